//! Answers as a table for other programs.

use std::fmt::Write as _;

use serde::Serialize;

use crate::planner::synthesis::Acquisition;
use crate::query::{Label, Preference, Response, SafetyAnswer, SkipReason, Verdict, Weights};
use crate::session::event::Choice;
use crate::session::{AskedQuery, Given, Session};
use crate::text::cell;

/// What each column of the table is called, in order: the fields of a [`LabelRow`].
const COLUMNS: &str = "query,left_dream,left_start,right_dream,right_start,choice,protocol,skipped,left_safe,right_safe,justification,\
preference,mu,secs,loops,annotator,sides_swapped,left_unsafe_from,right_unsafe_from,at,step,verdict,active";

/// An answer that counts: what was said, and what it means.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LabelRow {
    /// The query's number.
    pub query: u32,
    /// The dream of its left clip.
    pub left_dream: u32,
    /// The clip's first step.
    pub left_start: usize,
    /// The dream of its right clip.
    pub right_dream: u32,
    /// The clip's first step.
    pub right_start: usize,
    /// Why this was asked.
    pub choice: String,
    /// Which questions were asked then, by their name in the paper.
    pub protocol: &'static str,
    /// Why it was skipped, or `yes`, if it was.
    pub skipped: Option<&'static str>,
    /// Whether the left clip stays safe, if that was said.
    pub left_safe: Option<bool>,
    /// The same of the right one.
    pub right_safe: Option<bool>,
    /// The justification that was named.
    pub justification: Option<String>,
    /// Which is better, if that was said.
    pub preference: Option<&'static str>,
    /// The probability that left is better. From what was only asked again nothing is learned, and it has none.
    pub mu: Option<f32>,
    /// Seconds that it took.
    pub secs: f32,
    /// How often the clips were seen to their end.
    pub loops: u32,
    /// Who answered.
    pub annotator: String,
    /// Whether left was shown on the right.
    pub sides_swapped: bool,
    /// The step from which the left clip is unsafe, if one was pointed at.
    pub left_unsafe_from: Option<usize>,
    /// The same of the right one.
    pub right_unsafe_from: Option<usize>,
    /// When, in milliseconds since 1970.
    pub at: u64,
    /// The step that was asked about, where it was a single one.
    pub step: Option<usize>,
    /// What was said of it.
    pub verdict: Option<&'static str>,
    /// All justifications that are active, the most severe first, with a bar between two.
    pub active: Option<String>,
}

/// The answers that count, skips among them, in the order of answering, with what they mean by `weights`.
pub fn label_rows(session: &Session, weights: &Weights) -> Vec<LabelRow> {
    let row = |given: &&Given| Some(LabelRow::of(session.query(given.answer.query)?, given, weights));
    session.answers().iter().filter_map(row).collect()
}

/// The same by the session's present weights, as a table.
///
/// One line of names, then one line an answer. Commas between, and names as [`cell`] has them.
pub fn labels_csv(session: &Session) -> String {
    to_csv(&label_rows(session, session.weights()))
}

/// These rows as such a table.
pub fn to_csv(rows: &[LabelRow]) -> String {
    let mut csv = format!("{COLUMNS}\n");
    for row in rows {
        writeln!(csv, "{}", row.to_line()).unwrap_or_else(|_| unreachable!("a string takes all"));
    }
    csv
}

impl LabelRow {
    fn of(asked: &AskedQuery, given: &Given, weights: &Weights) -> Self {
        let &AskedQuery { query, transition, choice, .. } = asked;
        let Given { answer, protocol, at, .. } = given;
        let response = answer.response;
        let safety = response.safety();
        // A query that was asked again is no second label.
        let label = weights.label(&response).filter(|_| asked.repeats().is_none());
        Self {
            query: query.id.0,
            left_dream: query.left.dream.0,
            left_start: query.left.start,
            right_dream: query.right.dream.0,
            right_start: query.right.start,
            choice: why(choice),
            protocol: protocol.name(),
            skipped: skipped(response),
            left_safe: safety.map(|[left, _]| left),
            right_safe: safety.map(|[_, right]| right),
            justification: justification(response, weights),
            preference: preference(response),
            mu: label.map(Label::mu),
            secs: answer.secs,
            loops: answer.loops,
            annotator: answer.annotator.clone(),
            sides_swapped: answer.sides_swapped,
            left_unsafe_from: answer.left_unsafe_from,
            right_unsafe_from: answer.right_unsafe_from,
            at: *at,
            step: transition.map(|transition| transition.step),
            verdict: verdict(response),
            active: active(response, weights),
        }
    }

