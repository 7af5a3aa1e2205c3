//! The table of runs, and the results that they come from.

use eframe::egui::{Color32, Grid, Label, ScrollArea, Sense, Shape, Stroke, TextEdit, Ui, pos2, vec2};
use egui_plot::MarkerShape;

use crate::app::evaluate::ShownRun;
use crate::app::{Command, EvaluateCommand};
use crate::evaluation::MeanSd;
use crate::experiment::Measure;
use crate::experiment::side_by_side::Part;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::evaluate::{open_ui, saved_heading_ui};
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::keycap::{KeyButton, Tone};

/// Marks in the order of runs: those of saved figures.
pub(super) const MARKS: [MarkerShape; 8] = [
    MarkerShape::Circle,
    MarkerShape::Square,
    MarkerShape::Up,
    MarkerShape::Diamond,
    MarkerShape::Down,
    MarkerShape::Cross,
    MarkerShape::Plus,
    MarkerShape::Asterisk,
];

/// The color of the run with this number.
pub(super) fn color(ui: &Ui, number: usize) -> Color32 {
    let runs = &Tokens::of(ui).runs;
    runs[number % runs.len()]
}

pub(super) fn runs_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let evaluate = &state.evaluate;
    ui.horizontal(|ui| {
        open_ui(ui, state, Tone::Plain, commands);
        if evaluate.shown.runs.len() > 1 {
            let (name, tone) = if evaluate.is_sorted {
                ("Greatest first", Tone::Chosen)
            } else {
                ("In the order of opening", Tone::Quiet)
            };
            if KeyButton::new(name).tone(tone).is_pressed(ui) {
                commands.push(Command::Evaluate(EvaluateCommand::Sort(!evaluate.is_sorted)));
            }
        }
    });
    if !evaluate.shown.runs.is_empty() {
        ui.add_space(2.0);
        saved_heading_ui(
            ui,
            "Mean ± standard deviation over episodes",
            ("Save table…", Part::Table),
            commands,
        );
        ScrollArea::horizontal().id_salt("runs").show(ui, |ui| table_ui(ui, state, commands));
    }
    ui.add_space(4.0);
    for (i, results) in evaluate.results.iter().enumerate() {
        ui.horizontal(|ui| {
            let label = ui.label(tokens::small(ui, format!("Name of results {}", i + 1)));
            let mut name = results.name.clone();
            let edit = TextEdit::singleline(&mut name).desired_width(180.0);
            if ui.add(edit).labelled_by(label.id).changed() {
                commands.push(Command::Evaluate(EvaluateCommand::Rename(results.id, name)));
            }
            let close = format!("Close {}", results.name);
            if KeyButton::new(&close).tone(Tone::Quiet).small().is_pressed(ui) {
                commands.push(Command::Evaluate(EvaluateCommand::Close(results.id)));
            }
            if !results.opened.notes.is_empty() {
                let noted = tokens::small(ui, "not all of it was read").color(Tokens::of(ui).warn);
                ui.label(noted).on_hover_text(results.opened.notes.join("\n"));
            }
            // It ends in … where there is no room: a row that is too long would widen all cards.
            let about = Label::new(tokens::small(ui, results.opened.about.as_str())).truncate();
            ui.add(about).on_hover_text(results.opened.path.display().to_string());
        });
    }
}

fn table_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let evaluate = &state.evaluate;
    let shown = &evaluate.shown;
    Grid::new("runs").num_columns(3 + shown.measures.len()).spacing([18.0, 4.0]).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 22.0;
        ui.label(tokens::small(ui, "Run"));
        ui.label(tokens::small(ui, "Episodes"));
        ui.label(tokens::small(ui, "Seeds"))
            .on_hover_text("Of the whole chain: dreams, answers and the reward");
        for measure in &shown.measures {
            let tone = if *measure == evaluate.measure { Tone::Chosen } else { Tone::Quiet };
            let button = KeyButton::new(&measure.title()).tone(tone).small().show(ui);
            if button.on_hover_text("Show this in the figures and tests below").clicked() {
                commands.push(Command::Evaluate(EvaluateCommand::Measure(measure.clone())));
            }
        }
        ui.end_row();
        for run in &shown.runs {
            row_ui(ui, run, &shown.measures, commands);
            ui.end_row();
        }
    });
}

fn row_ui(ui: &mut Ui, run: &ShownRun, measures: &[Measure], commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.horizontal(|ui| {
        mark_ui(ui, run.number);
        let mut is_shown = !run.is_hidden;
        if ui.checkbox(&mut is_shown, format!("{} {}", run.number + 1, run.name)).changed() {
            let (results, run, is_hidden) = (run.results, run.run, !is_shown);
            commands.push(Command::Evaluate(EvaluateCommand::Hide { results, run, is_hidden }));
        }
    });
    let ink = if run.is_hidden { tokens.faint } else { tokens.text };
    ui.colored_label(ink, run.n_episodes.to_string());
    let seeds = run.n_seeds.map_or("–".to_owned(), |n| n.to_string());
    ui.colored_label(ink, seeds);
    for (measure, cell) in measures.iter().zip(&run.cells) {
        ui.colored_label(ink, cell_of(measure, *cell));
    }
}

/// `812 ± 95`, `3.1 ± 0.2 %`.
pub(super) fn cell_of(measure: &Measure, cell: Option<MeanSd>) -> String {
    let Some(MeanSd { mean, sd, .. }) = cell else { return "–".to_owned() };
    if measure.is_share() {
        format!("{:.1} ± {:.1} %", 100.0 * mean, 100.0 * sd)
    } else {
        format!("{} ± {}", measure.shown(mean), measure.shown(sd))
    }
}

/// The mark of a run, as it is in the figures.
pub(super) fn mark_ui(ui: &mut Ui, number: usize) {
    let (rect, _) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::hover());
    let (center, color, r) = (rect.center(), color(ui, number), 5.0);
    let at = |x: f32, y: f32| pos2(center.x + r * x, center.y + r * y);
    let painter = ui.painter();
    let shape = |points: Vec<_>| {
        painter.add(Shape::convex_polygon(points, color, Stroke::NONE));
    };
    let line = |from, to| {
        painter.line_segment([from, to], Stroke::new(2.0, color));
    };
    match number % MARKS.len() {
        0 => {
            painter.circle_filled(center, r, color);
        }
        1 => shape(vec![at(-0.9, -0.9), at(0.9, -0.9), at(0.9, 0.9), at(-0.9, 0.9)]),
        2 => shape(vec![at(0.0, -1.1), at(1.1, 0.9), at(-1.1, 0.9)]),
        3 => shape(vec![at(0.0, -1.2), at(1.2, 0.0), at(0.0, 1.2), at(-1.2, 0.0)]),
        4 => shape(vec![at(0.0, 1.1), at(1.1, -0.9), at(-1.1, -0.9)]),
        i => {
            if i != 6 {
                line(at(-0.9, -0.9), at(0.9, 0.9));
                line(at(-0.9, 0.9), at(0.9, -0.9));
            }
            if i != 5 {
                line(at(0.0, -1.2), at(0.0, 1.2));
            }
            if i == 6 {
                line(at(-1.2, 0.0), at(1.2, 0.0));
            }
        }
    }
}
