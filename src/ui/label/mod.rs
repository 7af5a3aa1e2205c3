//! Two clips, and one key for what a person says about them.

mod annotators;
mod answers;
mod predictions;
mod protocol;
pub(super) mod progress;
mod query_selection;
mod trajectories;

use eframe::egui::{Align, Key, Layout, Rect, RichText, Ui, UiBuilder, pos2, vec2};

use crate::app::label::{NORMAL_SPEED, PREFERENCES, verdict_name};
use crate::app::{Command, GuideCommand, LabelCommand, Panel, SessionCommand, WindowCommand};
use crate::query::{
    Active, Preference, Protocol, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SkipReason, Verdict,
};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::guide;
use crate::ui::input;
use crate::ui::label::progress::progress_ui;
use crate::ui::label::protocol::protocol_ui;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, CONTROL, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, clip_button_ui, picture_ui, timeline_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{dream_shape, heading, with_side, within};
use crate::world::EventKind;

pub(in crate::ui) fn label_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let protocol = state.protocol();
    if protocol == Protocol::Request && state.current().is_none() {
        return trajectories::waiting_ui(ui, state, commands);
    }
    let dreams = state.session().map(|session| session.dreams_for(protocol)).unwrap_or_default();
    if !dreams.iter().any(|(_, len)| *len >= SEGMENT_LEN) {
        heading(ui, "Label", "Here you will compare short clips of your dreams.");
        ui.label("There is nothing to compare yet: dream for a moment, and keep it.");
        ui.add_space(GAP);
        if KeyButton::new("Go and dream").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::Dream)));
        }
        if state.has_example() && state.open.is_none() {
            let is_free =
                !state.guide.is_preparing && state.opening.is_none() && state.world.loaded.is_some();
            let practice = KeyButton::new("Answer twenty questions about an example").enabled(is_free);
            if practice.is_pressed(ui) {
                commands.push(Command::Guide(GuideCommand::Practice));
            }
        }
        ui.add_space(GAP);
        ui.label(tokens::small(ui, "Or judge single steps of trajectories that are made for you"));
        if KeyButton::new("ReQueST").is_pressed(ui) {
            let request = Protocol::Request;
            let has_session = state.open.is_some();
            commands.push(if has_session {
                Command::Label(LabelCommand::ChangeProtocol(request))
            } else {
                Command::Session(SessionCommand::New(request))
            });
        }
        ui.add_space(GAP);
        guide::go_on_ui(ui, state, None, commands);
        guide::clips_to_come_ui(ui, state);
        return;
    }
    if is_list_shown(ui, state) {
        let main = |ui: &mut Ui, commands: &mut Commands| query_ui(ui, state, commands);
        let aside = |ui: &mut Ui, commands: &mut Commands| answers::answers_ui(ui, state, commands);
        with_side(ui, LIST, commands, main, aside);
    } else {
        query_ui(ui, state, commands);
    }
}

/// The width of the list of answers.
const LIST: f32 = 264.0;
/// The height of a row of answers.
const ANSWER: f32 = CONTROL + 8.0;

/// Whether the list of answers is there: where it was asked for, and where it takes nothing from the clips.
fn is_list_shown(ui: &Ui, state: &View<'_>) -> bool {
    let room = ui.available_size();
    let beside = (room.x - LIST - 3.0 * GAP) / 2.0;
    state.label.is_list_open || beside >= 0.95 * (room.y - around(state, room.x)) * dream_shape(state)
}

/// The room that everything but the clips takes from top to bottom, in a panel so wide.
fn around(state: &View<'_>, width: f32) -> f32 {
    let playback = if is_wide(width) { 0.0 } else { PLAYBACK + ROW_GAP };
    let timeline = 16.0 + ROW_GAP;
    let predicted = predictions::height(state).map_or(0.0, |height| height + ROW_GAP);
    HEAD + timeline + predicted + playback + rows(state) as f32 * (ANSWER + ROW_GAP) + CONTROL + ROW_GAP
}

