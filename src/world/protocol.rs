//! The messages between this program and the process of a world. `assets/python/dropj/README.md` has them byte by byte.
//!
//! ```text
//! u32 length of the header (little-endian) · u32 length of the pixels · header: JSON (UTF-8) · pixels: RGB, rows from the top
//! ```
//!
//! Nothing here waits or reads: bytes come in and messages go out, so that every limit stands in one place.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::spec::MAX_SIDE;

/// The version of the protocol.
pub const VERSION: u32 = 1;
/// Bytes before a header.
pub(super) const PREFIX: usize = 8;
/// Bytes of a header.
pub(super) const MAX_HEADER: usize = 1 << 20;
/// Bytes of the pixels.
pub(super) const MAX_PIXELS: usize = 3 * (MAX_SIDE as usize) * (MAX_SIDE as usize);

/// What this program asks of the process.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(super) enum Request<'a> {
    /// To begin an episode.
    Reset {
        /// Which request of this process it is, counted from 1.
        n: u64,
        /// What decides it.
        seed: u64,
        /// What is to be told of each step from here on.
        fields: &'a [String],
    },
    /// To take a step.
    Step {
        /// Which request of this process it is, counted from 1.
        n: u64,
        /// A number for each axis.
        action: &'a [f32],
    },
    /// To say what its own policy would do now. That moves nothing.
    Act {
        /// Which request of this process it is, counted from 1.
        n: u64,
    },
    /// To end.
    Close,
}

impl Request<'_> {
    /// Its bytes.
    pub(super) fn encoded(&self) -> Vec<u8> {
        let header = serde_json::to_vec(self).unwrap_or_else(|met| unreachable!("plain values: {met}"));
        let mut message = Vec::with_capacity(PREFIX + header.len());
        message.extend((header.len() as u32).to_le_bytes());
        message.extend(0_u32.to_le_bytes());
        message.extend(header);
        message
    }
}

/// What is told of a step beside picture and reward.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Fields {
    /// Nothing.
    #[default]
    Nothing,
    /// These fields.
    Named(Vec<String>),
    /// Every field that is a number or a truth value.
    All,
}

impl Fields {
    /// As the protocol says it.
    pub(super) fn names(&self) -> Vec<String> {
        match self {
            Self::Nothing => vec![],
            Self::Named(names) => names.clone(),
            Self::All => vec!["*".to_owned()],
        }
    }
}

/// The first message of a process: what it is.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Hello {
    /// The version of the protocol that it speaks.
    pub protocol: u32,
    /// What it is called.
    #[serde(default)]
    pub name: String,
    /// The size of its pictures.
    pub image: HelloImage,
    /// What can be done in it.
    pub axes: Vec<HelloAxis>,
    /// Steps a second of its time in Hz, where it knows.
    #[serde(default)]
    pub hertz: Option<f64>,
    /// Pictures a second that it says it draws for people, in Hz. Often not the rate of its steps.
    #[serde(default)]
    pub render_fps: Option<f64>,
    /// The most steps of an episode, where there is such a limit.
    #[serde(default)]
    pub longest_episode: Option<usize>,
    /// What it says can happen in it.
    #[serde(default)]
    pub events: Vec<HelloEvent>,
    /// The versions of what it is made of.
    #[serde(default)]
    pub versions: BTreeMap<String, String>,
    /// Whether it has a policy of its own, which says what it would do.
    #[serde(default)]
    pub policy: bool,
}

/// The size of a process's pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct HelloImage {
    /// Rows.
    pub height: u32,
    /// Pixels of a row.
    pub width: u32,
}

impl HelloImage {
    /// Bytes of a picture.
    pub(super) fn n_bytes(self) -> usize {
        3 * self.height as usize * self.width as usize
    }
}

/// An axis as a process says it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct HelloAxis {
    /// What it is called.
    pub name: String,
    /// Its smallest value.
    pub low: f64,
    /// Its largest value.
    pub high: f64,
    /// Its value while nobody does anything, where the process knows one.
    #[serde(default)]
    pub neutral: Option<f64>,
}

