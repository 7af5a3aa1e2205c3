//! The container of all arrays on disk, safetensors: read within bounds, and written alike for the same content.
//!
//! By hand on purpose: the reader of the crate `safetensors` trusts sums of sizes and forgets in which order a header
//! tells things. This one
//! trusts nothing, and what it has read can be written again byte by byte.

use std::fmt;
use std::ops::Range;

pub use safetensors::Dtype;
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use crate::tensor::limits::{MAX_AXES, MAX_HEADER, MAX_NUMBERS, MAX_TENSORS};

/// Bytes that tell how long the header is. Its length is a multiple of them.
const N_LEN: usize = 8;
/// What the metadata is called among the tensors.
const METADATA: &str = "__metadata__";

/// What a header tells of one tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// Of what its numbers are.
    pub dtype: Dtype,
    /// Its sizes.
    pub shape: Vec<usize>,
    /// Where its bytes lie behind the header.
    pub place: Range<usize>,
}

/// Why bytes are no safetensors file, or none that is read.
#[derive(Debug, thiserror::Error)]
pub enum ContainerError {
    /// There are none.
    #[error("the file is empty")]
    Empty,
    /// Git LFS put a pointer in the file's place.
    #[error("it is a pointer of Git LFS and not the file itself, which `git lfs pull` fetches")]
    LfsPointer,
    /// PyTorch saved them in its own way.
    #[error("it is a zip, as PyTorch's own files are; they have to be saved as safetensors")]
    Zip,
    /// They end before the length of the header does.
    #[error("{0} bytes are too few")]
    Short(usize),
    /// The header is said to be larger than any of ours.
    #[error("its header is said to have {0} bytes, and at most {MAX_HEADER} are read")]
    LongHeader(u64),
    /// They end before the header does.
    #[error("it is cut short: its header has {len} bytes, and {n_there} are there")]
    Cut {
        /// How many bytes the header is said to have.
        len: u64,
        /// How many bytes there are.
        n_there: usize,
    },
    /// The header is not JSON, or tells something else.
    #[error("its header cannot be read: {0}")]
    Header(serde_json::Error),
    /// A tensor has more axes than any of ours.
    #[error("{name:?} has {n_axes} axes, and at most {MAX_AXES} are read")]
    Axes {
        /// Which one.
        name: String,
        /// How many it has.
        n_axes: usize,
    },
    /// The tensors do not lie side by side.
    #[error("{0:?} does not begin where the tensor before it ends")]
    Apart(String),
    /// A tensor would be larger than can be.
    #[error("{name:?} has the shape {shape:?}, which is none of a tensor")]
    Shape {
        /// Which one.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
    },
    /// A tensor has not as many bytes as its type and its shape want.
    #[error("{name:?} of the shape {shape:?} does not have {n_bytes} bytes")]
    Bytes {
        /// Which one.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
        /// How many it has.
        n_bytes: usize,
    },
    /// The tensors do not fill the file.
    #[error("its tensors have {end} bytes, and {n_there} are there")]
    Rest {
        /// How many bytes they have.
        end: usize,
        /// How many there are.
        n_there: usize,
    },
}

/// A file that was found whole.
#[derive(Clone, Debug)]
pub struct Container<'a> {
    /// Keys and values, in the order of the header.
    pub metadata: Option<Vec<(String, String)>>,
    /// In the order of the header.
    pub entries: Vec<Entry>,
    data: &'a [u8],
}

impl<'a> Container<'a> {
    /// What `bytes` hold, or what is wrong with them.
    pub fn read(bytes: &'a [u8]) -> Result<Self, ContainerError> {
        if let Some(stranger) = stranger(bytes) {
            return Err(stranger);
        }
        let short = || ContainerError::Short(bytes.len());
        let (len, rest) = bytes.split_first_chunk::<N_LEN>().ok_or_else(short)?;
        let len = u64::from_le_bytes(*len);
        if len > MAX_HEADER as u64 {
            return Err(ContainerError::LongHeader(len));
        }
        let cut = || ContainerError::Cut { len, n_there: rest.len() };
        let (header, data) = rest.split_at_checked(len as usize).ok_or_else(cut)?;
        let Header { metadata, entries } = serde_json::from_slice(header).map_err(ContainerError::Header)?;
        check_places(&entries, data.len())?;
        Ok(Self { metadata, entries, data })
    }

