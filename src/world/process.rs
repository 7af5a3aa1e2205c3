//! A world in a process of its own, over its standard input and output.
//!
//! Every wait ends: pipes do not block, `poll` has the time that is left, and what is read is held against its limits
//! before room is made for it. No thread is needed for that; a worker that must not wait calls this from its own.
//!
//! The process's standard input is a socket rather than a pipe: writing to one whose reader has died is an error on
//! every system, and never a signal that ends this program.

use std::io::{self, ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rand_chacha::ChaCha8Rng;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::events::EventReader;
use super::image::framed;
use super::protocol::{
    Fields, Header, HeaderFault, Hello, MAX_HEADER, MAX_PIXELS, PREFIX, Reply, Request, VERSION,
};
use super::spec::{MAX_SIDE, Source, TimeOuts, WorldSpec};
use super::tail::{Tail, shown_line};
use super::{Action, End, Frame, OwnPolicy, Step, World, WorldError};

/// Bytes that are read at once.
const CHUNK: usize = 1 << 14;
/// What is wrong with the output is shown up to so many bytes.
const EXCERPT: usize = 120;
/// The longest wait between two looks at whether the process is still there.
const GLANCE: Duration = Duration::from_millis(200);
/// How long the end of a process, and its last words, are waited for once its output has ended.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// Lines of the process in an error.
const LINES_IN_ERROR: usize = 4;
/// Variables that are kept from the process: with the first, some worlds paint nothing but black.
const REMOVED: [&str; 1] = ["SDL_VIDEODRIVER"];
/// Variables that the process gets: its prints come at once, and it knows that its output is the protocol's.
const GIVEN: [(&str, &str); 2] = [("PYTHONUNBUFFERED", "1"), ("DROPJ_PROTOCOL", "1")];

/// How a process is started.
#[derive(Clone, Debug, PartialEq)]
pub struct Launch {
    /// The program and its arguments.
    pub command: Vec<String>,
    /// Where it is started. None: where this program is.
    pub folder: Option<PathBuf>,
    /// Environment variables that it gets beside ours.
    pub environment: Vec<(String, String)>,
    /// How long it is waited for.
    pub time_outs: TimeOuts,
}

impl Launch {
    /// That which a world's file says; `folder` is the one that the file is in.
    pub fn of(source: &Source, folder: &Path) -> Self {
        let folder = source.folder.as_ref().map_or_else(|| folder.to_owned(), |inner| folder.join(inner));
        Self {
            command: source.command.clone(),
            folder: Some(folder).filter(|folder| !folder.as_os_str().is_empty()),
            environment: source.environment.clone().into_iter().collect(),
            time_outs: source.time_outs,
        }
    }
}

/// What a process was doing when it failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Starting, up to its first message.
    Start,
    /// Beginning an episode.
    Reset,
    /// Taking a step.
    Step,
    /// Saying what its own policy would do.
    Act,
}

impl std::fmt::Display for Phase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Reset => "reset",
            Self::Step => "step",
            Self::Act => "act",
        })
    }
}

/// Why the process of a world failed, with the last lines that it wrote to its standard error.
#[derive(Debug)]
pub struct ProcessError {
    /// What was met.
    pub fault: ProcessFault,
    /// The last lines, safe to show, the latest last.
    pub last_lines: Vec<String>,
}

impl std::error::Error for ProcessError {}

impl std::fmt::Display for ProcessError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.fault)?;
        let from = self.last_lines.len().saturating_sub(LINES_IN_ERROR);
        match &self.last_lines[from..] {
            [] => Ok(()),
            lines => write!(f, "; its last lines: {}", lines.join(" | ")),
        }
    }
}

