//! The last lines of what a process writes to its standard error.

use std::collections::VecDeque;

use crate::text::shown_within;

/// So many lines are kept.
const LINES: usize = 40;
/// So many bytes of each.
const LINE_BYTES: usize = 1000;
/// So many letters of each are shown.
const SHOWN: usize = 200;

/// The last lines of a text that grows.
#[derive(Debug, Default)]
pub(super) struct Tail {
    lines: VecDeque<Vec<u8>>,
    current: Vec<u8>,
}

impl Tail {
    /// Takes in what was written next.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if byte == b'\n' {
                self.end_line();
            } else if self.current.len() < LINE_BYTES {
                self.current.push(byte);
            }
        }
    }

    fn end_line(&mut self) {
        let line = std::mem::take(&mut self.current);
        if line.trim_ascii().is_empty() {
            return;
        }
        log::debug!("the world's process: {}", shown_line(&line));
        if self.lines.len() == LINES {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
    }

    /// The lines, each as it can be shown.
    pub(super) fn lines(&self) -> Vec<String> {
        let unended = Some(&self.current).filter(|line| !line.trim_ascii().is_empty());
        self.lines.iter().chain(unended).map(|line| shown_line(line)).collect()
    }
}

/// Bytes as a line for a person, indented as they are and without what is at its end.
pub(super) fn shown_line(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes.trim_ascii_end());
    let line = text.trim_start_matches(' ');
    if line.is_empty() {
        return String::new();
    }
    let indent = (text.len() - line.len()).min(SHOWN);
    " ".repeat(indent) + &shown_within(line, SHOWN)
}
