//! Looks for signs that dreams have left the world behind, while nobody waits for it.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::thread;
use std::time::Instant;

use crate::worker::{LabelReport, Reports, ScreenerCommand, Worker, WorkerError, WorkerName, one_thread};
use crate::world_model::{Placed, WorldModel};

const NAME: WorkerName = WorkerName::Screener;

/// Starts a thread that looks for the signs of dreams of `model`.
pub fn spawn(model: impl Into<Placed>, reports: &Reports) -> Worker<ScreenerCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| screen(&commands, &reports, model))
}

/// The body of the thread.
pub fn screen(
    commands: &Receiver<ScreenerCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let mut waiting = VecDeque::new();
    while let Some(ScreenerCommand::AddDream(dream, episode)) =
        waiting.pop_front().or_else(|| commands.recv().ok())
    {
        let mut began = None::<Instant>;
        let signs = episode.signs(&model, || {
            // As long as it worked it rests: somebody may be driving.
            if let Some(began) = began {
                thread::sleep(began.elapsed());
            }
            began = Some(Instant::now());
            loop {
                match commands.try_recv() {
                    Ok(command) => waiting.push_back(command),
                    Err(TryRecvError::Empty) => return true,
                    // Nobody wants to know any more.
                    Err(TryRecvError::Disconnected) => return false,
                }
            }
        });
        let Some(signs) = signs else { return Ok(()) };
        reports.send(LabelReport::Signs { dream, seed: episode.seed, signs });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::query::DreamId;
    use crate::worker::{Report, fixtures};

    #[test]
    fn the_signs_of_each_dream_are_reported() {
        let (reports, inbox) = Reports::new(|| ());
        let screener = spawn(fixtures::model().parameters().clone(), &reports);
        for id in 1..3 {
            let dream = Arc::new(fixtures::dream(id, 60));
            screener.send(ScreenerCommand::AddDream(DreamId(id as u32), dream));
        }
        for id in 1..3 {
            let Report::Label(LabelReport::Signs { dream, seed, signs }) = inbox.recv().unwrap() else {
                panic!("another report")
            };
            assert_eq!((dream, seed, signs.len()), (DreamId(id as u32), id, 60));
            assert_eq!(signs, fixtures::dream(id, 60).signs(&fixtures::model(), || true).unwrap());
        }
    }
}
