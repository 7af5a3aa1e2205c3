//! Writes what was seen as a GIF.

use std::path::PathBuf;

use crate::clip::{Clip, beside, futures, query};
use crate::worker::jobs::Done;
use crate::worker::{ClipSource, JobReport};
use crate::world_model::WorldModel;

/// Steps of a dream at the most: what is longer is a file that nobody sends.
const MOST: usize = 500;
/// Of a dream every second step is shown.
const EVERY: usize = 2;

/// Writes `source` to `path`, which ends in `.gif` then.
pub(super) fn write(path: PathBuf, source: ClipSource) -> Done {
    let has_ending = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("gif"));
    let path = if has_ending { path } else { path.with_added_extension("gif") };
    let clip = match source {
        // A transition has one clip.
        ClipSource::Query { left, right, rate, .. } if left == right => Clip::half_as_fast(left, rate, 1),
        ClipSource::Query { left, right, response, rate } => {
            Clip::half_as_fast(query(&left, &right, response), rate, 1)
        }
        ClipSource::Dream { episode, model } => {
            let model = WorldModel::load(model)?;
            let frames = episode.frames(&model, 0..episode.len().min(MOST));
            Clip::at_pace(frames.into_iter().step_by(EVERY).collect(), model.spec().rate, EVERY)
        }
        ClipSource::Deployed { seen, rate } => {
            let frames = seen.iter().map(|moment| futures(&moment.frame, &moment.lead_to, moment.chosen));
            Clip::at_pace(of_one_size(frames), rate, 1)
        }
        ClipSource::Beside { seen, rate } => {
            Clip::at_pace(of_one_size(seen.iter().map(|[real, dream]| beside(real, dream))), rate, 1)
        }
    };
    clip.write(&path)?;
    Ok(Some(JobReport::ClipWritten(Ok(path))))
}

/// Those pictures that are as large as the last one: before the first plan there are no futures to be seen.
fn of_one_size(frames: impl Iterator<Item = crate::world::Frame>) -> Vec<crate::world::Frame> {
    let mut frames: Vec<_> = frames.collect();
    if let Some(size) = frames.last().map(crate::world::Frame::size) {
        frames.retain(|frame| frame.size() == size);
    }
    frames
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::query::{Response, SafetyAnswer};
    use crate::worker::{DeployedMoment, fixtures};
    use crate::world::Frame;

    fn one(shade: u8) -> Frame {
        Frame::square(12, vec![shade; 3 * 12 * 12])
    }

    fn written(path: PathBuf, source: ClipSource) -> PathBuf {
        let done = write(path, source).unwrap();
        let Some(JobReport::ClipWritten(Ok(path))) = done else { panic!("{done:?}") };
        path
    }

    #[test]
    fn what_was_seen_is_a_gif_of_that_name() {
        let dir = tempfile::tempdir().unwrap();
        let seen = |lead_to: Vec<Frame>| DeployedMoment { frame: one(9), lead_to: lead_to.into(), chosen: 1 };
        let three = || vec![one(1), one(2), one(3)];
        let sources = [
            ClipSource::Query {
                left: vec![one(1); 3],
                right: vec![one(2); 3],
                response: Some(Response::Safety(SafetyAnswer::OnlyLeft)),
                rate: 50.0,
            },
            ClipSource::Dream {
                episode: Arc::new(fixtures::dream(1, 30)),
                model: fixtures::model().parameters().clone(),
            },
            ClipSource::Deployed { seen: vec![seen(Vec::new()), seen(three()), seen(three())], rate: 12.5 },
            ClipSource::Beside { seen: vec![[one(1), one(2)]; 2], rate: 10.0 },
        ];
        for (i, source) in sources.into_iter().enumerate() {
            let path = written(dir.path().join(format!("clip {i}")), source);
            assert_eq!(path, dir.path().join(format!("clip {i}.gif")));
            assert!(crate::run::read_at_most(&path, 1 << 20).unwrap().unwrap().starts_with(b"GIF89a"));
        }
    }

    #[test]
    fn nothing_seen_is_no_clip_and_no_other_file_is_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notes.gif");
        let beside = |seen: Vec<[Frame; 2]>| ClipSource::Beside { seen, rate: 10.0 };
        let empty = write(path.clone(), beside(Vec::new())).unwrap_err().to_string();
        assert!(empty.contains("nothing to be seen"), "{empty}");
        fixtures::put(&path, "no GIF at all");
        let refused = write(path.clone(), beside(vec![[one(1), one(2)]])).unwrap_err().to_string();
        assert!(refused.contains("notes.gif"), "{refused}");
    }
}
