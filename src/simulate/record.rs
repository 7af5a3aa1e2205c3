//! Real episodes without a person: the world acts by itself, the dataset keeps.

use std::ops::{ControlFlow, Range};
use std::time::SystemTime;

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::dataset::{Dataset, DatasetError, EpisodeInfo, Layout, StepRecord};
use crate::world::{Explorer, World, WorldError};

/// The name that a world's own policy has in a dataset.
pub const PILOT: &str = "scripted";
/// The name of whoever tries everything, where a world has no policy of its own.
pub const EXPLORER: &str = "explorer";

/// An episode that has been recorded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recorded {
    /// Which of the episodes of a seed it is.
    pub k: u64,
    /// Its number in the dataset.
    pub number: usize,
    /// How many steps it has.
    pub n_steps: usize,
    /// In how many of them each event of the world's file went on.
    pub events: Vec<usize>,
    /// The sum of the world's rewards.
    pub ret: f32,
}

/// Why nothing more is recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The disk.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The world, after what was recorded of the episode is sealed.
    #[error("the world failed in episode {k} after {n_steps} steps, which are kept: {met}")]
    World {
        /// Which of the episodes of a seed it was.
        k: u64,
        /// How many steps there were.
        n_steps: usize,
        /// What the world met.
        met: WorldError,
    },
}

/// Records episodes `episodes` of `seed` as the world acts by itself, as far as the dataset does not have them yet.
///
/// Episode `k` has a `ChaCha8` stream of its own, which decides the world, the policy's moods and all it does: it is
/// the same whatever was recorded before. So a run that was stopped goes on where it is started again, and two
/// programs can share the work, each with a range and a dataset of its own.
/// A world without a policy of its own is explored by chance: see [`Explorer`].
///
/// `progress` is told of each episode once it is sealed, and may stop there.
pub fn record(
    world: &mut dyn World,
    dataset: &mut Dataset,
    episodes: Range<u64>,
    seed: u64,
    mut progress: impl FnMut(Recorded) -> ControlFlow<()>,
) -> Result<(), RecordError> {
    let pilot = if world.policy().is_some() { PILOT } else { EXPLORER };
    for k in episodes {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(k);
        let env = dataset.env().unwrap_or_default().to_owned();
        let info = EpisodeInfo { env, pilot: pilot.into(), seed: rng.next_u64() };
        if (0..dataset.n_episodes()).any(|idx| *dataset.info(idx) == info) {
            continue;
        }
        // What a killed run left of this very episode is driven anew from its beginning.
        while let Some(idx) = dataset.unfinished().iter().position(|unfinished| unfinished.info == info) {
            dataset.discard(idx)?;
        }
        let recorded = record_one(world, dataset, info, k, &mut rng)?;
        if progress(recorded).is_break() {
            break;
        }
    }
    Ok(())
}

/// Drives and seals one episode.
fn record_one(
    world: &mut dyn World,
    dataset: &mut Dataset,
    info: EpisodeInfo,
    k: u64,
    rng: &mut ChaCha8Rng,
) -> Result<Recorded, RecordError> {
    let failed = |n_steps, met| RecordError::World { k, n_steps, met };
    let mut explorer = Explorer::new(world.spec().clone());
    let mut frame = world.reset(info.seed).map_err(|met| failed(0, met))?;
    world.policy().unwrap_or(&mut explorer).begin(rng);
    let layout = Layout::of(world.spec(), &world.sensors());
    let mut recording = dataset.begin_with(info, &layout)?;
    let mut recorded = Recorded { k, events: vec![0; layout.events.len()], ..Recorded::default() };
    let ended = loop {
        let state = world.state();
        let action = match world.policy().unwrap_or(&mut explorer).act(rng) {
            Ok(action) => action,
            Err(met) => break Err(met),
        };
        let wall_time_ns = wall_time_ns();
        let step = match world.step(&action) {
            Ok(step) => step,
            Err(met) => break Err(met),
        };
        let seen = std::mem::replace(&mut frame, step.frame);
        let (action, reward) = (step.executed.unwrap_or(action), step.reward.unwrap_or_default());
        let events: Vec<bool> = step.events.iter().map(|event| event.goes_on).collect();
        recorded.events.iter_mut().zip(&events).for_each(|(n, goes_on)| *n += usize::from(*goes_on));
        recording.push(&StepRecord { frame: seen, action, reward, events, wall_time_ns, state })?;
        recorded.n_steps += 1;
        recorded.ret += reward;
        if step.end.is_some() {
            break Ok(step.end);
        }
    };
    if recorded.n_steps == 0 {
        recording.discard()?;
    } else {
        recorded.number = dataset.seal(recording, &frame, ended.as_ref().copied().unwrap_or(None))?;
    }
    match ended {
        Ok(_) => Ok(recorded),
        Err(met) => Err(failed(recorded.n_steps, met)),
    }
}