    /// What the header tells of the tensor called `name`.
    pub fn entry(&self, name: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.name == name)
    }

    /// The value of `key` in the metadata.
    pub fn value(&self, key: &str) -> Option<&str> {
        let mut metadata = self.metadata.iter().flatten();
        metadata.find(|(found, _)| found == key).map(|(_, value)| value.as_str())
    }

    /// The bytes of a tensor of this file.
    pub fn bytes(&self, entry: &Entry) -> &'a [u8] {
        self.data.get(entry.place.clone()).unwrap_or_default()
    }

    /// The numbers of a tensor of this file, where they are floating.
    ///
    /// F16 and BF16 are widened exactly. F64 is rounded.
    pub fn floats(&self, entry: &Entry) -> Option<Vec<f32>> {
        let bytes = self.bytes(entry);
        let halves = || bytes.as_chunks::<2>().0.iter().map(|bytes| u16::from_le_bytes(*bytes));
        Some(match entry.dtype {
            Dtype::F32 => bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(),
            Dtype::F64 => {
                bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes) as f32).collect()
            }
            Dtype::F16 => halves().map(of_half).collect(),
            Dtype::BF16 => halves().map(|bits| f32::from_bits(u32::from(bits) << 16)).collect(),
            _ => return None,
        })
    }
}

/// The number that sixteen bits mean in IEEE 754's half precision.
fn of_half(bits: u16) -> f32 {
    let (sign, exponent, fraction) =
        (u32::from(bits >> 15) << 31, u32::from(bits >> 10 & 0x1f), u32::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => (fraction as f32 / 16_777_216.0).to_bits(), // 2⁻²⁴ each
        0x1f => 0xff << 23 | fraction << 13,
        _ => (exponent + 127 - 15) << 23 | fraction << 13,
    };
    f32::from_bits(sign | magnitude)
}

/// What `bytes` seem to be, where that is a thing that is often taken for such a file.
fn stranger(bytes: &[u8]) -> Option<ContainerError> {
    match bytes {
        [] => Some(ContainerError::Empty),
        _ if bytes.starts_with(b"version https://git-lfs") => Some(ContainerError::LfsPointer),
        _ if bytes.starts_with(b"PK\x03\x04") => Some(ContainerError::Zip),
        _ => None,
    }
}

/// Whether the tensors lie side by side and fill `n` bytes, each as its type and shape want.
fn check_places(entries: &[Entry], n_there: usize) -> Result<(), ContainerError> {
    let mut in_place: Vec<_> = entries.iter().collect();
    in_place.sort_by_key(|entry| (entry.place.start, entry.place.end));
    let mut end = 0;
    for Entry { name, dtype, shape, place } in in_place {
        if shape.len() > MAX_AXES {
            return Err(ContainerError::Axes { name: name.clone(), n_axes: shape.len() });
        }
        if place.start != end || place.end < place.start {
            return Err(ContainerError::Apart(name.clone()));
        }
        let n = shape.iter().try_fold(1_usize, |n, &size| n.checked_mul(size.max(1)));
        if n.is_none_or(|n| n > MAX_NUMBERS) {
            return Err(ContainerError::Shape { name: name.clone(), shape: shape.clone() });
        }
        let bits = shape.iter().try_fold(dtype.bitsize(), |bits, &size| bits.checked_mul(size));
        if bits != place.len().checked_mul(8) {
            let (name, shape) = (name.clone(), shape.clone());
            return Err(ContainerError::Bytes { name, shape, n_bytes: place.len() });
        }
        end = place.end;
    }
    if end == n_there { Ok(()) } else { Err(ContainerError::Rest { end, n_there }) }
}

