//! What a person likes about the window itself: its colors, and what keys and pads do.

pub(crate) mod gamepad;
pub(crate) mod gamepad_ui;
pub(crate) mod help;
pub(crate) mod keymap;
pub(crate) mod preferences;
mod ron;

use eframe::egui::{Context, Key, ThemePreference};

use crate::ui::input::PadButton;
use crate::ui::settings::gamepad::Buttons;
use crate::ui::settings::keymap::{KeyAction, Keys, Rebinding, Slot, Taken};
use crate::world::WorldSpec;
use crate::world::controls::{ControlConfig, Pad};

/// On what the window looks like and what keys and pads do.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum SettingsCommand {
    /// Chooses light, dark or what the system says.
    Theme(ThemePreference),
    /// Waits for the key that one of the keys of an action becomes, or no longer.
    Rebind(Option<Slot>),
    /// Makes it this key, if nobody else has it.
    Bind(Key),
    /// Makes it the key that somebody else has, who gets this one's.
    SwapKeys,
    /// Shows the gamepad in the list of keys, or the keys again.
    ShowGamepad(bool),
    /// Waits for the button of a pad that does this, or no longer.
    RebindButton(Option<KeyAction>),
    /// Makes it this button; whoever had it gets the one before.
    BindButton(KeyAction, PadButton),
    /// Gives all keys back what they did at first, and the controls what they gave.
    Reset,
    /// Changes how much keys give, and where a pad begins to.
    Controls(ControlConfig),
}

/// What a person likes about the window, and what is plugged into it.
#[derive(Debug)]
pub(crate) struct Settings {
    pub theme: ThemePreference,
    /// Which keys do what.
    pub keys: Keys,
    /// The key that is being changed.
    pub rebinding: Option<Rebinding>,
    /// Which buttons of a pad do what.
    pub buttons: Buttons,
    /// What the button that is pressed next will do.
    pub rebinding_button: Option<KeyAction>,
    /// Where the sticks and triggers are.
    pub pad: Pad,
    /// Whether the list of keys shows the gamepad.
    pub is_gamepad_shown: bool,
    /// How much keys give, and where a pad begins to.
    pub controls: ControlConfig,
    /// Who draws the window.
    pub adapter: String,
    /// The pads that are plugged in.
    pub pads: Vec<String>,
    /// The one of them that drives.
    pub pad_in_use: Option<String>,
}

impl Settings {
    /// As they are at first for this world, in a window that is drawn by `adapter`.
    pub(crate) fn new(spec: &WorldSpec, adapter: String) -> Self {
        Self {
            theme: ThemePreference::default(),
            keys: Keys::of_world(spec),
            rebinding: None,
            buttons: Buttons::default(),
            rebinding_button: None,
            pad: Pad::default(),
            is_gamepad_shown: false,
            controls: ControlConfig::default(),
            adapter,
            pads: Vec::new(),
            pad_in_use: None,
        }
    }

    /// Carries out what was asked; whether all that is held is to be let go.
    pub(crate) fn command(&mut self, ctx: &Context, spec: &WorldSpec, command: SettingsCommand) -> bool {
        match command {
            SettingsCommand::Theme(theme) => {
                self.theme = theme;
                ctx.set_theme(theme);
                return false;
            }
            SettingsCommand::Rebind(slot) => {
                self.rebinding = slot.map(|slot| Rebinding { slot, wanted: None });
            }
            SettingsCommand::Bind(key) => self.bind(key),
            SettingsCommand::SwapKeys => {
                if let Some(Rebinding { slot, wanted: Some((key, Taken::By(_))) }) = self.rebinding.take() {
                    self.keys.bind(slot, key);
                }
            }
            SettingsCommand::Reset => {
                (self.keys, self.controls) = (Keys::of_world(spec), ControlConfig::default());
                self.buttons = Buttons::default();
                self.stop_rebinding();
            }
            SettingsCommand::ShowGamepad(is_shown) => {
                self.is_gamepad_shown = is_shown;
                self.stop_rebinding();
            }
            SettingsCommand::RebindButton(key_action) => self.rebinding_button = key_action,
            SettingsCommand::BindButton(key_action, button) => {
                self.buttons.bind(key_action, button);
                self.rebinding_button = None;
            }
            SettingsCommand::Controls(controls) => self.controls = controls.clamped(),
        }
        true
    }

    /// No key or button is waited for any longer.
    pub(crate) fn stop_rebinding(&mut self) {
        (self.rebinding, self.rebinding_button) = (None, None);
    }

    fn bind(&mut self, key: Key) {
        let Some(rebinding) = &mut self.rebinding else { return };
        rebinding.wanted = self.keys.taken(rebinding.slot, key).map(|taken| (key, taken));
        if rebinding.wanted.is_none() {
            self.keys.bind(rebinding.slot, key);
            self.rebinding = None;
        }
    }
}