/// Nanoseconds since 1970.
fn wall_time_ns() -> i64 {
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    since_epoch.as_nanos() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Episode;
    use crate::world::End;
    use crate::world::cars::{CarAction, CarWorld, Env, Events, Outcome, Seed, Truth};
    use crate::world::{Action, Frame};

    /// A world of six steps whose frame tells the seed and the time.
    struct Clockwork {
        seed: u8,
        time: u8,
    }

    impl Env for Clockwork {
        fn reset(&mut self, seed: Seed) {
            let Seed::Native(seed) = seed else { panic!("the recorder uses our own seeds") };
            *self = Self { seed: seed as u8, time: 0 };
        }

        fn advance(&mut self, _: CarAction) -> Outcome {
            self.time += 1;
            let end = (self.time == 6).then_some(End::Truncated);
            let events = Events { grass: self.time == 2, ..Events::default() };
            Outcome { reward: f32::from(self.time), events, end }
        }

        fn frame(&self) -> Frame {
            Frame::square(1, [self.seed, self.time, 0])
        }

        fn sensors(&self) -> &'static [&'static str] {
            &["time"]
        }

        fn state(&self) -> Vec<f32> {
            vec![f32::from(self.time)]
        }

        fn truth(&self) -> Truth {
            Truth { n_nodes: 300, ..Truth::default() }
        }

        fn picture(&self, _: u32, _: u32) -> Vec<u8> {
            Vec::new()
        }
    }

    /// Records a range into a dataset of its own and returns the episodes, their wall clock set to 0.
    fn recorded(dataset: &mut Dataset, episodes: Range<u64>, seed: u64) -> Vec<Episode> {
        let mut env = CarWorld::of("clockwork", Clockwork { seed: 0, time: 0 });
        record(&mut env, dataset, episodes, seed, |_| ControlFlow::Continue(())).unwrap();
        let mut episodes: Vec<Episode> = dataset.episodes().map(Result::unwrap).collect();
        for episode in &mut episodes {
            episode.wall_times_ns.fill(0);
        }
        episodes
    }

    fn dataset() -> (tempfile::TempDir, Dataset) {
        let dir = tempfile::tempdir().unwrap();
        let dataset = Dataset::create_or_open(dir.path(), "clockwork").unwrap();
        (dir, dataset)
    }

    #[test]
    fn an_episode_is_the_same_whatever_was_recorded_before() {
        let ((_dir, mut all), (_other_dir, mut late)) = (dataset(), dataset());
        let all = recorded(&mut all, 0..4, 7);
        let mut late = recorded(&mut late, 2..4, 7);
        for episode in &mut late {
            episode.number += 2;
        }
        assert_eq!(all[2..], late);
        assert_ne!(all[0].actions, all[1].actions);
    }

    #[test]
    fn what_the_car_measured_and_why_the_episode_ended_is_recorded() {
        let (_dir, mut dataset) = dataset();
        let episode = recorded(&mut dataset, 0..1, 7).remove(0);
        assert_eq!(episode.layout.sensors, ["time"]);
        assert_eq!(episode.states.concat(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], "before each action");
        assert!(episode.done && episode.truncated, "its time was up");
    }

    #[test]
    fn a_stopped_run_goes_on_where_it_is_started_again() {
        let ((_dir, mut whole), (_other_dir, mut halves)) = (dataset(), dataset());
        let mut env = CarWorld::of("clockwork", Clockwork { seed: 0, time: 0 });
        let mut n_heard = 0;
        let stop_after_two = |_| {
            n_heard += 1;
            if n_heard == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        record(&mut env, &mut halves, 0..5, 3, stop_after_two).unwrap();
        assert_eq!(halves.n_episodes(), 2);
        assert_eq!(recorded(&mut halves, 0..5, 3), recorded(&mut whole, 0..5, 3));
    }

    #[test]
    fn an_episode_broken_off_by_a_killed_run_is_driven_anew() {
        let (dir, mut first) = dataset();
        let info = recorded(&mut first, 0..1, 3).remove(0).info;
        drop(first);
        let (killed_dir, killed) = dataset();
        let spec = crate::world::WorldSpec::default();
        let layout = Layout::of(&spec, &["time".to_owned()]);
        let step = StepRecord {
            frame: Frame::square(1, [0; 3]),
            action: Action::new([0.0; 3]),
            reward: 0.0,
            events: vec![false; 2],
            wall_time_ns: 0,
            state: vec![0.0],
        };
        killed.begin_with(info, &layout).unwrap().push(&step).unwrap();
        drop(killed);
        let mut dataset = Dataset::create_or_open(killed_dir.path(), "clockwork").unwrap();
        assert_eq!(dataset.unfinished().len(), 1);
        let episodes = recorded(&mut dataset, 0..1, 3);
        assert_eq!((episodes[0].actions.len(), dataset.unfinished().len()), (6, 0));
        drop(dir);
    }

    #[test]
    fn progress_tells_what_was_driven() {
        let (_dir, mut dataset) = dataset();
        let mut env = CarWorld::of("clockwork", Clockwork { seed: 0, time: 0 });
        let mut told = Vec::new();
        record(&mut env, &mut dataset, 4..5, 1, |recorded| {
            told.push(recorded);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(
            told,
            [Recorded { k: 4, n_steps: 6, events: vec![1, 0], ret: 21.0, ..Recorded::default() }]
        );
    }
}
