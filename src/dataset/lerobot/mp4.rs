//! Where the samples of a video lie in an MP4 file.
//!
//! Only what is needed is read, and every count is held against the bytes that are there before room is made for it: a
//! file of a few hundred bytes may claim to have thousands of millions of samples.

use std::fs::File;
use std::os::unix::fs::FileExt as _;

/// Bytes of the box that tells where everything lies.
const MOST_MOOV: u64 = 64 << 20;
/// Boxes of the file itself.
const MOST_BOXES: usize = 100_000;
/// Samples of a video: two days at 24 a second.
const MOST_SAMPLES: usize = 4_000_000;

/// The video of a file.
#[derive(Clone, Debug)]
pub(super) struct Track {
    /// What it is encoded as: `av01`, `avc1` and so on.
    pub(super) codec: String,
    pub(super) width: u32,
    pub(super) height: u32,
    /// Pictures a second. None where there is but one.
    pub(super) rate: Option<f64>,
    pub(super) samples: Vec<Sample>,
}

/// A picture as it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sample {
    pub(super) offset: u64,
    pub(super) len: u32,
    /// Whether it can be shown without those before it.
    pub(super) is_sync: bool,
}

/// Finds the video of a file of `len` bytes.
pub(super) fn read(file: &File, len: u64) -> Result<Track, String> {
    let moov = moov(file, len)?;
    if find(&moov, *b"mvex")?.is_some() {
        return Err("it is in fragments; join them with: ffmpeg -i IN.mp4 -c copy OUT.mp4".to_owned());
    }
    let mut rest = moov.as_slice();
    while let Some((kind, body)) = next(&mut rest)? {
        if kind == *b"trak"
            && let Some(track) = track(body, len)?
        {
            return Ok(track);
        }
    }
    Err("there is no video in it".to_owned())
}

/// The body of the box that tells where everything lies.
fn moov(file: &File, len: u64) -> Result<Vec<u8>, String> {
    let cut = || "it is no MP4 file, or is cut; copy it again".to_owned();
    let mut at = 0;
    for _ in 0..MOST_BOXES {
        if at >= len {
            break;
        }
        let mut head = [0; 16];
        let n = len.saturating_sub(at).min(16) as usize;
        file.read_exact_at(&mut head[..n], at).map_err(|met| met.to_string())?;
        let short = u64::from(number(&head, 0).ok_or_else(cut)?);
        let [head_len, size] = match short {
            0 => [8, len - at],
            1 if n == 16 => [16, long(&head, 8).ok_or_else(cut)?],
            size => [8, size],
        };
        let end =
            at.checked_add(size).filter(|end| *end <= len && size >= head_len && n >= 8).ok_or_else(cut)?;
        if &head[4..8] == b"moov" {
            let n_bytes = size - head_len;
            if n_bytes > MOST_MOOV {
                return Err(format!("it tells where its samples lie in {n_bytes} bytes"));
            }
            let mut body = vec![0; n_bytes as usize];
            file.read_exact_at(&mut body, at + head_len).map_err(|met| met.to_string())?;
            return Ok(body);
        }
        at = end;
    }
    Err(cut())
}

/// The track in a `trak`, if it is a video.
fn track(trak: &[u8], file_len: u64) -> Result<Option<Track>, String> {
    let mdia = wanted(trak, *b"mdia")?;
    if wanted(mdia, *b"hdlr")?.get(8..12) != Some(b"vide") {
        return Ok(None);
    }
    let wrong = |what: &str| format!("its box {what:?} is damaged; copy it again");
    let mdhd = wanted(mdia, *b"mdhd")?;
    let time_scale = number(mdhd, if mdhd.first() == Some(&1) { 20 } else { 12 });
    let time_scale = time_scale.filter(|&scale| scale > 0).ok_or_else(|| wrong("mdhd"))?;
    let stbl = wanted(wanted(mdia, *b"minf")?, *b"stbl")?;
    let stsd = wanted(stbl, *b"stsd")?;
    // The first of the descriptions: its length, its kind, and what each picture's has.
    let codec = stsd.get(12..16).ok_or_else(|| wrong("stsd"))?;
    let codec =
        codec.iter().map(|&byte| if byte.is_ascii_alphanumeric() { byte as char } else { '?' }).collect();
    let side = |at: usize| Some(u32::from(u16::from_be_bytes(*stsd.get(at..)?.first_chunk()?)));
    let (Some(width), Some(height)) = (side(40), side(42)) else { return Err(wrong("stsd")) };
    let mut samples = samples(stbl, file_len)?;
    if let Some(stss) = find(stbl, *b"stss")? {
        for sample in &mut samples {
            sample.is_sync = false;
        }
        for i in 0..count(stss, 4, 4).ok_or_else(|| wrong("stss"))? {
            let at = number(stss, 8 + 4 * i).and_then(|n| n.checked_sub(1)).ok_or_else(|| wrong("stss"))?;
            samples.get_mut(at as usize).ok_or_else(|| wrong("stss"))?.is_sync = true;
        }
    }
    let stts = wanted(stbl, *b"stts")?;
    let (mut ticks, mut left) = (0_u128, samples.len().saturating_sub(1) as u128);
    for i in 0..count(stts, 4, 8).ok_or_else(|| wrong("stts"))? {
        let (n, each) = number(stts, 8 + 8 * i).zip(number(stts, 12 + 8 * i)).ok_or_else(|| wrong("stts"))?;
        // How long the last picture is shown is nobody's rate.
        let n = left.min(u128::from(n));
        ticks += n * u128::from(each);
        left -= n;
    }
    let n_steps = samples.len().saturating_sub(1) as f64;
    let rate = (ticks > 0 && left == 0).then(|| n_steps * f64::from(time_scale) / ticks as f64);
    Ok(Some(Track { codec, width, height, rate, samples }))
}

