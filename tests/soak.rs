//! Dreaming, labeling, fitting, driving and recording over and over, through the real window with its real threads: what
//! the program holds on to must not grow.
//!
//! `.ci/soak` runs it for two hours and draws what was measured; beside the other tests it takes some seconds.
//! Measured is the whole process: resident memory, threads, open files.

#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a failing test may panic, and a long one says how far it is"
)]

#[path = "support/real_window.rs"]
mod real_window;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dropj::app::Panel;
use dropj::ui::Window;
use eframe::egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::{self, NodeT as _, Queryable as _};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use real_window::{FRAME, real_window};

/// For how long, where nobody says otherwise.
const MINUTES: f64 = 0.3;
/// Steps of a dream.
const DREAM_SECS: f32 = 2.5;
/// Queries of a session.
const N_ANSWERS: usize = 20;
/// How long anything may take.
const PATIENCE: Duration = Duration::from_mins(2);
/// Sessions that are kept on disk.
const N_KEPT: usize = 4;

/// What the process holds on to.
#[derive(Clone, Copy, Debug)]
struct Sample {
    secs: f64,
    n_answers: usize,
    rss_mib: f64,
    n_threads: usize,
    n_files: usize,
}

impl Sample {
    fn now(since: Instant, n_answers: usize) -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let of = |key: &str| -> usize {
            let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap();
            line.split_whitespace().next().unwrap().parse().unwrap()
        };
        Self {
            secs: since.elapsed().as_secs_f64(),
            n_answers,
            rss_mib: of("VmRSS:") as f64 / 1024.0,
            n_threads: of("Threads:"),
            n_files: std::fs::read_dir("/proc/self/fd").unwrap().count(),
        }
    }
}

#[test]
fn a_soak_leaves_memory_threads_and_files_as_they_were() {
    if !Path::new("/proc/self/status").exists() {
        println!("SKIPPED: there is no /proc here to measure by");
        return;
    }
    let minutes: f64 = std::env::var("SOAK_MINUTES").map_or(MINUTES, |text| text.parse().unwrap());
    let table = std::env::var_os("SOAK_TABLE").map(PathBuf::from);
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    let mut soak = Soak::begin(dir.path());
    let since = Instant::now();
    let mut samples = Vec::new();
    while samples.len() < 2 || since.elapsed().as_secs_f64() < 60.0 * minutes {
        soak.round(samples.len());
        samples.push(Sample::now(since, soak.n_answers));
        let last = samples[samples.len() - 1];
        println!("{last:?}");
        if let Some(path) = &table {
            std::fs::write(path, csv(&samples)).unwrap();
        }
    }
    // The first rounds fill what is filled once: buffers, caches, the allocator's arenas.
    let n = samples.len();
    let (early, late) = if n < 8 {
        (&samples[..1], &samples[n - 1..])
    } else {
        (&samples[n / 4..n / 2], &samples[3 * n / 4..])
    };
    let mean = |of: &[Sample], what: fn(&Sample) -> f64| of.iter().map(what).sum::<f64>() / of.len() as f64;
    let memory = [early, late].map(|of| mean(of, |sample| sample.rss_mib));
    let threads = [early, late].map(|of| mean(of, |sample| sample.n_threads as f64));
    let files = [early, late].map(|of| mean(of, |sample| sample.n_files as f64));
    println!(
        "memory {memory:.1?} MiB, threads {threads:.2?}, files {files:.2?}: early and late, of {n} rounds"
    );
    // It takes a dozen rounds until they are full: only of a long run the growth is that of what is lost.
    let allowed = if n < 100 { 200.0 } else { 24.0 };
    assert!(memory[1] - memory[0] < allowed, "memory grew from {:.1} to {:.1} MiB", memory[0], memory[1]);
    assert!(threads[1] - threads[0] < 1.0, "threads grew from {:.2} to {:.2}", threads[0], threads[1]);
    assert!(files[1] - files[0] < 2.0, "open files grew from {:.2} to {:.2}", files[0], files[1]);
}

fn csv(samples: &[Sample]) -> String {
    let mut text = "secs,answers,rss_mib,threads,files\n".to_owned();
    for Sample { secs, n_answers, rss_mib, n_threads, n_files } in samples {
        writeln!(text, "{secs:.0},{n_answers},{rss_mib:.1},{n_threads},{n_files}").unwrap();
    }
    text
}

/// The window, and what was done in it.
struct Soak {
    window: Harness<'static, Window>,
    dir: PathBuf,
    rng: ChaCha8Rng,
    n_answers: usize,
}

impl Soak {
    fn begin(dir: &Path) -> Self {
        let mut soak = Self {
            window: real_window(dir, None),
            dir: dir.to_owned(),
            rng: ChaCha8Rng::seed_from_u64(0),
            n_answers: 0,
        };
        soak.wait("the world model", |window| window.query_by_label("Begin").is_some());
        soak
    }

