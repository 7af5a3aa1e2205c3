//! Answering queries, taking answers back, and showing the clips.

use crate::app::label::pair::Pair;
use crate::app::label::query_selection::is_held_back;
use crate::app::label::seen::Shown;
use crate::app::{App, Panel, Tick};
use crate::query::{
    JudgedTransition, Justification, Preference, Protocol, Query, QueryId, Response, SafetyAnswer,
    SegmentRef, SkipReason,
};
use crate::session::{Answer, Choice, Event, Session};
use crate::worker::{ClipperCommand, TrainerCommand, WorkerCommand};
use crate::world::Frame;

/// Queries that are drawn before they are needed.
const N_AHEAD: usize = 5;
/// Frames for which a clip stands at its end before it begins again.
pub(crate) const REST: f64 = 5.0;
/// Pairs of clips that are kept, so that undoing shows them at once.
const N_PAIRS: usize = 40;
/// Seconds after which another query is drawn where one could not be written down.
const ASK_AGAIN_AFTER: f64 = 5.0;

impl App {
    pub(super) fn change_protocol(&mut self, protocol: Protocol) {
        if protocol != self.state.protocol() {
            self.record(Event::ProtocolChanged { protocol });
        }
    }

    /// Other questions are asked from here on.
    fn protocol_changed(&mut self, protocol: Protocol) {
        // What is being synthesized is asked about under ReQueST alone.
        self.synthesize(protocol == Protocol::Request);
        self.next_query(self.state.label.revisited.filter(|query| self.state.is_asked_now(*query)));
    }

    /// Goes on now that `event` is on disk and counts: the labels, what is shown and what is asked next follow from it.
    pub(in crate::app) fn recorded(&mut self, event: &Event) {
        match event {
            Event::Answered(answer) => self.answered(answer),
            Event::SkipExplained { reason, .. } => self.skip_explained(*reason),
            Event::Retracted { query } => self.retracted(*query),
            Event::Restored { query } => {
                self.tell_trainer(*query);
                self.next_query(None);
            }
            Event::ProtocolChanged { protocol } => self.protocol_changed(*protocol),
            Event::WeightsChanged { .. } => self.weights_changed(),
            Event::DreamDropped { dream } => self.dream_deleted(*dream),
            Event::DreamRestored { dream } => self.done(format!("dream {} is back", dream.0 + 1)),
            Event::Asked { .. }
            | Event::AskedTransition { .. }
            | Event::Flagged { .. }
            | Event::Unflagged { .. }
            | Event::ScreenChanged { .. }
            | Event::DreamKept(_)
            | Event::Fitted { .. } => {}
        }
    }

    /// A query could not be written down: a full disk is not asked sixty times a second whether it is still full.
    pub(in crate::app) fn not_asked(&mut self) {
        self.state.label.ask_again_at = self.state.now + ASK_AGAIN_AFTER;
    }

    pub(super) fn ask_about(&mut self, left: SegmentRef, right: SegmentRef, choice: Choice) {
        let Some(query) = self.state.session().map(Session::next_query_id) else { return };
        self.record(Event::Asked { query, left, right, choice });
    }

    pub(super) fn answer_for(&mut self, query: QueryId, response: Response, annotator: &str) {
        self.record(Event::Answered(Answer::new(query, response, 0.0, annotator)));
    }

    pub(super) fn answer(&mut self, response: Response) {
        let Some(query) = self.state.label.shown.map(|shown| shown.query) else { return };
        if !self.state.protocol().permits(&response)
            || self.state.current().is_none_or(|next| next.id != query)
            || !self.is_seen()
        {
            return;
        }
        let secs = self.state.label.clock.watched();
        let annotator = self.annotator();
        let loops = self.state.label.loops;
        self.record(Event::Answered(Answer { loops, ..Answer::new(query, response, secs, &annotator) }));
    }

    fn answered(&mut self, answer: &Answer) {
        let response = answer.response;
        let said = self.state.weights().say(&response);
        let label = &mut self.state.label;
        label.said = Some(said);
        label.skipped = matches!(response, Response::Skipped(None)).then_some(answer.query);
        if matches!(response, Response::Skipped(Some(_))) {
            self.learn_doubt();
        }
        self.next_query(None);
        self.tell_trainer(answer.query);
    }