/// The height of the question, and of the line under it.
const HEAD: f32 = 28.0 + 24.0 + 2.0 * ROW_GAP;
/// The height of a row of small buttons.
const PLAYBACK: f32 = 26.0;
/// Justifications that surely fit into a row.
const IN_A_ROW: usize = 6;
/// Between two rows.
const ROW_GAP: f32 = 6.0;

/// Whether one row at the foot holds everything, so that the clips can be higher.
fn is_wide(width: f32) -> bool {
    width >= 960.0
}

/// What is asked now.
fn question(state: &View<'_>) -> &'static str {
    let label = &state.label;
    match state.protocol() {
        Protocol::Drop => "Which clip is better?",
        Protocol::Drope => "Which clip is better, or are they equal?",
        Protocol::Dropj if label.is_guided => match label.guided[..] {
            [] => "Does the left clip stay safe?",
            [_] => "Does the right clip stay safe?",
            _ => "Both are safe. Which is better?",
        },
        Protocol::Dropj => "Which clips stay safe? Where both do, which is better?",
        Protocol::DropjMulti => "What matters most here, and which clip is better?",
        Protocol::Request | Protocol::Dros => "Where does the last step of this clip lead?",
    }
}

fn query_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let label = &state.label;
    let room = ui.available_size();
    // A transition has one clip, in columns wide enough for its answers all the same.
    let is_single = state.protocol().is_sparse();
    let high = (room.y - around(state, room.x)).max(100.0);
    let most = if is_single { room.x } else { ((room.x - GAP) / 2.0).max(100.0) };
    let size = within(vec2(most, high), dream_shape(state));
    let side = size.x;
    let wide = if is_single { side.max(room.x.min(760.0)) } else { 2.0 * side + GAP };
    let left = ui.cursor().left() + (room.x - wide).max(0.0) / 2.0;
    let columns = Rect::from_min_size(pos2(left, ui.cursor().top()), vec2(wide, room.y));
    let shown = label.shown.map(|shown| shown.query);
    let pair = shown.and_then(|id| label.pairs.get(&id));
    let layout = Layout::top_down(Align::Min);
    ui.spacing_mut().item_spacing.y = ROW_GAP;
    ui.scope_builder(UiBuilder::new().max_rect(columns).layout(layout), |ui| {
        head_ui(ui, state, commands);
        let frame = state.frame();
        let [left_rim, right_rim] = rims(state);
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = GAP;
            let empty = "Drawing the clips…";
            let at = |clip: Option<&Vec<_>>| clip.and_then(|clip| clip.get(frame)).cloned();
            let left = at(pair.map(|pair| &pair.left));
            let right = at(pair.map(|pair| &pair.right));
            if is_single {
                ui.add_space((wide - side) / 2.0);
                let is_outcome = state.shown_transition().is_some_and(|(_, outcome)| outcome == frame);
                let rim = if is_outcome { Rim::Accent } else { Rim::Plain };
                picture_ui(ui, left.as_ref(), size, "Clip", empty, rim);
                return;
            }
            picture_ui(ui, left.as_ref(), size, "Left clip", empty, left_rim);
            picture_ui(ui, right.as_ref(), size, "Right clip", empty, right_rim);
        });
        predictions::under_clips_ui(ui, state, if is_single { wide } else { side });
        let width = ui.available_width();
        let outcome = state.shown_transition().map(|(_, outcome)| outcome);
        if let Some(playhead) = timeline_ui(ui, frame, SEGMENT_LEN, width, outcome) {
            commands.push(Command::Label(LabelCommand::ScrubClips(playhead)));
        }
        if !is_wide(room.x) {
            ui.allocate_ui_with_layout(
                vec2(ui.available_width(), PLAYBACK),
                Layout::right_to_left(Align::Center),
                |ui| playback_ui(ui, state, commands),
            );
        }
        answers_ui(ui, state, pair.is_some(), commands);
        if !is_wide(room.x) {
            foot_ui(ui, state, shown, false, commands);
        }
    });
    if is_wide(room.x) {
        foot_ui(ui, state, shown, true, commands);
    }
    keys(ui, state, commands);
}

