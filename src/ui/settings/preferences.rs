//! What a person likes, whatever the session: it outlasts the window.
//!
//! It is read field by field. What is unknown or absurd is left out, is as at first, and is said; the text that it stood
//! in is kept beside, and fields of a newer program are written back as they were.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use eframe::Storage;
use eframe::egui::{Context, Key, ThemePreference};
use serde::Serialize;
use serde::de::value::{Error, StrDeserializer};
use serde::de::{DeserializeOwned, IntoDeserializer as _};

use crate::app::label::{BREAK_MINUTES, MOST_HELD_BACK, MOST_REPEATS, NORMAL_SPEED};
use crate::app::{
    Budget, Command, Field, GuideCommand, Hint, LabelCommand, QuerySelection, State, WindowCommand,
};
use crate::ui::input::PadButton;
use crate::ui::settings::Settings;
use crate::ui::settings::gamepad::Buttons;
use crate::ui::settings::keymap::{KeyAction, Keys, MovedKeys, known_key};
use crate::ui::settings::ron::{self, Value, fields_of};
use crate::world::WorldSpec;
use crate::world::controls::{AxisControls, ControlConfig, Lever};

/// The name under which the system keeps it.
const NAME: &str = "preferences";
/// The names under which texts are kept that could not be used as they were, the first one first.
const KEPT: [&str; 9] = [
    "preferences_kept",
    "preferences_kept_2",
    "preferences_kept_3",
    "preferences_kept_4",
    "preferences_kept_5",
    "preferences_kept_6",
    "preferences_kept_7",
    "preferences_kept_8",
    "preferences_kept_9",
];

/// Bytes of a text at the most.
const LONGEST: usize = 1 << 20;
/// The slowest and the fastest clips, in frames a second.
const SPEEDS: RangeInclusive<f64> = 5.0..=100.0;
/// Letters of a name at the most.
const LONGEST_NAME: usize = 200;
/// How many queries or minutes can be set.
const BUDGETS: RangeInclusive<f64> = 1.0..=1_000_000.0;
/// A day.
const BREAKS: RangeInclusive<f64> = 0.0..=1440.0;

/// All of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Preferences {
    theme: ThemePreference,
    keys: Keys,
    /// The keys that somebody has for those of worlds' files.
    moves: MovedKeys,
    controls: ControlConfig,
    #[serde(rename = "pads")]
    buttons: Buttons,
    /// Frames a second of clips.
    clip_speed: f64,
    is_guided: bool,
    annotator: String,
    budget: Budget,
    break_minutes: u32,
    #[serde(rename = "asking")]
    selection: QuerySelection,
    is_motion_reduced: bool,
    /// The hints that were seen.
    hints: BTreeSet<Hint>,
    /// Fields that a newer program has written, and how.
    #[serde(skip)]
    unknown: Vec<(String, String)>,
}

/// A setting that could not be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Which: `controls.key_gas`.
    pub field: String,
    /// What is wrong with it.
    pub what: String,
    /// Whether it is one that this program does not know, which is written back as it was.
    pub is_unknown: bool,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.field, self.what)
    }
}

/// What was in the way when settings were read, until it is dealt with.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leftover {
    /// A text that is to be kept.
    text: Option<String>,
    /// Fields that are to be written back.
    unknown: Vec<(String, String)>,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            theme: ThemePreference::System,
            keys: Keys::default(),
            moves: MovedKeys::new(),
            controls: ControlConfig::default(),
            buttons: Buttons::default(),
            clip_speed: NORMAL_SPEED,
            is_guided: false,
            annotator: String::new(),
            budget: Budget::default(),
            break_minutes: BREAK_MINUTES,
            selection: QuerySelection::default(),
            is_motion_reduced: false,
            hints: BTreeSet::new(),
            unknown: Vec::new(),
        }
    }
}

impl Preferences {
    /// What `text` says, and what of it could not be used; that is as at first.
    pub fn read(text: &str) -> (Self, Vec<Problem>) {
        let (mut preferences, mut problems) = (Self::default(), Problems::default());
        if text.len() > LONGEST {
            problems.note("all of them", "nobody has written so much");
            return (preferences, problems.0);
        }
        let (fields, is_whole) = fields_of(text);
        let mut seen = BTreeSet::new();
        for field in fields {
            if !seen.insert(field.name.clone()) {
                problems.note(&field.name, "it is given twice, and the first counts");
                continue;
            }
            preferences.take(field, &mut problems);
        }
        if !is_whole {
            problems.note("the end", "the text is damaged, or cut short");
        }
        (preferences, problems.0)
    }

