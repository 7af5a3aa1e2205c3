//! Learning a safe reward from a person who drives in a dream and says what they prefer, and why.
pub mod env;
