//! Decodes the clips of queries before they are asked.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use crate::dream::DreamEpisode;
use crate::query::{DreamId, Query, SEGMENT_LEN, SegmentRef};
use crate::tensor::from_slice;
use crate::worker::error::TaskError;
use crate::worker::{ClipperCommand, LabelReport, Reports, Worker, WorkerError, WorkerName, one_thread};
use crate::world::Frame;
use crate::world_model::{Placed, WorldModel};

const NAME: WorkerName = WorkerName::Clipper;
/// Which picture of a clip stands for it in a list.
pub const MIDDLE: usize = SEGMENT_LEN / 2;

/// Starts a thread that decodes the clips of queries as `model` sees them.
pub fn spawn(model: impl Into<Placed>, reports: &Reports) -> Worker<ClipperCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| clip(&commands, &reports, model))
}

/// The body of the thread.
pub fn clip(
    commands: &Receiver<ClipperCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let mut dreams = HashMap::new();
    for command in commands {
        match command {
            ClipperCommand::AddDream(id, dream) => {
                dreams.insert(id, dream);
            }
            ClipperCommand::Decode(query) => match decode(&model, &dreams, query) {
                Ok((left, right)) => reports.send(LabelReport::Clips { query, left, right }),
                Err(e) => reports.fail(NAME, e),
            },
            ClipperCommand::DecodeThumbnails(query) => match decode_thumbnails(&model, &dreams, query) {
                Ok(frames) => reports.send(LabelReport::Thumbnails { query, frames }),
                Err(e) => reports.fail(NAME, e),
            },
        }
    }
    Ok(())
}

/// Both clips, decoded in one batch.
fn decode(
    model: &WorldModel,
    dreams: &HashMap<DreamId, Arc<DreamEpisode>>,
    query: Query,
) -> Result<(Vec<Frame>, Vec<Frame>), TaskError> {
    let mut zs = latents(dreams, query.left)?.to_vec();
    if query.left == query.right {
        let clip = model.decode(&from_slice(&zs, &[SEGMENT_LEN as i64, -1]));
        return Ok((clip.clone(), clip));
    }
    zs.extend_from_slice(latents(dreams, query.right)?);
    let mut left = model.decode(&from_slice(&zs, &[2 * SEGMENT_LEN as i64, -1]));
    let right = left.split_off(SEGMENT_LEN);
    Ok((left, right))
}

/// The picture in the middle of each clip.
fn decode_thumbnails(
    model: &WorldModel,
    dreams: &HashMap<DreamId, Arc<DreamEpisode>>,
    query: Query,
) -> Result<[Frame; 2], TaskError> {
    let mut zs = Vec::new();
    for segment in [query.left, query.right] {
        let rows = latents(dreams, segment)?;
        let width = rows.len() / SEGMENT_LEN;
        zs.extend_from_slice(&rows[MIDDLE * width..(MIDDLE + 1) * width]);
    }
    let frames = model.decode(&from_slice(&zs, &[2, -1]));
    Ok(frames.try_into().expect("two latents are two pictures"))
}

/// The latents of a segment, row after row.
fn latents(dreams: &HashMap<DreamId, Arc<DreamEpisode>>, segment: SegmentRef) -> Result<&[f32], TaskError> {
    let SegmentRef { dream, start } = segment;
    let zs = dreams.get(&dream).map(|dream| &dream.zs);
    let rows = zs.and_then(|zs| zs.values.get(start * zs.width..(start + SEGMENT_LEN) * zs.width));
    rows.ok_or(TaskError::Clip { dream, start })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::worker::{Report, fixtures};

    #[test]
    fn clips_are_the_pictures_of_their_segments() {
        let dream = Arc::new(fixtures::dream(1, 30));
        let (known, unknown) = (fixtures::query(0, (7, 2), (7, 10)), fixtures::query(1, (7, 11), (8, 0)));
        let (commands, received) = channel();
        commands.send(ClipperCommand::AddDream(DreamId(7), Arc::clone(&dream))).unwrap();
        commands.send(ClipperCommand::Decode(unknown)).unwrap();
        commands.send(ClipperCommand::Decode(known)).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        clip(&received, &reports, fixtures::model().parameters().clone()).unwrap();

        let Report::Failed(failure) = inbox.recv().unwrap() else { panic!("another report") };
        let message = failure.error.to_string();
        assert!(message.contains("step 11 of dream 7"), "{message}");
        let Report::Label(LabelReport::Clips { query, left, right }) = inbox.recv().unwrap() else {
            panic!("another report")
        };
        assert_eq!((query, left.len(), right.len()), (known, SEGMENT_LEN, SEGMENT_LEN));
        let alone = dream.frames(&fixtures::model(), 10..30);
        let apart = right.iter().flat_map(Frame::rgb).zip(alone.iter().flat_map(Frame::rgb));
        assert!(
            apart.map(|(a, b)| a.abs_diff(*b)).max() <= Some(2),
            "a batch rounds differently, but little"
        );
    }
}