    fn take(&mut self, field: ron::Field, problems: &mut Problems) {
        let ron::Field { name, text, value } = field;
        let Some(value) = value else { return problems.note(&name, "it cannot be read") };
        match name.as_str() {
            "theme" => problems.put(&name, &mut self.theme, named(&value)),
            "keys" => self.keys = keys(&value, &mut self.moves, problems),
            "moves" => moves(&mut self.moves, &value, problems),
            "controls" => controls(&mut self.controls, &value, problems),
            "pads" => self.buttons = buttons(&value, problems),
            "clip_speed" => problems.put(&name, &mut self.clip_speed, number(&value, SPEEDS)),
            "is_guided" => problems.put(&name, &mut self.is_guided, truth(&value)),
            "annotator" => problems.put(&name, &mut self.annotator, line(&value)),
            "budget" => problems.put(&name, &mut self.budget, budget(&value)),
            "break_minutes" => {
                let minutes = whole(&value, BREAKS).map(|minutes| minutes as u32);
                problems.put(&name, &mut self.break_minutes, minutes);
            }
            "is_motion_reduced" => problems.put(&name, &mut self.is_motion_reduced, truth(&value)),
            "hints" => problems.put(&name, &mut self.hints, hints(&value)),
            "asking" => selection(&mut self.selection, &value, problems),
            _ => {
                let what = "this program does not know it, and keeps it as it is".to_owned();
                problems.0.push(Problem { field: shortened(&name), what, is_unknown: true });
                self.unknown.push((name, text));
            }
        }
    }

    /// What [`Self::read`] reads.
    pub fn text(&self) -> String {
        let mut only = Only(String::new());
        eframe::set_value(&mut only, NAME, self);
        let mut text = only.0;
        if text.pop() == Some(')') {
            for (name, value) in &self.unknown {
                text.extend([",", name, ":", value]);
            }
            text.push(')');
        }
        text
    }

    /// What is shown of it.
    pub(crate) fn of(state: &State, settings: &Settings) -> Self {
        Self {
            theme: settings.theme,
            keys: settings.keys.clone(),
            moves: settings.keys.moved().clone(),
            controls: settings.controls.clone(),
            buttons: settings.buttons.clone(),
            clip_speed: state.label.speed,
            is_guided: state.label.is_guided,
            annotator: state.field(Field::Annotator).to_owned(),
            budget: state.label.budget,
            break_minutes: state.label.break_minutes,
            selection: state.label.selection,
            is_motion_reduced: state.label.is_motion_reduced,
            hints: state.guide.seen.clone(),
            unknown: Vec::new(),
        }
    }

    /// Brings it into the window; what is the application's business is told in commands.
    fn apply(self, ctx: &Context, spec: &WorldSpec, settings: &mut Settings) -> Vec<Command> {
        ctx.set_theme(self.theme);
        (settings.theme, settings.buttons) = (self.theme, self.buttons);
        settings.keys = self.keys.in_world(spec, self.moves);
        settings.controls = self.controls.clamped();
        let label = [
            LabelCommand::Speed(self.clip_speed),
            LabelCommand::Guide(self.is_guided),
            LabelCommand::Budget(self.budget),
            LabelCommand::BreakAfter(self.break_minutes),
            LabelCommand::SelectQueries(self.selection),
            LabelCommand::ReduceMotion(self.is_motion_reduced),
        ];
        let guide = Command::Guide(GuideCommand::Teach(self.hints));
        let annotator = Command::Window(WindowCommand::Edit(Field::Annotator, self.annotator));
        label.into_iter().map(Command::Label).chain([annotator, guide]).collect()
    }
}

impl Leftover {
    /// Brings in what was liked before, told in commands, with what of it could not be used.
    pub(crate) fn load(
        &mut self,
        ctx: &Context,
        storage: Option<&dyn Storage>,
        spec: &WorldSpec,
        settings: &mut Settings,
    ) -> Vec<Command> {
        let Some(storage) = storage else { return Vec::new() };
        let Some(text) = storage.get_string(NAME) else {
            return vec![Command::Guide(GuideCommand::FirstStart)];
        };
        let (preferences, problems) = Preferences::read(&text);
        self.unknown.clone_from(&preferences.unknown);
        let kept = |name: &&str| storage.get_string(name).map(|kept| Preferences::read(&kept).0);
        let is_kept = KEPT
            .iter()
            .filter_map(kept)
            .any(|kept| preferences.unknown.iter().all(|field| kept.unknown.contains(field)));
        let mut commands = preferences.apply(ctx, spec, settings);
        // A newer program's fields are no news once they were told of.
        let is_told = is_kept && problems.iter().all(|problem| problem.is_unknown);
        if !problems.is_empty() && !is_told {
            self.text = Some(text);
            commands.push(Command::Window(WindowCommand::Fail(said(&problems))));
        }
        commands
    }

    /// Keeps what is liked now, and what could not be used before.
    pub(crate) fn save(&mut self, storage: &mut dyn Storage, state: &State, settings: &Settings) {
        if let Some(text) = self.text.take() {
            let is_free = |name: &&&str| storage.get_string(name).is_none_or(|kept| kept == text);
            let name = KEPT.iter().find(is_free).unwrap_or(&KEPT[KEPT.len() - 1]);
            storage.set_string(name, text);
        }
        let unknown = self.unknown.clone();
        storage.set_string(NAME, Preferences { unknown, ..Preferences::of(state, settings) }.text());
    }
}

