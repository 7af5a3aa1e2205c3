//! Driving in a dream, and keeping it.

mod review;

pub(crate) use review::{Reviewing, resting};

use crate::app::{App, Command, Effect, Picture, SessionCommand};
use crate::dream::DreamEpisode;
use crate::planner::synthesis::Acquisition;
use crate::query::{DreamId, Protocol, SEGMENT_LEN};
use crate::session::{DreamJournal, DreamSource, SessionError};
use crate::worker::{DreamReport, DreamerCommand, LiveView, SessionWriterCommand, WorkerCommand};
use crate::world::Action;

/// On dreams.
#[derive(Clone, Debug, PartialEq)]
pub enum DreamCommand {
    /// Chooses where dreams begin.
    ChooseStart(usize),
    /// Begins a dream.
    Start,
    /// Stops the clock of the dream, or lets it go on.
    Pause,
    /// One step of a dream that stands.
    Step,
    /// Marks the present step as unsafe.
    MarkUnsafe,
    /// Ends the dream and keeps it.
    Keep,
    /// Throws the dream away and begins another from the same state.
    Redo,
    /// Throws the dream away.
    Leave,
    /// This is what the controls give now.
    Act(Action),
    /// A script has played a dream, and offers it for keeping; a synthesized trajectory with what it was to be.
    Offer {
        /// The dream.
        episode: Box<DreamEpisode>,
        /// Who played it.
        source: DreamSource,
        /// What it was to be.
        acquisition: Option<Acquisition>,
    },
    /// Looks at a kept dream again, or no longer.
    Review(Option<DreamId>),
    /// Deletes a kept dream; its file stays.
    Delete(DreamId),
    /// Uses it again.
    Restore(DreamId),
}

/// Driving in a dream.
#[expect(clippy::struct_excessive_bools, reason = "each is true or not whatever the others are")]
#[derive(Debug, Default)]
pub(crate) struct Dreaming {
    pub is_on: bool,
    /// Whether one is to begin as soon as it has a journal.
    pub is_starting: bool,
    /// Whether the dream has been asked to end and its episode is awaited.
    pub is_ending: bool,
    /// Whether the planner was given the controls since it began.
    pub is_shared: bool,
    pub start_idx: usize,
    pub live: Option<LiveView>,
    pub picture: Option<Picture>,
    /// What starts look like, in their order.
    pub thumbnails: Vec<Option<Picture>>,
    pub seed: u64,
    /// The one that is being driven, as it began.
    pub begun: Option<DreamEpisode>,
    /// Those that could not be written, each with its journal if that could be.
    pub unsaved: Vec<(DreamEpisode, Option<DreamJournal>)>,
    /// What the controls give now.
    pub action: Action,
    /// Why it was paused, where nobody asked for that.
    pub why_paused: Option<&'static str>,
    /// Whether a smaller world model was offered already.
    pub is_compact_offered: bool,
}

/// Steps after which it is clear whether a machine keeps the pace, and which share of them may be late.
const PACE: (usize, f64) = (100, 0.05);

impl App {
    pub(super) fn dream_command(&mut self, command: DreamCommand) {
        let is_paused = self.state.dream.live.as_ref().is_some_and(|live| live.is_paused);
        match command {
            DreamCommand::ChooseStart(idx) => {
                self.state.dream.start_idx = idx;
                self.state.dream.picture = None;
            }
            DreamCommand::Start => {
                self.state.review.is_opened = false;
                self.start_dream();
            }
            DreamCommand::Pause => {
                self.state.dream.why_paused = None;
                self.send_dreamer(DreamerCommand::Pause(!is_paused));
            }
            DreamCommand::Step if !is_paused => {}
            DreamCommand::Step => self.send_dreamer(DreamerCommand::Step),
            DreamCommand::MarkUnsafe => self.send_dreamer(DreamerCommand::MarkUnsafe),
            DreamCommand::Keep if self.state.dream.is_ending => {}
            DreamCommand::Keep => {
                self.state.dream.is_ending = true;
                self.send_dreamer(DreamerCommand::Finish);
            }
            DreamCommand::Redo => {
                self.end_dream();
                self.start_dream();
            }
            DreamCommand::Leave => self.end_dream(),
            DreamCommand::Act(action) => self.state.dream.action = action,
            DreamCommand::Offer { episode, source, acquisition } => {
                self.save_dream(*episode, source, acquisition, None);
            }
            DreamCommand::Review(dream) => self.review(dream),
            DreamCommand::Delete(dream) => self.delete_dream(dream),
            DreamCommand::Restore(dream) => self.restore_dream(dream),
        }
    }

    pub(super) fn dream_report(&mut self, report: DreamReport) {
        match report {
            DreamReport::View(view) => {
                let dream = &mut self.state.dream;
                if dream.is_on {
                    dream.picture = Some(Picture::from(&view.frame));
                    dream.live = Some(view);
                }
            }
            DreamReport::Ended { episode, journal } => self.dream_ended(episode, journal),
            DreamReport::Unjournaled(why) => {
                let text = "the dream goes on, but is lost if the program ends before it is kept";
                self.not_saved(text, &why);
            }
            DreamReport::Review(view) => self.review_seen(view),
            DreamReport::Rewards(rewards) => self.state.review.rewards = Some(rewards),
        }
    }

    fn send_dreamer(&mut self, command: DreamerCommand) {
        self.send(WorkerCommand::Dreamer(command));
    }

