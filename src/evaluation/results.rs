//! Results of driven episodes as they come in files: what is whole is read, and what was not is said.

use serde_json::{Map, Value};

use crate::evaluation::{EpisodeMetrics, EventFigure};
use crate::text::{decoded, objects_in, shown};
use crate::world::Count;

/// No return, no number of steps and no time is larger than this. What is, is no measurement.
const MOST: f64 = 1e9;
/// So many notes are told one by one.
const MOST_NOTES: usize = 5;

/// What an episode begins with as it is printed.
const BEGINNINGS: [&[u8]; 2] = [b"{\"metrics\"", b"{\"track\""];

/// What a file of results holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Results {
    /// The episodes, in order. A figure that is no number is NaN or nothing.
    pub episodes: Vec<EpisodeMetrics>,
    /// The seed of each, where it is told.
    pub tracks: Vec<Option<u64>>,
    /// What was passed over, in sentences.
    pub notes: Vec<String>,
}

impl Results {
    /// What the bytes of a file hold, as `dropj deploy --json` prints it or as a hand or another program left it: a pure
    /// function, which takes whatever bytes there are.
    ///
    /// Objects may stand one a line, over several lines or in a list. UTF-8 and UTF-16 are read. Fields of a later
    /// program are passed over.
    ///
    /// ```
    /// use dropj::evaluation::Results;
    ///
    /// let line = r#"{"track": 3, "metrics": {"ret": 812.5, "new_tile_rate": 0.3, "grass_rate": 0.0, "n_steps": 1000}}"#;
    /// let found = Results::parse(format!("{line}\n{{\"track\": 4, \"metr").as_bytes());
    /// assert_eq!(found.episodes.len(), 1);
    /// assert_eq!(found.notes, ["its last line is cut short and passed over"]);
    /// ```
    pub fn parse(bytes: &[u8]) -> Self {
        let text = decoded(bytes);
        let mut reading = Reading::default();
        let whole: Result<Vec<Value>, _> = serde_json::Deserializer::from_str(&text).into_iter().collect();
        match whole {
            Ok(values) => values.into_iter().for_each(|value| reading.take(value)),
            Err(_) => reading.take_lines(&text),
        }
        reading.results()
    }
}

/// Results that are being read.
#[derive(Default)]
struct Reading {
    results: Results,
    /// The episodes as they were told, to know one that stands there twice.
    met: Vec<Value>,
    n_twice: usize,
    /// Lines that are no results: the first of them, and how many.
    others: Option<(String, usize)>,
    has_summary: bool,
}

impl Reading {
    fn take_lines(&mut self, text: &str) {
        let lines: Vec<_> = text.lines().filter(|line| !is_blank(line)).collect();
        for (i, line) in lines.iter().enumerate() {
            // A mark of the encoding stands between files that were put together.
            let line = line.trim_matches(['\u{feff}', '\0', ' ', '\t', '\r']);
            let met = match serde_json::from_str(line) {
                Ok(value) => {
                    self.take(value);
                    continue;
                }
                Err(met) => met,
            };
            let (mut rest, mut from) = (String::new(), 0);
            for (range, value) in objects_in(line.as_bytes(), &BEGINNINGS) {
                rest.push_str(&line[from..range.start]);
                from = range.end;
                self.take(value);
            }
            rest.push_str(&line[from..]);
            if rest == line && met.is_eof() && i + 1 == lines.len() {
                self.results.notes.push("its last line is cut short and passed over".to_owned());
            } else if !is_blank(&rest) {
                self.pass_over(&rest);
            }
        }
    }

    fn pass_over(&mut self, line: &str) {
        self.others.get_or_insert_with(|| (shown(line), 0)).1 += 1;
    }

    fn take(&mut self, value: Value) {
        match value {
            Value::Array(values) => values.into_iter().for_each(|value| self.take(value)),
            Value::Object(object) if object.contains_key("metrics") => self.take_episode(object),
            Value::Object(object) if object.contains_key("summary") => self.has_summary = true,
            other => self.pass_over(&other.to_string()),
        }
    }

    fn take_episode(&mut self, object: Map<String, Value>) {
        let Some(Value::Object(metrics)) = object.get("metrics") else {
            return self.pass_over(&Value::Object(object).to_string());
        };
        let name = match object.get("track") {
            Some(track) => format!("track {}", shown(&track.to_string())),
            None => format!("episode {}", self.met.len() + 1),
        };
        let mut wrong = Vec::new();
        let mut figure = |name: &str, least: f64, most: f64| {
            let met = metrics.get(name)?;
            let number = met.as_f64().filter(|number| (least..=most).contains(number));
            if number.is_none() && !met.is_null() {
                wrong.push(format!("{name} is {}", shown(&met.to_string())));
            }
            number.map(|number| number as f32)
        };
        let ret = figure("ret", -MOST, MOST);
        let unsafe_rate = figure("unsafe_rate", 0.0, 1.0);
        let keys = metrics.keys().filter(|key| *key != "unsafe_rate");
        let mut events: Vec<EventFigure> = keys.filter_map(|key| EventFigure::of_key(key)).collect();
        for event in &mut events {
            let most = if event.count == Count::FirstTouch { MOST } else { 1.0 };
            event.value = figure(&event.key(), 0.0, most);
        }
        let n_steps = figure("n_steps", 0.0, MOST);
        let [plan_ms_mean, plan_ms_max] = ["plan_ms_mean", "plan_ms_max"].map(|name| figure(name, 0.0, MOST));
        let finished = metrics.get("finished").and_then(Value::as_bool).unwrap_or_default();
        if metrics.get("ret").is_none_or(Value::is_null) {
            wrong.push("ret is missing".to_owned());
        }
        if !wrong.is_empty() {
            self.results.notes.push(format!("{name}: {}, and left out", wrong.join(", ")));
        }
        let track = object.get("track").and_then(Value::as_u64);
        let value = Value::Object(object);
        if self.met.contains(&value) {
            self.n_twice += 1;
            return;
        }
        self.met.push(value);
        self.results.tracks.push(track);
        self.results.episodes.push(EpisodeMetrics {
            ret: ret.unwrap_or(f32::NAN),
            // Older programs did not tell it.
            unsafe_rate: unsafe_rate.unwrap_or(f32::NAN),
            events,
            n_steps: n_steps.unwrap_or_default() as usize,
            finished,
            plan_ms_mean,
            plan_ms_max,
        });
    }

