//! Videos that are not decoded here, by the program `ffmpeg`.
//!
//! Nothing waits without end: its pipes do not block, and where nothing comes for a while it is ended.

use std::ffi::OsStr;
use std::io::{self, ErrorKind, Read};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process_group};

use crate::world::Frame;

/// How long it may say nothing.
const PATIENCE: Duration = Duration::from_mins(1);
/// Bytes of what it says last.
const MOST_WORDS: usize = 2000;

/// Why no picture came.
pub(super) enum FfmpegFault {
    /// It is not installed.
    NotThere,
    /// It failed, or ended before the picture came.
    Failed(String),
}

/// The pictures of a video in their order, each `height` x `width`.
pub(super) struct Pictures {
    child: Child,
    output: ChildStdout,
    errors: Option<ChildStderr>,
    /// What it said last.
    words: Vec<u8>,
    height: u32,
    width: u32,
    next: usize,
    last: Option<Frame>,
}

impl Pictures {
    /// Starts `program` on the MP4 file at `path`, for the pictures up to `last`.
    pub(super) fn start(
        program: &OsStr,
        path: &Path,
        [height, width]: [u32; 2],
        last: usize,
    ) -> Result<Self, FfmpegFault> {
        let failed = |met: io::Error| FfmpegFault::Failed(format!("ffmpeg: {met}"));
        // As a file of this kind and nothing else: neither a list of other files nor an address.
        let mut input = std::ffi::OsString::from("file:");
        input.push(path);
        let mut command = Command::new(program);
        command.args([
            "-v",
            "error",
            "-nostdin",
            "-protocol_whitelist",
            "file",
            "-noautorotate",
            "-f",
            "mov",
            "-i",
        ]);
        command.arg(input).args(["-map", "0:v:0", "-frames:v", &(last + 1).to_string()]);
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        let mut child = command.spawn().map_err(|met| match met.kind() {
            ErrorKind::NotFound | ErrorKind::PermissionDenied => FfmpegFault::NotThere,
            _ => failed(met),
        })?;
        let (Some(output), errors) = (child.stdout.take(), child.stderr.take()) else {
            unreachable!("both are piped");
        };
        let pictures = Self { child, output, errors, words: Vec::new(), height, width, next: 0, last: None };
        let unblock = |fd: &dyn std::os::fd::AsFd| {
            fcntl_getfl(fd)
                .and_then(|flags| fcntl_setfl(fd, flags | OFlags::NONBLOCK))
                .map_err(io::Error::from)
        };
        unblock(&pictures.output).map_err(failed)?;
        if let Some(errors) = &pictures.errors {
            unblock(errors).map_err(failed)?;
        }
        Ok(pictures)
    }

    /// Picture `k` of the file, which is the last one that was asked for or one after it.
    pub(super) fn picture(&mut self, k: usize) -> Result<Frame, FfmpegFault> {
        if self.next == k + 1
            && let Some(frame) = &self.last
        {
            return Ok(frame.clone());
        }
        if self.next > k {
            return Err(FfmpegFault::Failed(format!(
                "picture {k} is wanted after picture {}",
                self.next - 1
            )));
        }
        let mut rgb = vec![0; 3 * self.height as usize * self.width as usize];
        while self.next <= k {
            self.fill(&mut rgb)?;
            self.next += 1;
        }
        let frame = Frame::new(self.height, self.width, rgb);
        self.last = Some(frame.clone());
        Ok(frame)
    }

    /// Reads the next picture into `rgb`.
    fn fill(&mut self, rgb: &mut [u8]) -> Result<(), FfmpegFault> {
        let mut n = 0;
        let mut until = Instant::now() + PATIENCE;
        while n < rgb.len() {
            self.listen();
            match self.output.read(&mut rgb[n..]) {
                Ok(0) => return Err(FfmpegFault::Failed(self.last_words())),
                Ok(read) => {
                    n += read;
                    until = Instant::now() + PATIENCE;
                }
                Err(met) if matches!(met.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                    if Instant::now() >= until {
                        let why = format!("ffmpeg said nothing for {} seconds", PATIENCE.as_secs());
                        return Err(FfmpegFault::Failed(why));
                    }
                    let mut fds = vec![PollFd::new(&self.output, PollFlags::IN)];
                    if let Some(errors) = &self.errors {
                        fds.push(PollFd::new(errors, PollFlags::IN));
                    }
                    let most = Timespec { tv_sec: 0, tv_nsec: 200_000_000 };
                    // Where it fails, the read says why.
                    let _ = poll(&mut fds, Some(&most));
                }
                Err(met) => return Err(FfmpegFault::Failed(format!("ffmpeg: {met}"))),
            }
        }
        Ok(())
    }

    /// Reads what it says, and keeps the end of it.
    fn listen(&mut self) {
        let mut chunk = [0; 1024];
        while let Some(errors) = &mut self.errors {
            match errors.read(&mut chunk) {
                Ok(n) if n > 0 => {
                    self.words.extend_from_slice(&chunk[..n]);
                    let surplus = self.words.len().saturating_sub(MOST_WORDS);
                    self.words.drain(..surplus);
                }
                Err(met) if matches!(met.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => return,
                _ => self.errors = None,
            }
        }
    }

    /// Why it ended before the picture came.
    fn last_words(&mut self) -> String {
        // Its output has ended, and so will it soon.
        let until = Instant::now() + Duration::from_secs(2);
        while self.errors.is_some() && Instant::now() < until {
            self.listen();
            let _ = poll(&mut [], Some(&Timespec { tv_sec: 0, tv_nsec: 5_000_000 }));
        }
        let text = String::from_utf8_lossy(&self.words);
        let line =
            text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it said nothing of why");
        format!(
            "ffmpeg gave {} pictures of {} x {} and no more: {}",
            self.next,
            self.height,
            self.width,
            crate::text::shown_within(line.trim(), 300)
        )
    }
}

impl Drop for Pictures {
    fn drop(&mut self) {
        // With all that it started.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
