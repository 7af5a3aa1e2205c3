//! The answer files that the authors released: pickles of lists, maps, text and numbers. No code in them is ever run.
//!
//! ```text
//! [{ "video": name of a file, "responses": "Skipped" or [(question, answer, seconds), …],
//!    "repeat_count": times it was played again, "total_time": seconds }, …]
//! ```

use serde_pickle::{DeOptions, HashableValue, Value};

use crate::query::Protocol;

/// Bytes of such a file; the authors' have some hundred thousand.
pub const MOST: u64 = 64 << 20;

/// An answer as it was recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedAnswer {
    /// The file of its clips.
    pub video: String,
    /// Seconds that it took.
    pub secs: f64,
    /// How often the clips were played again.
    pub n_repeats: u64,
    /// Whether it was skipped.
    pub is_skipped: bool,
}

/// Why a file holds no answers.
#[derive(Debug, thiserror::Error)]
pub enum ResponsesError {
    /// It is no pickle, or holds more than lists, maps, text and numbers.
    #[error("it is no pickle of plain lists, maps, text and numbers, and nothing else is read: {0}")]
    Pickle(String),
    /// A record is none.
    #[error("its record {number} has no {missing:?} as released files have it")]
    Record {
        /// Which, from 0.
        number: usize,
        /// What it lacks.
        missing: &'static str,
    },
    /// It is no list.
    #[error("it holds no list of records")]
    NoList,
}

/// The answers in the bytes of a released file.
///
/// # Errors
/// Where they are none.
pub fn read_responses(bytes: &[u8]) -> Result<Vec<RecordedAnswer>, ResponsesError> {
    let options = DeOptions::new().decode_strings();
    let value = serde_pickle::value_from_slice(bytes, options);
    let value = value.map_err(|met| ResponsesError::Pickle(met.to_string()))?;
    let Value::List(records) = value else { return Err(ResponsesError::NoList) };
    records.into_iter().enumerate().map(|(number, record)| recorded(number, &record)).collect()
}

fn recorded(number: usize, record: &Value) -> Result<RecordedAnswer, ResponsesError> {
    let missing = |missing| ResponsesError::Record { number, missing };
    let Value::Dict(fields) = record else { return Err(missing("total_time")) };
    let field =
        |name: &'static str| fields.get(&HashableValue::String(name.to_owned())).ok_or_else(|| missing(name));
    let secs = match field("total_time")? {
        Value::F64(secs) => *secs,
        Value::I64(secs) => *secs as f64,
        _ => return Err(missing("total_time")),
    };
    let Value::String(video) = field("video")? else { return Err(missing("video")) };
    let n_repeats = match field("repeat_count")? {
        Value::I64(n) => u64::try_from(*n).unwrap_or(0),
        _ => return Err(missing("repeat_count")),
    };
    let is_skipped = match field("responses")? {
        Value::String(said) => said == "Skipped",
        Value::List(_) | Value::Tuple(_) => false,
        _ => return Err(missing("responses")),
    };
    Ok(RecordedAnswer { video: video.clone(), secs, n_repeats, is_skipped })
}

/// What was asked, by the mode in the name of a released file.
///
/// ```
/// use dropj::query::Protocol;
/// use dropj::session::protocol_of_released;
///
/// assert_eq!(protocol_of_released("responses_27_nojust_eq_1699.pkl"), Some(Protocol::Drope));
/// assert_eq!(protocol_of_released("responses_27_just_1699.pkl"), Some(Protocol::Dropj));
/// assert_eq!(protocol_of_released("answers.pkl"), None);
/// ```
pub fn protocol_of_released(name: &str) -> Option<Protocol> {
    let has = |mode: &str| name.split(['_', '.', '-']).any(|part| part == mode);
    if has("mjust") {
        Some(Protocol::DropjMulti)
    } else if has("nojust") {
        Some(if has("noeq") { Protocol::Drop } else { Protocol::Drope })
    } else {
        has("just").then_some(Protocol::Dropj)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // >>> pickle.dumps([{"video": "0.mp4", "responses": [("Is left safe?", "Yes", 5.5)], "repeat_count": 2, "total_time": 7.25},
    // ...               {"video": "1.mp4", "responses": "Skipped", "repeat_count": 0, "total_time": 3}], protocol)
    const PROTOCOL_4: &str = "80049592000000000000005d94287d94288c05766964656f948c05302e6d7034948c09726573706f6e736573945d948c0d4973206c65667420736166653f948c03596573944740160000000000008794618c0c7265706561745f636f756e74944b028c0a746f74616c5f74696d659447401d000000000000757d942868028c05312e6d70349468048c07536b69707065649468094b00680a4b0375652e";
    const PROTOCOL_2: &str = "80025d7100287d7101285805000000766964656f71025805000000302e6d703471035809000000726573706f6e73657371045d7105580d0000004973206c65667420736166653f71065803000000596573710747401600000000000087710861580c0000007265706561745f636f756e7471094b02580a000000746f74616c5f74696d65710a47401d000000000000757d710b2868025805000000312e6d7034710c68045807000000536b6970706564710d68094b00680a4b0375652e";
    // >>> pickle.dumps([os.system]): a function by its name
    const WITH_CODE: &str = "80049517000000000000005d948c05706f736978948c0673797374656d949394612e";

    fn bytes(hex: &str) -> Vec<u8> {
        (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap()).collect()
    }

    #[test]
    fn released_answers_are_read_whatever_the_protocol_of_the_pickle() {
        for hex in [PROTOCOL_4, PROTOCOL_2] {
            let found = read_responses(&bytes(hex)).unwrap();
            let told: Vec<_> =
                found.iter().map(|it| (&*it.video, it.secs, it.n_repeats, it.is_skipped)).collect();
            assert_eq!(told, [("0.mp4", 7.25, 2, false), ("1.mp4", 3.0, 0, true)]);
        }
    }

    #[test]
    fn what_is_more_than_plain_values_is_refused_and_no_damage_panics() {
        let met = read_responses(&bytes(WITH_CODE)).unwrap_err().to_string();
        assert!(met.contains("nothing else is read"), "{met}");
        let whole = bytes(PROTOCOL_4);
        for n in 0..whole.len() {
            assert!(read_responses(&whole[..n]).is_err(), "cut after {n} bytes");
            let mut damaged = whole.clone();
            damaged[n] ^= 0x55;
            drop(read_responses(&damaged));
        }
        assert!(read_responses(b"").is_err() && read_responses(b"N.").is_err());
    }
}
