//! What can happen in a session, as it stands in its log: facts, never what follows from them.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::planner::synthesis::Acquisition;
use crate::query::{
    DreamId, Protocol, QueryId, Response, SegmentRef, SkipReason, Strategy, Transition, Weights,
};
use crate::text;

/// One thing that happened.
///
/// The names of variants and fields are the file format: the snapshot below pins it, and a changed snapshot means
/// that [`FORMAT`](crate::session::FORMAT) goes up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case", deny_unknown_fields)]
pub enum Event {
    /// A dream was driven and kept.
    DreamKept(KeptDream),
    /// A dream is no longer used: nothing is asked about it. Its file stays, so that this can be taken back.
    DreamDropped {
        /// Which.
        dream: DreamId,
    },
    /// A dream that was dropped is used again.
    DreamRestored {
        /// Which.
        dream: DreamId,
    },
    /// A query was drawn, and will be shown.
    Asked {
        /// Its number: how many were asked before.
        query: QueryId,
        /// Its left segment.
        left: SegmentRef,
        /// Its right segment.
        right: SegmentRef,
        /// Why this one.
        choice: Choice,
    },
    /// A transition was chosen, and will be shown.
    AskedTransition {
        /// Its number: how many queries were asked before.
        query: QueryId,
        /// Which one.
        transition: Transition,
        /// Why this one.
        choice: Choice,
    },
    /// From here on other questions are asked, of queries that are asked already too.
    ProtocolChanged {
        /// Which.
        protocol: Protocol,
    },
    /// From here on the pairs with the highest anomaly scores are held back, see [`Screen`](crate::dream::Screen).
    ScreenChanged {
        /// How many of a hundred.
        held_back: u8,
    },
    /// A query was answered or skipped. An earlier answer to it no longer counts.
    Answered(Answer),
    /// It was said why a query was skipped: a part of that answer, and no other one.
    SkipExplained {
        /// Which one.
        query: QueryId,
        /// Why.
        reason: SkipReason,
    },
    /// The answer that counts for a query was taken back. The one before it counts again, if there is one.
    Retracted {
        /// Of which query.
        query: QueryId,
    },
    /// The answer that was last taken back from a query counts again.
    Restored {
        /// Of which query.
        query: QueryId,
    },
    /// A query was marked for a second look.
    Flagged {
        /// Which one.
        query: QueryId,
    },
    /// That mark was removed.
    Unflagged {
        /// From which query.
        query: QueryId,
    },
    /// From here on the answers, old and new, have other weights.
    WeightsChanged {
        /// The new weights.
        weights: Weights,
    },
    /// A reward was learned.
    Fitted {
        /// From what, and how well.
        fit: Fit,
        /// The file of its parameters, from the session's folder.
        file: String,
        /// The hash of that file, as in [`Parameters::hash`](crate::tensor::Parameters::hash).
        sha256: String,
    },
}

/// A dream that belongs to the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptDream {
    /// Its number: how many were kept before.
    pub dream: DreamId,
    /// How many steps it has.
    pub len: usize,
    /// The seed of its noise.
    pub seed: u64,
    /// Steps that the driver marked as unsafe, in order.
    pub marks: Vec<usize>,
    /// Who drove.
    pub source: DreamSource,
    /// What it was made to be, where nobody drove.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<Acquisition>,
    /// How many of its steps the planner drove.
    #[serde(default, skip_serializing_if = "is_none")]
    pub planned: usize,
    /// Its file, from the session's folder.
    pub file: String,
    /// The hash of that file.
    pub sha256: String,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_none(n: &usize) -> bool {
    *n == 0
}

/// Who drove a dream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DreamSource {
    /// A person.
    User,
    /// A stand-in for one.
    Simulated,
    /// Nobody: its actions were made such that its transitions are worth asking about.
    Synthesized,
}

/// Why a query was asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// By chance, every pair of segments being as likely as any other: the paper's way.
    #[default]
    Uniform,
    /// By chance, but seldom where both segments are likely unsafe.
    Balanced,
    /// Its answer was likely to name what had been named least.
    LeastAnswered,
    /// The members of the ensemble disagree about it.
    Disagreement,
    /// One of its segments lies near a step that the driver marked as unsafe.
    SafetyBoundary,
    /// It is of a trajectory that was made to be this.
    Synthesized(Acquisition),
    /// To see whether the annotator answers as before, perhaps with the sides changed over.
    #[serde(rename = "again")]
    Repeat(QueryId),
}

