//! Sessions of verdicts on single transitions: what they hold, what they refuse, and what is learned from them again.
#![expect(clippy::unwrap_used, reason = "a failing test may panic")]

use std::ops::ControlFlow;
use std::path::Path;

use dropj::dream::Dream;
use dropj::query::{
    DreamId, Preference, Protocol, QueryId, Response, SafetyAnswer, Transition, Verdict, sample_queries,
};
use dropj::reward::{LearnedReward, SparseConfig, fit_sparse_anew, transition_row};
use dropj::session::{Answer, Choice, DreamSource, Event, Fit, Header, SessionStore, replay};
use dropj::tensor::NotFinite;
use dropj::world::Action;
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

fn model() -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1))
}

fn answer(query: u32, response: Response) -> Event {
    Event::Answered(Answer::new(QueryId(query), response, 1.6, "anna"))
}

/// Forty transitions of a dream, with verdicts by turns; the first was skipped, the second taken back and changed.
fn session(dir: &Path, model: &WorldModel) -> SessionStore {
    let header = Header::new("dummy-road", Protocol::Dros, 7, &model.hash(), 0);
    let mut store = SessionStore::create(dir, header).unwrap();
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let (mut dream, rng) = (Dream::new(&start, 1), &mut ChaCha8Rng::seed_from_u64(1));
    (0..60).for_each(|t| dream.step(model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap());
    store.save_dream(&dream.finish(), DreamSource::User).unwrap();
    for i in 0..40 {
        let transition = Transition { dream: DreamId(0), first: 5, step: 5 + i as usize };
        let query = QueryId(i);
        store.record(Event::AskedTransition { query, transition, choice: Choice::Uniform }).unwrap();
        let said = Response::Judged(Verdict::ALL[i as usize % 3]);
        store.record(answer(i, if i == 0 { Response::Skipped(None) } else { said })).unwrap();
        if i == 1 {
            store.record(Event::Retracted { query }).unwrap();
            store.record(answer(i, Response::Judged(Verdict::Good))).unwrap();
            store.record(Event::Flagged { query }).unwrap();
        }
    }
    store
}

#[test]
fn verdicts_are_there_when_the_session_is_opened_again_and_learned_from_again() {
    tch::set_num_threads(1);
    let (dir, model) = (tempfile::tempdir().unwrap(), model());
    let dir = dir.path().join("s");
    let mut store = session(&dir, &model);
    let judged = store.session().judged();
    assert_eq!((judged.len(), judged[0].query, judged[0].verdict), (39, QueryId(1), Verdict::Good));
    assert_eq!(store.session().labeled(), [], "none of them is a preference");

    let dream = store.dream(DreamId(0)).unwrap();
    let features = dream.features(&model);
    let row = |t: Transition| Ok::<_, NotFinite>(transition_row(&features, &dream.actions, t.step));
    let fitted =
        fit_sparse_anew(&model, SparseConfig::tiny(), 4, &judged, row, |_| ControlFlow::Continue(()));
    let fitted = fitted.unwrap().unwrap();
    let after = store.session().n_entries();
    let (losses, held_out) = (fitted.losses.clone(), fitted.held_out.map(|held_out| held_out.loss));
    let fit = Fit { after, n_labels: 39, seed: 4, epochs: 30, losses: losses.clone(), held_out };
    store.record(Event::Retracted { query: QueryId(39) }).unwrap();
    store.save_reward(&fitted.reward.parameters(), fit).unwrap();
    let state = store.session().clone();
    drop(store);

    let replayed = replay(&dir, &model).unwrap();
    assert_eq!(replayed.session, state, "it is as it was");
    let again = replayed.refit(&model, &replayed.fits[0]).unwrap();
    assert_eq!(again, losses, "the same processor computes the same");
    assert!(replayed.fits[0].agrees(&again), "of as many verdicts as there were");
    let (_, reward) = SessionStore::read_reward(&dir).unwrap();
    let reward = LearnedReward::load(&reward.unwrap(), &model).unwrap();
    assert!(reward.is_sparse(), "and what drives by it knows of which kind it is");
}

#[test]
fn a_verdict_is_of_a_transition_and_a_preference_of_a_pair() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model());
    let mut store = session(&dir.path().join("s"), &model);
    let lens = store.session().dream_lens();
    let pair = sample_queries(&lens, 1, QueryId(40), &mut ChaCha8Rng::seed_from_u64(0))[0];
    let asked = Event::Asked { query: pair.id, left: pair.left, right: pair.right, choice: Choice::Uniform };
    store.record(asked).unwrap();
    let verdict = answer(40, Response::Judged(Verdict::Good));
    assert!(store.record(verdict).is_err(), "a pair has no verdict");
    store.record(Event::ProtocolChanged { protocol: Protocol::Dropj }).unwrap();
    let safe = Response::Safety(SafetyAnswer::Both(Preference::Left));
    assert!(store.record(answer(3, safe)).is_err(), "a transition has no better side");
    store.record(answer(40, safe)).unwrap();
    let beyond = Transition { dream: DreamId(0), first: 5, step: 54 };
    let asked = Event::AskedTransition { query: QueryId(41), transition: beyond, choice: Choice::Uniform };
    let refused = store.record(asked).unwrap_err().to_string();
    assert!(refused.contains("step 54 of dream 0 lies outside its trajectory"), "{refused}");
}