/// What the process of a world did wrong.
#[derive(Debug, thiserror::Error)]
pub enum ProcessFault {
    /// It cannot be started.
    #[error("the world's process cannot be started: {cause}: {program:?}")]
    Start {
        /// What was met.
        cause: io::Error,
        /// The program.
        program: String,
    },
    /// It speaks another version of the protocol.
    #[error(
        "the world's process speaks version {found} of the protocol, and this program speaks version {VERSION}"
    )]
    Version {
        /// What it says of its version.
        found: String,
    },
    /// It ended.
    #[error("the world's process ended during {during} ({status})")]
    Ended {
        /// What it was doing.
        during: Phase,
        /// How it ended.
        status: ExitStatus,
    },
    /// It closed its standard output and lives on.
    #[error("the world's process closed its standard output during {during}, through which it is to answer")]
    Closed {
        /// What it was doing.
        during: Phase,
    },
    /// It did not answer in time.
    #[error("the world's process did not answer within {seconds} s of its {during}{so_far}")]
    Silent {
        /// What it was doing.
        during: Phase,
        /// The time-out.
        seconds: f64,
        /// What it had written of its answer, in words.
        so_far: String,
    },
    /// It wrote to its standard output what is no message.
    #[error(
        "the world's process wrote {excerpt} to its standard output, which belongs to the protocol: let it print to \
         standard error, and import dropj before what prints"
    )]
    Rubbish {
        /// What it wrote, safe to show.
        excerpt: String,
    },
    /// A message of it cannot be understood.
    #[error("a message of the world's process cannot be understood ({what}): {excerpt}")]
    Meaning {
        /// What is wrong.
        what: String,
        /// Its beginning, safe to show.
        excerpt: String,
    },
    /// A number of it is none.
    #[error("the world's process tells of {} {key} that is not a finite number, during {during}", article(.key))]
    NotFinite {
        /// Which.
        key: String,
        /// What it was doing.
        during: Phase,
    },
    /// An action of it has too many or too few numbers.
    #[error(
        "the world's process tells of an action of {found} numbers during {during}, and it has {wanted} axes"
    )]
    ActionLength {
        /// What it was doing.
        during: Phase,
        /// How many it has.
        found: usize,
        /// How many axes there are.
        wanted: usize,
    },
    /// A message of it is too long.
    #[error("a message of the world's process would have {what} of {found} bytes, and {most} is the most")]
    TooLong {
        /// Which part.
        what: &'static str,
        /// Its bytes.
        found: usize,
        /// How many are taken.
        most: usize,
    },
    /// A picture has another size than the process said.
    #[error("the world's process sent a picture of {found}, and it had said {wanted}")]
    Size {
        /// Its size.
        found: String,
        /// What was said at its start.
        wanted: String,
    },
    /// It reports an error of its own.
    #[error("the world's process reports during {during}: {message}")]
    Reported {
        /// What it was doing.
        during: Phase,
        /// What it says, in one line.
        message: String,
        /// Where that was met in its own code, one line each.
        traceback: Vec<String>,
    },
    /// It sent another kind of message than was due.
    #[error("the world's process sent {found} during {during}, and {wanted} was due")]
    Unexpected {
        /// What it was doing.
        during: Phase,
        /// What came.
        found: &'static str,
        /// What was due.
        wanted: &'static str,
    },
    /// It sent something that nobody asked for.
    #[error("the world's process sent a message that was not asked for, before its {during}")]
    Unasked {
        /// What would have been next.
        during: Phase,
    },
    /// It says of itself what cannot be.
    #[error("the world's process says that {key} is {found}, and it must be {wanted}")]
    Hello {
        /// What.
        key: String,
        /// What it says.
        found: String,
        /// What it may say.
        wanted: String,
    },
    /// It is not the world that the file describes.
    #[error("{key} is {in_file} in the world's file, and its process says {found}")]
    Differs {
        /// The key of the file.
        key: String,
        /// Its value.
        in_file: String,
        /// What the process says.
        found: String,
    },
    /// The system failed.
    #[error("the world's process cannot be reached during {during}: {cause}")]
    System {
        /// What it was doing.
        during: Phase,
        /// What was met.
        cause: io::Error,
    },
    /// It failed before.
    #[error("the world's process is gone: start it anew")]
    Gone,
}

/// A process that speaks the protocol. It is ended, and nothing of it is left, when this is dropped.
#[derive(Debug)]
pub struct Process {
    child: Child,
    input: UnixStream,
    output: ChildStdout,
    /// None once it has ended.
    errors: Option<ChildStderr>,
    tail: Tail,
    /// What has come of the next message.
    received: Vec<u8>,
    output_ended: bool,
    hello: Hello,
    time_outs: TimeOuts,
    n_asked: u64,
    is_alive: bool,
}

