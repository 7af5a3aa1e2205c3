//! What is seen leaves as a GIF: a query, a dream, an episode that the planner acted in, or a dream beside the real world.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use crate::app::{App, Effect, Panel, Picture, Purpose, State};
use crate::worker::{
    CandidateView, ClipSource, DeployedMoment, DriveView, JobCommand, RolloutView, WorkerError,
};
use crate::world::Frame;

/// Steps between two moments that are remembered.
const EVERY: usize = 3;
/// Moments that are remembered at the most: seven seconds of a world of 50 Hz.
const MOST: usize = 120;
/// Bytes of all of them at the most.
const MOST_BYTES: usize = 48 << 20;

/// The latest moments of an episode, as many as there is room for.
#[derive(Clone, Debug)]
pub(crate) struct Replay<T> {
    moments: VecDeque<(usize, T, usize)>,
    n_bytes: usize,
}

impl<T> Default for Replay<T> {
    fn default() -> Self {
        Self { moments: VecDeque::new(), n_bytes: 0 }
    }
}

impl<T: Clone> Replay<T> {
    /// Takes in what is seen at `step` and takes `n_bytes`; an earlier step begins another episode.
    fn push(&mut self, step: usize, moment: T, n_bytes: usize) {
        let last = self.moments.back().map(|(step, ..)| *step);
        if last.is_some_and(|last| step < last) {
            *self = Self::default();
        } else if last.is_some_and(|last| step < last + EVERY) {
            return;
        }
        self.moments.push_back((step, moment, n_bytes));
        self.n_bytes += n_bytes;
        while self.moments.len() > MOST || self.n_bytes > MOST_BYTES && self.moments.len() > 1 {
            self.n_bytes -= self.moments.pop_front().map_or(0, |(.., n_bytes)| n_bytes);
        }
    }

    /// Whether there is enough to be called a clip.
    pub(crate) fn is_clip(&self) -> bool {
        self.moments.len() > 1
    }

    /// What was seen, and how many moments a second there are in a world of `rate` steps a second.
    fn seen(&self, rate: f64) -> (Vec<T>, f64) {
        let steps = match (self.moments.front(), self.moments.back()) {
            (Some((first, ..)), Some((last, ..))) => last - first,
            _ => 0,
        };
        let pace = rate * (self.moments.len().saturating_sub(1)) as f64 / steps.max(1) as f64;
        (self.moments.iter().map(|(_, moment, _)| moment.clone()).collect(), pace.max(1.0))
    }
}

/// The clip that is being saved, and what could be one.
#[derive(Debug, Default)]
pub(crate) struct Clips {
    /// What is to be written, while somebody is asked where.
    waiting: Option<(ClipSource, String)>,
    /// How many are being written.
    pub n_writing: usize,
    /// The latest moments of the planner in the real world.
    pub deployed: Replay<DeployedMoment>,
    /// Those of a dream beside the real world.
    pub beside: Replay<[Frame; 2]>,
}

impl State {
    /// Whether something on the panel can be saved as a clip.
    pub(crate) fn has_clip(&self) -> bool {
        match self.panel {
            Panel::Label => self.label.shown.is_some_and(|shown| self.label.pairs.contains_key(&shown.query)),
            Panel::Dream | Panel::Reward => self.is_reviewing() && self.review.dream.is_some(),
            Panel::Deploy => self.clips.deployed.is_clip(),
            Panel::Record => self.clips.beside.is_clip(),
            Panel::World | Panel::Evaluate => false,
        }
    }

    /// What is seen on the panel, and what its file could be called.
    fn clip(&self) -> Option<(ClipSource, String)> {
        let rate = self.spec.rate;
        match self.panel {
            Panel::Label => {
                let query = self.label.shown?.query;
                let pair = self.label.pairs.get(&query)?;
                let frames = |clip: &[Picture]| clip.iter().map(Frame::from).collect();
                let asked = self.session().and_then(|session| session.query(query));
                let response = asked.and_then(|asked| asked.answer()).map(|given| given.answer.response);
                let (left, right) = (frames(&pair.left), frames(&pair.right));
                let source = ClipSource::Query { left, right, response, rate };
                Some((source, format!("query-{}.gif", query.0)))
            }
            Panel::Dream | Panel::Reward => {
                let id = self.review.dream?;
                let episode = Arc::clone(self.review.episodes.get(&id)?);
                let model = self.world.loaded.as_ref()?.parameters.clone();
                Some((ClipSource::Dream { episode, model }, format!("dream-{}.gif", id.0 + 1)))
            }
            Panel::Deploy => {
                let (seen, rate) = self.clips.deployed.seen(rate);
                let name = format!("episode-{}.gif", self.deploy.seed);
                Some((ClipSource::Deployed { seen, rate }, name))
            }
            Panel::Record => {
                let (seen, rate) = self.clips.beside.seen(rate);
                Some((ClipSource::Beside { seen, rate }, "dream-beside-real.gif".to_owned()))
            }
            Panel::World | Panel::Evaluate => None,
        }
    }
}