/// The question, what was said last, and how far one is.
fn head_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let label = &state.label;
    let row = |height| (vec2(ui.available_width(), height), Layout::left_to_right(Align::Center));
    let (asked, told) = (row(28.0), row(24.0));
    ui.allocate_ui_with_layout(asked.0, asked.1, |ui| {
        ui.label(RichText::new(question(state)).size(18.0).color(Tokens::of(ui).text));
        if let Some((transition, _)) = state.shown_transition() {
            let place = format!("transition {} of its trajectory", transition.place() + 1);
            let next = trajectories::in_short(state).map_or_else(String::new, |next| format!(" · {next}"));
            ui.label(tokens::small(ui, place + &next));
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| protocol_ui(ui, state, commands));
    });
    // What was said last stays where the eye is, and its room stays where nothing was said.
    ui.allocate_ui_with_layout(told.0, told.1, |ui| {
        if label.skipped.is_some() {
            reasons_ui(ui, state.protocol(), commands);
        } else {
            let said = label.said.as_deref().unwrap_or(" ");
            let is_early =
                label.early.is_some_and(|early| label.shown.is_some_and(|shown| shown.query == early));
            let is_away = label.shown.is_some() && !label.is_standing && label.clock.is_away(state.now);
            let said = if is_early { EARLY } else { said };
            let said = if is_away { AWAY } else { said };
            ui.label(tokens::muted(ui, said));
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| progress_ui(ui, state, commands));
    });
}

/// What is said while nobody is there.
const AWAY: &str = "The clips wait for you: move the pointer to go on";
/// What is said of an answer that came too early.
const EARLY: &str = "Not taken: this came before the pair could be seen";

/// What moves the clips, from the right to the left.
fn playback_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let label = &state.label;
    ui.spacing_mut().item_spacing.x = 4.0;
    let name = if label.is_standing { "Play" } else { "Pause" };
    let button =
        |ui: &mut Ui, name: &str, key_action: KeyAction, command: Command, commands: &mut Commands| {
            if KeyButton::new(name)
                .key(state.settings.keys.of(key_action))
                .tone(Tone::Quiet)
                .small()
                .show(ui)
                .clicked()
            {
                commands.push(command);
            }
        };
    button(ui, "Faster", KeyAction::Faster, Command::Label(LabelCommand::Faster(true)), commands);
    ui.label(tokens::small(ui, format!("{:.1} ×", label.speed / NORMAL_SPEED)));
    button(ui, "Slower", KeyAction::Slower, Command::Label(LabelCommand::Faster(false)), commands);
    button(ui, "Again", KeyAction::Restart, Command::Label(LabelCommand::RestartClips), commands);
    button(ui, name, KeyAction::PauseClips, Command::Label(LabelCommand::PauseClips), commands);
    clip_button_ui(ui, state, commands);
}

/// How many rows of answers there are.
fn rows(state: &View<'_>) -> usize {
    match state.protocol() {
        Protocol::Dropj if !state.label.is_guided => 2,
        Protocol::DropjMulti => 1 + state.weights().justifications.iter().count().div_ceil(IN_A_ROW),
        _ => 1,
    }
}

/// In the guided questions the clip that is asked about is framed, and what was said stays to be seen.
fn rims(state: &View<'_>) -> [Rim; 2] {
    let label = &state.label;
    if !label.is_guided || state.protocol() != Protocol::Dropj || label.shown.is_none() {
        return [Rim::Plain; 2];
    }
    let said = |is_safe: bool| if is_safe { Rim::Good } else { Rim::Bad };
    match label.guided[..] {
        [] => [Rim::Accent, Rim::Plain],
        [left] => [said(left), Rim::Accent],
        [left, right, ..] => [said(left), said(right)],
    }
}

