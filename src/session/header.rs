//! What a session is before anything happens in it: `session.json`.

use std::path::Path;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::query::{Protocol, Weights};
use crate::session::check::check_weights;
use crate::session::error::{HeaderError, SessionError};
use crate::session::{Session, arrays};
use crate::text::{is_utf16, trimmed};
use crate::world::WorldSpec;

/// The format of sessions that this program writes. It reads those before it too, for it only added events.
///
/// 2: `protocol_changed` and `skip_explained`. 3: `dream_dropped` and `dream_restored`, who drove in `dream_kept`,
/// `screen_changed`, `asked_transition`, verdicts, and what synthesized dreams were made to be.
pub const FORMAT: u32 = 3;

/// The name of its file in the session's folder.
pub(crate) const FILE: &str = "session.json";

/// The head of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// [`FORMAT`].
    pub format: u32,
    /// The version of the program that made the session.
    pub app: String,
    /// The environment, as on the command line.
    pub env: String,
    /// Which questions are asked, until the log says otherwise.
    pub protocol: Protocol,
    /// What the session's generators are seeded from.
    pub seed: u64,
    /// The hash of the world model: everything in the session was dreamed with it.
    pub world_model: String,
    /// Where the world model was, from the session's folder, if the folder holds no copy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_model_path: Option<String>,
    /// The world's file, where the world is not built in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_file: Option<String>,
    /// When it was made, in milliseconds since 1970.
    pub created_at: u64,
    /// What can be chosen.
    pub config: Config,
}

/// What a researcher chooses for a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The weights of answers, until the log says otherwise.
    pub weights: Weights,
    /// Who answers, until somebody gives a name.
    #[serde(default = "anonymous")]
    pub annotator: String,
}

fn anonymous() -> String {
    "anonymous".to_owned()
}

impl Header {
    /// A session of this program in a world, made `created_at` milliseconds after the start of 1970, with the world's weights.
    pub fn of(spec: &WorldSpec, protocol: Protocol, seed: u64, world_model: &str, created_at: u64) -> Self {
        Self {
            format: FORMAT,
            app: env!("CARGO_PKG_VERSION").to_owned(),
            env: spec.name.clone(),
            protocol,
            seed,
            world_model: world_model.to_owned(),
            world_model_path: None,
            world_file: None,
            created_at,
            config: Config { weights: Weights::of(spec), annotator: anonymous() },
        }
    }

    /// The same in the world of this name, which is built in, or begins with weights as if it was.
    pub fn new(env: &str, protocol: Protocol, seed: u64, world_model: &str, created_at: u64) -> Self {
        Self::of(&WorldSpec::of_name(env), protocol, seed, world_model, created_at)
    }

    /// The session at its beginning.
    pub fn session(&self) -> Session {
        Session::new(self.protocol, self.config.weights.clone())
    }

    /// The name of its folder: the time of its making (UTC) and the protocol.
    ///
    /// ```
    /// use dropj::query::Protocol;
    /// use dropj::session::Header;
    ///
    /// let header = Header::new("car-racing", Protocol::Dropj, 7, "sha256:…", 1_795_342_500_000);
    /// assert_eq!(header.folder_name(), "2026-11-22T10-15-00-dropj");
    /// ```
    pub fn folder_name(&self) -> String {
        let protocol = match self.protocol {
            Protocol::Drop => "drop",
            Protocol::Drope => "drope",
            Protocol::Dropj => "dropj",
            Protocol::DropjMulti => "dropj-multi",
            Protocol::Request => "request",
            Protocol::Dros => "dros",
        };
        timed_name(self.created_at, protocol)
    }

    /// The head of the session in `dir`.
    pub fn read(dir: &Path) -> Result<Self, SessionError> {
        let path = dir.join(FILE);
        let bytes = std::fs::read(&path).map_err(SessionError::disk("read the session's header", &path))?;
        Self::parse(&bytes, &path)
    }

    /// The head in the bytes of its file, wherever it lies: a pure function, which takes whatever bytes there are.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, SessionError> {
        let wrong = |met: HeaderError| SessionError::Header { met, path: path.to_owned() };
        let text = trimmed(bytes);
        if text.iter().all(|&byte| byte == 0) {
            return Err(wrong(if text.is_empty() { HeaderError::Empty } else { HeaderError::Zeros }));
        }
        if is_utf16(text) {
            return Err(wrong(HeaderError::Utf16));
        }
        let value: serde_json::Value =
            serde_json::from_slice(text).map_err(|e| wrong(HeaderError::Json(e)))?;
        // Before anything else: another format may have other fields.
        match value.get("format").and_then(serde_json::Value::as_u64) {
            Some(found) if (1..=u64::from(FORMAT)).contains(&found) => {}
            Some(0) => return Err(wrong(HeaderError::FormatZero)),
            Some(found) => {
                return Err(SessionError::Format { found, known: FORMAT, path: path.to_owned() });
            }
            None => return Err(wrong(HeaderError::NoFormat)),
        }
        for name in ["seed", "created_at"] {
            if value.get(name).is_some_and(|number| number.as_u64().is_none()) {
                return Err(wrong(HeaderError::NotWhole(name)));
            }
        }
        let header: Self = serde_json::from_value(value).map_err(|e| wrong(HeaderError::Json(e)))?;
        check_weights(&header.config.weights).map_err(|e| wrong(HeaderError::Weights(e)))?;
        Ok(header)
    }

    pub(super) fn write(&self, dir: &Path) -> Result<(), SessionError> {
        check_weights(&self.config.weights)?;
        let mut text = serde_json::to_string_pretty(self).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        text.push('\n');
        arrays::write_whole(&dir.join(FILE), text.as_bytes(), "write the session's header")
    }
}