impl Process {
    /// Starts a process and waits for what it says of itself.
    ///
    /// # Errors
    /// Where it cannot be started, where it does not say in time what it is, and where that cannot be.
    pub fn start(launch: &Launch) -> Result<Self, ProcessError> {
        let program = launch.command.first().cloned().unwrap_or_default();
        let (child, input, time_outs) = spawn(launch).map_err(|cause| ProcessError {
            fault: ProcessFault::Start { cause, program: program.clone() },
            last_lines: vec![],
        })?;
        let mut child = child;
        let (Some(output), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            unreachable!("both were asked for")
        };
        let nothing = Hello {
            protocol: VERSION,
            name: String::new(),
            image: super::protocol::HelloImage { height: 0, width: 0 },
            axes: vec![],
            hertz: None,
            render_fps: None,
            longest_episode: None,
            events: vec![],
            versions: std::collections::BTreeMap::new(),
            policy: false,
        };
        let mut process = Self {
            child,
            input,
            output,
            errors: Some(errors),
            tail: Tail::default(),
            received: Vec::new(),
            output_ended: false,
            hello: nothing,
            time_outs,
            n_asked: 0,
            is_alive: true,
        };
        let begun = process.begin();
        process.noted(begun)?;
        Ok(process)
    }

    fn begin(&mut self) -> Result<(), ProcessFault> {
        for fd in [Some(self.output.as_fd()), self.errors.as_ref().map(AsFd::as_fd)].into_iter().flatten() {
            fcntl_setfl(fd, OFlags::NONBLOCK)
                .map_err(|met| ProcessFault::System { during: Phase::Start, cause: met.into() })?;
        }
        match self.exchange(None, Phase::Start, self.time_outs.start)? {
            (Header::Hello(hello), _) => {
                check_hello(&hello)?;
                self.hello = hello;
                Ok(())
            }
            (other, _) => Err(ProcessFault::Unexpected {
                during: Phase::Start,
                found: other.kind(),
                wanted: "what it says of itself, hello,",
            }),
        }
    }

    /// What it said of itself.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The last lines that it wrote to its standard error, safe to show.
    pub fn last_lines(&self) -> Vec<String> {
        self.tail.lines()
    }

    /// Begins an episode; `fields` are told of each step from here on.
    ///
    /// # Errors
    /// Where the process fails in any way: see [`ProcessFault`]. It is then gone.
    pub fn reset(&mut self, seed: u64, fields: &Fields) -> Result<(Frame, Reply), ProcessError> {
        let n = self.next();
        let request = Request::Reset { n, seed, fields: &fields.names() };
        let frame = self.frame(n, &request, Phase::Reset, self.time_outs.reset);
        self.noted(frame)
    }

    /// Takes a step.
    ///
    /// # Errors
    /// Where the process fails in any way: see [`ProcessFault`]. It is then gone.
    pub fn step(&mut self, action: &[f32]) -> Result<(Frame, Reply), ProcessError> {
        let n = self.next();
        let frame = self.frame(n, &Request::Step { n, action }, Phase::Step, self.time_outs.step);
        self.noted(frame)
    }

    /// Whether it has a policy of its own.
    pub fn has_policy(&self) -> bool {
        self.hello.policy
    }

    /// What its own policy would do now, in the ranges of its axes; None where it has none. That moves nothing. It is
    /// waited for as long as for a step.
    ///
    /// # Errors
    /// Where the process fails in any way: see [`ProcessFault`]. It is then gone.
    pub fn act(&mut self) -> Result<Option<Vec<f32>>, ProcessError> {
        if !self.has_policy() {
            return Ok(None);
        }
        let n = self.next();
        let action = self.advice(n);
        self.noted(action).map(Some)
    }

    fn advice(&mut self, n: u64) -> Result<Vec<f32>, ProcessFault> {
        let during = Phase::Act;
        match self.ask(n, &Request::Act { n }, during, self.time_outs.step)? {
            (Header::Action(advice), _) => {
                self.check_action(&advice.action, during)?;
                let axes = &self.hello.axes;
                Ok(axes
                    .iter()
                    .zip(advice.action)
                    .map(|(axis, x)| x.clamp(axis.low, axis.high) as f32)
                    .collect())
            }
            (other, _) => Err(ProcessFault::Unexpected { during, found: other.kind(), wanted: "an action" }),
        }
    }

    /// Fails where an action has not a finite number for each axis.
    fn check_action(&self, action: &[f64], during: Phase) -> Result<(), ProcessFault> {
        let (found, wanted) = (action.len(), self.hello.axes.len());
        if found != wanted {
            return Err(ProcessFault::ActionLength { during, found, wanted });
        }
        if action.iter().any(|&value| !(value as f32).is_finite()) {
            return Err(ProcessFault::NotFinite { key: "action".to_owned(), during });
        }
        Ok(())
    }

