//! Dreams and parameters as files that are whole or absent.

use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};

use crate::dream::{DreamEpisode, Rows};
use crate::run::replace_file;
use crate::session::error::{DreamError, SessionError};
use crate::tensor::container::Container;
use crate::tensor::limits::{MAX_LATENTS, MAX_MEMORY, within};
use crate::world::{Action, ActionRanges, MAX_AXES};
use crate::world_model::LatentState;

/// Puts `bytes` at `path`, whole or not at all.
pub(crate) fn write_whole(path: &Path, bytes: &[u8], tried: &'static str) -> Result<(), SessionError> {
    replace_file(path, bytes).map_err(SessionError::disk(tried, path))
}

/// A dream as a safetensors file. The same dream has the same bytes.
pub fn dream_to_bytes(episode: &DreamEpisode) -> Vec<u8> {
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let DreamEpisode { start, zs, actions, unsafe_marks, seed, planned } = episode;
    let action_values: Vec<f32> = actions.iter().flat_map(|action| action.to_vec()).collect();
    // Without a step, as many numbers as a car's has.
    let n_axes = actions.first().map_or(ActionRanges::default().n_axes(), |action| action.len());
    let marks: Vec<u8> = unsafe_marks.iter().flat_map(|&mark| (mark as u32).to_le_bytes()).collect();
    let ends: Vec<u8> = planned
        .iter()
        .flat_map(|range| [range.start, range.end])
        .flat_map(|t| (t as u32).to_le_bytes())
        .collect();
    let mut arrays = vec![
        ("start.z", Dtype::F32, vec![start.z.len()], floats(&start.z)),
        ("start.c", Dtype::F32, vec![start.c.len()], floats(&start.c)),
        ("start.h", Dtype::F32, vec![start.h.len()], floats(&start.h)),
        ("zs", Dtype::F32, vec![zs.len(), zs.width], floats(&zs.values)),
        ("actions", Dtype::F32, vec![actions.len(), n_axes], floats(&action_values)),
        ("unsafe_marks", Dtype::U32, vec![unsafe_marks.len()], marks),
    ];
    // Where nobody handed over, the file is what it always was.
    if !planned.is_empty() {
        arrays.push(("planned", Dtype::U32, vec![planned.len(), 2], ends));
    }
    let views = arrays.iter().map(|(name, dtype, shape, bytes)| {
        let view = TensorView::new(*dtype, shape.clone(), bytes);
        (name, view.unwrap_or_else(|e| unreachable!("sizes come from the dream itself: {e}")))
    });
    // One key only: the order of several would be a matter of chance.
    let metadata = [("seed".to_owned(), seed.to_string())].into();
    safetensors::serialize(views, Some(metadata)).unwrap_or_else(|e| unreachable!("every view is whole: {e}"))
}

/// The dream in the bytes of such a file, or what is wrong with them.
///
/// What comes out is a dream that can be: made of numbers, of parts that fit, and marked at steps that it has.
pub fn dream_from_bytes(bytes: &[u8]) -> Result<DreamEpisode, DreamError> {
    let file = Container::read(bytes).map_err(DreamError::Container)?;
    let seed = file.value("seed").and_then(|seed| seed.parse().ok()).ok_or(DreamError::NoSeed)?;
    let entry = |name: &'static str| file.entry(name).ok_or(DreamError::Missing(name));
    let floats = |name: &'static str, wanted: usize| {
        let entry = entry(name)?;
        let found = entry.shape.len();
        if found != wanted {
            return Err(DreamError::Axes { name, found, wanted });
        }
        let values = file.floats(entry).ok_or(DreamError::Kind { name, dtype: entry.dtype })?;
        Ok((values, entry.shape.clone()))
    };
    let steps = |name: &'static str, row: &[usize]| {
        let entry = entry(name)?;
        if entry.dtype != Dtype::U32 || entry.shape.get(1..) != Some(row) {
            return Err(DreamError::NoSteps { name, dtype: entry.dtype, shape: entry.shape.clone() });
        }
        let words = file.bytes(entry).as_chunks::<4>().0;
        Ok(words.iter().map(|word| u32::from_le_bytes(*word) as usize).collect::<Vec<_>>())
    };
    let start =
        LatentState { z: floats("start.z", 1)?.0, c: floats("start.c", 1)?.0, h: floats("start.h", 1)?.0 };
    let (values, shape) = floats("zs", 2)?;
    let (action_values, action_shape) = floats("actions", 2)?;
    let n_axes = action_shape[1];
    if shape != [action_shape[0], start.z.len()] || !(1..=MAX_AXES).contains(&n_axes) {
        return Err(DreamError::Unfit { zs: shape, actions: action_shape });
    }
    if let Some(i) = action_values.iter().position(|value| !value.is_finite()) {
        return Err(DreamError::Action(i / n_axes));
    }
    let ends = if file.entry("planned").is_some() { steps("planned", &[2])? } else { Vec::new() };
    let episode = DreamEpisode {
        zs: Rows { width: start.z.len(), values },
        start,
        actions: action_values.chunks_exact(n_axes).map(Action::new).collect(),
        unsafe_marks: steps("unsafe_marks", &[])?,
        seed,
        planned: ends.as_chunks::<2>().0.iter().map(|&[from, to]| from..to).collect(),
    };
    check(&episode)?;
    Ok(episode)
}

