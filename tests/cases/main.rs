//! Inputs that failed once, and their kind: damaged, foreign, crafted, moved, or given twice.
//!
//! Each is made here from what the program itself writes, so that no test depends on a file of an earlier format.
//! What is tried is the program as a user starts it, or the library where only that can be watched.
#![expect(clippy::unwrap_used, reason = "a failing test may panic")]

#[path = "../support/program.rs"]
mod program;

mod clips;
mod compare;
mod datasets;
mod drqv2;
mod files;
mod format;
mod networks;
mod numbers;
mod run_files;
mod sessions;
mod starting;
mod told;
#[cfg(target_os = "linux")]
mod window;