    /// The number of the next request.
    fn next(&mut self) -> u64 {
        self.n_asked += 1;
        self.n_asked
    }

    /// Ends the process where it failed, and takes its last lines.
    fn noted<T>(&mut self, result: Result<T, ProcessFault>) -> Result<T, ProcessError> {
        result.map_err(|fault| {
            if !matches!(fault, ProcessFault::Gone) {
                self.read_errors();
                self.kill();
            }
            ProcessError { fault, last_lines: self.tail.lines() }
        })
    }

    fn frame(
        &mut self,
        n: u64,
        request: &Request,
        during: Phase,
        seconds: f64,
    ) -> Result<(Frame, Reply), ProcessFault> {
        match self.ask(n, request, during, seconds)? {
            (Header::Frame(reply), pixels) => {
                if !reply.reward.is_none_or(|reward| (reward as f32).is_finite()) {
                    return Err(ProcessFault::NotFinite { key: "reward".to_owned(), during });
                }
                if let Some(action) = &reply.action {
                    self.check_action(action, during)?;
                }
                Ok((Frame::new(reply.height, reply.width, pixels), reply))
            }
            (other, _) => Err(ProcessFault::Unexpected { during, found: other.kind(), wanted: "a frame" }),
        }
    }

    /// Sends a request and waits for its answer.
    fn ask(
        &mut self,
        n: u64,
        request: &Request,
        during: Phase,
        seconds: f64,
    ) -> Result<(Header, Vec<u8>), ProcessFault> {
        if !self.is_alive {
            return Err(ProcessFault::Gone);
        }
        self.require_quiet(during)?;
        let answer = self.exchange(Some(request), during, seconds)?;
        // A second answer to what was asked before may come as late as this.
        if answer.0.n().is_some_and(|answered| answered != n) {
            return Err(ProcessFault::Unasked { during });
        }
        Ok(answer)
    }

    /// Fails where the process has written something that it was not asked for: an error, or a second answer.
    fn require_quiet(&mut self, during: Phase) -> Result<(), ProcessFault> {
        if self.received.is_empty() {
            self.read_output().map_err(|cause| ProcessFault::System { during, cause })?;
        }
        if self.received.is_empty() {
            return Ok(()); // and where it has ended, the exchange says so
        }
        // It may be an error, all of which should be read.
        match self.exchange(None, during, LAST_WORDS.as_secs_f64()) {
            Err(fault @ (ProcessFault::Reported { .. } | ProcessFault::Rubbish { .. })) => Err(fault),
            _ => Err(ProcessFault::Unasked { during }),
        }
    }

    /// Sends a request, if there is one, and waits for the next message.
    fn exchange(
        &mut self,
        request: Option<&Request>,
        during: Phase,
        seconds: f64,
    ) -> Result<(Header, Vec<u8>), ProcessFault> {
        let system = |cause| ProcessFault::System { during, cause };
        let limit = TimeOuts::duration(seconds);
        let deadline = Instant::now() + limit;
        let message = request.map(Request::encoded).unwrap_or_default();
        let mut unsent = message.as_slice();
        let mut header = None;
        loop {
            if !unsent.is_empty() {
                match self.input.write(unsent) {
                    Ok(n) => unsent = &unsent[n..],
                    Err(met) if is_transient(&met) => {}
                    // It is gone, or will not listen; what it says last tells more.
                    Err(_) => unsent = &[],
                }
            }
            if let Some(message) = self.take_message(&mut header, during)? {
                return Ok(message);
            }
            if self.output_ended {
                return Err(self.end_of_output(during, deadline));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                self.read_errors();
                return Err(ProcessFault::Silent {
                    during,
                    seconds: limit.as_secs_f64(),
                    so_far: self.so_far(),
                });
            }
            if !self.wait(!unsent.is_empty(), left.min(GLANCE)).map_err(system)? && self.has_ended() {
                // Nothing more will come, even where others hold its output open.
                self.read_output().map_err(system)?;
                self.output_ended = true;
            }
        }
    }

    /// Waits until there is something to read, or to write where that is wanted, and reads. Whether there was anything.
    fn wait(&mut self, wants_to_write: bool, most: Duration) -> io::Result<bool> {
        let mut fds = vec![PollFd::new(&self.output, PollFlags::IN)];
        if let Some(errors) = &self.errors {
            fds.push(PollFd::new(errors, PollFlags::IN));
        }
        if wants_to_write {
            fds.push(PollFd::new(&self.input, PollFlags::OUT));
        }
        let n = poll_for(&mut fds, most)?;
        drop(fds);
        self.read_output()?;
        self.read_errors();
        Ok(n > 0)
    }

