//! Single pieces of work on files, each in a thread of its own, so that one may overtake the other.

mod results;

pub(super) use results::SaveError;

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use crate::dataset::Dataset;
use crate::experiment::{Opened, is_results};
use crate::run::read_at_most;
use crate::session::header::FILE as SESSION_FILE;
use crate::session::list_sessions as all_sessions;
use crate::session::{
    Annotators, ListedSession, LoadedSession, Session, SessionStore, example, hand_on_in, latest, merge_in,
    practice_in, share_dreams,
};
use crate::text::{decoded, distinct, shown};
use crate::worker::channel::IsWanted;
use crate::worker::clip_writer;
use crate::worker::error::TaskError;
use crate::worker::{
    Dropped, JobCommand, JobReport, LoadWorldModel, Report, Reports, SessionItem, WorkerError, one_thread,
    panicked,
};
use crate::world::WorldSpec;
use crate::world_model::ModelIdentity;

/// Bytes of a world's file at the most.
const MOST_OF_A_WORLD: u64 = 1 << 20;
/// So many sessions are listed at the most.
const MOST: usize = 30;

/// Does what `command` says at once, in this thread.
pub fn run(command: JobCommand, load: &LoadWorldModel, report: &mut dyn FnMut(JobReport)) {
    do_while(&|| true, command, load, report);
}

/// Does what `command` says as long as it is wanted.
fn do_while(
    is_wanted: &dyn Fn() -> bool,
    command: JobCommand,
    load: &LoadWorldModel,
    report: &mut dyn FnMut(JobReport),
) {
    let kind = Kind::of(&command);
    let done = match command {
        JobCommand::LoadWorldModel(path) => load_world_model(&path, load),
        JobCommand::OpenSession { dir, model } => SessionStore::open(&dir, model.as_ref())
            .map(|store| read_session(store, is_wanted, report))
            .map_err(WorkerError::from),
        JobCommand::ReadSession(store) => Ok(read_session(*store, is_wanted, report)),
        JobCommand::ListSessions { sessions, model } => {
            list_sessions(&sessions, model.as_ref(), is_wanted, report)
        }
        JobCommand::GiveUpOpening | JobCommand::StopListing => Ok(None),
        JobCommand::FindLatestSession { sessions, model, except } => {
            Ok(Some(JobReport::LatestSession(latest_session(&sessions, model.as_ref(), except))))
        }
        JobCommand::ListMergeable { sessions, added, hash, model } => {
            list_mergeable(&sessions, &added, &hash, model.as_ref())
        }
        JobCommand::Merge { dirs, sessions } => merge(&dirs, &sessions),
        JobCommand::HandOver { dir, sessions, annotator } => hand_over(&dir, &sessions, &annotator),
        JobCommand::CompareAnnotators { dir, session, sessions } => {
            compare_annotators(dir, &session, &sessions)
        }
        JobCommand::OpenRecordings { dir, spec } => open_recordings(dir, &spec),
        JobCommand::Identify(path) => identify(path),
        JobCommand::Practice { world, sessions, annotator } => practice(&world, &sessions, &annotator),
        JobCommand::WriteClip { path, source } => clip_writer::write(path, source),
        JobCommand::OpenResults(path) => open_results(&path),
        JobCommand::SaveResults { part, path, shown } => results::save(part, &path, &shown)
            .map(|said| Some(JobReport::Saved(Ok(said))))
            .map_err(WorkerError::from),
    };
    match done {
        Ok(Some(done)) => report(done),
        Ok(None) => {}
        Err(error) => report(kind.failed(error)),
    }
}

/// What comes of a job: nothing where it was given up.
pub(super) type Done = Result<Option<JobReport>, WorkerError>;

/// Jobs of which only the last counts, and others.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Reads a world model.
    Load,
    /// Opens or reads a session.
    Open,
    /// Lists sessions.
    List,
    /// Makes a session to begin with.
    Practice,
    /// Writes a clip.
    Clip,
    /// Reads results.
    Results,
    /// Saves what is shown of them.
    Save,
    Other,
}

