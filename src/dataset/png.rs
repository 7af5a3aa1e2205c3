//! Frames as PNG and back: lossless, and fast rather than small.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder as _, ImageEncoder as _};

use super::damage::FrameError;
use super::limits;
use crate::env::Frame;

/// A frame as a PNG file.
pub(super) fn encode(frame: &Frame) -> Vec<u8> {
    let mut png = Vec::with_capacity(frame.rgb().len() / 2);
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
        .write_image(frame.rgb(), frame.side(), frame.side(), ExtendedColorType::Rgb8)
        .expect("writing to memory does not fail");
    png
}

/// Pixels a side of the square that a PNG file says it shows, which is of a sane size.
pub(super) fn side(png: &[u8]) -> Result<u32, FrameError> {
    // The signature, then the first chunk: length, "IHDR", width, height.
    let size = png.get(16..24).filter(|_| png.starts_with(b"\x89PNG\r\n\x1a\n") && &png[12..16] == b"IHDR");
    let (size, _) = size.ok_or(FrameError::NotPng)?.as_chunks();
    let [width, height] = [size[0], size[1]].map(u32::from_be_bytes);
    let is_sane = width == height && (1..=limits::SIDE).contains(&width);
    if is_sane { Ok(width) } else { Err(FrameError::NotSquare) }
}

/// The frame of `side` pixels a side that a PNG file shows, or why there is none.
pub(super) fn decode(png: &[u8], side: u32) -> Result<Frame, FrameError> {
    // Before anything is allocated.
    let found = self::side(png)?;
    if found != side {
        return Err(FrameError::Side { found, wanted: side });
    }
    let decoder = PngDecoder::new(Cursor::new(png)).map_err(FrameError::Image)?;
    if decoder.color_type() != ColorType::Rgb8 || decoder.dimensions() != (side, side) {
        return Err(FrameError::NotRgb(decoder.color_type()));
    }
    let mut rgb = vec![0; 3 * side as usize * side as usize];
    decoder.read_image(&mut rgb).map_err(FrameError::Image)?;
    Ok(Frame::new(side, rgb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_comes_back_bit_by_bit() {
        let rgb: Vec<u8> = (0..3 * 9 * 9).map(|byte| (byte * 37 % 251) as u8).collect();
        let frame = Frame::new(9, rgb);
        assert_eq!(decode(&encode(&frame), 9).unwrap(), frame);
    }

    #[test]
    fn a_flipped_bit_is_noticed() {
        let mut png = encode(&Frame::new(8, vec![7; 3 * 64]));
        let middle = png.len() - 20;
        png[middle] ^= 1;
        assert!(decode(&png, 8).is_err(), "the checksum of a chunk covers it");
    }

    #[test]
    fn a_frame_that_claims_to_be_huge_or_of_another_size_is_refused_before_it_is_read() {
        let mut png = encode(&Frame::new(8, vec![7; 3 * 64]));
        assert!(decode(&png, 9).is_err(), "of another size");
        for at in [16, 20] {
            png[at..at + 4].copy_from_slice(&60_000_u32.to_be_bytes());
        }
        assert!(side(&png).is_err() && decode(&png, 60_000).is_err(), "10 GB");
        assert!(side(b"\x89PNG").is_err() && side(b"").is_err(), "cut");
    }
}
