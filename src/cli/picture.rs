//! Pictures that commands write.

use dropj::world::Frame;
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Rgba, RgbaImage};

/// A picture as the bytes of a PNG file.
pub(crate) fn png(rgb: &[u8], width: u32, height: u32) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    image::ImageEncoder::write_image(encoder, rgb, width, height, image::ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// Pictures, which are equally large, one after the other without end as the bytes of a GIF file; each is shown for `millis`, and
/// each of its pixels is `scale` wide and high.
pub(crate) fn gif(frames: &[Frame], millis: u32, scale: u32) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, 10);
    encoder.set_repeat(Repeat::Infinite)?;
    for frame in frames {
        let (width, height) = (frame.width() * scale, frame.height() * scale);
        let pixels = frame.rgb().as_chunks::<3>().0;
        let large = RgbaImage::from_fn(width, height, |x, y| {
            let [r, g, b] = pixels[(y / scale * frame.width() + x / scale) as usize];
            Rgba([r, g, b, 255])
        });
        encoder.encode_frame(image::Frame::from_parts(large, 0, 0, Delay::from_numer_denom_ms(millis, 1)))?;
    }
    drop(encoder);
    Ok(bytes)
}

/// Two pictures side by side, each in a frame of its color.
pub(crate) fn side_by_side(left: &Frame, right: &Frame, colors: [[u8; 3]; 2]) -> Frame {
    /// Pixels of a frame's border, and between both.
    const BORDER: u32 = 2;
    let (height, width) =
        (left.height().max(right.height()) + 2 * BORDER, left.width() + right.width() + 6 * BORDER);
    let mut rgb = vec![24u8; 3 * (height * width) as usize];
    let mut put = |x: u32, y: u32, color: [u8; 3]| {
        let at = 3 * (y * width + x) as usize;
        rgb[at..at + 3].copy_from_slice(&color);
    };
    let mut from = 0;
    for (frame, color) in [(left, colors[0]), (right, colors[1])] {
        let (w, h) = (frame.width(), frame.height());
        let pixels = frame.rgb().as_chunks::<3>().0;
        for y in 0..h + 2 * BORDER {
            for x in 0..w + 2 * BORDER {
                let inside = (BORDER..w + BORDER).contains(&x) && (BORDER..h + BORDER).contains(&y);
                let pixel = || pixels[((y - BORDER) * w + x - BORDER) as usize];
                put(from + x, y, if inside { pixel() } else { color });
            }
        }
        from += w + 4 * BORDER;
    }
    Frame::new(height, width, rgb)
}

#[cfg(test)]
mod tests {
    use image::AnimationDecoder as _;

    use super::*;

    #[test]
    fn a_gif_shows_every_picture_as_long_and_as_large_as_is_said() {
        let frames = [[200, 30, 30], [30, 200, 30], [30, 30, 200]]
            .map(|color: [u8; 3]| Frame::new(4, 6, color.repeat(24)));
        let bytes = gif(&frames, 40, 3).unwrap();
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(bytes)).unwrap();
        let shown: Vec<_> = decoder.into_frames().collect::<Result<_, _>>().unwrap();
        assert_eq!(shown.len(), 3);
        for (shown, frame) in shown.iter().zip(&frames) {
            assert_eq!((shown.buffer().dimensions(), shown.delay().numer_denom_ms()), ((18, 12), (40, 1)));
            let (found, wanted) = (shown.buffer().get_pixel(9, 6).0, &frame.rgb()[..3]);
            assert!(found.iter().zip(wanted).all(|(a, b)| a.abs_diff(*b) < 12), "{found:?} for {wanted:?}");
        }
    }

    #[test]
    fn clips_stand_side_by_side_in_frames_of_their_colors() {
        let one = |shade: u8| Frame::new(5, 7, vec![shade; 105]);
        let both = side_by_side(&one(100), &one(200), [[1, 2, 3], [4, 5, 6]]);
        assert_eq!((both.height(), both.width()), (9, 26));
        let at = |x: usize, y: usize| &both.rgb()[3 * (y * 26 + x)..][..3];
        assert_eq!(
            (at(0, 0), at(3, 3), at(15, 0), at(20, 4)),
            (&[1, 2, 3][..], &[100; 3][..], &[4, 5, 6][..], &[200; 3][..])
        );
    }
}