    pub(super) fn revisit(&mut self, id: QueryId) {
        if !self.state.is_asked_now(id) {
            return self
                .note("this was asked under another protocol: choose that to answer it again".to_owned());
        }
        let label = &mut self.state.label;
        (label.revisited, label.said, label.skipped) = (Some(id), None, None);
        label.guided.clear();
    }

    /// Goes to the next query, or to `revisited` if that is given, as if nothing had been said about it yet.
    pub(in crate::app) fn next_query(&mut self, revisited: Option<QueryId>) {
        let label = &mut self.state.label;
        label.revisited = revisited;
        label.active = None;
        label.guided.clear();
        label.shown = None;
        self.ask();
        // The next pair is on the graphics card already: it is in the very next picture of the window.
        let current = self.state.current().map(|query| query.id);
        let label = &mut self.state.label;
        label.shown = current.filter(|id| label.pairs.contains_key(id)).map(Shown::new);
        (label.loops, label.is_standing) = (0, false);
        label.clock.begin(self.state.now);
        self.state.label.playhead = self.state.span().start;
    }

    pub(super) fn answer_guided(&mut self, is_safe: bool) {
        let is_asked = self.state.protocol() == Protocol::Dropj && self.state.label.guided.len() < 2;
        if !is_asked || !self.is_seen() {
            return;
        }
        let guided = &mut self.state.label.guided;
        guided.push(is_safe);
        let answer = match guided[..] {
            [true, false] => SafetyAnswer::OnlyLeft,
            [false, true] => SafetyAnswer::OnlyRight,
            [false, false] => SafetyAnswer::Neither,
            _ => return,
        };
        self.answer(Response::Safety(answer));
    }

    pub(super) fn explain_skip(&mut self, reason: SkipReason) {
        if let Some(query) = self.state.label.skipped {
            self.record(Event::SkipExplained { query, reason });
        }
    }

    fn skip_explained(&mut self, reason: SkipReason) {
        self.learn_doubt();
        let why = match reason {
            SkipReason::Hallucinated => "the dream does not look like the world",
            SkipReason::Ambiguous => "the clips cannot be told apart",
            SkipReason::Other => "another reason",
        };
        let label = &mut self.state.label;
        (label.skipped, label.said) = (None, Some(format!("skipped: {why}")));
    }

    /// Makes a justification active, or no longer.
    pub(super) fn justify(&mut self, justification: Justification) {
        let default = self.state.weights().justifications.default();
        let label = &mut self.state.label;
        label.active = Some(label.active.unwrap_or(default.into()).toggled(justification, default));
    }

    pub(super) fn undo(&mut self) {
        if self.state.label.guided.pop().is_some() {
            return;
        }
        // What did not get to disk was said last.
        if self.forget_last_unsaved() {
            return;
        }
        if let Some(query) = self.state.session().and_then(Session::undoable) {
            self.record(Event::Retracted { query });
        }
    }

    fn retracted(&mut self, query: QueryId) {
        (self.state.label.said, self.state.label.skipped) = (None, None);
        self.tell_trainer(query);
        self.next_query(Some(query).filter(|query| self.state.is_asked_now(*query)));
    }

    pub(super) fn redo(&mut self) {
        if let Some(query) = self.state.session().and_then(Session::redoable) {
            self.record(Event::Restored { query });
        }
    }

    pub(super) fn flag(&mut self) {
        let Some(query) = self.state.current().map(|query| query.id) else { return };
        if self.state.label.shown.is_none_or(|shown| shown.query != query) || !self.is_seen() {
            return;
        }
        let is_flagged =
            self.state.session().and_then(|s| s.query(query)).is_some_and(|asked| asked.is_flagged);
        self.record(if is_flagged { Event::Unflagged { query } } else { Event::Flagged { query } });
    }

    /// Tells the trainer what counts for a query now.
    pub(in crate::app) fn tell_trainer(&mut self, query: QueryId) {
        let Some(session) = self.state.session() else { return };
        let Some(asked) = session.query(query) else { return };
        if asked.repeats().is_some() {
            return;
        }
        let said = asked.answer().map(|given| given.answer.response);
        let command = match (session.label_of(query, session.weights()), said, asked.transition) {
            (Some(labeled), ..) => TrainerCommand::Learn(labeled.query, labeled.label),
            (None, Some(Response::Judged(verdict)), Some(transition)) => {
                TrainerCommand::LearnVerdict(JudgedTransition { query, transition, verdict })
            }
            _ => TrainerCommand::Forget(query),
        };
        self.send(WorkerCommand::Trainer(command));
    }

