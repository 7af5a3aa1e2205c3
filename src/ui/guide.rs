//! How to begin: three cards at a first start, and hints above the status bar.

use eframe::egui::{
    Align, Key, Label, Layout, Rect, RichText, Role, Sense, Ui, UiBuilder, Vec2, WidgetInfo, pos2, vec2,
};

use crate::app::{Command, Field, GuideCommand, Hint, Panel, Picture, SessionCommand, WindowCommand};
use crate::session::N_PRACTICED;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::input;
use crate::ui::rail::short_name;
use crate::ui::settings::keymap::{KeyAction, known_key};
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, paint_picture};
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name};
use crate::ui::widgets::layout::{card, dream_shape, within};
use crate::world::Axis;

/// Cards narrower than this stand under each other.
const NARROWEST: f32 = 190.0;

/// What a card offers.
struct Offer<'a> {
    title: &'a str,
    about: String,
    button: &'a str,
    key: Key,
    is_enabled: bool,
    /// What it looks like: one picture, or two side by side.
    pictures: Vec<Option<&'a Picture>>,
    command: GuideCommand,
}

/// Three ways to begin.
pub(super) fn welcome_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.label(tokens::title("How do you want to begin?"));
    let about =
        "Drive in a dream, compare short clips of it, and a reward is learned that a planner drives by.";
    ui.label(tokens::muted(ui, about));
    ui.add_space(GAP);
    let offers = offers(state);
    let room = ui.available_size();
    let columns = if room.x >= 3.0 * NARROWEST + 2.0 * GAP { offers.len() } else { 1 };
    if columns > 1 {
        let pictures = (room.y - 330.0).clamp(60.0, 240.0);
        ui.columns(columns, |columns| {
            for (column, offer) in columns.iter_mut().zip(&offers) {
                card_ui(column, state, offer, pictures, commands);
            }
        });
    } else {
        eframe::egui::ScrollArea::vertical().id_salt("offers").show(ui, |ui| {
            for offer in &offers {
                card_ui(ui, state, offer, 90.0, commands);
            }
        });
    }
    ui.add_space(GAP);
    go_on_ui(ui, state, Some(Key::Num4), commands);
    ui.horizontal_wrapped(|ui| {
        let close = KeyButton::new("Look around first").key(Key::Escape).tone(Tone::Quiet);
        if close.is_pressed(ui) {
            commands.push(Command::Guide(GuideCommand::Offer(false)));
        }
        ui.label(tokens::small(ui, "“Keys and help” (?) shows these cards and all hints again."));
    });
    // What begins everywhere else begins here, too.
    if input::pressed(ui, state.settings.keys.of(KeyAction::Begin)) && offers[0].is_enabled {
        commands.push(Command::Guide(GuideCommand::Dream));
    }
}

/// The latest session, as long as none is open.
pub(super) fn go_on_ui(ui: &mut Ui, state: &View<'_>, key: Option<Key>, commands: &mut Commands) {
    let Some(latest) = state.list.latest.as_ref().filter(|_| state.open.is_none()) else { return };
    let name = format!("Go on with {}", short_name(&latest.name));
    ui.horizontal_wrapped(|ui| {
        let button = KeyButton::new(&name).key(key).enabled(state.opening.is_none() && !state.dream.is_on);
        if button.is_pressed(ui) {
            commands.push(Command::Guide(GuideCommand::Offer(false)));
            commands.push(Command::Session(SessionCommand::Open(latest.dir.clone())));
        }
        if let Ok(about) = &latest.about {
            ui.label(tokens::small(ui, about.as_str()));
        }
    });
    ui.add_space(4.0);
}