/// What is told of problems: the first few, and where the old text is.
fn said(problems: &[Problem]) -> String {
    const MOST: usize = 4;
    let named: Vec<_> = problems.iter().take(MOST).map(ToString::to_string).collect();
    let more = match problems.len().saturating_sub(MOST) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let file = settings_file();
    let place = file.map_or_else(String::new, |file| format!(" in {file:?}"));
    format!(
        "some settings could not be used: {}{more}; these are as at first, and the old text is kept as {}{place}",
        named.join(", "),
        KEPT[0]
    )
}

/// A single value that is kept nowhere.
struct Only(String);

impl Storage for Only {
    fn get_string(&self, _: &str) -> Option<String> {
        Some(self.0.clone())
    }

    fn set_string(&mut self, _: &str, value: String) {
        self.0 = value;
    }

    fn remove_string(&mut self, _: &str) {}

    fn flush(&mut self) {}
}

/// The file in which the system keeps the settings, and where the window was.
pub fn settings_file() -> Option<PathBuf> {
    eframe::storage_dir(crate::ui::NAME).map(|dir| dir.join("app.ron"))
}

/// What a file of settings is good for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SettingsFile {
    /// It can be used as it is.
    Good,
    /// It could be used without what makes no sense about the window itself, as here.
    Mended(Vec<u8>),
    /// It cannot be read; the window would take it for none, and overwrite it.
    Damaged,
}

impl SettingsFile {
    /// Looks at the content of one.
    pub fn of(bytes: &[u8]) -> Self {
        let text = std::str::from_utf8(bytes).ok().map(|text| Only(text.to_owned()));
        let entries = text.and_then(|only| eframe::get_value::<BTreeMap<String, String>>(&only, NAME));
        let Some(mut entries) = entries else { return Self::Damaged };
        let n = entries.len();
        entries.retain(|name, text| match name.as_str() {
            // What these say is used before there is a window, and a scale that makes no sense is the end of it.
            "egui" => has_sense(text, &["options", "zoom_factor"], ZOOMS),
            "window" => {
                let is_good = |axis| has_sense(text, &["normal_geometry", "inner_size_points", axis], SIZES);
                is_good("x") && is_good("y") && has_sense(text, &["normal_geometry", "scale_factor"], SCALES)
            }
            _ => true,
        });
        if entries.len() == n {
            return Self::Good;
        }
        let mut only = Only(String::new());
        eframe::set_value(&mut only, NAME, &entries);
        Self::Mended(only.0.into_bytes())
    }
}

/// How much larger everything can be than the system says, as `egui` has it.
const ZOOMS: RangeInclusive<f64> = 0.2..=5.0;
/// What a screen can make of a point.
const SCALES: RangeInclusive<f64> = 0.1..=20.0;
/// Points from one side of a window to the other.
const SIZES: RangeInclusive<f64> = 1.0..=100_000.0;

/// Whether the number at this place of a text is in its range, if there is one.
fn has_sense(text: &str, place: &[&str], range: RangeInclusive<f64>) -> bool {
    let (fields, _) = fields_of(text);
    let fields = fields.into_iter().filter_map(|field| Some((field.name, field.value?)));
    let mut value = Value::Fields(fields.collect());
    for name in place {
        // `Some((x: 1))`.
        while let Value::Call(_, values) = &mut value
            && values.len() == 1
        {
            value = values.remove(0);
        }
        let Value::Fields(fields) = value else { return true };
        let Some((_, inner)) = fields.into_iter().find(|(own, _)| own == name) else { return true };
        value = inner;
    }
    !matches!(value, Value::Word(_)) || number(&value, range).is_ok()
}

/// What could not be used so far.
#[derive(Default)]
struct Problems(Vec<Problem>);

impl Problems {
    fn note(&mut self, field: &str, what: &str) {
        self.0.push(Problem { field: shortened(field), what: what.to_owned(), is_unknown: false });
    }

    /// Puts what was read into its place, or says why it is not there.
    fn put<T>(&mut self, field: &str, place: &mut T, read: Result<T, String>) {
        match read {
            Ok(value) => *place = value,
            Err(what) => self.note(field, &what),
        }
    }
}

/// No more of a text than can be shown.
fn shortened(text: &str) -> String {
    const LONGEST: usize = 32;
    let mut letters = text.chars().map(|letter| if letter.is_control() { ' ' } else { letter });
    let short: String = letters.by_ref().take(LONGEST).collect();
    if letters.next().is_some() { format!("{short}…") } else { short }
}

fn word(value: &Value) -> Result<&str, String> {
    match value {
        Value::Word(word) => Ok(word),
        _ => Err("it is of another kind".to_owned()),
    }
}

/// One of several that have names.
fn named<T: DeserializeOwned>(value: &Value) -> Result<T, String> {
    let word = word(value)?;
    let name: StrDeserializer<'_, Error> = word.into_deserializer();
    T::deserialize(name).map_err(|_| format!("nothing here is called {}", shortened(word)))
}

fn number(value: &Value, range: RangeInclusive<f64>) -> Result<f64, String> {
    let word = word(value)?;
    let found = word.parse().ok().filter(|number: &f64| range.contains(number));
    let (low, high) = range.into_inner();
    found.ok_or_else(|| format!("{} is no number from {low} to {high}", shortened(word)))
}