impl Kind {
    fn of(command: &JobCommand) -> Self {
        match command {
            JobCommand::LoadWorldModel(_) => Self::Load,
            JobCommand::OpenSession { .. } | JobCommand::ReadSession(_) | JobCommand::GiveUpOpening => {
                Self::Open
            }
            JobCommand::ListSessions { .. } | JobCommand::StopListing => Self::List,
            JobCommand::OpenResults(_) => Self::Results,
            JobCommand::SaveResults { .. } => Self::Save,
            JobCommand::ListMergeable { .. }
            | JobCommand::FindLatestSession { .. }
            | JobCommand::Merge { .. }
            | JobCommand::HandOver { .. }
            | JobCommand::CompareAnnotators { .. }
            | JobCommand::OpenRecordings { .. }
            | JobCommand::Identify(_) => Self::Other,
            JobCommand::Practice { .. } => Self::Practice,
            JobCommand::WriteClip { .. } => Self::Clip,
        }
    }

    /// What its thread is called.
    fn name(self) -> &'static str {
        match self {
            Self::Load => "loader",
            Self::Open => "opener",
            Self::List => "lister",
            Self::Clip => "clip writer",
            Self::Results => "results",
            Self::Save => "saver",
            Self::Practice | Self::Other => "job",
        }
    }

    fn failed(self, error: WorkerError) -> JobReport {
        match self {
            Self::Load => JobReport::WorldModel(Err(error)),
            Self::Open => JobReport::Session(Err(error)),
            Self::List => JobReport::NotListed(error),
            Self::Practice => JobReport::Practice(Err(error)),
            Self::Clip => JobReport::ClipWritten(Err(error)),
            Self::Results => JobReport::Results(Err(error)),
            Self::Save => JobReport::Saved(Err(error)),
            Self::Other => JobReport::Failed(error),
        }
    }
}

/// A job that was begun.
struct Begun {
    is_wanted: IsWanted,
    thread: Option<JoinHandle<()>>,
}

/// The threads of jobs.
pub(super) struct Jobs {
    load: LoadWorldModel,
    reports: Reports,
    loading: Option<Begun>,
    opening: Option<Begun>,
    listing: Option<Begun>,
}

impl Jobs {
    /// None is begun yet; world models are read by `load`.
    pub(super) fn new(load: LoadWorldModel, reports: &Reports) -> Self {
        Self { load, reports: reports.clone(), loading: None, opening: None, listing: None }
    }

    /// The last one of a kind of which only the last counts.
    fn last(&mut self, kind: Kind) -> Option<&mut Option<Begun>> {
        match kind {
            Kind::Load => Some(&mut self.loading),
            Kind::Open => Some(&mut self.opening),
            Kind::List => Some(&mut self.listing),
            // Each counts: several may be dropped at once.
            Kind::Results | Kind::Save | Kind::Practice | Kind::Clip | Kind::Other => None,
        }
    }

    /// Gives up the job that `command` takes the place of, or that it says is to be given up: nothing of it is reported
    /// any more.
    pub(super) fn give_up_before(&mut self, command: &JobCommand) {
        if let Some(Some(last)) = self.last(Kind::of(command)) {
            last.is_wanted.end();
        }
    }

