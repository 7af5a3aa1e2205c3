//! Who may enter: a token for each annotator, kept in a file that nobody else reads, so that links last.
//!
//! Tokens are kept rather than derived: whoever wants to shut somebody out removes a line.

use std::collections::BTreeMap;
use std::path::Path;

use rand::Rng;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::run::{read_at_most, write_private};
use crate::serve::ServeError;

/// The file in a session's folder, where no other is named.
pub const TOKENS_FILE: &str = "annotators.toml";
/// Bytes of such a file at the most.
const MOST: u64 = 1 << 20;
/// Random bytes of a token.
const N_BYTES: usize = 16;
/// Characters of a token that somebody chose, at the least.
const SHORTEST: usize = 16;
/// Above everything in the file.
const HEAD: &str = "# Whoever has a token answers in that name: keep this to yourself. A line that is removed shuts somebody out.\n";

/// The tokens of annotators, and the port that their links name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tokens {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) port: Option<u16>,
    #[serde(default)]
    pub(super) tokens: BTreeMap<String, String>,
}

impl Tokens {
    /// What the file at `path` says; nothing yet, where there is none.
    pub(super) fn read(path: &Path) -> Result<Self, ServeError> {
        let wrong = |why: String| ServeError::Tokens { why, path: path.to_owned() };
        let bytes = match read_at_most(path, MOST) {
            Err(met) if met.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            read => read.map_err(|met| wrong(met.to_string()))?,
        };
        let bytes = bytes.ok_or_else(|| wrong(format!("it has more than {MOST} bytes")))?;
        let text = crate::text::decoded(&bytes);
        let read: Self = toml::from_str(&text).map_err(|met| wrong(met.message().to_owned()))?;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        for (name, token) in &read.tokens {
            if token.len() < SHORTEST || token.len() > 256 || !token.chars().all(is_plain) {
                let why =
                    format!("the token of {name:?} is not of {SHORTEST} to 256 letters, digits, - and _");
                return Err(wrong(why));
            }
            if read.tokens.iter().any(|(other, same)| other != name && same == token) {
                return Err(wrong(format!("{name:?} has the same token as another")));
            }
        }
        Ok(read)
    }

    /// Gives those of `names` a token that have none.
    pub(super) fn complete(&mut self, names: &[String], rng: &mut impl Rng) {
        for name in names {
            self.tokens.entry(name.clone()).or_insert_with(|| {
                let mut bytes = [0; N_BYTES];
                rng.fill_bytes(&mut bytes);
                hex(&bytes)
            });
        }
    }

    /// Writes the file.
    pub(super) fn write(&self, path: &Path) -> Result<(), ServeError> {
        let text = toml::to_string(self).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        Ok(write_private(path, format!("{HEAD}{text}").as_bytes())?)
    }
}

/// Bytes as hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

/// The tokens as they are compared: by their hashes, all of them, and each to its end, so that the time it takes tells
/// nothing.
#[derive(Debug)]
pub(super) struct Doorkeeper(Vec<[u8; 32]>);

impl Doorkeeper {
    pub(super) fn new<'a>(tokens: impl Iterator<Item = &'a str>) -> Self {
        Self(tokens.map(|token| Sha256::digest(token).into()).collect())
    }

    /// Whose token this is, by its place in the list.
    pub(super) fn who(&self, token: &str) -> Option<usize> {
        let told: [u8; 32] = Sha256::digest(token).into();
        let mut found = None;
        for (i, known) in self.0.iter().enumerate() {
            let differs = known.iter().zip(&told).fold(0, |all, (a, b)| all | (a ^ b));
            found = if std::hint::black_box(differs) == 0 { Some(i) } else { found };
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn tokens_last_and_only_who_is_new_gets_one() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("annotators.toml");
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mut first = Tokens { port: Some(4000), ..Tokens::read(&path).unwrap() };
        first.complete(&names(&["anna", "Ben \"B\" = x\n"]), rng);
        first.write(&path).unwrap();
        let mut again = Tokens::read(&path).unwrap();
        assert_eq!(again, first);
        again.complete(&names(&["anna", "cleo"]), rng);
        assert_eq!((again.tokens.len(), &again.tokens["anna"]), (3, &first.tokens["anna"]));
        assert!(again.tokens.values().all(|token| token.len() == 32), "{again:?}");
    }

    #[test]
    fn a_file_that_somebody_wrote_is_refused_in_a_sentence() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("annotators.toml");
        let same = "x".repeat(20);
        for (text, word) in [
            ("tokens = 3".to_owned(), "invalid type"),
            ("[tokens]\nanna = \"short\"".to_owned(), "anna"),
            ("[tokens]\nanna = \"with spaces in it, too\"".to_owned(), "anna"),
            (format!("[tokens]\nanna = \"{same}\"\nben = \"{same}\""), "same token"),
            ("words = 1".to_owned(), "words"),
        ] {
            write_private(&path, text.as_bytes()).unwrap();
            let refused = Tokens::read(&path).unwrap_err().to_string();
            assert!(refused.contains(word) && refused.contains("annotators.toml"), "{text}: {refused}");
        }
    }

    #[test]
    fn a_token_is_known_whole_or_not_at_all() {
        let keeper = Doorkeeper::new(["0123456789abcdef", "fedcba9876543210"].into_iter());
        assert_eq!(keeper.who("fedcba9876543210"), Some(1));
        for wrong in ["", "fedcba987654321", "fedcba98765432100", "FEDCBA9876543210"] {
            assert_eq!(keeper.who(wrong), None, "{wrong:?}");
        }
    }
}
