//! Queries that are drawn before anybody answers, so that all annotators are asked the same.

use std::collections::BTreeSet;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::app::label::next_transition;
use crate::query::{DreamId, Pool, SegmentRef, Strategy};
use crate::serve::ServeError;
use crate::session::{Choice, Event, SessionStore};

/// So often a pair is drawn anew that is asked already; where few are possible, there are no more.
const N_TRIES: usize = 50;

/// Draws queries by `strategy` until the session has `n` different ones of those that its protocol asks, or as many as there
/// can be. How many were drawn.
///
/// By chance, where the strategy finds no pair; so are those by disagreement, since nothing is learned meanwhile.
pub fn draw(store: &mut SessionStore, n: usize, strategy: Strategy) -> Result<usize, ServeError> {
    let protocol = store.session().protocol();
    let mut asked = asked(store);
    let (n_before, mut n_again) = (asked.len(), 0);
    while asked.len() < n {
        let drawn = if protocol.is_sparse() {
            let next = next_transition(store.session(), store.header().seed, |_| true);
            // One that comes again, in another trajectory, is written down, so that what follows can come, and not counted.
            next.filter(|_| n_again < N_TRIES * n).map(|(transition, choice)| {
                n_again += usize::from(!asked.insert([(transition.dream, transition.step); 2]));
                let query = store.session().next_query_id();
                Event::AskedTransition { query, transition, choice }
            })
        } else {
            pair(store, strategy, &mut asked)
        };
        let Some(event) = drawn else { break };
        store.record(event)?;
    }
    if asked.is_empty() {
        return Err(ServeError::NothingToDraw { protocol, path: store.dir().to_owned() });
    }
    Ok(asked.len() - n_before)
}

/// A pair that is not among those that are asked, and then is.
fn pair(store: &SessionStore, strategy: Strategy, asked: &mut BTreeSet<[Place; 2]>) -> Option<Event> {
    let session = store.session();
    let query = session.next_query_id();
    let (dreams, known, marks) =
        (session.dreams_for(session.protocol()), session.known_clips(), session.marks());
    let pool = Pool { dreams: &dreams, known: &known, marks: &marks };
    // A stream of its own: what is asked does not hang on when it was drawn.
    let mut rng = ChaCha8Rng::seed_from_u64(store.header().seed);
    rng.set_stream(u64::from(query.0));
    let strategy = if strategy == Strategy::Disagreement { Strategy::Uniform } else { strategy };
    for _ in 0..N_TRIES {
        let drawn = pool.draw(strategy, &mut rng).map(|pair| (pair, Choice::from(strategy)));
        let drawn = drawn.or_else(|| Some((pool.draw(Strategy::Uniform, &mut rng)?, Choice::Uniform)));
        let ([left, right], choice) = drawn?;
        if asked.insert(places(left, right)) {
            return Some(Event::Asked { query, left, right, choice });
        }
    }
    None
}

/// A place in a dream: which, and the step.
type Place = (DreamId, usize);

/// What a pair shows, whichever side is where.
fn places(left: SegmentRef, right: SegmentRef) -> [Place; 2] {
    let mut both = [left, right].map(|segment| (segment.dream, segment.start));
    both.sort_unstable();
    both
}

/// What is asked already of that which can be handed out: each once.
fn asked(store: &SessionStore) -> BTreeSet<[Place; 2]> {
    let session = store.session();
    let asked =
        session.queries().iter().filter(|asked| asked.repeats().is_none() && session.is_in_use(asked));
    let asked = asked.filter(|asked| session.is_of(asked, session.protocol()));
    asked
        .map(|asked| match asked.transition {
            Some(transition) => [(transition.dream, transition.step); 2],
            None => places(asked.query.left, asked.query.right),
        })
        .collect()
}