    /// Begins a job; one that opens a session waits for the one before, which may hold that very session still.
    pub(super) fn begin(&mut self, command: JobCommand) {
        let kind = Kind::of(&command);
        if matches!(command, JobCommand::GiveUpOpening | JobCommand::StopListing) {
            return;
        }
        let (load, reports) = (Arc::clone(&self.load), self.reports.of_its_own());
        let is_wanted = reports.is_wanted().clone();
        let mut last = self.last(kind);
        let before = last.as_mut().and_then(|last| last.take()?.thread).filter(|_| kind == Kind::Open);
        let work = move || {
            one_thread();
            if let Some(before) = before {
                before.join().ok();
            }
            if !reports.is_wanted().get() {
                return;
            }
            let mut report = |done| reports.send(Report::Job(done));
            let work =
                AssertUnwindSafe(|| do_while(&|| reports.is_wanted().get(), command, &load, &mut report));
            if let Err(panic) = catch_unwind(work) {
                reports.send(kind.failed(panicked(panic.as_ref())));
            }
        };
        let thread = std::thread::Builder::new().name(kind.name().to_owned()).spawn(work).ok();
        if let Some(last) = self.last(kind) {
            *last = Some(Begun { is_wanted, thread });
        }
    }
}

fn load_world_model(path: &Path, load: &LoadWorldModel) -> Done {
    let loaded = load(path).map_err(WorkerError::Met)?;
    // Slow for a large file, and kept.
    loaded.parameters.hash();
    Ok(Some(JobReport::WorldModel(Ok(Box::new(loaded)))))
}

fn read_session(
    store: SessionStore,
    is_wanted: &dyn Fn() -> bool,
    report: &mut dyn FnMut(JobReport),
) -> Option<JobReport> {
    let mut on_dream = |n_read, n| {
        if !is_wanted() {
            return ControlFlow::Break(());
        }
        report(JobReport::Opening(n_read, n));
        ControlFlow::Continue(())
    };
    LoadedSession::read(store, &mut on_dream).map(|loaded| JobReport::Session(Ok(Box::new(loaded))))
}

/// Reads the latest sessions and reports the list after each of them.
///
/// Those that cannot be read are its end: nobody can go on with them.
fn list_sessions(
    sessions: &Path,
    model: Option<&ModelIdentity>,
    is_wanted: &dyn Fn() -> bool,
    report: &mut dyn FnMut(JobReport),
) -> Done {
    let is_ours = |named: &str| model.is_none_or(|model| model.is(named));
    let mut found: Vec<SessionItem> = Vec::new();
    let mut n_readable = 0;
    for recent in latest(sessions)? {
        if !is_wanted() {
            return Ok(None);
        }
        let place = if recent.session.is_ok() { n_readable } else { found.len() };
        n_readable += usize::from(recent.session.is_ok());
        found.insert(place, listed(recent, is_ours));
        found.truncate(MOST);
        report(JobReport::Sessions { found: found.clone(), is_listing: true });
        if n_readable == MOST {
            break;
        }
    }
    Ok(Some(JobReport::Sessions { found, is_listing: false }))
}

/// The latest session of the model that can be opened, but not the one in a folder called `except`. Where they cannot be listed
/// there is none: nobody has asked for it.
fn latest_session(
    sessions: &Path,
    model: Option<&ModelIdentity>,
    except: Option<&str>,
) -> Option<SessionItem> {
    let is_ours = |named: &str| model.is_none_or(|model| model.is(named));
    let all = latest(sessions).inspect_err(|met| log::warn!("no session to go on with: {met}")).ok()?;
    let own =
        all.filter(|recent| except.is_none_or(|except| recent.dir.file_name() != Some(except.as_ref())));
    own.map(|recent| listed(recent, is_ours)).find(|item| item.about.is_ok())
}

/// A session to go on with, if it is of the world model of which `is_ours` tells the names.
fn listed(recent: ListedSession, is_ours: impl Fn(&str) -> bool) -> SessionItem {
    let about = match &recent.session {
        Ok((header, _)) if !is_ours(&header.world_model) => {
            Err("dreamed with another world model: load that one first".to_owned())
        }
        Ok((_, session)) => {
            let (n_dreams, n_answers) = (session.dreams().len(), session.statistics().n_answered);
            let protocol = session.protocol().name();
            Ok(format!("{protocol} · {} · {}", counted(n_dreams, "dream"), counted(n_answers, "answer")))
        }
        Err(e) => Err(e.to_string()),
    };
    SessionItem { name: name(&recent.dir), dir: recent.dir, about }
}