fn offers<'a>(state: &'a View<'_>) -> [Offer<'a>; 3] {
    let world = state.spec.title.as_str();
    let thumbnail = |i: usize| state.dream.thumbnails.get(i).and_then(Option::as_ref);
    let is_loaded = state.world.loaded.as_ref().is_some_and(|world| !world.starts.is_empty());
    let practice = if state.has_example() {
        format!(
            "Two clips at a time: which one stays safe, which one is better? {N_PRACTICED} answers, one key each, and you see what is \
             learned from them."
        )
    } else {
        "There is no example of this world: drive in a dream first.".to_owned()
    };
    let is_preparing = state.guide.is_preparing || state.opening.is_some();
    [
        Offer {
            title: "Drive in a dream now",
            about: format!(
                "The world model imagines {world} while you act. Two short dreams are enough for the first questions."
            ),
            button: if state.world.loading.is_some() { "Reading the world model…" } else { "Drive" },
            key: Key::Num1,
            is_enabled: is_loaded,
            pictures: vec![thumbnail(0)],
            command: GuideCommand::Dream,
        },
        Offer {
            title: "Answer twenty questions",
            about: practice,
            button: if is_preparing { "Preparing…" } else { "Answer" },
            key: Key::Num2,
            is_enabled: is_loaded && state.has_example() && !is_preparing,
            pictures: vec![thumbnail(1), thumbnail(2)],
            command: GuideCommand::Practice,
        },
        Offer {
            title: "Open a world of my own",
            about: "A robot, a Gymnasium environment or recordings: choose its world.toml (“dropj world new” makes one)."
                .to_owned(),
            button: "Choose the file…",
            key: Key::Num3,
            is_enabled: true,
            pictures: vec![state.scene(Field::DeploySeed)],
            command: GuideCommand::OpenWorld,
        },
    ]
}

fn card_ui(ui: &mut Ui, state: &View<'_>, offer: &Offer<'_>, height: f32, commands: &mut Commands) {
    card(ui, |ui| {
        pictures_ui(ui, state, &offer.pictures, height);
        ui.add_space(4.0);
        // Columns would set it flush on both sides.
        ui.scope_builder(UiBuilder::new().layout(Layout::top_down(Align::Min)), |ui| {
            let title = RichText::new(offer.title).size(17.0).color(Tokens::of(ui).text);
            ui.add(Label::new(title).wrap());
            ui.add(Label::new(tokens::muted(ui, offer.about.as_str())).wrap());
        });
        ui.add_space(4.0);
        let tone = if offer.key == Key::Num1 { Tone::Primary } else { Tone::Plain };
        let button = KeyButton::new(offer.button).key(offer.key).tone(tone).enabled(offer.is_enabled);
        if button.wide(ui).is_pressed(ui) {
            commands.push(Command::Guide(offer.command.clone()));
        }
    });
}

/// Pictures side by side in a room of `height` points; nobody has to see them to know what a card offers.
fn pictures_ui(ui: &mut Ui, state: &View<'_>, pictures: &[Option<&Picture>], height: f32) {
    let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::hover());
    ui.painter().rect_filled(rect, 6.0, Tokens::of(ui).stage);
    let n = pictures.len().max(1) as f32;
    let each = vec2((rect.width() - 6.0 * (n - 1.0)) / n, rect.height());
    for (i, picture) in pictures.iter().enumerate() {
        let Some(picture) = picture else { continue };
        let room = Rect::from_min_size(pos2(rect.left() + i as f32 * (each.x + 6.0), rect.top()), each);
        let shape = picture.width as f32 / picture.height.max(1) as f32;
        let size = within(each, if pictures.len() > 1 { dream_shape(state) } else { shape });
        paint_picture(ui, Some(picture), Rect::from_center_size(room.center(), size), "", Rim::Plain);
    }
}

/// What a panel will show, as long as it has nothing: pictures of clips that can be compared.
pub(super) fn clips_to_come_ui(ui: &mut Ui, state: &View<'_>) {
    let room = vec2(ui.available_width().min(620.0), (ui.available_height() - 40.0).clamp(80.0, 300.0));
    let thumbnail = |i: usize| state.dream.thumbnails.get(i).and_then(Option::as_ref);
    ui.allocate_ui(room, |ui| pictures_ui(ui, state, &[thumbnail(0), thumbnail(1)], room.y));
    ui.label(tokens::small(
        ui,
        "So it will look: two clips of what was dreamed, and one key for what you say.",
    ));
}