impl From<Strategy> for Choice {
    fn from(strategy: Strategy) -> Self {
        match strategy {
            Strategy::Uniform => Self::Uniform,
            Strategy::Balanced => Self::Balanced,
            Strategy::LeastAnswered => Self::LeastAnswered,
            Strategy::Disagreement => Self::Disagreement,
            Strategy::SafetyBoundary => Self::SafetyBoundary,
        }
    }
}

/// What an annotator said, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// To which query.
    pub query: QueryId,
    /// What was said, of the query's own left and right.
    pub response: Response,
    /// Seconds from showing the clips to the answer.
    pub secs: f32,
    /// How often the clips were seen to their end.
    pub loops: u32,
    /// Who answered.
    pub annotator: String,
    /// Whether the query's left segment was shown on the right. The response is already turned back.
    pub sides_swapped: bool,
    /// The step of the left segment from which it is unsafe, where the annotator pointed at one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_unsafe_from: Option<usize>,
    /// The same of the right segment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub right_unsafe_from: Option<usize>,
}

impl Answer {
    /// An answer to `query` by `annotator` with nothing else said.
    pub fn new(query: QueryId, response: Response, secs: f32, annotator: &str) -> Self {
        let annotator = annotator.to_owned();
        let (left_unsafe_from, right_unsafe_from) = (None, None);
        Self {
            query,
            response,
            secs,
            loops: 0,
            annotator,
            sides_swapped: false,
            left_unsafe_from,
            right_unsafe_from,
        }
    }
}

/// How a reward was learned, so that it can be learned again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fit {
    /// How many lines of the log had been written: its labels are those of the session up to there.
    pub after: u64,
    /// How many labels those are.
    pub n_labels: usize,
    /// The seed of its initialization and its batches.
    pub seed: u64,
    /// How often it went through the labels.
    pub epochs: u32,
    /// The last loss of each member of the ensemble.
    pub losses: Vec<f32>,
    /// The loss on labels that were held out, where some were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out: Option<f32>,
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Entry {
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
    /// How many lines come before it.
    pub seq: u64,
    /// When, in milliseconds since 1970.
    pub at: u64,
}

/// Why a line is no [`Entry`].
#[derive(Debug, thiserror::Error)]
pub enum LineError {
    /// It is not even JSON: perhaps half a line.
    #[error("it is not JSON ({0})")]
    Torn(serde_json::Error),
    /// The log is stored in another encoding.
    #[error("it is stored as UTF-16, and the log is UTF-8")]
    Utf16,
    /// A number that every line has is missing.
    #[error("it has no number {0:?}")]
    NoNumber(&'static str),
    /// It tells of something else.
    #[error(transparent)]
    Event(serde_json::Error),
    /// It has not the number that is next.
    #[error("it has the number {found} where {next} is next")]
    Number {
        /// Its number.
        found: u64,
        /// The next.
        next: usize,
    },
}

impl Entry {
    /// The line, without its end.
    pub fn to_line(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|e| unreachable!("plain data: {e}"))
    }

    /// The entry in `line`, which must contain nothing else.
    pub(crate) fn from_line(line: &[u8]) -> Result<Self, LineError> {
        let fields = serde_json::from_slice(line).map_err(LineError::Torn)?;
        Self::from_value(fields)
    }

    /// The entry that such an object tells of.
    pub(crate) fn from_value(mut fields: Value) -> Result<Self, LineError> {
        let mut number = |name: &'static str| {
            let taken = fields.as_object_mut().and_then(|fields| fields.remove(name));
            let number = taken.as_ref().and_then(Value::as_u64);
            number.ok_or(LineError::NoNumber(name))
        };
        let (seq, at) = (number("seq")?, number("at")?);
        let event = serde_json::from_value(fields).map_err(LineError::Event)?;
        Ok(Self { event, seq, at })
    }
}

/// What a whole event begins with; not even the name of an annotator can contain it, for there the quotes are escaped.
const BEGINNING: &[u8] = b"{\"event\"";