fn list_mergeable(sessions: &Path, added: &[PathBuf], hash: &str, model: Option<&ModelIdentity>) -> Done {
    let is_ours = |named: &str| hash.is_empty() || ModelIdentity::are_same(model, hash, named);
    let mut found = all_sessions(sessions)?;
    // A folder of those may have been named once more.
    let is_new = |dir: &&PathBuf| !found.iter().any(|known| is_same(&known.dir, dir));
    let new: Vec<_> = added.iter().filter(is_new).map(|dir| ListedSession::read(dir)).collect();
    found.extend(new);
    let found: Vec<_> = found.iter().map(|recent| mergeable(recent, is_ours, added)).collect();
    let names = distinct(&found.iter().map(|session| &session.dir).collect::<Vec<_>>());
    let found = found.into_iter().zip(names);
    let found = found.map(|(session, name)| SessionItem { name: shown(&name), ..session }).collect();
    Ok(Some(JobReport::Mergeable(found, added.len())))
}

/// A session that could be merged, if it is of the world model of which `is_ours` tells the names.
///
/// One of `added` keeps the name that it was added by.
fn mergeable(recent: &ListedSession, is_ours: impl Fn(&str) -> bool, added: &[PathBuf]) -> SessionItem {
    let about = match &recent.session {
        Ok((header, _)) if !is_ours(&header.world_model) => {
            Err("dreamed with another world model".to_owned())
        }
        Ok((_, session)) => Ok(holds(session)),
        Err(e) => Err(e.to_string()),
    };
    let dir = added.iter().find(|dir| is_same(dir, &recent.dir)).unwrap_or(&recent.dir).clone();
    SessionItem { name: name(&dir), dir, about }
}

fn merge(dirs: &[PathBuf], sessions: &Path) -> Done {
    let merged = merge_in(dirs, sessions)?;
    let n = counted(dirs.len(), "session");
    let said = format!("{n} put together in {}: {}", name(merged.dir()), holds(merged.session()));
    Ok(Some(JobReport::Made(merged.dir().to_owned(), said)))
}

fn hand_over(dir: &Path, sessions: &Path, annotator: &str) -> Done {
    let handed = hand_on_in(dir, sessions, annotator)?;
    let n = handed.session().pending().count();
    let queries = if n == 1 { "1 query waits".to_owned() } else { format!("{n} queries wait") };
    let said = format!("{queries} for {} in {}", shown(annotator), name(handed.dir()));
    Ok(Some(JobReport::Made(handed.dir().to_owned(), said)))
}

fn practice(world: &str, sessions: &Path, annotator: &str) -> Done {
    let example = example(world).ok_or_else(|| TaskError::NoExample(world.to_owned()))?;
    let made = practice_in(&example, sessions, annotator)?;
    Ok(Some(JobReport::Practice(Ok(made.dir().to_owned()))))
}

/// Compares whoever answered about the dreams of a session, in it and in all others.
fn compare_annotators(dir: PathBuf, own: &Session, sessions: &Path) -> Done {
    let found = all_sessions(sessions)?;
    let others = found.iter().filter(|recent| !is_same(&recent.dir, &dir));
    let others = others.filter_map(|recent| Some((&recent.dir, &recent.session.as_ref().ok()?.1)));
    let others = others.filter(|(_, other)| share_dreams(own, other));
    let (dirs, all): (Vec<_>, Vec<_>) = std::iter::once((&dir, own)).chain(others).unzip();
    let named: Vec<_> = distinct(&dirs).into_iter().zip(all).collect();
    let annotators = Annotators::of_sessions(&named);
    Ok(Some(JobReport::Compared(dir, annotators)))
}

