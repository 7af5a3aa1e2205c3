//! Dreams and parameters as files that are whole or absent.

use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::dream::{DreamEpisode, Rows};
use crate::env::Action;
use crate::run::replace_file;
use crate::session::error::SessionError;
use crate::world_model::LatentState;

/// Puts `bytes` at `path`, whole or not at all.
pub(crate) fn write_whole(path: &Path, bytes: &[u8], tried: &'static str) -> Result<(), SessionError> {
    replace_file(path, bytes).map_err(SessionError::disk(tried, path))
}

/// A dream as a safetensors file; the same dream has the same bytes.
pub fn dream_to_bytes(episode: &DreamEpisode) -> Vec<u8> {
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let DreamEpisode { start, zs, actions, unsafe_marks, seed, planned } = episode;
    let action_values: Vec<f32> = actions.iter().flat_map(|action| action.to_array()).collect();
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
        ("actions", Dtype::F32, vec![actions.len(), Action::LEN], floats(&action_values)),
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
pub fn dream_from_bytes(bytes: &[u8]) -> Result<DreamEpisode, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let seed = SafeTensors::read_metadata(bytes).map_err(|e| e.to_string())?.1;
    let seed = seed.metadata().as_ref().and_then(|metadata| metadata.get("seed")?.parse().ok());
    let words = |name: &str, dtype: Dtype| {
        let view = file.tensor(name).map_err(|_| format!("it has no {name:?}"))?;
        if view.dtype() != dtype {
            return Err(format!("its {name:?} are of type {:?}", view.dtype()));
        }
        let words: Vec<[u8; 4]> = view.data().as_chunks::<4>().0.to_vec();
        Ok((words, view.shape().to_vec()))
    };
    let floats = |name: &str| {
        let (words, shape) = words(name, Dtype::F32)?;
        Ok::<_, String>((words.into_iter().map(f32::from_le_bytes).collect::<Vec<f32>>(), shape))
    };
    let start = LatentState { z: floats("start.z")?.0, c: floats("start.c")?.0, h: floats("start.h")?.0 };
    let (values, shape) = floats("zs")?;
    let (action_values, action_shape) = floats("actions")?;
    let (marks, _) = words("unsafe_marks", Dtype::U32)?;
    let ends = if file.tensor("planned").is_ok() { words("planned", Dtype::U32)?.0 } else { Vec::new() };
    let at = |word: [u8; 4]| u32::from_le_bytes(word) as usize;
    let planned = ends.as_chunks::<2>().0.iter().map(|&[from, to]| at(from)..at(to)).collect();
    let is_whole = matches!((&shape[..], &action_shape[..]), ([t, z], [n, a])
        if t == n && *z == start.z.len() && *a == Action::LEN && start.c.len() == start.h.len());
    if !is_whole {
        return Err(format!("its arrays do not fit: zs {shape:?}, actions {action_shape:?}"));
    }
    let (actions, _) = action_values.as_chunks::<{ Action::LEN }>();
    Ok(DreamEpisode {
        zs: Rows { width: start.z.len(), values },
        start,
        actions: actions.iter().copied().map(Action::from).collect(),
        unsafe_marks: marks.into_iter().map(|mark| u32::from_le_bytes(mark) as usize).collect(),
        seed: seed.ok_or("it has no seed")?,
        planned,
    })
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
        episode.actions.push(Action::new(value(t), 0.5, 0.0));
    }
    episode.unsafe_marks = (0..len).step_by(7).collect();
    episode
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dreams_survive_the_way_to_bytes_and_back() {
        for len in [0, 1, 33] {
            let dream = formula_dream(len, u64::MAX - 1);
            let bytes = dream_to_bytes(&dream);
            assert_eq!(dream_from_bytes(&bytes), Ok(dream.clone()));
            assert_eq!(bytes, dream_to_bytes(&dream), "the same dream has the same bytes");
            let shared = DreamEpisode { planned: vec![3..9, 20..33], ..dream };
            assert_eq!(dream_from_bytes(&dream_to_bytes(&shared)), Ok(shared));
        }
    }

    #[test]
    fn other_files_are_no_dreams() {
        assert!(dream_from_bytes(b"not a dream").is_err());
        let mut dream = formula_dream(5, 0);
        dream.actions.pop();
        let refused = dream_from_bytes(&dream_to_bytes(&dream)).unwrap_err();
        assert_eq!(refused, "its arrays do not fit: zs [5, 4], actions [4, 3]");
    }
}
