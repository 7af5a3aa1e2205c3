//! The answers so far, to be looked at and given again, and who gives them.

use eframe::egui::{
    Rect, Response, RichText, Role, ScrollArea, Sense, TextStyle, TextWrapMode, Ui, WidgetInfo, WidgetText,
    pos2, vec2,
};

use crate::app::{Command, Field, LabelCommand, Picture};
use crate::query::QueryId;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::label::{annotators, predictions, query_selection};
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::clip::{Rim, paint_picture};
use crate::ui::widgets::field::field_ui;
use crate::ui::widgets::layout::{thumbnail_size, titled_card};

/// The height of an answer in the list.
const ROW: f32 = 40.0;
/// The height of a thumbnail.
const THUMBNAIL: f32 = 36.0;

pub(in crate::ui) fn answers_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Who answers", |ui| {
        field_ui(ui, state, Field::Annotator, "A name, kept with every answer", commands);
    });
    query_selection::card_ui(ui, state, commands);
    annotators::card_ui(ui, state, commands);
    titled_card(ui, "Answers", |ui| list_ui(ui, state, commands));
}

/// All answers, the latest first; only those that are seen cost anything.
fn list_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(session) = state.session() else { return };
    let answers = session.answers();
    if answers.is_empty() {
        ui.label(tokens::muted(ui, "None yet."));
        return;
    }
    let weights = session.weights();
    let room = (ui.available_height() - 20.0).max(200.0);
    ui.spacing_mut().item_spacing.y = 2.0;
    let list = ScrollArea::vertical().id_salt("answers").max_height(room);
    list.show_rows(ui, ROW, answers.len(), |ui, rows| {
        let mut unseen = Vec::new();
        for given in rows.filter_map(|row| answers.iter().rev().nth(row)) {
            let answer = &given.answer;
            let is_flagged = session.query(answer.query).is_some_and(|asked| asked.is_flagged);
            let pictures = state.label.thumbnails.get(&answer.query);
            if pictures.is_none() && !state.label.thumbnails_asked.contains(&answer.query) {
                unseen.push(answer.query);
            }
            let said = weights.say(&answer.response);
            let is_here = state.label.revisited == Some(answer.query);
            let response = answer_ui(ui, state, answer.query, &said, is_flagged, is_here, pictures);
            if response.hovered() && state.is_to_be_predicted(answer.query) {
                commands.push(Command::Label(LabelCommand::Predict(answer.query)));
            }
            if response.on_hover_ui(|ui| predictions::hover_ui(ui, state, answer.query, &said)).clicked() {
                commands.push(Command::Label(LabelCommand::Revisit(answer.query)));
            }
        }
        if !unseen.is_empty() {
            commands.push(Command::Label(LabelCommand::LoadThumbnails(unseen)));
        }
    });
}

fn answer_ui(
    ui: &mut Ui,
    state: &View<'_>,
    query: QueryId,
    said: &str,
    is_flagged: bool,
    is_here: bool,
    pictures: Option<&[Picture; 2]>,
) -> Response {
    let tokens = Tokens::of(ui);
    let number = format!("{}", query.0 + 1);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), ROW), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, format!("Query {number}: {said}")));
    if is_here || response.hovered() || response.has_focus() {
        ui.painter().rect_filled(rect, 4.0, tokens.hovered);
    }
    let mut left = rect.left() + 3.0;
    let size = thumbnail_size(state, THUMBNAIL);
    for i in 0..2 {
        let at = Rect::from_min_size(pos2(left, rect.center().y - size.y / 2.0), size);
        paint_picture(ui, pictures.map(|pictures| &pictures[i]), at, "", Rim::Plain);
        left += size.x + 3.0;
    }
    let (head, rest) = said.split_once(": ").unwrap_or(("skipped", said));
    let inner = rect.shrink2(vec2(4.0, 3.0)).with_min_x(left + 5.0);
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
    put(1.0, RichText::new(text).size(13.0).color(tokens.text));
    put(17.0, RichText::new(rest).size(12.0).color(tokens.muted));
    response
}