fn open_recordings(dir: PathBuf, spec: &Arc<WorldSpec>) -> Done {
    let dataset = Dataset::open_as(&dir, spec)?;
    let env = spec.name.as_str();
    if let Some(found) = dataset.env().filter(|found| *found != env) {
        return Err(TaskError::OtherWindow { found: found.to_owned(), env: env.to_owned() }.into());
    }
    let (episodes, steps) = (counted(dataset.n_episodes(), "episode"), dataset.n_steps());
    let damaged = match dataset.damaged().len() {
        0 => String::new(),
        n => format!("; {} cannot be read", counted(n, "file")),
    };
    let said = format!("recordings are in {} from here on: {episodes}, {steps} steps{damaged}", name(&dir));
    Ok(Some(JobReport::Recordings(dir, said)))
}

fn identify(path: PathBuf) -> Done {
    let has = |wanted| path.extension().is_some_and(|extension| extension == wanted);
    let dropped = if has("safetensors") {
        Dropped::WorldModel
    } else if has("toml") && !is_results(&path) {
        check_world(&path)?;
        Dropped::World
    } else if path.join(SESSION_FILE).exists() {
        Dropped::Session
    } else if is_results(&path) {
        Dropped::Results
    } else {
        Dropped::Recordings
    };
    Ok(Some(JobReport::Identified(path, dropped)))
}

fn open_results(path: &Path) -> Done {
    let opened = Opened::read(path)?;
    Ok(Some(JobReport::Results(Ok(Box::new(opened)))))
}

/// Fails where a file is no world's.
fn check_world(path: &Path) -> Result<(), WorkerError> {
    let unreadable = |cause| TaskError::WorldUnread { path: path.to_owned(), cause };
    let bytes = read_at_most(path, MOST_OF_A_WORLD).map_err(unreadable)?;
    let bytes = bytes.ok_or_else(|| TaskError::WorldTooLong(path.to_owned()))?;
    WorldSpec::from_toml(&decoded(&bytes), path).map_err(TaskError::World)?;
    Ok(())
}

/// Whether both name the same folder.
pub(super) fn is_same(one: &Path, other: &Path) -> bool {
    std::path::absolute(one).ok() == std::path::absolute(other).ok()
}

/// What a session holds, in a few words.
fn holds(session: &Session) -> String {
    let who: Vec<_> = session.annotators().into_keys().map(shown).collect();
    let who = if who.is_empty() { String::new() } else { format!(" of {}", who.join(", ")) };
    let (n_dreams, n_answers) = (session.dreams().len(), session.statistics().n_answered);
    format!("{}, {}{who}", counted(n_dreams, "dream"), counted(n_answers, "answer"))
}

fn name(dir: &Path) -> String {
    shown(&dir.file_name().map_or_else(|| dir.to_string_lossy(), |name| name.to_string_lossy()))
}