    /// Reads once what is there of the output.
    fn read_output(&mut self) -> io::Result<()> {
        let mut chunk = [0; CHUNK];
        match self.output.read(&mut chunk) {
            Ok(0) => self.output_ended = true,
            Ok(n) => self.received.extend_from_slice(&chunk[..n]),
            Err(met) if is_transient(&met) => {}
            Err(met) => return Err(met),
        }
        Ok(())
    }

    /// Reads once what is there of the standard error. That it fails is no reason to fail.
    fn read_errors(&mut self) {
        let mut chunk = [0; CHUNK];
        let Some(errors) = &mut self.errors else { return };
        match errors.read(&mut chunk) {
            Ok(n) if n > 0 => self.tail.push(&chunk[..n]),
            Err(met) if is_transient(&met) => {}
            _ => self.errors = None,
        }
    }

    /// The next message, if all of it has come; its header stands in `header` as soon as that has.
    fn take_message(
        &mut self,
        header: &mut Option<(Header, usize)>,
        during: Phase,
    ) -> Result<Option<(Header, Vec<u8>)>, ProcessFault> {
        if header.is_none() {
            *header = self.take_header(during)?;
        }
        let Some((_, n_pixels)) = header else { return Ok(None) };
        if self.received.len() < *n_pixels {
            return Ok(None);
        }
        let rest = self.received.split_off(*n_pixels);
        let pixels = std::mem::replace(&mut self.received, rest);
        Ok(header.take().map(|(header, _)| (header, pixels)))
    }

    /// The header of the next message with the number of bytes behind it, if all of the header has come.
    fn take_header(&mut self, during: Phase) -> Result<Option<(Header, usize)>, ProcessFault> {
        let Some((prefix, rest)) = self.received.split_first_chunk::<PREFIX>() else { return Ok(None) };
        let length =
            |at: usize| u32::from_le_bytes([prefix[at], prefix[at + 1], prefix[at + 2], prefix[at + 3]]);
        let (n_header, n_pixels) = (length(0) as usize, length(4) as usize);
        let is_text = |bytes: &[u8]| bytes.iter().all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace());
        // No length that is taken looks like text.
        if n_header > MAX_HEADER && prefix.iter().any(u8::is_ascii_graphic) && is_text(&prefix[..4]) {
            return Err(ProcessFault::Rubbish { excerpt: self.excerpt() });
        }
        for (what, found, most) in [("a header", n_header, MAX_HEADER), ("pixels", n_pixels, MAX_PIXELS)] {
            if found > most {
                return Err(ProcessFault::TooLong { what, found, most });
            }
        }
        let Some(text) = rest.get(..n_header) else { return Ok(None) };
        let excerpt = || shown_bytes(text);
        let header = Header::parsed(text).map_err(|met| match met {
            HeaderFault::Meaning(what) => ProcessFault::Meaning { what, excerpt: excerpt() },
            HeaderFault::Version(found) => ProcessFault::Version { found: crate::text::shown(&found) },
            HeaderFault::NotFinite(key) => ProcessFault::NotFinite { key, during },
        })?;
        let wanted = match &header {
            Header::Frame(_) if during == Phase::Start => 0,
            Header::Frame(reply) => {
                let said = self.hello.image;
                if (reply.height, reply.width) != (said.height, said.width) {
                    return Err(ProcessFault::Size {
                        found: format!("{} x {} pixels", reply.height, reply.width),
                        wanted: format!("{} x {}", said.height, said.width),
                    });
                }
                said.n_bytes()
            }
            Header::Hello(_) | Header::Action(_) => 0,
            Header::Error { message, traceback } => {
                let traceback = traceback.lines().map(|line| shown_line(line.as_bytes())).collect();
                let message = crate::text::shown_within(message.trim(), 500);
                return Err(ProcessFault::Reported { during, message, traceback });
            }
        };
        if n_pixels != wanted {
            return Err(ProcessFault::Size {
                found: format!("{n_pixels} bytes"),
                wanted: format!("{wanted}, three a pixel"),
            });
        }
        self.received.drain(..PREFIX + n_header);
        // All that is to come, and no more.
        self.received.reserve(n_pixels.saturating_sub(self.received.len()));
        Ok(Some((header, n_pixels)))
    }

    /// What has come of a message that is not whole, in words.
    fn so_far(&self) -> String {
        match self.received.len() {
            0 => String::new(),
            n => format!("; {n} bytes of its answer came: {}", self.excerpt()),
        }
    }

    fn excerpt(&self) -> String {
        shown_bytes(&self.received)
    }

    /// Why the output ended.
    fn end_of_output(&mut self, during: Phase, deadline: Instant) -> ProcessFault {
        let until =
            (Instant::now() + LAST_WORDS).min(deadline.max(Instant::now() + Duration::from_millis(50)));
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let mut fds: Vec<_> =
                self.errors.iter().map(|errors| PollFd::new(errors, PollFlags::IN)).collect();
            let _ = poll_for(&mut fds, left.min(Duration::from_millis(20)));
            drop(fds);
            let before = self.tail.lines().len();
            self.read_errors();
            let has_ended = self.has_ended();
            if left.is_zero() || (has_ended && self.tail.lines().len() == before) {
                break;
            }
        }
        if !self.received.is_empty() && !self.received.starts_with(&[0]) && self.received.len() < PREFIX {
            return ProcessFault::Rubbish { excerpt: self.excerpt() };
        }
        if !self.has_ended() {
            return ProcessFault::Closed { during };
        }
        match self.kill() {
            Some(status) => ProcessFault::Ended { during, status },
            None => ProcessFault::Closed { during },
        }
    }

    /// Whether the process has ended, without taking its place away from it.
    fn has_ended(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        !self.is_alive || !matches!(waitid(WaitId::Pid(Pid::from_child(&self.child)), options), Ok(None))
    }

    /// Ends it and all that it started, at once. How it ended, where it had not been ended before.
    fn kill(&mut self) -> Option<ExitStatus> {
        if !std::mem::take(&mut self.is_alive) {
            return None;
        }
        // Before it is waited for: until then nobody else can have its number.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.kill();
        self.child.wait().ok()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if !self.is_alive {
            return;
        }
        let _ = self.input.write(&Request::Close.encoded());
        let _ = self.input.shutdown(Shutdown::Write);
        let deadline = Instant::now() + TimeOuts::duration(self.time_outs.close);
        while !self.has_ended() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            // It may have something to say still, and wait until that is read.
            let looked = if self.output_ended && self.errors.is_none() {
                poll_for(&mut [], left.min(Duration::from_millis(10))).map(|_| ())
            } else {
                self.wait(false, left.min(Duration::from_millis(10))).map(|_| ())
            };
            self.received.clear();
            if looked.is_err() {
                break;
            }
        }
        self.kill();
    }
}