fn answers_ui(ui: &mut Ui, state: &View<'_>, is_ready: bool, commands: &mut Commands) {
    let key = |key_action| state.settings.keys.of(key_action);
    let preferences = |names: [&'static str; 3], response: &dyn Fn(Preference) -> Response| {
        let keys = [KeyAction::PreferLeft, KeyAction::Equal, KeyAction::PreferRight].map(key);
        let choices = PREFERENCES.into_iter().zip(names).zip(keys);
        choices
            .map(|((preference, name), key)| {
                (name, key, Command::Label(LabelCommand::Answer(response(preference))))
            })
            .collect()
    };
    let label = &state.label;
    let safety = |answer| Command::Label(LabelCommand::Answer(Response::Safety(answer)));
    let plain = ["Left is better", "Equal", "Right is better"];
    match state.protocol() {
        Protocol::Drop => {
            let all: Vec<_> = preferences(plain, &Response::Preferred);
            row(ui, &[all[0].clone(), all[2].clone()], is_ready, commands);
        }
        Protocol::Drope => row(ui, &preferences(plain, &Response::Preferred), is_ready, commands),
        Protocol::Dropj if label.is_guided && label.guided != [true, true] => {
            let yes =
                ("Yes, it stays safe", key(KeyAction::Yes), Command::Label(LabelCommand::AnswerGuided(true)));
            let no = (
                "No, it becomes unsafe",
                key(KeyAction::No),
                Command::Label(LabelCommand::AnswerGuided(false)),
            );
            row(ui, &[yes, no], is_ready, commands);
        }
        Protocol::Dropj => {
            if !label.is_guided {
                let only = [
                    ("Only left is safe", key(KeyAction::OnlyLeft), safety(SafetyAnswer::OnlyLeft)),
                    ("Neither is safe", key(KeyAction::Neither), safety(SafetyAnswer::Neither)),
                    ("Only right is safe", key(KeyAction::OnlyRight), safety(SafetyAnswer::OnlyRight)),
                ];
                row(ui, &only, is_ready, commands);
            }
            let names = ["Both safe, left better", "Both safe, equal", "Both safe, right better"];
            let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
            row(ui, &preferences(names, &both), is_ready, commands);
        }
        Protocol::Request | Protocol::Dros => {
            let names = [EventKind::Safety, EventKind::Progress].map(|kind| verdict_name(&state.spec, kind));
            let names = [names[0].as_str(), "Neither", names[1].as_str()];
            let keys = [KeyAction::PreferLeft, KeyAction::Equal, KeyAction::PreferRight].map(key);
            let verdicts = Verdict::ALL.into_iter().zip(names).zip(keys).map(|((verdict, name), key)| {
                (name, key, Command::Label(LabelCommand::Answer(Response::Judged(verdict))))
            });
            row(ui, &verdicts.collect::<Vec<_>>(), is_ready, commands);
        }
        Protocol::DropjMulti => {
            let active = justifications_ui(ui, state, commands);
            let response = |preference| Response::Justified(active, preference);
            row(ui, &preferences(plain, &response), is_ready, commands);
        }
    }
}

/// Answers side by side, each as wide as the others.
fn row(ui: &mut Ui, choices: &[(&str, Key, Command)], is_ready: bool, commands: &mut Commands) {
    let n = choices.len() as f32;
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        let width = (ui.available_width() - 8.0 * (n - 1.0)) / n;
        for (name, key, command) in choices {
            let button = KeyButton::new(name).key(*key).enabled(is_ready).size(vec2(width, ANSWER));
            if button.is_pressed(ui) {
                commands.push(command.clone());
            }
        }
    });
}

/// The justifications in order of severity, and which are active.
fn justifications_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) -> Active {
    let all = state.weights().justifications;
    let active = state.label.active.unwrap_or(all.default().into());
    let digits =
        [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        // Those after the ninth have no key.
        let keys = digits.into_iter().map(Some).chain(std::iter::repeat(None));
        for ((justification, name, _), key) in all.iter().zip(keys) {
            let tone = if active.contains(justification) { Tone::Chosen } else { Tone::Plain };
            if KeyButton::new(name).key(key).tone(tone).is_pressed(ui) {
                commands.push(Command::Label(LabelCommand::Justify(justification)));
            }
        }
    });
    active
}