/// The header as it is written.
struct Header {
    metadata: Option<Vec<(String, String)>>,
    entries: Vec<Entry>,
}

impl<'de> Deserialize<'de> for Header {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;

        #[derive(Deserialize)]
        struct Info {
            dtype: Dtype,
            shape: Vec<usize>,
            data_offsets: (usize, usize),
        }

        impl<'de> Visitor<'de> for InOrder {
            type Value = Header;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the tensors by name")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Header, A::Error> {
                let mut header = Header { metadata: None, entries: Vec::new() };
                let mut names = std::collections::BTreeSet::new();
                while let Some(name) = map.next_key::<String>()? {
                    if !names.insert(name.clone()) {
                        return Err(A::Error::custom(format!("{name:?} is there twice")));
                    }
                    if name == METADATA {
                        header.metadata = map.next_value::<Option<Pairs>>()?.map(|Pairs(pairs)| pairs);
                        continue;
                    }
                    if header.entries.len() == MAX_TENSORS {
                        return Err(A::Error::custom(format!("it has more than {MAX_TENSORS} tensors")));
                    }
                    let Info { dtype, shape, data_offsets: (start, end) } = map.next_value()?;
                    header.entries.push(Entry { name, dtype, shape, place: start..end });
                }
                Ok(header)
            }
        }

        deserializer.deserialize_map(InOrder)
    }
}

/// Keys and values in the order in which they stand.
struct Pairs(Vec<(String, String)>);

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;

        impl<'de> Visitor<'de> for InOrder {
            type Value = Pairs;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("texts by name")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Pairs, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }

        deserializer.deserialize_map(InOrder)
    }
}

/// A tensor to be written.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Of what its numbers are.
    pub dtype: Dtype,
    /// Its sizes.
    pub shape: Vec<usize>,
    /// Its numbers in row-major order, little-endian.
    pub bytes: Vec<u8>,
}

