//! Numbers on the command line: each has its range, and what lies outside is refused before anything is begun.

use crate::program::dropj;

/// Runs the program in an empty folder, which must stay empty, and returns what it refused.
#[track_caller]
fn refused(args: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    let ran = dropj(dir.path(), args.split(' '));
    let line = ran.refused().to_owned();
    let left: Vec<_> = std::fs::read_dir(dir.path()).unwrap().collect();
    assert!(left.is_empty(), "{args} left {left:?}");
    line
}

// The table of all numbers is tested where the command line is parsed, in `src/cli/mod.rs`.

#[test]
fn whole_numbers_lie_in_their_range() {
    for (args, option) in [
        ("simulate --out X --queries 0", "--queries"),
        ("simulate --out X --steps 5", "--steps"),
        ("simulate --out X --seed 18446744073709551616", "--seed"),
        ("record --out X --first 18446744073709551615", "--first"),
        ("deploy --straight-on --episodes 18446744073709551615", "--episodes"),
        ("check-world --data X --world Y --stretches 0", "--stretches"),
        ("refit --session X --updates -1", "-1"),
    ] {
        let line = refused(args);
        assert!(line.contains(option), "{args}: {line}");
    }
}

#[test]
fn what_is_no_number_is_none() {
    for args in [
        "simulate --out X --beta=NaN",
        "simulate --out X --gamma=0",
        "simulate --out X --eps-mistake=2",
        "simulate --out X --care=inf",
        "deploy --straight-on --brake NaN",
        "fit-world --data X --out Y --emphasis inf",
        "refit --session X --held-out 1",
    ] {
        assert!(refused(args).contains("it must be a number"), "{args}");
    }
}

#[test]
fn weights_lie_above_a_half_and_at_most_at_one() {
    for args in [
        "refit --session X --safety 0.5",
        "refit --session X --weights grass",
        "simulate --out X --weights grass=NaN",
    ] {
        assert!(refused(args).contains("weight"), "{args}");
    }
    let twice = refused("simulate --out X --weights grass=1,grass=0.9,default=0.8");
    assert!(twice.contains("named twice"), "{twice}");
}

#[test]
fn numbers_fit_each_other() {
    for (args, wanted) in [
        ("simulate --out X --queries 4 --undo 5", "5 answers cannot be taken back where there are 4"),
        ("simulate --out X --dreams 10000 --steps 1000000", "more than the 10000000 steps"),
        ("simulate --out X --dreams 2 --rounds 3", "with 2 dreams there are 1 to 2 rounds"),
        ("simulate --out X --protocol dros --rounds 2", "rounds are for preferences"),
        ("simulate --out X --protocol dros,dropj", "name one protocol"),
    ] {
        let line = refused(args);
        assert!(line.contains(wanted), "{args}: {line}");
    }
}

#[test]
fn names_of_protocols_and_ways_are_listed_where_another_is_given() {
    for (args, listed) in [
        ("simulate --out X --protocol sing", "dropj-multi"),
        ("simulate --out X --choice sing", "disagreement"),
        ("simulate --out X --manner sing", "touring"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let ran = dropj(dir.path(), args.split(' '));
        assert!(ran.refused().contains("sing") && ran.err.contains(listed), "{args}: {ran:?}");
    }
    let dir = tempfile::tempdir().unwrap();
    let ran = dropj(dir.path(), ["simulate", "--out", "X", "--annotator", " "]);
    assert!(ran.refused().contains("a name is needed"), "{ran:?}");
}

#[test]
fn the_greatest_seed_is_as_good_as_any() {
    let dir = tempfile::tempdir().unwrap();
    let seed = u64::MAX.to_string();
    let ran = dropj(dir.path(), ["deploy", "--straight-on", "--episodes", "2", "--seed", &seed, "--json"]);
    let out = ran.succeeded();
    assert!(out.contains(&format!("\"track\":{seed}")) && out.contains("\"track\":0"), "{out}");
}
