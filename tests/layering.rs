//! Data flows one way: a module names only itself and modules listed before it in `src/lib.rs`.
//!
//! Outside names keep to their homes as well: a window is the user interface's business, a thread a worker's.
//! This reads the source as text, so that a fault is reported even where the code does not compile.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Outside names, each with the only modules that may use it.
const RESERVED: [(&str, &[&str]); 9] = [
    ("egui", &["ui", "main"]),
    ("eframe", &["ui", "main"]),
    ("egui_plot", &["ui"]),
    ("winit", &["ui"]),
    ("gilrs", &["ui"]),
    ("rfd", &["ui"]),
    ("httparse", &["serve"]),
    ("std::thread", &["worker"]),
    ("std::fs", &["dataset", "run", "session", "main"]),
];

/// Names, each with modules that must do without it, and the places in these that may use it all the same.
const BARRED: [(&str, &[&str], &[&str]); 13] = [
    ("tch", &["world", "dataset", "query", "session", "app", "ui"], &[]),
    // All that happens to the application comes in as an argument.
    ("std::time", &["app"], &[]),
    ("std::env", &["app"], &[]),
    ("std::process", &["app", "ui"], &[]),
    // Jobs read files for the application, and the session writer writes them.
    ("Dataset::open", &["app", "ui"], &[]),
    ("SessionStore::open", &["app", "ui"], &[]),
    ("SessionStore::create", &["app", "ui"], &[]),
    ("SessionStore", &["ui"], &[]),
    // The window decides nothing, and remembers nothing but a person's settings.
    ("rand", &["ui"], &[]),
    ("rand_chacha", &["ui"], &[]),
    ("serde_json", &["app", "ui"], &[]),
    ("serde", &["ui"], &["ui/settings/", "ui/input/mod.rs"]),
    ("safetensors", &["app", "ui"], &[]),
];

#[test]
fn data_flows_down_the_list_in_lib_rs() {
    let sources = sources(Path::new(env!("CARGO_MANIFEST_DIR")).join("src").as_path());
    let modules_of = |root: &str| {
        let (_, source) =
            sources.iter().find(|(path, _)| path == root).expect("there is a library and a program");
        modules(source)
    };
    let (library, program) = (modules_of("lib.rs"), modules_of("main.rs"));
    assert!(library.contains(&"world".to_owned()), "no modules were found in lib.rs: {library:?}");

    let faults: Vec<String> = sources
        .iter()
        .flat_map(|(path, source)| faults(&library, home(path, &program), path, source))
        .collect();
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// Words of the built-in worlds, which nothing outside their own room knows.
const CAR_WORDS: [&str; 4] = ["steer", "grass", "chuckhole", "wheel"];
/// Where they stand all the same: their own room and files, what reads files of before worlds were described, the traces that
/// are compared with Python's, and the authors' settings.
const CAR_PLACES: [&str; 9] = [
    "world/cars/",
    "world/builtin.rs",
    "dataset/legacy.rs",
    "ui/settings/",
    "ui/input/",
    "simulate/fit_probe/car.rs",
    "planner/mod.rs",
    "cli/trace.rs",
    "session/event.rs",
];

#[test]
fn outside_their_room_nothing_knows_the_cars() {
    let sources = sources(Path::new(env!("CARGO_MANIFEST_DIR")).join("src").as_path());
    assert!(sources.len() > 100, "the sources were found");
    let mut met = Vec::new();
    for (path, source) in &sources {
        if CAR_PLACES.iter().any(|place| path.starts_with(place)) || path.ends_with("tests.rs") {
            continue;
        }
        // Tests and examples may drive what they like.
        let code = source.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        let code = code.lines().filter(|line| !line.trim_start().starts_with("//"));
        let named = code.filter(|line| CAR_WORDS.iter().any(|word| line.to_lowercase().contains(word)));
        met.extend(named.map(|line| format!("{path}: {}", line.trim())));
    }
    assert!(met.is_empty(), "\n{}\n", met.join("\n"));
}

/// All Rust files under `src`, with their paths from there.
fn sources(src: &Path) -> Vec<(String, String)> {
    let mut folders = vec![src.to_owned()];
    let mut sources = vec![];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("the folder can be listed") {
            let path = entry.expect("the folder can be listed").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(src).expect("it lies in src").to_string_lossy().into_owned();
                sources.push((name, fs::read_to_string(&path).expect("the file is text")));
            }
        }
    }
    sources.sort();
    sources
}

