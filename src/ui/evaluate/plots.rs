//! Distributions and curves of runs.

use eframe::egui::{FontId, Rangef, Role, Stroke, TextStyle, Ui, Vec2b, WidgetInfo};
use egui_plot::{BoxElem, BoxPlot, BoxSpread, Corner, FilledArea, Legend, Line, Plot, PlotPoints, Points};

use crate::experiment::side_by_side::{Part, aside};
use crate::experiment::{Axis, Measure};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::evaluate::runs::{MARKS, color};
use crate::ui::evaluate::saved_heading_ui;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::gauge::capitalized;
use crate::ui::widgets::layout::card;

/// The height of a plot.
const HEIGHT: f32 = 230.0;
/// Two plots stand beside each other where there are so many points.
const WIDE: f32 = 760.0;

/// How episodes are distributed, and beside it what is measured over an axis, where there is one.
pub(super) fn plots_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let has_curves = state.evaluate.shown.over.as_ref().is_some_and(|(_, all)| !all.is_empty());
    if !has_curves {
        return card(ui, |ui| distribution_ui(ui, state, commands));
    }
    if ui.available_width() < WIDE {
        card(ui, |ui| distribution_ui(ui, state, commands));
        return card(ui, |ui| curves_ui(ui, state, commands));
    }
    ui.columns(2, |columns| {
        card(&mut columns[0], |ui| distribution_ui(ui, state, commands));
        card(&mut columns[1], |ui| curves_ui(ui, state, commands));
    });
}

/// Percent where shares are shown.
fn scale(measure: &Measure) -> f64 {
    if measure.is_share() { 100.0 } else { 1.0 }
}

fn named(measure: &Measure) -> String {
    capitalized(&measure.title()) + if measure.is_share() { " (%)" } else { "" }
}

/// A plot that is looked at and not moved.
fn plot<'a>(ui: &Ui, name: &'a str) -> Plot<'a> {
    Plot::new(name)
        .height(HEIGHT)
        .show_background(false)
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_boxed_zoom(false)
        .allow_double_click_reset(false)
        .auto_bounds(Vec2b::TRUE)
        .include_y(0.0)
        .grid_color(Tokens::of(ui).border)
        .grid_spacing(Rangef::new(18.0, 160.0))
}

/// Draws `contents` in small letters.
fn quietly(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    ui.scope(|ui| {
        ui.style_mut().text_styles.insert(TextStyle::Body, FontId::proportional(12.0));
        ui.visuals_mut().override_text_color = Some(Tokens::of(ui).muted);
        contents(ui);
    });
}

fn legend() -> Legend {
    Legend::default().position(Corner::RightTop).background_alpha(0.6).text_style(TextStyle::Small)
}

/// A box for each run, and a mark for each episode.
fn distribution_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let evaluate = &state.evaluate;
    let (measure, shown) = (&evaluate.measure, &evaluate.shown);
    let title = format!("{} of each episode", named(measure));
    saved_heading_ui(ui, &title, ("Save distribution…", Part::Distribution), commands);
    let (scale, faint) = (scale(measure), Tokens::of(ui).muted);
    let all: Vec<_> = shown.groups.iter().zip(&shown.spreads).enumerate().collect();
    let numbers: Vec<usize> = shown.groups.iter().map(|(number, _)| *number).collect();
    let last = all.len() as f64 - 0.5;
    let medians = all
        .iter()
        .map(|(_, ((_, group), spread))| format!("{}: median {}", group.name, measure.shown(spread.median)));
    let said = format!("{title}. {}", medians.collect::<Vec<_>>().join("; "));
    quietly(ui, |ui| {
        let colors: Vec<_> = numbers.iter().map(|number| color(ui, *number)).collect();
        let drawn = plot(ui, "distribution")
            .include_x(-0.5)
            .include_x(last)
            .show_x(false)
            .x_grid_spacer(|_| Vec::new())
            .show_grid([false, true])
            .x_axis_formatter(|_, _| String::new())
            .show(ui, |plot| {
                for (place, ((number, group), spread)) in all {
                    let (x, color) = (place as f64, colors[place]);
                    let [least, most] = spread.ends.map(|value| scale * value);
                    let [lower, upper] = spread.quartiles.map(|value| scale * value);
                    let spread = BoxSpread::new(least, lower, scale * spread.median, upper, most);
                    let element = BoxElem::new(x, spread)
                        .box_width(0.62)
                        .whisker_width(0.3)
                        .fill(color.gamma_multiply(0.18))
                        .stroke(Stroke::new(1.6, color));
                    plot.box_plot(BoxPlot::new(&group.name, vec![element]).allow_hover(false));
                    let points: Vec<[f64; 2]> = group
                        .episodes
                        .iter()
                        .enumerate()
                        .map(|(k, it)| [x + 0.24 * aside(k), scale * it.value])
                        .collect();
                    let points = Points::new(&group.name, PlotPoints::from(points));
                    let mark = MARKS[number % MARKS.len()];
                    plot.points(
                        points.shape(mark).radius(3.0).filled(true).color(color.gamma_multiply(0.85)),
                    );
                }
            });
        drawn.response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &said));
        // Each stands over the number that it has in the table.
        let (rect, transform) = (drawn.response.rect, drawn.transform);
        for (place, number) in numbers.iter().enumerate() {
            let x = transform.position_from_point_x(place as f64);
            let at = eframe::egui::pos2(x, rect.bottom() - 2.0);
            let font = FontId::proportional(12.0);
            ui.painter().text(at, eframe::egui::Align2::CENTER_BOTTOM, number + 1, font, faint);
        }
    });
}

