//! The path of the work, and how far it is.

use std::sync::Arc;

use eframe::egui::text::{LayoutJob, TextWrapping};
use eframe::egui::{
    Align, Align2, Color32, CornerRadius, FontId, Galley, Key, Layout, Modifiers, Pos2, Role, Sense, Shape,
    Stroke, Ui, WidgetInfo, pos2, vec2,
};

use crate::app::counted;
use crate::app::evaluate::n_open;
use crate::app::{Command, Panel, SessionCommand, WindowCommand};
use crate::query::Protocol;
use crate::text::shown;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, SMALL_CORNER, Tokens};

/// How far a step is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    /// Something is needed before.
    Waiting,
    /// It can be done now.
    Ready,
    /// It is being done.
    Running,
    /// It has been done, at least once.
    Done,
}

pub(super) fn rail_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.add_space(2.0);
    ui.horizontal(|ui| {
        ui.add_space(10.0);
        ui.label(tokens::title("dropj").strong());
    });
    ui.add_space(18.0);
    ui.spacing_mut().item_spacing.y = 4.0;
    let keys = [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7];
    for (i, (panel, key)) in Panel::ALL.into_iter().zip(keys).enumerate() {
        let (progress, about) = step(state, panel);
        let share = share(state, panel);
        let is_chosen = state.panel == panel;
        let is_last = i + 1 == Panel::ALL.len();
        if step_ui(ui, i + 1, (panel.name(), &about), (progress, share), is_chosen, is_last)
            || ui.input_mut(|input| input.consume_key(Modifiers::COMMAND, key))
        {
            commands.push(Command::Window(WindowCommand::Show(panel)));
        }
    }
    ui.with_layout(Layout::bottom_up(Align::Min), |ui| session_ui(ui, state, commands));
}

/// How far `panel` is, and its figure.
fn step(state: &View<'_>, panel: Panel) -> (Progress, String) {
    let session = state.session();
    let n_dreams = session.map_or(0, |session| session.dream_lens().len());
    let n_askable = session.map_or(0, |session| session.dreams_for(session.protocol()).len());
    let is_request = state.protocol() == Protocol::Request;
    let n_answered = session.map_or(0, |session| session.statistics().n_answered);
    let when = |is_done, about: String| (if is_done { Progress::Done } else { Progress::Ready }, about);
    let waiting = |about: &str| (Progress::Waiting, about.to_owned());
    match panel {
        Panel::Record if state.record.is_on => (Progress::Running, "recording".to_owned()),
        Panel::Record => match state.n_recorded() {
            0 => (Progress::Ready, "if you like".to_owned()),
            n => (Progress::Done, counted(n, "episode")),
        },
        Panel::World if state.world.fit.is_some() => (Progress::Running, "fitting".to_owned()),
        Panel::World if state.world.loading.is_some() => (Progress::Running, "being read".to_owned()),
        Panel::World => match &state.world.loaded {
            Some(world) => (Progress::Done, world.name.clone()),
            None => (Progress::Ready, "none loaded".to_owned()),
        },
        Panel::Dream if state.dream.is_on => {
            let is_paused = state.dream.live.as_ref().is_some_and(|live| live.is_paused);
            (Progress::Running, if is_paused { "paused" } else { "dreaming" }.to_owned())
        }
        Panel::Dream if state.world.loaded.is_none() && state.world.loading.is_none() => {
            waiting("needs a world model")
        }
        Panel::Dream if n_dreams == 0 => (Progress::Ready, "begin one".to_owned()),
        Panel::Dream => when(true, format!("{n_dreams} kept")),
        Panel::Label if is_making(state) => (Progress::Running, "making a trajectory".to_owned()),
        Panel::Label if !is_request && n_askable == 0 => waiting("needs dreams"),
        Panel::Label if n_answered == 0 => (Progress::Ready, "answer queries".to_owned()),
        Panel::Label => when(true, counted(n_answered, "answer")),
        Panel::Reward if state.reward.is_fitting => (Progress::Running, "fitting".to_owned()),
        Panel::Reward if state.reward.is_relearning => (Progress::Running, "learning anew".to_owned()),
        Panel::Reward if n_answered == 0 => waiting("needs answers"),
        Panel::Reward => when(state.reward.parameters.is_some(), learned(state)),
        Panel::Deploy if state.deploy.is_on => (Progress::Running, "acting".to_owned()),
        Panel::Deploy if state.reward.parameters.is_none() => waiting("needs a reward"),
        Panel::Deploy => match state.deploy.episodes.len() {
            0 => (Progress::Ready, "let it act".to_owned()),
            n => (Progress::Done, counted(n, "episode")),
        },
        Panel::Evaluate if state.evaluate.n_reading > 0 => (Progress::Running, n_open(state)),
        Panel::Evaluate => when(!state.evaluate.results.is_empty(), n_open(state)),
    }
}

