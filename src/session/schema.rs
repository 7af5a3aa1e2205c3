//! The committed JSON Schemas say of files what the code says: what they let through is read, what they refuse is refused.

use std::path::Path;

use serde_json::{Value, json};

use super::event::tests::lines;
use super::*;

const EVENT: &str = include_str!("../../assets/schema/event.schema.json");
const SESSION: &str = include_str!("../../assets/schema/session.schema.json");

/// Whether `schema`, a part of `root`, lets `value` through: as much of JSON Schema as those files use.
///
/// # Panics
/// At a word that it does not know.
fn permits(root: &Value, schema: &Value, value: &Value) -> bool {
    let schema = schema.as_object().unwrap();
    schema.iter().all(|(word, rule)| match word.as_str() {
        "$schema" | "$defs" | "title" | "description" => true,
        "$ref" => {
            let pointer = rule.as_str().unwrap().trim_start_matches('#');
            permits(root, root.pointer(pointer).unwrap(), value)
        }
        "type" => match rule {
            Value::Array(types) => types.iter().any(|one| is_of(one, value)),
            one => is_of(one, value),
        },
        "const" => rule == value,
        "enum" => rule.as_array().unwrap().contains(value),
        "oneOf" => rule.as_array().unwrap().iter().filter(|one| permits(root, one, value)).count() == 1,
        "minimum" => value.as_f64().is_none_or(|number| number >= rule.as_f64().unwrap()),
        "maximum" => value.as_f64().is_none_or(|number| number <= rule.as_f64().unwrap()),
        "exclusiveMinimum" => value.as_f64().is_none_or(|number| number > rule.as_f64().unwrap()),
        "minItems" => value.as_array().is_none_or(|items| items.len() as u64 >= rule.as_u64().unwrap()),
        "maxItems" => value.as_array().is_none_or(|items| items.len() as u64 <= rule.as_u64().unwrap()),
        "items" => value.as_array().is_none_or(|items| items.iter().all(|item| permits(root, rule, item))),
        "prefixItems" => value.as_array().is_none_or(|items| {
            items.iter().zip(rule.as_array().unwrap()).all(|(item, rule)| permits(root, rule, item))
        }),
        "properties" => value.as_object().is_none_or(|fields| {
            let known = |(name, value)| rule.get(name).is_none_or(|rule| permits(root, rule, value));
            fields.iter().all(known)
        }),
        "required" => value.as_object().is_none_or(|fields| {
            rule.as_array().unwrap().iter().all(|name| fields.contains_key(name.as_str().unwrap()))
        }),
        "additionalProperties" => value.as_object().is_none_or(|fields| {
            assert_eq!(rule, &json!(false), "nothing else is known here");
            fields.keys().all(|name| schema["properties"].get(name).is_some())
        }),
        other => panic!("the test does not know {other:?}"),
    })
}

fn is_of(name: &Value, value: &Value) -> bool {
    match name.as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        other => panic!("the test does not know the type {other:?}"),
    }
}

/// The ways to all values within `value`.
fn pointers(value: &Value) -> Vec<String> {
    let within = |key: &str, inner: &Value| -> Vec<String> {
        pointers(inner).into_iter().map(|pointer| format!("/{key}{pointer}")).collect()
    };
    let mut all = vec![String::new()];
    match value {
        Value::Object(fields) => all.extend(fields.iter().flat_map(|(key, inner)| within(key, inner))),
        Value::Array(items) => {
            all.extend(items.iter().enumerate().flat_map(|(i, inner)| within(&i.to_string(), inner)));
        }
        _ => {}
    }
    all
}

/// `value` with a field less, with one more, and with odd values in each place, after the place.
fn altered(value: &Value) -> Vec<(String, Value)> {
    let odd = [
        json!(null),
        json!(-1),
        json!(0),
        json!(1.5),
        json!(19),
        json!(20),
        json!(101),
        json!(300),
        json!(u64::MAX),
        json!(1e39),
        json!("x"),
        json!(""),
        json!(true),
        json!([]),
        json!({}),
        json!([0, "left"]),
        json!("left"),
    ];
    let mut all = Vec::new();
    for pointer in pointers(value) {
        for odd in &odd {
            let mut other = value.clone();
            *other.pointer_mut(&pointer).unwrap() = odd.clone();
            all.push((pointer.clone(), other));
        }
        if let Some(fields) = value.pointer(&pointer).unwrap().as_object() {
            for key in fields.keys() {
                let mut other = value.clone();
                other.pointer_mut(&pointer).unwrap().as_object_mut().unwrap().remove(key);
                all.push((format!("{pointer} without {key}"), other));
            }
            let mut other = value.clone();
            other.pointer_mut(&pointer).unwrap()["sure"] = json!(1);
            all.push((format!("{pointer} with more"), other));
        }
    }
    all
}

