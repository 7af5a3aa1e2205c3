//! What the window shows: panels read it, only the app changes it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;
use std::path::PathBuf;

use eframe::egui::{TextureHandle, ThemePreference};

use crate::dream::{DreamEpisode, Screen};
use crate::env::controls::{ControlConfig, Pad};
use crate::env::{Action, Frame};
use crate::evaluation::EpisodeMetrics;
use crate::query::{DreamId, Justification, Protocol, Query, QueryId, SEGMENT_LEN, Transition, Weights};
use crate::session::{Annotators, DreamJournal, Header, Session, SessionStore, UnfinishedDream};
use crate::tensor::Parameters;
use crate::ui::beside::Besides;
use crate::ui::choosing::{Asking, Weighing, is_held_back};
use crate::ui::command::{Command, Field, Panel};
use crate::ui::errands::Several;
use crate::ui::foretelling::Foretelling;
use crate::ui::keys::{Deed, Keys, Rebinding};
use crate::ui::opening::BeingOpened;
use crate::ui::pace::{Budget, Pace};
use crate::ui::pads::Pads;
use crate::ui::review::Reviewing;
use crate::ui::shelf::Shelving;
use crate::ui::trajectories::Making;
use crate::ui::widgets::clip::Clip;
use crate::worker::{DriveView, Learning, LiveView};
use crate::world_model::LatentState;
use crate::world_model::fit::{Progress, Stage};

/// Where a dream can begin.
#[derive(Clone, Debug)]
pub struct DreamStart {
    /// What a person would call it.
    pub name: String,
    /// The state.
    pub state: LatentState,
    /// What it looks like.
    pub picture: Option<Frame>,
}

/// A world model that is ready for use.
#[derive(Clone, Debug)]
pub struct LoadedWorld {
    /// A name for people: that it is shipped, or its file's.
    pub name: String,
    /// The file it came from, if it came from one.
    pub path: Option<PathBuf>,
    /// The networks.
    pub parameters: Parameters,
    /// What is known about it: what it learned from, how well it foretells.
    pub card: Vec<(String, String)>,
    /// Where its dreams can begin.
    pub starts: Vec<DreamStart>,
}

/// Everything that panels read.
#[derive(Default)]
pub(crate) struct State {
    /// The environment, as on the command line.
    pub(crate) env: String,
    /// Seconds since the window opened.
    pub now: f64,
    /// What is shown.
    pub panel: Panel,
    /// What is typed.
    pub fields: BTreeMap<Field, String>,
    /// The session, once there is one.
    pub store: Option<SessionStore>,
    /// The session that is being opened.
    pub opening: Option<BeingOpened>,
    /// Sessions that can be opened.
    pub recent: Vec<RecentSession>,
    /// Dreams that a killed program left behind.
    pub unfinished: Vec<UnfinishedDream>,
    pub sessions_open: bool,
    /// Sessions of several annotators.
    pub several: Several,
    /// What is being done with files, in a few words.
    pub errand: Option<&'static str>,
    pub help_open: bool,
    pub theme: ThemePreference,
    /// Which keys do what.
    pub keys: Keys,
    /// The key that is being changed.
    pub rebinding: Option<Rebinding>,
    /// Which buttons of a pad do what.
    pub pads_map: Pads,
    /// What the button that is pressed next will do.
    pub rebinding_pad: Option<Deed>,
    /// Where the sticks and triggers are.
    pub pad_held: Pad,
    /// Whether the list of keys shows the gamepad.
    pub is_pad_shown: bool,
    /// How much keys give, and where a pad begins to.
    pub controls: ControlConfig,
    /// Who draws the window.
    pub adapter: String,
    /// The pads that are plugged in.
    pub pads: Vec<String>,
    pub toasts: Vec<Toast>,
    pub world: World,
    pub record: Recording,
    pub shelf: Shelving,
    pub dream: Dreaming,
    pub label: Labeling,
    pub reward: Rewarding,
    pub review: Reviewing,
    pub deploy: Deploying,
}

/// A session in the list.
#[derive(Clone, Debug)]
pub(crate) struct RecentSession {
    pub dir: PathBuf,
    pub name: String,
    /// What it holds, or why it cannot be opened.
    pub about: Result<String, String>,
}

