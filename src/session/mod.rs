//! What a person did, kept such that nothing is lost: events, their log, and the arrays and weights beside it.
//!
//! With `dataset` and `run` the only module that touches files. Starts no thread.
//! A session *is* its log: a [`Session`] is what folding the log gives, live and in a replay alike.
//!
//! ```text
//! sessions/2026-11-22T10-15-00-dropj/
//! ├── session.json                 Header: format, environment, protocol, seed, world model, weights, annotator
//! ├── events.jsonl                 one Event a line, in order, never edited
//! ├── dreams/0000.safetensors      start z c h · zs [T, Z] · actions [T, A] · unsafe marks
//! ├── dreams/journal-0000.partial  a dream that is being driven, or was when the program was killed
//! ├── reward/0000.safetensors      what a fit learned
//! └── world_model.safetensors      or a path to it in session.json; its hash decides
//! ```

pub mod annotators;
pub mod arrays;
mod check;
pub mod clip_hash;
pub mod error;
pub mod event;
pub mod export;
pub mod hand_out;
pub mod header;
pub mod journal;
pub mod list;
mod loaded;
pub mod log;
pub mod merge;
mod new;
pub mod practice;
pub mod repair;
pub mod repeats;
pub mod replay;
pub mod responses;
mod save_as;
pub mod statistics;
pub mod store;
mod trajectories;
pub mod worlds;

use std::collections::{BTreeMap, BTreeSet};

use crate::query::{
    DreamId, JudgedTransition, KnownClips, LabeledQuery, Protocol, Query, QueryId, Response, SegmentRef,
    SkipReason, Transition, Weights,
};

pub use annotators::{AnnotatorReport, Annotators, share_dreams};
pub use clip_hash::{ClipHash, ClipHashes, FILE as CLIPS_FILE};
pub use error::{ClipHashError, DreamError, HeaderError, Impossible, SessionError};
pub use event::{Answer, Choice, DreamSource, Entry, Event, Fit, KeptDream, LineError};
pub use hand_out::{annotator_folder, hand_out};
pub use header::{Config, FORMAT, Header, date};
pub use journal::{DreamJournal, UnfinishedDream};
pub use list::{ListedSession, latest, list_sessions};
pub use loaded::LoadedSession;
pub use merge::{hand_on, hand_on_in, merge, merge_counted, merge_in, relative};
pub use new::NewSession;
pub use practice::{N_PRACTICED, example, practice_in};
pub use repair::{Note, Origin, Repair, repair};
pub use replay::{REFIT_TOLERANCE, Replay, ReplayedFit, replay};
pub use responses::{RecordedAnswer, ResponsesError, protocol_of_released, read_responses};
pub use save_as::SavedAs;
pub use statistics::Statistics;
pub use store::{SessionStore, now};

/// An answer and the line that tells of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// What was answered.
    pub answer: Answer,
    /// To which questions.
    pub protocol: Protocol,
    /// The number of the line.
    pub seq: u64,
    /// When, in milliseconds since 1970.
    pub at: u64,
}

/// A query and what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct AskedQuery {
    /// What was shown; of a transition the clip around it, on both sides.
    pub query: Query,
    /// The transition that is asked about, where it is not a pair of clips.
    pub transition: Option<Transition>,
    /// Why this.
    pub choice: Choice,
    /// Whether it is marked for a second look.
    pub is_flagged: bool,
    /// Its answers, the last of which counts.
    given: Vec<Given>,
    /// Answers that were taken back, the last one last.
    retracted: Vec<Given>,
}

impl AskedQuery {
    /// The answer that counts.
    pub fn answer(&self) -> Option<&Given> {
        self.given.last()
    }
}

/// A reward that was learned.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedReward {
    /// From what, and how well.
    pub fit: Fit,
    /// The file of its parameters, from the session's folder.
    pub file: String,
    /// The hash of that file.
    pub sha256: String,
}

