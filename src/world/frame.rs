//! A picture as a world shows it.

use std::sync::Arc;

use super::Size;

/// An RGB picture, `[height, width, 3]` bytes in rows from the top. Not necessarily square.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    height: u32,
    width: u32,
    rgb: Arc<[u8]>,
}

impl Frame {
    /// A frame of `height` rows of `width` pixels.
    ///
    /// # Panics
    /// Where `rgb` does not hold `height · width · 3` bytes.
    pub fn new(height: u32, width: u32, rgb: impl Into<Arc<[u8]>>) -> Self {
        let rgb = rgb.into();
        assert_eq!(
            rgb.len() as u64,
            3 * u64::from(height) * u64::from(width),
            "a frame of {height} x {width} has three bytes a pixel"
        );
        Self { height, width, rgb }
    }

    /// A square frame of `side` pixels a side.
    ///
    /// # Panics
    /// Where `rgb` does not hold `3 · side²` bytes.
    pub fn square(side: u32, rgb: impl Into<Arc<[u8]>>) -> Self {
        Self::new(side, side, rgb)
    }

    /// Rows and pixels of a row.
    pub fn size(&self) -> Size {
        Size { height: self.height, width: self.width }
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// The bytes, `[height, width, 3]`.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The same, shared.
    pub fn shared(&self) -> Arc<[u8]> {
        Arc::clone(&self.rgb)
    }

    /// Whether all its pixels have one color, as where nothing was drawn.
    pub fn is_uniform(&self) -> bool {
        let pixels = self.rgb.as_chunks::<3>().0;
        pixels.iter().all(|pixel| Some(pixel) == pixels.first())
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Frame({}x{})", self.height, self.width)
    }
}