/// `1 dream`, `2 dreams`.
fn counted(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use super::*;
    use crate::dataset::{EpisodeInfo, StepRecord};
    use crate::query::{DreamId, Protocol, QueryId, Response, SafetyAnswer, SegmentRef};
    use crate::session::{Answer, Choice, DreamSource, Event, Header};
    use crate::worker::fixtures::{self, Wall};
    use crate::worker::{Inbox, Report};
    use crate::world::Action;
    use crate::world::cars::Env as _;

    /// A session of one dream and two queries about it, the first of which is answered by `annotator`.
    fn session(dir: &Path, world: &str, annotator: &str) -> SessionStore {
        let header = Header::new("dummy-road", Protocol::Dropj, 1, world, 0);
        let mut store = SessionStore::create(dir, header).unwrap();
        store.save_dream(&fixtures::dream(1, 60), DreamSource::User).unwrap();
        let segment = |start| SegmentRef { dream: DreamId(0), start };
        for id in 0..2 {
            let (left, right) = (segment(0), segment(20 + id as usize));
            store.record(Event::Asked { query: QueryId(id), left, right, choice: Choice::Uniform }).unwrap();
        }
        let response = Response::Safety(SafetyAnswer::OnlyLeft);
        store.record(Event::Answered(Answer::new(QueryId(0), response, 2.0, annotator))).unwrap();
        store
    }

    fn all(command: JobCommand) -> Vec<JobReport> {
        let mut reports = Vec::new();
        run(command, &fixtures::load(), &mut |report| reports.push(report));
        reports
    }

    fn one(command: JobCommand) -> JobReport {
        let mut reports = all(command);
        assert_eq!(reports.len(), 1, "{reports:?}");
        reports.remove(0)
    }

    fn model() -> ModelIdentity {
        fixtures::model().identity().clone()
    }

    #[test]
    fn a_world_model_is_read_or_it_is_said_why_not() {
        let report = one(JobCommand::LoadWorldModel(PathBuf::from("good")));
        let JobReport::WorldModel(Ok(world)) = report else { panic!("{report:?}") };
        assert_eq!((world.name.as_str(), world.parameters.hash()), ("good", fixtures::model().hash()));
        let report = one(JobCommand::LoadWorldModel(PathBuf::from("bad")));
        let JobReport::WorldModel(Err(error)) = report else { panic!("{report:?}") };
        assert_eq!(error.to_string(), "a bad file");
    }

    #[test]
    fn a_session_is_opened_with_all_that_it_holds() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s");
        drop(session(&path, &fixtures::model().hash(), "anna"));
        let reports = all(JobCommand::OpenSession { dir: path.clone(), model: Some(model()) });
        let [JobReport::Opening(0, 1), JobReport::Session(Ok(loaded))] = &reports[..] else {
            panic!("{reports:?}")
        };
        assert!(matches!(&loaded.dreams[..], [(DreamId(0), Ok(dream))] if dream.len() == 60));

        let report = one(JobCommand::OpenSession { dir: path.clone(), model: Some(model()) });
        let JobReport::Session(Err(error)) = report else { panic!("{report:?}") };
        assert!(error.to_string().contains("another program has it open"), "{error}");
        drop(reports);
        let store = Box::new(SessionStore::open(&path, None).unwrap());
        let reports = all(JobCommand::ReadSession(store));
        assert!(matches!(&reports[..], [JobReport::Opening(0, 1), JobReport::Session(Ok(_))]), "{reports:?}");
    }

    #[test]
    fn sessions_are_listed_one_by_one_and_those_that_cannot_be_opened_last() {
        let dir = tempfile::tempdir().unwrap();
        drop(session(&dir.path().join("a"), &fixtures::model().hash(), "anna"));
        drop(session(&dir.path().join("b"), "sha256:other", "anna"));
        fixtures::make_folder(dir.path(), "c");
        fixtures::put(&dir.path().join("c/session.json"), "{}");
        let list = |model| all(JobCommand::ListSessions { sessions: dir.path().to_owned(), model });
        let reports = list(Some(model()));
        let shape: Vec<_> = reports
            .iter()
            .map(|report| match report {
                JobReport::Sessions { found, is_listing } => (found.len(), *is_listing),
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(shape, [(1, true), (2, true), (3, true), (3, false)]);
        let Some(JobReport::Sessions { found, .. }) = reports.last() else { panic!("{reports:?}") };
        let about = |name: &str| found.iter().find(|it| it.name == name).unwrap().about.clone();
        assert_eq!(about("a").unwrap(), "DROPJ · 1 dream · 1 answer");
        assert_eq!(about("b").unwrap_err(), "dreamed with another world model: load that one first");
        assert!(about("c").is_err() && found[2].name == "c", "{found:?}");

        let reports = list(None);
        let Some(JobReport::Sessions { found, .. }) = reports.last() else { panic!("{reports:?}") };
        assert!(found[..2].iter().all(|it| it.about.is_ok()), "without a world model any will do: {found:?}");
        let file = dir.path().join("a/session.json");
        let reports = all(JobCommand::ListSessions { sessions: file, model: None });
        assert!(matches!(&reports[..], [JobReport::NotListed(WorkerError::Met(_))]), "{reports:?}");
    }

    #[test]
    fn sessions_of_several_people_are_handed_over_compared_and_merged() {
        let dir = tempfile::tempdir().unwrap();
        let (sessions, hash) = (dir.path().join("sessions"), fixtures::model().hash());
        let (own, elsewhere) = (sessions.join("a"), dir.path().join("a"));
        drop(session(&own, &hash, "anna"));
        drop(session(&elsewhere, &hash, "ben"));
        drop(session(&sessions.join("other"), "sha256:other", "anna"));

        let added = vec![elsewhere.clone(), own.clone()];
        let report =
            one(JobCommand::ListMergeable { sessions: sessions.clone(), added, hash, model: Some(model()) });
        let JobReport::Mergeable(found, 2) = report else { panic!("{report:?}") };
        let about = |dir: &Path| found.iter().find(|it| it.dir == dir).unwrap();
        assert_eq!(
            (found.len(), about(&elsewhere).about.clone().unwrap().as_str()),
            (3, "1 dream, 1 answer of ben")
        );
        assert!(about(&own).name.ends_with("sessions/a"), "two are called a: {found:?}");
        assert_eq!(about(&sessions.join("other")).about, Err("dreamed with another world model".to_owned()));

        let (_, state) = SessionStore::read(&own).unwrap();
        let command = JobCommand::CompareAnnotators {
            dir: own.clone(),
            session: Box::new(state),
            sessions: dir.path().to_owned(),
        };
        let report = one(command);
        let JobReport::Compared(of, annotators) = report else { panic!("{report:?}") };
        assert_eq!((of, annotators.each.len()), (own.clone(), 2), "{annotators:?}");

        let dirs = vec![own.clone(), elsewhere];
        let report = one(JobCommand::Merge { dirs, sessions: sessions.clone() });
        let JobReport::Made(made, said) = report else { panic!("{report:?}") };
        assert!(said.starts_with("2 sessions put together in ") && made.starts_with(&sessions), "{said}");

        let (annotator, sessions) = ("carl".to_owned(), sessions.clone());
        let report = one(JobCommand::HandOver { dir: own, sessions: sessions.clone(), annotator });
        let JobReport::Made(made, said) = report else { panic!("{report:?}") };
        assert!(said.starts_with("1 query waits for carl in ") && made.starts_with(&sessions), "{said}");

        let report = one(JobCommand::Merge { dirs: Vec::new(), sessions });
        assert!(matches!(report, JobReport::Failed(WorkerError::Met(_))), "{report:?}");
    }

    #[test]
    fn recordings_are_looked_at_and_those_of_another_world_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("real");
        let mut dataset = Dataset::create_or_open(&path, "wall").unwrap();
        let info = EpisodeInfo { env: "wall".to_owned(), pilot: "nobody".to_owned(), seed: 0 };
        let (mut recording, frame) = (dataset.begin(info).unwrap(), Wall::new(5).frame());
        let step = StepRecord {
            frame: frame.clone(),
            action: Action::new([0.0; 3]),
            reward: 0.0,
            events: vec![false],
            wall_time_ns: 0,
            state: Vec::new(),
        };
        recording.push(&step).unwrap();
        dataset.seal(recording, &frame, None).unwrap();
        drop(dataset);
        let open = |env: &str| {
            one(JobCommand::OpenRecordings { dir: path.clone(), spec: Arc::new(WorldSpec::of_name(env)) })
        };
        let report = open("wall");
        let JobReport::Recordings(opened, said) = report else { panic!("{report:?}") };
        assert_eq!(
            (&opened, said.as_str()),
            (&path, "recordings are in real from here on: 1 episode, 1 steps")
        );
        let report = open("car-racing");
        let JobReport::Failed(error) = report else { panic!("{report:?}") };
        assert_eq!(
            error.to_string(),
            "these recordings are of wall and this window is about car-racing: start `dropj --env wall` for them"
        );
    }

    #[test]
    fn what_is_dropped_is_known_by_what_it_holds() {
        let dir = tempfile::tempdir().unwrap();
        drop(session(&dir.path().join("s"), "sha256:00", "anna"));
        let identified = |path: PathBuf| match one(JobCommand::Identify(path.clone())) {
            JobReport::Identified(known, dropped) if known == path => dropped,
            other => panic!("{other:?}"),
        };
        assert_eq!(identified(dir.path().join("s")), Dropped::Session);
        assert_eq!(identified(dir.path().to_owned()), Dropped::Recordings);
        assert_eq!(identified(dir.path().join("model.safetensors")), Dropped::WorldModel);
    }

    /// Jobs with threads, and what they report.
    fn threads(load: LoadWorldModel) -> (Jobs, Inbox) {
        let (reports, inbox) = Reports::new(|| ());
        (Jobs::new(load, &reports), inbox)
    }

    fn next(inbox: &Inbox) -> JobReport {
        match inbox.recv_timeout(Duration::from_mins(1)).unwrap() {
            Report::Job(report) => report,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_job_that_panics_is_a_report_of_its_kind() {
        let (mut jobs, inbox) = threads(Arc::new(|_| panic!("on purpose")));
        jobs.begin(JobCommand::LoadWorldModel(PathBuf::new()));
        let report = next(&inbox);
        let JobReport::WorldModel(Err(WorkerError::Panicked(text))) = report else { panic!("{report:?}") };
        assert_eq!(text, "on purpose");
    }

    #[test]
    fn of_two_world_models_the_later_counts_and_another_job_overtakes_them() {
        let (go, wait) = channel::<()>();
        let wait = std::sync::Mutex::new(wait);
        let load = fixtures::load();
        let (mut jobs, inbox) = threads(Arc::new(move |path| {
            if path == Path::new("slow") {
                wait.lock().unwrap().recv().unwrap();
            }
            load(path)
        }));
        for path in ["slow", "good"] {
            let command = JobCommand::LoadWorldModel(PathBuf::from(path));
            jobs.give_up_before(&command);
            jobs.begin(command);
            if path == "slow" {
                jobs.begin(JobCommand::Identify(PathBuf::from("nothing")));
                assert!(matches!(next(&inbox), JobReport::Identified(..)), "nobody waits for the slow one");
            }
        }
        assert!(matches!(next(&inbox), JobReport::WorldModel(Ok(world)) if world.name == "good"));
        go.send(()).unwrap();
        let slow = jobs.loading.take();
        drop((slow, jobs));
        assert!(inbox.recv_timeout(Duration::from_mins(1)).is_err(), "nothing comes of the slow one");
    }

    #[test]
    fn of_a_session_that_is_given_up_nothing_is_reported_and_the_next_can_be_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s");
        drop(session(&path, &fixtures::model().hash(), "anna"));
        let (mut jobs, inbox) = threads(fixtures::load());
        let open = || JobCommand::OpenSession { dir: path.clone(), model: Some(model()) };
        for _ in 0..20 {
            let command = open();
            jobs.give_up_before(&command);
            // As the owner of the inbox does.
            inbox.sent().for_each(drop);
            jobs.begin(command);
        }
        let last = loop {
            match next(&inbox) {
                JobReport::Opening(..) => {}
                JobReport::Session(opened) => break opened,
                other => panic!("{other:?}"),
            }
        };
        assert!(last.is_ok(), "none of those before holds it: {last:?}");
        drop(last);
        jobs.begin(open());
        jobs.give_up_before(&JobCommand::GiveUpOpening);
        jobs.begin(JobCommand::GiveUpOpening);
        drop(jobs);
        assert!(inbox.iter().next().is_none(), "it was given up");
    }
}