fn spawn(launch: &Launch) -> io::Result<(Child, UnixStream, TimeOuts)> {
    let Some((program, args)) = launch.command.split_first() else {
        return Err(io::Error::new(ErrorKind::InvalidInput, "no program is named"));
    };
    let (ours, theirs) = UnixStream::pair()?;
    ours.set_nonblocking(true)?;
    let mut command = Command::new(program);
    command.args(args).process_group(0);
    if let Some(folder) = &launch.folder {
        command.current_dir(folder);
    }
    for name in REMOVED {
        command.env_remove(name);
    }
    command.envs(GIVEN).envs(launch.environment.iter().map(|(name, value)| (name, value)));
    command.stdin(Stdio::from(OwnedFd::from(theirs))).stdout(Stdio::piped()).stderr(Stdio::piped());
    Ok((command.spawn()?, ours, launch.time_outs))
}

/// Waits for one of `fds`, but no longer than `most`. How many there are.
fn poll_for(fds: &mut [PollFd<'_>], most: Duration) -> io::Result<usize> {
    let most = Timespec { tv_sec: most.as_secs() as _, tv_nsec: most.subsec_nanos() as _ };
    match poll(fds, Some(&most)) {
        Ok(n) => Ok(n),
        Err(met) if met == rustix::io::Errno::INTR => Ok(0),
        Err(met) => Err(met.into()),
    }
}

fn is_transient(met: &io::Error) -> bool {
    matches!(met.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// The article before a key.
fn article(key: &str) -> &'static str {
    if key.starts_with(['a', 'e', 'i', 'o']) { "an" } else { "a" }
}

/// The beginning of some bytes, safe to show and in quotes.
fn shown_bytes(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(EXCERPT)]);
    format!("\"{}\"", crate::text::shown_within(&text, EXCERPT).trim_matches('"'))
}