/// Where the samples lie, as the chunks have them.
fn samples(stbl: &[u8], file_len: u64) -> Result<Vec<Sample>, String> {
    let wrong = |what: &str| format!("its box {what:?} is damaged; copy it again");
    let stsz = wanted(stbl, *b"stsz")?;
    let (each, n) = number(stsz, 4).zip(number(stsz, 8)).ok_or_else(|| wrong("stsz"))?;
    let n = n as usize;
    if n > MOST_SAMPLES || (each == 0 && stsz.len() < 12 + 4 * n) {
        return Err(wrong("stsz"));
    }
    let len = |i: usize| if each > 0 { Some(each) } else { number(stsz, 12 + 4 * i) };
    let (chunks, is_long) = match find(stbl, *b"stco")? {
        Some(chunks) => (chunks, false),
        None => (wanted(stbl, *b"co64")?, true),
    };
    let n_chunks = count(chunks, 4, if is_long { 8 } else { 4 }).ok_or_else(|| wrong("stco"))?;
    let stsc = wanted(stbl, *b"stsc")?;
    let n_runs = count(stsc, 4, 12).ok_or_else(|| wrong("stsc"))?;
    let run =
        |i: usize| if i < n_runs { number(stsc, 8 + 12 * i).zip(number(stsc, 12 + 12 * i)) } else { None };
    let mut samples = Vec::with_capacity(n);
    let mut at_run = 0;
    for chunk in 0..n_chunks {
        while run(at_run + 1).is_some_and(|(first, _)| first as usize <= chunk + 1) {
            at_run += 1;
        }
        let (_, per_chunk) = run(at_run).ok_or_else(|| wrong("stsc"))?;
        let offset =
            if is_long { long(chunks, 8 + 8 * chunk) } else { number(chunks, 8 + 4 * chunk).map(u64::from) };
        let mut offset = offset.ok_or_else(|| wrong("stco"))?;
        for _ in 0..per_chunk {
            if samples.len() == n {
                break;
            }
            let len = len(samples.len()).ok_or_else(|| wrong("stsz"))?;
            let end = offset.checked_add(u64::from(len)).filter(|end| *end <= file_len);
            let end = end.ok_or_else(|| {
                format!(
                    "its picture {} lies behind its end, for the file is cut; copy it again",
                    samples.len()
                )
            })?;
            samples.push(Sample { offset, len, is_sync: true });
            offset = end;
        }
    }
    if samples.len() < n {
        return Err(wrong("stsc"));
    }
    Ok(samples)
}

/// The body of the box of this kind in `body`, which must be there.
fn wanted(body: &[u8], kind: [u8; 4]) -> Result<&[u8], String> {
    let name = String::from_utf8_lossy(&kind);
    find(body, kind)?.ok_or_else(|| format!("it lacks the box {name:?}; copy it again"))
}

/// The body of the first box of this kind in `body`.
fn find(body: &[u8], kind: [u8; 4]) -> Result<Option<&[u8]>, String> {
    let mut rest = body;
    while let Some((found, inner)) = next(&mut rest)? {
        if found == kind {
            return Ok(Some(inner));
        }
    }
    Ok(None)
}

/// The kind and the body of a box.
type Boxed<'a> = ([u8; 4], &'a [u8]);

/// The next box.
fn next<'a>(rest: &mut &'a [u8]) -> Result<Option<Boxed<'a>>, String> {
    if rest.len() < 8 {
        return Ok(None);
    }
    let all: &'a [u8] = rest;
    let whole = match number(all, 0).unwrap_or_default() {
        0 => Some(all.len()),
        // None of the boxes in a box of 64 MiB needs eight bytes for its length.
        size => Some(size as usize).filter(|size| (8..=all.len()).contains(size)),
    };
    let whole = whole.ok_or("a box in it is longer than what holds it; copy it again")?;
    let kind = [all[4], all[5], all[6], all[7]];
    *rest = &all[whole..];
    Ok(Some((kind, &all[8..whole])))
}

/// How many entries of `len` bytes each a list has, whose number stands at `at`; all of them are there.
fn count(body: &[u8], at: usize, len: usize) -> Option<usize> {
    let n = number(body, at)? as usize;
    (n.checked_mul(len)? <= body.len().checked_sub(at + 4)?).then_some(n)
}

/// The number of four bytes at `at`.
fn number(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// The number of eight bytes at `at`.
fn long(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}