/// The whole objects in `line` that begin as events do.
pub(super) fn objects_in(line: &[u8]) -> impl Iterator<Item = (Range<usize>, Value)> {
    text::objects_in(line, &[BEGINNING])
}

/// Whether a line that is no JSON has a whole event in it, so that cutting it off would lose that.
pub(super) fn has_event(line: &[u8]) -> bool {
    objects_in(line).any(|(_, value)| Entry::from_value(value).is_ok())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::query::{Justification, Preference, SafetyAnswer, Verdict};

    fn one_of_each() -> Vec<Event> {
        let query = QueryId(1);
        let segment = |dream, start| SegmentRef { dream: DreamId(dream), start };
        let kept = KeptDream {
            dream: DreamId(0),
            len: 640,
            seed: u64::MAX,
            marks: vec![412, 413],
            source: DreamSource::User,
            acquisition: None,
            planned: 0,
            file: "dreams/0000.safetensors".to_owned(),
            sha256: "sha256:00".to_owned(),
        };
        let asked = |choice| Event::Asked { query, left: segment(0, 412), right: segment(3, 77), choice };
        let answered =
            |response| Event::Answered(Answer { loops: 1, ..Answer::new(query, response, 4.2, "anna") });
        let pointed = Answer {
            left_unsafe_from: Some(9),
            sides_swapped: true,
            ..Answer::new(query, Response::Safety(SafetyAnswer::OnlyRight), 3.0, "anonymous")
        };
        let fit =
            Fit { after: 9, n_labels: 4, seed: 7, epochs: 100, losses: vec![0.5, 0.25], held_out: None };
        vec![
            Event::DreamKept(kept.clone()),
            asked(Choice::Uniform),
            asked(Choice::Repeat(QueryId(0))),
            answered(Response::Safety(SafetyAnswer::Both(Preference::Right))),
            answered(Response::Preferred(Preference::Left)),
            answered(Response::Justified(Justification(0).into(), Preference::Equal)),
            answered(Response::Skipped(Some(SkipReason::Hallucinated))),
            Event::Answered(pointed),
            Event::Retracted { query },
            Event::Restored { query },
            Event::Flagged { query },
            Event::Unflagged { query },
            Event::WeightsChanged { weights: Weights { default: 0.7, ..Weights::paper() } },
            Event::Fitted { fit, file: "reward/0000.safetensors".to_owned(), sha256: "sha256:00".to_owned() },
            Event::ProtocolChanged { protocol: Protocol::DropjMulti },
            Event::SkipExplained { query, reason: SkipReason::Ambiguous },
            Event::DreamKept(KeptDream { planned: 120, ..kept.clone() }),
            Event::DreamDropped { dream: DreamId(0) },
            Event::DreamRestored { dream: DreamId(0) },
            Event::ScreenChanged { held_back: 10 },
            Event::AskedTransition {
                query,
                transition: Transition { dream: DreamId(2), first: 412, step: 431 },
                choice: Choice::Uniform,
            },
            answered(Response::Judged(Verdict::Unsafe)),
            Event::DreamKept(KeptDream {
                source: DreamSource::Synthesized,
                acquisition: Some(Acquisition::MaxReward),
                ..kept
            }),
            Event::AskedTransition {
                query,
                transition: Transition { dream: DreamId(0), first: 0, step: 3 },
                choice: Choice::Synthesized(Acquisition::MaxReward),
            },
        ]
    }

    /// A line of each kind.
    pub(in crate::session) fn lines() -> Vec<String> {
        let entry = |(seq, event)| Entry { event, seq: seq as u64, at: 1_795_342_500_000 };
        one_of_each().into_iter().enumerate().map(entry).map(|entry| entry.to_line()).collect()
    }

    #[test]
    fn the_lines_of_the_log_look_as_they_always_did() {
        insta::assert_snapshot!(lines().join("\n"), @r#"
        {"event":"dream_kept","dream":0,"len":640,"seed":18446744073709551615,"marks":[412,413],"source":"user","file":"dreams/0000.safetensors","sha256":"sha256:00","seq":0,"at":1795342500000}
        {"event":"asked","query":1,"left":{"dream":0,"start":412},"right":{"dream":3,"start":77},"choice":"uniform","seq":1,"at":1795342500000}
        {"event":"asked","query":1,"left":{"dream":0,"start":412},"right":{"dream":3,"start":77},"choice":{"again":0},"seq":2,"at":1795342500000}
        {"event":"answered","query":1,"response":{"safety":{"both":"right"}},"secs":4.2,"loops":1,"annotator":"anna","sides_swapped":false,"seq":3,"at":1795342500000}
        {"event":"answered","query":1,"response":{"preferred":"left"},"secs":4.2,"loops":1,"annotator":"anna","sides_swapped":false,"seq":4,"at":1795342500000}
        {"event":"answered","query":1,"response":{"justified":[0,"equal"]},"secs":4.2,"loops":1,"annotator":"anna","sides_swapped":false,"seq":5,"at":1795342500000}
        {"event":"answered","query":1,"response":{"skipped":"hallucinated"},"secs":4.2,"loops":1,"annotator":"anna","sides_swapped":false,"seq":6,"at":1795342500000}
        {"event":"answered","query":1,"response":{"safety":"only_right"},"secs":3.0,"loops":0,"annotator":"anonymous","sides_swapped":true,"left_unsafe_from":9,"seq":7,"at":1795342500000}
        {"event":"retracted","query":1,"seq":8,"at":1795342500000}
        {"event":"restored","query":1,"seq":9,"at":1795342500000}
        {"event":"flagged","query":1,"seq":10,"at":1795342500000}
        {"event":"unflagged","query":1,"seq":11,"at":1795342500000}
        {"event":"weights_changed","weights":{"safety":1.0,"default":0.7,"justifications":[["grass",1.0],["default",0.75]]},"seq":12,"at":1795342500000}
        {"event":"fitted","fit":{"after":9,"n_labels":4,"seed":7,"epochs":100,"losses":[0.5,0.25]},"file":"reward/0000.safetensors","sha256":"sha256:00","seq":13,"at":1795342500000}
        {"event":"protocol_changed","protocol":"dropj-multi","seq":14,"at":1795342500000}
        {"event":"skip_explained","query":1,"reason":"ambiguous","seq":15,"at":1795342500000}
        {"event":"dream_kept","dream":0,"len":640,"seed":18446744073709551615,"marks":[412,413],"source":"user","planned":120,"file":"dreams/0000.safetensors","sha256":"sha256:00","seq":16,"at":1795342500000}
        {"event":"dream_dropped","dream":0,"seq":17,"at":1795342500000}
        {"event":"dream_restored","dream":0,"seq":18,"at":1795342500000}
        {"event":"screen_changed","held_back":10,"seq":19,"at":1795342500000}
        {"event":"asked_transition","query":1,"transition":{"dream":2,"first":412,"step":431},"choice":"uniform","seq":20,"at":1795342500000}
        {"event":"answered","query":1,"response":{"judged":"unsafe"},"secs":4.2,"loops":1,"annotator":"anna","sides_swapped":false,"seq":21,"at":1795342500000}
        {"event":"dream_kept","dream":0,"len":640,"seed":18446744073709551615,"marks":[412,413],"source":"synthesized","acquisition":"max_reward","file":"dreams/0000.safetensors","sha256":"sha256:00","seq":22,"at":1795342500000}
        {"event":"asked_transition","query":1,"transition":{"dream":0,"first":0,"step":3},"choice":{"synthesized":"max_reward"},"seq":23,"at":1795342500000}
        "#);
    }

    #[test]
    fn every_event_survives_the_way_to_a_line_and_back() {
        let read: Vec<Event> =
            lines().iter().map(|line| Entry::from_line(line.as_bytes()).unwrap().event).collect();
        assert_eq!(read, one_of_each());
    }

    #[test]
    fn fields_that_nobody_knows_are_refused_by_name() {
        for line in [
            r#"{"event":"retracted","query":1,"sure":true,"seq":0,"at":0}"#,
            r#"{"event":"answered","query":0,"response":{"preferred":"left"},"secs":1,"loops":0,"annotator":"a","sides_swapped":false,"sure":1,"seq":0,"at":0}"#,
        ] {
            let refused = Entry::from_line(line.as_bytes()).unwrap_err().to_string();
            assert!(refused.contains("`sure`"), "{refused}");
        }
    }
}
