//! What is done to a file.

use proptest::prelude::*;

/// What is put where a number or anything else stood.
const TOKENS: [&[u8]; 34] = [
    b"-1",
    b"0",
    b"1",
    b"2",
    b"3",
    b"17",
    b"255",
    b"256",
    b"65536",
    b"1000000",
    b"2147483648",
    b"4294967295",
    b"4294967296",
    b"9223372036854775807",
    b"18446744073709551615",
    b"18446744073709551616",
    b"-9223372036854775808",
    b"1e999",
    b"-1e999",
    b"3e38",
    b"1e-320",
    b"NaN",
    b"0.5",
    b"null",
    b"true",
    b"\"\"",
    b"[]",
    b"{}",
    b"[[]]",
    b"\n",
    b"\"../../x\"",
    b"\xef\xbb\xbf",
    b"\x00\x00\x00\x00",
    b"\xff\xff\xff\xff\xff\xff\xff\x7f",
];

/// One change; places are shares of the length, so that a shrunk input still means something.
#[derive(Clone, Debug)]
pub(crate) enum Mutation {
    /// One bit.
    Flip(u32, u8),
    /// One byte.
    Set(u32, u8),
    /// Everything from here on is gone.
    Cut(u32),
    /// So many bytes are gone.
    Remove(u32, u8),
    /// So many bytes come again.
    Repeat(u32, u8),
    /// A piece of another file, or of this one, from there.
    Splice(u32, usize, u32, u16),
    /// A token is put in.
    Insert(u32, usize),
    /// The number in the text that stands nearest behind becomes a token.
    Number(u32, usize),
    /// Its digits become others, as many as they were: lengths around it stay true.
    Digits(u32, u64),
    /// So many bytes become not-a-number, infinity or the largest `f32`.
    Float(u32, u8),
}

/// A few of them; more than one is needed where a size stands in two places.
pub(crate) fn mutations() -> impl Strategy<Value = Vec<Mutation>> {
    let at = any::<u32>;
    let token = || 0..TOKENS.len();
    let one = prop_oneof![
        2 => (at(), 0u8..8).prop_map(|(at, bit)| Mutation::Flip(at, bit)),
        2 => (at(), any::<u8>()).prop_map(|(at, byte)| Mutation::Set(at, byte)),
        1 => at().prop_map(Mutation::Cut),
        1 => (at(), any::<u8>()).prop_map(|(at, n)| Mutation::Remove(at, n)),
        1 => (at(), any::<u8>()).prop_map(|(at, n)| Mutation::Repeat(at, n)),
        1 => (at(), 0usize..8, at(), any::<u16>()).prop_map(|(at, of, from, n)| Mutation::Splice(at, of, from, n)),
        2 => (at(), token()).prop_map(|(at, token)| Mutation::Insert(at, token)),
        5 => (at(), token()).prop_map(|(at, token)| Mutation::Number(at, token)),
        3 => (at(), any::<u64>()).prop_map(|(at, digits)| Mutation::Digits(at, digits)),
        1 => (at(), 0u8..3).prop_map(|(at, which)| Mutation::Float(at, which)),
    ];
    prop::collection::vec(one, 1..6)
}

impl Mutation {
    /// Changes `bytes`; `corpus` is where pieces of other files come from.
    pub(crate) fn apply(&self, bytes: &mut Vec<u8>, corpus: &[Vec<u8>]) {
        if bytes.is_empty() {
            return;
        }
        let place = |at: u32, len: usize| (at as usize * len) >> 32;
        let n = bytes.len();
        match *self {
            Self::Flip(at, bit) => bytes[place(at, n)] ^= 1 << bit,
            Self::Set(at, byte) => bytes[place(at, n)] = byte,
            Self::Cut(at) => bytes.truncate(place(at, n)),
            Self::Remove(at, len) => {
                let from = place(at, n);
                bytes.drain(from..(from + len as usize).min(n));
            }
            Self::Repeat(at, len) => {
                let from = place(at, n);
                let piece = bytes[from..(from + len as usize).min(n)].to_vec();
                bytes.splice(from..from, piece);
            }
            Self::Splice(at, of, from, len) => {
                let other = &corpus[of % corpus.len()];
                let from = place(from, other.len());
                let piece = other[from..(from + len as usize).min(other.len())].to_vec();
                let at = place(at, n);
                bytes.splice(at..at, piece);
            }
            Self::Insert(at, token) => {
                let at = place(at, n);
                bytes.splice(at..at, TOKENS[token].iter().copied());
            }
            Self::Number(at, token) => {
                if let Some(number) = number_behind(bytes, place(at, n)) {
                    bytes.splice(number, TOKENS[token].iter().copied());
                }
            }
            Self::Digits(at, mut digits) => {
                let Some(number) = number_behind(bytes, place(at, n)) else { return };
                for byte in &mut bytes[number] {
                    if byte.is_ascii_digit() {
                        *byte = b'0' + (digits % 10) as u8;
                        digits /= 10;
                    }
                }
            }
            Self::Float(at, which) => {
                let from = place(at, n) & !3;
                let value = [f32::NAN, f32::INFINITY, f32::MAX][which as usize].to_le_bytes();
                let to = (from + 4).min(n);
                bytes[from..to].copy_from_slice(&value[..to - from]);
            }
        }
    }
}

/// The first number in the text of `bytes` from `at` on, or else from the beginning.
fn number_behind(bytes: &[u8], at: usize) -> Option<std::ops::Range<usize>> {
    let is_part = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
    let first = |from: usize| Some(from + bytes[from..].iter().position(u8::is_ascii_digit)?);
    let start = first(at).or_else(|| first(0))?;
    let end = bytes[start..].iter().position(|byte| !is_part(byte)).map_or(bytes.len(), |len| start + len);
    Some(start..end)
}

/// Makes the first eight bytes of safetensors the length of the header that is there.
pub(crate) fn mend_safetensors(bytes: &mut [u8]) {
    if bytes.len() < 9 {
        return;
    }
    // The header is one JSON object: it ends where its braces are closed.
    let (mut depth, mut is_text, mut is_escaped) = (0i32, false, false);
    let end = bytes[8..].iter().position(|&byte| {
        match byte {
            _ if is_escaped => is_escaped = false,
            b'\\' if is_text => is_escaped = true,
            b'"' => is_text = !is_text,
            b'{' if !is_text => depth += 1,
            b'}' if !is_text => depth -= 1,
            _ => {}
        }
        byte == b'}' && !is_text && depth == 0
    });
    if let Some(end) = end {
        bytes[..8].copy_from_slice(&(end as u64 + 1).to_le_bytes());
    }
}

/// Makes the checksum in the footer of an episode's table the one of the bytes before it.
pub(crate) fn mend_parquet(bytes: &mut [u8]) {
    let key = b"dropj.sha256";
    let Some(at) = bytes.windows(key.len()).rposition(|window| window == key) else { return };
    // What follows the key: type and length of the text, the number of bytes, a space, 64 digits.
    let Some(space) = bytes[at..].iter().position(|&byte| byte == b' ').map(|space| at + space) else {
        return;
    };
    let digits = bytes[..space].iter().rev().take_while(|byte| byte.is_ascii_digit()).count();
    let n =
        std::str::from_utf8(&bytes[space - digits..space]).ok().and_then(|text| text.parse::<usize>().ok());
    let Some(n) = n.filter(|n| *n <= bytes.len() && bytes.len() >= space + 65) else { return };
    let hash = dropj::tensor::sha256(&bytes[..n]);
    bytes[space + 1..space + 65].copy_from_slice(hash.trim_start_matches("sha256:").as_bytes());
}
