//! Pictures beside each other in one.

use crate::world::Frame;

/// The ground that pictures are put on.
const GROUND: [u8; 3] = [24, 24, 24];
/// Pixels of a border, and half of those between two pictures.
const BORDER: u32 = 2;
/// A broken border has so many pixels of color, and as many without.
const DASH: u32 = 5;

/// What a border says of its picture. The colors are Okabe and Ito's, which people who see fewer colors tell apart, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// It was preferred, or chosen: whole and blue.
    Better,
    /// It was not, or is unsafe: broken and orange.
    Worse,
    /// Nothing: gray.
    Neither,
    /// It was only considered: none.
    None,
}

impl Border {
    /// Its color so many pixels along it.
    fn at(self, along: u32) -> [u8; 3] {
        match self {
            Self::Better => [86, 180, 233],
            Self::Worse if (along / DASH).is_multiple_of(2) => [213, 94, 0],
            Self::Neither => [120, 120, 120],
            Self::Worse | Self::None => GROUND,
        }
    }
}

/// A picture that others are put into.
struct Canvas {
    height: u32,
    width: u32,
    rgb: Vec<u8>,
}

impl Canvas {
    fn new(height: u32, width: u32) -> Self {
        Self { height, width, rgb: GROUND.repeat((height * width) as usize) }
    }

    /// Puts `frame` at a place, each pixel `scale` wide and high, in a border around it.
    fn put(&mut self, frame: &Frame, [left, top]: [u32; 2], scale: u32, border: Border) {
        let (w, h) = (frame.width() * scale, frame.height() * scale);
        let pixels = frame.rgb().as_chunks::<3>().0;
        for y in 0..h + 2 * BORDER {
            for x in 0..w + 2 * BORDER {
                let inside = (BORDER..w + BORDER).contains(&x) && (BORDER..h + BORDER).contains(&y);
                let color = if inside {
                    pixels[((y - BORDER) / scale * frame.width() + (x - BORDER) / scale) as usize]
                } else {
                    border.at(x + y)
                };
                let at = 3 * ((top + y) * self.width + left + x) as usize;
                self.rgb[at..at + 3].copy_from_slice(&color);
            }
        }
    }

    fn finish(self) -> Frame {
        Frame::new(self.height, self.width, self.rgb)
    }
}

/// Two pictures side by side, each in its border.
pub fn side_by_side(left: &Frame, right: &Frame, borders: [Border; 2]) -> Frame {
    let height = left.height().max(right.height()) + 2 * BORDER;
    let mut canvas = Canvas::new(height, left.width() + right.width() + 6 * BORDER);
    canvas.put(left, [0, 0], 1, borders[0]);
    canvas.put(right, [left.width() + 4 * BORDER, 0], 1, borders[1]);
    canvas.finish()
}

/// The real world and what is dreamt beside it, the dream in a gray border, for it is none of this world.
pub fn beside(real: &Frame, dream: &Frame) -> Frame {
    side_by_side(real, dream, [Border::None, Border::Neither])
}

/// Pictures of futures in a row at the most.
const COLUMNS: usize = 5;

/// The real world at the left, as high as all `candidates` at its right: where each of the plans would lead, the `chosen` one framed.
pub fn futures(real: &Frame, candidates: &[Frame], chosen: usize) -> Frame {
    let Some(first) = candidates.first() else { return real.clone() };
    let columns = candidates.len().min(COLUMNS);
    let rows = candidates.len().div_ceil(columns) as u32;
    let (cell_w, cell_h) = (first.width() + 4 * BORDER, first.height() + 4 * BORDER);
    let scale = ((rows * cell_h).saturating_sub(2 * BORDER) / real.height().max(1)).max(1);
    let (real_w, real_h) = (real.width() * scale + 2 * BORDER, real.height() * scale + 2 * BORDER);
    let height = (rows * cell_h).saturating_sub(2 * BORDER).max(real_h);
    let mut canvas = Canvas::new(height, real_w + 2 * BORDER + columns as u32 * cell_w);
    canvas.put(real, [0, (height - real_h) / 2], scale, Border::None);
    for (i, candidate) in candidates.iter().enumerate() {
        // One of another size is of another world model, and is left out.
        if candidate.size() != first.size() {
            continue;
        }
        let (row, column) = ((i / columns) as u32, (i % columns) as u32);
        let border = if i == chosen { Border::Better } else { Border::None };
        canvas.put(candidate, [real_w + 4 * BORDER + column * cell_w, row * cell_h], 1, border);
    }
    canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(height: u32, width: u32, shade: u8) -> Frame {
        Frame::new(height, width, vec![shade; (3 * height * width) as usize])
    }

    fn at(frame: &Frame, x: u32, y: u32) -> [u8; 3] {
        frame.rgb().as_chunks::<3>().0[(y * frame.width() + x) as usize]
    }

    #[test]
    fn clips_stand_side_by_side_in_borders_that_differ_by_shape_as_well() {
        let both = side_by_side(&one(9, 7, 100), &one(9, 7, 200), [Border::Better, Border::Worse]);
        assert_eq!((both.height(), both.width()), (13, 26));
        assert_eq!((at(&both, 3, 3), at(&both, 20, 4)), ([100; 3], [200; 3]));
        let top = |from: u32| (from..from + 11).map(|x| at(&both, x, 0)).collect::<Vec<_>>();
        assert!(top(0).iter().all(|color| *color == Border::Better.at(0)), "a whole one");
        let broken = top(15);
        assert!(broken.contains(&GROUND) && broken.contains(&Border::Worse.at(0)), "a broken one");
    }

    #[test]
    fn the_real_world_is_as_high_as_all_futures_and_the_chosen_one_is_framed() {
        let candidates: Vec<_> = (0..15).map(|i| one(84, 84, 10 * i)).collect();
        let all = futures(&one(84, 84, 250), &candidates, 6);
        assert_eq!((all.height(), all.width()), (272, 720));
        assert_eq!(at(&all, 10, 136), [250; 3], "three times as large");
        let framed = |i: u32| at(&all, 256 + 8 + i % 5 * 92, i / 5 * 92);
        assert_eq!((framed(6), framed(7)), (Border::Better.at(0), GROUND));
        assert_eq!(
            futures(&one(84, 84, 250), &[], 0).size(),
            one(84, 84, 0).size(),
            "nothing is planned yet"
        );
    }
}