    fn to_line(&self) -> String {
        fn told<T: ToString>(value: Option<T>) -> String {
            value.map(|value| value.to_string()).unwrap_or_default()
        }
        [
            self.query.to_string(),
            self.left_dream.to_string(),
            self.left_start.to_string(),
            self.right_dream.to_string(),
            self.right_start.to_string(),
            self.choice.clone(),
            self.protocol.to_owned(),
            told(self.skipped),
            told(self.left_safe),
            told(self.right_safe),
            self.justification.as_deref().map(cell).unwrap_or_default(),
            told(self.preference),
            told(self.mu),
            self.secs.to_string(),
            self.loops.to_string(),
            cell(&self.annotator),
            self.sides_swapped.to_string(),
            told(self.left_unsafe_from),
            told(self.right_unsafe_from),
            self.at.to_string(),
            told(self.step),
            told(self.verdict),
            self.active.as_deref().map(cell).unwrap_or_default(),
        ]
        .join(",")
    }
}

fn why(choice: Choice) -> String {
    match choice {
        Choice::Uniform => "uniform".to_owned(),
        Choice::Balanced => "balanced".to_owned(),
        Choice::Disagreement => "disagreement".to_owned(),
        Choice::LeastAnswered => "least_answered".to_owned(),
        Choice::SafetyBoundary => "safety_boundary".to_owned(),
        Choice::Synthesized(acquisition) => made_to_be(acquisition).to_owned(),
        Choice::Repeat(of) => format!("again {}", of.0),
    }
}

fn skipped(response: Response) -> Option<&'static str> {
    let Response::Skipped(reason) = response else { return None };
    Some(match reason {
        None => "yes",
        Some(SkipReason::Hallucinated) => "hallucinated",
        Some(SkipReason::Ambiguous) => "ambiguous",
        Some(SkipReason::Other) => "other",
    })
}

fn justification(response: Response, weights: &Weights) -> Option<String> {
    let Response::Justified(active, _) = response else { return None };
    let named = weights.justifications.iter().find(|(this, ..)| *this == active.most_severe());
    Some(named.map_or("", |(_, name, _)| name).to_owned())
}

/// All that are active, the most severe first, with a bar between two.
fn active(response: Response, weights: &Weights) -> Option<String> {
    let Response::Justified(active, _) = response else { return None };
    let all = weights.justifications.iter().filter(|(this, ..)| active.contains(*this));
    Some(all.map(|(_, name, _)| name).collect::<Vec<_>>().join("|"))
}

fn preference(response: Response) -> Option<&'static str> {
    let (Response::Preferred(preference)
    | Response::Safety(SafetyAnswer::Both(preference))
    | Response::Justified(_, preference)) = response
    else {
        return None;
    };
    Some(match preference {
        Preference::Left => "left",
        Preference::Equal => "equal",
        Preference::Right => "right",
    })
}

fn verdict(response: Response) -> Option<&'static str> {
    let Response::Judged(verdict) = response else { return None };
    Some(match verdict {
        Verdict::Unsafe => "unsafe",
        Verdict::Neutral => "neutral",
        Verdict::Good => "good",
    })
}

/// What a trajectory was made to be.
fn made_to_be(acquisition: Acquisition) -> &'static str {
    match acquisition {
        Acquisition::Uncertainty => "synthesized: uncertainty",
        Acquisition::MaxReward => "synthesized: max_reward",
        Acquisition::MinReward => "synthesized: min_reward",
        Acquisition::Novelty => "synthesized: novelty",
    }
}
