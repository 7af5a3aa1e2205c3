//! What is done with queries: asking, answering, and taking back.

use crate::query::{
    JudgedTransition, Preference, Protocol, Query, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SkipReason,
};
use crate::session::{Answer, Event, Session};
use crate::ui::App;
use crate::ui::choosing::is_held_back;
use crate::ui::command::{Command, Field};
use crate::ui::crew::Order;
use crate::ui::seen::Shown;
use crate::worker::{ClipperCommand, TrainerCommand};

/// Queries that are drawn before they are needed.
const N_AHEAD: usize = 5;
/// The slowest and the fastest clips, in frames a second.
const SPEEDS: [f64; 7] = [5.0, 10.0, 15.0, 25.0, 35.0, 50.0, 100.0];

impl App {
    pub(super) fn change_protocol(&mut self, protocol: Protocol) {
        if protocol != self.state.protocol() && self.record(Event::ProtocolChanged { protocol }) {
            // What is being made is asked about under ReQueST alone.
            self.make_trajectories(protocol == Protocol::Request);
            self.next_query(self.state.label.revisited.filter(|query| self.state.is_asked_now(*query)));
        }
    }

    pub(super) fn act_on_label(&mut self, command: Command) {
        let label = &mut self.state.label;
        match command {
            Command::Answer(response) => self.answer(response),
            Command::GuidedSafe(is_safe) => self.answer_guided(is_safe),
            Command::Guide(is_guided) => (label.is_guided, label.guided) = (is_guided, Vec::new()),
            Command::ToggleAnswers => label.is_list_open = !label.is_list_open,
            Command::MakeTrajectories(is_wanted) => self.make_trajectories(is_wanted),
            Command::Ask(asking) => label.asking = asking.clamped(),
            Command::Justify(justification) => label.justification = Some(justification),
            Command::GiveReason(reason) => self.give_reason(reason),
            Command::Undo => self.undo(),
            Command::Redo => self.redo(),
            Command::Flag => self.flag(),
            Command::Revisit(id) => self.revisit(id),
            Command::Budget(budget) => label.budget = budget,
            Command::BreakAfter(minutes) => label.break_minutes = minutes,
            Command::PutOffBreak => label.pace.put_off(label.break_minutes),
            Command::Glance(queries) => self.glance(&queries),
            Command::ScrubClips(playhead) => {
                (label.playhead, label.is_standing) = (playhead.clamp(0.0, SEGMENT_LEN as f64 - 0.01), true);
            }
            Command::RestartClips => {
                label.is_standing = false;
                self.state.label.playhead = self.state.span().start;
            }
            Command::PauseClips => label.is_standing = !label.is_standing,
            Command::StepClips(n) => {
                label.is_standing = true;
                let frame = (label.playhead as i32).min(SEGMENT_LEN as i32 - 1) + n;
                label.playhead = f64::from(frame.rem_euclid(SEGMENT_LEN as i32)) + 0.5;
            }
            Command::Faster(is_faster) => {
                let slower = SPEEDS.iter().rev().find(|speed| **speed < label.speed);
                let faster = SPEEDS.iter().find(|speed| **speed > label.speed);
                label.speed = *(if is_faster { faster } else { slower }).unwrap_or(&label.speed);
            }
            _ => {}
        }
    }

    fn answer(&mut self, response: Response) {
        let Some(query) = self.state.label.shown.map(|shown| shown.query) else { return };
        if !self.state.protocol().permits(&response)
            || self.state.current().is_none_or(|next| next.id != query)
            || !self.is_seen()
        {
            return;
        }
        let secs = self.state.label.pace.watched();
        let annotator = self.annotator();
        let answer =
            Answer { loops: self.state.label.loops, ..Answer::new(query, response, secs, &annotator) };
        if !self.record(Event::Answered(answer)) {
            return;
        }
        let said = self.state.weights().say(&response);
        let label = &mut self.state.label;
        label.said = Some(said);
        label.skipped = matches!(response, Response::Skipped(None)).then_some(query);
        if matches!(response, Response::Skipped(Some(_))) {
            self.learn_doubt();
        }
        self.next_query(None);
        self.teach(query);
    }

    fn revisit(&mut self, id: QueryId) {
        if !self.state.is_asked_now(id) {
            return self
                .note("this was asked under another protocol: choose that to answer it again".to_owned());
        }
        let label = &mut self.state.label;
        (label.revisited, label.said, label.skipped) = (Some(id), None, None);
        label.guided.clear();
    }

    /// Who answers.
    pub(super) fn annotator(&self) -> String {
        let typed = self.state.field(Field::Annotator).trim();
        let given = self.state.header().map_or("anonymous", |header| header.config.annotator.as_str());
        if typed.is_empty() { given.to_owned() } else { typed.to_owned() }
    }

