//! `compare`: results as they come, from this program, a later one, a hand, or a disk that was full.

use std::path::Path;

use crate::program::{Ran, dropj};

fn line(track: u32, ret: &str) -> String {
    let rates = r#""car_rate": null, "chuckhole_rate": null, "finished": true, "grass_rate": 0.0"#;
    let times = r#""n_steps": 1000, "new_tile_rate": 1.0, "plan_ms_max": 1.0, "plan_ms_mean": 1.0"#;
    format!(r#"{{"metrics": {{{rates}, {times}, "ret": {ret}}}, "track": {track}}}"#)
}

fn lines(returns: &[&str]) -> String {
    let lines = (0..).zip(returns).map(|(track, ret)| line(track, ret) + "\n");
    lines.collect()
}

/// Compares files with these names and bytes.
fn compare(dir: &Path, files: &[(&str, &[u8])], options: &[&str]) -> Ran {
    for (name, bytes) in files {
        let path = dir.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    let names = files.iter().map(|(name, _)| *name);
    dropj(dir, ["compare"].into_iter().chain(names).chain(options.iter().copied()))
}

const ONE: [&str; 5] = ["1", "2", "3", "4", "5"];
const OTHER: [&str; 5] = ["6", "7", "8", "9", "10"];

#[test]
fn results_are_read_however_they_are_stored() {
    let dir = tempfile::tempdir().unwrap();
    let (one, other) = (lines(&ONE), lines(&OTHER));
    let wanted = compare(dir.path(), &[("a.json", one.as_bytes()), ("b.json", other.as_bytes())], &[]);
    let wanted = wanted.succeeded();
    assert!(wanted.contains("return: Kruskal–Wallis H(1) = 6.818"), "{wanted}");
    let utf16: Vec<u8> =
        [0xfeff].into_iter().chain(other.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let list = format!("[{}]", other.trim_end().replace('\n', ","));
    for bytes in [
        format!("\u{feff}{other}").into_bytes(),
        other.replace('\n', "\r\n").into_bytes(),
        utf16,
        list.into_bytes(),
        other.replace("\"ret\"", "\"new\": [1], \"ret\"").into_bytes(),
    ] {
        let ran = compare(dir.path(), &[("a.json", one.as_bytes()), ("b.json", &bytes)], &[]);
        assert_eq!((ran.succeeded(), ran.err.as_str()), (wanted, ""));
    }
}

#[test]
fn what_is_not_whole_is_passed_over_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let one = lines(&ONE);
    let torn = format!("track 0: return 5\n{}{}", lines(&OTHER), &line(5, "11")[..20]);
    let ran = compare(dir.path(), &[("a.json", one.as_bytes()), ("b.json", torn.as_bytes())], &[]);
    assert!(ran.succeeded().contains("Dunn"), "{ran:?}");
    assert!(ran.err.contains("b: its last line is cut short"), "{ran:?}");
    assert!(ran.err.contains("b: 1 piece that is no result is passed over: track 0: return 5"), "{ran:?}");
    let odd = lines(&["null", "1e39", "3", "4", "5", "6"]);
    let ran = compare(dir.path(), &[("a.json", one.as_bytes()), ("b.json", odd.as_bytes())], &[]);
    assert!(
        ran.err.contains("b: track 0: ret is missing") && ran.err.contains("b: track 1: ret is 1e"),
        "{ran:?}"
    );
    assert!(ran.succeeded().contains("b              6   4 ± 1") && !ran.out.contains("inf"), "{ran:?}");
    let twice = format!("{one}{one}");
    let ran = compare(dir.path(), &[("a.json", twice.as_bytes()), ("b.json", lines(&OTHER).as_bytes())], &[]);
    assert!(
        ran.succeeded().contains("H(1) = 6.818") && ran.err.contains("5 of its episodes stand there twice")
    );
}

#[test]
fn a_file_without_episodes_is_refused_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let one = lines(&ONE);
    for (bytes, why) in [
        (&b""[..], "they are empty"),
        (b"\xef\xbb\xbf\n", "they are empty"),
        (b"{\"summary\":{}}", "there is only the summary"),
        (b"track 0: return 5", "no result is passed over: track 0"),
        (b"{\"metrics\":", "cut short"),
        (b"[1, 2]", "2 pieces that are no results"),
    ] {
        let ran = compare(dir.path(), &[("a.json", one.as_bytes()), ("none.json", bytes)], &[]);
        let line = ran.refused();
        assert!(line.contains(why) && line.contains("none.json"), "{line}");
    }
    let ran = dropj(dir.path(), ["compare", "a.json", "nowhere.json"]);
    assert!(ran.refused().contains("nowhere.json"), "{ran:?}");
}

#[test]
fn methods_are_called_unmistakably() {
    let dir = tempfile::tempdir().unwrap();
    let (one, other) = (lines(&ONE), lines(&OTHER));
    let ran = compare(dir.path(), &[("x/r.json", one.as_bytes()), ("y/r.json", other.as_bytes())], &[]);
    assert!(ran.succeeded().contains("x/r.json – y/r.json: Dunn"), "{ran:?}");
    let files = [("a b,c\"d.json", one.as_bytes()), ("two\nlines.json", other.as_bytes())];
    let ran = compare(dir.path(), &files, &[]);
    assert!(ran.succeeded().contains("a b,c\"d – two\\nlines: Dunn"), "{ran:?}");
    let ran = compare(dir.path(), &files, &["--json"]);
    let first = ran.succeeded().lines().next().unwrap();
    let first: serde_json::Value = serde_json::from_str(first).unwrap();
    assert_eq!(first["methods"], serde_json::json!(["a b,c\"d", "two\nlines"]));
    let ran = dropj(dir.path(), ["compare", "x/r.json", "x/../x/r.json"]);
    assert!(ran.err.contains("r and r (2) hold the same episodes"), "{ran:?}");
}

#[test]
fn why_a_test_could_not_be_made_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let same = lines(&["1"; 5]);
    let again = same.replace("\"plan_ms_mean\": 1.0", "\"plan_ms_mean\": 2.0");
    let ran = compare(dir.path(), &[("a.json", same.as_bytes()), ("b.json", again.as_bytes())], &[]);
    assert!(ran.succeeded().contains("return: not tested, for all values are equal (1)"), "{ran:?}");
    let ran = compare(dir.path(), &[("a.json", same.as_bytes()), ("b.json", again.as_bytes())], &["--json"]);
    assert!(ran.succeeded().contains("\"untested\":\"all values are equal (1)\""), "{ran:?}");
    let (one, other) = (lines(&["1"]), lines(&["2"]));
    let ran = compare(dir.path(), &[("a.json", one.as_bytes()), ("b.json", other.as_bytes())], &[]);
    assert!(ran.succeeded().contains("return: not tested, for each method has one value"), "{ran:?}");
    let missing = lines(&["null"; 5]);
    let ran =
        compare(dir.path(), &[("a.json", missing.as_bytes()), ("b.json", lines(&OTHER).as_bytes())], &[]);
    assert!(ran.succeeded().contains("return: not tested, for a has no value of it"), "{ran:?}");
    let few = lines(&["1", "2"]);
    let ran = compare(dir.path(), &[("a.json", few.as_bytes()), ("b.json", lines(&OTHER).as_bytes())], &[]);
    assert!(
        ran.succeeded().contains("a has 2 values: with fewer than 5 these probabilities are rough"),
        "{ran:?}"
    );
}