impl From<&Picture> for Frame {
    fn from(picture: &Picture) -> Self {
        Self::new(picture.height, picture.width, Arc::clone(&picture.rgb))
    }
}

impl App {
    /// Asks where to save what is seen on the panel.
    pub(super) fn save_clip(&mut self) {
        if !self.state.has_clip() {
            return self.warn("there is nothing here yet that could be a clip".to_owned());
        }
        let Some((source, name)) = self.state.clip() else { return };
        self.effects.push(Effect::OpenDialog(Purpose::Clip, name.clone()));
        self.state.clips.waiting = Some((source, name));
    }

    /// A place was chosen for the clip, or none; where nobody could be asked, it is put beside the sessions.
    pub(super) fn clip_place_chosen(&mut self, chosen: Result<Vec<PathBuf>, String>) {
        let Some((source, name)) = self.state.clips.waiting.take() else { return };
        let path = match chosen {
            Ok(paths) => paths.into_iter().next(),
            Err(_) => Some(self.sessions.join(name)),
        };
        if let Some(path) = path {
            self.state.clips.n_writing += 1;
            self.job(JobCommand::WriteClip { path, source });
        }
    }

    pub(super) fn clip_written(&mut self, written: Result<PathBuf, WorkerError>) {
        self.state.clips.n_writing = self.state.clips.n_writing.saturating_sub(1);
        match written {
            Ok(path) => self.note(format!("the clip is in {}", path.display())),
            Err(error) => self.fail(error.to_string()),
        }
    }

    /// Remembers what is seen while the planner acts.
    pub(super) fn remember_deployed(&mut self, view: &DriveView) {
        let last = |candidate: &CandidateView| candidate.frames.last().cloned();
        let lead_to: Arc<[Frame]> = view.candidates.iter().filter_map(last).collect();
        let n_bytes = view.frame.rgb().len() + lead_to.iter().map(|frame| frame.rgb().len()).sum::<usize>();
        let moment = DeployedMoment { frame: view.frame.clone(), lead_to, chosen: view.chosen };
        self.state.clips.deployed.push(view.step, moment, n_bytes);
    }

    /// Remembers what is dreamt beside the real world.
    pub(super) fn remember_beside(&mut self, view: &RolloutView) {
        let Some(live) = &self.state.record.live else { return };
        let n_bytes = live.frame.rgb().len() + view.frame.rgb().len();
        self.state.clips.beside.push(view.step, [live.frame.clone(), view.frame.clone()], n_bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_moments_are_remembered_and_another_episode_begins_anew() {
        let mut replay = Replay::default();
        for step in 0..1000 {
            replay.push(step, step, 10);
        }
        let (seen, rate) = replay.seen(50.0);
        assert_eq!((seen.len(), seen[MOST - 1]), (MOST, 999));
        assert!((rate - 50.0 / 3.0).abs() < 1e-9, "{rate}");
        replay.push(0, 7, MOST_BYTES);
        assert!(!replay.is_clip(), "one picture is no clip");
        replay.push(3, 8, MOST_BYTES);
        assert_eq!(replay.seen(50.0).0, [8], "there is no room for more");
    }

    /// An application without a world model, whose sessions are to be in `sessions`.
    fn app() -> App {
        App::new(crate::app::Startup {
            spec: Arc::default(),
            spec_file: None,
            sessions: "sessions".into(),
            dataset: "recordings".into(),
            world: crate::app::FirstWorld::Here(Err("there is none".to_owned())),
            session: None,
            seed: 1,
        })
    }

    /// What is written where, once a place was chosen.
    fn written(app: &mut App, chosen: Result<Vec<PathBuf>, String>) -> Option<PathBuf> {
        use crate::app::{Command, WindowCommand};
        use crate::worker::WorkerCommand;
        let mut ask = |command| app.command(Command::Window(command), crate::app::Moment::default());
        ask(WindowCommand::SaveClip);
        ask(WindowCommand::Chosen(Purpose::Clip, chosen));
        app.take_effects().into_iter().find_map(|effect| {
            let Effect::Worker(WorkerCommand::Jobs(JobCommand::WriteClip { path, .. })) = effect else {
                return None;
            };
            Some(path)
        })
    }

    #[test]
    fn a_clip_is_written_where_somebody_says_or_beside_the_sessions_where_nobody_can_be_asked() {
        let mut app = app();
        app.show(Panel::Record);
        assert_eq!(written(&mut app, Ok(vec!["mine.gif".into()])), None, "there is nothing to see yet");
        let one = |shade: u8| Frame::square(2, vec![shade; 12]);
        for step in 0..9 {
            app.state.clips.beside.push(step, [one(1), one(2)], 24);
        }
        assert_eq!(written(&mut app, Ok(vec!["mine.gif".into()])), Some("mine.gif".into()));
        assert_eq!(written(&mut app, Ok(Vec::new())), None, "the dialog was closed");
        let no_dialog = Err("no dialog".to_owned());
        assert_eq!(written(&mut app, no_dialog), Some("sessions/dream-beside-real.gif".into()));
    }
}