/// Fails where a dream cannot be: numbers that are none, parts that do not fit, or steps that it does not have.
pub(super) fn check(episode: &DreamEpisode) -> Result<(), DreamError> {
    let DreamEpisode { start, zs, actions, unsafe_marks, planned, .. } = episode;
    let (n, n_latents, n_memory) = (actions.len(), start.z.len(), start.c.len());
    within("the number of its latents", n_latents, 1..=MAX_LATENTS as usize)
        .and_then(|()| within("the number of its memory cells", n_memory, 1..=MAX_MEMORY as usize))
        .map_err(DreamError::OutOfRange)?;
    if start.h.len() != n_memory {
        return Err(DreamError::Start { cells: n_memory, outputs: start.h.len() });
    }
    if (zs.width, zs.values.len()) != (n_latents, n * n_latents) {
        return Err(DreamError::Steps { latents: zs.len(), actions: n });
    }
    if ![&start.z, &start.c, &start.h].into_iter().flatten().all(|value| value.is_finite()) {
        return Err(DreamError::StartNotFinite);
    }
    if let Some(i) = zs.values.iter().position(|value| !value.is_finite()) {
        return Err(DreamError::Latents(i / n_latents));
    }
    if let Some(&mark) = unsafe_marks.iter().find(|mark| **mark >= n) {
        return Err(DreamError::Mark { mark, n_steps: n });
    }
    let mut end = 0;
    for range in planned {
        if range.start < end || range.is_empty() || range.end > n {
            return Err(DreamError::Planned { from: range.start, to: range.end, n_steps: n });
        }
        end = range.end;
    }
    Ok(())
}

/// A dream of `len` steps that a formula makes, for tests.
#[cfg(test)]
pub(crate) fn formula_dream(len: usize, seed: u64) -> DreamEpisode {
    let value = |i: usize| (i as f32 + seed as f32).sin();
    let start = LatentState {
        z: (0..4).map(value).collect(),
        c: (4..20).map(value).collect(),
        h: (20..36).map(value).collect(),
    };
    let mut episode = DreamEpisode::new(start, seed);
    for t in 0..len {
        episode.zs.push(&(t..t + 4).map(value).collect::<Vec<_>>());
        episode.actions.push(Action::new([value(t), 0.5, 0.0]));
    }
    episode.unsafe_marks = (0..len).step_by(7).collect();
    episode
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn dreams_survive_the_way_to_bytes_and_back() {
        for len in [0, 1, 33] {
            let dream = formula_dream(len, u64::MAX - 1);
            let bytes = dream_to_bytes(&dream);
            assert_eq!(dream_from_bytes(&bytes).unwrap(), dream);
            assert_eq!(bytes, dream_to_bytes(&dream), "the same dream has the same bytes");
            // A planner can only have driven steps that there are.
            let planned = if len == 33 { vec![3..9, 20..33] } else { vec![] };
            let shared = DreamEpisode { planned, ..dream };
            assert_eq!(dream_from_bytes(&dream_to_bytes(&shared)).unwrap(), shared);
        }
    }

    #[test]
    fn other_files_are_no_dreams() {
        assert!(dream_from_bytes(b"not a dream").is_err());
        let mut dream = formula_dream(5, 0);
        dream.actions.pop();
        let refused = dream_from_bytes(&dream_to_bytes(&dream)).unwrap_err().to_string();
        assert_eq!(refused, "its arrays do not fit: zs [5, 4], actions [4, 3]");
    }

    #[test]
    fn a_dream_that_cannot_be_is_refused_by_what_is_wrong_with_it() {
        let refused = |change: &dyn Fn(&mut DreamEpisode)| {
            let mut dream = formula_dream(20, 0);
            dream.planned = vec![3..9, 12..14];
            assert_eq!(dream_from_bytes(&dream_to_bytes(&dream)).unwrap(), dream, "unchanged it is one");
            change(&mut dream);
            dream_from_bytes(&dream_to_bytes(&dream)).unwrap_err().to_string()
        };
        assert!(refused(&|dream| dream.zs.values[4 * 7 + 1] = f32::NAN).contains("step 7"));
        assert!(refused(&|dream| dream.actions[6][1] = f32::INFINITY).contains("step 6"));
        assert!(refused(&|dream| dream.start.h[0] = f32::NAN).contains("start"));
        assert!(refused(&|dream| dream.start.h.truncate(3)).contains("outputs"));
        assert!(refused(&|dream| dream.start.z.truncate(2)).contains("fit"));
        assert!(refused(&|dream| (dream.start.c, dream.start.h) = (vec![], vec![])).contains("memory cells"));
        assert!(refused(&|dream| dream.unsafe_marks.push(20)).contains("step 20"));
        let planned: [&[[usize; 2]]; 5] =
            [&[[9, 3]], &[[3, 9], [8, 10]], &[[12, 14], [3, 9]], &[[18, 21]], &[[5, 5]]];
        for ranges in planned {
            let ranges: Vec<_> = ranges.iter().map(|&[from, to]| from..to).collect();
            assert!(
                refused(&|dream| dream.planned.clone_from(&ranges)).contains("the planner"),
                "{ranges:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn damaged_bytes_are_a_dream_or_refused(at in 0usize..2000, bytes: [u8; 3], cut in 0usize..2000) {
            let mut dream = formula_dream(20, 0);
            dream.planned.push(3..9);
            let mut damaged = dream_to_bytes(&dream);
            let n = damaged.len();
            for (i, byte) in bytes.into_iter().enumerate() {
                damaged[(at + i) % n] = byte;
            }
            if let Ok(dream) = dream_from_bytes(&damaged) {
                prop_assert!(check(&dream).is_ok());
            }
            damaged.truncate(cut);
            drop(dream_from_bytes(&damaged));
        }
    }
}