/// A message, with a way out of what it tells.
#[derive(Clone, Debug)]
pub(crate) struct Toast {
    pub id: u64,
    pub kind: ToastKind,
    pub text: String,
    /// What can be done, and what it is called.
    pub ways: Vec<(String, Command)>,
    /// When it goes by itself, in seconds since the window opened.
    pub until: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ToastKind {
    Note,
    Done,
    Error,
}

/// The world model, and the fit of another.
#[derive(Default)]
pub(crate) struct World {
    pub loaded: Option<LoadedWorld>,
    pub hash: String,
    /// The file that is being read.
    pub loading: Option<PathBuf>,
    pub fit: Option<FitState>,
    /// The file of the last fit.
    pub fitted: Option<PathBuf>,
}

impl World {
    /// Whether the session with this head was dreamed with it; of none, nothing is known.
    pub(crate) fn is_of(&self, header: &Header) -> bool {
        self.loaded.is_none() || self.hash == header.world_model
    }
}

/// A fit that is under way.
#[derive(Clone, Debug, Default)]
pub(crate) struct FitState {
    pub progress: Option<Progress>,
    /// The stage, when it was first heard of, and how many updates it had then.
    pub began: Option<(Stage, f64, usize)>,
    pub loss: Vec<[f64; 2]>,
    pub held_out: Vec<[f64; 2]>,
}

impl FitState {
    /// Updates that `progress` has behind it in its stage.
    fn updates(progress: &Progress) -> usize {
        progress.epoch * progress.n + progress.done
    }

    pub(crate) fn hear(&mut self, progress: Progress, now: f64) {
        let updates = Self::updates(&progress);
        if self.began.is_none_or(|(stage, ..)| stage != progress.stage) {
            self.began = Some((progress.stage, now, updates));
            self.loss.clear();
            self.held_out.clear();
        }
        let x = updates as f64 / progress.n.max(1) as f64;
        if progress.loss.is_finite() {
            self.loss.push([x, progress.loss]);
        }
        if let Some(held_out) = progress.held_out.filter(|loss| loss.is_finite()) {
            self.held_out.push([x, held_out]);
        }
        self.progress = Some(progress);
    }

