//! What a world tells of a step becomes events.

use serde_json::{Map, Value};

use super::{Count, EventSpec, When};

/// Whether an event happened in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Happened {
    /// It did, and is counted: in every step in which it goes on, or only when it begins, as its [`Count`] says.
    pub happened: bool,
    /// It goes on at this moment, whether that is counted or not.
    pub goes_on: bool,
    /// One more was passed, for events that are counted as a share of those.
    pub passed: bool,
}

/// Reads the events of steps, one after the other.
///
/// A field that is not told in a step, or is `null`, says that nothing happens.
#[derive(Clone, Debug)]
pub struct EventReader {
    events: Vec<EventSpec>,
    before: Vec<Before>,
}

/// What the step before said of an event.
#[derive(Clone, Copy, Debug, Default)]
struct Before {
    goes_on: bool,
    value: Option<f64>,
    passed: Option<f64>,
}

impl EventReader {
    /// For these events.
    pub fn new(events: &[EventSpec]) -> Self {
        Self { events: events.to_vec(), before: vec![Before::default(); events.len()] }
    }

    /// Begins an episode in which `fields` are told of the first moment: what goes on there does not begin later.
    pub fn begin(&mut self, fields: &Map<String, Value>) {
        self.before.fill(Before::default());
        self.read(fields);
    }

    /// The events of the next step, of which `fields` are told.
    pub fn read(&mut self, fields: &Map<String, Value>) -> Vec<Happened> {
        self.events.iter().zip(&mut self.before).map(|(event, before)| before.read(event, fields)).collect()
    }
}

impl Before {
    fn read(&mut self, event: &EventSpec, fields: &Map<String, Value>) -> Happened {
        let value = field_value(fields, &event.field);
        let goes_on = value.is_some_and(|value| match event.when {
            When::True => value != 0.0,
            When::False => value == 0.0,
            When::Grows => self.value.is_some_and(|before| value > before),
            When::Above(limit) => value > limit,
            When::Below(limit) => value < limit,
        });
        // What grows twice in a row has begun twice.
        let begins = goes_on && (!self.goes_on || event.when == When::Grows);
        let passed = event.passed.as_ref().and_then(|field| field_value(fields, field));
        let is_passed = passed.is_some_and(|value| value != 0.0 && self.passed.unwrap_or_default() < value);
        // A counter may be silent for a step.
        *self = Self { goes_on, value: value.or(self.value), passed };
        let happened = if event.count == Count::PerStep { goes_on } else { begins };
        Happened { happened, goes_on, passed: is_passed }
    }
}

/// The number in a field, if there is one; true is 1 and false is 0.
pub fn field_value(fields: &Map<String, Value>, name: &str) -> Option<f64> {
    match fields.get(name)? {
        Value::Bool(value) => Some(f64::from(u8::from(*value))),
        Value::Number(number) => number.as_f64(),
        _ => None,
    }
}

/// The name of an event as a part of the name of a column or figure: small letters, digits and single underscores.
///
/// ```
/// assert_eq!(dropj::world::event_slug("New  tile!"), "new_tile");
/// ```
pub fn event_slug(name: &str) -> String {
    let parts = name.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty());
    parts.map(str::to_lowercase).collect::<Vec<_>>().join("_")
}