/// Skipping, undoing, and why the last one was skipped.
fn foot_ui(
    ui: &mut Ui,
    state: &View<'_>,
    shown: Option<QueryId>,
    has_playback: bool,
    commands: &mut Commands,
) {
    let session = state.session();
    let is_flagged = shown.and_then(|id| session?.query(id)).is_some_and(|asked| asked.is_flagged);
    let is_unsaved = state.open.as_ref().is_some_and(|open| open.n_unsaved > 0);
    let can_undo = is_unsaved
        || !state.label.guided.is_empty()
        || session.is_some_and(|session| session.undoable().is_some());
    let can_redo = session.is_some_and(|session| session.redoable().is_some());
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        let (name, tone) = if is_flagged { ("Flagged", Tone::Chosen) } else { ("Flag", Tone::Quiet) };
        for (name, key_action, tone, is_enabled, command) in [
            (
                "Skip",
                KeyAction::Skip,
                Tone::Quiet,
                shown.is_some(),
                Command::Label(LabelCommand::Answer(Response::Skipped(None))),
            ),
            ("Undo", KeyAction::Undo, Tone::Quiet, can_undo, Command::Label(LabelCommand::Undo)),
            ("Redo", KeyAction::Restore, Tone::Quiet, can_redo, Command::Label(LabelCommand::Redo)),
            (name, KeyAction::Flag, tone, shown.is_some(), Command::Label(LabelCommand::Flag)),
        ] {
            let button = KeyButton::new(name).key(state.settings.keys.of(key_action)).tone(tone);
            if button.small().enabled(is_enabled).is_pressed(ui) {
                commands.push(command);
            }
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            modes_ui(ui, state, commands);
            if has_playback {
                ui.add_space(GAP);
                playback_ui(ui, state, commands);
            }
        });
    });
}

/// How it is asked, and whether the list of answers is there.
fn modes_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let label = &state.label;
    let tone = |is_on| if is_on { Tone::Chosen } else { Tone::Quiet };
    let button = KeyButton::new("Answers")
        .key(state.settings.keys.of(KeyAction::Answers))
        .tone(tone(label.is_list_open));
    if button.small().is_pressed(ui) {
        commands.push(Command::Label(LabelCommand::ToggleAnswers));
    }
    if state.protocol() == Protocol::Dropj {
        let button = KeyButton::new("One question at a time").key(state.settings.keys.of(KeyAction::Guide));
        if button.tone(tone(label.is_guided)).small().is_pressed(ui) {
            commands.push(Command::Label(LabelCommand::Guide(!label.is_guided)));
        }
    }
}

/// Why the last query was skipped, for those who want to say it.
fn reasons_ui(ui: &mut Ui, protocol: Protocol, commands: &mut Commands) {
    ui.spacing_mut().item_spacing.x = 6.0;
    ui.label(tokens::muted(ui, "Skipped, because it was"));
    let reasons = [
        ("hallucinated", Key::Num1, SkipReason::Hallucinated),
        ("ambiguous", Key::Num2, SkipReason::Ambiguous),
        ("something else", Key::Num3, SkipReason::Other),
    ];
    for (name, key, reason) in reasons {
        let button = KeyButton::new(name).small();
        // Where digits name justifications, they do not name reasons.
        let button = if protocol == Protocol::DropjMulti { button } else { button.key(key) };
        if button.is_pressed(ui) {
            commands.push(Command::Label(LabelCommand::ExplainSkip(reason)));
        }
    }
}

/// Keys that have no button of their own.
fn keys(ui: &Ui, state: &View<'_>, commands: &mut Commands) {
    for (key_action, command) in [
        (KeyAction::Restart, Command::Label(LabelCommand::RestartClips)),
        (KeyAction::Forward, Command::Label(LabelCommand::StepClips(1))),
        (KeyAction::Back, Command::Label(LabelCommand::StepClips(-1))),
        (KeyAction::Slower, Command::Label(LabelCommand::Faster(false))),
        (KeyAction::Faster, Command::Label(LabelCommand::Faster(true))),
        (KeyAction::PauseClips, Command::Label(LabelCommand::PauseClips)),
    ] {
        if state.label.shown.is_some() && input::pressed(ui, state.settings.keys.of(key_action)) {
            commands.push(command);
        }
    }
    // What every program does by these.
    if input::chord(ui, Key::Z, false) {
        commands.push(Command::Label(LabelCommand::Undo));
    }
    if input::chord(ui, Key::Z, true) || input::chord(ui, Key::Y, false) {
        commands.push(Command::Label(LabelCommand::Redo));
    }
}
