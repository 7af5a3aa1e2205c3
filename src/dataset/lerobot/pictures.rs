//! The pictures of a camera in an episode, one after the other: from Parquet, from files, or from a video.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Cursor, Read as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use image::{ImageFormat, ImageReader, Limits};

use super::av1::{self, Av1Fault};
use super::fault::{self, LeRobotFault};
use super::ffmpeg::{self, FfmpegFault};
use super::info::within;
use super::{Camera, DatasetError, mp4};
use crate::world::Frame;

/// Bytes of a picture as it is stored.
pub(super) const MOST_STORED: u64 = 256 << 20;
/// By which part of it a video's rate may differ from the dataset's.
const RATE_SLACK: f64 = 0.02;

/// A picture of a camera as its table has it.
#[derive(Clone, Debug, Default)]
pub(super) struct Stored {
    /// The whole file of it.
    pub(super) bytes: Option<Vec<u8>>,
    /// Where it lies otherwise.
    pub(super) path: Option<String>,
}

/// Where the pictures of an episode come from.
pub(super) enum Pictures {
    /// Each by itself, in the order of the rows.
    Stored(std::vec::IntoIter<Stored>),
    /// From a video.
    Video {
        source: VideoSource,
        wanted: std::vec::IntoIter<usize>,
        path: PathBuf,
        program: std::ffi::OsString,
    },
}

/// What decodes a video.
pub(super) enum VideoSource {
    Av1(Box<av1::Pictures>),
    Ffmpeg(ffmpeg::Pictures),
}

/// Whose pictures are read, for messages.
#[derive(Clone, Copy)]
pub(super) struct Whose<'a> {
    pub(super) dir: &'a Path,
    pub(super) camera: &'a Camera,
    pub(super) episode: i64,
}

impl Pictures {
    /// Those numbered `wanted`, growing, of the video at `path`.
    pub(super) fn of_video(
        path: PathBuf,
        wanted: Vec<usize>,
        fps: f64,
        camera: &Camera,
        program: &OsStr,
    ) -> Result<Self, DatasetError> {
        let file = File::open(&path).map_err(|met| fault::met(met, &path, "it is a video of a camera"))?;
        let len = file.metadata().map_err(|met| fault::met(met, &path, "it is a video of a camera"))?.len();
        // A first file of Git LFS instead of the video is a common mistake.
        let mut head = [0; 12];
        let is_pointer = file.read_exact_at(&mut head, 0).is_ok() && head.starts_with(b"version http");
        let video = |why: String| LeRobotFault::Video(why).at(&path);
        if is_pointer {
            return Err(video(
                "it is a pointer of Git LFS and not the video; fetch it with: git lfs pull".to_owned(),
            ));
        }
        let track = mp4::read(&file, len).map_err(video)?;
        let (height, width) = (track.height, track.width);
        if (height, width) != (camera.height, camera.width) {
            let why =
                format!("it is {height} x {width}, and info.json says {} x {}", camera.height, camera.width);
            return Err(video(why));
        }
        if let Some(rate) = track.rate.filter(|rate| (rate / fps - 1.0).abs() > RATE_SLACK) {
            return Err(video(format!("it has {rate:.2} pictures a second, and info.json says {fps}")));
        }
        let last = wanted.last().copied().unwrap_or_default();
        let n = track.samples.len();
        if last >= n {
            return Err(video(format!("picture {last} of it is wanted, and it has {n}; copy it again")));
        }
        let source = if track.codec == "av01" {
            let pictures = av1::Pictures::new(file, track).map_err(|met| av1_fault(met, &path))?;
            VideoSource::Av1(Box::new(pictures))
        } else {
            let codec = codec_name(&track.codec);
            let started = ffmpeg::Pictures::start(program, &path, [height, width], last);
            VideoSource::Ffmpeg(started.map_err(|met| ffmpeg_fault(met, &codec, &path))?)
        };
        let program = program.to_owned();
        Ok(Self::Video { source, wanted: wanted.into_iter(), path, program })
    }

    /// The picture of the next row, which is number `row`.
    pub(super) fn next(&mut self, row: usize, whose: Whose<'_>) -> Result<Frame, DatasetError> {
        let picture = |why: String| LeRobotFault::Picture {
            episode: whose.episode,
            row,
            camera: whose.camera.name.clone(),
            why,
        };
        match self {
            Self::Stored(all) => {
                let stored = all.next().unwrap_or_default();
                stored.frame(row, whose).map_err(|why| picture(why).at(whose.dir))
            }
            Self::Video { source, wanted, path, program } => {
                let k = wanted.next().ok_or_else(|| picture("there are no more rows".to_owned()).at(path))?;
                match source {
                    VideoSource::Av1(pictures) => match pictures.picture(k) {
                        Ok(frame) => Ok(frame),
                        Err(Av1Fault::Unsupported(codec)) => {
                            let last = wanted.as_slice().last().copied().unwrap_or(k);
                            let size = [whose.camera.height, whose.camera.width];
                            let other = ffmpeg::Pictures::start(program, path, size, last);
                            let mut other = other.map_err(|met| ffmpeg_fault(met, &codec, path))?;
                            let frame = other.picture(k).map_err(|met| ffmpeg_fault(met, &codec, path))?;
                            *source = VideoSource::Ffmpeg(other);
                            Ok(frame)
                        }
                        Err(met) => Err(av1_fault(met, path)),
                    },
                    VideoSource::Ffmpeg(pictures) => {
                        pictures.picture(k).map_err(|met| ffmpeg_fault(met, "not AV1", path))
                    }
                }
            }
        }
    }
}

