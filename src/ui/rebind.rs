//! Changing what keys do.

use crate::env::controls::ControlConfig;
use crate::ui::App;
use crate::ui::command::Command;
use crate::ui::keys::{Keys, Rebinding, Taken};
use crate::ui::pads::Pads;

impl App {
    pub(super) fn act_on_keys(&mut self, command: Command) {
        let state = &mut self.state;
        match command {
            Command::Rebind(slot) => {
                state.rebinding = slot.map(|slot| Rebinding { slot, wanted: None });
            }
            Command::Bind(key) => {
                let Some(rebinding) = &mut state.rebinding else { return };
                rebinding.wanted = state.keys.taken(rebinding.slot, key).map(|taken| (key, taken));
                if rebinding.wanted.is_none() {
                    state.keys.bind(rebinding.slot, key);
                    state.rebinding = None;
                }
            }
            Command::SwapKeys => {
                if let Some(Rebinding { slot, wanted: Some((key, Taken::By(_))) }) = state.rebinding.take() {
                    state.keys.bind(slot, key);
                }
            }
            Command::ResetKeys => {
                (state.keys, state.controls) = (Keys::default(), ControlConfig::paper());
                state.pads_map = Pads::default();
                (state.rebinding, state.rebinding_pad) = (None, None);
            }
            Command::ShowPad(is_shown) => {
                (state.is_pad_shown, state.rebinding, state.rebinding_pad) = (is_shown, None, None);
            }
            Command::RebindPad(deed) => state.rebinding_pad = deed,
            Command::BindPad(deed, button) => {
                state.pads_map.bind(deed, button);
                state.rebinding_pad = None;
            }
            Command::Control(controls) => state.controls = controls.clamped(),
            _ => {}
        }
        self.hands.release();
    }
}
