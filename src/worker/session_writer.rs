//! Keeps the session that is open on disk, in the order in which things happen, while nobody waits for the disk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use crate::dream::DreamEpisode;
use crate::planner::synthesis::Acquisition;
use crate::query::DreamId;
use crate::session::{
    DreamJournal, DreamSource, Entry, Event, Fit, Header, LoadedSession, SessionError, SessionStore,
    UnfinishedDream,
};
use crate::tensor::Parameters;
use crate::worker::jobs::is_same;
use crate::worker::{Reports, SessionReport, SessionWriterCommand, Worker, WorkerName};

const NAME: WorkerName = WorkerName::SessionWriter;
/// Between two looks at whether the session still is where its name says.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// Starts a thread that writes a session.
pub(crate) fn spawn(reports: &Reports) -> Worker<SessionWriterCommand> {
    Worker::spawn(NAME, reports, |commands, reports| {
        write(&commands, &reports);
        Ok(())
    })
}

/// The body of the thread.
fn write(commands: &Receiver<SessionWriterCommand>, reports: &Reports) {
    let mut writer = SessionWriter::default();
    let mut check_at = Instant::now() + CHECK_EVERY;
    loop {
        let is_open = writer.store.is_some();
        let received = if is_open {
            commands.recv_timeout(check_at.saturating_duration_since(Instant::now()))
        } else {
            commands.recv().map_err(|_| RecvTimeoutError::Disconnected)
        };
        let mut has_failed = false;
        match received {
            Ok(command) => writer.handle(command, &mut |report| {
                has_failed |= is_failure(&report);
                reports.send(report);
            }),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = Instant::now();
        if has_failed || now >= check_at {
            writer.check(&mut |report| reports.send(report));
            check_at = now + CHECK_EVERY;
        }
    }
}

/// Whether something is not on disk.
fn is_failure(report: &SessionReport) -> bool {
    use SessionReport as Report;
    matches!(
        report,
        Report::NotRecorded { .. }
            | Report::DreamNotSaved { .. }
            | Report::RewardNotSaved { .. }
            | Report::Journal { journal: Err(_), .. }
            | Report::NotRecovered(_)
            | Report::NotWritten { .. }
            | Report::NotSavedAs(_)
    )
}

/// Where reports go.
type Reporting<'a> = &'a mut dyn FnMut(SessionReport);

/// The session that is open, if one is.
#[derive(Debug, Default)]
pub struct SessionWriter {
    store: Option<SessionStore>,
    /// Why it was not under its name when that was last reported.
    trouble: Option<String>,
}

impl SessionWriter {
    /// Carries out a command, and reports what came of it.
    pub fn handle(&mut self, command: SessionWriterCommand, report: &mut dyn FnMut(SessionReport)) {
        match command {
            SessionWriterCommand::Create { sessions, header } => report(create(&sessions, header)),
            SessionWriterCommand::Use(store) => self.go_on_with(Some(*store)),
            SessionWriterCommand::Close => self.go_on_with(None),
            SessionWriterCommand::Release => {
                if let Some(store) = self.store.take() {
                    report(SessionReport::Released(Box::new(store)));
                }
                self.go_on_with(None);
            }
            SessionWriterCommand::Record { event, at } => report(self.record(event, at)),
            SessionWriterCommand::SaveDream { episode, source, acquisition, journal } => {
                report(self.save_dream(episode, source, acquisition, journal));
            }
            SessionWriterCommand::SaveReward { parameters, fit } => report(self.save_reward(parameters, fit)),
            SessionWriterCommand::KeepDriven { seed, metrics } => {
                let line = serde_json::json!({"track": seed, "metrics": metrics}).to_string();
                if let Some(Err(met)) = self.store.as_ref().map(|store| store.append_driven(&line)) {
                    report(SessionReport::DrivenNotKept(met));
                }
            }
            SessionWriterCommand::OpenJournal { episode, is_new } => {
                let store = self.store.as_ref().ok_or(SessionError::NotOpen);
                let journal = store.and_then(|store| store.journal(&episode, DreamSource::User));
                report(SessionReport::Journal { episode, journal, is_new });
            }
            SessionWriterCommand::DiscardJournal(journal) => discard(Some(journal)),
            SessionWriterCommand::Recover(unfinished) => self.recover(unfinished, report),
            SessionWriterCommand::DiscardUnfinished(unfinished) => {
                for left in unfinished {
                    if let Err(e) = left.discard() {
                        report(SessionReport::NotRecovered(e));
                    }
                }
            }
            SessionWriterCommand::TryAgain => self.try_again(report),
            SessionWriterCommand::ForgetLastUnsaved => {
                if let Some(store) = &mut self.store
                    && store.forget_unsaved().is_some()
                {
                    report(SessionReport::Forgotten { n_unsaved: store.n_unsaved() });
                }
            }
            SessionWriterCommand::ForgetUnsaved => {
                if let Some(store) = &mut self.store
                    && store.n_unsaved() > 0
                {
                    while store.forget_unsaved().is_some() {}
                    report(SessionReport::Forgotten { n_unsaved: 0 });
                }
            }
            SessionWriterCommand::SaveAs { path, dreams, reward } => {
                let saved = self.save_as(&path, &dreams, reward.as_ref());
                report(saved.unwrap_or_else(SessionReport::NotSavedAs));
            }
            SessionWriterCommand::CheckFolder { sessions, purpose } => {
                let result = SessionStore::check_folder(&sessions);
                report(SessionReport::Folder { sessions, purpose, result });
            }
            SessionWriterCommand::ProposePlace { folder, name } => {
                let place = free_place(&folder);
                let path = name.map(|name| SessionStore::free_folder(&place, &name));
                report(SessionReport::Place(path.unwrap_or(place)));
            }
        }
    }

    /// Finds out whether the session still is under its name, and reports it where that has changed.
    pub fn check(&mut self, report: &mut dyn FnMut(SessionReport)) {
        let Some(store) = &self.store else { return };
        let checked = store.check();
        let trouble = checked.as_ref().err().map(ToString::to_string);
        if trouble != self.trouble {
            self.trouble = trouble;
            report(SessionReport::Checked(checked));
        }
    }

    fn go_on_with(&mut self, store: Option<SessionStore>) {
        (self.store, self.trouble) = (store, None);
    }

    fn record(&mut self, event: Event, at: u64) -> SessionReport {
        let Some(store) = &mut self.store else {
            return SessionReport::NotRecorded { event, error: SessionError::NotOpen, n_unsaved: 0 };
        };
        match store.record_at(event.clone(), at) {
            Ok(()) => SessionReport::Recorded(last(store)),
            Err(error) => SessionReport::NotRecorded { event, error, n_unsaved: store.n_unsaved() },
        }
    }

    fn save_dream(
        &mut self,
        episode: DreamEpisode,
        source: DreamSource,
        acquisition: Option<Acquisition>,
        journal: Option<DreamJournal>,
    ) -> SessionReport {
        let saved = match (&mut self.store, acquisition) {
            (None, _) => Err(SessionError::NotOpen),
            (Some(store), Some(acquisition)) => {
                store.save_trajectory(&episode, acquisition).map(|id| (id, last(store)))
            }
            (Some(store), None) => store.save_dream(&episode, source).map(|id| (id, last(store))),
        };
        match saved {
            Ok((id, entry)) => {
                discard(journal);
                SessionReport::DreamSaved { entry, id, episode }
            }
            Err(error) => SessionReport::DreamNotSaved { episode, acquisition, journal, error },
        }
    }

    fn save_reward(&mut self, parameters: Parameters, fit: Fit) -> SessionReport {
        let saved = match &mut self.store {
            Some(store) => store.save_reward(&parameters, fit.clone()).map(|()| last(store)),
            None => Err(SessionError::NotOpen),
        };
        match saved {
            Ok(entry) => SessionReport::RewardSaved(entry),
            Err(error) => SessionReport::RewardNotSaved { parameters, fit, error },
        }
    }

    fn recover(&mut self, mut unfinished: Vec<UnfinishedDream>, report: Reporting<'_>) {
        let Some(store) = &mut self.store else {
            return report(SessionReport::NotRecovered(SessionError::NotOpen));
        };
        if unfinished.is_empty() {
            unfinished = store.unfinished_dreams().unwrap_or_default();
        }
        for left in unfinished {
            // It counts as soon as it is kept, whatever becomes of its journal.
            match store.save_dream(&left.episode, left.source) {
                Ok(id) => {
                    let (entry, episode) = (last(store), left.episode.clone());
                    report(SessionReport::DreamSaved { entry, id, episode });
                    if let Err(e) = left.discard() {
                        report(SessionReport::NotRecovered(e));
                    }
                }
                Err(e) => report(SessionReport::NotRecovered(e)),
            }
        }
    }

    fn try_again(&mut self, report: Reporting<'_>) {
        let Some(store) = &mut self.store else {
            return report(SessionReport::NotWritten { error: SessionError::NotOpen, n_unsaved: 0 });
        };
        let n_before = store.entries().len();
        let tried = store.try_again();
        // Some of it may be written down even where it could not be to the end.
        let events: Vec<_> = store.entries()[n_before..].iter().map(|entry| entry.event.clone()).collect();
        if tried.is_ok() || !events.is_empty() {
            report(SessionReport::Written { events, session: Box::new(store.session().clone()) });
        }
        if let Err(error) = tried {
            report(SessionReport::NotWritten { error, n_unsaved: store.n_unsaved() });
        }
    }

    /// Writes all of the session to `path` and goes on there; in `path` where that is a folder with something in it.
    fn save_as(
        &mut self,
        path: &Path,
        dreams: &BTreeMap<DreamId, Arc<DreamEpisode>>,
        reward: Option<&Parameters>,
    ) -> Result<SessionReport, SessionError> {
        let store = self.store.as_ref().ok_or(SessionError::NotOpen)?;
        let out = match path.parent() {
            _ if !is_there(path) => path.to_owned(),
            Some(above) if is_same(path, store.dir()) => SessionStore::free_folder(above, &name(path)),
            _ => SessionStore::free_folder(path, &name(store.dir())),
        };
        let held = |id| dreams.get(&id).map(|episode| episode.as_ref().clone());
        let crate::session::SavedAs { store, written: events, left_out } =
            store.save_as(&out, held, reward)?;
        let (header, session) = (store.header().clone(), Box::new(store.session().clone()));
        self.go_on_with(Some(store));
        Ok(SessionReport::SavedAs { dir: out, header, session, events, left_out })
    }
}

fn create(sessions: &Path, header: Header) -> SessionReport {
    let created = SessionStore::create_in(sessions, header);
    SessionReport::Created(created.map(|store| Box::new(LoadedSession::new(store))))
}

/// The line that was written last.
fn last(store: &SessionStore) -> Entry {
    store.entries().last().expect("a line was written").clone()
}

/// Removes the journal of a dream that is kept or thrown away; where that fails, it is found again later.
fn discard(journal: Option<DreamJournal>) {
    if let Some(Err(e)) = journal.map(DreamJournal::discard) {
        log::warn!("{e}");
    }
}

/// A folder that can be written into: this one, one at home, or a temporary one.
fn free_place(folder: &Path) -> PathBuf {
    let home = std::env::home_dir().map(|home| home.join("dropj-sessions"));
    let places = [Some(folder.to_owned()), home, Some(std::env::temp_dir().join("dropj-sessions"))];
    let mut places = places.into_iter().flatten();
    places.find(|place| SessionStore::check_folder(place).is_ok()).unwrap_or_else(|| folder.to_owned())
}

/// Whether there is something at `path` that is no empty folder.
fn is_there(path: &Path) -> bool {
    path.is_dir() && path.read_dir().is_ok_and(|mut inside| inside.next().is_some())
}

fn name(dir: &Path) -> String {
    dir.file_name().map_or_else(|| "session".to_owned(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{Protocol, QueryId, Response, SafetyAnswer, SegmentRef};
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::session::{Answer, Choice, Impossible, Session};
    use crate::worker::{FolderCheck, Inbox, Report, fixtures};

    /// A writer with a session in the folder `s` of `dir`.
    fn writer(dir: &Path) -> SessionWriter {
        let mut writer = SessionWriter::default();
        let store = SessionStore::create(&dir.join("s"), header()).unwrap();
        assert!(all(&mut writer, SessionWriterCommand::Use(Box::new(store))).is_empty());
        writer
    }

    fn header() -> Header {
        Header::new("dummy-road", Protocol::Dropj, 1, &fixtures::model().hash(), 0)
    }

    /// What comes of a command.
    fn all(writer: &mut SessionWriter, command: SessionWriterCommand) -> Vec<SessionReport> {
        let mut reports = Vec::new();
        writer.handle(command, &mut |report| reports.push(report));
        reports
    }

    /// The only report that comes of a command.
    fn one(writer: &mut SessionWriter, command: SessionWriterCommand) -> SessionReport {
        let mut reports = all(writer, command);
        assert_eq!(reports.len(), 1, "{reports:?}");
        reports.remove(0)
    }

    fn check(writer: &mut SessionWriter) -> Vec<SessionReport> {
        let mut reports = Vec::new();
        writer.check(&mut |report| reports.push(report));
        reports
    }

    fn save_dream(seed: u64, journal: Option<DreamJournal>) -> SessionWriterCommand {
        let (episode, source) = (fixtures::dream(seed, 60), DreamSource::User);
        SessionWriterCommand::SaveDream { episode, source, acquisition: None, journal }
    }

    fn asked(id: u32) -> Event {
        let segment = |start| SegmentRef { dream: DreamId(0), start };
        Event::Asked { query: QueryId(id), left: segment(0), right: segment(20), choice: Choice::Uniform }
    }

    fn answered(id: u32) -> Event {
        let response = Response::Safety(SafetyAnswer::OnlyLeft);
        Event::Answered(Answer::new(QueryId(id), response, 2.0, "anna"))
    }

    fn record(event: Event) -> SessionWriterCommand {
        SessionWriterCommand::Record { event, at: 7 }
    }

    /// A dream and a query, recorded.
    fn begin(writer: &mut SessionWriter) {
        for command in [save_dream(1, None), record(asked(0))] {
            all(writer, command);
        }
    }

    #[test]
    fn a_session_is_made_and_not_kept_open_before_it_is_used() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = SessionWriter::default();
        let create = || SessionWriterCommand::Create { sessions: dir.path().to_owned(), header: header() };
        let SessionReport::Created(Ok(loaded)) = one(&mut writer, create()) else { panic!("not made") };
        assert!(loaded.dreams.is_empty() && loaded.store.dir().starts_with(dir.path()));
        let refused = one(&mut writer, record(asked(0)));
        let SessionReport::NotRecorded { event, error, n_unsaved: 0 } = refused else {
            panic!("{refused:?}")
        };
        assert_eq!((event, error.to_string().as_str()), (asked(0), "there is no session to keep it in"));

        let file = dir.path().join("file");
        fixtures::put(&file, "mine");
        let create = SessionWriterCommand::Create { sessions: file, header: header() };
        assert!(matches!(one(&mut writer, create), SessionReport::Created(Err(_))));
    }

    #[test]
    fn what_is_recorded_is_reported_as_it_is_on_disk() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        begin(&mut writer);
        let SessionReport::Recorded(entry) = one(&mut writer, record(answered(0))) else { panic!("not so") };
        assert_eq!((entry.seq, entry.at, &entry.event), (2, 7, &answered(0)));

        let report = one(&mut writer, record(answered(5)));
        let SessionReport::NotRecorded { error, n_unsaved: 0, .. } = report else { panic!("{report:?}") };
        assert!(matches!(error, SessionError::Impossible(Impossible::NeverAsked(_))), "{error}");

        let SessionReport::Released(store) = one(&mut writer, SessionWriterCommand::Release) else {
            panic!("not released")
        };
        assert_eq!((store.entries().len(), store.entries().last()), (3, Some(&entry)));
        assert!(all(&mut writer, SessionWriterCommand::Release).is_empty(), "there is none any more");
        drop(store);
        let (_, session) = SessionStore::read(&dir.path().join("s")).unwrap();
        assert_eq!(session.labeled().len(), 1);
    }

    #[test]
    fn a_closed_session_can_be_opened_by_others() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        assert!(SessionStore::open(&dir.path().join("s"), None).is_err(), "it is in use");
        assert!(all(&mut writer, SessionWriterCommand::Close).is_empty());
        assert!(SessionStore::open(&dir.path().join("s"), None).is_ok());
    }

    #[test]
    fn a_kept_dream_needs_no_journal_and_one_that_is_not_kept_gets_it_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        let open = |is_new| SessionWriterCommand::OpenJournal { episode: fixtures::dream(1, 30), is_new };
        let journal = |report| match report {
            SessionReport::Journal { journal: Ok(journal), is_new: true, episode } => {
                assert_eq!(episode, fixtures::dream(1, 30));
                journal
            }
            other => panic!("{other:?}"),
        };
        let opened = journal(one(&mut writer, open(true)));
        let path = opened.path().to_owned();
        let report = one(&mut writer, save_dream(1, Some(opened)));
        let SessionReport::DreamSaved { entry, id: DreamId(0), episode } = report else {
            panic!("{report:?}")
        };
        assert!(matches!(&entry.event, Event::DreamKept(kept) if kept.len == 60), "{entry:?}");
        assert_eq!((episode, path.exists()), (fixtures::dream(1, 60), false));

        let opened = journal(one(&mut writer, open(true)));
        let path = opened.path().to_owned();
        all(&mut writer, SessionWriterCommand::Close);
        let report = one(&mut writer, save_dream(2, Some(opened)));
        let SessionReport::DreamNotSaved { journal: Some(opened), error, .. } = report else {
            panic!("{report:?}")
        };
        assert!(matches!(error, SessionError::NotOpen) && path.exists(), "{error}");
        all(&mut writer, SessionWriterCommand::DiscardJournal(opened));
        assert!(!path.exists(), "thrown away");
        let report = one(&mut writer, open(false));
        let SessionReport::Journal { journal: Err(SessionError::NotOpen), is_new: false, .. } = report else {
            panic!("{report:?}")
        };
    }

    #[test]
    fn a_trajectory_is_kept_with_what_it_was_to_be() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        let (source, acquisition) = (DreamSource::Synthesized, Some(Acquisition::Novelty));
        let episode = fixtures::dream(1, 60);
        let command = SessionWriterCommand::SaveDream { episode, source, acquisition, journal: None };
        let report = one(&mut writer, command);
        let SessionReport::DreamSaved { entry, .. } = report else { panic!("{report:?}") };
        let Event::DreamKept(kept) = entry.event else { panic!("{entry:?}") };
        assert_eq!((kept.source, kept.acquisition), (source, acquisition));
    }

    #[test]
    fn a_reward_is_saved_or_given_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        begin(&mut writer);
        let rng = &mut <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(0);
        let hash = fixtures::model().hash();
        let parameters = RewardEnsemble::new((36, hash.as_str()), RewardConfig::tiny(), rng).parameters();
        let fit = Fit { after: 2, n_labels: 0, seed: 4, epochs: 1, losses: vec![0.5], held_out: None };
        let save = || SessionWriterCommand::SaveReward { parameters: parameters.clone(), fit: fit.clone() };
        let report = one(&mut writer, save());
        let SessionReport::RewardSaved(entry) = report else { panic!("{report:?}") };
        assert!(matches!(&entry.event, Event::Fitted { fit: kept, .. } if *kept == fit), "{entry:?}");
        all(&mut writer, SessionWriterCommand::Close);
        let report = one(&mut writer, save());
        let SessionReport::RewardNotSaved { parameters: given, fit: kept, .. } = report else {
            panic!("{report:?}")
        };
        assert_eq!((given.hash(), kept), (parameters.hash(), fit));
    }

    #[test]
    fn what_a_killed_program_left_behind_is_kept_or_thrown_away() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        let leave = |writer: &mut SessionWriter, seed| {
            let episode = fixtures::dream(seed, 30);
            drop(all(writer, SessionWriterCommand::OpenJournal { episode, is_new: true }));
        };
        leave(&mut writer, 1);
        // Those that are there, for none are given.
        let report = one(&mut writer, SessionWriterCommand::Recover(Vec::new()));
        let SessionReport::DreamSaved { id: DreamId(0), episode, .. } = report else { panic!("{report:?}") };
        assert_eq!((episode.seed, episode.len()), (1, 30));
        let left = |writer: &SessionWriter| writer.store.as_ref().unwrap().unfinished_dreams().unwrap();
        assert!(left(&writer).is_empty(), "its journal is gone");

        leave(&mut writer, 2);
        leave(&mut writer, 3);
        let found = left(&writer);
        let report = one(&mut writer, SessionWriterCommand::Recover(vec![found[1].clone()]));
        let SessionReport::DreamSaved { id: DreamId(1), episode, .. } = report else { panic!("{report:?}") };
        assert_eq!(episode.seed, found[1].episode.seed);
        let discard = || SessionWriterCommand::DiscardUnfinished(vec![found[0].clone()]);
        assert!(all(&mut writer, discard()).is_empty() && left(&writer).is_empty());
        let report = one(&mut writer, discard());
        assert!(matches!(report, SessionReport::NotRecovered(_)), "it is gone already: {report:?}");
        all(&mut writer, SessionWriterCommand::Close);
        let report = one(&mut writer, SessionWriterCommand::Recover(found));
        assert!(matches!(report, SessionReport::NotRecovered(SessionError::NotOpen)), "{report:?}");
    }

    #[cfg(unix)]
    #[test]
    fn what_cannot_be_written_waits_and_is_written_once_the_log_is_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        begin(&mut writer);
        all(&mut writer, record(asked(1)));
        assert!(check(&mut writer).is_empty(), "nothing has changed");
        let (log, away) = (dir.path().join("s/events.jsonl"), dir.path().join("away"));
        fixtures::rename(&log, &away);
        for (id, n) in [(0, 1), (1, 2)] {
            let report = one(&mut writer, record(answered(id)));
            let SessionReport::NotRecorded { error, n_unsaved, .. } = report else { panic!("{report:?}") };
            assert!(matches!(error, SessionError::Replaced { .. }) && n_unsaved == n, "{error}");
        }
        let checked = check(&mut writer);
        assert!(matches!(checked[..], [SessionReport::Checked(Err(_))]), "{checked:?}");
        assert!(check(&mut writer).is_empty(), "the same trouble is not reported twice");
        let report = one(&mut writer, SessionWriterCommand::TryAgain);
        assert!(matches!(report, SessionReport::NotWritten { n_unsaved: 2, .. }), "{report:?}");

        fixtures::rename(&away, &log);
        let report = one(&mut writer, SessionWriterCommand::ForgetLastUnsaved);
        assert!(matches!(report, SessionReport::Forgotten { n_unsaved: 1 }), "{report:?}");
        let report = one(&mut writer, SessionWriterCommand::TryAgain);
        let SessionReport::Written { events, session } = report else { panic!("{report:?}") };
        assert_eq!((events, session.labeled().len()), (vec![answered(0)], 1));
        let checked = check(&mut writer);
        assert!(matches!(checked[..], [SessionReport::Checked(Ok(()))]), "{checked:?}");
        assert!(all(&mut writer, SessionWriterCommand::ForgetLastUnsaved).is_empty(), "nothing is left");

        fixtures::remove(&log);
        all(&mut writer, record(answered(1)));
        let report = one(&mut writer, SessionWriterCommand::ForgetUnsaved);
        assert!(matches!(report, SessionReport::Forgotten { n_unsaved: 0 }), "{report:?}");
    }

    #[cfg(unix)]
    #[test]
    fn a_session_whose_log_is_gone_goes_on_elsewhere_with_all_that_was_said() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path());
        begin(&mut writer);
        fixtures::remove(&dir.path().join("s/events.jsonl"));
        all(&mut writer, record(answered(0)));
        assert!(matches!(check(&mut writer)[..], [SessionReport::Checked(Err(_))]));

        let save_as = |path: &Path| SessionWriterCommand::SaveAs {
            path: path.to_owned(),
            dreams: BTreeMap::from([(DreamId(0), Arc::new(fixtures::dream(1, 60)))]),
            reward: None,
        };
        let saved = |report| -> (PathBuf, Box<Session>, Vec<Event>) {
            match report {
                SessionReport::SavedAs { dir, session, events, left_out, header: kept } => {
                    assert_eq!((left_out, kept.seed), (Vec::<String>::new(), header().seed));
                    (dir, session, events)
                }
                other => panic!("{other:?}"),
            }
        };
        let place = dir.path().join("place");
        let (out, session, events) = saved(one(&mut writer, save_as(&place)));
        assert_eq!((&out, session.labeled().len(), events), (&place, 1, vec![answered(0)]));
        assert!(check(&mut writer).is_empty(), "all is well there");
        // Beside it, where its own folder is named; in it, where there is something else.
        let (out, _, events) = saved(one(&mut writer, save_as(&place)));
        assert_eq!((out, events), (dir.path().join("place-2"), vec![]));
        let (out, ..) = saved(one(&mut writer, save_as(&place)));
        assert_eq!(out, place.join("place-2"));
        let report = one(&mut writer, record(asked(1)));
        assert!(matches!(report, SessionReport::Recorded(_)), "{report:?}");

        let file = dir.path().join("file");
        fixtures::put(&file, "mine");
        let report = one(&mut writer, save_as(&file.join("in")));
        assert!(matches!(report, SessionReport::NotSavedAs(_)), "{report:?}");
        let report = one(&mut writer, record(answered(1)));
        assert!(matches!(report, SessionReport::Recorded(_)), "it goes on where it was: {report:?}");
        all(&mut writer, SessionWriterCommand::Close);
        let report = one(&mut writer, save_as(&dir.path().join("none")));
        assert!(matches!(report, SessionReport::NotSavedAs(SessionError::NotOpen)), "{report:?}");
    }

    #[test]
    fn places_are_checked_and_proposed() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = SessionWriter::default();
        let file = dir.path().join("file");
        fixtures::put(&file, "mine");
        for (path, can) in [(dir.path().join("new"), true), (file.join("in"), false)] {
            let purpose = FolderCheck::Chosen;
            let report =
                one(&mut writer, SessionWriterCommand::CheckFolder { sessions: path.clone(), purpose });
            let SessionReport::Folder { sessions, purpose: FolderCheck::Chosen, result } = report else {
                panic!("{report:?}")
            };
            assert_eq!((sessions, result.is_ok()), (path, can));
        }
        fixtures::make_folder(dir.path(), "s-saved");
        let mut propose = |folder: &Path, name: Option<&str>| {
            let (folder, name) = (folder.to_owned(), name.map(str::to_owned));
            match one(&mut writer, SessionWriterCommand::ProposePlace { folder, name }) {
                SessionReport::Place(path) => path,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(propose(dir.path(), None), dir.path());
        assert_eq!(propose(dir.path(), Some("s-saved")), dir.path().join("s-saved-2"));
        assert!(!propose(&file.join("in"), Some("s")).starts_with(&file), "that cannot be written");
    }

    #[cfg(unix)]
    #[test]
    fn its_thread_looks_after_the_session_by_itself() {
        let dir = tempfile::tempdir().unwrap();
        let (reports, inbox) = Reports::new(|| ());
        let worker = spawn(&reports);
        let store = SessionStore::create(&dir.path().join("s"), header()).unwrap();
        worker.send(SessionWriterCommand::Use(Box::new(store)));
        worker.send(save_dream(1, None));
        let next = |inbox: &Inbox| match inbox.recv_timeout(Duration::from_mins(1)).unwrap() {
            Report::Session(report) => report,
            other => panic!("{other:?}"),
        };
        assert!(matches!(next(&inbox), SessionReport::DreamSaved { .. }));
        let log = dir.path().join("s/events.jsonl");
        fixtures::rename(&log, &dir.path().join("away"));
        fixtures::put(&log, "");
        assert!(matches!(next(&inbox), SessionReport::Checked(Err(_))), "it was replaced");
        fixtures::rename(&dir.path().join("away"), &log);
        assert!(matches!(next(&inbox), SessionReport::Checked(Ok(()))), "it is back");
        // What was sent before the end is written.
        worker.send(record(asked(0)));
        drop(worker);
        assert!(matches!(next(&inbox), SessionReport::Recorded(_)));
    }
}
