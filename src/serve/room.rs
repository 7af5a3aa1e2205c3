//! One annotator's session: what is asked next, what was said, and whether it counts.
//!
//! # Said once
//!
//! A page whose connection broke does not know whether its last answer arrived, and sends it again. So whatever is said has
//! a number: how many things had been said in the log before it, as far as the page knew. The log decides:
//!
//! - where as many stand in it, it is new: it is written down, and once it is on disk it is acknowledged;
//! - where the same stands in it under this number or after it, it has arrived before and is acknowledged again;
//! - anything else is a page that has not seen what was said elsewhere, such as on another screen: it is told the number that
//!   is next (409), and sends the same with that.
//!
//! Nothing else has to be remembered, so that a server that was killed knows as much as one that was not.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::app::Budget;
use crate::app::label::{AWAY_AFTER, LEAST_SECS, NORMAL_SPEED, REST, run_up, verdict_name};
use crate::dream::DreamEpisode;
use crate::query::{DreamId, Protocol, QueryId, Response, SEGMENT_LEN, SegmentRef, SkipReason};
use crate::serve::http::Refused;
use crate::session::{Answer, AskedQuery, Event, Given, SessionStore};
use crate::text::shown;
use crate::world::{EventKind, WorldSpec};

/// So many queries a page knows ahead: what it can go on with while the server is away.
const N_AHEAD: usize = 24;
/// So many answers it can take back while the server is away.
const N_BACK: usize = 12;

/// One annotator's session.
#[derive(Debug)]
pub(super) struct Room {
    annotator: String,
    store: SessionStore,
    spec: Arc<WorldSpec>,
    /// What the session's dreams are called where clips are drawn; those that cannot be read are not there.
    dreams: BTreeMap<DreamId, DreamId>,
    /// Which lines of the log tell of what was said.
    said: Vec<usize>,
}

/// What is said to a query, and its number.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Numbered {
    nr: usize,
    act: Act,
}

/// What is said.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Act {
    /// It is answered or skipped, after so many seconds and loops.
    Answer { query: QueryId, response: Response, secs: f32, loops: u32 },
    /// Why it was skipped.
    Explain { query: QueryId, reason: SkipReason },
    /// Its answer is taken back.
    Undo { query: QueryId },
    /// The answer that was taken back counts again.
    Redo { query: QueryId },
    /// It is marked for a second look.
    Flag { query: QueryId },
    /// That mark is removed.
    Unflag { query: QueryId },
}

/// All that a page needs to know.
#[derive(Debug, Serialize)]
pub(super) struct View {
    annotator: String,
    session: String,
    protocol: Protocol,
    protocol_name: &'static str,
    /// The most severe first, the default last.
    justifications: Vec<String>,
    /// Of unsafe, neither and good.
    verdicts: [String; 3],
    n_frames: usize,
    /// Frames a second at the usual speed.
    rate: f64,
    /// Frames for which a clip stands at its end.
    rest: f64,
    /// Seconds without a sign of anybody after which nobody is there.
    away_after: f64,
    /// Seconds before which a pair cannot have been seen.
    least_secs: f64,
    /// The number of what is said next.
    nr: usize,
    n_done: usize,
    n_all: usize,
    /// How far it is, in words.
    progress: String,
    /// What the last answer means.
    said: Option<String>,
    /// The query that was skipped last and can be given a reason.
    skipped: Option<QueryId>,
    redo: Option<QueryId>,
    /// What is asked next.
    next: Vec<Card>,
    /// What was answered, the last first.
    latest: Vec<Card>,
}

impl View {
    /// Frames a second at the usual speed.
    pub(super) fn rate(&self) -> f64 {
        self.rate
    }
}

/// A query as a page shows it.
#[derive(Debug, Serialize)]
struct Card {
    query: QueryId,
    /// The frames that are played: from the first to before the second.
    span: [usize; 2],
    /// The frame of the outcome, where a transition is asked about.
    #[serde(skip_serializing_if = "Option::is_none")]
    outcome: Option<usize>,
    /// Its place in its trajectory, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    place: Option<usize>,
    is_flagged: bool,
}

