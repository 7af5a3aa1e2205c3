//! Queries that are drawn before anybody answers, so that all annotators are asked the same.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::app::label::next_transition;
use crate::query::{Pool, Strategy};
use crate::serve::ServeError;
use crate::session::{Choice, Event, SessionStore};

/// Draws queries by `strategy` until the session has `n` of those that its protocol asks, repetitions left out, or as many
/// as there can be. How many were drawn.
///
/// By chance, where the strategy finds no pair; so are those by disagreement, since nothing is learned meanwhile.
pub fn draw(store: &mut SessionStore, n: usize, strategy: Strategy) -> Result<usize, ServeError> {
    let (seed, protocol) = (store.header().seed, store.session().protocol());
    let mut n_drawn = 0;
    let n_there = n_queries(store);
    while n_there + n_drawn < n {
        let session = store.session();
        let query = session.next_query_id();
        let event = if protocol.is_sparse() {
            next_transition(session, seed, |_| true)
                .map(|(transition, choice)| Event::AskedTransition { query, transition, choice })
        } else {
            let (dreams, known, marks) =
                (session.dreams_for(protocol), session.known_clips(), session.marks());
            let pool = Pool { dreams: &dreams, known: &known, marks: &marks };
            // A stream of its own: what is asked does not hang on when it was drawn.
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(u64::from(query.0));
            let strategy = if strategy == Strategy::Disagreement { Strategy::Uniform } else { strategy };
            let drawn = pool.draw(strategy, &mut rng).map(|pair| (pair, Choice::from(strategy)));
            let drawn =
                drawn.or_else(|| Some((pool.draw(Strategy::Uniform, &mut rng)?, Choice::Uniform)));
            drawn.map(|([left, right], choice)| Event::Asked { query, left, right, choice })
        };
        let Some(event) = event else { break };
        store.record(event)?;
        n_drawn += 1;
    }
    if n_there + n_drawn == 0 {
        return Err(ServeError::NothingToDraw { protocol, path: store.dir().to_owned() });
    }
    Ok(n_drawn)
}

/// How many queries that can be handed out the session has.
fn n_queries(store: &SessionStore) -> usize {
    let session = store.session();
    let asked = session.queries().iter().filter(|asked| asked.repeats().is_none() && session.is_in_use(asked));
    asked.filter(|asked| session.is_of(asked, session.protocol())).count()
}
