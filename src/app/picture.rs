//! Pictures that are shown: bytes that are shared, not copied.

use std::sync::Arc;

use crate::world::Frame;

/// A picture of any size, which costs nothing to clone.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels from side to side.
    pub width: u32,
    /// Pixels from top to bottom.
    pub height: u32,
    /// Rows from the top, three bytes a pixel.
    pub rgb: Arc<[u8]>,
    /// Whether its pixels are to be seen, as those that models see are.
    pub is_hard: bool,
}

impl From<&Frame> for Picture {
    fn from(frame: &Frame) -> Self {
        Self { width: frame.width(), height: frame.height(), rgb: frame.shared(), is_hard: true }
    }
}

impl From<&(u32, u32, Arc<[u8]>)> for Picture {
    fn from((width, height, rgb): &(u32, u32, Arc<[u8]>)) -> Self {
        Self { width: *width, height: *height, rgb: Arc::clone(rgb), is_hard: false }
    }
}
