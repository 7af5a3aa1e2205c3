//! The answers so far, to be looked at and given again, and who gives them.

use eframe::egui::{
    Response, RichText, Role, ScrollArea, Sense, TextStyle, TextWrapMode, Ui, WidgetInfo, WidgetText, pos2,
    vec2,
};

use crate::query::QueryId;
use crate::ui::command::{Command, Field};
use crate::ui::state::State;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::field::field_ui;
use crate::ui::widgets::layout::titled_card;

pub(super) fn answers_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    titled_card(ui, "Who answers", |ui| {
        field_ui(ui, state, Field::Annotator, "A name, kept with every answer", commands);
    });
    titled_card(ui, "Latest answers", |ui| latest_ui(ui, state, commands));
}

fn latest_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    let Some(session) = state.session() else { return };
    let answers = session.answers();
    if answers.is_empty() {
        ui.label(tokens::muted(ui, "None yet."));
        return;
    }
    let weights = session.weights();
    ScrollArea::vertical().id_salt("answers").max_height((ui.available_height() - 20.0).max(200.0)).show(
        ui,
        |ui| {
            ui.spacing_mut().item_spacing.y = 2.0;
            for given in answers.iter().rev().take(50) {
                let answer = &given.answer;
                let is_flagged = session.query(answer.query).is_some_and(|asked| asked.is_flagged);
                let response = answer_ui(ui, answer.query, &weights.say(&answer.response), is_flagged);
                if response.on_hover_text("Answer it again").clicked() {
                    commands.push(Command::Revisit(answer.query));
                }
            }
        },
    );
}

fn answer_ui(ui: &mut Ui, query: QueryId, said: &str, is_flagged: bool) -> Response {
    let tokens = Tokens::of(ui);
    let number = format!("{}", query.0 + 1);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 36.0), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, format!("Query {number}: {said}")));
    if response.hovered() || response.has_focus() {
        ui.painter().rect_filled(rect, 4.0, tokens.hovered);
    }
    let (head, rest) = said.split_once(": ").unwrap_or(("skipped", said));
    let inner = rect.shrink2(vec2(6.0, 2.0));
    let text = format!("{number}  {head}{}", if is_flagged { "  flagged" } else { "" });
    let put = |y: f32, text: RichText| {
        let galley = WidgetText::from(text).into_galley(
            ui,
            Some(TextWrapMode::Truncate),
            inner.width(),
            TextStyle::Small,
        );
        ui.painter().galley(pos2(inner.left(), inner.top() + y), galley, tokens.text);
    };
    put(0.0, RichText::new(text).size(13.0).color(tokens.text));
    put(16.0, RichText::new(rest).size(12.0).color(tokens.muted));
    response
}
