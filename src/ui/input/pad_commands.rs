//! What pressing a button of a gamepad comes to, which depends on what is shown.

use crate::app::{Command, DreamCommand, LabelCommand, Panel, RecordCommand, WindowCommand};
use crate::query::{Preference, Protocol, Response, SafetyAnswer, Verdict};
use crate::ui::View;
use crate::ui::input::PadButton;
use crate::ui::settings::gamepad::Place;

/// What a button of a pad means on the panel that is shown.
pub(crate) fn pad_command(state: &View<'_>, button: PadButton) -> Option<Command> {
    let place = match state.panel {
        Panel::Label if state.label.is_guided && state.label.guided != [true, true] => Place::Guided,
        Panel::Label => Place::Labeling,
        _ if state.is_driving() => Place::Driving,
        _ => Place::Waiting,
    };
    // What can be asked in one place is asked in the other too.
    let button = match place {
        Place::Guided if matches!(button, PadButton::East | PadButton::Back) => button,
        place => state.settings.buttons.meant(place, button)?,
    };
    match state.panel {
        Panel::Dream if state.dream.is_on => Some(match button {
            PadButton::North => Command::Dream(DreamCommand::Keep),
            PadButton::West => Command::Dream(DreamCommand::Redo),
            PadButton::South => Command::Dream(DreamCommand::MarkUnsafe),
            PadButton::Start => Command::Dream(DreamCommand::Pause),
            PadButton::Back => Command::Window(WindowCommand::HandOver),
            PadButton::East => Command::Dream(DreamCommand::Leave),
            _ => return None,
        }),
        Panel::Dream => matches!(button, PadButton::Start | PadButton::South)
            .then_some(Command::Dream(DreamCommand::Start)),
        Panel::Record if state.record.is_on => Some(match button {
            PadButton::North => Command::Record(RecordCommand::Keep),
            PadButton::West => Command::Record(RecordCommand::Redo),
            PadButton::Start => Command::Record(RecordCommand::Pause),
            PadButton::Back => Command::Window(WindowCommand::HandOver),
            PadButton::East => Command::Record(RecordCommand::Leave),
            _ => return None,
        }),
        Panel::Record => matches!(button, PadButton::Start | PadButton::South)
            .then_some(Command::Record(RecordCommand::Start)),
        Panel::Label => label_command(state, button),
        _ => None,
    }
}

fn label_command(state: &View<'_>, button: PadButton) -> Option<Command> {
    let preference = match button {
        PadButton::Left => Some(Preference::Left),
        PadButton::Right => Some(Preference::Right),
        PadButton::Up | PadButton::South => Some(Preference::Equal),
        _ => None,
    };
    match button {
        PadButton::East => return Some(Command::Label(LabelCommand::Answer(Response::Skipped(None)))),
        PadButton::Back => return Some(Command::Label(LabelCommand::Undo)),
        _ => {}
    }
    let protocol = state.protocol();
    if protocol == Protocol::Dropj {
        if state.label.is_guided && state.label.guided != [true, true] {
            return match button {
                PadButton::South => Some(Command::Label(LabelCommand::AnswerGuided(true))),
                PadButton::West => Some(Command::Label(LabelCommand::AnswerGuided(false))),
                _ => None,
            };
        }
        let answer = match button {
            PadButton::LeftShoulder => SafetyAnswer::OnlyLeft,
            PadButton::RightShoulder => SafetyAnswer::OnlyRight,
            PadButton::Down => SafetyAnswer::Neither,
            _ => SafetyAnswer::Both(preference?),
        };
        return Some(Command::Label(LabelCommand::Answer(Response::Safety(answer))));
    }
    let response = match protocol {
        Protocol::Request | Protocol::Dros => Response::Judged(match preference? {
            Preference::Left => Verdict::Unsafe,
            Preference::Equal => Verdict::Neutral,
            Preference::Right => Verdict::Good,
        }),
        Protocol::DropjMulti => {
            let default = state.weights().justifications.default();
            Response::Justified(state.label.active.unwrap_or(default.into()), preference?)
        }
        _ => Response::Preferred(preference?),
    };
    Some(Command::Label(LabelCommand::Answer(response))).filter(|_| protocol.permits(&response))
}
