//! Labeling: which query is on the screen, its clips, what is answered, and what comes next.

mod answer;
mod budget;
mod pair;
mod predictions;
mod query_selection;
mod seen;
mod thumbnails;
mod trajectories;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

pub use budget::Budget;
pub use query_selection::QuerySelection;
pub use seen::Moment;

pub(crate) use answer::{PREFERENCES, REST};
pub(crate) use budget::AWAY_AFTER;
pub(crate) use budget::LabelClock;
pub(crate) use pair::Pair;
pub(crate) use predictions::Predictions;
pub(crate) use query_selection::{MOST_HELD_BACK, MOST_REPEATS, obstacles};
pub(crate) use seen::{LEAST_SECS, Shown};
pub(crate) use trajectories::{Synthesis, next_transition};

use query_selection::{Disagreements, is_held_back};

use crate::app::{App, Picture, State};
use crate::dream::Screen;
use crate::query::{
    Active, DreamId, Justification, Protocol, Query, QueryId, Response, SEGMENT_LEN, SegmentRef, SkipReason,
    Transition,
};
use crate::session::{Annotators, Choice, Session};
use crate::worker::LabelReport;
use crate::world::{EventKind, WorldSpec};

/// On queries and their answers.
#[derive(Clone, Debug, PartialEq)]
pub enum LabelCommand {
    /// Asks other questions from here on.
    ChangeProtocol(Protocol),
    /// Asks about this pair, as a script has chosen it.
    Ask([SegmentRef; 2], Choice),
    /// Asks about this transition, as a script has chosen it.
    AskTransition(Transition, Choice),
    /// Answers the query that is shown.
    Answer(Response),
    /// Answers a query without having looked at it on the screen, as a script does for this annotator.
    AnswerFor {
        /// Which.
        query: QueryId,
        /// What is answered.
        response: Response,
        /// Who answers.
        annotator: String,
    },
    /// Says whether a clip stays safe, in the guided questions.
    AnswerGuided(bool),
    /// Asks one question at a time, or all at once.
    Guide(bool),
    /// Opens or closes the list of answers.
    ToggleAnswers,
    /// Synthesizes trajectories where they are needed, or none and not the one that is being synthesized.
    Synthesize(bool),
    /// Chooses how queries are selected.
    SelectQueries(QuerySelection),
    /// Makes a justification active for the next preference, or no longer; the default makes all others inactive.
    Justify(Justification),
    /// Says why the last query was skipped.
    ExplainSkip(SkipReason),
    /// Takes back the last answer.
    Undo,
    /// Gives back what was taken back last.
    Redo,
    /// Marks the query that is shown for a second look, or removes the mark.
    Flag,
    /// Answers this query again.
    Revisit(QueryId),
    /// Sets how much is to be labeled.
    Budget(Budget),
    /// Suggests a pause after so many minutes of labeling; 0 is never.
    BreakAfter(u32),
    /// Says nothing of pauses for a while.
    PutOffBreak,
    /// Has thumbnails of these queries decoded.
    LoadThumbnails(Vec<QueryId>),
    /// Has the reward predict which clip of an answered query is better.
    Predict(QueryId),
    /// Begins the clips anew.
    RestartClips,
    /// Stops the clips, or lets them go on.
    PauseClips,
    /// Moves the standing clips by so many frames.
    StepClips(i32),
    /// Stops the clips here, in frames.
    ScrubClips(f64),
    /// Makes the clips faster, or slower.
    Faster(bool),
    /// Plays clips at so many frames a second.
    Speed(f64),
    /// Shows a few still pictures of a clip after each other, or lets it move.
    ReduceMotion(bool),
}

