//! Keys can be changed, and stay so.

use std::collections::BTreeMap;

use dropj::ui::{KeyAction, Keys};
use eframe::App as _;

use super::*;

fn open_keys(harness: &mut Harness<'_, Window>) {
    harness.get_by_label("Keys and help").click();
    // A dialog finds its size in its first pictures.
    harness.run_steps(10);
}

fn click(harness: &mut Harness<'_, Window>, label: &str) {
    harness.get_by_label(label).click();
    harness.run_steps(2);
}

#[test]
fn a_key_is_changed_by_clicking_it_and_pressing_another() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    open_keys(&mut harness);
    click(&mut harness, "only left is safe: A");
    harness.get_by_label_contains("Press the new key of “only left is safe”");
    press(&mut harness, Key::Q);
    harness.get_by_label("only left is safe: Q");
    assert_eq!(responses(&harness), [], "keys that are being changed answer nothing");
    press(&mut harness, Key::Escape);
    press(&mut harness, Key::A);
    assert_eq!(responses(&harness), [], "A does nothing now");
    press(&mut harness, Key::Q);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft)]);
}

#[test]
fn a_key_that_somebody_has_is_named_and_can_be_swapped() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    open_keys(&mut harness);
    click(&mut harness, "flag: F");
    press(&mut harness, Key::S);
    harness.get_by_label_contains("S is the key of “neither is safe”");
    assert_eq!(harness.state().keys(), &Keys::default(), "nothing has changed yet");
    click(&mut harness, "Swap them");
    let keys = harness.state().keys();
    assert_eq!((keys.of(KeyAction::Flag), keys.of(KeyAction::Neither)), (Key::S, Key::F));
    click(&mut harness, "Back to the first keys");
    assert_eq!(harness.state().keys(), &Keys::default());
}

#[test]
fn escape_leaves_a_key_as_it_is_and_numbers_have_their_own_use() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    open_keys(&mut harness);
    click(&mut harness, "skip: Space");
    press(&mut harness, Key::Num1);
    harness.get_by_label_contains("1 is the key of “reasons and justifications”");
    assert!(harness.query_by_label("Swap them").is_none(), "these stay");
    press(&mut harness, Key::Escape);
    harness.get_by_label("Click a key to change it.");
    assert_eq!(harness.state().keys(), &Keys::default());
}

#[test]
fn a_changed_key_drives() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    open_keys(&mut harness);
    click(&mut harness, "gas: W");
    press(&mut harness, Key::I);
    press(&mut harness, Key::Escape);
    harness.key_down(Key::W);
    harness.run_steps(2);
    assert_eq!(backstage.given(), [0.0; 3]);
    harness.key_down(Key::I);
    harness.run_steps(2);
    assert_eq!(backstage.given(), Action::new([0.0, 1.0, 0.0]));
}

/// What the system keeps for a program.
#[derive(Default)]
pub(crate) struct Memory(pub(crate) BTreeMap<String, String>);

impl Storage for Memory {
    fn get_string(&self, key: &str) -> Option<String> {
        self.0.get(key).cloned()
    }

    fn set_string(&mut self, key: &str, value: String) {
        self.0.insert(key.to_owned(), value);
    }

    fn remove_string(&mut self, key: &str) {
        self.0.remove(key);
    }

    fn flush(&mut self) {}
}

#[test]
fn keys_and_theme_outlast_the_window() {
    let dir = tempfile::tempdir().unwrap();
    let size = vec2(1280.0, 800.0);
    let (mut harness, _) = window(dir.path(), None, size, false);
    click(&mut harness, "As the system");
    open_keys(&mut harness);
    click(&mut harness, "end and keep: N");
    press(&mut harness, Key::K);
    let mut memory = Memory::default();
    harness.state_mut().save(&mut memory);

    let memory: &'static Memory = Box::leak(Box::new(memory));
    let (harness, _) = window_with(dir.path(), None, size, false, Some(memory));
    assert_eq!(harness.state().keys().of(KeyAction::Keep), Key::K);
    harness.get_by_label("Light");

    let torn = Memory([("preferences".to_owned(), "(theme: Li".to_owned())].into());
    let (harness, _) = window_with(dir.path(), None, size, false, Some(Box::leak(Box::new(torn))));
    assert_eq!(harness.state().keys(), &Keys::default(), "what cannot be read is as at first");
}

/// A window of somebody whose settings are these, and what it keeps of them.
fn with_settings(dir: &Path, text: &str) -> (Harness<'static, Window>, Memory) {
    let memory = Memory([("preferences".to_owned(), text.to_owned())].into());
    let mut kept = Memory(memory.0.clone());
    let size = vec2(1280.0, 800.0);
    let (mut harness, _) = window_with(dir, None, size, false, Some(Box::leak(Box::new(memory))));
    harness.state_mut().save(&mut kept);
    (harness, kept)
}

#[test]
fn a_setting_that_cannot_be_used_takes_no_other_along_and_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let text = "(theme:Light,keys:{Keep:[K],Fly:[F],Redo:[Kay]},clip_speed:NaN,annotator:\"anna\")";
    let (harness, kept) = with_settings(dir.path(), text);
    harness.get_by_label("Light");
    assert_eq!(
        (harness.state().keys().of(KeyAction::Keep), harness.state().keys().of(KeyAction::Redo)),
        (Key::K, Key::R)
    );
    for named in ["keys.Fly", "keys.Redo", "clip_speed", "kept as preferences_kept"] {
        harness.get_by_label_contains(named);
    }
    assert_eq!(kept.0["preferences_kept"], text, "all of it, as it was");
    let (harness, again) = with_settings(dir.path(), &kept.0["preferences"]);
    assert!(harness.query_by_label_contains("Some settings").is_none(), "what is kept now is good");
    assert_eq!(harness.state().keys().of(KeyAction::Keep), Key::K);
    assert!(!again.0.contains_key("preferences_kept"));
}

#[test]
fn settings_of_a_newer_program_are_kept_and_told_of_once() {
    let dir = tempfile::tempdir().unwrap();
    let text = "(theme:Light,wings:(span:[1,2]))";
    let (harness, kept) = with_settings(dir.path(), text);
    harness.get_by_label_contains("wings (this program does not know it");
    assert!(kept.0["preferences"].contains("wings:(span:[1,2])"), "{}", kept.0["preferences"]);
    let memory: &'static Memory = Box::leak(Box::new(kept));
    let (harness, _) = window_with(dir.path(), None, vec2(1280.0, 800.0), false, Some(memory));
    assert!(harness.query_by_label_contains("wings").is_none(), "it was told of before");
}

#[test]
fn texts_that_could_not_be_used_are_kept_beside_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let mut kept = Memory::default();
    for text in ["(theme: Li", "(theme:Drak)", "(theme: Li"] {
        kept.0.insert("preferences".to_owned(), text.to_owned());
        let memory: &'static Memory = Box::leak(Box::new(Memory(kept.0.clone())));
        let (mut harness, _) = window_with(dir.path(), None, vec2(1280.0, 800.0), false, Some(memory));
        harness.state_mut().save(&mut kept);
    }
    assert_eq!(
        (&*kept.0["preferences_kept"], &*kept.0["preferences_kept_2"]),
        ("(theme: Li", "(theme:Drak)")
    );
    assert!(!kept.0.contains_key("preferences_kept_3"), "the same text is kept once");
}