/// What is only refused where the event is taken in: see [`Session::check`].
fn is_checked_later(pointer: &str) -> bool {
    let names = ["secs", "held_back", "held_out", "losses", "left_unsafe_from", "safety", "default"];
    names.iter().any(|name| pointer.split('/').any(|part| part == *name))
}

#[test]
fn the_schema_of_events_and_the_code_let_the_same_through() {
    let schema: Value = serde_json::from_str(EVENT).unwrap();
    let (mut n_permitted, mut n_refused) = (0, 0);
    // An answer can rest on several justifications.
    let one = "\"justified\":[0,";
    let several = lines().into_iter().find(|line| line.contains(one)).unwrap();
    let several = several.replace(one, "\"justified\":[[0,1],");
    for line in lines().into_iter().chain([several]) {
        let value: Value = serde_json::from_str(&line).unwrap();
        assert!(permits(&schema, &schema, &value), "{line}");
        for (place, other) in altered(&value) {
            let line = other.to_string();
            let (is_permitted, is_read) =
                (permits(&schema, &schema, &other), Entry::from_line(line.as_bytes()).is_ok());
            if is_checked_later(&place) {
                assert!(is_read || !is_permitted, "at {place:?} the schema permits {line}");
            } else {
                assert_eq!(is_permitted, is_read, "at {place:?}: {line}");
            }
            *(if is_permitted { &mut n_permitted } else { &mut n_refused }) += 1;
        }
    }
    assert!(n_permitted > 100 && n_refused > 1000, "{n_permitted} and {n_refused}");
}

#[test]
fn the_schema_of_events_knows_every_event() {
    let schema: Value = serde_json::from_str(EVENT).unwrap();
    let name = |value: &Value| value["event"].as_str().unwrap().to_owned();
    let used: BTreeSet<_> = lines().iter().map(|line| name(&serde_json::from_str(line).unwrap())).collect();
    let all = schema["oneOf"].as_array().unwrap().iter();
    let known: BTreeSet<_> =
        all.map(|event| event["properties"]["event"]["const"].as_str().unwrap().to_owned()).collect();
    assert_eq!(used, known);
}

#[test]
fn the_schema_of_headers_and_the_code_let_the_same_through() {
    let schema: Value = serde_json::from_str(SESSION).unwrap();
    let header = Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 5);
    let header = Header {
        world_model_path: Some("../world.safetensors".to_owned()),
        world_file: Some("/worlds/mine.toml".to_owned()),
        ..header
    };
    let value = serde_json::to_value(header).unwrap();
    assert!(permits(&schema, &schema, &value), "{value}");
    for (place, other) in altered(&value) {
        let is_read = Header::parse(other.to_string().as_bytes(), Path::new("session.json")).is_ok();
        assert_eq!(permits(&schema, &schema, &other), is_read, "at {place:?}: {other}");
    }
}

#[test]
fn the_shipped_examples_are_as_the_schemas_say() {
    let (session, event): (Value, Value) =
        (serde_json::from_str(SESSION).unwrap(), serde_json::from_str(EVENT).unwrap());
    for example in ["example", "example-obstacles"] {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions").join(example);
        let header = serde_json::from_slice(&std::fs::read(dir.join("session.json")).unwrap()).unwrap();
        assert!(permits(&session, &session, &header), "{example}");
        for line in std::fs::read_to_string(dir.join("events.jsonl")).unwrap().lines() {
            assert!(permits(&event, &event, &serde_json::from_str(line).unwrap()), "{example}: {line}");
        }
    }
}

#[test]
fn the_lines_in_the_document_can_be_read_and_followed() {
    let document = include_str!("../../assets/format-sessions.md");
    let events: Vec<_> = document.lines().filter(|line| line.starts_with("{\"event\"")).collect();
    let contents = log::parse(events.join("\n").as_bytes(), Path::new("log")).unwrap();
    let header = Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 5);
    header.session().folded(&contents.entries).unwrap();
    let name = |line: &str| serde_json::from_str::<Value>(line).unwrap()["event"].to_string();
    let shown: BTreeSet<_> = events.iter().map(|line| name(line)).collect();
    assert_eq!(shown, lines().iter().map(|line| name(line)).collect(), "one of each");

    let header = &document[document.find("{\n  \"format\"").unwrap()..];
    let header = &header[..header.find("```").unwrap()];
    assert_eq!(Header::parse(header.as_bytes(), Path::new("session.json")).unwrap().seed, 3);

    let result = document.lines().find(|line| line.starts_with("{\"metrics\"")).unwrap();
    let found = crate::evaluation::Results::parse(result.as_bytes());
    assert_eq!((found.episodes[0].ret, found.notes), (2530.0, vec![]));
    let told: Value = serde_json::from_str(result).unwrap();
    let names = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    assert_eq!(names(&told["metrics"]), names(&json!(found.episodes[0])), "as they are written");
}
