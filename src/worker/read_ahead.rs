//! Reads episodes in several threads, ahead of whoever takes them: their pictures are slow to unpack.

use std::num::NonZero;
use std::sync::mpsc::sync_channel;
use std::thread;

use crate::dataset::Dataset;
use crate::world_model::fit::{FitError, Take};

/// More threads would wait for the disk, and each holds two episodes.
const MOST: usize = 16;

/// Hands over the episodes of these indices in their order, as [`read_one_by_one`] does.
///
/// [`read_one_by_one`]: crate::world_model::fit::read_one_by_one
pub fn read_ahead(dataset: &Dataset, episodes: &[usize], take: &mut Take<'_>) -> Result<(), FitError> {
    let n = thread::available_parallelism().map_or(1, NonZero::get).min(MOST).min(episodes.len());
    thread::scope(|scope| {
        // The first thread reads every n-th episode, the second those behind them, and so on: so all come in order.
        let mut readers = Vec::new();
        for first in 0..n {
            let (done, reader) = sync_channel(1);
            readers.push(reader);
            scope.spawn(move || {
                for &i in episodes.iter().skip(first).step_by(n) {
                    // Nobody takes any more.
                    if done.send(dataset.episode(i)).is_err() {
                        return;
                    }
                }
            });
        }
        for (&i, reader) in episodes.iter().zip(readers.iter().cycle()) {
            // A thread that panicked hands over nothing, and the scope passes its panic on.
            let Ok(episode) = reader.recv() else { break };
            take(i, episode?)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::dataset::{EpisodeInfo, StepRecord};
    use crate::run::Run;
    use crate::world::{Action, Frame};
    use crate::world_model::WorldModelConfig;
    use crate::world_model::fit::{FitConfig, Means, fit_world, fit_world_with, read_one_by_one};

    /// Forty episodes of three steps, each in a gray of its own.
    fn recorded(dir: &std::path::Path, side: u32) -> Dataset {
        let mut dataset = Dataset::create_or_open(dir, "dummy-road").unwrap();
        for seed in 0..40_u64 {
            let info = EpisodeInfo { env: "dummy-road".to_owned(), pilot: "nobody".to_owned(), seed };
            let mut recording = dataset.begin(info).unwrap();
            let frame = Frame::square(side, vec![seed as u8; (3 * side * side) as usize]);
            for _ in 0..3 {
                let step = StepRecord {
                    frame: frame.clone(),
                    action: Action::new([0.0; 3]),
                    reward: 0.0,
                    events: vec![false],
                    wall_time_ns: 0,
                    state: Vec::new(),
                };
                recording.push(&step).unwrap();
            }
            dataset.seal(recording, &frame, None).unwrap();
        }
        dataset
    }

    #[test]
    fn episodes_come_in_the_order_that_is_asked_for() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = recorded(dir.path(), 4);
        let asked: Vec<usize> = (0..40).rev().chain([3, 3]).collect();
        let mut both = Vec::new();
        for read in [read_ahead, read_one_by_one] {
            let mut taken = Vec::new();
            let mut take = |i, episode: crate::dataset::Episode| {
                taken.push((i, episode.frames[0].rgb()[0]));
                Ok(())
            };
            read(&dataset, &asked, &mut take).unwrap();
            both.push(taken);
        }
        assert_eq!(both[0], both[1]);
        assert_eq!(both[0].iter().map(|(i, _)| *i).collect::<Vec<_>>(), asked);
        assert!(read_ahead(&dataset, &[], &mut |_, _| unreachable!("there is none")).is_ok());
    }

    #[test]
    fn a_fit_is_the_same_to_the_last_bit_however_its_recordings_are_read() {
        tch::set_num_threads(1);
        let dir = tempfile::tempdir().unwrap();
        let mut dataset = recorded(&dir.path().join("data"), 20);
        (0..30).for_each(|_| dataset.delete(0).unwrap());
        let mut brief = FitConfig::tiny();
        for schedule in [&mut brief.vae, &mut brief.mdn_rnn] {
            (schedule.max_epochs, schedule.updates_per_epoch) = (1, 3);
        }
        let run = |name: &str| Run::open(&dir.path().join(name), false).unwrap();
        let report = &mut |_: &_| ControlFlow::Continue(());
        let config = WorldModelConfig::tiny();
        let ahead = Means { read: &read_ahead, ..Means::default() };
        let ahead = fit_world_with(ahead, &dataset, &config, &brief, &run("ahead"), report).unwrap();
        let plain = fit_world(&dataset, &config, &brief, &run("plain"), report).unwrap();
        assert_eq!(ahead.hash(), plain.hash());
    }

    #[test]
    fn whoever_takes_no_more_ends_the_reading() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = recorded(dir.path(), 4);
        let mut n = 0;
        let mut take = |_, _| {
            n += 1;
            if n == 3 { Err(FitError::Stopped) } else { Ok(()) }
        };
        let asked: Vec<usize> = (0..40).collect();
        assert!(matches!(read_ahead(&dataset, &asked, &mut take), Err(FitError::Stopped)));
        assert_eq!(n, 3);
    }
}
