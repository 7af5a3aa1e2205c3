//! The first hour: what is offered at a first start, and hints, each once, where they are needed.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::app::{App, Budget, DreamCommand, Effect, Panel, Purpose, State};
use crate::query::Protocol;
use crate::session::N_PRACTICED;
use crate::worker::trainer::MIN_LABELS;
use crate::worker::{JobCommand, WorkerError};
use crate::world::example_of;

/// On the first hour.
#[derive(Clone, Debug, PartialEq)]
pub enum GuideCommand {
    /// Nothing is remembered of anybody: this may be a first start.
    FirstStart,
    /// Hints are shown, but for these.
    Teach(BTreeSet<Hint>),
    /// Offers how to begin, or no longer.
    Offer(bool),
    /// Begins a dream.
    Dream,
    /// Asks twenty queries of the example that is shipped.
    Practice,
    /// Asks for the file of a world.
    OpenWorld,
    /// A hint was read.
    Understood(Hint),
    /// Shows all hints again.
    TeachAgain,
}

/// Something that is said once, where it is needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hint {
    /// What the keys do in the first dream.
    Drive,
    /// A dream is kept: another one, or questions.
    Again,
    /// What the keys mean at the first query.
    Answer,
    /// What justifications are.
    Justify,
    /// How many of the first answers there are.
    GoOn,
    /// There are answers enough to see what is learned from them.
    Learned,
    /// How the reward is fitted and kept.
    Fit,
    /// What the reward is for.
    Deploy,
    /// What is seen while the planner acts.
    Futures,
}

impl Hint {
    /// All of them, in the order of the work.
    pub const ALL: [Self; 9] = [
        Self::Drive,
        Self::Again,
        Self::Answer,
        Self::Justify,
        Self::GoOn,
        Self::Learned,
        Self::Fit,
        Self::Deploy,
        Self::Futures,
    ];

    /// Whether it helps now.
    fn is_due(self, state: &State) -> bool {
        let (n_dreams, n_answered, n_fits) = so_far(state);
        let (panel, is_shown) = (state.panel, state.label.shown.is_some());
        let is_justified = state.protocol() == Protocol::DropjMulti;
        let has_reward = state.reward.parameters.is_some();
        match self {
            Self::Drive => panel == Panel::Dream && state.dream.is_on && n_dreams == 0,
            Self::Again => panel == Panel::Dream && !state.dream.is_on && n_dreams > 0 && n_answered == 0,
            Self::Answer => panel == Panel::Label && is_shown && !is_justified && n_answered < A_FEW,
            Self::Justify => panel == Panel::Label && is_shown && is_justified && n_answered < A_FEW,
            Self::GoOn => panel == Panel::Label && is_shown && (A_FEW..N_PRACTICED).contains(&n_answered),
            Self::Learned => panel == Panel::Label && n_answered >= N_PRACTICED && n_fits == 0,
            Self::Fit => {
                panel == Panel::Reward && n_answered >= MIN_LABELS && n_fits == 0 && !state.reward.is_fitting
            }
            Self::Deploy => matches!(panel, Panel::Reward | Panel::Label) && n_fits > 0 && has_reward,
            Self::Futures => panel == Panel::Deploy && has_reward && !state.is_recorded_only(),
        }
    }

    /// Whether what it tells of was done, so that nobody needs to be told.
    fn is_done(self, state: &State) -> bool {
        let (n_dreams, n_answered, n_fits) = so_far(state);
        match self {
            Self::Drive => n_dreams > 0,
            Self::Again => n_answered > 0,
            Self::Answer | Self::Justify => n_answered >= A_FEW,
            Self::GoOn => n_answered >= N_PRACTICED,
            Self::Learned => n_answered >= N_PRACTICED && state.panel == Panel::Reward || n_fits > 0,
            Self::Fit => n_fits > 0,
            Self::Deploy => state.panel == Panel::Deploy && n_fits > 0,
            Self::Futures => !state.deploy.episodes.is_empty(),
        }
    }
}

/// Answers after which the keys are known.
const A_FEW: usize = 3;

