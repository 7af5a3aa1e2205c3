//! Which events can happen in which state: the rules that live use and replay share.

use std::path::{Component, Path};

use crate::query::{
    DreamId, Query, QueryId, Response, SEGMENT_LEN, SegmentRef, TRAJECTORY_LEN, Transition, Weights,
};
use crate::session::error::Impossible;
use crate::session::event::{Answer, Choice, Event};
use crate::session::{Given, Session};

impl Session {
    /// Whether `event` can happen now.
    pub fn check(&self, event: &Event) -> Result<(), Impossible> {
        match event {
            Event::DreamKept(kept) => {
                if kept.dream.0 as usize != self.dreams.len() {
                    return Err(Impossible::DreamNumber { found: kept.dream, next: self.dreams.len() });
                }
                if let Some(&mark) = kept.marks.iter().find(|mark| **mark >= kept.len) {
                    return Err(Impossible::Mark { mark, len: kept.len });
                }
                check_inside(&kept.file)
            }
            &Event::DreamDropped { dream } => {
                self.check_in_use(dream)?;
                match self.n_resting_on(dream) {
                    0 => Ok(()),
                    n => Err(Impossible::Rests { dream, n }),
                }
            }
            &Event::DreamRestored { dream } if !self.is_dropped(dream) => Err(Impossible::NotDropped(dream)),
            Event::Asked { query, left, right, choice } => self.check_asked(*query, [*left, *right], *choice),
            &Event::AskedTransition { query, transition, choice } => {
                self.check_transition(query, transition, choice)
            }
            Event::Answered(answer) => self.check_answer(answer),
            Event::SkipExplained { query, .. } => match self.asked(*query)?.answer() {
                Some(Given { answer: Answer { response: Response::Skipped(_), .. }, .. }) => Ok(()),
                _ => Err(Impossible::NotSkipped(*query)),
            },
            Event::Retracted { query } if self.asked(*query)?.given.is_empty() => {
                Err(Impossible::NotAnswered(*query))
            }
            Event::Restored { query } if self.asked(*query)?.retracted.is_empty() => {
                Err(Impossible::NotRetracted(*query))
            }
            Event::Retracted { query } | Event::Restored { query } => self.check_shown(*query),
            Event::ScreenChanged { held_back } if *held_back > 100 => Err(Impossible::Share(*held_back)),
            Event::ProtocolChanged { .. } | Event::DreamRestored { .. } | Event::ScreenChanged { .. } => {
                Ok(())
            }
            Event::Flagged { query } | Event::Unflagged { query } => self.asked(*query).map(drop),
            Event::WeightsChanged { weights } => {
                let names = |weights: &Weights| -> Vec<String> {
                    weights.justifications.iter().map(|(_, name, _)| name.to_owned()).collect()
                };
                if names(weights) != names(&self.weights) {
                    return Err(Impossible::Justifications);
                }
                check_weights(weights)
            }
            Event::Fitted { fit, file, .. } => {
                let numbers = fit.losses.iter().chain(&fit.held_out);
                if !numbers.into_iter().all(|loss| loss.is_finite() && *loss >= 0.0) {
                    return Err(Impossible::Number("a loss"));
                }
                if fit.after > self.n_entries {
                    return Err(Impossible::Future { after: fit.after, n_lines: self.n_entries });
                }
                check_inside(file)
            }
        }
    }

    /// Whether `dream` is there and was not dropped.
    fn check_in_use(&self, dream: DreamId) -> Result<(), Impossible> {
        if dream.0 as usize >= self.dreams.len() {
            return Err(Impossible::Segment(SegmentRef { dream, start: 0 }));
        }
        if self.is_dropped(dream) { Err(Impossible::Dropped(dream)) } else { Ok(()) }
    }

    /// Whether what `query` shows is in use.
    fn check_shown(&self, query: QueryId) -> Result<(), Impossible> {
        let Query { left, right, .. } = self.asked(query)?.query;
        self.check_in_use(left.dream).and_then(|()| self.check_in_use(right.dream))
    }

    fn check_asked(
        &self,
        query: QueryId,
        segments: [SegmentRef; 2],
        choice: Choice,
    ) -> Result<(), Impossible> {
        if query != self.next_query_id() {
            return Err(Impossible::QueryNumber { found: query, next: self.queries.len() });
        }
        for segment in segments {
            let len = self.dreams.get(segment.dream.0 as usize).map_or(0, |kept| kept.len);
            if segment.start.saturating_add(SEGMENT_LEN) > len {
                return Err(Impossible::Segment(segment));
            }
            self.check_in_use(segment.dream)?;
        }
        if let Choice::Repeat(of) = choice {
            let Query { left, right, .. } = self.asked(of)?.query;
            if segments != [left, right] && segments != [right, left] {
                return Err(Impossible::OtherSegments { query, of });
            }
        }
        Ok(())
    }

    fn check_transition(
        &self,
        query: QueryId,
        transition: Transition,
        choice: Choice,
    ) -> Result<(), Impossible> {
        if query != self.next_query_id() {
            return Err(Impossible::QueryNumber { found: query, next: self.queries.len() });
        }
        let len = self.dreams.get(transition.dream.0 as usize).map_or(0, |kept| kept.len);
        let Transition { first, step, .. } = transition;
        if len < SEGMENT_LEN || first > step || step - first > TRAJECTORY_LEN - 2 || step >= len - 1 {
            return Err(Impossible::Transition(transition));
        }
        self.check_in_use(transition.dream)?;
        if let Choice::Repeat(of) = choice
            && self.asked(of)?.transition != Some(transition)
        {
            return Err(Impossible::OtherSegments { query, of });
        }
        Ok(())
    }

    fn check_answer(&self, answer: &Answer) -> Result<(), Impossible> {
        let asked = self.asked(answer.query)?;
        let query = asked.query.id;
        let is_of_it = match answer.response {
            Response::Skipped(_) => true,
            Response::Judged(_) => asked.transition.is_some(),
            _ => asked.transition.is_none(),
        };
        if !matches!(answer.response, Response::Skipped(_)) {
            self.check_shown(query)?;
        }
        if !is_of_it || !self.protocol.permits(&answer.response) {
            return Err(Impossible::Response { query, protocol: self.protocol });
        }
        if let Response::Justified(active, _) = answer.response
            && active.least_severe() > self.weights.justifications.default()
        {
            return Err(Impossible::Justification(query));
        }
        let mut steps = answer.left_unsafe_from.iter().chain(&answer.right_unsafe_from);
        if let Some(&step) = steps.find(|step| **step >= SEGMENT_LEN) {
            return Err(Impossible::Step { query, step });
        }
        if !(answer.secs.is_finite() && answer.secs >= 0.0) {
            return Err(Impossible::Number("the time of an answer"));
        }
        Ok(())
    }
}

/// Whether labels made with `weights` lie in `[0, 1]` on the side that was meant.
pub(crate) fn check_weights(weights: &Weights) -> Result<(), Impossible> {
    for (name, weight) in [("safety", weights.safety), ("default", weights.default)] {
        if !(weight > 0.5 && weight <= 1.0) {
            return Err(Impossible::Weight { name, weight });
        }
    }
    Ok(())
}

fn check_inside(file: &str) -> Result<(), Impossible> {
    let is_inside = Path::new(file).components().all(|part| matches!(part, Component::Normal(_)));
    if is_inside { Ok(()) } else { Err(Impossible::Outside(file.to_owned())) }
}