/// What experiments measured over their axis: the mean, its interval, and each seed.
fn curves_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let evaluate = &state.evaluate;
    let (measure, shown) = (&evaluate.measure, &evaluate.shown);
    let Some((axis, all)) = &shown.over else { return };
    let title = format!("{} over {}", named(measure), axis.in_words());
    saved_heading_ui(ui, &title, ("Save curves…", Part::Curves), commands);
    let scale = scale(measure);
    let ends = all.iter().filter_map(|(_, name, points)| {
        Some(format!("{name}: {} at the end", measure.shown(points.last()?.mean[0])))
    });
    let said = format!("{title}. {}", ends.collect::<Vec<_>>().join("; "));
    quietly(ui, |ui| {
        let colors: Vec<_> = all.iter().map(|(number, ..)| color(ui, *number)).collect();
        let drawn = plot(ui, "curves").include_x(0.0).show(ui, |plot| {
            for ((number, name, points), color) in all.iter().zip(colors) {
                let xs: Vec<f64> = points.iter().map(|point| point.x).collect();
                let of = |i: usize| points.iter().map(|point| scale * point.mean[i]).collect::<Vec<_>>();
                let band = FilledArea::new("", &xs, &of(1), &of(2));
                plot.add(band.fill_color(color.gamma_multiply(0.14)).stroke(Stroke::NONE).allow_hover(false));
                let line: Vec<[f64; 2]> = xs.iter().zip(of(0)).map(|(x, y)| [*x, y]).collect();
                plot.line(Line::new(name, PlotPoints::from(line)).color(color).width(1.8));
                let seeds: Vec<[f64; 2]> = points
                    .iter()
                    .flat_map(|point| point.of_seeds.iter().map(|value| [point.x, scale * value]))
                    .collect();
                let seeds = Points::new(name, PlotPoints::from(seeds)).color(color).filled(true);
                plot.points(seeds.shape(MARKS[number % MARKS.len()]).radius(3.0));
            }
        });
        drawn.response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &said));
    });
    let about = match axis {
        Axis::Answers | Axis::Minutes | Axis::CriticalMistakes | Axis::Recorded => {
            "Bands: where the mean over seeds lies, at 95 % (bootstrap); a mark a seed"
        }
        Axis::Variants => "",
    };
    let left_out = match &shown.left_out[..] {
        [] => String::new(),
        names => format!(". Over another axis, and not drawn: {}", names.join(", ")),
    };
    ui.label(tokens::small(ui, format!("{about}{left_out}")));
}

/// Curves of fits.
pub(super) fn losses_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let all = &state.evaluate.shown.losses;
    saved_heading_ui(ui, "Loss over epochs", ("Save losses…", Part::Losses), commands);
    let ends = all.iter().filter_map(|(_, (name, points))| Some(format!("{name}: {:.3}", points.last()?[1])));
    let said = format!("Loss over epochs, at the end. {}", ends.collect::<Vec<_>>().join("; "));
    quietly(ui, |ui| {
        let colors: Vec<_> = all.iter().map(|(number, _)| color(ui, *number)).collect();
        let drawn = plot(ui, "losses").legend(legend()).show(ui, |plot| {
            for ((number, (name, points)), color) in all.iter().zip(colors) {
                plot.line(Line::new(name, PlotPoints::from(points.clone())).color(color).width(1.8));
                let last: Vec<[f64; 2]> = points.last().copied().into_iter().collect();
                let last = Points::new(name, PlotPoints::from(last)).color(color).filled(true);
                plot.points(last.shape(MARKS[number % MARKS.len()]).radius(4.0));
            }
        });
        drawn.response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &said));
    });
}