/// Answering.
#[expect(clippy::struct_excessive_bools, reason = "each is true or not whatever the others are")]
#[derive(Debug)]
pub(crate) struct Labeling {
    /// Dreams whose files are damaged: nothing is shown of them.
    pub unreadable: Vec<DreamId>,
    /// The query that is answered again, before the others.
    pub revisited: Option<QueryId>,
    /// The query that is on the screen.
    pub shown: Option<Shown>,
    /// The query whose answer came before it could be seen, so that it was not taken.
    pub early: Option<QueryId>,
    /// Clips that are ready, by query.
    pub pairs: BTreeMap<QueryId, Pair>,
    /// Queries whose clips have been asked for.
    pub asked: Vec<QueryId>,
    /// A picture of either clip, of queries that were on the screen or in the list of answers.
    pub thumbnails: BTreeMap<QueryId, [Picture; 2]>,
    /// Queries whose thumbnails have been asked for.
    pub thumbnails_asked: BTreeSet<QueryId>,
    /// Where the clips are, in frames.
    pub playhead: f64,
    /// How often they were seen to their end.
    pub loops: u32,
    pub is_standing: bool,
    /// Frames a second, where the world has [`NORMAL_SPEED`] or more: see [`State::clip_rate`].
    pub speed: f64,
    /// Whether a few still pictures of a clip are shown after each other, for whoever does not like what moves.
    pub is_motion_reduced: bool,
    /// Whether the questions come one at a time.
    pub is_guided: bool,
    /// When queries are drawn again after one could not be written down, in seconds since the window opened.
    pub ask_again_at: f64,
    /// Whether the list of answers was asked for.
    pub is_list_open: bool,
    /// What was said to the guided questions so far: whether left is safe, then right.
    pub guided: Vec<bool>,
    /// The justifications that the next preference rests on, where another than the default does.
    pub active: Option<Active>,
    /// The answer given last, in words.
    pub said: Option<String>,
    /// The query that was skipped just now, which can still be given a reason.
    pub skipped: Option<QueryId>,
    /// How much is to be labeled.
    pub budget: Budget,
    /// Minutes of labeling after which a pause is suggested; 0 is never.
    pub break_minutes: u32,
    /// The clock of whoever labels.
    pub clock: LabelClock,
    /// How queries are selected.
    pub selection: QuerySelection,
    /// The trajectories that are synthesized to be asked about.
    pub synthesis: Synthesis,
    /// The pairs whose disagreement is measured.
    pub disagreements: Disagreements,
    /// Who answered about these dreams, as of when that was asked.
    pub annotators: Option<Annotators>,
    /// What is known of bad dreams.
    pub screen: Screen,
    /// What the reward predicts of clips that were answered.
    pub predictions: Predictions,
}

/// Frames a second at which clips of a world of 25 Hz and more are played at first. Those of a slower one are played as
/// fast as it goes.
pub(crate) const NORMAL_SPEED: f64 = 25.0;
/// Frames before the outcome of a transition that are played with it.
const RUN_UP: usize = 7;
/// Minutes of labeling after which a pause is suggested at first.
pub(crate) const BREAK_MINUTES: u32 = 25;

impl Default for Labeling {
    fn default() -> Self {
        Self {
            unreadable: Vec::new(),
            revisited: None,
            shown: None,
            early: None,
            pairs: BTreeMap::new(),
            asked: Vec::new(),
            thumbnails: BTreeMap::new(),
            thumbnails_asked: BTreeSet::new(),
            playhead: 0.0,
            loops: 0,
            is_standing: false,
            speed: NORMAL_SPEED,
            is_motion_reduced: false,
            is_guided: false,
            ask_again_at: 0.0,
            is_list_open: false,
            guided: Vec::new(),
            active: None,
            said: None,
            skipped: None,
            budget: Budget::default(),
            break_minutes: BREAK_MINUTES,
            clock: LabelClock::default(),
            selection: QuerySelection::default(),
            synthesis: Synthesis::default(),
            disagreements: Disagreements::default(),
            annotators: None,
            screen: Screen::default(),
            predictions: Predictions::default(),
        }
    }
}

impl Labeling {
    /// For another session: what the annotator likes stays.
    pub(crate) fn anew(&self) -> Self {
        let Self { speed, is_motion_reduced, is_guided, budget, break_minutes, selection, .. } = *self;
        let clock = self.clock.clone();
        let fresh = Self { speed, is_motion_reduced, is_guided, ..Self::default() };
        Self { budget, break_minutes, clock, selection, ..fresh }
    }
}

