//! A picture of the gamepad, what each of its parts does, and how its sticks feel.

use eframe::egui::{
    Align2, ComboBox, CornerRadius, FontId, Grid, Pos2, Rect, Response, RichText, Role, Sense, Slider,
    Stroke, StrokeKind, Ui, WidgetInfo, pos2, vec2,
};

use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::input::PadButton;
use crate::ui::settings::SettingsCommand;
use crate::ui::settings::gamepad::Place;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::gauge::capitalized;
use crate::ui::widgets::keycap::{KeyButton, Tone, paint_arrow};
use crate::world::Axis;
use crate::world::controls::{AxisControls, ControlConfig, lever_of, levers_for};

/// Where buttons are, on a pad of 300 by 190 points, and how large.
const BUTTONS: [(PadButton, [f32; 2], f32); 12] = [
    (PadButton::LeftShoulder, [66.0, 34.0], 13.0),
    (PadButton::RightShoulder, [234.0, 34.0], 13.0),
    (PadButton::Up, [80.0, 68.0], 9.0),
    (PadButton::Down, [80.0, 104.0], 9.0),
    (PadButton::Left, [62.0, 86.0], 9.0),
    (PadButton::Right, [98.0, 86.0], 9.0),
    (PadButton::Back, [132.0, 78.0], 8.0),
    (PadButton::Start, [168.0, 78.0], 8.0),
    (PadButton::North, [220.0, 66.0], 11.0),
    (PadButton::South, [220.0, 106.0], 11.0),
    (PadButton::West, [200.0, 86.0], 11.0),
    (PadButton::East, [240.0, 86.0], 11.0),
];

/// What a button is called on most pads.
pub(super) fn button_name(button: PadButton) -> &'static str {
    match button {
        PadButton::South => "A",
        PadButton::East => "B",
        PadButton::West => "X",
        PadButton::North => "Y",
        PadButton::LeftShoulder => "L1",
        PadButton::RightShoulder => "R1",
        PadButton::Left => "Left",
        PadButton::Right => "Right",
        PadButton::Up => "Up",
        PadButton::Down => "Down",
        PadButton::Start => "Start",
        PadButton::Back => "Back",
    }
}

pub(in crate::ui) fn pad_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.columns(2, |columns| {
        let ui = &mut columns[0];
        picture_ui(ui, state, commands);
        ui.add_space(GAP);
        feel_ui(ui, state, commands);
        let ui = &mut columns[1];
        for (place, heading) in [
            (Place::Waiting, "Before it begins"),
            (Place::Driving, "In a dream or the real world"),
            (Place::Labeling, "Labeling"),
            (Place::Guided, "One question at a time"),
        ] {
            ui.label(RichText::new(heading).strong().color(Tokens::of(ui).text));
            place_ui(ui, state, place, commands);
            ui.add_space(4.0);
        }
    });
}

/// What is done in a place, each with its button, which a click changes.
fn place_ui(ui: &mut Ui, state: &View<'_>, place: Place, commands: &mut Commands) {
    Grid::new(format!("{place:?}")).num_columns(2).spacing([12.0, 4.0]).min_row_height(22.0).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        for (key_action, _, button) in state.settings.buttons.all().filter(|(_, of, _)| *of == place) {
            let is_waiting = state.settings.rebinding_button == Some(key_action);
            let tone = if is_waiting { Tone::Chosen } else { Tone::Plain };
            let said = format!("{}: {}", key_action.name(), button_name(button));
            let response = KeyButton::new(button_name(button)).tone(tone).small().show(ui);
            response.widget_info(|| WidgetInfo::labeled(Role::Button, true, &said));
            if response.clicked() {
                commands.push(SettingsCommand::RebindButton((!is_waiting).then_some(key_action)));
            }
            ui.label(tokens::muted(ui, key_action.name()));
            ui.end_row();
        }
    });
}