impl Room {
    /// `dreams` is what the session's are called where clips are drawn.
    pub(super) fn new(
        annotator: String,
        store: SessionStore,
        spec: Arc<WorldSpec>,
        dreams: BTreeMap<DreamId, DreamId>,
    ) -> Self {
        let entries = store.entries().iter().enumerate();
        let said = entries.filter(|(_, entry)| is_said(&entry.event)).map(|(i, _)| i).collect();
        Self { annotator, store, spec, dreams, said }
    }

    pub(super) fn annotator(&self) -> &str {
        &self.annotator
    }

    pub(super) fn store(&self) -> &SessionStore {
        &self.store
    }

    /// How many queries were answered or skipped, and how many there are.
    pub(super) fn n_done(&self) -> (usize, usize) {
        let so_far = self.store.session().statistics();
        let n_done = so_far.n_answered + so_far.n_skipped;
        (n_done, n_done + self.pending().count())
    }

    /// The queries to answer, in their order.
    fn pending(&self) -> impl Iterator<Item = &AskedQuery> {
        let session = self.store.session();
        session.pending().filter(|asked| self.is_shown(asked))
    }

    /// Whether a query is one that is asked now, and can be seen.
    fn is_shown(&self, asked: &AskedQuery) -> bool {
        let session = self.store.session();
        let is_readable =
            [asked.query.left, asked.query.right].iter().all(|it| self.dreams.contains_key(&it.dream));
        session.is_of(asked, session.protocol()) && session.is_in_use(asked) && is_readable
    }

    /// All that a page needs to know now.
    pub(super) fn view(&self) -> View {
        let (session, weights) = (self.store.session(), self.store.session().weights());
        let kinds = [EventKind::Safety, EventKind::Progress].map(|kind| verdict_name(&self.spec, kind));
        let [unsafe_name, good] = kinds;
        let (n_done, n_all) = self.n_done();
        let mut answers = session.answers();
        answers.reverse();
        let last = answers.first().filter(|given| self.is_last_said(given)).map(|given| &given.answer);
        let skipped =
            last.filter(|answer| answer.response == Response::Skipped(None)).map(|answer| answer.query);
        let answered = answers.iter().filter_map(|given| session.query(given.answer.query));
        let redo = session.redoable().and_then(|id| session.query(id)).filter(|asked| self.is_shown(asked));
        View {
            annotator: shown(&self.annotator),
            session: self.store.dir().file_name().map_or_else(String::new, |it| shown(&it.to_string_lossy())),
            protocol: session.protocol(),
            protocol_name: session.protocol().name(),
            justifications: weights.justifications.iter().map(|(_, name, _)| shown(name)).collect(),
            verdicts: [unsafe_name, "Neither".to_owned(), good],
            n_frames: SEGMENT_LEN,
            rate: NORMAL_SPEED * (self.spec.rate / NORMAL_SPEED).min(1.0),
            rest: REST,
            away_after: AWAY_AFTER,
            least_secs: LEAST_SECS,
            nr: self.said.len(),
            n_done,
            n_all,
            progress: Budget::Queries(n_all as u32).say(&session.statistics()),
            said: last.map(|answer| weights.say(&answer.response)),
            skipped,
            redo: redo.map(|asked| asked.query.id),
            next: self.pending().take(N_AHEAD).map(card).collect(),
            latest: answered.filter(|asked| self.is_shown(asked)).take(N_BACK).map(card).collect(),
        }
    }

    /// Whether nothing else was said after this answer but why it was skipped.
    fn is_last_said(&self, given: &Given) -> bool {
        let after = self.said.iter().rev().take_while(|line| **line as u64 > given.seq);
        let mut after = after.map(|line| &self.store.entries()[*line].event);
        after.all(|event| {
            matches!(event, Event::SkipExplained { .. } | Event::Flagged { .. } | Event::Unflagged { .. })
        })
    }

