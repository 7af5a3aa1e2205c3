//! What the window shows: panels read it, only the app changes it.

use std::collections::BTreeMap;
use std::path::PathBuf;

use eframe::egui::{TextureHandle, ThemePreference};

use crate::dream::DreamEpisode;
use crate::env::controls::{ControlConfig, Pad};
use crate::env::{Action, Frame};
use crate::evaluation::EpisodeMetrics;
use crate::query::{Protocol, Weights};
use crate::session::{DreamJournal, Fit, Header, Session, SessionStore, UnfinishedDream};
use crate::tensor::Parameters;
use crate::ui::beside::Besides;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::elsewhere::Saving;
use crate::ui::errands::Several;
use crate::ui::keys::{Deed, Keys, Rebinding};
use crate::ui::labeling::Labeling;
use crate::ui::opening::BeingOpened;
use crate::ui::pads::Pads;
use crate::ui::recent::RecentSessions;
use crate::ui::review::Reviewing;
use crate::ui::seen::Picture;
use crate::ui::shelf::Shelving;
use crate::worker::{DriveView, Learning, LiveView};
use crate::world_model::fit::{Progress, Stage};
use crate::world_model::{LatentState, ModelIdentity};

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
    /// The picture of the window that is being laid out.
    pub picture: Picture,
    /// The picture with which the key came that is heard now.
    pub heard: Picture,
    /// What is shown.
    pub panel: Panel,
    /// What is typed.
    pub fields: BTreeMap<Field, String>,
    /// The session, once there is one.
    pub store: Option<SessionStore>,
    /// The session that is being opened.
    pub opening: Option<BeingOpened>,
    /// Sessions that can be opened.
    pub recent: RecentSessions,
    /// Dreams that a killed program left behind.
    pub unfinished: Vec<UnfinishedDream>,
    pub sessions_open: bool,
    /// What is not saved, and where it is to be saved.
    pub saving: Saving,
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
    /// The one of them that drives.
    pub pad_in_use: Option<String>,
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
    /// What it is called, also where it was stored in another way.
    pub identity: Option<ModelIdentity>,
    /// The file that is being read.
    pub loading: Option<PathBuf>,
    pub fit: Option<FitState>,
    /// The file of the last fit.
    pub fitted: Option<PathBuf>,
}

impl World {
    /// Whether the session with this head was dreamed with it; of none, nothing is known.
    pub(crate) fn is_of(&self, header: &Header) -> bool {
        self.loaded.is_none() || is_called(self.identity.as_ref(), &self.hash, &header.world_model)
    }
}

/// Whether `named` is the world model whose hash is `hash`, which may have been stored in another way since then.
pub(crate) fn is_called(identity: Option<&ModelIdentity>, hash: &str, named: &str) -> bool {
    hash == named || identity.is_some_and(|identity| identity.is(hash) && identity.is(named))
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
#[expect(clippy::struct_excessive_bools, reason = "each is true or not whatever the others are")]
#[derive(Default)]
pub(crate) struct Recording {
    pub is_on: bool,
    /// Whether the recording has been asked to end and is being sealed.
    pub is_ending: bool,
    /// Whether it stands because it cannot be written.
    pub is_held: bool,
    /// Whether the planner was given the wheel since it began.
    pub is_shared: bool,
    pub live: Option<LiveView>,
    pub picture: Option<TextureHandle>,
    /// Why it was paused, where nobody asked for that.
    pub why_paused: Option<&'static str>,
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
    /// Whether the planner was given the wheel since it began.
    pub is_shared: bool,
    pub start_idx: usize,
    pub live: Option<LiveView>,
    pub picture: Option<TextureHandle>,
    /// What starts look like, in their order.
    pub thumbnails: Vec<Option<TextureHandle>>,
    pub seed: u64,
    /// The one that is being driven, as it began.
    pub begun: Option<DreamEpisode>,
    /// Those that could not be written, each with its journal if that could be.
    pub unsaved: Vec<(DreamEpisode, Option<DreamJournal>)>,
    /// What the hands do now.
    pub action: Action,
    /// Why it was paused, where nobody asked for that.
    pub why_paused: Option<&'static str>,
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
    /// A fit that could not be written.
    pub unsaved: Option<(Parameters, Fit)>,
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
        self.help_open || self.sessions_open || self.several.is_open || self.saving.asked.is_some()
    }

    /// What is typed into a field.
    pub(crate) fn field(&self, field: Field) -> &str {
        self.fields.get(&field).map_or("", String::as_str)
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