/// An event as a process says it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct HelloEvent {
    /// What it is called.
    pub name: String,
    /// `safety` or `progress`.
    pub kind: super::EventKind,
    /// The field that says it.
    pub field: String,
}

/// What a process answers to a reset or a step.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Reply {
    /// Which request it answers.
    pub n: u64,
    /// Rows.
    pub height: u32,
    /// Pixels of a row.
    pub width: u32,
    /// Its own reward, if it has one.
    #[serde(default)]
    pub reward: Option<f64>,
    /// Whether the episode ended by what happened in it.
    #[serde(default)]
    pub terminated: bool,
    /// Whether it was ended from outside.
    #[serde(default)]
    pub truncated: bool,
    /// The fields that were asked for, as far as there are such.
    #[serde(default)]
    pub fields: Map<String, Value>,
    /// What was executed, where that is not what was asked: by a safety filter, or by a human at the robot. A finite
    /// number for each axis.
    #[serde(default)]
    pub action: Option<Vec<f64>>,
}

/// What a process's own policy would do.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct Advice {
    /// Which request it answers.
    pub(super) n: u64,
    /// A number for each axis.
    pub(super) action: Vec<f64>,
}

/// The header of a message from a process.
#[derive(Debug, PartialEq)]
pub(super) enum Header {
    Hello(Hello),
    Frame(Reply),
    Action(Advice),
    Error { message: String, traceback: String },
}

/// Why a header cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum HeaderFault {
    /// It is no JSON, or has not what it should have.
    Meaning(String),
    /// It speaks another version.
    Version(String),
    /// What stands behind this key is no number.
    NotFinite(String),
}

impl Header {
    /// Which request it answers, where it is an answer.
    pub(super) fn n(&self) -> Option<u64> {
        match self {
            Self::Frame(reply) => Some(reply.n),
            Self::Action(advice) => Some(advice.n),
            Self::Hello(_) | Self::Error { .. } => None,
        }
    }

    /// Its kind, in words.
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Self::Hello(_) => "another hello",
            Self::Frame(_) => "a frame",
            Self::Action(_) => "an action",
            Self::Error { .. } => "an error",
        }
    }

    /// What a header says.
    pub(super) fn parsed(bytes: &[u8]) -> Result<Self, HeaderFault> {
        let meaning = |met: serde_json::Error| HeaderFault::Meaning(met.to_string());
        let value: Value = serde_json::from_slice(bytes)
            .map_err(|met| not_finite(bytes).map_or_else(|| meaning(met), HeaderFault::NotFinite))?;
        let text = |key: &str| value.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
        match text("type").as_str() {
            "hello" => {
                let found = value.get("protocol").map_or_else(|| "none".to_owned(), Value::to_string);
                if found != VERSION.to_string() {
                    return Err(HeaderFault::Version(found));
                }
                serde_json::from_value(value).map(Self::Hello).map_err(meaning)
            }
            "frame" => serde_json::from_value(value).map(Self::Frame).map_err(meaning),
            "action" => serde_json::from_value(value).map(Self::Action).map_err(meaning),
            "error" => Ok(Self::Error { message: text("message"), traceback: text("traceback") }),
            "" => Err(HeaderFault::Meaning("it has no type".to_owned())),
            other => Err(HeaderFault::Meaning(format!(
                "its type is {:?}, and there are hello, frame, action and error",
                crate::text::shown(other)
            ))),
        }
    }
}

/// The key before the first NaN or Infinity of a header, as languages other than JSON write them.
fn not_finite(bytes: &[u8]) -> Option<String> {
    let text = str::from_utf8(bytes).ok()?;
    let at = ["NaN", "Infinity"].iter().filter_map(|word| text.find(word)).min()?;
    let key = text[..at].rsplit('"').nth(1).unwrap_or_default();
    Some(crate::text::shown(key))
}
