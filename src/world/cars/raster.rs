//! A software rasterizer for convex polygons: no anti-aliasing, exact in integers.
//!
//! It fills as OpenGL does: corners are snapped to 1/256 pixel, and a pixel takes the color of the last polygon that
//! contains its center. Centers on an edge belong to one side only, so neighbors neither overlap nor leave gaps.
//! By hand on purpose: rasterizers of the registry, such as `tiny-skia`, do not promise this rule, and a pixel more or
//! less at an edge is another picture than the Python environment's.

/// Red, green and blue.
pub(super) type Color = [u8; 3];

/// Fractions of a pixel that corners are snapped to.
const SUBPIXELS: i64 = 256;
/// The most corners a polygon has.
const MAX_CORNERS: usize = 8;
/// Beyond this many pixels corners are clamped, far outside of any picture.
const LIMIT: f64 = 1e6;

/// Bytes that are painted at once: of whole pixels, and in whole registers.
const STRIP: usize = 48;

/// A row that no edge has crossed yet.
const NO_SPAN: [i64; 2] = [i64::MAX, i64::MIN];

/// A picture in the making.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Color>,
    /// First column and end of the polygon in hand, a row.
    spans: Vec<[i64; 2]>,
}

impl Canvas {
    /// A black picture.
    pub(super) fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { width, height, pixels: vec![[0; 3]; width * height], spans: vec![NO_SPAN; height] }
    }

    /// Fills a convex polygon, corners in pixels from the top left, in either orientation.
    pub(super) fn fill(&mut self, corners: &[[f64; 2]], color: Color) {
        let n = corners.len();
        assert!((3..=MAX_CORNERS).contains(&n), "a polygon has 3 to {MAX_CORNERS} corners, not {n}");
        let mut snapped = [[0i64; 2]; MAX_CORNERS];
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        for (at, corner) in snapped.iter_mut().zip(corners) {
            for axis in 0..2 {
                at[axis] = snap(corner[axis]);
                low[axis] = low[axis].min(at[axis]);
                high[axis] = high[axis].max(at[axis]);
            }
        }
        let rows = first_center(low[1]).max(0)..first_center(high[1]).min(self.height as i64);
        let columns = first_center(low[0]).max(0)..first_center(high[0]).min(self.width as i64);
        if rows.is_empty() || columns.is_empty() {
            return;
        }
        self.spans[rows.start as usize..rows.end as usize].fill(NO_SPAN);
        let mut a = snapped[n - 1];
        for &b in &snapped[..n] {
            self.mark_edge(a, b);
            a = b;
        }
        for row in rows.start as usize..rows.end as usize {
            let [from, to] = self.spans[row];
            let (from, to) = (from.max(columns.start), to.min(columns.end));
            if from < to {
                let start = row * self.width;
                paint(&mut self.pixels[start + from as usize..start + to as usize], color);
            }
        }
    }

    /// Widens the span of every row whose centers the edge `a`–`b` crosses.
    ///
    /// The first column whose center is not left of the edge at height `y` is
    ///
    /// ```text
    /// ⌈((a.x − 128) h + (y − a.y) (b.x − a.x)) / (256 h)⌉,  h = b.y − a.y
    /// ```
    ///
    /// and from row to row it is stepped with its remainder, which is as exact and needs no division.
    fn mark_edge(&mut self, a: [i64; 2], b: [i64; 2]) {
        let (a, b) = if a[1] < b[1] { (a, b) } else { (b, a) };
        let first = first_center(a[1]).max(0);
        let end = first_center(b[1]).min(self.height as i64);
        if first >= end {
            return;
        }
        let height = b[1] - a[1];
        let run = b[0] - a[0];
        let divisor = height * SUBPIXELS;
        let y = first * SUBPIXELS + SUBPIXELS / 2;
        // Rounding up is rounding down of one less, plus one.
        let numerator = (a[0] - SUBPIXELS / 2) * height + (y - a[1]) * run - 1;
        let (mut column, mut rest) = (numerator.div_euclid(divisor) + 1, numerator.rem_euclid(divisor));
        let (step, step_rest) = (run.div_euclid(height), run.rem_euclid(height) * SUBPIXELS);
        for span in &mut self.spans[first as usize..end as usize] {
            span[0] = span[0].min(column);
            span[1] = span[1].max(column);
            column += step;
            rest += step_rest;
            if rest >= divisor {
                column += 1;
                rest -= divisor;
            }
        }
    }

    /// The bytes, in rows from the top.
    pub(super) fn into_rgb(self) -> Vec<u8> {
        self.pixels.into_flattened()
    }

    /// The picture at half the size: each pixel the mean of 2 × 2.
    pub(super) fn into_halved_rgb(self) -> Vec<u8> {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut rgb = Vec::with_capacity(3 * width * height);
        for rows in self.pixels.chunks_exact(2 * self.width).take(height) {
            let (upper, lower) = rows.split_at(self.width);
            for (a, b) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                for c in 0..3 {
                    let sum: u16 = [a[0][c], a[1][c], b[0][c], b[1][c]].into_iter().map(u16::from).sum();
                    rgb.push(((sum + 2) / 4) as u8);
                }
            }
        }
        rgb
    }
}

