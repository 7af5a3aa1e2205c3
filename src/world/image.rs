//! What of a picture is shown and learned from: cut, padded and brought to the size that networks are trained at.

use std::sync::Arc;

use image::RgbImage;
use image::imageops::{FilterType, resize};

use super::{Frame, ImageSpec, Size};

/// `frame` as `spec` wants it: cut, padded with black, and then brought to the size that networks are trained at.
///
/// A side that shrinks is averaged over the area of each new pixel; one that grows is interpolated after Lanczos. The
/// same picture gives the same bytes always. Where nothing is to be done the bytes are shared, not copied.
///
/// What is cut is counted from the sides of the frame that is given: one of another size than `spec` says is brought to
/// the same size in the end. At least a pixel is left of it.
pub fn framed(spec: &ImageSpec, frame: &Frame) -> Frame {
    let (crop, pad) = (spec.crop, spec.pad);
    let rows = kept(frame.height(), crop.top, crop.bottom);
    let columns = kept(frame.width(), crop.left, crop.right);
    let left = Size { height: rows[1] - rows[0], width: columns[1] - columns[0] };
    let padded = Size {
        height: left.height.saturating_add(pad.top).saturating_add(pad.bottom),
        width: left.width.saturating_add(pad.left).saturating_add(pad.right),
    };
    let whole = Size { height: frame.height(), width: frame.width() };
    let wanted = spec.train.unwrap_or(padded);
    if left == whole && padded == whole {
        return resized(frame.clone(), wanted);
    }
    let row_len = 3 * padded.width as usize;
    let mut rgb = vec![0; row_len * padded.height as usize];
    let whole_rows = frame.rgb().chunks_exact(3 * frame.width() as usize);
    let cut = whole_rows.skip(rows[0] as usize).take(left.height as usize);
    for (to, from) in rgb.chunks_exact_mut(row_len).skip(pad.top as usize).zip(cut) {
        let from = &from[3 * columns[0] as usize..3 * columns[1] as usize];
        to[3 * pad.left as usize..][..from.len()].copy_from_slice(from);
    }
    resized(Frame::new(padded.height, padded.width, rgb), wanted)
}

/// `frame` at another size, as [`framed`] does it; the same frame where it has that size already.
pub fn resized(frame: Frame, wanted: Size) -> Frame {
    let mut size = Size { height: frame.height(), width: frame.width() };
    if size == wanted {
        return frame;
    }
    let mut rgb = frame.shared();
    if wanted.width < size.width {
        rgb = averaged(&rgb, size.height as usize, size.width as usize, 1, wanted.width as usize);
        size.width = wanted.width;
    }
    if wanted.height < size.height {
        let row = size.width as usize;
        rgb = averaged(&rgb, 1, size.height as usize, row, wanted.height as usize);
        size.height = wanted.height;
    }
    if size != wanted {
        let image = RgbImage::from_raw(size.width, size.height, rgb.to_vec()).expect("three bytes a pixel");
        rgb = resize(&image, wanted.width, wanted.height, FilterType::Lanczos3).into_raw().into();
    }
    Frame::new(wanted.height, wanted.width, rgb)
}

/// What is left of `whole` once so much is cut off at its two ends: from where to where.
fn kept(whole: u32, before: u32, after: u32) -> [u32; 2] {
    let from = before.min(whole.saturating_sub(1));
    [from, whole.saturating_sub(after).max(from + 1).min(whole)]
}

/// `lines` lines of `n` elements of `width` pixels each, shrunk to `wanted` elements by the areas that they cover.
fn averaged(rgb: &[u8], lines: usize, n: usize, width: usize, wanted: usize) -> Arc<[u8]> {
    let element = 3 * width;
    let mut shrunk = vec![0; lines * wanted * element];
    let mut sums = vec![0_u64; element];
    for (line, to) in rgb.chunks_exact(n * element).zip(shrunk.chunks_exact_mut(wanted * element)) {
        for (i, to) in to.chunks_exact_mut(element).enumerate() {
            // Element j covers [j · wanted, (j + 1) · wanted), and the new one [i · n, (i + 1) · n).
            sums.fill(0);
            let (from, until) = (i * n, (i + 1) * n);
            for j in from / wanted..until.div_ceil(wanted) {
                let covered = (((j + 1) * wanted).min(until) - (j * wanted).max(from)) as u64;
                for (sum, &byte) in sums.iter_mut().zip(&line[j * element..(j + 1) * element]) {
                    *sum += covered * u64::from(byte);
                }
            }
            for (to, &sum) in to.iter_mut().zip(&sums) {
                *to = ((sum + n as u64 / 2) / n as u64) as u8;
            }
        }
    }
    shrunk.into()
}