/// Fails where a process says of itself what cannot be.
fn check_hello(hello: &Hello) -> Result<(), ProcessFault> {
    let wrong = |key: String, found: String, wanted: &str| {
        Err(ProcessFault::Hello { key, found, wanted: wanted.to_owned() })
    };
    for (key, found) in [("image.height", hello.image.height), ("image.width", hello.image.width)] {
        if !(1..=MAX_SIDE).contains(&found) {
            return wrong(key.to_owned(), found.to_string(), "from 1 to 4096");
        }
    }
    if hello.axes.is_empty() || hello.axes.len() > 64 {
        return wrong("the number of axes".to_owned(), hello.axes.len().to_string(), "from 1 to 64");
    }
    for axis in &hello.axes {
        let key = |name: &str| format!("axes.{:?}.{name}", crate::text::shown(&axis.name));
        let (low, high) = (axis.low as f32, axis.high as f32);
        if !low.is_finite() {
            return wrong(key("low"), axis.low.to_string(), "a finite number");
        }
        if !high.is_finite() || high <= low {
            return wrong(key("high"), axis.high.to_string(), "a finite number above its low");
        }
    }
    Ok(())
}

/// Something about a world's process that is no error, but hardly meant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    /// A picture has one color.
    #[error(
        "a picture of this world has the same color everywhere ({rgb:?}): it may draw nothing without a screen"
    )]
    Uniform {
        /// The color.
        rgb: [u8; 3],
    },
}

/// A world in a process, as its file describes it.
#[derive(Debug)]
pub struct ProcessWorld {
    spec: Arc<WorldSpec>,
    process: Process,
    fields: Fields,
    events: EventReader,
    /// Steps of the episode that goes on; none where none does.
    n_steps: Option<usize>,
    /// What was executed in the last step, where the process says that it was something else than was asked.
    executed: Option<Vec<f32>>,
    /// The present picture, where networks see another one.
    shown: Option<Frame>,
    warnings: Vec<Warning>,
    has_warned: bool,
}

impl ProcessWorld {
    /// Starts the process that `spec` names; `folder` is the one that its file is in.
    ///
    /// # Errors
    /// Where that fails, and where the process is not what the file describes.
    pub fn start(spec: WorldSpec, folder: &Path) -> Result<Self, ProcessError> {
        let mut process = Process::start(&Launch::of(&spec.source, folder))?;
        let fits = check_fit(&spec, &process.hello);
        process.noted(fits)?;
        let names = spec.fields();
        let fields = if names.is_empty() { Fields::Nothing } else { Fields::Named(names) };
        let events = EventReader::new(&spec.events);
        Ok(Self {
            spec: Arc::new(spec),
            process,
            fields,
            events,
            n_steps: None,
            executed: None,
            shown: None,
            warnings: vec![],
            has_warned: false,
        })
    }

    /// The process.
    pub fn process(&self) -> &Process {
        &self.process
    }

    /// Whether the process has a policy of its own.
    pub fn has_policy(&self) -> bool {
        self.process.has_policy()
    }

    /// What the process's own policy would do now, in the ranges of the file's axes; None where it has none. That moves
    /// nothing.
    ///
    /// # Errors
    /// Where no episode goes on, and where the process fails.
    pub fn act(&mut self) -> Result<Option<Vec<f32>>, WorldError> {
        if self.has_policy() && self.n_steps.is_none() {
            return Err(WorldError::NoEpisode);
        }
        let action = self.process.act()?;
        Ok(action.map(|action| self.clamped(action)))
    }

    /// What was executed in the last step, in the ranges of the file's axes, where the process says that it was not what
    /// was asked.
    pub fn executed(&self) -> Option<&[f32]> {
        self.executed.as_deref()
    }

    /// What networks see of a picture, which is kept for people where that is something else.
    fn seen(&mut self, frame: Frame) -> Frame {
        let seen = framed(&self.spec.image, &frame);
        self.shown = (seen.size() != frame.size()).then_some(frame);
        seen
    }

    fn clamped(&self, action: impl IntoIterator<Item = f32>) -> Vec<f32> {
        self.spec.axes.iter().zip(action).map(|(axis, value)| axis.clamped(value)).collect()
    }