/// The pad itself: what is held lights up, and while a button is awaited any of them can be clicked.
fn picture_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(300.0, 190.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "A gamepad"));
    let stroke = Stroke::new(1.0, tokens.border);
    let at = |[x, y]: [f32; 2]| rect.min + vec2(x, y);
    for x in [26.0, 204.0] {
        let grip = Rect::from_min_size(at([x, 70.0]), vec2(70.0, 112.0));
        ui.painter().rect(grip, CornerRadius::same(34), tokens.raised, stroke, StrokeKind::Inside);
    }
    let body = Rect::from_min_max(at([30.0, 40.0]), at([270.0, 140.0]));
    ui.painter().rect(body, CornerRadius::same(44), tokens.raised, stroke, StrokeKind::Inside);
    let pad = state.settings.pad;
    for (x, value, name) in [(66.0, pad.left_trigger, "L2"), (234.0, pad.right_trigger, "R2")] {
        let bar = Rect::from_center_size(at([x, 13.0]), vec2(54.0, 12.0));
        ui.painter().rect(bar, CornerRadius::same(6), tokens.stage, stroke, StrokeKind::Inside);
        let mut filled = bar;
        filled.set_width(bar.width() * value.clamp(0.0, 1.0));
        ui.painter().rect_filled(filled, CornerRadius::same(6), tokens.accent);
        ui.painter().text(
            bar.center(),
            Align2::CENTER_CENTER,
            name,
            FontId::proportional(10.5),
            tokens.muted,
        );
    }
    for (center, [x, y]) in
        [([112.0, 128.0], [pad.stick, pad.left_y]), ([188.0, 128.0], [pad.right_x, pad.right_y])]
    {
        stick(ui, at(center), [x, y], state.settings.controls.dead_zone);
    }
    for (button, center, radius) in BUTTONS {
        let response = button_ui(ui, state, button, at(center), radius);
        if response.clicked()
            && let Some(key_action) = state.settings.rebinding_button
        {
            commands.push(SettingsCommand::BindButton(key_action, button));
        }
    }
}

/// A stick: where it is, and the zone in which it is dead.
fn stick(ui: &Ui, center: Pos2, [x, y]: [f32; 2], dead_zone: f32) {
    let tokens = Tokens::of(ui);
    let reach = 20.0;
    ui.painter().circle(center, reach, tokens.stage, Stroke::new(1.0, tokens.border));
    ui.painter().circle_stroke(center, reach * dead_zone, Stroke::new(1.0, tokens.warn.gamma_multiply(0.6)));
    let tip = center + vec2(x, -y) * (reach - 6.0);
    ui.painter().circle_filled(tip, 6.0, tokens.accent);
}

fn button_ui(ui: &mut Ui, state: &View<'_>, button: PadButton, center: Pos2, radius: f32) -> Response {
    let tokens = Tokens::of(ui);
    let rect = Rect::from_center_size(center, vec2(2.0 * radius, 2.0 * radius));
    let is_awaited = state.settings.rebinding_button.is_some();
    let sense = if is_awaited { Sense::click() } else { Sense::hover() };
    let response = ui.interact(rect, ui.scope_id().with(button_name(button)), sense);
    let key_actions: Vec<_> = state.settings.buttons.all().filter(|(.., own)| *own == button).collect();
    let said = key_actions.iter().map(|(key_action, ..)| key_action.name()).collect::<Vec<_>>().join(", ");
    let name = format!("Button {}: {}", button_name(button), if said.is_empty() { "nothing" } else { &said });
    response.widget_info(|| WidgetInfo::labeled(Role::Button, is_awaited, &name));
    let is_chosen =
        key_actions.iter().any(|(key_action, ..)| state.settings.rebinding_button == Some(*key_action));
    let is_hot = response.hovered() && is_awaited;
    let (fill, ink) = if is_chosen {
        (tokens.accent, tokens.on_accent)
    } else if is_hot {
        (tokens.hovered, tokens.accent)
    } else {
        (tokens.surface, if key_actions.is_empty() { tokens.faint } else { tokens.text })
    };
    ui.painter().rect(
        rect,
        CornerRadius::same(radius as u8),
        fill,
        Stroke::new(1.0, tokens.border),
        StrokeKind::Inside,
    );
    let along = match button {
        PadButton::Left | PadButton::Back => Some(vec2(-1.0, 0.0)),
        PadButton::Right | PadButton::Start => Some(vec2(1.0, 0.0)),
        PadButton::Up => Some(vec2(0.0, -1.0)),
        PadButton::Down => Some(vec2(0.0, 1.0)),
        _ => None,
    };
    if let Some(along) = along {
        paint_arrow(ui.painter(), center, along, 4.5, ink);
    } else {
        let (name, font) = (button_name(button), FontId::proportional(10.5));
        ui.painter().text(center, Align2::CENTER_CENTER, name, font, ink);
    }
    response.on_hover_text(name)
}