/// The modules that `lib` declares, in its order.
fn modules(lib: &str) -> Vec<String> {
    let code = code_of(lib);
    let words: Vec<&str> = code.split_whitespace().collect();
    words
        .windows(2)
        .filter(|pair| pair[0] == "mod")
        .filter_map(|pair| pair[1].strip_suffix(';'))
        .map(str::to_owned)
        .collect()
}

/// The module that the file at `path` is part of; the program's own count as `main`.
fn home<'a>(path: &'a str, program: &[String]) -> &'a str {
    let module = path.split('/').next().expect("a path has a start").trim_end_matches(".rs");
    if program.iter().any(|own| own == module) { "main" } else { module }
}

/// What the file at `path`, part of `home`, names and should not.
fn faults(modules: &[String], home: &str, path: &str, source: &str) -> Vec<String> {
    if ["lib", "build"].contains(&home) {
        return vec![];
    }
    let place = |module: &str| modules.iter().position(|listed| listed == module);
    let mut faults = vec![];
    let mut fault = |what: String| faults.push(format!("src/{path} {what}"));

    let code = code_of(source);
    if home != "main" {
        match place(home) {
            None => fault(format!("is in no build: lib.rs does not list `{home}`")),
            Some(own) => {
                for name in names_in(&code, "crate") {
                    match place(&name) {
                        Some(other) if other <= own => (),
                        Some(_) => fault(format!("names `crate::{name}`, which lib.rs lists after `{home}`")),
                        None => fault(format!("names `crate::{name}`, which lib.rs does not list")),
                    }
                }
            }
        }
    }
    for (name, homes) in RESERVED {
        if uses(&code, name) && !homes.contains(&home) {
            fault(format!("names `{name}`, which only {} may", homes.join(" and ")));
        }
    }
    for (name, barred, exempt) in BARRED {
        let is_exempt = exempt.iter().any(|place| path.starts_with(place));
        if uses(&code, name) && barred.contains(&home) && !is_exempt {
            fault(format!("names `{name}`, which `{home}` must do without"));
        }
    }
    faults
}

/// Whether `code` uses the crate, or the module of a crate, called `name`.
fn uses(code: &str, name: &str) -> bool {
    match name.split_once("::") {
        Some((root, module)) => names_in(code, root).contains(module),
        None => words(code).any(|(_, word)| word == name),
    }
}

/// What follows `root::` anywhere in `code`, be it one name or a list in braces.
fn names_in(code: &str, root: &str) -> BTreeSet<String> {
    let first_word = |text: &str| words(text).next().map(|(_, word)| word.to_owned());
    let mut names = BTreeSet::new();
    for (at, _) in words(code).filter(|(_, word)| *word == root) {
        let Some(rest) = code[at + root.len()..].trim_start().strip_prefix("::") else { continue };
        let rest = rest.trim_start();
        let Some(list) = rest.strip_prefix('{') else {
            names.extend(first_word(rest));
            continue;
        };
        let mut depth = 0;
        let end = list.find(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            depth < 0
        });
        for part in split_at_commas(&list[..end.unwrap_or(list.len())]) {
            names.extend(first_word(part));
        }
    }
    names
}

/// The parts between the commas that are in no braces.
fn split_at_commas(list: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0;
    list.split(move |c| {
        depth += i32::from(c == '{') - i32::from(c == '}');
        c == ',' && depth == 0
    })
}