/// The queries that come next, the present one first.
pub(crate) type Upcoming = VecDeque<Query>;

impl State {
    /// The queries to answer, the one on the screen first.
    pub(crate) fn upcoming(&self) -> Upcoming {
        let Some(session) = self.session() else { return Upcoming::new() };
        let revisited = self.label.revisited.and_then(|id| session.query(id)).map(|asked| asked.query);
        let (protocol, is_sparse) = (session.protocol(), session.protocol().is_sparse());
        let pending = session.pending().filter(|asked| session.is_of(asked, protocol));
        let pending = pending.map(|asked| asked.query);
        let is_shown = |query: &Query| {
            let dreams = [query.left.dream, query.right.dream];
            !dreams.iter().any(|dream| self.label.unreadable.contains(dream))
        };
        let pending = pending.filter(|query| Some(query.id) != self.label.revisited).filter(is_shown);
        let mut pending: Vec<_> = pending.collect();
        // What is on the screen stays there, and transitions come in their order.
        let shown = self.label.shown.map(|shown| shown.query);
        pending.sort_by_key(|query| !is_sparse && Some(query.id) != shown && is_held_back(self, query));
        revisited.into_iter().chain(pending).collect()
    }

    /// The query that is on the screen.
    pub(crate) fn current(&self) -> Option<Query> {
        self.upcoming().pop_front()
    }

    /// Whether a query is of the kind that is asked about now: a pair of clips, or a transition.
    pub(crate) fn is_asked_now(&self, id: QueryId) -> bool {
        let is_of = |session: &Session| Some(session.is_of(session.query(id)?, session.protocol()));
        self.session().and_then(is_of).unwrap_or(false)
    }

    /// The transition that is on the screen, and the frame of its outcome.
    pub(crate) fn shown_transition(&self) -> Option<(Transition, usize)> {
        let asked = self.session()?.query(self.label.shown?.query)?;
        let transition = asked.transition?;
        Some((transition, transition.outcome_in(asked.query.left.start)))
    }

    /// The frames that are played over and over: all of them, or a run-up to the outcome of a transition.
    pub(crate) fn span(&self) -> Range<f64> {
        match self.shown_transition() {
            None => 0.0..SEGMENT_LEN as f64,
            Some((_, outcome)) => run_up(outcome).start as f64..run_up(outcome).end as f64,
        }
    }

    /// Frames a second at which clips are played.
    pub(crate) fn clip_rate(&self) -> f64 {
        let still = if self.label.is_motion_reduced { STILL_PACE } else { 1.0 };
        self.label.speed * (self.spec.rate / NORMAL_SPEED).min(1.0) * still
    }

    /// The frame that is seen.
    pub(crate) fn frame(&self) -> usize {
        // What is played stands at its end for a moment; what is held can be anywhere.
        let last = if self.label.is_standing { SEGMENT_LEN } else { self.span().end as usize };
        let at = (self.label.playhead as usize).min(last - 1);
        if !self.label.is_motion_reduced || self.label.is_standing || at == last - 1 {
            return at;
        }
        let first = self.span().start as usize;
        first + at.saturating_sub(first) / STILL * STILL
    }
}

/// Frames of a clip for which one of its pictures stands, where motion is reduced.
const STILL: usize = 5;
/// How much slower it goes then: at the usual speed a picture stands for 0.8 s.
const STILL_PACE: f64 = 0.25;

/// The frames of a clip that are played over and over, where a transition with its outcome in this frame is asked about.
pub(crate) fn run_up(outcome: usize) -> Range<usize> {
    outcome.saturating_sub(RUN_UP)..outcome + 1
}

/// What is said of a step in which something of this kind happens: `Unsafe`, a colon and its name.
pub(crate) fn verdict_name(spec: &WorldSpec, kind: EventKind) -> String {
    let word = if kind == EventKind::Safety { "Unsafe" } else { "Good" };
    let events: Vec<_> = spec.events_of(kind).map(|event| event.name.as_str()).collect();
    match events[..] {
        [] => word.to_owned(),
        [one] => format!("{word}: {one}"),
        [one, other] => format!("{word}: {one}, {other}"),
        [one, ..] => format!("{word}: {one} or the like"),
    }
}

