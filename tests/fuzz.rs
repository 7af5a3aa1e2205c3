//! Every file that the program reads, damaged and crafted in a thousand ways: it is read or refused, never more.
//!
//! Inputs are mutations of what the program itself wrote: of bytes, of numbers in text, of whole pieces, and with
//! checksums and lengths put right again, so that what lies behind them is reached. A panic fails the test, and `proptest`
//! makes the input as small as it can; what was found so is a test of its own by now, beside the code that was wrong.
//! Memory is bounded: a process that has grown by more than [`MOST_MIB`] has believed a number.
//!
//! `.ci/fuzz` runs each for as many inputs as one likes (`FUZZ_INPUTS`); beside the other tests it is a few hundred.

#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a failing test may panic, and a long one says how many inputs it had"
)]

#[path = "fuzz/corpus.rs"]
mod corpus;
#[path = "fuzz/mutation.rs"]
mod mutation;
#[path = "support/mod.rs"]
#[expect(dead_code, reason = "the road is used, and nobody who answers")]
mod support;

use dropj::dataset::Dataset;
use dropj::evaluation::Results;
use dropj::reward::LearnedReward;
use dropj::session::{Header, SessionStore};
use dropj::simulate::probe::Probe;
use dropj::tensor::Parameters;
use dropj::ui::{Preferences, SettingsFile};
use dropj::world_model::WorldModel;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use mutation::mutations;

/// Inputs of each target, where nobody says otherwise.
const N_INPUTS: u32 = 300;
/// By how many MiB a process may grow over all its inputs.
const MOST_MIB: u64 = 600;

/// Tries `read` on mutations of `corpus`; `mend` puts lengths and checksums right in half of them.
fn fuzz(name: &str, corpus: &[Vec<u8>], cost: u32, mend: fn(&mut [u8]), read: impl Fn(&[u8]) -> bool) {
    let asked: Option<u32> = std::env::var("FUZZ_INPUTS").ok().map(|text| text.parse().unwrap());
    let n_inputs = (asked.unwrap_or(N_INPUTS) / cost).max(20);
    for bytes in corpus {
        assert!(read(bytes), "{name}: what the program wrote is read");
    }
    let before = resident_mib();
    let config =
        Config { cases: n_inputs, failure_persistence: None, max_shrink_iters: 20_000, ..Config::default() };
    let mut runner = match std::env::var("FUZZ_SEED") {
        Ok(seed) => {
            let mut bytes = [0; 32];
            bytes[..8].copy_from_slice(&seed.parse::<u64>().unwrap().to_le_bytes());
            TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes))
        }
        Err(_) => TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha)),
    };
    let n_read = std::cell::Cell::new(0u32);
    let inputs = (0..corpus.len(), mutations(), any::<bool>());
    let tried = runner.run(&inputs, |(which, mutations, is_mended)| {
        let mut bytes = corpus[which].clone();
        for mutation in &mutations {
            mutation.apply(&mut bytes, corpus);
        }
        if is_mended {
            mend(&mut bytes);
        }
        n_read.set(n_read.get() + u32::from(read(&bytes)));
        Ok(())
    });
    if let Err(error) = tried {
        panic!("{name}: {error}");
    }
    let grown = resident_mib().saturating_sub(before);
    println!("{name}: {n_inputs} inputs, {} of them read, {grown} MiB more at the most", n_read.get());
    assert!(grown < MOST_MIB, "{name}: the process grew by {grown} MiB");
}

/// The most memory that this process has had, in MiB.
fn resident_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = peak.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) / 1024
}

fn as_it_is(_: &mut [u8]) {}

#[test]
fn fuzz_worlds() {
    let read = |bytes: &[u8]| Parameters::from_bytes(bytes).is_ok_and(|file| WorldModel::load(file).is_ok());
    fuzz("worlds", &corpus::worlds(), 4, mutation::mend_safetensors, read);
}