/// What is learned will be seen like this: a curve that falls, drawn faintly, for it is only an example.
pub(super) fn curves_to_come_ui(ui: &mut Ui) {
    let tokens = Tokens::of(ui);
    let size = vec2(ui.available_width().min(620.0), (ui.available_height() - 40.0).clamp(60.0, 220.0));
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let about = "An example of what will be seen here: the loss falls as answers come in, and more of them are predicted";
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, about));
    ui.painter().rect_filled(rect, 6.0, tokens.stage);
    let inner = rect.shrink(18.0);
    for (k, of) in [|t: f32| 0.9 * (-3.0 * t).exp() + 0.06, |t: f32| 1.0 - 0.55 * (-2.2 * t).exp()]
        .into_iter()
        .enumerate()
    {
        let point = |i: usize| {
            let t = i as f32 / 60.0;
            let wobble = 0.02 * (i as f32 * 1.9).sin() * (1.0 - t);
            pos2(inner.left() + t * inner.width(), inner.bottom() - (of(t) + wobble) * inner.height())
        };
        let points: Vec<_> = (0..=60).map(point).collect();
        let color = tokens.lines[k].gamma_multiply(0.6);
        if k == 0 {
            ui.painter().add(eframe::egui::Shape::line(points, (1.6, color)));
        } else {
            ui.painter().extend(eframe::egui::Shape::dashed_line(&points, (1.6, color), 6.0, 4.0));
        }
    }
    ui.label(tokens::small(
        ui,
        "So it will look: the loss falls as answers come in (line), and more of them are predicted (dashes).",
    ));
}

/// The height of the strip that a hint stands in.
pub(super) const HINT: f32 = 44.0;

/// A hint, what can be done, and a way to be rid of it.
pub(super) fn hint_ui(ui: &mut Ui, state: &View<'_>, hint: Hint, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    let text = text_of(hint, state);
    let height = ui.available_height();
    ui.allocate_ui_with_layout(
        Vec2::new(ui.available_width(), height),
        Layout::right_to_left(Align::Center),
        |ui| {
            ui.spacing_mut().item_spacing.x = 6.0;
            if KeyButton::new("Got it").small().tone(Tone::Quiet).is_pressed(ui) {
                commands.push(Command::Guide(GuideCommand::Understood(hint)));
            }
            if let Some((name, panel)) = way_of(hint)
                && KeyButton::new(name).small().tone(Tone::Primary).is_pressed(ui)
            {
                commands.push(Command::Window(WindowCommand::Show(panel)));
            }
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                let (dot, _) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
                ui.painter().circle_filled(dot.center(), 4.0, tokens.accent);
                let text = tokens::small(ui, text.as_str()).color(tokens.text);
                ui.add(Label::new(text).wrap());
            });
        },
    );
}

/// Where a hint points to.
fn way_of(hint: Hint) -> Option<(&'static str, Panel)> {
    match hint {
        Hint::Again => Some(("Go and label", Panel::Label)),
        Hint::Learned => Some(("Look at Reward", Panel::Reward)),
        Hint::Deploy => Some(("Go and deploy", Panel::Deploy)),
        Hint::Drive | Hint::Answer | Hint::Justify | Hint::GoOn | Hint::Fit | Hint::Futures => None,
    }
}