fn whole(value: &Value, range: RangeInclusive<f64>) -> Result<f64, String> {
    let number = number(value, range)?;
    if number.fract() == 0.0 { Ok(number) } else { Err(format!("{number} is no whole number")) }
}

fn truth(value: &Value) -> Result<bool, String> {
    match word(value)? {
        "true" => Ok(true),
        "false" => Ok(false),
        other => Err(format!("{} is neither true nor false", shortened(other))),
    }
}

fn line(value: &Value) -> Result<String, String> {
    match value {
        Value::Text(text) if text.chars().count() > LONGEST_NAME => {
            Err(format!("it has more than {LONGEST_NAME} letters"))
        }
        Value::Text(text) if text.chars().any(char::is_control) => Err("it is no line of text".to_owned()),
        Value::Text(text) => Ok(text.clone()),
        _ => Err("it is no text".to_owned()),
    }
}

fn budget(value: &Value) -> Result<Budget, String> {
    let (kind, n) = match value {
        Value::Call(kind, values) if values.len() == 1 => (kind.as_str(), &values[0]),
        _ => return Err("it is neither queries nor minutes".to_owned()),
    };
    let n = whole(n, BUDGETS)? as u32;
    match kind {
        "queries" => Ok(Budget::Queries(n)),
        "minutes" => Ok(Budget::Minutes(n)),
        other => Err(format!("nothing is counted in {}", shortened(other))),
    }
}

/// The fields of a value that has some, by their full names.
fn parts<'a>(name: &str, value: &'a Value, problems: &mut Problems) -> Vec<(String, &'a str, &'a Value)> {
    match value {
        Value::Fields(fields) => {
            fields.iter().map(|(own, value)| (format!("{name}.{own}"), own.as_str(), value)).collect()
        }
        // `()`: all as at first.
        Value::Call(_, values) if values.is_empty() => Vec::new(),
        _ => {
            problems.note(name, "it is of another kind");
            Vec::new()
        }
    }
}

fn controls(config: &mut ControlConfig, value: &Value, problems: &mut Problems) {
    for (name, own, value) in parts("controls", value, problems) {
        match own {
            "dead_zone" => {
                let zone = number(value, 0.0..=0.9).map(|number| number as f32);
                problems.put(&name, &mut config.dead_zone, zone);
            }
            "curve" => {
                let curve = number(value, 1.0..=3.0).map(|number| number as f32);
                problems.put(&name, &mut config.curve, curve);
            }
            "axes" => axes(config, value, problems),
            _ => match former(own) {
                Some(former) => former.take(config, &name, value, problems),
                None => problems.note(&name, "this program does not know it"),
            },
        }
    }
}

/// What somebody wants of axes, by their names.
fn axes(config: &mut ControlConfig, value: &Value, problems: &mut Problems) {
    let Value::Map(all) = value else { return problems.note("controls.axes", "it is of another kind") };
    for (axis, value) in all {
        let Ok(axis) = line(axis) else {
            problems.note("controls.axes", "it is no name of an axis");
            continue;
        };
        let mut wanted = AxisControls::default();
        for (name, own, value) in parts(&format!("controls.axes.{axis}"), value, problems) {
            match own {
                "keys" => problems.put(&name, &mut wanted.keys, optional(value, share)),
                "pad" => problems.put(&name, &mut wanted.pad, optional(value, named)),
                _ => problems.note(&name, "this program does not know it"),
            }
        }
        config.set(&axis, wanted);
    }
}

fn share(value: &Value) -> Result<f32, String> {
    number(value, 0.0..=1.0).map(|number| number as f32)
}

/// A value that may be none.
fn optional<T>(value: &Value, read: fn(&Value) -> Result<T, String>) -> Result<Option<T>, String> {
    match value {
        Value::Word(word) if word == "None" => Ok(None),
        Value::Call(name, values) if name == "Some" && values.len() == 1 => read(&values[0]).map(Some),
        value => read(value).map(Some),
    }
}

/// A setting of the times when only cars were driven: of which axis it is, and what it was where nobody had set it, which
/// then says nothing.
struct Former {
    axis: &'static str,
    first: &'static str,
}

fn former(field: &str) -> Option<Former> {
    let (axis, first) = match field {
        "key_steer" => ("steer", "1"),
        "key_gas" => ("gas", "1"),
        "key_brake" => ("brake", "0.8"),
        "steer_by" => ("steer", "LeftStick"),
        "gas_by" => ("gas", "RightTrigger"),
        "brake_by" => ("brake", "LeftTrigger"),
        _ => return None,
    };
    Some(Former { axis, first })
}

impl Former {
    fn take(&self, config: &mut ControlConfig, name: &str, value: &Value, problems: &mut Problems) {
        let mut wanted = config.of(self.axis);
        if let Ok(first) = self.first.parse::<f32>() {
            let mut keys = None;
            problems.put(name, &mut keys, share(value).map(Some));
            wanted.keys = keys.filter(|keys| *keys != first).or(wanted.keys);
        } else {
            let mut lever = None;
            let read = word(value).and_then(|word| {
                former_lever(word).ok_or_else(|| format!("nothing here is called {}", shortened(word)))
            });
            problems.put(name, &mut lever, read.map(Some));
            wanted.pad = lever.filter(|lever| Some(*lever) != former_lever(self.first)).or(wanted.pad);
        }
        config.set(self.axis, wanted);
    }
}

