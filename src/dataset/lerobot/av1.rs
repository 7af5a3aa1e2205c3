//! AV1, decoded in order, a picture at a time.

use std::fs::File;
use std::mem;
use std::os::unix::fs::FileExt as _;
use std::panic::{AssertUnwindSafe, catch_unwind};

use re_rav1d::pixel::{MatrixCoefficients, YUVRange};
use re_rav1d::{Decoder, Error, Picture, PixelLayout, PlanarImageComponent, Settings};

use super::mp4::Track;
use crate::world::Frame;

/// Bytes of a picture as it is stored.
const MOST_SAMPLE: u32 = 64 << 20;

/// Why a picture could not be had.
pub(super) enum Av1Fault {
    /// It is of a kind that is not decoded here, and that another program may.
    Unsupported(String),
    /// It is damaged.
    Damaged(String),
}

/// The pictures of a video in their order.
pub(super) struct Pictures {
    file: File,
    track: Track,
    /// None once it has panicked.
    decoder: Option<Decoder>,
    /// The sample that comes next.
    next: usize,
    /// The picture that came last.
    last: Option<Frame>,
}

impl Pictures {
    pub(super) fn new(file: File, track: Track) -> Result<Self, Av1Fault> {
        let mut settings = Settings::new();
        // No thread, and each picture as soon as its sample is there.
        settings.set_n_threads(1);
        settings.set_max_frame_delay(1);
        settings.set_frame_size_limit(track.width.saturating_mul(track.height));
        let decoder = caught(|| Decoder::with_settings(&settings).map_err(fault))?;
        Ok(Self { file, track, decoder: Some(decoder), next: 0, last: None })
    }

    /// Picture `k` of the file, which is the last one that was asked for or one after it.
    pub(super) fn picture(&mut self, k: usize) -> Result<Frame, Av1Fault> {
        let damaged = |why: String| Err(Av1Fault::Damaged(why));
        if self.next == k + 1
            && let Some(frame) = &self.last
        {
            return Ok(frame.clone());
        }
        let n = self.track.samples.len();
        if k >= n {
            return damaged(format!("picture {k} is wanted, and it has {n}"));
        }
        if self.next > k {
            return damaged(format!("picture {k} is wanted after picture {}", self.next - 1));
        }
        // Nothing before the last picture that stands for itself is needed.
        if let Some(sync) = (self.next + 1..=k).rev().find(|&i| self.track.samples[i].is_sync) {
            self.next = sync;
            if let Some(decoder) = &mut self.decoder {
                caught(|| {
                    decoder.flush();
                    Ok(())
                })?;
            }
        }
        while self.next <= k {
            let at = self.next;
            self.next += 1;
            let picture = self.decode(at)?;
            if at == k {
                let frame = caught(|| frame(&picture, &self.track))?;
                self.last = Some(frame.clone());
                return Ok(frame);
            }
        }
        damaged(format!("picture {k} did not come"))
    }

    /// What sample `at` shows.
    fn decode(&mut self, at: usize) -> Result<Picture, Av1Fault> {
        let sample = self.track.samples[at];
        if sample.len == 0 || sample.len > MOST_SAMPLE {
            return Err(Av1Fault::Damaged(format!("its picture {at} has {} bytes", sample.len)));
        }
        let mut bytes = vec![0; sample.len as usize];
        let read = self.file.read_exact_at(&mut bytes, sample.offset);
        read.map_err(|met| Av1Fault::Damaged(met.to_string()))?;
        let Some(mut decoder) = self.decoder.take() else {
            return Err(Av1Fault::Damaged("its decoder has failed".to_owned()));
        };
        if let Ok(picture) = catch_unwind(AssertUnwindSafe(|| shown(&mut decoder, bytes, at))) {
            self.decoder = Some(decoder);
            picture?.ok_or_else(|| Av1Fault::Damaged(format!("its picture {at} shows nothing")))
        } else {
            // Whatever state it is in, it is not to be asked again, not even to end.
            mem::forget(decoder);
            Err(Av1Fault::Damaged(format!("there is no sense in its picture {at}")))
        }
    }
}

/// The picture of a sample, if it shows one.
fn shown(decoder: &mut Decoder, bytes: Vec<u8>, at: usize) -> Result<Option<Picture>, Av1Fault> {
    /// Pictures that may come of a sample; one is shown.
    const MOST: usize = 64;
    let sent = |sent: Result<(), Error>| match sent {
        Ok(()) => Ok(false),
        Err(met) if met.is_again() => Ok(true),
        Err(met) => Err(fault(met)),
    };
    let mut is_pending = sent(decoder.send_data(bytes, None, Some(at as i64), None))?;
    let mut last = None;
    for _ in 0..MOST {
        match decoder.get_picture() {
            Ok(picture) => last = Some(picture),
            Err(met) if met.is_again() => {
                if !is_pending {
                    break;
                }
                is_pending = sent(decoder.send_pending_data())?;
            }
            Err(met) => return Err(fault(met)),
        }
    }
    if is_pending {
        decoder.flush();
        return Err(Av1Fault::Damaged(format!("its picture {at} has no end")));
    }
    Ok(last.filter(|picture| picture.timestamp() == Some(at as i64)))
}

