//! Curves where people look at curves: event files of `TensorBoard`, which other viewers read, too.
//!
//! A file is a row of records; a record is the length of an event, the event, and a checksum of each:
//!
//! ```text
//! length: u64 · crc(length): u32 · event · crc(event): u32          all little-endian
//! crc = CRC-32C, rotated right by 15 bits, plus 0xa282ead8
//! event: 1 = seconds since 1970 (f64) · 2 = step · 3 = version | 5 = summary { 1 = { 1 = name · 2 = value (f32) } … }
//! ```

use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// The name of an event file: viewers look for the middle of it.
pub const NAME: &str = "events.out.tfevents.dropj";
/// What the first event of a file says.
const VERSION: &str = "brain.Event:2";
/// CRC-32C (Castagnoli), reflected.
const POLYNOMIAL: u32 = 0x82f6_3b78;

/// Appends a point to each of the named curves at `step` to the event file at `path`, which is begun where there is none.
///
/// # Errors
/// Where it cannot be written.
pub fn append(path: &Path, step: u64, points: &[(&str, f32)]) -> io::Result<()> {
    let mut bytes = Vec::new();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let mut file = OpenOptions::new().append(true).create(true).open(path)?;
    if file.metadata()?.len() == 0 {
        record(&event(now, 0, &field(3, VERSION.as_bytes())), &mut bytes);
    }
    let values = points.iter().flat_map(|(name, value)| {
        let mut point = field(1, name.as_bytes());
        point.push(2 << 3 | 5);
        point.extend(value.to_le_bytes());
        field(1, &point)
    });
    let summary: Vec<u8> = values.collect();
    record(&event(now, step, &field(5, &summary)), &mut bytes);
    file.write_all(&bytes)
}

/// An event with what it tells.
fn event(now: f64, step: u64, told: &[u8]) -> Vec<u8> {
    let mut event = vec![1 << 3 | 1];
    event.extend(now.to_le_bytes());
    event.push(2 << 3);
    number(step, &mut event);
    event.extend(told);
    event
}

/// A field of bytes, as protocol buffers have it.
fn field(of: u8, bytes: &[u8]) -> Vec<u8> {
    let mut field = vec![of << 3 | 2];
    number(bytes.len() as u64, &mut field);
    field.extend(bytes);
    field
}

/// A number, seven bits a byte, the lowest first.
fn number(mut value: u64, to: &mut Vec<u8>) {
    while value > 0x7f {
        to.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

fn record(event: &[u8], to: &mut Vec<u8>) {
    let length = (event.len() as u64).to_le_bytes();
    to.extend(length);
    to.extend(checksum(&length).to_le_bytes());
    to.extend(event);
    to.extend(checksum(event).to_le_bytes());
}

fn checksum(bytes: &[u8]) -> u32 {
    let crc = !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { POLYNOMIAL } else { 0 })
    });
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    // The check value of CRC-32C, as every catalog of checksums has it, before it is masked.
    #[test]
    fn checksums_are_castagnolis() {
        assert_eq!(checksum(b"123456789"), 0xe306_9283_u32.rotate_right(15).wrapping_add(0xa282_ead8));
    }

    // TensorBoard's own reader opens such a file in `.ci/check-curves`.
    #[test]
    fn a_file_begins_with_its_version_and_grows_by_a_record_a_call() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(NAME);
        append(&path, 300, &[("vision/loss", 0.5), ("vision/held out", 0.25)]).unwrap();
        append(&path, 301, &[("vision/loss", 0.125)]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut events: Vec<&[u8]> = Vec::new();
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            let n = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            assert_eq!(rest[8..12], checksum(&rest[..8]).to_le_bytes());
            let (event, sum) = (&rest[12..12 + n], &rest[12 + n..16 + n]);
            assert_eq!(sum, checksum(event).to_le_bytes());
            events.push(event);
            rest = &rest[16 + n..];
        }
        assert_eq!(events.len(), 3);
        let shows = |event: &[u8], what: &[u8]| event.windows(what.len()).any(|part| part == what);
        assert!(shows(events[0], VERSION.as_bytes()));
        assert!(shows(events[1], b"vision/held out") && shows(events[1], &0.25f32.to_le_bytes()));
        assert_eq!(events[1][9..12], [2 << 3, 0x80 | 0x2c, 2], "step 300, seven bits a byte");
        assert!(shows(events[2], &0.125f32.to_le_bytes()) && !shows(events[2], b"held out"));
    }
}
