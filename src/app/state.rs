//! What the application knows: whoever shows it reads it, only the application changes it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use crate::app::clips::Clips;
use crate::app::deploy::Deploying;
use crate::app::dream::{Dreaming, Reviewing};
use crate::app::evaluate::Evaluating;
use crate::app::guide::Guide;
use crate::app::label::{Labeling, Moment};
use crate::app::message::Message;
use crate::app::panel::{Field, Panel};
use crate::app::record::{Episodes, Recording};
use crate::app::reward::Rewarding;
use crate::app::scene::Scenes;
use crate::app::session::{Merging, OpenSession, OpenedFolder, Saving, SessionList};
use crate::app::world_model::World;
use crate::evaluation::EpisodeMetrics;
use crate::query::{Protocol, Weights};
use crate::session::{Header, Session, UnfinishedDream};
use crate::world::{SourceKind, WorldSpec};

/// Everything that is shown.
#[derive(Debug, Default)]
pub struct State {
    /// The world that all is about.
    pub(crate) spec: Arc<WorldSpec>,
    /// Its file, where it has one of its own.
    pub(crate) spec_file: Option<PathBuf>,
    /// Seconds since the window opened.
    pub(crate) now: f64,
    /// The picture of the window that is being laid out.
    pub(crate) moment: Moment,
    /// The picture that somebody had seen who asked what is carried out now.
    pub(crate) seen: Moment,
    /// What is shown.
    pub(crate) panel: Panel,
    /// What is typed.
    pub(crate) fields: BTreeMap<Field, String>,
    /// The session, once there is one.
    pub(crate) open: Option<OpenSession>,
    /// The session that is being opened.
    pub(crate) opening: Option<OpenedFolder>,
    /// Sessions that can be opened.
    pub(crate) list: SessionList,
    /// Dreams that a killed program left behind.
    pub(crate) unfinished: Vec<UnfinishedDream>,
    /// What is not saved, and where it is to be saved.
    pub(crate) saving: Saving,
    /// Sessions of several annotators.
    pub(crate) merge: Merging,
    /// What is being done with files, in a few words.
    pub(crate) job: Option<&'static str>,
    /// Whether the list of keys is open.
    pub(crate) help_open: bool,
    /// What was said and not taken away yet.
    pub(crate) messages: Vec<Message>,
    /// What is offered at a first start, and which hints were seen.
    pub(crate) guide: Guide,
    /// What is saved as a clip, or could be.
    pub(crate) clips: Clips,
    /// What the next episode begins with.
    pub(crate) scenes: Scenes,
    pub(crate) world: World,
    pub(crate) record: Recording,
    pub(crate) episodes: Episodes,
    pub(crate) dream: Dreaming,
    pub(crate) label: Labeling,
    pub(crate) reward: Rewarding,
    pub(crate) review: Reviewing,
    pub(crate) deploy: Deploying,
    pub(crate) evaluate: Evaluating,
}

impl State {
    /// The session, if there is one.
    pub fn session(&self) -> Option<&Session> {
        self.open.as_ref().map(|open| &open.session)
    }

    /// The session's head, if there is one.
    pub(crate) fn header(&self) -> Option<&Header> {
        self.open.as_ref().map(|open| &open.header)
    }

    /// The panel that is shown.
    pub fn panel(&self) -> Panel {
        self.panel
    }

    /// The step of the dream that is driven, if one is.
    pub fn dream_step(&self) -> Option<usize> {
        self.dream.live.as_ref().filter(|_| self.dream.is_on).map(|live| live.step)
    }

    /// Episodes that the planner has driven: the seed and the figures.
    pub fn deployed(&self) -> &[(u64, EpisodeMetrics)] {
        &self.deploy.episodes
    }

    /// What was said and not taken away yet.
    pub fn messages(&self) -> &[Message] {
        &self.messages
    }

    /// The questions that are asked.
    pub(crate) fn protocol(&self) -> Protocol {
        self.session().map_or_else(|| Protocol::of(&self.spec), Session::protocol)
    }

    /// What answers weigh.
    pub(crate) fn weights(&self) -> Weights {
        self.session().map_or_else(|| Weights::of(&self.spec), |session| session.weights().clone())
    }

    /// Whether something lies over the panel, so that its keys do nothing, or is shown in its place.
    pub(crate) fn is_covered(&self) -> bool {
        self.has_dialog() || self.guide.is_offering
    }

    /// Whether a dialog lies over everything else.
    pub(crate) fn has_dialog(&self) -> bool {
        self.help_open || self.list.is_open || self.merge.is_open || self.saving.asked.is_some()
    }

    /// What is typed into a field.
    pub(crate) fn field(&self, field: Field) -> &str {
        self.fields.get(&field).map_or("", String::as_str)
    }

    /// The world that all is about.
    pub fn spec(&self) -> Arc<WorldSpec> {
        Arc::clone(&self.spec)
    }

    /// Whether only recordings of the world are there, so that it cannot be acted in.
    pub(crate) fn is_recorded_only(&self) -> bool {
        self.spec.source.kind == SourceKind::Recordings
    }

    /// Whether what keys and pad drive stands still.
    pub(crate) fn is_standing(&self) -> bool {
        let live = if self.panel == Panel::Record { &self.record.live } else { &self.dream.live };
        live.as_ref().is_some_and(|live| live.is_paused)
    }

    /// Whether keys and pad drive something now.
    pub fn is_driving(&self) -> bool {
        match self.panel {
            Panel::Dream => self.dream.is_on,
            Panel::Record => self.record.is_on,
            Panel::World | Panel::Label | Panel::Reward | Panel::Deploy | Panel::Evaluate => false,
        }
    }
}
