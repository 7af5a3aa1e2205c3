//! Frames as PNG and back: lossless, and fast rather than small.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder as _, ImageEncoder as _};

use crate::env::Frame;

/// A frame as a PNG file.
pub(super) fn encode(frame: &Frame) -> Vec<u8> {
    let mut png = Vec::with_capacity(frame.rgb().len() / 2);
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
        .write_image(frame.rgb(), frame.side(), frame.side(), ExtendedColorType::Rgb8)
        .expect("writing to memory does not fail");
    png
}

/// The frame that a PNG file shows, or why there is none.
pub(super) fn decode(png: &[u8]) -> Result<Frame, String> {
    let decoder = PngDecoder::new(Cursor::new(png)).map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    if width != height || decoder.color_type() != ColorType::Rgb8 {
        return Err(format!("a frame of {width} x {height} {:?} is not square RGB", decoder.color_type()));
    }
    let mut rgb = vec![0; 3 * width as usize * height as usize];
    decoder.read_image(&mut rgb).map_err(|error| error.to_string())?;
    Ok(Frame::new(width, rgb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_comes_back_bit_by_bit() {
        let rgb: Vec<u8> = (0..3 * 9 * 9).map(|byte| (byte * 37 % 251) as u8).collect();
        let frame = Frame::new(9, rgb);
        assert_eq!(decode(&encode(&frame)), Ok(frame));
    }

    #[test]
    fn a_flipped_bit_is_noticed() {
        let mut png = encode(&Frame::new(8, vec![7; 3 * 64]));
        let middle = png.len() - 20;
        png[middle] ^= 1;
        assert!(decode(&png).is_err(), "the checksum of a chunk covers it");
    }
}