/// The identifiers and keywords in `code`, each with its place.
fn words(code: &str) -> impl Iterator<Item = (usize, &str)> {
    code.split(|c: char| !(c.is_alphanumeric() || c == '_'))
        .filter(|word| !word.is_empty())
        .map(|word| (word.as_ptr().addr() - code.as_ptr().addr(), word))
}

/// `source` without its comments and without what stands in quotes.
fn code_of(source: &str) -> String {
    let mut code = String::new();
    let mut rest = source;
    while let Some(first) = rest.chars().next() {
        let skipped = comment_len(rest).or_else(|| quote_len(rest, &code)).unwrap_or(0);
        code.push(if skipped > 0 { ' ' } else { first });
        rest = &rest[skipped.max(first.len_utf8())..];
    }
    code
}

/// The length of the comment that `text` starts with.
fn comment_len(text: &str) -> Option<usize> {
    if text.starts_with("//") {
        return Some(text.find('\n').unwrap_or(text.len()));
    }
    text.starts_with("/*").then_some(())?;
    let mut depth = 0; // they nest
    for at in 0..text.len() {
        match text.as_bytes().get(at..at + 2) {
            Some(b"/*") => depth += 1,
            Some(b"*/") => depth -= 1,
            _ => continue,
        }
        if depth == 0 {
            return Some(at + 2);
        }
    }
    Some(text.len())
}

/// The length of the string or character that `text` starts with, after `code`.
fn quote_len(text: &str, code: &str) -> Option<usize> {
    if let Some(rest) = text.strip_prefix('\'') {
        let second = rest.chars().next()?;
        let escaped = usize::from(second == '\\');
        let body = 1 + escaped + rest[escaped..].chars().next()?.len_utf8();
        // A lifetime has no second quote; `'\u{1F600}'` has one further on.
        return match text[body..].find('\'') {
            Some(0) => Some(body + 1),
            Some(more) if escaped == 1 => Some(body + more + 1),
            _ => None,
        };
    }
    let hashes = text.strip_prefix('r').map(|raw| raw.len() - raw.trim_start_matches('#').len());
    let in_word = code.ends_with(|c: char| c.is_alphanumeric() || c == '_') && !code.ends_with('b');
    match hashes {
        Some(n) if text[1 + n..].starts_with('"') && !in_word => {
            let open = n + 2;
            let close = format!("\"{}", "#".repeat(n));
            Some(text[open..].find(&close).map_or(text.len(), |at| open + at + close.len()))
        }
        _ if text.starts_with('"') => {
            let mut escaped = false;
            let end = text[1..].find(|c| {
                let closes = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                closes
            });
            Some(end.map_or(text.len(), |at| at + 2))
        }
        _ => None,
    }
}

/// The faults of one file in a crate of three modules.
fn faults_in(path: &str, source: &str) -> Vec<String> {
    let modules = ["world", "query", "ui"].map(str::to_owned);
    faults(&modules, home(path, &["cli".to_owned()]), path, source)
}

#[test]
fn a_module_may_name_itself_and_those_before_it() {
    let source = "use crate::world::Frame;\nuse crate::query::{Label, label::Weights};\n";
    assert_eq!(faults_in("query/mod.rs", source), [""; 0], "world comes first, query is itself");
}

#[test]
fn a_module_must_not_name_one_after_it() {
    for source in ["use crate::ui::App;", "fn f(a: &crate :: ui::App) {}", "use crate::{world::Frame, ui};"] {
        assert_eq!(
            faults_in("query/label.rs", source),
            ["src/query/label.rs names `crate::ui`, which lib.rs lists after `query`"],
            "{source}"
        );
    }
}

#[test]
fn a_module_must_not_name_one_that_is_not_listed() {
    assert_eq!(
        faults_in("ui/mod.rs", "crate::dims!(x)"),
        ["src/ui/mod.rs names `crate::dims`, which lib.rs does not list"]
    );
    assert_eq!(faults_in("run.rs", ""), ["src/run.rs is in no build: lib.rs does not list `run`"]);
}