/// The bytes of a file with `metadata` and `parts` in this order: the same for the same content.
pub fn write(metadata: Option<&[(String, String)]>, parts: &[Part]) -> Vec<u8> {
    let text = |text: &str| serde_json::to_string(text).unwrap_or_else(|e| unreachable!("plain text: {e}"));
    let mut fields = Vec::new();
    if let Some(metadata) = metadata {
        let pairs: Vec<_> =
            metadata.iter().map(|(key, value)| format!("{}:{}", text(key), text(value))).collect();
        fields.push(format!("\"{METADATA}\":{{{}}}", pairs.join(",")));
    }
    let mut end = 0;
    for Part { name, dtype, shape, bytes } in parts {
        let sizes: Vec<_> = shape.iter().map(usize::to_string).collect();
        let (name, sizes, start) = (text(name), sizes.join(","), end);
        end += bytes.len();
        fields.push(format!(
            "{name}:{{\"dtype\":\"{dtype}\",\"shape\":[{sizes}],\"data_offsets\":[{start},{end}]}}"
        ));
    }
    let mut header = format!("{{{}}}", fields.join(",")).into_bytes();
    header.resize(header.len().next_multiple_of(N_LEN), b' ');
    let mut file = Vec::with_capacity(N_LEN + header.len() + end);
    file.extend((header.len() as u64).to_le_bytes());
    file.extend(header);
    for part in parts {
        file.extend(&part.bytes);
    }
    file
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use safetensors::tensor::TensorView;

    use super::*;

    fn parts() -> Vec<Part> {
        let part = |name: &str, dtype, shape: &[usize], n: usize| Part {
            name: name.to_owned(),
            dtype,
            shape: shape.to_vec(),
            bytes: (0..n).map(|i| i as u8).collect(),
        };
        vec![
            part("a", Dtype::F32, &[2, 1], 8),
            part("b \"2\"", Dtype::F32, &[], 4),
            part("c", Dtype::U32, &[0, 2], 0),
        ]
    }

    fn metadata() -> Vec<(String, String)> {
        vec![("seed".to_owned(), "{\"a\": 1}\n".to_owned())]
    }

    #[test]
    fn a_file_is_that_of_the_reference_and_is_read_as_written() {
        let (parts, metadata) = (parts(), metadata());
        let bytes = write(Some(&metadata), &parts);
        let views = parts.iter().map(|part| {
            (part.name.as_str(), TensorView::new(part.dtype, part.shape.clone(), &part.bytes).unwrap())
        });
        let reference = safetensors::serialize(views, Some(metadata.iter().cloned().collect())).unwrap();
        assert_eq!(bytes, reference);

        let read = Container::read(&bytes).unwrap();
        assert_eq!(read.metadata.as_deref(), Some(&metadata[..]));
        let a = read.entry("a").unwrap();
        assert_eq!((a.shape.as_slice(), read.bytes(a)), (&[2, 1][..], &parts[0].bytes[..]));
        assert_eq!(write(None, &[]), write(None, &[]));
    }

    #[test]
    fn halves_are_widened_exactly() {
        let cases =
            [(0x3c00, 1.0), (0xc000, -2.0), (0x0001, 2.0_f32.powi(-24)), (0x03ff, 1023.0 / 16_777_216.0)];
        for (bits, value) in cases {
            assert_eq!(of_half(bits), value);
        }
        assert_eq!((of_half(0x7bff), of_half(0x3555)), (65504.0, 0.333_251_95));
        assert_eq!(of_half(0x8000).to_bits(), (-0.0_f32).to_bits());
        assert!(of_half(0x7e00).is_nan() && of_half(0xfc00) == f32::NEG_INFINITY);
    }

    #[test]
    fn what_is_often_taken_for_such_a_file_is_named() {
        let said = |bytes: &[u8]| Container::read(bytes).unwrap_err().to_string();
        assert!(said(b"").contains("empty"));
        assert!(said(b"version https://git-lfs.github.com/spec/v1\noid").contains("git lfs pull"));
        assert!(said(b"PK\x03\x04\0\0\0\0\0\0").contains("zip"));
        assert!(said(&u64::MAX.to_le_bytes()).contains("at most"));
        let whole = write(None, &parts());
        assert!(said(&whole[..whole.len() - 1]).contains("are there"));
        assert!(said(&whole[..20]).contains("cut short"));
    }

    /// Eight tensors whose sizes add up to almost 2⁶⁴: with the header the sum is no number of bytes.
    #[test]
    fn sizes_that_overflow_are_refused() {
        let size = (1_u64 << 61) - 1;
        let fields: Vec<_> = (0..8)
            .map(|i| {
                let offsets = [i * size, (i + 1) * size];
                format!("\"{i}\":{{\"dtype\":\"U8\",\"shape\":[{size}],\"data_offsets\":{offsets:?}}}")
            })
            .collect();
        let header = format!("{{{}}}", fields.join(","));
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.into_bytes());
        assert!(Container::read(&bytes).unwrap_err().to_string().contains("none of a tensor"));
        let part = Part { name: "a".to_owned(), dtype: Dtype::F32, shape: vec![0, 1 << 62], bytes: vec![] };
        let bytes = write(None, &[part]);
        assert!(
            Container::read(&bytes).unwrap_err().to_string().contains("none of a tensor"),
            "empty, and of no size"
        );
        let twice = br#"{"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]},"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}}"#;
        let bytes = [&(twice.len() as u64).to_le_bytes()[..], twice].concat();
        assert!(Container::read(&bytes).unwrap_err().to_string().contains("twice"));
    }

    proptest! {
        #[test]
        fn damaged_bytes_are_read_or_refused(at in 0usize..200, byte: u8, cut in 0usize..200) {
            let mut bytes = write(Some(&metadata()), &parts());
            let n = bytes.len();
            bytes[at % n] = byte;
            drop(Container::read(&bytes));
            bytes.truncate(cut);
            drop(Container::read(&bytes));
        }
    }
}
