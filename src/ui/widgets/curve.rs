//! Curves over time.

use eframe::egui::{Color32, FontId, Rangef, RichText, Ui, Vec2b};
use egui_plot::{Corner, HLine, Legend, Line, LineStyle, Plot, PlotPoints, Points};

use crate::ui::tokens::{self, Tokens};

/// One line of a plot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Curve<'a> {
    /// What it shows.
    pub name: &'a str,
    /// From left to right.
    pub points: &'a [[f64; 2]],
    /// Its color.
    pub color: Color32,
}

/// Curves under a heading, which explains itself where the pointer rests on it; `level` is drawn as a quiet line to compare with.
///
/// The names stand in the `corner` where the curves are not.
pub(crate) fn curves_ui(
    ui: &mut Ui,
    (heading, about): (&str, &str),
    curves: &[Curve<'_>],
    level: Option<(&str, f64)>,
    corner: Corner,
    height: f32,
) {
    let tokens = Tokens::of(ui);
    ui.horizontal(|ui| ui.label(RichText::new(heading).color(tokens.muted)).on_hover_text(about));
    if curves.iter().all(|curve| curve.points.is_empty()) {
        ui.allocate_ui(eframe::egui::vec2(ui.available_width(), height), |ui| {
            ui.set_min_height(height);
            ui.centered_and_justified(|ui| ui.label(tokens::small(ui, "nothing measured yet")));
        });
        return;
    }
    let legend =
        Legend::default().position(corner).background_alpha(0.0).text_style(eframe::egui::TextStyle::Small);
    let mut plot = Plot::new(heading)
        .height(height)
        .show_background(false)
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_boxed_zoom(false)
        .auto_bounds(Vec2b::TRUE)
        .include_y(0.0)
        .grid_color(tokens.border)
        .grid_spacing(Rangef::new(18.0, 160.0))
        .show_x(false);
    if curves.len() > 1 || level.is_some() {
        plot = plot.legend(legend);
    }
    ui.scope(|ui| {
        ui.style_mut().text_styles.insert(eframe::egui::TextStyle::Body, FontId::proportional(12.0));
        ui.visuals_mut().override_text_color = Some(tokens.muted);
        plot.show(ui, |plot| {
            if let Some((name, y)) = level {
                plot.hline(HLine::new(name, y).color(tokens.faint).width(1.0));
            }
            // Told apart by their shape as well as by their color.
            let styles = [LineStyle::Solid, LineStyle::dashed_loose(), LineStyle::dotted_dense()];
            for (curve, style) in curves.iter().zip(styles.into_iter().cycle()) {
                let points = PlotPoints::from(curve.points.to_vec());
                if curve.points.len() == 1 {
                    // A line of one point is not seen.
                    plot.points(Points::new(curve.name, points).color(curve.color).radius(4.0));
                    continue;
                }
                plot.line(Line::new(curve.name, points).color(curve.color).width(1.8).style(style));
            }
        });
    });
}