/// Which stick or trigger moves which axis, and how it answers.
fn feel_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let mut controls = state.settings.controls.clone();
    Grid::new("axes").num_columns(2).spacing([12.0, 6.0]).show(ui, |ui| {
        for axis in &state.spec.axes {
            axis_ui(ui, axis, &mut controls);
        }
    });
    ui.spacing_mut().slider_width = 90.0;
    let dead_zone = Slider::new(&mut controls.dead_zone, 0.0..=0.5).fixed_decimals(2).text("dead zone");
    ui.add(dead_zone).on_hover_text("How far a stick or trigger moves before it counts");
    let curve = Slider::new(&mut controls.curve, 1.0..=3.0).fixed_decimals(1).text("curve");
    ui.add(curve).on_hover_text("1 is straight; more is gentler in the middle and the same at the end");
    response_ui(ui, &controls);
    if controls != state.settings.controls {
        commands.push(SettingsCommand::Controls(controls));
    }
}

fn axis_ui(ui: &mut Ui, axis: &Axis, controls: &mut ControlConfig) {
    let label = ui.label(tokens::muted(ui, capitalized(&axis.name)));
    let wanted = controls.of(&axis.name);
    let first = lever_of(axis);
    let unnamed = if axis.pad.is_empty() { "nothing" } else { "as its file says" };
    let name =
        |lever: Option<crate::world::controls::Lever>| lever.or(first).map_or(unnamed, |lever| lever.name());
    let mut chosen = wanted.pad;
    let combo = ComboBox::from_id_salt(&axis.name).selected_text(name(chosen)).width(150.0);
    let combo = combo.show_ui(ui, |ui| {
        if first.is_none() {
            ui.selectable_value(&mut chosen, None, unnamed);
        }
        for &lever in levers_for(axis) {
            let value = Some(lever).filter(|lever| Some(*lever) != first);
            ui.selectable_value(&mut chosen, value, lever.name());
        }
    });
    combo.response.labelled_by(label.id);
    controls.set(&axis.name, AxisControls { pad: chosen, ..wanted });
    ui.end_row();
}

/// What comes out of the stick for what goes in, from left to right.
fn response_ui(ui: &mut Ui, controls: &ControlConfig) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(180.0, 70.0), Sense::hover());
    response.widget_info(|| {
        WidgetInfo::labeled(Role::Image, true, "What the stick gives for how far it is moved")
    });
    let stroke = Stroke::new(1.0, tokens.border);
    ui.painter().rect(rect, CornerRadius::same(4), tokens.stage, stroke, StrokeKind::Inside);
    let inner = rect.shrink(5.0);
    let point = |i: usize| {
        let stick = i as f32 / 30.0 - 1.0;
        let given = controls.beyond(stick);
        pos2(
            inner.left() + f32::midpoint(stick, 1.0) * inner.width(),
            inner.center().y - given / 2.0 * inner.height(),
        )
    };
    let line: Vec<Pos2> = (0..=60).map(point).collect();
    ui.painter().add(eframe::egui::Shape::line(line, Stroke::new(1.6, tokens.accent)));
}

/// What to do with the pad that is shown.
pub(super) fn told(state: &View<'_>) -> String {
    match state.settings.rebinding_button {
        Some(key_action) => {
            format!("Press the new button of “{}”, or click it in the picture.", KeyAction::name(key_action))
        }
        None if state.settings.pads.is_empty() => {
            "No gamepad is plugged in; its buttons can be chosen all the same.".to_owned()
        }
        None => format!("{}: click a button to change it.", state.settings.pads.join(", ")),
    }
}