    /// Frames or steps a second, and seconds to the end of the stage at the most.
    pub(crate) fn pace(&self, now: f64) -> Option<(f64, f64)> {
        let ((_, since, first), progress) = (self.began?, self.progress.as_ref()?);
        let (secs, done) = (now - since, Self::updates(progress).saturating_sub(first) as f64);
        if secs < 1.0 || done < 1.0 {
            return None;
        }
        let left = (progress.max_epochs * progress.n).saturating_sub(Self::updates(progress)) as f64;
        Some((done * progress.items as f64 / secs, left * secs / done))
    }
}

/// Driving the real car.
#[derive(Default)]
pub(crate) struct Recording {
    pub is_on: bool,
    /// Whether the recording has been asked to end and is being sealed.
    pub is_ending: bool,
    pub live: Option<LiveView>,
    pub picture: Option<TextureHandle>,
    /// How many episodes were kept since the window opened.
    pub n_kept: usize,
    /// The dream beside.
    pub besides: Besides,
}

/// Driving in a dream.
#[derive(Default)]
pub(crate) struct Dreaming {
    pub is_on: bool,
    /// Whether the dream has been asked to end and its episode is awaited.
    pub is_ending: bool,
    pub start_idx: usize,
    pub live: Option<LiveView>,
    pub picture: Option<TextureHandle>,
    /// What starts look like, in their order.
    pub thumbnails: Vec<Option<TextureHandle>>,
    pub seed: u64,
    /// One that could not be written, and its journal if that could be.
    pub unsaved: Option<(DreamEpisode, Option<DreamJournal>)>,
    /// What the hands do now.
    pub action: Action,
}

/// A pair of clips on the graphics card.
pub(crate) struct Pair {
    pub left: Clip,
    pub right: Clip,
}

/// Answering.
pub(crate) struct Labeling {
    /// Dreams whose files are damaged: nothing is shown of them.
    pub unreadable: Vec<DreamId>,
    /// The query that is answered again, before the others.
    pub revisited: Option<QueryId>,
    /// The query that is on the screen, and since when.
    pub shown: Option<(QueryId, f64)>,
    /// Clips that are ready, by query.
    pub pairs: BTreeMap<QueryId, Pair>,
    /// Queries whose clips have been asked for.
    pub asked: Vec<QueryId>,
    /// A picture of either clip, of queries that were on the screen or in the list of answers.
    pub thumbnails: BTreeMap<QueryId, [TextureHandle; 2]>,
    /// Queries whose thumbnails have been asked for.
    pub glanced: BTreeSet<QueryId>,
    /// Where the clips are, in frames.
    pub playhead: f64,
    /// How often they were seen to their end.
    pub loops: u32,
    pub is_standing: bool,
    /// Frames a second.
    pub speed: f64,
    /// Whether the questions come one at a time.
    pub is_guided: bool,
    /// When queries are drawn again after one could not be written down, in seconds since the window opened.
    pub ask_again_at: f64,
    /// Whether the list of answers was asked for.
    pub is_list_open: bool,
    /// What was said to the guided questions so far: whether left is safe, then right.
    pub guided: Vec<bool>,
    /// The justification that the next preference rests on.
    pub justification: Option<Justification>,
    /// The answer given last, in words.
    pub said: Option<String>,
    /// The query that was skipped just now, which can still be given a reason.
    pub skipped: Option<QueryId>,
    /// How much is to be labeled.
    pub budget: Budget,
    /// Minutes of labeling after which a pause is suggested; 0 is never.
    pub break_minutes: u32,
    /// The clock of whoever labels.
    pub pace: Pace,
    /// What is asked about.
    pub asking: Asking,
    /// The trajectories that are made to be asked about.
    pub making: Making,
    /// What the trainer is asked of that.
    pub weighing: Weighing,
    /// Who answered about these dreams, as of when that was asked.
    pub annotators: Option<Annotators>,
    /// What is known of bad dreams.
    pub screen: Screen,
    /// What the reward says of clips that were answered.
    pub foretelling: Foretelling,
}

/// Frames a second at which clips are played at first: as they were driven.
pub(crate) const NORMAL_SPEED: f64 = 25.0;
/// Frames before the outcome of a transition that are played with it.
const RUN_UP: usize = 7;
/// Minutes of labeling after which a pause is suggested at first.
pub(crate) const BREAK_MINUTES: u32 = 25;

impl Default for Labeling {
    fn default() -> Self {
        Self {
            unreadable: Vec::new(),
            revisited: None,
            shown: None,
            pairs: BTreeMap::new(),
            asked: Vec::new(),
            thumbnails: BTreeMap::new(),
            glanced: BTreeSet::new(),
            playhead: 0.0,
            loops: 0,
            is_standing: false,
            speed: NORMAL_SPEED,
            is_guided: false,
            ask_again_at: 0.0,
            is_list_open: false,
            guided: Vec::new(),
            justification: None,
            said: None,
            skipped: None,
            budget: Budget::default(),
            break_minutes: BREAK_MINUTES,
            pace: Pace::default(),
            asking: Asking::default(),
            making: Making::default(),
            weighing: Weighing::default(),
            annotators: None,
            screen: Screen::default(),
            foretelling: Foretelling::default(),
        }
    }
}

impl Labeling {
    /// For another session: what the annotator likes stays.
    pub(crate) fn anew(&self) -> Self {
        let Self { speed, is_guided, budget, break_minutes, asking, ref pace, .. } = *self;
        let pace = pace.clone();
        Self { speed, is_guided, budget, break_minutes, pace, asking, ..Self::default() }
    }
}

/// Learning the reward.
#[derive(Default)]
pub(crate) struct Rewarding {
    pub latest: Option<Learning>,
    /// Loss of each member, by report.
    pub losses: Vec<Vec<[f64; 2]>>,
    pub held_out: Vec<[f64; 2]>,
    pub agreement: Vec<[f64; 2]>,
    /// Reports heard so far.
    pub n_heard: usize,
    pub parameters: Option<Parameters>,
    /// How many answers those rest on.
    pub n_learned: usize,
    pub is_fitting: bool,
    /// Whether other weights are being learned.
    pub is_relearning: bool,
    /// Weights that are tried with a slider.
    pub tried: Option<Weights>,
    /// Fits that were asked for: the seed of each, and how many lines the log had then.
    pub asked: Vec<(u64, u64)>,
}

impl Rewarding {
    pub(crate) fn hear(&mut self, learning: Learning) {
        let x = self.n_heard as f64;
        self.n_heard += 1;
        self.losses.resize(learning.losses.len().max(self.losses.len()), Vec::new());
        for (curve, loss) in self.losses.iter_mut().zip(&learning.losses) {
            push_thinned(curve, [x, f64::from(*loss)]);
        }
        let n = learning.n_labels as f64;
        if let Some(loss) = learning.held_out_loss {
            push_by_label(&mut self.held_out, [n, f64::from(loss)]);
        }
        if let Some(agreement) = learning.agreement {
            push_by_label(&mut self.agreement, [n, f64::from(agreement)]);
        }
        self.is_fitting = learning.fit_epochs.is_some();
        self.latest = Some(learning);
    }
}

/// Appends a point; a curve of very many loses every second one.
fn push_thinned(curve: &mut Vec<[f64; 2]>, point: [f64; 2]) {
    const MOST: usize = 4000;
    curve.push(point);
    if curve.len() > MOST {
        let mut is_kept = false;
        curve.retain(|_| {
            is_kept = !is_kept;
            is_kept
        });
    }
}

/// Appends a point, or moves the last one where nothing was answered since.
fn push_by_label(curve: &mut Vec<[f64; 2]>, point: [f64; 2]) {
    match curve.last_mut() {
        Some(last) if last[0] == point[0] => *last = point,
        _ => push_thinned(curve, point),
    }
}

/// The planner at the wheel.
#[derive(Default)]
pub(crate) struct Deploying {
    pub is_on: bool,
    pub is_paused: bool,
    pub seed: u64,
    pub view: Option<DriveView>,
    pub picture: Option<TextureHandle>,
    /// Last pictures of the candidates.
    pub candidates: Vec<Option<TextureHandle>>,
    /// Episodes that ended: the track's seed and the figures.
    pub episodes: Vec<(u64, EpisodeMetrics)>,
}

/// The queries that come next, the present one first.
pub(crate) type Upcoming = VecDeque<Query>;

impl State {
    /// The session, if there is one.
    pub(crate) fn session(&self) -> Option<&Session> {
        self.store.as_ref().map(SessionStore::session)
    }