    /// Draws queries and has their clips decoded before they are needed.
    pub(in crate::app) fn ask(&mut self) {
        // Nothing is drawn for nobody.
        if self.state.panel != Panel::Label {
            return;
        }
        // What is on its way to disk is to be known before anything else is drawn.
        if !self.writing.is_empty() {
            return self.decode_ahead();
        }
        if self.state.protocol().is_sparse() {
            let missing = N_AHEAD.saturating_sub(self.state.upcoming().len());
            self.ask_transitions(missing);
            self.synthesize_ahead();
            return self.decode_ahead();
        }
        if self.state.now >= self.state.label.ask_again_at && self.note_screen() {
            // Those that are held back come last, so others are drawn before them.
            let is_good = |query: &&Query| !is_held_back(&self.state, query);
            let n_waiting = self.state.upcoming().iter().filter(is_good).count();
            if n_waiting < N_AHEAD
                && let Some(([left, right], choice)) = self.select_query(n_waiting)
            {
                self.ask_about(left, right, choice);
            }
        }
        self.decode_ahead();
    }

    /// Has the clips of the next queries drawn.
    fn decode_ahead(&mut self) {
        for query in self.state.upcoming().into_iter().take(N_AHEAD) {
            let label = &mut self.state.label;
            if !label.pairs.contains_key(&query.id) && !label.asked.contains(&query.id) {
                label.asked.push(query.id);
                self.send(WorkerCommand::Clipper(ClipperCommand::Decode(query)));
            }
        }
    }

    /// The clips of a query are decoded, unless it was drawn for a session before this one.
    pub(super) fn clips_decoded(&mut self, query: Query, left: &[Frame], right: &[Frame]) {
        if self.state.session().and_then(|s| s.query(query.id)).is_none_or(|asked| asked.query != query) {
            return;
        }
        let clip = |frames: &[Frame]| frames.iter().map(crate::app::Picture::from).collect();
        let pair = Pair { left: clip(left), right: clip(right) };
        self.state.label.asked.retain(|asked| *asked != query.id);
        self.keep_thumbnail(query.id, &pair);
        self.state.label.pairs.insert(query.id, pair);
        self.forget_far_pairs();
    }

    fn forget_far_pairs(&mut self) {
        let wanted: Vec<QueryId> = self.state.upcoming().iter().take(8).map(|query| query.id).collect();
        let pairs = &mut self.state.label.pairs;
        while pairs.len() > N_PAIRS {
            let Some(far) = pairs.keys().find(|id| !wanted.contains(id)).copied() else { break };
            pairs.remove(&far);
        }
    }

    /// Keeps the next clips ready, and moves those on the screen.
    pub(in crate::app) fn advance_clips(&mut self, tick: Tick) {
        if self.state.panel != Panel::Label {
            self.state.label.shown = None;
            return;
        }
        self.ask();
        self.show_ready();
        if let Some(query) = self.state.reconsidered() {
            self.predict(query);
        }
        let now = self.state.now;
        let has_focus = tick.has_focus && !self.state.is_covered();
        let (span, rate) = (self.state.span(), self.state.clip_rate());
        let label = &mut self.state.label;
        let is_ready = label.shown.is_some();
        if is_ready {
            label.clock.pass(now, has_focus);
        }
        if is_ready && !label.is_standing && !label.clock.is_away(now) {
            label.playhead += tick.dt.min(0.25) * rate;
            let end = span.end + REST;
            if label.playhead >= end {
                label.playhead = span.start + (label.playhead - end) % (end - span.start);
                label.loops += 1;
            }
        }
    }

    /// Shows the query that comes next once its clips are decoded.
    fn show_ready(&mut self) {
        let current = self.state.current().map(|query| query.id);
        let now = self.state.now;
        let label = &mut self.state.label;
        let ready = current.filter(|id| label.pairs.contains_key(id));
        if label.shown.map(|shown| shown.query) != ready {
            label.shown = ready.map(Shown::new);
            (label.loops, label.is_standing) = (0, false);
            label.clock.begin(now);
            self.state.label.playhead = self.state.span().start;
        }
    }
}

/// The preference that an arrow means.
pub(crate) const PREFERENCES: [Preference; 3] = [Preference::Left, Preference::Equal, Preference::Right];