/// What a hint says, by the keys that there are.
fn text_of(hint: Hint, state: &View<'_>) -> String {
    let key = |key_action| spoken(key_name(state.settings.keys.of(key_action)));
    let n_answered = state.session().map_or(0, |session| session.statistics().n_answered);
    match hint {
        Hint::Drive => format!(
            "Hold {}. Drive well for a while, then badly: both are worth asking about. {} ends the dream and keeps it, {} \
             throws it away.",
            moves(state),
            key(KeyAction::Keep),
            key(KeyAction::Leave)
        ),
        Hint::Again => match state.session().map_or(0, |session| session.dream_lens().len()) {
            0 | 1 => format!(
                "Kept. A second dream ({}) makes the questions more varied. Then compare clips of them: Label, or Ctrl+4.",
                key(KeyAction::Begin)
            ),
            n => format!("{n} dreams are kept. Now compare clips of them: Label, or Ctrl+4."),
        },
        Hint::Answer => answer_of(state, &key),
        Hint::Justify => format!(
            "1 to 9 name what matters most here, if anything does; then {} or {} says which clip is better, {} that they are \
             equal. {} takes an answer back.",
            key(KeyAction::PreferLeft),
            key(KeyAction::PreferRight),
            key(KeyAction::Equal),
            key(KeyAction::Undo)
        ),
        Hint::GoOn => format!(
            "After {N_PRACTICED} answers there is something to see. {} skips what cannot be told or looks broken, {} takes an answer back.",
            key(KeyAction::Skip),
            key(KeyAction::Undo)
        ),
        Hint::Learned => format!(
            "{n_answered} answers: enough to see what is learned from them. Go on if you like, or look at Reward (Ctrl+5)."
        ),
        Hint::Fit => format!(
            "The reward learns along while you answer. {} fits it to all answers from the beginning and keeps it: some seconds.",
            key(KeyAction::Begin)
        ),
        Hint::Deploy => {
            "The reward is fitted and kept. Deploy (Ctrl+6) lets the planner drive by it.".to_owned()
        }
        Hint::Futures if state.deploy.is_on => {
            "Each small picture is where one plan would lead, with what the reward promises of it; the planner does what is framed."
                .to_owned()
        }
        Hint::Futures => format!(
            "{} lets the planner act in this world by what you taught it. It is not a dream any more.",
            key(KeyAction::Begin)
        ),
    }
}

/// What the keys mean at the first query.
fn answer_of(state: &View<'_>, key: &dyn Fn(KeyAction) -> String) -> String {
    use crate::query::Protocol;
    let [left, equal, right] = [KeyAction::PreferLeft, KeyAction::Equal, KeyAction::PreferRight].map(key);
    match state.protocol() {
        Protocol::Dropj => format!(
            "Watch both clips, then press one key. Both stay safe: {left} or {right} for the better one, {equal} if they are equally good. \
             Something unsafe happens: {} if only the left stays safe, {} if only the right, {} if neither does.",
            key(KeyAction::OnlyLeft),
            key(KeyAction::OnlyRight),
            key(KeyAction::Neither)
        ),
        Protocol::Drop => {
            format!("Watch both clips, then press one key: {left} or {right} for the better one.")
        }
        Protocol::Drope | Protocol::DropjMulti => {
            format!(
                "Watch both clips, then press one key: {left} or {right} for the better one, {equal} if they are equal."
            )
        }
        Protocol::Request | Protocol::Dros => {
            format!(
                "Watch the clip to its end, then judge its last step: {left} unsafe, {right} good, {equal} neither."
            )
        }
    }
}

/// `steer: Left, Right; gas: Up`: what moves the first few axes.
fn moves(state: &View<'_>) -> String {
    let keys = &state.settings.keys;
    let of = |axis: &Axis| {
        // The first key of each side.
        let mut sides: Vec<(f32, &str)> = Vec::new();
        for input in &axis.keys {
            let Some(name) = known_key(&input.key) else { continue };
            if !sides.iter().any(|(to, _)| *to == input.to) {
                sides.push((input.to, key_name(keys.of_move(name))));
            }
        }
        let names: Vec<_> = sides.into_iter().map(|(_, name)| name).collect();
        (!names.is_empty()).then(|| format!("{}: {}", axis.name, names.join(", ")))
    };
    let moves: Vec<_> = state.spec.axes.iter().filter_map(of).take(3).collect();
    if moves.is_empty() { "a gamepad's sticks".to_owned() } else { format!("keys ({})", moves.join("; ")) }
}

/// A key as it is called in a sentence.
fn spoken(name: &'static str) -> String {
    match name {
        "Back" => "Backspace".to_owned(),
        "Left" | "Right" | "Up" | "Down" => format!("arrow {}", name.to_lowercase()),
        other => other.to_owned(),
    }
}
