//! `dropj experiment`: named or described grids of trials, on all cores or on a cluster.

use std::collections::{BTreeMap, VecDeque};
use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use dropj::experiment::slurm::ArrayJob;
use dropj::experiment::summary::series;
use dropj::experiment::{
    Description, Evaluation, Evaluations, Folder, Ground, Outcome, Scale, Trial, learned_world, named, names,
    run_trial,
};
use dropj::run::{read_at_most, write_whole};
use dropj::worker::{n_processors, pause};
use serde_json::json;

use super::chosen_world::ChosenWorld;
use super::meter::Meter;
use super::models;
use super::numbers::count;
use super::told::Form;

/// Bytes of a description.
const MOST: u64 = 1 << 20;
/// How often trials are looked after.
const LOOK: Duration = Duration::from_millis(250);
/// How often a cluster is asked.
const ASK: Duration = Duration::from_secs(5);
/// A trial notes how far it is no more often than this.
const NOTE: Duration = Duration::from_secs(2);

#[derive(Debug, clap::Args)]
#[expect(clippy::struct_excessive_bools, reason = "flags of a command line")]
pub(crate) struct Options {
    /// The experiment: one of those that --list tells, or a file that describes one
    #[arg(value_name = "NAME|FILE", required_unless_present_any = ["list", "task", "collect"])]
    experiment: Option<String>,
    /// Tell the named experiments
    #[arg(long)]
    list: bool,
    /// How large: toy takes seconds, quick minutes, full is what is reported
    #[arg(long, value_enum, default_value = "full")]
    scale: ScaleName,
    /// The folder of the run; what was done in it stands, and is gone on with [default: experiments/NAME-SCALE]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Only these seeds, such as 0,1,2 [default: the experiment's]
    #[arg(long, value_delimiter = ',')]
    seeds: Vec<u64>,
    /// Trials that run at a time [default: as many as there are processors]
    #[arg(long, value_parser = count(1..=1024))]
    jobs: Option<usize>,
    /// Print the description, to be changed and used as a file, and do nothing else
    #[arg(long)]
    print: bool,
    /// Submit the trials as an array job to Slurm, follow it, submit again what failed, and put the results together
    #[arg(long)]
    slurm: bool,
    /// With --slurm: a line more for the head of its scripts, such as --slurm-option=--partition=main
    #[arg(long, value_name = "OPTION", requires = "slurm")]
    slurm_option: Vec<String>,
    /// With --slurm: submit and do not wait
    #[arg(long, requires = "slurm")]
    no_wait: bool,
    /// Run one trial of the folder by its number, as a task of an array does
    #[arg(long, value_name = "NUMBER", requires = "out", conflicts_with_all = ["experiment", "slurm"])]
    task: Option<usize>,
    /// Put together what the trials of the folder brought
    #[arg(long, requires = "out", conflicts_with_all = ["experiment", "slurm", "task"])]
    collect: bool,
    #[command(flatten)]
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ScaleName {
    /// Whether it runs at all
    Toy,
    /// A first look
    Quick,
    /// As it is reported
    Full,
}

impl ScaleName {
    fn scale(self) -> Scale {
        match self {
            Self::Toy => Scale::Toy,
            Self::Quick => Scale::Quick,
            Self::Full => Scale::Full,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Toy => "toy",
            Self::Quick => "quick",
            Self::Full => "full",
        }
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    if options.list {
        let all = || names().filter_map(|name| Some((name, named(name)?)));
        let told = all().map(|(name, it)| json!({"name": name, "title": it.title, "paper": it.paper}));
        let told = json!({"experiments": told.collect::<Vec<_>>()});
        let line = |(name, Description { title, paper, .. }): (&str, Description)| {
            let paper = if paper.is_empty() { String::new() } else { format!(" ({paper})") };
            format!("{name:20} {title}{paper}\n")
        };
        return options.form.tell(&told, || all().map(line).collect());
    }
    if let (Some(task), Some(dir)) = (options.task, &options.out) {
        return run_task(&Folder::open(dir)?, task);
    }
    if let (true, Some(dir)) = (options.collect, &options.out) {
        return collect(&Folder::open(dir)?, options.form);
    }
    let description = asked(options)?;
    if options.print {
        print!("{}", description.to_toml());
        return Ok(());
    }
    let world = ChosenWorld::named(&description.world)?;
    description.check_for(&world.spec)?;
    let usual =
        || PathBuf::from("experiments").join(format!("{}-{}", description.name, options.scale.name()));
    let dir = std::path::absolute(options.out.clone().unwrap_or_else(usual))?;
    let folder = Folder::begin(&dir, description)?;
    if options.slurm {
        on_cluster(&folder, options)?;
    } else {
        on_this_machine(&folder, options.jobs)?;
    }
    if options.no_wait {
        return Ok(());
    }
    collect(&folder, options.form)?;
    let missing = folder.missing()?;
    let why = || {
        missing.iter().find_map(|trial| folder.failure(*trial)).unwrap_or_else(|| "it was ended".to_owned())
    };
    anyhow::ensure!(
        missing.is_empty(),
        "{} of the trials came to nothing, the first because: {}; run the same again to try only those",
        missing.len(),
        why()
    );
    Ok(())
}

/// The description that is asked for.
fn asked(options: &Options) -> anyhow::Result<Description> {
    let name = options.experiment.as_deref().unwrap_or_default();
    let mut description =
        if let Some(description) = named(name) { description } else { in_file(Path::new(name))? };
    if !options.seeds.is_empty() {
        description.seeds.clone_from(&options.seeds);
    }
    let description = description.at(options.scale.scale());
    description.check()?;
    Ok(description)
}

/// The description in a file.
fn in_file(path: &Path) -> anyhow::Result<Description> {
    anyhow::ensure!(
        path.exists(),
        "there is no experiment {:?}: named are {}, any other is in a file",
        dropj::text::shown(&path.to_string_lossy()),
        names().collect::<Vec<_>>().join(", ")
    );
    let bytes = read_at_most(path, MOST).with_context(|| format!("cannot read {path:?}"))?;
    let bytes = bytes.with_context(|| format!("no description has more than {MOST} bytes: {path:?}"))?;
    let read = Description::from_toml(&dropj::text::decoded(&bytes));
    read.with_context(|| format!("in the file {path:?}"))
}

/// Runs one trial here, and keeps what it brought.
fn run_task(folder: &Folder, task: usize) -> anyhow::Result<()> {
    let trials = folder.description.trials();
    let n = trials.len();
    let trial = trials
        .into_iter()
        .nth(task)
        .with_context(|| format!("there are trials 0 to {}, and no {task}", n - 1))?;
    if folder.rows_of(task)?.is_some() {
        return Ok(());
    }
    // A processor for each trial: more threads would mostly wait.
    tch::set_num_threads(1);
    match outcome_of(folder, &trial) {
        Ok(outcome) => Ok(folder.keep(task, &outcome)?),
        Err(met) => {
            folder.fail(task, &super::in_words(&met))?;
            Err(met)
        }
    }
}

fn outcome_of(folder: &Folder, trial: &Trial) -> anyhow::Result<Outcome> {
    let description = &folder.description;
    let world = ChosenWorld::named(&description.world)?;
    let open = |aids| world.open(aids).map_err(|met| met.to_string());
    let mut said: Option<Instant> = None;
    let mut on_stage = |(what, done, n): (&'static str, usize, usize)| {
        if said.is_none_or(|said| said.elapsed() >= NOTE) {
            said = Some(Instant::now());
            // What cannot be noted is no reason to stop.
            folder.note(trial.index, &format!("{what}: {done} of {n}")).ok();
        }
        ControlFlow::Continue(())
    };
    let (model, probe, figures) = if let Some(recorded) = trial.recorded {
        let which = (recorded, trial.seed);
        let learned = learned_world(folder.dir(), description, &world.spec, &open, which, &mut on_stage)?;
        (learned.model, learned.probe, learned.figures)
    } else {
        let file = world.named_world_model(description.world_model.as_deref().map(Path::new));
        let model = models::world_model(&file)?;
        let probe = models::probe(None, &file, &world, model.backend())?;
        (model, probe, BTreeMap::new())
    };
    models::require(&model, &world)?;
    probe.require(&model)?;
    let ground = Ground { spec: &world.spec, model: &model, probe: &probe, open: &open };
    let mut keep =
        |all: &[Evaluation]| folder.keep_evaluations(trial.index, all).map_err(|met| met.to_string());
    let mut evaluations = Evaluations { known: folder.evaluations(trial.index)?, keep: &mut keep };
    let mut outcome = run_trial(description, trial, &ground, &mut evaluations, &mut on_stage)?;
    outcome.rows.iter_mut().for_each(|row| row.world_model.clone_from(&figures));
    Ok(outcome)
}

fn collect(folder: &Folder, form: Form) -> anyhow::Result<()> {
    let words = folder.collect()?;
    let rows = folder.rows()?;
    let mut measures = serde_json::Map::new();
    for measure in rows.measures() {
        let all = series(&folder.description, &rows, &measure).into_iter().map(|(name, points)| {
            let points = points.iter().map(|point| {
                let [mean, low, high] = point.mean;
                json!({"x": point.x, "mean": mean, "low": low, "high": high, "seeds": point.of_seeds})
            });
            json!({"series": name, "points": points.collect::<Vec<_>>()})
        });
        measures.insert(measure.slug(), all.collect());
    }
    let told = json!({
        "folder": folder.dir(), "trials": folder.description.trials().len(), "missing": folder.missing()?,
        "episodes": rows.0.len(), "measures": measures
    });
    form.tell(&told, || words)?;
    std::io::stdout().flush().ok();
    eprintln!("tables, words and figures are in {:?}", folder.dir());
    Ok(())
}

/// Runs what is missing, a process for each trial, as many at a time as are wanted.
fn on_this_machine(folder: &Folder, jobs: Option<usize>) -> anyhow::Result<()> {
    let program = std::env::current_exe().context("cannot find this program, to run its trials")?;
    let jobs = jobs.unwrap_or_else(n_processors);
    let mut waiting: VecDeque<usize> = folder.missing()?.into();
    let (n, mut running): (usize, Vec<(usize, Child)>) = (waiting.len(), Vec::new());
    let mut meter = Meter::new();
    let mut done = 0;
    loop {
        while running.len() < jobs
            && let Some(task) = waiting.pop_front()
        {
            let mut command = Command::new(&program);
            command.args(["experiment", "--task", &task.to_string(), "--out"]).arg(folder.dir());
            let child = command
                .env("OMP_NUM_THREADS", "1")
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null());
            running.push((task, child.spawn().context("cannot start a trial")?));
        }
        if running.is_empty() {
            return Ok(());
        }
        pause(LOOK);
        let mut still = Vec::new();
        for (task, mut child) in running {
            match child.try_wait() {
                Ok(None) => still.push((task, child)),
                Ok(Some(status)) => {
                    done += 1;
                    if !status.success() {
                        let why = folder.failure(task).unwrap_or_else(|| format!("it ended with {status}"));
                        meter.line(&format!("trial {task} came to nothing: {why}"));
                    }
                }
                Err(met) => return Err(met).context("cannot look after the trials"),
            }
        }
        running = still;
        meter.at("trials", done, n, || {
            let now =
                running.iter().filter_map(|(task, _)| Some(format!("{task}: {}", folder.noted(*task)?)));
            now.collect::<Vec<_>>().join("; ")
        });
    }
}

/// Submits what is missing as an array job, and, if it is waited for, once more what failed.
fn on_cluster(folder: &Folder, options: &Options) -> anyhow::Result<()> {
    let program = std::env::current_exe().context("cannot find this program, to run its trials")?;
    let job =
        ArrayJob { at_a_time: options.jobs.unwrap_or(16), cpus: 1, options: options.slurm_option.clone() };
    let name = &folder.description.name;
    for round in 0..2 {
        let missing = folder.missing()?;
        if missing.is_empty() {
            break;
        }
        let script = folder.dir().join("slurm.sh");
        write_whole(&script, job.script(&program, folder.dir(), name, &missing).as_bytes())?;
        let id = submit(&[], &script)?;
        let again = if round == 0 { "" } else { " once more" };
        eprintln!("submitted {} trials{again} as the job {id}", missing.len());
        let collecting = folder.dir().join("slurm-collect.sh");
        write_whole(&collecting, job.collecting(&program, folder.dir(), name).as_bytes())?;
        // After failures, too: `afterok` would wait for ever.
        let collects = submit(&[&format!("--dependency=afterany:{id}")], &collecting)?;
        eprintln!("the job {collects} puts together what comes of it");
        if options.no_wait {
            break;
        }
        follow(folder, &id, missing.len())?;
    }
    Ok(())
}

/// Submits a script and says what the cluster calls it.
fn submit(more: &[&str], script: &Path) -> anyhow::Result<String> {
    let submitted = Command::new("sbatch").arg("--parsable").args(more).arg(script).output();
    let submitted = submitted.context("cannot run sbatch: is this a machine that submits to Slurm?")?;
    anyhow::ensure!(
        submitted.status.success(),
        "Slurm does not take the job: {}",
        String::from_utf8_lossy(&submitted.stderr).trim()
    );
    let said = String::from_utf8_lossy(&submitted.stdout);
    // With several clusters the name of one follows.
    Ok(said.trim().split(';').next().unwrap_or_default().to_owned())
}

/// Waits until no task of the job is left, going by the files of the tasks and by the queue.
fn follow(folder: &Folder, id: &str, n: usize) -> anyhow::Result<()> {
    let n_before = folder.missing()?.len();
    let mut meter = Meter::new();
    loop {
        let left = folder.missing()?.len();
        meter.at("trials", n_before - left, n, || format!("job {id}"));
        if left == 0 {
            return Ok(());
        }
        let queue = Command::new("squeue").args(["-h", "-r", "-j", id, "-o", "%T"]).output();
        let queue = queue.context("cannot run squeue")?;
        // A job that the cluster has forgotten is over; of one that does not answer nothing is known.
        let is_forgotten = String::from_utf8_lossy(&queue.stderr).contains("Invalid job id");
        let is_over = queue.status.success() && queue.stdout.iter().all(u8::is_ascii_whitespace);
        if is_forgotten || is_over {
            return Ok(());
        }
        pause(ASK);
    }
}
