//! How far labeling is against a budget, which can be changed here, and a word about pauses.

use eframe::egui::containers::menu::MenuButton;
use eframe::egui::{Button, CornerRadius, Rect, Role, Sense, Ui, WidgetInfo, vec2};

use crate::app::Budget;
use crate::app::label::BREAK_MINUTES;
use crate::app::{Command, LabelCommand};
use crate::session::Session;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, Tokens};

/// How long the bar is.
const BAR: f32 = 72.0;

/// How far one is, how fast, and how long it will take; a click sets another budget.
pub(in crate::ui) fn progress_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let so_far = state.session().map(Session::statistics).unwrap_or_default();
    let budget = state.budget();
    let button = Button::new(tokens::small(ui, budget.say(&so_far))).frame(false);
    let (menu, _) = MenuButton::from_button(button).ui(ui, |ui| {
        ui.label(tokens::small(ui, "Label so much"));
        for offered in Budget::ALL {
            if ui.selectable_label(offered == budget, offered.name()).clicked() {
                commands.push(Command::Label(LabelCommand::Budget(offered)));
                ui.close();
            }
        }
        ui.separator();
        let most = state.label.break_minutes;
        let mut is_hinting = most > 0;
        if ui.checkbox(&mut is_hinting, format!("Suggest a pause after {BREAK_MINUTES} minutes")).changed() {
            commands.push(Command::Label(LabelCommand::BreakAfter(if is_hinting {
                BREAK_MINUTES
            } else {
                0
            })));
        }
    });
    let skipped =
        format!("{} answered, {} skipped, {} flagged", so_far.n_answered, so_far.n_skipped, so_far.n_flagged);
    menu.on_hover_text(format!(
        "{skipped}.\nTime in which nobody is there does not count.\nClick to label more or less."
    ));
    // In a narrow window what was said last needs the room.
    if ui.available_width() > 2.0 * BAR {
        bar_ui(ui, budget.share(&so_far));
    }
}

/// A short bar.
fn bar_ui(ui: &mut Ui, share: f32) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(BAR, 4.0), Sense::hover());
    response.widget_info(|| {
        WidgetInfo::labeled(Role::ProgressIndicator, true, format!("{:.0} % done", 100.0 * share))
    });
    ui.painter().rect_filled(rect, CornerRadius::same(2), tokens.border);
    let filled = Rect::from_min_size(rect.min, vec2(rect.width() * share, rect.height()));
    let color = if share < 1.0 { tokens.accent } else { tokens.good };
    ui.painter().rect_filled(filled, CornerRadius::same(2), color);
}

/// A hint that a pause would do good, where one would: quiet, and gone once it is put off.
pub(in crate::ui) fn break_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(minutes) = state.label.clock.overdue(state.label.break_minutes) else { return };
    ui.label(tokens::small(ui, format!("{minutes} minutes of labeling: a short pause keeps answers good")));
    let text = tokens::small(ui, "Not now");
    if ui.add(Button::new(text).frame(false)).clicked() {
        commands.push(Command::Label(LabelCommand::PutOffBreak));
    }
}