    /// Goes to the next query, or to `revisited` if that is given, as if nothing had been said about it yet.
    pub(super) fn next_query(&mut self, revisited: Option<QueryId>) {
        let label = &mut self.state.label;
        label.revisited = revisited;
        label.justification = None;
        label.guided.clear();
        label.shown = None;
        self.ask();
        // The next pair is on the graphics card already: it is in the very next picture of the window.
        let current = self.state.current().map(|query| query.id);
        let label = &mut self.state.label;
        label.shown = current.filter(|id| label.pairs.contains_key(id)).map(Shown::new);
        (label.loops, label.is_standing) = (0, false);
        label.pace.begin(self.state.now);
        self.state.label.playhead = self.state.span().start;
    }

    fn answer_guided(&mut self, is_safe: bool) {
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

    fn give_reason(&mut self, reason: SkipReason) {
        let Some(query) = self.state.label.skipped else { return };
        if !self.record(Event::SkipExplained { query, reason }) {
            return;
        }
        self.learn_doubt();
        let why = match reason {
            SkipReason::Hallucinated => "the dream does not look like the world",
            SkipReason::Ambiguous => "the clips cannot be told apart",
            SkipReason::Other => "another reason",
        };
        let label = &mut self.state.label;
        (label.skipped, label.said) = (None, Some(format!("skipped: {why}")));
    }

    fn undo(&mut self) {
        if self.state.label.guided.pop().is_some() {
            return;
        }
        // What did not get to disk was said last.
        if self.forget_unsaved_event() {
            return;
        }
        let Some(query) = self.state.session().and_then(Session::undoable) else { return };
        if !self.record(Event::Retracted { query }) {
            return;
        }
        (self.state.label.said, self.state.label.skipped) = (None, None);
        self.teach(query);
        self.next_query(Some(query).filter(|query| self.state.is_asked_now(*query)));
    }

    fn redo(&mut self) {
        let Some(query) = self.state.session().and_then(Session::redoable) else { return };
        if self.record(Event::Restored { query }) {
            self.teach(query);
            self.next_query(None);
        }
    }

    fn flag(&mut self) {
        let Some(query) = self.state.current().map(|query| query.id) else { return };
        if self.state.label.shown.is_none_or(|shown| shown.query != query) || !self.is_seen() {
            return;
        }
        let is_flagged =
            self.state.session().and_then(|s| s.query(query)).is_some_and(|asked| asked.is_flagged);
        self.record(if is_flagged { Event::Unflagged { query } } else { Event::Flagged { query } });
    }

    /// Tells the trainer what counts for a query now.
    pub(super) fn teach(&mut self, query: QueryId) {
        let Some(session) = self.state.session() else { return };
        let Some(asked) = session.query(query) else { return };
        if asked.repeats().is_some() {
            return;
        }
        let said = asked.answer().map(|given| given.answer.response);
        let command = match (session.label_of(query, session.weights()), said, asked.transition) {
            (Some(labeled), ..) => TrainerCommand::Learn(labeled.query, labeled.label),
            (None, Some(Response::Judged(verdict)), Some(transition)) => {
                TrainerCommand::Judge(JudgedTransition { query, transition, verdict })
            }
            _ => TrainerCommand::Forget(query),
        };
        self.crew.send(Order::Trainer(command));
    }

    /// Draws queries and has their clips drawn before they are needed.
    pub(super) fn ask(&mut self) {
        let missing = N_AHEAD.saturating_sub(self.state.upcoming().len());
        if self.state.protocol().is_sparse() {
            self.ask_transitions(missing);
            self.make_ahead();
            return self.decode_ahead();
        }
        while self.state.now >= self.state.label.ask_again_at {
            // Those that are held back come last, so others are drawn before them.
            let is_good = |query: &&Query| !is_held_back(&self.state, query);
            let n_waiting = self.state.upcoming().iter().filter(is_good).count();
            if n_waiting >= N_AHEAD || !self.note_screen() {
                break;
            }
            let Some(([left, right], choice)) = self.choose(n_waiting) else { break };
            let Some(query) = self.state.session().map(Session::next_query_id) else { break };
            if !self.record(Event::Asked { query, left, right, choice }) {
                // A full disk is not asked sixty times a second whether it is still full.
                self.state.label.ask_again_at = self.state.now + 5.0;
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
                self.crew.send(Order::Clipper(ClipperCommand::Decode(query)));
            }
        }
    }
}

/// The preference that an arrow means.
pub(super) const PREFERENCES: [Preference; 3] = [Preference::Left, Preference::Equal, Preference::Right];
