//! The scene of the next episode, before anybody acts in it.

use crate::app::{App, Field, Panel, Picture, State};
use crate::worker::{PreviewerCommand, SceneReport, WorkerCommand};
use crate::world::SourceKind;

/// What the next episode begins with.
#[derive(Debug, Default)]
pub(crate) struct Scenes {
    /// The seed that was asked for last.
    asked: Option<u64>,
    /// The seed that is shown, and its picture.
    shown: Option<(u64, Picture)>,
}

impl State {
    /// What the episode of the seed in `field` begins with, once that is drawn.
    pub(crate) fn scene(&self, field: Field) -> Option<&Picture> {
        let seed: u64 = self.field(field).trim().parse().ok()?;
        self.scenes.shown.as_ref().filter(|(shown, _)| *shown == seed).map(|(_, picture)| picture)
    }
}

impl App {
    /// Has the scene drawn that is to be seen on the panel, if it is not yet.
    ///
    /// Only of worlds that are a part of this program: nobody's robot moves because a panel is looked at.
    pub(super) fn advance_scene(&mut self) {
        let Some(field) = self.seed_shown() else { return };
        if self.state.spec.source.kind != SourceKind::BuiltIn {
            return;
        }
        let Ok(seed) = self.state.field(field).trim().parse() else { return };
        if self.state.scenes.asked != Some(seed) {
            self.state.scenes.asked = Some(seed);
            self.send(WorkerCommand::Previewer(PreviewerCommand::Show(seed)));
        }
    }

    /// Where the seed is typed of the episode whose scene is to be seen, if one is.
    fn seed_shown(&self) -> Option<Field> {
        if self.state.guide.is_offering {
            return Some(Field::DeploySeed);
        }
        match self.state.panel {
            Panel::Record => Some(Field::RecordSeed).filter(|_| !self.state.record.is_on),
            Panel::Deploy => Some(Field::DeploySeed).filter(|_| !self.state.deploy.is_on),
            Panel::World | Panel::Dream | Panel::Label | Panel::Reward | Panel::Evaluate => None,
        }
    }

    pub(super) fn scene_seen(&mut self, report: &SceneReport) {
        self.state.scenes.shown = Some((report.seed, Picture::from(&report.picture)));
    }
}