/// What of a pad was called so.
fn former_lever(name: &str) -> Option<Lever> {
    Some(match name {
        "LeftStick" => Lever::LeftStickSideways,
        "RightStick" => Lever::RightStickSideways,
        "LeftTrigger" => Lever::LeftTrigger,
        "RightTrigger" => Lever::RightTrigger,
        "LeftUp" => Lever::LeftStickUp,
        "LeftDown" => Lever::LeftStickDown,
        "RightUp" => Lever::RightStickUp,
        "RightDown" => Lever::RightStickDown,
        _ => return None,
    })
}

fn selection(selection: &mut QuerySelection, value: &Value, problems: &mut Problems) {
    let percent = |value, most: u8| whole(value, 0.0..=f64::from(most)).map(|percent| percent as u8);
    for (name, own, value) in parts("asking", value, problems) {
        match own {
            "again" => problems.put(&name, &mut selection.repeats, percent(value, MOST_REPEATS)),
            "held_back" => problems.put(&name, &mut selection.held_back, percent(value, MOST_HELD_BACK)),
            "mix" => {
                for (name, own, value) in parts("asking.mix", value, problems) {
                    let mix = &mut selection.mix;
                    match own {
                        "disagreement" => problems.put(&name, &mut mix.disagreement, percent(value, 100)),
                        "boundary" => problems.put(&name, &mut mix.boundary, percent(value, 100)),
                        "least_answered" => {
                            problems.put(&name, &mut mix.least_answered, percent(value, 100));
                        }
                        "is_balanced" => problems.put(&name, &mut mix.is_balanced, truth(value)),
                        _ => problems.note(&name, "this program does not know it"),
                    }
                }
                if selection.mix != selection.mix.clamped() {
                    problems.note("asking.mix", "it is more than a hundred of a hundred");
                    selection.mix = selection.mix.clamped();
                }
            }
            _ => problems.note(&name, "this program does not know it"),
        }
    }
}

/// Hints by their names; those of a newer program are left out.
fn hints(value: &Value) -> Result<BTreeSet<Hint>, String> {
    let Value::List(names) = value else { return Err("it is no list of hints".to_owned()) };
    Ok(names.iter().filter_map(|name| named::<Hint>(name).ok()).collect())
}

/// Deeds with what they are done by, by their full names.
fn by_deed<'a>(
    field: &str,
    value: &'a Value,
    problems: &mut Problems,
) -> Vec<(KeyAction, String, &'a Value)> {
    let Value::Map(entries) = value else {
        problems.note(field, "it is of another kind");
        return Vec::new();
    };
    let mut found: Vec<(KeyAction, String, &Value)> = Vec::new();
    for (key_action, value) in entries {
        let name = format!("{field}.{}", shortened(word(key_action).unwrap_or("?")));
        match named::<KeyAction>(key_action) {
            Ok(key_action) if found.iter().any(|(other, ..)| *other == key_action) => {
                problems.note(&name, "it is given twice, and the first counts");
            }
            Ok(key_action) => found.push((key_action, name, value)),
            Err(what) => problems.note(&name, &what),
        }
    }
    found
}

/// What was done by two keys each when only cars were driven: by the names that their files have for them.
const FORMER_MOVES: [(&str, [&str; 2]); 4] = [
    ("SteerLeft", ["Left", "A"]),
    ("SteerRight", ["Right", "D"]),
    ("Gas", ["Up", "W"]),
    ("Brake", ["Down", "S"]),
];

fn keys(value: &Value, moved: &mut MovedKeys, problems: &mut Problems) -> Keys {
    let (former, value) = without_former_moves(value);
    for (deed, names, value) in former {
        let name = format!("keys.{deed}");
        let wanted = key_list(value).and_then(|keys| match keys.len() {
            2 if keys[0] != keys[1] => Ok(keys),
            2 => Err(format!("{} twice", keys[0].name())),
            n => Err(format!("{n} keys where it has 2")),
        });
        match wanted {
            Ok(wanted) => {
                for (key_name, key) in names.into_iter().filter_map(known_key).zip(wanted) {
                    move_key(moved, &name, key_name, key, problems);
                }
            }
            Err(what) => problems.note(&name, &what),
        }
    }
    let mut own = BTreeMap::new();
    for (key_action, name, value) in by_deed("keys", &value, problems) {
        match key_list(value) {
            Ok(keys) => drop(own.insert(key_action, keys)),
            Err(what) => problems.note(&name, &what),
        }
    }
    let (keys, refused) = Keys::with(own);
    for (key_action, what) in refused {
        problems.note(&format!("keys.{key_action:?}"), &what);
    }
    keys
}

fn key_list(value: &Value) -> Result<Vec<Key>, String> {
    match value {
        Value::List(keys) => keys.iter().map(named::<Key>).collect(),
        _ => Err("it is no list of keys".to_owned()),
    }
}

/// Something that was done by two keys, and which they are now.
type FormerMove<'a> = (&'static str, [&'static str; 2], &'a Value);

