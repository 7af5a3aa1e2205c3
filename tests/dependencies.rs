//! What we build on may be built on: free licenses, the public registry, nothing heavy by accident.

use std::process::Command;

use serde_json::Value;

/// Licenses that ask no more than to be named, or that keep to their own files.
const ALLOWED: [&str; 13] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MPL-2.0",
    "OFL-1.1",
    "Ubuntu-font-1.0",
    "Unicode-3.0",
    "Zlib",
];

/// Crates that would cost minutes of every build, each with the way around it.
const UNWANTED: [(&str, &str); 4] = [
    ("arrow-array", "parquet's own reader and writer do without it"),
    ("gtk-sys", "rfd's `xdg-portal` feature does without it"),
    ("openssl-sys", "nothing here speaks to a network"),
    ("tokio", "threads and channels do"),
];

/// All crates that are built here, from `cargo metadata`.
fn packages() -> Vec<Value> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version=1", "--locked", "--offline", "--filter-platform=host-tuple"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo writes JSON");
    metadata["packages"].as_array().expect("there are packages").clone()
}

/// Whether the terms of `license`, an SPDX expression, can be met with the allowed ones alone.
fn is_allowed(license: &str) -> bool {
    let license = license.trim();
    // The loosest first: AND binds more tightly than OR, of which the slash is an older spelling.
    for (word, enough) in [(" OR ", 1), ("/", 1), (" AND ", 2)] {
        if let Some((left, right)) = split_outside_parentheses(license, word) {
            return usize::from(is_allowed(left)) + usize::from(is_allowed(right)) >= enough;
        }
    }
    match license.strip_prefix('(').and_then(|inner| inner.strip_suffix(')')) {
        Some(inner) => is_allowed(inner),
        None => ALLOWED.contains(&license),
    }
}

/// The sides of the first `word` in `text` that is in no parentheses.
fn split_outside_parentheses<'a>(text: &'a str, word: &str) -> Option<(&'a str, &'a str)> {
    text.match_indices(word)
        .map(|(at, _)| (&text[..at], &text[at + word.len()..]))
        .find(|(left, _)| left.matches('(').count() == left.matches(')').count())
}

#[test]
fn every_crate_is_free_and_from_the_registry() {
    let packages = packages();
    let (ours, others): (Vec<_>, Vec<_>) = packages.iter().partition(|package| package["name"] == "dropj");
    assert_eq!(ours.len(), 1, "we are one crate");
    for package in others {
        let name = package["name"].as_str().expect("a crate has a name");
        let license = package["license"].as_str().unwrap_or("none");
        assert!(is_allowed(license), "{name} is licensed {license}");
        let source = package["source"].as_str().unwrap_or("a folder");
        assert!(source.starts_with("registry+"), "{name} comes from {source}");
        let unwanted = UNWANTED.iter().find(|(unwanted, _)| *unwanted == name);
        assert_eq!(
            unwanted, None,
            "a new dependency brings {name}; `cargo tree --invert {name}` tells which"
        );
    }
}

#[test]
fn a_license_that_asks_for_more_is_noticed() {
    for allowed in ["MIT", "GPL-3.0 / MIT", "MIT OR ISC AND GPL-2.0", "(MIT OR GPL-2.0) AND Unicode-3.0"] {
        assert!(is_allowed(allowed), "{allowed}");
    }
    for too_much in ["GPL-3.0", "none", "MIT AND GPL-2.0", "(MIT OR ISC) AND (GPL-2.0 OR LGPL-3.0)"] {
        assert!(!is_allowed(too_much), "{too_much}");
    }
}
