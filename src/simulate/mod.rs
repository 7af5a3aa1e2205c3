//! Stand-ins for people: they drive, see and answer, so that everything runs without anyone at the keys.

mod hand;
pub mod pilot;
pub mod record;