    fn start_dream(&mut self) {
        self.state.guide.is_offering = false;
        if self.state.opening.is_some() {
            return self.warn("one moment: the session is being opened".to_owned());
        }
        if self.state.dream.is_starting {
            return;
        }
        if self.state.open.is_none() {
            self.state.dream.is_starting = self.new_session(Protocol::of(&self.state.spec));
            return;
        }
        self.open_journal();
    }

    /// Has a journal opened for the dream that is to begin: nobody drives what could not be kept.
    pub(super) fn open_journal(&mut self) {
        self.state.dream.is_starting = false;
        let idx = self.state.dream.start_idx;
        let start = self.state.world.loaded.as_ref().and_then(|world| world.starts.get(idx));
        let Some(start) = start.map(|start| start.state.clone()) else { return };
        self.state.dream.is_starting = true;
        let episode = DreamEpisode::new(start, self.fresh_seed());
        self.write(SessionWriterCommand::OpenJournal { episode, is_new: true });
    }

    /// Begins the dream, or goes on with the one that is driven, now that it has a journal; or says why it has none.
    pub(super) fn journal_opened(
        &mut self,
        episode: DreamEpisode,
        journal: Result<DreamJournal, SessionError>,
        is_new: bool,
    ) {
        let was_starting = std::mem::take(&mut self.state.dream.is_starting) && is_new;
        match journal {
            Ok(journal) if was_starting => self.begin_dream(episode, journal),
            Ok(journal) if !is_new && self.state.dream.is_on && self.state.dream.seed == episode.seed => {
                self.send_dreamer(DreamerCommand::Journal(journal));
            }
            Ok(journal) => self.write(SessionWriterCommand::DiscardJournal(journal)),
            Err(error) if is_new => {
                let text = "no dream begins, for it would be lost if the program were killed";
                self.not_saved(text, &error.to_string());
            }
            Err(error) => {
                let text = "the dream goes on, but is lost if the program ends before it is kept";
                self.not_saved(text, &error.to_string());
            }
        }
    }

    fn begin_dream(&mut self, episode: DreamEpisode, journal: DreamJournal) {
        self.effects.push(Effect::ReleaseControls);
        let (start, seed) = (episode.start.clone(), episode.seed);
        let dream = &mut self.state.dream;
        dream.begun = Some(episode);
        (dream.is_on, dream.is_ending, dream.live, dream.seed) = (true, false, None, seed);
        (dream.is_shared, dream.why_paused) = (false, None);
        self.send_dreamer(DreamerCommand::Start { start, seed, journal: Some(journal) });
    }

    pub(super) fn end_dream(&mut self) {
        self.state.dream.is_starting = false;
        if self.state.dream.is_on {
            self.send_dreamer(DreamerCommand::Discard);
            self.state.dream.is_on = false;
        }
    }

    fn dream_ended(&mut self, episode: DreamEpisode, journal: Option<DreamJournal>) {
        // One that was kept and followed by another at once arrives after that has begun.
        if episode.seed == self.state.dream.seed {
            (self.state.dream.is_on, self.state.dream.is_ending) = (false, false);
            self.offer_compact(episode.len());
        }
        if !episode.is_usable() {
            let n = episode.len();
            self.warn(format!("the dream had {n} steps and was not kept: a segment needs {SEGMENT_LEN}"));
            if let Some(journal) = journal {
                self.write(SessionWriterCommand::DiscardJournal(journal));
            }
            return;
        }
        self.save_dream(episode, DreamSource::User, None, journal);
    }

    /// Offers a smaller world model, where there is one, once a dream of `n_steps` came too late to drive well in it.
    fn offer_compact(&mut self, n_steps: usize) {
        let n_late = self.state.dream.live.as_ref().map_or(0, |live| live.n_late);
        let (enough, share) = PACE;
        let is_slow = n_steps >= enough && n_late as f64 > share * n_steps as f64;
        let compact = self.state.world.loaded.as_ref().and_then(|world| world.compact.clone());
        let Some(path) = compact.filter(|_| is_slow && !self.state.dream.is_compact_offered) else { return };
        self.state.dream.is_compact_offered = true;
        let text = format!(
            "{n_late} of {n_steps} steps came late: this machine is slow for this world model. A compact one is quicker and sees \
             less; a session of its own begins with it"
        );
        let load = Command::WorldModel(super::WorldModelCommand::Load(path));
        self.offer(text, vec![("Use the compact one".to_owned(), load)]);
    }

    pub(super) fn save_dream(
        &mut self,
        episode: DreamEpisode,
        source: DreamSource,
        acquisition: Option<Acquisition>,
        journal: Option<DreamJournal>,
    ) {
        self.change(SessionWriterCommand::SaveDream { episode, source, acquisition, journal });
    }

    /// A dream could not be kept: it stays in memory until it can.
    pub(super) fn dream_not_saved(
        &mut self,
        episode: DreamEpisode,
        journal: Option<DreamJournal>,
        error: &SessionError,
    ) {
        self.state.dream.unsaved.push((episode, journal));
        self.not_saved("the dream is not lost but could not be kept yet", &error.to_string());
    }

    /// Says how many dreams a killed program left behind, and what can be done with them.
    pub(super) fn offer_dreams(&mut self) {
        let n = self.state.unfinished.len();
        if n > 0 {
            let dreams = super::counted(n, "dream");
            let text = format!("{dreams} not ended the last time can still be kept");
            let ways =
                [("Keep", SessionCommand::RecoverDreams), ("Throw away", SessionCommand::DiscardDreams)];
            self.offer(text, ways.map(|(name, command)| (name.to_owned(), Command::Session(command))).into());
        }
    }
}
