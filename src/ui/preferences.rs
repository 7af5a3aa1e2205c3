//! What a person likes, whatever the session: it outlasts the window.

use eframe::Storage;
use eframe::egui::{Context, ThemePreference};
use serde::{Deserialize, Serialize};

use crate::env::controls::ControlConfig;
use crate::ui::choosing::Asking;
use crate::ui::command::Field;
use crate::ui::keys::Keys;
use crate::ui::labeling::{BREAK_MINUTES, NORMAL_SPEED};
use crate::ui::pace::Budget;
use crate::ui::pads::Pads;
use crate::ui::state::State;

/// The name under which the system keeps it.
const NAME: &str = "preferences";

/// All of it; what an earlier program did not know is as at first.
#[derive(Debug, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Preferences {
    theme: ThemePreference,
    keys: Keys,
    controls: ControlConfig,
    pads: Pads,
    /// Frames a second of clips.
    clip_speed: f64,
    is_guided: bool,
    annotator: String,
    budget: Budget,
    break_minutes: u32,
    asking: Asking,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            theme: ThemePreference::System,
            keys: Keys::default(),
            controls: ControlConfig::paper(),
            pads: Pads::default(),
            clip_speed: NORMAL_SPEED,
            is_guided: false,
            annotator: String::new(),
            budget: Budget::default(),
            break_minutes: BREAK_MINUTES,
            asking: Asking::default(),
        }
    }
}

impl Preferences {
    /// What was kept in `storage`, or what there is at first.
    pub(crate) fn load(storage: Option<&dyn Storage>) -> Self {
        storage.and_then(|storage| eframe::get_value(storage, NAME)).unwrap_or_default()
    }

    /// What `state` shows of it.
    pub(crate) fn of(state: &State) -> Self {
        Self {
            theme: state.theme,
            keys: state.keys.clone(),
            controls: state.controls,
            pads: state.pads_map.clone(),
            clip_speed: state.label.speed,
            is_guided: state.label.is_guided,
            annotator: state.field(Field::Annotator).to_owned(),
            budget: state.label.budget,
            break_minutes: state.label.break_minutes,
            asking: state.label.asking,
        }
    }

    /// Brings it into `state`.
    pub(crate) fn apply(self, ctx: &Context, state: &mut State) {
        ctx.set_theme(self.theme);
        (state.theme, state.keys, state.controls) = (self.theme, self.keys, self.controls.clamped());
        state.pads_map = self.pads;
        (state.label.speed, state.label.is_guided) = (self.clip_speed.clamp(5.0, 100.0), self.is_guided);
        (state.label.budget, state.label.break_minutes) = (self.budget, self.break_minutes);
        state.label.asking = self.asking.clamped();
        state.fields.insert(Field::Annotator, self.annotator);
    }

    /// Keeps it in `storage`.
    pub(crate) fn save(&self, storage: &mut dyn Storage) {
        eframe::set_value(storage, NAME, self);
    }
}