fn av1_fault(met: Av1Fault, path: &Path) -> DatasetError {
    let (Av1Fault::Unsupported(why) | Av1Fault::Damaged(why)) = met;
    LeRobotFault::Video(why).at(path)
}

fn ffmpeg_fault(met: FfmpegFault, codec: &str, path: &Path) -> DatasetError {
    let fault = match met {
        FfmpegFault::NotThere => LeRobotFault::NoFfmpeg { codec: codec.to_owned() },
        FfmpegFault::Failed(why) => LeRobotFault::Video(why),
    };
    fault.at(path)
}

/// What people call an encoding.
fn codec_name(code: &str) -> String {
    let name = match code {
        "avc1" | "avc3" => "H.264",
        "hvc1" | "hev1" => "HEVC (H.265)",
        "vp09" => "VP9",
        "vp08" => "VP8",
        "mp4v" => "MPEG-4",
        other => return format!("encoded as {other:?}"),
    };
    name.to_owned()
}

impl Stored {
    /// The picture, or why there is none.
    fn frame(self, row: usize, whose: Whose<'_>) -> Result<Frame, String> {
        let bytes = match self.bytes.filter(|bytes| !bytes.is_empty()) {
            Some(bytes) => bytes,
            None => from_file(self.path.as_deref(), row, whose)?,
        };
        decoded(&bytes, whose.camera)
    }
}

/// The bytes of the picture's file: as the table says, or where lerobot puts it.
fn from_file(told: Option<&str>, row: usize, whose: Whose<'_>) -> Result<Vec<u8>, String> {
    let Whose { dir, camera, episode } = whose;
    let named = told.and_then(within);
    let usual = [("-", "png"), ("_", "png"), ("-", "jpg"), ("-", "jpeg")].map(|(dash, ending)| {
        within(&format!("images/{}/episode{dash}{episode:06}/frame{dash}{row:06}.{ending}", camera.name))
    });
    let all: Vec<PathBuf> = [named].into_iter().chain(usual).flatten().map(|path| dir.join(path)).collect();
    let Some(path) = all.iter().find(|path| path.is_file()) else {
        let told = told
            .map_or_else(|| "none".to_owned(), |told| format!("{:?}", crate::text::shown_within(told, 200)));
        return Err(format!(
            "the table holds no picture, and there is no file of it within the dataset (the table names {told})"
        ));
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|met| format!("{met}, at {path:?}"))?;
    file.take(MOST_STORED + 1).read_to_end(&mut bytes).map_err(|met| format!("{met}, at {path:?}"))?;
    if bytes.len() as u64 > MOST_STORED {
        return Err(format!("its file has more than {MOST_STORED} bytes: {path:?}"));
    }
    Ok(bytes)
}

/// What a PNG or JPEG file shows, as RGB.
fn decoded(bytes: &[u8], camera: &Camera) -> Result<Frame, String> {
    let format = if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        ImageFormat::Png
    } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        ImageFormat::Jpeg
    } else {
        return Err("it is neither PNG nor JPEG".to_owned());
    };
    let reader = || {
        let mut limits = Limits::default();
        limits.max_image_width = Some(crate::world::MAX_SIDE);
        limits.max_image_height = Some(crate::world::MAX_SIDE);
        limits.max_alloc = Some(1 << 30);
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        reader.limits(limits);
        reader
    };
    let (width, height) = reader().into_dimensions().map_err(|met| met.to_string())?;
    if (height, width) != (camera.height, camera.width) {
        return Err(format!(
            "it is {height} x {width}, and info.json says {} x {}",
            camera.height, camera.width
        ));
    }
    let image = reader().decode().map_err(|met| met.to_string())?;
    Ok(Frame::new(height, width, image.into_rgb8().into_raw()))
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, GrayImage, RgbaImage};

    use super::*;

    fn camera(height: u32, width: u32) -> Camera {
        Camera { name: "front".to_owned(), height, width, is_video: false }
    }

    fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn gray_and_transparent_pictures_and_jpegs_become_rgb() {
        let gray = DynamicImage::from(GrayImage::from_pixel(6, 4, image::Luma([90])));
        let clear = DynamicImage::from(RgbaImage::from_pixel(6, 4, image::Rgba([10, 20, 30, 0])));
        let gray_frame = decoded(&encoded(&gray, ImageFormat::Png), &camera(4, 6)).unwrap();
        assert!(gray_frame.rgb().iter().all(|&byte| byte == 90));
        let frame = decoded(&encoded(&clear, ImageFormat::Png), &camera(4, 6)).unwrap();
        assert_eq!(frame.rgb()[..3], [10, 20, 30]);
        let jpeg = decoded(&encoded(&gray, ImageFormat::Jpeg), &camera(4, 6)).unwrap();
        assert!(jpeg.rgb().iter().all(|&byte| byte.abs_diff(90) < 3));
    }

    #[test]
    fn pictures_of_other_sizes_and_kinds_and_cut_ones_are_refused() {
        let gray = DynamicImage::from(GrayImage::from_pixel(6, 4, image::Luma([90])));
        let png = encoded(&gray, ImageFormat::Png);
        assert!(decoded(&png, &camera(6, 4)).unwrap_err().contains("4 x 6"));
        assert!(decoded(b"GIF89a", &camera(4, 6)).unwrap_err().contains("neither"));
        for format in [ImageFormat::Png, ImageFormat::Jpeg] {
            let whole = encoded(&gray, format);
            for len in 0..whole.len() {
                // Of a JPEG the end may be missing without much harm. It must not do any.
                let _ = decoded(&whole[..len], &camera(4, 6));
            }
        }
        assert!(decoded(&png[..png.len() - 20], &camera(4, 6)).is_err());
    }
}