/// `what` behind the time (UTC) so many milliseconds after the start of 1970.
pub(super) fn timed_name(at: u64, what: &str) -> String {
    format!("{}-{what}", timestamp(at / 1000).strftime("%Y-%m-%dT%H-%M-%S"))
}

/// `2026-11-22 10:15`: the date and time, in UTC, that many seconds after the beginning of 1970.
pub fn date(secs: u64) -> String {
    timestamp(secs).strftime("%Y-%m-%d %H:%M").to_string()
}

/// The moment so many seconds after the start of 1970; the last of the year 9999 for what lies behind it.
fn timestamp(secs: u64) -> Timestamp {
    let secs = i64::try_from(secs).ok();
    secs.and_then(|secs| Timestamp::from_second(secs).ok()).unwrap_or(Timestamp::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    // python3 -c "from datetime import *; [print(datetime.fromtimestamp(s, UTC)) for s in (0, 951782400, 1795342500, …)]"
    #[test]
    fn seconds_become_dates() {
        assert_eq!(date(0), "1970-01-01 00:00");
        assert_eq!(date(951_782_400), "2000-02-29 00:00");
        assert_eq!(date(1_795_342_500), "2026-11-22 10:15");
        assert_eq!(date(1_798_761_599), "2026-12-31 23:59");
        assert_eq!(date(1_798_761_600), "2027-01-01 00:00");
        assert_eq!(timed_name(1_798_761_599_999, "dropj"), "2026-12-31T23-59-59-dropj");
        // A header can hold any number.
        assert_eq!(date(u64::MAX), date(1 << 50));
    }

    #[test]
    fn the_header_looks_as_it_always_did() {
        let header = Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 0);
        let text = serde_json::to_string(&Header { app: "0.1.0".to_owned(), ..header }).unwrap();
        insta::assert_snapshot!(text, @r#"{"format":3,"app":"0.1.0","env":"car-racing","protocol":"dropj","seed":7,"world_model":"sha256:00","created_at":0,"config":{"weights":{"safety":1.0,"default":0.75,"justifications":[["grass",1.0],["default",0.75]]},"annotator":"anonymous"}}"#);
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_header_or_an_error(bytes in any::<Vec<u8>>()) {
            drop(Header::parse(&bytes, Path::new("session.json")));
        }
    }

    #[test]
    fn a_mark_of_the_encoding_and_spaces_mean_nothing() {
        let header = Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 0);
        let text = format!("\u{feff}\r\n{}\r\n \n", serde_json::to_string(&header).unwrap());
        assert_eq!(Header::parse(text.as_bytes(), Path::new("")).unwrap(), header);
    }

    #[test]
    fn what_a_crash_or_a_hand_leaves_is_one_clear_sentence() {
        let whole =
            serde_json::to_string(&Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 0)).unwrap();
        for (text, wanted) in [
            (String::new(), "it is empty"),
            ("\0".repeat(544), "there is nothing but zeros in it"),
            (
                whole.replace("\"seed\":7", "\"seed\":18446744073709551616"),
                "its \"seed\" is not a whole number from 0 to",
            ),
            (whole.replace("\"format\":3", "\"format\":0"), "it is of format 0, and the first one is 1"),
            (whole.replace("\"format\":3,", ""), "it has no number \"format\""),
            (whole.replace("1.0", "0.5"), "above 0.5"),
        ] {
            let refused = Header::parse(text.as_bytes(), Path::new("session.json")).unwrap_err().to_string();
            assert!(refused.contains(wanted), "{refused}");
        }
    }

    #[test]
    fn another_format_is_named_before_its_fields() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(FILE), r#"{"format": 9, "dreamer": "me"}"#).unwrap();
        let refused = Header::read(dir.path()).unwrap_err().to_string();
        assert!(
            refused.starts_with("this is a session of format 9, and this program reads formats up to 3"),
            "{refused}"
        );
        std::fs::write(dir.path().join(FILE), r#"{"format": 1, "dreamer": "me"}"#).unwrap();
        let refused = Header::read(dir.path()).unwrap_err().to_string();
        assert!(refused.contains("unknown field `dreamer`"), "{refused}");
    }
}
