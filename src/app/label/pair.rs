//! The clips of a query.

use crate::app::Picture;

/// Clips of a pair, ready to be shown.
#[derive(Clone, Debug)]
pub(crate) struct Pair {
    pub left: Vec<Picture>,
    pub right: Vec<Picture>,
}