/// The state of a session: the fold of its events.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    protocol: Protocol,
    weights: Weights,
    dreams: Vec<KeptDream>,
    /// Those of which nothing is asked any more.
    dropped: BTreeSet<DreamId>,
    queries: Vec<AskedQuery>,
    fits: Vec<FittedReward>,
    held_back: u8,
    n_entries: u64,
    last_at: Option<u64>,
    /// Every answer that was ever given, whatever became of it.
    spent: Vec<Spent>,
}

/// That somebody spent time with a query.
#[derive(Clone, Debug, PartialEq)]
struct Spent {
    annotator: String,
    query: QueryId,
    at: u64,
    secs: f32,
}

impl Session {
    /// A session in which nothing has happened.
    pub fn new(protocol: Protocol, weights: Weights) -> Self {
        Self {
            protocol,
            weights,
            dreams: Vec::new(),
            dropped: BTreeSet::new(),
            queries: Vec::new(),
            fits: Vec::new(),
            held_back: 0,
            n_entries: 0,
            last_at: None,
            spent: Vec::new(),
        }
    }

    /// This session after `entries`. An error comes with how many of them could be applied.
    pub fn folded<'a>(
        mut self,
        entries: impl IntoIterator<Item = &'a Entry>,
    ) -> Result<Self, (usize, Impossible)> {
        for (n_applied, entry) in entries.into_iter().enumerate() {
            self.apply(entry).map_err(|why| (n_applied, why))?;
        }
        Ok(self)
    }

    /// Takes in what happened. Where it cannot have happened, nothing changes.
    pub fn apply(&mut self, entry: &Entry) -> Result<(), Impossible> {
        self.check(&entry.event)?;
        match &entry.event {
            Event::DreamKept(kept) => self.dreams.push(kept.clone()),
            Event::DreamDropped { dream } => drop(self.dropped.insert(*dream)),
            Event::DreamRestored { dream } => drop(self.dropped.remove(dream)),
            &Event::Asked { query: id, left, right, choice } => {
                self.ask(Query { id, left, right }, None, choice);
            }
            &Event::AskedTransition { query: id, transition, choice } => {
                let clip = transition.clip(self.dreams[transition.dream.0 as usize].len);
                self.ask(Query { id, left: clip, right: clip }, Some(transition), choice);
            }
            Event::Answered(answer) => {
                let (annotator, query, secs) = (answer.annotator.clone(), answer.query, answer.secs);
                self.spent.push(Spent { annotator, query, at: entry.at, secs });
                let asked = &mut self.queries[answer.query.0 as usize];
                asked.retracted.clear();
                let (answer, protocol) = (answer.clone(), self.protocol);
                asked.given.push(Given { answer, protocol, seq: entry.seq, at: entry.at });
            }
            &Event::SkipExplained { query, reason } => {
                let skip = self.queries[query.0 as usize].given.last_mut();
                skip.expect("it was skipped").answer.response = Response::Skipped(Some(reason));
            }
            Event::ProtocolChanged { protocol } => self.protocol = *protocol,
            Event::ScreenChanged { held_back } => self.held_back = *held_back,
            Event::Retracted { query } => {
                let asked = &mut self.queries[query.0 as usize];
                asked.retracted.extend(asked.given.pop());
            }
            Event::Restored { query } => {
                let asked = &mut self.queries[query.0 as usize];
                asked.given.extend(asked.retracted.pop());
            }
            Event::Flagged { query } => self.queries[query.0 as usize].is_flagged = true,
            Event::Unflagged { query } => self.queries[query.0 as usize].is_flagged = false,
            Event::WeightsChanged { weights } => self.weights = weights.clone(),
            Event::Fitted { fit, file, sha256 } => {
                let (file, sha256) = (file.clone(), sha256.clone());
                self.fits.push(FittedReward { fit: fit.clone(), file, sha256 });
            }
        }
        self.n_entries += 1;
        self.last_at = Some(entry.at);
        Ok(())
    }

    fn ask(&mut self, query: Query, transition: Option<Transition>, choice: Choice) {
        let (given, retracted) = (Vec::new(), Vec::new());
        self.queries.push(AskedQuery { query, transition, choice, is_flagged: false, given, retracted });
    }

    fn asked(&self, query: QueryId) -> Result<&AskedQuery, Impossible> {
        self.query(query).ok_or(Impossible::NeverAsked(query))
    }

    /// Which questions are asked now.
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The weights of answers now.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// The dreams, in the order of keeping.
    pub fn dreams(&self) -> &[KeptDream] {
        &self.dreams
    }

    /// The dreams in use with their lengths, as [`sample_queries`](crate::query::sample_queries) takes them.
    pub fn dream_lens(&self) -> Vec<(DreamId, usize)> {
        let in_use = self.dreams.iter().filter(|kept| !self.is_dropped(kept.dream));
        in_use.map(|kept| (kept.dream, kept.len)).collect()
    }

    /// Whether a dream was deleted.
    pub fn is_dropped(&self, dream: DreamId) -> bool {
        self.dropped.contains(&dream)
    }

    /// How many answers that are learned from rest on a dream. Skips do not.
    pub fn n_resting_on(&self, dream: DreamId) -> usize {
        let shows = |asked: &&AskedQuery| asked.query.left.dream == dream || asked.query.right.dream == dream;
        let is_said = |asked: &AskedQuery| {
            asked.answer().is_some_and(|given| !matches!(given.answer.response, Response::Skipped(_)))
        };
        self.queries.iter().filter(shows).filter(|asked| is_said(asked)).count()
    }

    /// Whether both clips of a query are of dreams in use.
    pub(crate) fn is_in_use(&self, asked: &AskedQuery) -> bool {
        ![asked.query.left, asked.query.right].iter().any(|segment| self.is_dropped(segment.dream))
    }

    /// The queries, in the order of asking.
    pub fn queries(&self) -> &[AskedQuery] {
        &self.queries
    }

    /// The query of this number.
    pub fn query(&self, id: QueryId) -> Option<&AskedQuery> {
        self.queries.get(id.0 as usize)
    }

    /// The number of the query that is asked next.
    pub fn next_query_id(&self) -> QueryId {
        QueryId(self.queries.len() as u32)
    }

    /// The queries that were asked, have no answer that counts and show dreams in use, in the order of asking.
    pub fn pending(&self) -> impl Iterator<Item = &AskedQuery> {
        self.queries.iter().filter(|asked| asked.given.is_empty() && self.is_in_use(asked))
    }

    /// The answers that count, skips among them, in the order of answering.
    pub fn answers(&self) -> Vec<&Given> {
        let mut answers: Vec<_> = self.queries.iter().filter_map(AskedQuery::answer).collect();
        answers.sort_by_key(|given| given.seq);
        answers
    }

    /// Whether what was said last, skips aside, is a verdict on a transition.
    pub fn ends_with_verdicts(&self) -> bool {
        let said = self.answers().into_iter().rev().map(|given| &given.answer.response);
        let last = said.into_iter().find(|response| !matches!(response, Response::Skipped(_)));
        matches!(last, Some(Response::Judged(_)))
    }

    /// The query whose answer undoing takes back: the one answered last.
    pub fn undoable(&self) -> Option<QueryId> {
        let in_use = self.queries.iter().filter(|asked| self.is_in_use(asked));
        let last = in_use.filter_map(AskedQuery::answer).max_by_key(|given| given.seq);
        last.map(|given| given.answer.query)
    }

    /// The query whose answer redoing gives back: undoing backwards, so the one answered first of those taken back.
    pub fn redoable(&self) -> Option<QueryId> {
        let in_use = self.queries.iter().filter(|asked| self.is_in_use(asked));
        let first = in_use.filter_map(|asked| asked.retracted.last()).min_by_key(|given| given.seq);
        first.map(|given| given.answer.query)
    }

    /// What can be learned from, in the order of answering: skips are left out, and so is what was only asked again.
    pub fn labeled(&self) -> Vec<LabeledQuery> {
        self.labeled_by(&self.weights)
    }

    /// The same with other weights, which needs no new answers.
    pub fn labeled_by(&self, weights: &Weights) -> Vec<LabeledQuery> {
        let labeled = self.answers();
        labeled.iter().filter_map(|given| self.label_of(given.answer.query, weights)).collect()
    }

    /// The label of a query with these weights, if it has one.
    pub fn label_of(&self, id: QueryId, weights: &Weights) -> Option<LabeledQuery> {
        let asked = self.query(id).filter(|asked| asked.repeats().is_none())?;
        let label = weights.label(&asked.answer()?.answer.response)?;
        Some(LabeledQuery { query: asked.query, label })
    }

    /// What clips were said to show.
    pub fn known_clips(&self) -> KnownClips {
        let mut known = KnownClips::new(&self.weights().justifications);
        for (asked, given) in self.queries.iter().filter_map(|asked| Some((asked, asked.answer()?))) {
            known.record([asked.query.left, asked.query.right], given.answer.response);
        }
        known
    }

    /// The pairs that were looked at, and whether they were skipped because they did not look like the world.
    ///
    /// A skip without a reason may be anything, and is left out.
    pub fn looked_at(&self) -> Vec<([SegmentRef; 2], bool)> {
        let looked_at = self.queries.iter().filter(|asked| asked.transition.is_none()).filter_map(|asked| {
            let is_bad = match asked.answer()?.answer.response {
                Response::Skipped(None | Some(SkipReason::Other)) => return None,
                response => response == Response::Skipped(Some(SkipReason::Hallucinated)),
            };
            Some(([asked.query.left, asked.query.right], is_bad))
        });
        looked_at.collect()
    }

    /// How many of a hundred pairs are held back for their anomaly scores.
    pub fn held_back(&self) -> u8 {
        self.held_back
    }

    /// The steps of dreams in use that drivers marked as unsafe.
    pub fn marks(&self) -> Vec<(DreamId, usize)> {
        let in_use = self.dreams.iter().filter(|kept| !self.is_dropped(kept.dream));
        let marks = in_use.flat_map(|kept| kept.marks.iter().map(|mark| (kept.dream, *mark)));
        marks.collect()
    }

    /// The transitions that a verdict was given on, in the order of answering.
    pub fn judged(&self) -> Vec<JudgedTransition> {
        let judged = |given: &&Given| -> Option<JudgedTransition> {
            let Response::Judged(verdict) = given.answer.response else { return None };
            let transition = self.query(given.answer.query)?.transition?;
            Some(JudgedTransition { query: given.answer.query, transition, verdict })
        };
        self.answers().iter().filter_map(judged).collect()
    }

    /// The rewards that were learned, the last one last.
    pub fn fits(&self) -> &[FittedReward] {
        &self.fits
    }

    /// How many lines the log has.
    pub fn n_entries(&self) -> u64 {
        self.n_entries
    }

    /// When something last happened, in milliseconds since 1970.
    pub fn last_at(&self) -> Option<u64> {
        self.last_at
    }

    /// Seconds spent with queries by each annotator, at most a minute with each.
    pub fn active_secs(&self) -> impl Iterator<Item = (&str, f32)> {
        let mut active_secs: BTreeMap<&str, f32> = BTreeMap::new();
        for spent in &self.spent {
            *active_secs.entry(&spent.annotator).or_default() += spent.secs.min(statistics::IDLE_SECS);
        }
        active_secs.into_iter()
    }

    /// How the answering goes.
    pub fn statistics(&self) -> Statistics {
        Statistics::of(self)
    }

    /// The protocols of the answers that count, or the present one where there is none, in the order of the paper.
    pub fn protocols(&self) -> Vec<Protocol> {
        let answered = |protocol: &Protocol| {
            self.queries.iter().filter_map(AskedQuery::answer).any(|given| given.protocol == *protocol)
        };
        let found: Vec<_> = Protocol::ALL.into_iter().filter(answered).collect();
        if found.is_empty() { vec![self.protocol] } else { found }
    }

    /// How many answers that count were given by each annotator.
    pub fn annotators(&self) -> BTreeMap<&str, usize> {
        let mut annotators = BTreeMap::new();
        for given in self.queries.iter().filter_map(AskedQuery::answer) {
            *annotators.entry(given.answer.annotator.as_str()).or_default() += 1;
        }
        annotators
    }
}

#[cfg(test)]
mod schema;
#[cfg(test)]
mod tests;