    /// What was met since the last time that is no error, but hardly meant. Each is told once.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.warnings)
    }

    /// The same as [`World::reset`], with what the process tells of the first moment.
    ///
    /// # Errors
    /// Where the process fails.
    pub fn reset_told(&mut self, seed: u64) -> Result<(Frame, Reply), WorldError> {
        (self.n_steps, self.executed) = (None, None);
        let (frame, reply) = self.process.reset(seed, &self.fields)?;
        self.events.begin(&reply.fields);
        self.n_steps = Some(0);
        self.look_at(&frame);
        Ok((frame, reply))
    }

    /// The same as [`World::step`], with what the process tells of the step.
    ///
    /// # Errors
    /// As those of [`World::step`].
    pub fn step_told(&mut self, action: &[f32]) -> Result<(Step, Reply), WorldError> {
        let action = self.spec.checked(action)?;
        let n_steps = self.n_steps.take().ok_or(WorldError::NoEpisode)? + 1;
        let (frame, reply) = self.process.step(&action)?;
        let executed = reply.action.as_ref();
        let executed = executed.map(|values| self.clamped(values.iter().map(|&value| value as f32)));
        self.executed.clone_from(&executed);
        self.look_at(&frame);
        let step = Step {
            frame,
            reward: reply.reward.map(|reward| reward as f32),
            events: self.events.read(&reply.fields),
            executed: executed.map(Action::new),
            end: match reply.terminated {
                true => Some(End::Terminated),
                false if reply.truncated || n_steps >= self.spec.longest_episode => Some(End::Truncated),
                false => None,
            },
        };
        self.n_steps = step.end.is_none().then_some(n_steps);
        Ok((step, reply))
    }

    fn look_at(&mut self, frame: &Frame) {
        if self.has_warned || !frame.is_uniform() {
            return;
        }
        self.has_warned = true;
        let rgb = frame.rgb().first_chunk().copied().unwrap_or_default();
        self.warnings.push(Warning::Uniform { rgb });
    }
}

impl World for ProcessWorld {
    fn spec(&self) -> &Arc<WorldSpec> {
        &self.spec
    }

    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError> {
        let (frame, _) = self.reset_told(seed)?;
        Ok(self.seen(frame))
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError> {
        let (step, _) = self.step_told(action)?;
        Ok(Step { frame: self.seen(step.frame), ..step })
    }

    fn picture(&self, _: u32, _: u32) -> Option<Frame> {
        self.shown.clone()
    }

    fn policy(&mut self) -> Option<&mut dyn OwnPolicy> {
        self.has_policy().then_some(self as &mut dyn OwnPolicy)
    }
}

impl OwnPolicy for ProcessWorld {
    /// The process draws its moods by the episode's seed.
    fn begin(&mut self, _: &mut ChaCha8Rng) {}

    fn act(&mut self, _: &mut ChaCha8Rng) -> Result<Action, WorldError> {
        let action = Self::act(self)?;
        Ok(Action::new(action.unwrap_or_else(|| self.spec.neutral())))
    }
}

/// Fails where a process is not what a file describes. A file may name axes otherwise, and narrow their ranges.
fn check_fit(spec: &WorldSpec, hello: &Hello) -> Result<(), ProcessFault> {
    let differs =
        |key: String, in_file: String, found: String| Err(ProcessFault::Differs { key, in_file, found });
    let image = &spec.image;
    if (image.height, image.width) != (hello.image.height, hello.image.width) {
        let size = |height: u32, width: u32| format!("{height} x {width}");
        let found = size(hello.image.height, hello.image.width);
        return differs("the size of image".to_owned(), size(image.height, image.width), found);
    }
    if spec.axes.len() != hello.axes.len() {
        let (in_file, found) = (spec.axes.len().to_string(), hello.axes.len().to_string());
        return differs("the number of axes".to_owned(), in_file, found);
    }
    for (axis, said) in spec.axes.iter().zip(&hello.axes) {
        let room = 1e-5 * (said.high - said.low).abs();
        let (low, high) = (f64::from(axis.low), f64::from(axis.high));
        if low < said.low - room {
            return differs(format!("axes.{:?}.low", axis.name), axis.low.to_string(), said.low.to_string());
        }
        if high > said.high + room {
            return differs(
                format!("axes.{:?}.high", axis.name),
                axis.high.to_string(),
                said.high.to_string(),
            );
        }
    }
    match hello.hertz {
        Some(hertz) if (hertz - spec.rate).abs() > 1e-3 * spec.rate => {
            differs("rate".to_owned(), spec.rate.to_string(), hertz.to_string())
        }
        _ => Ok(()),
    }
}
