//! What clips looked like when a session was recorded, coarsely, so that another processor sees them alike.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::query::DreamId;
use crate::session::arrays::write_whole;
use crate::session::error::{ClipHashError, SessionError};
use crate::text::trimmed;
use crate::world::Frame;

/// The file in a session's folder.
pub const FILE: &str = "clips.json";
/// Fields a side that a picture is divided into.
const FIELDS: u32 = 4;

/// A clip in small: the mean colors of 4 x 4 fields of its first picture, then of its last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClipHash(Vec<u8>);

impl ClipHash {
    /// How far two may lie apart and still be of the same clip, in steps of 256: pictures are drawn in bf16 or in f32.
    pub const TOLERANCE: u8 = 4;

    /// That of a clip.
    pub fn of(clip: &[Frame]) -> Self {
        Self([clip.first(), clip.last()].into_iter().flatten().flat_map(means).collect())
    }

    /// The largest difference of a color.
    pub fn apart(&self, other: &Self) -> u8 {
        let colors = self.0.iter().zip(&other.0).map(|(a, b)| a.abs_diff(*b));
        if self.0.len() == other.0.len() { colors.max().unwrap_or(0) } else { u8::MAX }
    }
}

/// The mean colors of the fields of `frame`, row by row.
fn means(frame: &Frame) -> Vec<u8> {
    let (height, width) = (frame.height(), frame.width());
    let mut sums = vec![(0_u64, 0_u64); (3 * FIELDS * FIELDS) as usize];
    for (i, rgb) in (0..).zip(frame.rgb().as_chunks::<3>().0) {
        let (row, column) = (i / width * FIELDS / height, i % width * FIELDS / width);
        for (channel, value) in rgb.iter().enumerate() {
            let (sum, n) = &mut sums[3 * (row * FIELDS + column) as usize + channel];
            (*sum, *n) = (*sum + u64::from(*value), *n + 1);
        }
    }
    sums.iter().map(|(sum, n)| (sum / n.max(&1)) as u8).collect()
}

impl Serialize for ClipHash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut hex = String::new();
        for byte in &self.0 {
            write!(hex, "{byte:02x}").unwrap_or_else(|_| unreachable!("a string takes all"));
        }
        serializer.serialize_str(&hex)
    }
}

impl<'de> Deserialize<'de> for ClipHash {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let hex = String::deserialize(deserializer)?;
        let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
        let (pairs, rest) = hex.as_bytes().as_chunks::<2>();
        let bytes = pairs.iter().map(|&[high, low]| Some(16 * digit(high)? + digit(low)?)).collect();
        let bytes: Option<Vec<u8>> = if rest.is_empty() { bytes } else { None };
        bytes.map(Self).ok_or_else(|| D::Error::custom("colors are pairs of hexadecimal digits"))
    }
}

/// The hashes of clips, by dream and first step.
pub type ClipHashes = BTreeMap<(DreamId, usize), ClipHash>;

/// Writes `hashes` into the session in `dir`.
pub(super) fn write(dir: &Path, hashes: &ClipHashes) -> Result<(), SessionError> {
    let named: BTreeMap<_, _> =
        hashes.iter().map(|((dream, start), hash)| (format!("{}/{start}", dream.0), hash)).collect();
    let text = serde_json::to_vec_pretty(&named).unwrap_or_else(|e| unreachable!("plain data: {e}"));
    write_whole(&dir.join(FILE), &text, "write down what the clips look like")
}

/// The hashes that were written into the session in `dir`, if any were.
pub(super) fn read(dir: &Path) -> Result<Option<ClipHashes>, SessionError> {
    let path = dir.join(FILE);
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read(&path).map_err(SessionError::disk("read what the clips look like", &path))?;
    parse(&text, &path).map(Some)
}

/// The hashes in the bytes of such a file: a pure function, which takes whatever bytes there are.
pub fn parse(bytes: &[u8], path: &Path) -> Result<ClipHashes, SessionError> {
    let wrong = |met| SessionError::ClipHashes { met, path: path.to_owned() };
    let named: BTreeMap<String, ClipHash> =
        serde_json::from_slice(trimmed(bytes)).map_err(|e| wrong(ClipHashError::Json(e)))?;
    let parse = |(name, hash): (String, ClipHash)| {
        let (dream, start) = name.split_once('/')?;
        Some(((DreamId(dream.parse().ok()?), start.parse().ok()?), hash))
    };
    let hashes: Option<ClipHashes> = named.into_iter().map(parse).collect();
    hashes.ok_or_else(|| wrong(ClipHashError::Name))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A picture that grows lighter downwards from `at`.
    fn frame(at: u8) -> Frame {
        Frame::square(8, (0..192_u8).map(|i| at + i / 24).collect::<Vec<_>>())
    }

    #[test]
    fn a_clip_looks_like_itself_and_unlike_others() {
        let hash = ClipHash::of(&[frame(10), frame(99), frame(40)]);
        assert_eq!(hash.0.len(), 2 * 48, "two pictures of sixteen colors");
        assert_eq!((hash.0[0], hash.0[47]), (10, 16), "rows 0 and 1, rows 6 and 7");
        assert_eq!(hash.apart(&ClipHash::of(&[frame(10), frame(0), frame(40)])), 0, "only its ends count");
        assert_eq!(hash.apart(&ClipHash::of(&[frame(10), frame(46)])), 6);
        assert_eq!(hash.apart(&ClipHash::of(&[])), u8::MAX);
    }

    #[test]
    fn hashes_survive_the_way_to_a_file_and_back() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(read(dir.path()).unwrap(), None);
        let hashes = ClipHashes::from([
            ((DreamId(2), 35), ClipHash::of(&[frame(1)])),
            ((DreamId(11), 0), ClipHash::of(&[])),
        ]);
        write(dir.path(), &hashes).unwrap();
        assert_eq!(read(dir.path()).unwrap(), Some(hashes));
        std::fs::write(dir.path().join(FILE), r#"{"2": "00"}"#).unwrap();
        assert!(read(dir.path()).unwrap_err().to_string().contains("3/120"));
    }

    #[test]
    fn what_is_no_color_is_refused() {
        let hash =
            |hex: &str| parse(format!("\u{feff}{{\"4/280\":\"{hex}\"}}").as_bytes(), Path::new("clips.json"));
        assert_eq!(hash("0a").unwrap().len(), 1);
        for hex in ["é0é", "0", "+1", "0g", "00 "] {
            assert!(hash(hex).unwrap_err().to_string().contains("hexadecimal"), "{hex:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_hashes_or_an_error(bytes in any::<Vec<u8>>()) {
            drop(parse(&bytes, Path::new("clips.json")));
        }
    }
}
