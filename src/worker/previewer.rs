//! Shows what an episode of the real world begins with, before anybody acts in it.
//!
//! As it looks after a second in which nothing is done: some worlds open with a view from far away.

use std::sync::mpsc::Receiver;

use crate::worker::{
    OpenError, OpenWorld, PreviewerCommand, Reports, SceneReport, Worker, WorkerError, WorkerName,
    one_thread, picture,
};
use crate::world::{Action, World};

const NAME: WorkerName = WorkerName::Previewer;
/// Steps of that second at the most.
const MOST: usize = 100;

/// Starts a thread that shows how episodes begin in the world that `open` opens.
pub fn spawn(open: OpenWorld, reports: &Reports) -> Worker<PreviewerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| preview(&commands, &reports, &open))
}

/// The body of the thread.
pub fn preview(
    commands: &Receiver<PreviewerCommand>,
    reports: &Reports,
    open: &OpenWorld,
) -> Result<(), WorkerError> {
    one_thread();
    let mut world: Option<Box<dyn World>> = None;
    while let Ok(command) = commands.recv() {
        // Of several seeds only the last is still of interest, as while one is typed.
        let PreviewerCommand::Show(seed) = commands.try_iter().last().unwrap_or(command);
        let opened = world.take().map_or_else(|| open(false), Ok);
        let begun = opened.and_then(|mut world| {
            let mut frame = world.reset(seed).map_err(OpenError::World)?;
            let (neutral, n) = (Action::new(world.spec().neutral()), world.spec().rate.round() as usize);
            for _ in 0..n.min(MOST) {
                let step = world.step(&neutral).map_err(OpenError::World)?;
                frame = step.frame;
                if step.end.is_some() {
                    break;
                }
            }
            Ok((world, frame))
        });
        match begun {
            Ok((begun, frame)) => {
                reports.send(SceneReport { seed, picture: picture(begun.as_ref(), &frame) });
                world = Some(begun);
            }
            // Whoever acts in it is told; a picture that is missing is no news.
            Err(met) => log::warn!("there is no picture of episode {seed}: {met}"),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::worker::{Report, fixtures};

    #[test]
    fn the_first_picture_is_shown_of_the_seed_that_was_asked_for_last() {
        let (commands, received) = channel();
        for seed in [3, 30, 301] {
            commands.send(PreviewerCommand::Show(seed)).unwrap();
        }
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        preview(&received, &reports, &fixtures::wall(5)).unwrap();
        drop(reports);
        let all: Vec<_> = inbox.iter().collect();
        let [Report::Scene(SceneReport { seed: 301, picture })] = &all[..] else { panic!("{all:?}") };
        assert_eq!(picture.2.len() as u32, 3 * picture.0 * picture.1);
    }

    #[test]
    fn a_world_that_fails_shows_nothing_and_the_next_is_tried() {
        let (commands, received) = channel();
        commands.send(PreviewerCommand::Show(1)).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        let open: OpenWorld = std::sync::Arc::new(|_| Err(OpenError::RecordingsOnly("this one".to_owned())));
        preview(&received, &reports, &open).unwrap();
        drop(reports);
        assert!(inbox.iter().next().is_none(), "it is only a picture");
    }
}