    /// A session from its first dream to a drive by its reward.
    fn round(&mut self, number: usize) {
        self.new_session();
        for dream in 1..=2 {
            self.dream(dream);
        }
        self.label();
        self.fit();
        self.drive();
        self.record(number < N_KEPT);
        self.go(Panel::Dream);
        self.forget_old();
    }

    fn new_session(&mut self) {
        let before = self.window.state().app().open().map(|store| store.dir().to_owned());
        self.window.get_by_label("Sessions…").click();
        self.steps(10);
        self.window.get_by_label("DROPJ").click();
        self.wait("a new session", |window| {
            let now = window.state().app().open().map(|store| store.dir().to_owned());
            now.is_some() && now != before
        });
    }

    fn dream(&mut self, n_kept: usize) {
        self.go(Panel::Dream);
        self.press(Key::Enter);
        let side = if self.rng.random_bool(0.5) { Key::ArrowLeft } else { Key::ArrowRight };
        self.window.key_down(Key::ArrowUp);
        self.pause(DREAM_SECS / 2.0);
        self.window.key_down(side);
        self.pause(DREAM_SECS / 2.0);
        self.window.key_up(side);
        self.window.key_up(Key::ArrowUp);
        self.press(Key::U);
        self.press(Key::N);
        self.wait("a dream that was kept", |window| {
            window.state().app().open().unwrap().session().dreams().len() == n_kept
        });
    }

    fn label(&mut self) {
        self.go(Panel::Label);
        let keys = [Key::A, Key::D, Key::S, Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight, Key::Space];
        for n in 1..=N_ANSWERS {
            self.wait("a pair", |window| window.state().app().shown().is_some());
            self.pause(0.15);
            let key = keys[self.rng.random_range(0..keys.len())];
            self.press(key);
            if n % 7 == 0 {
                self.press(Key::Backspace);
            }
            self.n_answers += 1;
        }
        let n = self.window.state().app().open().unwrap().session().answers().len();
        assert!(n > N_ANSWERS / 2, "{n} answers are on disk");
    }

    fn fit(&mut self) {
        self.go(Panel::Reward);
        self.press(Key::Enter);
        self.wait("a reward", |window| !window.state().app().open().unwrap().session().fits().is_empty());
    }

    fn drive(&mut self) {
        self.go(Panel::Deploy);
        self.press(Key::Enter);
        self.pause(1.5);
        self.press(Key::Escape);
        self.pause(0.3);
    }

    fn record(&mut self, is_kept: bool) {
        self.go(Panel::Record);
        self.press(Key::Enter);
        self.window.key_down(Key::ArrowUp);
        self.pause(1.0);
        self.window.key_up(Key::ArrowUp);
        self.press(if is_kept { Key::N } else { Key::Escape });
        self.pause(0.5);
    }

    /// Lists of sessions grow with the sessions there are.
    fn forget_old(&self) {
        let mut folders: Vec<_> =
            std::fs::read_dir(&self.dir).unwrap().map(|item| item.unwrap().path()).collect();
        folders.retain(|path| path.join("session.json").exists());
        folders.sort_by_key(|path| std::fs::metadata(path).unwrap().modified().unwrap());
        for old in folders.iter().rev().skip(N_KEPT) {
            std::fs::remove_dir_all(old).unwrap();
        }
    }

    fn go(&mut self, panel: Panel) {
        let keys = [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7];
        let key = Panel::ALL.into_iter().zip(keys).find(|(of, _)| *of == panel).unwrap().1;
        self.window.key_press_modifiers(Modifiers::COMMAND, key);
        self.steps(3);
        assert_eq!(self.window.state().app().state().panel(), panel, "{}", self.seen());
    }

    fn press(&mut self, key: Key) {
        self.window.key_press(key);
        self.steps(2);
    }

    fn steps(&mut self, n: usize) {
        for _ in 0..n {
            self.window.step();
            std::thread::sleep(FRAME);
        }
    }

    /// Lets the window run for a while.
    fn pause(&mut self, secs: f32) {
        let until = Instant::now() + Duration::from_secs_f32(secs);
        while Instant::now() < until {
            self.steps(1);
        }
    }

    /// Everything that is written in the window.
    fn seen(&self) -> String {
        let all = self.window.query_all(kittest::By::new().predicate(|_| true));
        let texts =
            all.filter_map(|node| node.accesskit_node().label().or_else(|| node.accesskit_node().value()));
        texts.collect::<Vec<_>>().join(" | ")
    }

    fn wait(&mut self, what: &str, is_there: impl Fn(&Harness<'_, Window>) -> bool) {
        let since = Instant::now();
        while !is_there(&self.window) {
            assert!(since.elapsed() < PATIENCE, "{what} never came: {}", self.seen());
            self.steps(1);
        }
    }
}
