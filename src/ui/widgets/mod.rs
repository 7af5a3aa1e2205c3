//! The parts that panels are made of.

pub(crate) mod clip;
pub(crate) mod curve;
pub(crate) mod field;
pub(crate) mod predictions;
pub(crate) mod gauge;
pub(crate) mod histogram;
pub(crate) mod keycap;
pub(crate) mod layout;
pub(crate) mod strip;