fn fault(met: Error) -> Av1Fault {
    match met {
        Error::UnsupportedBitstream => Av1Fault::Unsupported(
            "AV1 of more than 8 bits a color, or of a profile that is not read".to_owned(),
        ),
        met => Av1Fault::Damaged(format!("its AV1 is damaged ({met}); copy it again")),
    }
}

/// What the decoder makes of it; a panic is an error.
fn caught<T>(call: impl FnOnce() -> Result<T, Av1Fault>) -> Result<T, Av1Fault> {
    catch_unwind(AssertUnwindSafe(call))
        .unwrap_or_else(|_| Err(Av1Fault::Damaged("there is no sense in it".to_owned())))
}

/// A decoded picture as RGB.
fn frame(picture: &Picture, track: &Track) -> Result<Frame, Av1Fault> {
    let unsupported = |what: String| Av1Fault::Unsupported(what);
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    if (picture.width(), picture.height()) != (track.width, track.height) {
        let why = format!(
            "a picture of it is {height} x {width}, and the file says {} x {}",
            track.height, track.width
        );
        return Err(Av1Fault::Damaged(why));
    }
    if picture.bit_depth() != 8 {
        return Err(unsupported(format!("AV1 of {} bits a color", picture.bit_depth())));
    }
    // How much of red and blue is in the luminance. Where nobody says, lerobot means BT.601.
    let [red, blue] = match picture.matrix_coefficients() {
        MatrixCoefficients::Unspecified | MatrixCoefficients::BT470BG | MatrixCoefficients::ST170M => {
            [0.299, 0.114]
        }
        MatrixCoefficients::BT470M => [0.30, 0.11],
        MatrixCoefficients::BT709 => [0.2126, 0.0722],
        MatrixCoefficients::BT2020NonConstantLuminance => [0.2627, 0.0593],
        other => return Err(unsupported(format!("AV1 with colors as {other:?}"))),
    };
    let to_rgb = ToRgb::new(red, blue, picture.color_range() == YUVRange::Full);
    let [shift_x, shift_y] = match picture.pixel_layout() {
        PixelLayout::I420 => [1, 1],
        PixelLayout::I422 => [1, 0],
        PixelLayout::I400 | PixelLayout::I444 => [0, 0],
    };
    let is_gray = picture.pixel_layout() == PixelLayout::I400;
    let plane = |which: PlanarImageComponent| (picture.plane(which), picture.stride(which) as usize);
    let (luma, luma_stride) = plane(PlanarImageComponent::Y);
    let chroma = (!is_gray).then(|| (plane(PlanarImageComponent::U), plane(PlanarImageComponent::V).0));
    let mut rgb = Vec::with_capacity(3 * width * height);
    for row in 0..height {
        for column in 0..width {
            let y = luma[row * luma_stride + column];
            let [u, v] = match &chroma {
                None => [128; 2],
                Some(((u, stride), v)) => {
                    let at = (row >> shift_y) * stride + (column >> shift_x);
                    [u[at], v[at]]
                }
            };
            rgb.extend(to_rgb.of(y, u, v));
        }
    }
    Ok(Frame::new(height as u32, width as u32, rgb))
}

/// From a luminance and two differences of color to red, green and blue, in parts of 2^16.
struct ToRgb {
    black: i32,
    luma: i32,
    red: i32,
    green: [i32; 2],
    blue: i32,
}

impl ToRgb {
    fn new(red: f64, blue: f64, is_full: bool) -> Self {
        let [luma, chroma] = if is_full { [1.0, 1.0] } else { [255.0 / 219.0, 255.0 / 224.0] };
        let part = |value: f64| (value * f64::from(1 << 16)).round() as i32;
        let green = 1.0 - red - blue;
        Self {
            black: if is_full { 0 } else { 16 },
            luma: part(luma),
            red: part(2.0 * (1.0 - red) * chroma),
            green: [
                part(-2.0 * (1.0 - blue) * blue / green * chroma),
                part(-2.0 * (1.0 - red) * red / green * chroma),
            ],
            blue: part(2.0 * (1.0 - blue) * chroma),
        }
    }

    fn of(&self, y: u8, u: u8, v: u8) -> [u8; 3] {
        // Cut and not rounded, as the decoder that lerobot uses does it.
        let y = self.luma * (i32::from(y) - self.black);
        let [u, v] = [u, v].map(|difference| i32::from(difference) - 128);
        let byte = |sum: i32| (sum >> 16).clamp(0, 255) as u8;
        [byte(y + self.red * v), byte(y + self.green[0] * u + self.green[1] * v), byte(y + self.blue * u)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_as_the_standards_have_them() {
        // What is cut off rather than rounded is one less.
        let is_near =
            |found: [u8; 3], wanted: [u8; 3]| found.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 1);
        let limited = ToRgb::new(0.299, 0.114, false);
        for (yuv, rgb) in [
            ([16, 128, 128], [0, 0, 0]),
            ([235, 128, 128], [255, 255, 255]),
            ([81, 90, 240], [254, 0, 0]),
            ([145, 54, 34], [0, 255, 0]),
            ([41, 240, 110], [0, 0, 255]),
        ] {
            let [y, u, v] = yuv;
            assert!(is_near(limited.of(y, u, v), rgb), "{yuv:?}: {:?}", limited.of(y, u, v));
        }
        let full = ToRgb::new(0.2126, 0.0722, true);
        assert!(is_near(full.of(255, 128, 128), [255; 3]) && is_near(full.of(7, 128, 128), [7; 3]));
    }
}