    /// Takes in what was said. When this returns it is on disk, or it does not count.
    pub(super) fn act(&mut self, told: &Numbered) -> Result<(), Refused> {
        let event = self.event(&told.act);
        let known = self.said.iter().skip(told.nr).map(|line| &self.store.entries()[*line].event);
        if known.into_iter().any(|known| *known == event) {
            return Ok(());
        }
        if told.nr != self.said.len() {
            let why = "something else was said meanwhile".to_owned();
            return Err(Refused { status: 409, why, nr: Some(self.said.len()) });
        }
        self.store.session().check(&event).map_err(|why| Refused::new(422, why.to_string()))?;
        self.store.record(event).map_err(|met| {
            // The page keeps it, and says it again.
            while self.store.forget_unsaved().is_some() {}
            log::error!("{met}");
            Refused::new(503, format!("it cannot be written down: {met}"))
        })?;
        self.said.push(self.store.entries().len() - 1);
        Ok(())
    }

    /// What an act is in the log: the same as in the window.
    fn event(&self, act: &Act) -> Event {
        match *act {
            Act::Answer { query, response, secs, loops } => {
                Event::Answered(Answer { loops, ..Answer::new(query, response, secs, &self.annotator) })
            }
            Act::Explain { query, reason } => Event::SkipExplained { query, reason },
            Act::Undo { query } => Event::Retracted { query },
            Act::Redo { query } => Event::Restored { query },
            Act::Flag { query } => Event::Flagged { query },
            Act::Unflag { query } => Event::Unflagged { query },
        }
    }

    /// The clips of a query, as they are called where they are drawn.
    pub(super) fn clips(&self, id: QueryId) -> Option<[SegmentRef; 2]> {
        let asked = self.store.session().query(id).filter(|asked| self.is_shown(asked))?;
        let at =
            |segment: SegmentRef| Some(SegmentRef { dream: *self.dreams.get(&segment.dream)?, ..segment });
        Some([at(asked.query.left)?, at(asked.query.right)?])
    }
}

fn card(asked: &AskedQuery) -> Card {
    let outcome = asked.transition.map(|transition| transition.outcome_in(asked.query.left.start));
    let span = outcome.map_or(0..SEGMENT_LEN, run_up);
    Card {
        query: asked.query.id,
        span: [span.start, span.end],
        outcome,
        place: asked.transition.map(|transition| transition.place() + 1),
        is_flagged: asked.is_flagged,
    }
}

/// Whether an annotator said this.
fn is_said(event: &Event) -> bool {
    matches!(
        event,
        Event::Answered(_)
            | Event::SkipExplained { .. }
            | Event::Retracted { .. }
            | Event::Restored { .. }
            | Event::Flagged { .. }
            | Event::Unflagged { .. }
    )
}

/// The dreams of a session that can be read, by what they are called where clips are drawn: their places in `known`, where
/// those of the same content, by its hash, are one.
pub(super) fn read_dreams(
    store: &SessionStore,
    known: &mut Vec<(String, DreamEpisode)>,
) -> BTreeMap<DreamId, DreamId> {
    let mut names = BTreeMap::new();
    for (id, _) in store.session().dream_lens() {
        let Some(kept) = store.session().dreams().get(id.0 as usize) else { continue };
        let place = match known.iter().position(|(hash, _)| *hash == kept.sha256) {
            Some(place) => place,
            None => match store.dream(id) {
                Ok(dream) => {
                    known.push((kept.sha256.clone(), dream));
                    known.len() - 1
                }
                Err(met) => {
                    log::warn!("nothing is asked about dream {}: {met}", id.0 + 1);
                    continue;
                }
            },
        };
        names.insert(id, DreamId(place as u32));
    }
    names
}