/// Kept dreams, answers and full fits of the session.
fn so_far(state: &State) -> (usize, usize, usize) {
    state.session().map_or((0, 0, 0), |session| {
        (session.dream_lens().len(), session.statistics().n_answered, session.fits().len())
    })
}

/// What is offered and taught.
#[derive(Clone, Debug, Default)]
pub(crate) struct Guide {
    /// Whether it is offered how to begin.
    pub is_offering: bool,
    /// Whether hints are shown: only where it can be remembered that they were.
    pub is_teaching: bool,
    /// Those that were shown, or that nobody needs any more.
    pub seen: BTreeSet<Hint>,
    /// Whether a session of a few queries is being made.
    pub is_preparing: bool,
    /// Where it lies, once it was.
    pub practice: Option<PathBuf>,
}

impl State {
    /// The hint that is shown now.
    pub(crate) fn hint(&self) -> Option<Hint> {
        let guide = &self.guide;
        if !guide.is_teaching || guide.is_offering {
            return None;
        }
        Hint::ALL.into_iter().find(|hint| !guide.seen.contains(hint) && hint.is_due(self))
    }

    /// How much is to be labeled: as long as somebody is being taught, a beginning.
    pub(crate) fn budget(&self) -> Budget {
        let (_, n_answered, _) = so_far(self);
        let is_beginning =
            self.guide.is_teaching && !self.guide.seen.contains(&Hint::Learned) && n_answered <= N_PRACTICED;
        let is_practice = self.guide.practice.is_some()
            && self.open.as_ref().map(|open| &open.dir) == self.guide.practice.as_ref();
        if is_beginning || is_practice { Budget::Queries(N_PRACTICED as u32) } else { self.label.budget }
    }

    /// Whether an example is shipped that can be asked about.
    pub(crate) fn has_example(&self) -> bool {
        example_of(&self.spec.name).is_some()
    }
}

impl App {
    pub(super) fn guide_command(&mut self, command: GuideCommand) {
        let guide = &mut self.state.guide;
        match command {
            GuideCommand::FirstStart => {
                guide.is_teaching = true;
                guide.is_offering = self.state.open.is_none() && self.state.opening.is_none();
            }
            GuideCommand::Teach(seen) => (guide.is_teaching, guide.seen) = (true, seen),
            GuideCommand::Offer(is_offering) => {
                guide.is_offering = is_offering;
                if is_offering {
                    self.pause_driving(None);
                    self.state.help_open = false;
                }
            }
            GuideCommand::Dream => {
                self.show(Panel::Dream);
                self.dream_command(DreamCommand::Start);
            }
            GuideCommand::Practice => self.practice(),
            GuideCommand::OpenWorld => {
                self.effects.push(Effect::OpenDialog(Purpose::Env, String::new()));
            }
            GuideCommand::Understood(hint) => drop(guide.seen.insert(hint)),
            GuideCommand::TeachAgain => {
                (guide.is_teaching, guide.seen) = (true, BTreeSet::new());
                self.state.help_open = false;
            }
        }
    }

    /// Has a session of a few queries made, which is opened once it is there.
    fn practice(&mut self) {
        if self.state.guide.is_preparing {
            return;
        }
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        self.state.guide.is_preparing = true;
        let (world, sessions, annotator) =
            (self.state.spec.name.clone(), self.sessions.clone(), self.annotator());
        self.job(JobCommand::Practice { world, sessions, annotator });
    }

    /// A session of a few queries is there, or it is known why not.
    pub(super) fn practice_made(&mut self, made: Result<PathBuf, WorkerError>) {
        self.state.guide.is_preparing = false;
        match made {
            Ok(dir) => {
                self.state.guide.practice = Some(dir.clone());
                self.session_command(crate::app::SessionCommand::Open(dir));
            }
            Err(error) => self.fail(error.to_string()),
        }
    }

    /// Takes note of what was done: nobody is told of it any more.
    pub(super) fn advance_guide(&mut self) {
        if !self.state.guide.is_teaching {
            return;
        }
        for hint in Hint::ALL {
            if !self.state.guide.seen.contains(&hint) && hint.is_done(&self.state) {
                self.state.guide.seen.insert(hint);
            }
        }
    }
}
