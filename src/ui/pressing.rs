//! What pressing a button of a gamepad comes to, which depends on what is shown.

use crate::query::{Preference, Protocol, Response, SafetyAnswer, Verdict};
use crate::ui::command::{Command, Panel};
use crate::ui::input::PadButton;
use crate::ui::pads::Place;
use crate::ui::state::State;

/// What a button of a pad means on the panel that is shown.
pub(super) fn pad_command(state: &State, button: PadButton) -> Option<Command> {
    let place = match state.panel {
        Panel::Label if state.label.is_guided && state.label.guided != [true, true] => Place::Guided,
        Panel::Label => Place::Labeling,
        _ if state.is_driving() => Place::Driving,
        _ => Place::Waiting,
    };
    // What can be asked in one place is asked in the other too.
    let button = match place {
        Place::Guided if matches!(button, PadButton::East | PadButton::Back) => button,
        place => state.pads_map.meant(place, button)?,
    };
    match state.panel {
        Panel::Dream if state.dream.is_on => Some(match button {
            PadButton::North => Command::KeepDream,
            PadButton::West => Command::RedoDream,
            PadButton::South => Command::MarkUnsafe,
            PadButton::Start => Command::PauseDream,
            PadButton::Back => Command::HandOver,
            PadButton::East => Command::LeaveDream,
            _ => return None,
        }),
        Panel::Dream => matches!(button, PadButton::Start | PadButton::South).then_some(Command::StartDream),
        Panel::Record if state.record.is_on => Some(match button {
            PadButton::North => Command::KeepRecording,
            PadButton::West => Command::RedoRecording,
            PadButton::Start => Command::PauseRecording,
            PadButton::Back => Command::HandOver,
            PadButton::East => Command::LeaveRecording,
            _ => return None,
        }),
        Panel::Record => {
            matches!(button, PadButton::Start | PadButton::South).then_some(Command::StartRecording)
        }
        Panel::Label => label_command(state, button),
        _ => None,
    }
}

fn label_command(state: &State, button: PadButton) -> Option<Command> {
    let preference = match button {
        PadButton::Left => Some(Preference::Left),
        PadButton::Right => Some(Preference::Right),
        PadButton::Up | PadButton::South => Some(Preference::Equal),
        _ => None,
    };
    match button {
        PadButton::East => return Some(Command::Answer(Response::Skipped(None))),
        PadButton::Back => return Some(Command::Undo),
        _ => {}
    }
    let protocol = state.protocol();
    if protocol == Protocol::Dropj {
        if state.label.is_guided && state.label.guided != [true, true] {
            return match button {
                PadButton::South => Some(Command::GuidedSafe(true)),
                PadButton::West => Some(Command::GuidedSafe(false)),
                _ => None,
            };
        }
        let answer = match button {
            PadButton::LeftShoulder => SafetyAnswer::OnlyLeft,
            PadButton::RightShoulder => SafetyAnswer::OnlyRight,
            PadButton::Down => SafetyAnswer::Neither,
            _ => SafetyAnswer::Both(preference?),
        };
        return Some(Command::Answer(Response::Safety(answer)));
    }
    let response = match protocol {
        Protocol::Request | Protocol::Dros => Response::Judged(match preference? {
            Preference::Left => Verdict::Unsafe,
            Preference::Equal => Verdict::Neutral,
            Preference::Right => Verdict::Good,
        }),
        Protocol::DropjMulti => {
            let justification = state.label.justification.unwrap_or(state.weights().justifications.default());
            Response::Justified(justification, preference?)
        }
        _ => Response::Preferred(preference?),
    };
    Some(Command::Answer(response)).filter(|_| protocol.permits(&response))
}
