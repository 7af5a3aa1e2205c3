//! Frames as PNG and back: lossless, and fast rather than small.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder as _, ImageEncoder as _};

use super::damage::FrameError;
use super::limits;
use crate::world::{Frame, Size};

/// A frame as a PNG file.
pub fn encode(frame: &Frame) -> Vec<u8> {
    let mut png = Vec::with_capacity(frame.rgb().len() / 2);
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
        .write_image(frame.rgb(), frame.width(), frame.height(), ExtendedColorType::Rgb8)
        .expect("writing to memory does not fail");
    png
}

/// The size of what a PNG file says it shows, where that is sane.
pub(super) fn size(png: &[u8]) -> Result<Size, FrameError> {
    // The signature, then the first chunk: length, "IHDR", width, height.
    let size = png.get(16..24).filter(|_| png.starts_with(b"\x89PNG\r\n\x1a\n") && &png[12..16] == b"IHDR");
    let (size, _) = size.ok_or(FrameError::NotPng)?.as_chunks();
    let [width, height] = [size[0], size[1]].map(u32::from_be_bytes);
    let size = Size { height, width };
    if limits::is_sane(size) { Ok(size) } else { Err(FrameError::Limits(size)) }
}

/// The frame of this size that a PNG file shows, or why there is none.
pub(super) fn decode(png: &[u8], wanted: Size) -> Result<Frame, FrameError> {
    // Before anything is allocated.
    let found = size(png)?;
    if found != wanted {
        return Err(FrameError::Size { found, wanted });
    }
    let Size { height, width } = found;
    let decoder = PngDecoder::new(Cursor::new(png)).map_err(FrameError::Image)?;
    if decoder.color_type() != ColorType::Rgb8 || decoder.dimensions() != (width, height) {
        return Err(FrameError::NotRgb(decoder.color_type()));
    }
    let mut rgb = vec![0; 3 * height as usize * width as usize];
    decoder.read_image(&mut rgb).map_err(FrameError::Image)?;
    Ok(Frame::new(height, width, rgb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_comes_back_bit_by_bit() {
        let rgb: Vec<u8> = (0..3 * 9 * 16).map(|byte| (byte * 37 % 251) as u8).collect();
        for (height, width) in [(12, 12), (9, 16), (16, 9), (1, 144)] {
            let frame = Frame::new(height, width, rgb.clone());
            assert_eq!(size(&encode(&frame)).unwrap(), frame.size());
            assert_eq!(decode(&encode(&frame), frame.size()).unwrap(), frame);
        }
    }

    #[test]
    fn a_flipped_bit_is_noticed() {
        let mut png = encode(&Frame::square(8, vec![7; 3 * 64]));
        let middle = png.len() - 20;
        png[middle] ^= 1;
        assert!(decode(&png, Size { height: 8, width: 8 }).is_err(), "the checksum of a chunk covers it");
    }

    #[test]
    fn a_frame_that_claims_to_be_huge_or_of_another_size_is_refused_before_it_is_read() {
        let mut png = encode(&Frame::square(8, vec![7; 3 * 64]));
        assert!(decode(&png, Size { height: 8, width: 9 }).is_err(), "of another size");
        for at in [16, 20] {
            png[at..at + 4].copy_from_slice(&60_000_u32.to_be_bytes());
            let message = size(&png).unwrap_err().to_string();
            assert!(message.contains("x 60000 pixels is empty or too large"), "{message}");
        }
        assert!(decode(&png, Size { height: 60_000, width: 60_000 }).is_err(), "10 GB");
        assert!(size(b"\x89PNG").is_err() && size(b"").is_err(), "cut");
    }
}