    /// The session's head, if there is one.
    pub(crate) fn header(&self) -> Option<&Header> {
        self.store.as_ref().map(SessionStore::header)
    }

    /// The questions that are asked.
    pub(crate) fn protocol(&self) -> Protocol {
        self.session().map_or_else(|| Protocol::of_env(&self.env), Session::protocol)
    }

    /// What answers weigh.
    pub(crate) fn weights(&self) -> Weights {
        self.session().map_or_else(|| Weights::of_env(&self.env), |session| session.weights().clone())
    }

    /// Whether something lies over the panel, so that its keys do nothing.
    pub(crate) fn is_covered(&self) -> bool {
        self.help_open || self.sessions_open || self.several.is_open
    }

    /// What is typed into a field.
    pub(crate) fn field(&self, field: Field) -> &str {
        self.fields.get(&field).map_or("", String::as_str)
    }

    /// The queries to answer, the one on the screen first.
    pub(crate) fn upcoming(&self) -> Upcoming {
        let Some(session) = self.session() else { return Upcoming::new() };
        let revisited = self.label.revisited.and_then(|id| session.query(id)).map(|asked| asked.query);
        let (protocol, is_sparse) = (session.protocol(), session.protocol().is_sparse());
        let pending = session.pending().filter(|asked| session.is_of(asked, protocol));
        let pending = pending.map(|asked| asked.query);
        let is_shown = |query: &Query| {
            let dreams = [query.left.dream, query.right.dream];
            !dreams.iter().any(|dream| self.label.unreadable.contains(dream))
        };
        let pending = pending.filter(|query| Some(query.id) != self.label.revisited).filter(is_shown);
        let mut pending: Vec<_> = pending.collect();
        // What is on the screen stays there, and transitions come in their order.
        let shown = self.label.shown.map(|(id, _)| id);
        pending.sort_by_key(|query| !is_sparse && Some(query.id) != shown && is_held_back(self, query));
        revisited.into_iter().chain(pending).collect()
    }

    /// The query that is on the screen.
    pub(crate) fn current(&self) -> Option<Query> {
        self.upcoming().pop_front()
    }

    /// Whether a query is of the kind that is asked about now: a pair of clips, or a transition.
    pub(crate) fn is_asked_now(&self, id: QueryId) -> bool {
        let is_of = |session: &Session| Some(session.is_of(session.query(id)?, session.protocol()));
        self.session().and_then(is_of).unwrap_or(false)
    }

    /// The transition that is on the screen, and the frame of its outcome.
    pub(crate) fn shown_transition(&self) -> Option<(Transition, usize)> {
        let asked = self.session()?.query(self.label.shown?.0)?;
        let transition = asked.transition?;
        Some((transition, transition.outcome_in(asked.query.left.start)))
    }

    /// The frames that are played over and over: all of them, or a run-up to the outcome of a transition.
    pub(crate) fn span(&self) -> Range<f64> {
        match self.shown_transition() {
            None => 0.0..SEGMENT_LEN as f64,
            Some((_, outcome)) => outcome.saturating_sub(RUN_UP) as f64..(outcome + 1) as f64,
        }
    }

    /// The frame that is seen.
    pub(crate) fn frame(&self) -> usize {
        // What is played stands at its end for a moment; what is held can be anywhere.
        let last = if self.label.is_standing { SEGMENT_LEN } else { self.span().end as usize };
        (self.label.playhead as usize).min(last - 1)
    }

    /// Whether keys and pad drive something now.
    pub(crate) fn is_driving(&self) -> bool {
        match self.panel {
            Panel::Dream => self.dream.is_on,
            Panel::Record => self.record.is_on,
            _ => false,
        }
    }
}