#[test]
fn outside_names_keep_to_their_homes() {
    for (name, homes) in RESERVED {
        let source = format!("use {name}::x;");
        for home in ["world", "query", "ui", "cli", "main"] {
            let n_faults = usize::from(!homes.contains(&if home == "cli" { "main" } else { home }));
            let faults = faults_in(&format!("{home}.rs"), &source);
            assert_eq!(faults.len(), n_faults, "{home} names {name}: {faults:?}");
        }
    }
    assert_eq!(faults_in("world.rs", "use std::{collections::BTreeMap, io::{Read, fs}, fs::File};").len(), 1);
    assert_eq!(faults_in("world.rs", "use std::{collections::BTreeMap, io::{Read, fs}};"), [""; 0]);
    assert_eq!(faults_in("world.rs", "let threads = egui_like::thread(std::fsx);"), [""; 0]);
}

#[test]
fn plain_data_does_without_tensors() {
    assert_eq!(faults_in("world/frame.rs", "fn f(t: &tch::Tensor) {}").len(), 1);
    assert_eq!(faults_in("ui/frame.rs", "fn f(t: &tch::Tensor) {}").len(), 1);
    let source = "fn f(t: &tch::Tensor) {}";
    assert_eq!(faults(&["planner".to_owned()], "planner", "planner/mod.rs", source), [""; 0]);
}

#[test]
fn the_application_has_no_clock_and_the_window_no_generator() {
    let modules = ["app", "ui"].map(str::to_owned);
    let faults_in = |path: &str, source: &str| faults(&modules, home(path, &[]), path, source);
    for (path, source) in [
        ("app/label/mod.rs", "use std::time::Instant;"),
        ("app/label/mod.rs", "use eframe::NativeOptions;"),
        ("app/label/mod.rs", "std::thread::sleep(moment);"),
        ("app/label/mod.rs", "let bytes = std::fs::read(path);"),
        ("app/label/mod.rs", "let store = SessionStore::open(path, None);"),
        ("ui/label/mod.rs", "use rand::SeedableRng as _;"),
        ("ui/label/mod.rs", "use crate::app::SessionStore;"),
        ("ui/label/mod.rs", "#[derive(serde::Serialize)] struct State;"),
    ] {
        assert_eq!(faults_in(path, source).len(), 1, "{path}: {source}");
    }
    let settings = "#[derive(serde::Serialize)] struct Preferences;";
    assert_eq!(faults_in("ui/settings/preferences.rs", settings), [""; 0], "a person's settings are kept");
}

#[test]
fn comments_and_quotes_name_nothing() {
    for silent in [
        "// use crate::ui;",
        "/// [`crate::ui`]\nfn f() {}",
        "/* /* crate::ui */ crate::ui */",
        r#"let s = "crate::ui \" crate::ui";"#,
        r##"let s = r#"crate::ui " crate::ui"#;"##,
        r#"let s = br"crate::ui\";"#,
    ] {
        assert_eq!(faults_in("world.rs", silent), [""; 0], "{silent}");
    }
    for telling in [
        "// a comment ends\nuse crate::ui;",
        "/* a comment ends */ use crate::ui;",
        r#"let url = "https://x"; crate::ui::f();"#,
        r"let quote = '\''; crate::ui::f();",
        r"let quote = '\u{22}'; crate::ui::f();",
        "let quote = '\"'; crate::ui::f('\"');",
        "fn f<'a>(x: &'a crate::ui::X) -> &'a str {}",
        "for r in r#\"\"#.chars() { crate::ui::f() }",
    ] {
        assert_eq!(faults_in("world.rs", telling).len(), 1, "{telling}");
    }
}

#[test]
fn the_order_is_read_from_declarations_only() {
    let lib =
        "//! mod nothing;\npub mod env;   pub mod query;\n#[cfg(unix)]\nmod ui;\npub fn f() {}\nmod tests {}";
    assert_eq!(modules(lib), ["env", "query", "ui"], "comments and inline modules are no part of it");
}