/// The slowest and the fastest clips, in frames a second.
const SPEEDS: [f64; 7] = [5.0, 10.0, 15.0, 25.0, 35.0, 50.0, 100.0];

impl App {
    pub(super) fn label_command(&mut self, command: LabelCommand) {
        let label = &mut self.state.label;
        match command {
            LabelCommand::ChangeProtocol(protocol) => self.change_protocol(protocol),
            LabelCommand::Ask([left, right], choice) => self.ask_about(left, right, choice),
            LabelCommand::AskTransition(transition, choice) => self.ask_about_transition(transition, choice),
            LabelCommand::Answer(response) => self.answer(response),
            LabelCommand::AnswerFor { query, response, annotator } => {
                self.answer_for(query, response, &annotator);
            }
            LabelCommand::AnswerGuided(is_safe) => self.answer_guided(is_safe),
            LabelCommand::Guide(is_guided) => (label.is_guided, label.guided) = (is_guided, Vec::new()),
            LabelCommand::ToggleAnswers => label.is_list_open = !label.is_list_open,
            LabelCommand::Synthesize(is_wanted) => self.synthesize(is_wanted),
            LabelCommand::SelectQueries(selection) => label.selection = selection.clamped(),
            LabelCommand::Justify(justification) => self.justify(justification),
            LabelCommand::ExplainSkip(reason) => self.explain_skip(reason),
            LabelCommand::Undo => self.undo(),
            LabelCommand::Redo => self.redo(),
            LabelCommand::Flag => self.flag(),
            LabelCommand::Revisit(id) => self.revisit(id),
            LabelCommand::Budget(budget) => label.budget = budget,
            LabelCommand::BreakAfter(minutes) => label.break_minutes = minutes,
            LabelCommand::PutOffBreak => label.clock.put_off(label.break_minutes),
            LabelCommand::LoadThumbnails(queries) => self.load_thumbnails(&queries),
            LabelCommand::Predict(query) => self.predict(query),
            LabelCommand::ScrubClips(playhead) => {
                (label.playhead, label.is_standing) = (playhead.clamp(0.0, SEGMENT_LEN as f64 - 0.01), true);
            }
            LabelCommand::RestartClips => {
                label.is_standing = false;
                self.state.label.playhead = self.state.span().start;
            }
            LabelCommand::PauseClips => label.is_standing = !label.is_standing,
            LabelCommand::StepClips(n) => {
                label.is_standing = true;
                let frame = (label.playhead as i32).min(SEGMENT_LEN as i32 - 1) + n;
                label.playhead = f64::from(frame.rem_euclid(SEGMENT_LEN as i32)) + 0.5;
            }
            LabelCommand::Faster(is_faster) => {
                let slower = SPEEDS.iter().rev().find(|speed| **speed < label.speed);
                let faster = SPEEDS.iter().find(|speed| **speed > label.speed);
                label.speed = *(if is_faster { faster } else { slower }).unwrap_or(&label.speed);
            }
            LabelCommand::ReduceMotion(is_reduced) => label.is_motion_reduced = is_reduced,
            LabelCommand::Speed(speed) => label.speed = speed.clamp(SPEEDS[0], SPEEDS[SPEEDS.len() - 1]),
        }
    }

    pub(super) fn label_report(&mut self, report: LabelReport) {
        match report {
            LabelReport::Clips { query, left, right } => self.clips_decoded(query, &left, &right),
            LabelReport::Thumbnails { query, frames } => self.thumbnails_decoded(query, &frames),
            LabelReport::Signs { dream, seed, signs } => self.dream_screened(dream, seed, &signs),
            LabelReport::Disagreements { pairs, disagreements } => {
                self.disagreements_measured(&pairs, disagreements.as_deref());
            }
            LabelReport::Predicted { query, clips } => self.predicted(query, clips),
            LabelReport::Synthesizing { seed, done, n } => self.synthesizing(seed, done, n),
            LabelReport::Synthesized { episode, acquisition } => self.synthesized(episode, acquisition),
        }
    }
}