/// How much of what is being done on `panel` is done, where that is known.
fn share(state: &View<'_>, panel: Panel) -> Option<f32> {
    let of = |done: usize, all: usize| done as f32 / all.max(1) as f32;
    match panel {
        Panel::Record if state.record.is_on => {
            Some(of(state.record.live.as_ref()?.step, state.spec.longest_episode))
        }
        Panel::World => {
            let progress = state.world.fit.as_ref()?.progress.as_ref()?;
            Some(of(progress.epoch * progress.n + progress.done, progress.max_epochs * progress.n))
        }
        Panel::Dream if state.dream.is_on => {
            Some(of(state.dream.live.as_ref()?.step, state.spec.longest_episode))
        }
        Panel::Label => state.label.synthesis.ordered.as_ref().map(|ordered| ordered.share),
        Panel::Reward if state.reward.is_fitting => {
            let latest = state.reward.latest.as_ref()?;
            Some(of(latest.epoch, latest.fit_epochs?))
        }
        Panel::Deploy if state.deploy.is_on => {
            Some(of(state.deploy.view.as_ref()?.step, state.spec.longest_episode))
        }
        _ => None,
    }
}

/// Whether labeling waits for a trajectory.
fn is_making(state: &View<'_>) -> bool {
    state.label.synthesis.ordered.is_some() && state.current().is_none()
}

fn learned(state: &View<'_>) -> String {
    let n_labels = state.session().map_or(0, |session| session.labeled().len());
    match state.reward.n_learned {
        0 => "learning".to_owned(),
        // Some were taken back, and the next report is without them.
        n if n > n_labels => format!("forgetting {}", counted(n - n_labels, "answer")),
        n => format!("knows {}", counted(n, "answer")),
    }
}

fn step_ui(
    ui: &mut Ui,
    number: usize,
    (name, about): (&str, &str),
    (progress, share): (Progress, Option<f32>),
    is_chosen: bool,
    is_last: bool,
) -> bool {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 50.0), Sense::click());
    response.widget_info(|| WidgetInfo::selected(Role::Tab, true, is_chosen, name));
    let response = response.on_hover_text(format!("Ctrl+{number}"));
    let painter = ui.painter();
    if is_chosen {
        painter.rect_filled(rect, SMALL_CORNER, tokens.here);
    } else if response.hovered() || response.has_focus() {
        painter.rect_filled(rect, SMALL_CORNER, tokens.here.gamma_multiply(0.5));
    }
    let center = pos2(rect.left() + 24.0, rect.center().y);
    if !is_last {
        let to_next = (center.y + 15.0)..=(center.y + 50.0 + 4.0 - 15.0);
        painter.vline(center.x, to_next, Stroke::new(1.0, tokens.border));
    }
    dot(ui, center, number, progress);
    if let Some(share) = share.filter(|_| progress == Progress::Running) {
        arc(ui, center, share);
    }
    let left = rect.left() + 46.0;
    let ink = if progress == Progress::Waiting && !is_chosen { tokens.muted } else { tokens.text };
    painter.text(pos2(left, center.y - 8.0), Align2::LEFT_CENTER, name, FontId::proportional(14.5), ink);
    let font = FontId::proportional(12.5);
    let ink = if progress == Progress::Running { tokens.accent } else { tokens.faint };
    let galley = one_line(ui, about, font, ink, rect.right() - 6.0 - left);
    ui.painter().galley(pos2(left, center.y + 1.0), galley, ink);
    response.clicked()
}