#[test]
fn fuzz_rewards() {
    let model = corpus::model();
    let read = |bytes: &[u8]| {
        Parameters::from_bytes(bytes).is_ok_and(|file| LearnedReward::load(&file, &model).is_ok())
    };
    fuzz("rewards", &corpus::rewards(), 2, mutation::mend_safetensors, read);
}

#[test]
fn fuzz_probes() {
    let read = |bytes: &[u8]| Parameters::from_bytes(bytes).is_ok_and(|file| Probe::load(&file).is_ok());
    fuzz("probes", &corpus::probes(), 10, mutation::mend_safetensors, read);
}

#[test]
fn fuzz_dreams() {
    let read = |bytes: &[u8]| dropj::session::arrays::dream_from_bytes(bytes).is_ok();
    fuzz("dreams", &corpus::dreams(), 1, mutation::mend_safetensors, read);
}

/// A folder in memory where the system has one: a fuzzer writes a lot.
fn folder() -> tempfile::TempDir {
    let memory = std::path::Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

#[test]
fn fuzz_event_logs() {
    let dir = folder();
    let session = dir.path().join("s");
    corpus::session(&session);
    let log = session.join("events.jsonl");
    let whole = std::fs::read(&log).unwrap();
    let read = |bytes: &[u8]| {
        std::fs::write(&log, bytes).unwrap();
        SessionStore::read_reward(&session).is_ok_and(|(session, _)| {
            // Whoever has read a log shows it.
            session.statistics();
            session.labeled();
            session.undoable();
            true
        })
    };
    fuzz("event logs", &[whole], 1, as_it_is, read);
}

#[test]
fn fuzz_session_headers() {
    let dir = folder();
    let session = dir.path().join("s");
    corpus::session(&session);
    let header = session.join("session.json");
    let whole = std::fs::read(&header).unwrap();
    let read = |bytes: &[u8]| {
        std::fs::write(&header, bytes).unwrap();
        Header::read(&session).is_ok_and(|header| !header.folder_name().is_empty())
    };
    fuzz("session headers", &[whole], 1, as_it_is, read);
}

#[test]
fn fuzz_sealed_episodes() {
    let dir = folder();
    let [sealed, _] = corpus::episodes(dir.path());
    let path = dir.path().join("data/chunk-000/file-000.parquet");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        Dataset::open(dir.path()).is_ok_and(|dataset| !dataset.is_empty() && dataset.episode(0).is_ok())
    };
    fuzz("sealed episodes", &[sealed], 2, mutation::mend_parquet, read);
}

#[test]
fn fuzz_recordings_in_their_journal() {
    let dir = folder();
    let [_, journal] = corpus::episodes(dir.path());
    let path = dir.path().join("journal/00000.journal");
    let read = |bytes: &[u8]| {
        std::fs::remove_dir_all(dir.path().join("journal")).unwrap();
        std::fs::create_dir(dir.path().join("journal")).unwrap();
        std::fs::write(&path, bytes).unwrap();
        Dataset::create_or_open(dir.path(), "dummy-road")
            .is_ok_and(|dataset| !dataset.unfinished().is_empty())
    };
    fuzz("recordings in their journal", &[journal], 20, as_it_is, read);
}

#[test]
fn fuzz_comparison_files() {
    let read = |bytes: &[u8]| !Results::parse(bytes).episodes.is_empty();
    fuzz("comparison files", &corpus::comparisons(), 1, as_it_is, read);
}

#[test]
fn fuzz_settings() {
    let written = Preferences::default().text();
    assert!(Preferences::read(&written).1.is_empty(), "what the program wrote has no problems");
    let read = |bytes: &[u8]| {
        let (preferences, problems) = Preferences::read(&String::from_utf8_lossy(bytes));
        // What was taken is written so that it is read again.
        let again = Preferences::read(&preferences.text());
        assert_eq!(again.0.text(), preferences.text(), "{problems:?}");
        let _ = SettingsFile::of(bytes);
        problems.is_empty()
    };
    fuzz("settings", &[written.into_bytes()], 4, as_it_is, read);
}
