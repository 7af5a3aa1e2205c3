//! What the label panel shows: which query is on the screen, its clips, and what was said so far.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use eframe::egui::TextureHandle;

use crate::dream::Screen;
use crate::query::{DreamId, Justification, Query, QueryId, SEGMENT_LEN, Transition};
use crate::session::{Annotators, Session};
use crate::ui::choosing::{Asking, Weighing, is_held_back};
use crate::ui::foretelling::Foretelling;
use crate::ui::pace::{Budget, Pace};
use crate::ui::seen::Shown;
use crate::ui::state::State;
use crate::ui::trajectories::Making;
use crate::ui::widgets::clip::Clip;

/// A pair of clips on the graphics card.
pub(crate) struct Pair {
    pub left: Clip,
    pub right: Clip,
}

/// Answering.
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
    pub thumbnails: BTreeMap<QueryId, [TextureHandle; 2]>,
    /// Queries whose thumbnails have been asked for.
    pub glanced: BTreeSet<QueryId>,
    /// Where the clips are, in frames.
    pub playhead: f64,
    /// How often they were seen to their end.
    pub loops: u32,
    pub is_standing: bool,
    /// Frames a second.
    pub speed: f64,
    /// Whether the questions come one at a time.
    pub is_guided: bool,
    /// When queries are drawn again after one could not be written down, in seconds since the window opened.
    pub ask_again_at: f64,
    /// Whether the list of answers was asked for.
    pub is_list_open: bool,
    /// What was said to the guided questions so far: whether left is safe, then right.
    pub guided: Vec<bool>,
    /// The justification that the next preference rests on.
    pub justification: Option<Justification>,
    /// The answer given last, in words.
    pub said: Option<String>,
    /// The query that was skipped just now, which can still be given a reason.
    pub skipped: Option<QueryId>,
    /// How much is to be labeled.
    pub budget: Budget,
    /// Minutes of labeling after which a pause is suggested; 0 is never.
    pub break_minutes: u32,
    /// The clock of whoever labels.
    pub pace: Pace,
    /// What is asked about.
    pub asking: Asking,
    /// The trajectories that are made to be asked about.
    pub making: Making,
    /// What the trainer is asked of that.
    pub weighing: Weighing,
    /// Who answered about these dreams, as of when that was asked.
    pub annotators: Option<Annotators>,
    /// What is known of bad dreams.
    pub screen: Screen,
    /// What the reward says of clips that were answered.
    pub foretelling: Foretelling,
}

/// Frames a second at which clips are played at first: as they were driven.
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
            glanced: BTreeSet::new(),
            playhead: 0.0,
            loops: 0,
            is_standing: false,
            speed: NORMAL_SPEED,
            is_guided: false,
            ask_again_at: 0.0,
            is_list_open: false,
            guided: Vec::new(),
            justification: None,
            said: None,
            skipped: None,
            budget: Budget::default(),
            break_minutes: BREAK_MINUTES,
            pace: Pace::default(),
            asking: Asking::default(),
            making: Making::default(),
            weighing: Weighing::default(),
            annotators: None,
            screen: Screen::default(),
            foretelling: Foretelling::default(),
        }
    }
}

impl Labeling {
    /// For another session: what the annotator likes stays.
    pub(crate) fn anew(&self) -> Self {
        let Self { speed, is_guided, budget, break_minutes, asking, ref pace, .. } = *self;
        let pace = pace.clone();
        Self { speed, is_guided, budget, break_minutes, pace, asking, ..Self::default() }
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
            Some((_, outcome)) => outcome.saturating_sub(RUN_UP) as f64..(outcome + 1) as f64,
        }
    }

    /// The frame that is seen.
    pub(crate) fn frame(&self) -> usize {
        // What is played stands at its end for a moment; what is held can be anywhere.
        let last = if self.label.is_standing { SEGMENT_LEN } else { self.span().end as usize };
        (self.label.playhead as usize).min(last - 1)
    }
}