/// `text` in a line that ends in … where it does not fit into `width`.
fn one_line(ui: &Ui, text: &str, font: FontId, ink: Color32, width: f32) -> Arc<Galley> {
    let mut job = LayoutJob::simple_singleline(text.to_owned(), font, ink);
    job.wrap = TextWrapping::truncate_at_width(width);
    ui.painter().layout_job(job)
}

/// How much of a step is done, around its number.
fn arc(ui: &Ui, center: Pos2, share: f32) {
    let tokens = Tokens::of(ui);
    let point = |i: u32| {
        let angle = share.clamp(0.0, 1.0) * std::f32::consts::TAU * i as f32 / 40.0;
        center + vec2(angle.sin(), -angle.cos()) * 14.5
    };
    ui.painter().circle_stroke(center, 14.5, Stroke::new(2.0, tokens.border));
    ui.painter().add(Shape::line((0..=40).map(point).collect(), Stroke::new(2.0, tokens.accent)));
}

/// A step's number in a ring: empty, filled, or a check mark.
fn dot(ui: &Ui, center: Pos2, number: usize, progress: Progress) {
    let tokens = Tokens::of(ui);
    let painter = ui.painter();
    let (fill, ring, ink) = match progress {
        Progress::Waiting => (Color32::TRANSPARENT, tokens.border, tokens.faint),
        Progress::Ready => (Color32::TRANSPARENT, tokens.accent, tokens.accent),
        Progress::Running => (tokens.accent, tokens.accent, tokens.on_accent),
        Progress::Done => (tokens.good.gamma_multiply(0.18), tokens.good, tokens.good),
    };
    painter.circle(center, 11.0, fill, Stroke::new(1.3, ring));
    if progress == Progress::Done {
        let at = |x: f32, y: f32| center + vec2(x, y);
        painter.line_segment([at(-4.0, 0.3), at(-1.2, 3.2)], Stroke::new(1.8, ink));
        painter.line_segment([at(-1.2, 3.2), at(4.3, -3.2)], Stroke::new(1.8, ink));
    } else {
        painter.text(center, Align2::CENTER_CENTER, number, FontId::proportional(12.0), ink);
    }
}

/// The session at the foot of the rail.
fn session_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 54.0), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, "Sessions…"));
    let is_hot = response.hovered() || response.has_focus();
    let fill = if is_hot { tokens.hovered } else { tokens.here };
    ui.painter().rect_filled(rect, CornerRadius::same(8), fill);
    let (name, about) = match (&state.opening, &state.open) {
        (Some(opening), _) => (short_name(&opening.name()), format!("opening: {}", opening.progress())),
        (None, Some(open)) => {
            let name = open.dir.file_name().map(|name| shown(&name.to_string_lossy()));
            (short_name(&name.unwrap_or_default()), format!("{} session", state.protocol().name()))
        }
        _ => ("No session yet".to_owned(), "the first dream begins one".to_owned()),
    };
    let text = |y: f32, text: String, size: f32, ink| {
        let galley = one_line(ui, &text, FontId::proportional(size), ink, rect.width() - 24.0);
        ui.painter().galley(pos2(rect.left() + 12.0, rect.top() + y), galley, ink);
    };
    text(9.0, name, 13.5, tokens.text);
    text(29.0, about, 12.5, tokens.faint);
    if response.clicked() {
        commands.push(Command::Session(SessionCommand::ToggleList));
    }
}

/// `2026-11-22 10:15` of `2026-11-22T10-15-00-dropj`; any other name as it is.
pub(super) fn short_name(folder: &str) -> String {
    let is_ours = folder.len() > 19 && folder.is_char_boundary(19) && folder.as_bytes()[10] == b'T';
    if is_ours {
        format!("{} {}", &folder[..10], folder[11..16].replace('-', ":"))
    } else {
        folder.to_owned()
    }
}