    fn results(self) -> Results {
        let Self { mut results, n_twice, others, has_summary, .. } = self;
        let n_more = results.notes.len().saturating_sub(MOST_NOTES);
        results.notes.truncate(MOST_NOTES);
        if n_more > 0 {
            results.notes.push(format!("and {n_more} more of the kind"));
        }
        if let Some((first, n)) = others {
            let lines = if n == 1 {
                "1 piece that is no result is"
            } else {
                &format!("{n} pieces that are no results are")
            };
            results.notes.push(format!("{lines} passed over: {first}"));
        }
        if n_twice > 0 {
            results.notes.push(format!("{n_twice} of its episodes stand there twice and count once"));
        }
        if results.episodes.is_empty() && has_summary {
            results.notes.push("there is only the summary of episodes in it".to_owned());
        }
        results
    }
}

fn is_blank(line: &str) -> bool {
    line.trim_matches(['\u{feff}', '\0']).trim().is_empty()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn line(track: u32, ret: &str) -> String {
        format!(
            r#"{{"metrics": {{"car_rate": null, "chuckhole_rate": null, "finished": true, "grass_rate": 0.25, "n_steps": 1000, "new_tile_rate": 0.5, "plan_ms_max": 1.5, "plan_ms_mean": 1.0, "ret": {ret}}}, "track": {track}}}"#
        )
    }

    fn three() -> String {
        [line(0, "1"), line(1, "2"), line(2, "3")].join("\n")
    }

    fn returns(found: &Results) -> Vec<f32> {
        found.episodes.iter().map(|episode| episode.ret).collect()
    }

    #[test]
    fn results_are_read_however_they_are_stored() {
        let text = three();
        let list = format!("[{}]", text.replace('\n', ","));
        let utf16 = |text: &str| {
            [0xff, 0xfe].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect()
        };
        let spread = text.replace("{\"metrics\"", "{\n\"metrics\"");
        let marked = format!("\u{feff}{}\n\n", text.replace('\n', "\r\n"));
        let later = text.replace("\"ret\"", "\"new\": 1, \"ret\"");
        let all: [Vec<u8>; 7] = [
            text.clone().into(),
            list.into(),
            utf16(&text),
            spread.into(),
            marked.into(),
            later.into(),
            format!("{text}\n{{\"summary\":{{}}}}").into(),
        ];
        for bytes in all {
            let found = Results::parse(&bytes);
            assert_eq!((returns(&found), found.notes), (vec![1.0, 2.0, 3.0], vec![]), "{}", decoded(&bytes));
        }
    }

    #[test]
    fn what_is_not_whole_is_passed_over_and_said() {
        let torn = format!("track 0: return 5\n{}\n\u{feff}{}", three(), &line(3, "4")[..30]);
        let found = Results::parse(torn.as_bytes());
        assert_eq!(returns(&found), [1.0, 2.0, 3.0]);
        assert_eq!(
            found.notes,
            [
                "its last line is cut short and passed over",
                "1 piece that is no result is passed over: track 0: return 5"
            ]
        );
        let twice = format!("{}\n{}", three(), three());
        let found = Results::parse(twice.as_bytes());
        assert_eq!((found.episodes.len(), found.notes.len()), (3, 1), "{:?}", found.notes);
        assert_eq!(
            Results::parse(b"{\"summary\":{}}").notes,
            ["there is only the summary of episodes in it"]
        );
        assert_eq!(Results::parse(b""), Results::default());
    }

    #[test]
    fn a_figure_that_is_no_measurement_is_left_out_and_the_others_stay() {
        for (ret, said) in [
            ("null", "track 7: ret is missing, and left out"),
            ("1e39", "track 7: ret is 1e39, and left out"),
            ("\"NaN\"", "track 7: ret is \"NaN\", and left out"),
        ] {
            let found = Results::parse(line(7, ret).as_bytes());
            assert!(
                found.episodes[0].ret.is_nan() && found.episodes[0].event("grass") == Some(0.25),
                "{found:?}"
            );
            assert_eq!(found.notes[0].replace("1e+39", "1e39"), said);
        }
        let found = Results::parse(line(7, "5").replace("0.25", "-3").as_bytes());
        assert_eq!(found.notes, ["track 7: grass_rate is -3, and left out"]);
        let found = Results::parse(line(7, "NaN").as_bytes());
        assert_eq!((found.episodes.len(), found.notes.len()), (0, 1), "that is no JSON: {found:?}");
    }

    proptest! {
        #[test]
        fn any_bytes_are_results_or_none(bytes in any::<Vec<u8>>()) {
            drop(Results::parse(&bytes));
        }

        #[test]
        fn damage_anywhere_never_changes_what_else_is_read(at in any::<prop::sample::Index>(), byte in any::<u8>()) {
            let mut bytes = three().into_bytes();
            let at = at.index(bytes.len());
            bytes[at] = byte;
            // At the very beginning it may be the mark of another encoding.
            prop_assert!(Results::parse(&bytes).episodes.len() >= 2 || at < 4);
        }
    }
}