/// Gives all of these pixels a color, in whole registers: three bytes by themselves are slow to repeat.
pub(super) fn paint(pixels: &mut [Color], color: Color) {
    let strip: [u8; STRIP] = std::array::from_fn(|i| color[i % 3]);
    let (strips, rest) = pixels.as_flattened_mut().as_chunks_mut();
    for to in strips {
        *to = strip;
    }
    rest.copy_from_slice(&strip[..rest.len()]);
}

/// A coordinate in 1/256 pixel.
fn snap(pixels: f64) -> i64 {
    (pixels.clamp(-LIMIT, LIMIT) * SUBPIXELS as f64).round() as i64
}

/// The first pixel whose center is not before `at`, which is in 1/256 pixel.
fn first_center(at: i64) -> i64 {
    (at + SUBPIXELS / 2 - 1).div_euclid(SUBPIXELS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lit(canvas: &Canvas) -> Vec<usize> {
        (0..canvas.pixels.len()).filter(|&i| canvas.pixels[i] == [255; 3]).collect()
    }

    #[test]
    fn a_pixel_is_lit_where_the_polygon_contains_its_center() {
        let mut canvas = Canvas::new(3, 3);

        canvas.fill(&[[0.6, 0.0], [2.4, 0.0], [2.4, 1.6], [0.6, 1.6]], [255; 3]);

        assert_eq!(lit(&canvas), [1, 4]);
    }

    #[test]
    fn neighbors_share_an_edge_without_gap_or_overlap() {
        let mut canvas = Canvas::new(4, 4);
        let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];

        canvas.fill(&[corners[0], corners[1], corners[2]], [255; 3]);
        let above = lit(&canvas).len();
        canvas.fill(&[corners[0], corners[2], corners[3]], [1; 3]);

        assert_eq!(lit(&canvas).len() + canvas.pixels.iter().filter(|&&p| p == [1; 3]).count(), 16);
        assert_eq!(lit(&canvas).len(), above, "the second triangle painted over the first");
    }

    #[test]
    fn what_lies_outside_is_not_drawn() {
        let mut canvas = Canvas::new(2, 2);

        canvas.fill(&[[-9.0, -9.0], [-1.0, -9.0], [-1.0, 9.0]], [255; 3]);
        canvas.fill(&[[5e9, 0.0], [6e9, 0.0], [5e9, 1.0]], [255; 3]);

        assert!(lit(&canvas).is_empty());
    }

    #[test]
    fn half_a_picture_is_the_mean_of_four_pixels() {
        let mut canvas = Canvas::new(2, 2);
        canvas.fill(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [200, 100, 2]);

        assert_eq!(canvas.into_halved_rgb(), [50, 25, 1]);
    }
}
