//! Answers as a table for other programs.

use std::fmt::Write as _;

use crate::planner::synthesis::Acquisition;
use crate::query::{Preference, Response, SafetyAnswer, SkipReason, Verdict, Weights};
use crate::session::event::Choice;
use crate::session::{AskedQuery, Given, Session};
use crate::text::cell;

/// The answers that count, skips among them, in the order of answering: what was said, and μ by the present weights.
///
/// From what was only asked again nothing is learned, and it has no μ.
///
/// One line of names, then one line an answer. Commas between, and names as [`cell`] has them.
pub fn labels_csv(session: &Session) -> String {
    let mut csv = String::from(
        "query,left_dream,left_start,right_dream,right_start,choice,protocol,skipped,left_safe,right_safe,justification,\
         preference,mu,secs,loops,annotator,sides_swapped,left_unsafe_from,right_unsafe_from,at,\
         step,verdict\n",
    );
    for given in session.answers() {
        if let Some(asked) = session.query(given.answer.query) {
            write_row(&mut csv, asked, given, session.weights());
        }
    }
    csv
}

fn write_row(csv: &mut String, asked: &AskedQuery, given: &Given, weights: &Weights) {
    let &AskedQuery { query, transition, choice, .. } = asked;
    let Given { answer, protocol, at, .. } = given;
    let is_again = matches!(choice, Choice::Repeat(_));
    let choice = match choice {
        Choice::Uniform => "uniform".to_owned(),
        Choice::Balanced => "balanced".to_owned(),
        Choice::Disagreement => "disagreement".to_owned(),
        Choice::SafetyBoundary => "safety_boundary".to_owned(),
        Choice::Synthesized(acquisition) => made_to_be(acquisition).to_owned(),
        Choice::Repeat(of) => format!("again {}", of.0),
    };
    // A query that was asked again is no second label.
    let label = weights.label(&answer.response).filter(|_| !is_again);
    let mu = label.map(|label| label.mu().to_string()).unwrap_or_default();
    let step = |step: Option<usize>| step.map(|step| step.to_string()).unwrap_or_default();
    let fields = [
        query.id.0.to_string(),
        query.left.dream.0.to_string(),
        query.left.start.to_string(),
        query.right.dream.0.to_string(),
        query.right.start.to_string(),
        choice,
        protocol.name().to_owned(),
    ];
    let verdict = match answer.response {
        Response::Judged(Verdict::Unsafe) => "unsafe",
        Response::Judged(Verdict::Neutral) => "neutral",
        Response::Judged(Verdict::Good) => "good",
        _ => "",
    };
    let said = said(answer.response, weights);
    let how = [
        mu,
        answer.secs.to_string(),
        answer.loops.to_string(),
        cell(&answer.annotator),
        answer.sides_swapped.to_string(),
        step(answer.left_unsafe_from),
        step(answer.right_unsafe_from),
        at.to_string(),
        step(transition.map(|transition| transition.step)),
        verdict.to_owned(),
    ];
    let row = [&fields[..], &said[..], &how[..]].concat().join(",");
    writeln!(csv, "{row}").unwrap_or_else(|_| unreachable!("a string takes all"));
}

/// Skipped, left safe, right safe, justification, preference: empty where nothing was said of it.
fn said(response: Response, weights: &Weights) -> [String; 5] {
    let preferred = |preference: Preference| match preference {
        Preference::Left => "left",
        Preference::Equal => "equal",
        Preference::Right => "right",
    };
    let name = |justification| {
        let named = weights.justifications.iter().find(|(this, ..)| *this == justification);
        cell(named.map_or("", |(_, name, _)| name))
    };
    let said = match response {
        Response::Skipped(reason) => {
            let reason = match reason {
                None => "yes",
                Some(SkipReason::Hallucinated) => "hallucinated",
                Some(SkipReason::Ambiguous) => "ambiguous",
                Some(SkipReason::Other) => "other",
            };
            [reason, "", "", "", ""]
        }
        Response::Judged(_) => [""; 5],
        Response::Preferred(preference) => ["", "", "", "", preferred(preference)],
        Response::Safety(SafetyAnswer::OnlyLeft) => ["", "true", "false", "", ""],
        Response::Safety(SafetyAnswer::OnlyRight) => ["", "false", "true", "", ""],
        Response::Safety(SafetyAnswer::Neither) => ["", "false", "false", "", ""],
        Response::Safety(SafetyAnswer::Both(preference)) => ["", "true", "true", "", preferred(preference)],
        Response::Justified(justification, preference) => {
            return ["", "", "", &name(justification), preferred(preference)].map(str::to_owned);
        }
    };
    said.map(str::to_owned)
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