/// What a map says of keys that moved cars, and the map without that.
fn without_former_moves(value: &Value) -> (Vec<FormerMove<'_>>, Value) {
    let Value::Map(entries) = value else { return (Vec::new(), value.clone()) };
    let of = |key: &Value| FORMER_MOVES.into_iter().find(|(deed, _)| word(key) == Ok(*deed));
    let former = entries.iter().filter_map(|(key, value)| of(key).map(|(deed, names)| (deed, names, value)));
    let rest = entries.iter().filter(|(key, _)| of(key).is_none()).cloned();
    (former.collect(), Value::Map(rest.collect()))
}

/// Has `key` for the one of this name, unless another name has it.
fn move_key(moved: &mut MovedKeys, field: &str, name: &'static str, key: Key, problems: &mut Problems) {
    if Key::from_name(name) == Some(key) {
        moved.remove(name);
        return;
    }
    let is_fixed = matches!(key, Key::Questionmark | Key::Slash | Key::F1 | Key::Tab);
    let has_other = moved.iter().any(|(other, own)| *other != name && *own == key);
    if is_fixed || has_other {
        return problems.note(field, &format!("{} has another use", key.name()));
    }
    moved.insert(name, key);
}

fn moves(moved: &mut MovedKeys, value: &Value, problems: &mut Problems) {
    let Value::Map(entries) = value else { return problems.note("moves", "it is of another kind") };
    for (name, key) in entries {
        let known = line(name).ok().as_deref().and_then(known_key);
        match (known, named::<Key>(key)) {
            (Some(known), Ok(key)) => move_key(moved, &format!("moves.{known}"), known, key, problems),
            (Some(known), Err(what)) => problems.note(&format!("moves.{known}"), &what),
            (None, _) => problems.note("moves", "no world moves anything by such a key"),
        }
    }
}