#[cfg(test)]
mod tests {
    use super::super::Margins;
    use super::*;

    /// Each pixel is (row, column, 7).
    fn frame(height: u32, width: u32) -> Frame {
        let pixels =
            (0..height).flat_map(|row| (0..width).flat_map(move |column| [row as u8, column as u8, 7]));
        Frame::new(height, width, pixels.collect::<Vec<u8>>())
    }

    fn spec(height: u32, width: u32) -> ImageSpec {
        ImageSpec { height, width, ..ImageSpec::default() }
    }

    fn pixel(frame: &Frame, row: u32, column: u32) -> [u8; 3] {
        let at = 3 * (row * frame.width() + column) as usize;
        [frame.rgb()[at], frame.rgb()[at + 1], frame.rgb()[at + 2]]
    }

    #[test]
    fn where_nothing_is_to_be_done_the_bytes_are_shared() {
        let whole = frame(10, 20);
        let same = framed(&spec(10, 20), &whole);
        assert!(Arc::ptr_eq(&same.shared(), &whole.shared()));
        let train = Some(Size { height: 10, width: 20 });
        let same = framed(&ImageSpec { train, ..spec(10, 20) }, &whole);
        assert!(Arc::ptr_eq(&same.shared(), &whole.shared()));
    }

    #[test]
    fn margins_are_cut_and_then_put_around() {
        let crop = Margins { top: 2, right: 5, bottom: 1, left: 3 };
        let pad = Margins { top: 1, right: 0, bottom: 2, left: 4 };
        let spec = ImageSpec { crop, pad, ..spec(10, 20) };
        let cut = framed(&spec, &frame(10, 20));
        assert_eq!((cut.height(), cut.width()), (10, 16));
        assert_eq!(Size { height: cut.height(), width: cut.width() }, spec.framed());
        assert_eq!(pixel(&cut, 1, 4), [2, 3, 7], "the first pixel that was not cut off");
        assert_eq!(pixel(&cut, 7, 15), [8, 14, 7], "the last one");
        for (row, column) in [(0, 9), (8, 9), (9, 9), (4, 0), (4, 3)] {
            assert_eq!(pixel(&cut, row, column), [0; 3], "black at {row}, {column}");
        }
    }

    #[test]
    fn what_shrinks_is_averaged_over_areas() {
        let train = Some(Size { height: 3, width: 4 });
        let small = framed(&ImageSpec { train, ..spec(6, 12) }, &frame(6, 12));
        assert_eq!((small.height(), small.width()), (3, 4));
        // Rows 2 and 3, columns 3 to 5.
        assert_eq!(pixel(&small, 1, 1), [3, 4, 7]);
        // Three elements to two: the middle one is in both by halves.
        let line = Frame::new(1, 3, vec![0, 0, 0, 90, 90, 90, 240, 240, 240]);
        let halved = resized(line, Size { height: 1, width: 2 });
        assert_eq!(halved.rgb(), [30, 30, 30, 190, 190, 190]);
    }

    #[test]
    fn what_grows_or_changes_its_shape_has_the_size_that_is_asked_for() {
        for (height, width) in [(12, 24), (5, 24), (12, 7), (1, 1)] {
            let uniform = Frame::new(6, 9, vec![77; 3 * 6 * 9]);
            let other = resized(uniform, Size { height, width });
            assert_eq!((other.height(), other.width()), (height, width));
            assert!(other.rgb().iter().all(|&byte| byte == 77), "a plain picture stays plain");
        }
    }

    #[test]
    fn a_frame_of_another_size_than_the_file_says_does_no_harm() {
        let crop = Margins { top: 8, right: 30, bottom: 8, left: 30 };
        let train = Some(Size { height: 8, width: 8 });
        let small = framed(&ImageSpec { crop, train, ..spec(100, 100) }, &frame(3, 5));
        assert_eq!((small.height(), small.width()), (8, 8));
    }
}
