//! A square picture as the models see it.

use std::sync::Arc;

/// A square RGB picture, `[P, P, 3]` bytes in rows from the top.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    side: u32,
    rgb: Arc<[u8]>,
}

impl Frame {
    /// A frame of `side` pixels squared.
    ///
    /// # Panics
    /// Where `rgb` does not hold `3 · side²` bytes.
    pub fn new(side: u32, rgb: impl Into<Arc<[u8]>>) -> Self {
        let rgb = rgb.into();
        assert_eq!(rgb.len(), 3 * (side * side) as usize, "a frame of side {side} has 3 · side² bytes");
        Self { side, rgb }
    }

    /// Pixels a side: the axis `P`.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// The bytes, `[P, P, 3]`.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The same, shared.
    pub fn shared(&self) -> Arc<[u8]> {
        Arc::clone(&self.rgb)
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Frame({0}x{0})", self.side)
    }
}