fn buttons(value: &Value, problems: &mut Problems) -> Buttons {
    let mut own = BTreeMap::new();
    for (key_action, name, value) in by_deed("pads", value, problems) {
        match named::<PadButton>(value) {
            Ok(button) => drop(own.insert(key_action, button)),
            Err(what) => problems.note(&name, &what),
        }
    }
    let (buttons, refused) = Buttons::with(own);
    for (key_action, what) in refused {
        problems.note(&format!("pads.{key_action:?}"), &what);
    }
    buttons
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ui::settings::keymap::Slot;

    #[test]
    fn what_was_set_when_only_cars_were_driven_counts_still() {
        let text = "(keys:{SteerLeft:[ArrowLeft,J],Gas:[I,W],Brake:[ArrowDown,S]},controls:(key_steer:1.0,key_gas:0.25,\
            key_brake:0.8,dead_zone:0.2,curve:1.0,steer_by:RightStick,gas_by:RightTrigger,brake_by:LeftDown))";
        let (read, problems) = Preferences::read(text);
        assert_eq!(problems, []);
        assert_eq!(read.moves, MovedKeys::from([("A", Key::J), ("Up", Key::I)]));
        let wanted = |keys, pad| AxisControls { keys, pad };
        assert_eq!(read.controls.dead_zone, 0.2);
        assert_eq!(read.controls.of("steer"), wanted(None, Some(Lever::RightStickSideways)));
        assert_eq!(read.controls.of("gas"), wanted(Some(0.25), None));
        assert_eq!(read.controls.of("brake"), wanted(None, Some(Lever::LeftStickDown)));
        assert_eq!(Preferences::read(&read.text()), (read, Vec::new()));
    }

    /// What somebody may have set.
    fn lived_in() -> Preferences {
        let mut keys = Keys::default();
        keys.bind(Slot::Of(KeyAction::Keep, 0), Key::K);
        keys.bind(Slot::Of(KeyAction::OnlyLeft, 0), Key::D);
        let mut controls = ControlConfig { curve: 2.5, ..ControlConfig::default() };
        controls.set("gas", AxisControls { keys: Some(0.25), pad: Some(Lever::LeftStickUp) });
        let mut buttons = Buttons::default();
        buttons.bind(KeyAction::Keep, PadButton::East);
        Preferences {
            theme: ThemePreference::Dark,
            keys,
            moves: MovedKeys::from([("A", Key::J), ("Up", Key::I)]),
            controls,
            buttons,
            clip_speed: 35.0,
            is_guided: true,
            annotator: "Anna \"A.\" Ünal, (1)".to_owned(),
            budget: Budget::Minutes(60),
            break_minutes: 0,
            selection: QuerySelection { repeats: 10, held_back: 20, ..QuerySelection::default() },
            is_motion_reduced: true,
            hints: BTreeSet::from([Hint::Drive, Hint::Fit]),
            unknown: Vec::new(),
        }
    }

    /// The fields that could not be used of `text`.
    fn refused(text: &str) -> Vec<String> {
        Preferences::read(text).1.into_iter().map(|problem| problem.field).collect()
    }

    #[test]
    fn what_is_written_is_read_again() {
        for preferences in [Preferences::default(), lived_in()] {
            assert_eq!(Preferences::read(&preferences.text()), (preferences, Vec::new()));
        }
    }

    #[test]
    fn one_bad_field_leaves_all_others_as_they_were() {
        let text = lived_in().text();
        for (good, bad, field) in [
            ("theme:Dark", "theme:Drak", "theme"),
            ("theme:Dark", "theme:7", "theme"),
            ("theme:Dark", "theme:[Dark]", "theme"),
            ("clip_speed:35.0", "clip_speed:NaN", "clip_speed"),
            ("clip_speed:35.0", "clip_speed:inf", "clip_speed"),
            ("clip_speed:35.0", "clip_speed:1e300", "clip_speed"),
            ("clip_speed:35.0", "clip_speed:\"35\"", "clip_speed"),
            ("clip_speed:35.0", "clip_speed:", "clip_speed"),
            ("is_guided:true", "is_guided:maybe", "is_guided"),
            ("budget:minutes(60)", "budget:minutes(0)", "budget"),
            ("budget:minutes(60)", "budget:minutes(99999999999)", "budget"),
            ("budget:minutes(60)", "budget:hours(1)", "budget"),
            ("break_minutes:0", "break_minutes:-1", "break_minutes"),
            ("break_minutes:0", "break_minutes:2.5", "break_minutes"),
            ("keys:Some(0.25)", "keys:Some(NaN)", "controls.axes.gas.keys"),
            ("pad:Some(LeftStickUp)", "pad:Some(Nose)", "controls.axes.gas.pad"),
            ("\"A\":J", "\"A\":Jay", "moves.A"),
            ("\"A\":J", "\"Ä\":J", "moves"),
            ("\"A\":J", "\"A\":F1", "moves.A"),
            ("curve:2.5", "curve:-3", "controls.curve"),
            ("again:10", "again:99", "asking.again"),
            ("is_motion_reduced:true", "is_motion_reduced:1", "is_motion_reduced"),
            ("hints:[Drive,Fit]", "hints:Drive", "hints"),
            ("Keep:East", "Keep:East,Keep:East", "pads.Keep"),
        ] {
            assert!(text.contains(good), "{good} in {text}");
            let (read, problems) = Preferences::read(&text.replacen(good, bad, 1));
            assert_eq!(problems.len(), 1, "{bad}: {problems:?}");
            assert_eq!(problems[0].field, field, "{problems:?}");
            assert_eq!((&read.keys, &read.annotator), (&lived_in().keys, &lived_in().annotator), "{bad}");
        }
    }

    #[test]
    fn a_key_that_cannot_be_is_as_at_first_and_the_others_are_as_they_were() {
        let with = |keys: &str| Preferences::read(&format!("(keys:{{Skip:[Q],{keys}}},theme:Light)"));
        for (keys, field) in [
            ("Fly:[K]", "keys.Fly"),
            ("Keep:[Kay]", "keys.Keep"),
            ("Keep:[]", "keys.Keep"),
            ("Keep:[K,L]", "keys.Keep"),
            ("Keep:K", "keys.Keep"),
            ("Keep:[R]", "keys.Keep"),
            ("Keep:[F1]", "keys.Keep"),
            ("Flag:[Num1]", "keys.Flag"),
            ("Gas:[W,W]", "keys.Gas"),
        ] {
            let (read, problems) = with(keys);
            assert_eq!(problems.len(), 1, "{keys}: {problems:?}");
            assert_eq!(problems[0].field, field);
            assert_eq!(
                (read.keys.of(KeyAction::Skip), read.keys.of(KeyAction::Keep)),
                (Key::Q, Key::N),
                "{keys}"
            );
            assert_eq!(read.theme, ThemePreference::Light);
        }
        let (read, problems) = with("Keep:[K],Redo:[K]");
        let theirs = [read.keys.of(KeyAction::Keep), read.keys.of(KeyAction::Redo)];
        assert_eq!((problems.len(), theirs), (1, [Key::K, Key::R]), "of two who want one the first has it");
    }

    #[test]
    fn a_button_of_a_pad_that_cannot_be_is_as_at_first() {
        assert_eq!(refused("(pads:{Keep:Nose})"), ["pads.Keep"]);
        assert_eq!(refused("(pads:{Gas:South})"), ["pads.Gas"], "that is no key_action of a pad");
        assert_eq!(refused("(pads:{Keep:South})"), ["pads.Keep"], "another key_action has it there");
        assert_eq!(refused("(pads:{Keep:South,Unsafe:North})"), [""; 0], "unless they change over");
        assert_eq!(refused("(pads:7)"), ["pads"]);
    }

    #[test]
    fn settings_of_a_newer_program_are_written_back() {
        let text = "(theme:Dark,wings:(span:[1,2],\"x\":Some(3)),clip_speed:50.0,smell:\"of roses\")";
        let text = text.replace("\"x\":Some(3)", "of:\"wax, (hot)\"");
        let (read, problems) = Preferences::read(&text);
        assert!(problems.iter().all(|problem| problem.is_unknown), "{problems:?}");
        assert_eq!(refused(&text), ["wings", "smell"]);
        let again = read.text();
        assert!(again.contains("wings:(span:[1,2],of:\"wax, (hot)\")"), "{again}");
        assert_eq!(Preferences::read(&again).0, read);
        assert_eq!((read.theme, read.clip_speed), (ThemePreference::Dark, 50.0));
    }

    #[test]
    fn a_field_that_is_given_twice_counts_once() {
        let (read, problems) = Preferences::read("(theme:Dark,theme:Light)");
        assert_eq!((read.theme, problems.len()), (ThemePreference::Dark, 1));
    }

    #[test]
    fn a_text_that_is_cut_short_gives_what_is_whole_of_it_and_says_so() {
        let text = lived_in().text();
        for end in (0..text.len()).filter(|end| text.is_char_boundary(*end)) {
            let (read, problems) = Preferences::read(&text[..end]);
            assert!(!problems.is_empty(), "{end}");
            if text[..end].contains("controls") {
                assert_eq!((read.theme, &read.keys), (ThemePreference::Dark, &lived_in().keys), "{end}");
            }
        }
    }

    #[test]
    fn what_is_told_names_the_fields_and_where_the_old_text_is() {
        let (_, problems) = Preferences::read("(theme:Drak,clip_speed:NaN)");
        let said = said(&problems);
        assert!(said.contains("theme (nothing here is called Drak)"), "{said}");
        assert!(said.contains("clip_speed (NaN is no number from 5 to 100)"), "{said}");
        assert!(said.contains("kept as preferences_kept"), "{said}");
    }

    #[test]
    fn a_damaged_file_is_told_from_a_whole_one() {
        assert_eq!(SettingsFile::of(b"{\"preferences\":\"(theme:Dark)\",}"), SettingsFile::Good);
        assert_eq!(SettingsFile::of(b"{}"), SettingsFile::Good, "one in which nothing is set");
        for damaged in [&b""[..], b"{\"preferences\":\"(the", b"\xff\xfe{}", b"[1]", b"{} {}", b"\0\0\0\0"] {
            assert_eq!(SettingsFile::of(damaged), SettingsFile::Damaged, "{damaged:?}");
        }
    }

    #[test]
    fn a_scale_that_ends_every_window_is_taken_out_and_the_rest_stays() {
        let file = |egui: &str, window: &str| {
            let entries = [("preferences", "(theme:Dark)"), ("egui", egui), ("window", window)];
            let mut only = Only(String::new());
            eframe::set_value(&mut only, NAME, &BTreeMap::from(entries));
            only.0.into_bytes()
        };
        let (egui, window) = (
            |zoom: &str| format!("(options:(theme_preference:Dark,zoom_factor:{zoom}),data:([]))"),
            |x: &str| format!("(normal_geometry:(scale_factor:1.0,inner_size_points:(x:{x},y:820.0)))"),
        );
        assert_eq!(SettingsFile::of(&file(&egui("1.5"), &window("1280.0"))), SettingsFile::Good);
        for zoom in ["NaN", "0.0", "inf", "-1.0", "1e9"] {
            let SettingsFile::Mended(bytes) = SettingsFile::of(&file(&egui(zoom), &window("1280.0"))) else {
                panic!("{zoom} is taken for a scale")
            };
            let text = String::from_utf8_lossy(&bytes);
            assert!(!text.contains("zoom") && text.contains("theme:Dark") && text.contains("1280"), "{text}");
            assert_eq!(SettingsFile::of(&bytes), SettingsFile::Good);
        }
        for size in ["NaN", "-5.0", "1e9"] {
            let found = SettingsFile::of(&file(&egui("1.0"), &window(size)));
            assert!(matches!(found, SettingsFile::Mended(_)), "{size}");
        }
    }

    /// The same text with one byte in another place, gone, or other.
    fn damaged(text: &str, at: usize, with: char, kind: u8) -> String {
        let mut letters: Vec<char> = text.chars().collect();
        let at = at % letters.len();
        match kind % 4 {
            0 => letters[at] = with,
            1 => letters.insert(at, with),
            2 => drop(letters.remove(at)),
            _ => letters.truncate(at),
        }
        letters.into_iter().collect()
    }

    proptest! {
        #[test]
        fn no_damage_makes_it_panic_or_sets_what_cannot_be(
            damages in prop::collection::vec((any::<usize>(), any::<char>(), any::<u8>()), 1..6),
        ) {
            let mut text = lived_in().text();
            for (at, with, kind) in damages {
                if !text.is_empty() {
                    text = damaged(&text, at, with, kind);
                }
            }
            let (read, _) = Preferences::read(&text);
            prop_assert!(SPEEDS.contains(&read.clip_speed));
            prop_assert_eq!(&read.controls, &read.controls.clone().clamped());
            prop_assert_eq!(Keys::with(read.keys.clone().into()).1, []);
            // What comes of it is written and read without a loss.
            let (again, problems) = Preferences::read(&read.text());
            prop_assert!(problems.iter().all(|problem| problem.is_unknown), "{:?}", problems);
            prop_assert_eq!(again, read);
        }

        #[test]
        fn any_text_is_read(text in ".{0,200}") {
            let (read, _) = Preferences::read(&text);
            prop_assert_eq!(Preferences::read(&read.text()).0, read);
        }
    }
}
