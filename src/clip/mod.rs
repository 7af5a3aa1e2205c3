//! What somebody saw, as pictures to show to others: put beside each other, framed, and one after the other as a GIF.
//!
//! Marks differ by shape as well as by color: what is better has a whole frame, what is worse a broken one.

mod compose;

use std::path::Path;

use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, ImageError, Rgba, RgbaImage};

use crate::query::{Preference, Response, SafetyAnswer};
use crate::run::{Kind, OutputFile, RunError};
use crate::world::Frame;

pub use compose::{Border, beside, futures, side_by_side};

/// Milliseconds of a picture at the least: browsers show what is to be quicker at a tenth of its pace.
const QUICKEST: f64 = 20.0;
/// A GIF of more pixels than this from side to side is not made larger.
const WIDEST: u32 = 700;

/// Pictures one after the other.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Equally large.
    pub frames: Vec<Frame>,
    /// For how many milliseconds each is shown.
    pub millis: u32,
    /// How many pixels wide and high each of theirs is.
    pub scale: u32,
}

/// Why a clip is not written.
#[derive(Debug, thiserror::Error)]
pub enum ClipError {
    /// There is nothing to see.
    #[error("there is nothing to be seen in this clip yet")]
    Empty,
    /// A picture cannot be encoded.
    #[error("the pictures cannot be made a GIF: {0}")]
    Encode(#[from] ImageError),
    /// The file cannot be written.
    #[error(transparent)]
    Run(#[from] RunError),
}

impl Clip {
    /// `frames` of a world of `rate` steps a second, `every` so many steps, half as fast as they happened as in the window, and as
    /// large as can be shown well.
    pub fn half_as_fast(frames: Vec<Frame>, rate: f64, every: usize) -> Self {
        let scale = frames.first().map_or(1, |frame| (WIDEST / frame.width().max(1)).clamp(1, 3));
        Self { frames, millis: millis(2.0 * every as f64 / rate), scale }
    }

    /// `frames` as fast as they happened.
    pub fn at_pace(frames: Vec<Frame>, rate: f64, every: usize) -> Self {
        let millis = millis(every as f64 / rate);
        Self { millis, ..Self::half_as_fast(frames, rate, every) }
    }

    /// The bytes of a GIF that goes on without end.
    pub fn gif(&self) -> Result<Vec<u8>, ClipError> {
        if self.frames.is_empty() {
            return Err(ClipError::Empty);
        }
        let (mut bytes, scale) = (Vec::new(), self.scale.max(1));
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, 10);
        encoder.set_repeat(Repeat::Infinite)?;
        for frame in &self.frames {
            let pixels = frame.rgb().as_chunks::<3>().0;
            let large = RgbaImage::from_fn(frame.width() * scale, frame.height() * scale, |x, y| {
                let [r, g, b] = pixels[(y / scale * frame.width() + x / scale) as usize];
                Rgba([r, g, b, 255])
            });
            let delay = Delay::from_numer_denom_ms(self.millis, 1);
            encoder.encode_frame(image::Frame::from_parts(large, 0, 0, delay))?;
        }
        drop(encoder);
        Ok(bytes)
    }

    /// Writes it to `path`, where nothing of another kind may be.
    pub fn write(&self, path: &Path) -> Result<(), ClipError> {
        let output = OutputFile::at(path, Kind::Clip)?;
        output.write(&self.gif()?)?;
        Ok(())
    }
}

/// So many seconds in whole milliseconds that are shown as they are.
fn millis(secs: f64) -> u32 {
    (1000.0 * secs).round().max(QUICKEST) as u32
}

/// How the left and the right clip of a query are framed after this answer.
pub fn borders(response: Option<Response>) -> [Border; 2] {
    let of = |preference| match preference {
        Preference::Left => [Border::Better, Border::Worse],
        Preference::Right => [Border::Worse, Border::Better],
        Preference::Equal => [Border::Neither; 2],
    };
    match response {
        Some(Response::Preferred(preference) | Response::Justified(_, preference)) => of(preference),
        Some(Response::Safety(answer)) => match answer {
            SafetyAnswer::OnlyLeft => of(Preference::Left),
            SafetyAnswer::OnlyRight => of(Preference::Right),
            SafetyAnswer::Neither => [Border::Worse; 2],
            SafetyAnswer::Both(preference) => of(preference),
        },
        Some(Response::Skipped(_) | Response::Judged(_)) | None => [Border::Neither; 2],
    }
}

/// Both clips of a query side by side, framed after this answer.
pub fn query(left: &[Frame], right: &[Frame], response: Option<Response>) -> Vec<Frame> {
    let borders = borders(response);
    left.iter().zip(right).map(|(left, right)| side_by_side(left, right, borders)).collect()
}

#[cfg(test)]
mod tests {
    use image::AnimationDecoder as _;

    use super::*;

    #[test]
    fn a_gif_shows_every_picture_as_long_and_as_large_as_is_said() {
        let frames = [[200, 30, 30], [30, 200, 30], [30, 30, 200]]
            .map(|color: [u8; 3]| Frame::new(4, 6, color.repeat(24)));
        let bytes = Clip { frames: frames.to_vec(), millis: 40, scale: 3 }.gif().unwrap();
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
    fn a_clip_is_as_fast_as_it_is_said_and_never_too_fast_to_be_shown() {
        let clip = |width: u32| vec![Frame::new(1, width, vec![0; 3 * width as usize])];
        assert_eq!(Clip::half_as_fast(clip(100), 50.0, 1).millis, 40);
        assert_eq!(Clip::at_pace(clip(100), 50.0, 4).millis, 80);
        assert_eq!(Clip::at_pace(clip(100), 1000.0, 1).millis, 20);
        assert_eq!(
            (Clip::at_pace(clip(100), 50.0, 1).scale, Clip::at_pace(clip(600), 50.0, 1).scale),
            (3, 1)
        );
        assert!(matches!(Clip::at_pace(Vec::new(), 50.0, 1).gif(), Err(ClipError::Empty)));
    }

    #[test]
    fn what_is_unsafe_is_framed_as_worse_and_what_nobody_said_as_neither() {
        let safety = |answer| borders(Some(Response::Safety(answer)));
        assert_eq!(safety(SafetyAnswer::OnlyRight), [Border::Worse, Border::Better]);
        assert_eq!(safety(SafetyAnswer::Neither), [Border::Worse; 2]);
        assert_eq!(safety(SafetyAnswer::Both(Preference::Left)), [Border::Better, Border::Worse]);
        assert_eq!(borders(None), [Border::Neither; 2]);
    }
}
