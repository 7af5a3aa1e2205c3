//! A session in its folder: every event is on disk before it counts.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::dream::DreamEpisode;
use crate::planner::synthesis::Acquisition;
use crate::query::DreamId;
use crate::run::place::Named;
use crate::run::{PARTIAL, check_folder, is_being_built, log_saved, remove_partials, sync_folder};
use crate::session::error::{DreamError, SessionError};
use crate::session::event::{DreamSource, Entry, Event, Fit, KeptDream};
use crate::session::header::{self, FORMAT, Header};
use crate::session::journal::{self, DreamJournal, UnfinishedDream};
use crate::session::log::{self, Contents, Log};
use crate::session::worlds::{self, WORLD_MODEL_FILE};
use crate::session::{FittedReward, Session, arrays, export};
use crate::tensor::{Parameters, sha256};
use crate::world_model::{ModelIdentity, WorldModel};

pub(super) const LOG_FILE: &str = "events.jsonl";
pub(super) const DREAMS: &str = "dreams";
/// What its reward drove in the window, an episode a line, as `dropj deploy --json` prints them. No part of the log: what is learned
/// does not hang on it.
pub(super) const DRIVEN_FILE: &str = "driven.jsonl";
pub(super) const REWARDS: &str = "reward";

/// A session that is open, with everything that happens in it going to disk.
#[derive(Debug)]
pub struct SessionStore {
    dir: PathBuf,
    header: Header,
    session: Session,
    log: Log,
    torn: Option<String>,
    /// The lines of its log, so that all of it can be written elsewhere.
    pub(super) entries: Vec<Entry>,
    /// What happened and could not be written down, in order, and when.
    pub(super) unsaved: Vec<(Event, u64)>,
    /// Files that were missing when it was opened, so that nobody waits for them.
    missing: BTreeSet<PathBuf>,
    /// The folder itself, whatever it is called by now.
    pub(super) folder: Option<File>,
    /// What its dreams must fit, once that is known.
    model: Option<ModelIdentity>,
}

impl SessionStore {
    /// A new session in `dir`, where there must be nothing yet, or an empty folder.
    pub fn create(dir: &Path, header: Header) -> Result<Self, SessionError> {
        let is_taken = std::fs::read_dir(dir).map_or(dir.exists(), |mut inside| inside.next().is_some());
        if is_taken {
            return Err(SessionError::Exists { path: dir.to_owned() });
        }
        let is_new = !dir.exists();
        let made =
            || std::fs::create_dir_all(dir).map_err(SessionError::disk("make the folder of a session", dir));
        let made = made().and_then(|()| Self::create_here(dir, header));
        made.inspect_err(|_| {
            // What could not be begun must not stand in the way of the next.
            std::fs::remove_file(dir.join(LOG_FILE)).ok();
            if is_new {
                std::fs::remove_dir(dir).ok();
            }
        })
    }

    /// A new session in the folder `dir`, which is there and holds none.
    pub(super) fn create_here(dir: &Path, header: Header) -> Result<Self, SessionError> {
        let log = Log::create(&dir.join(LOG_FILE))?;
        // The header comes last: a folder without one is no session.
        header.write(dir)?;
        sync_folder(dir).map_err(SessionError::disk("make the folder of a session", dir))?;
        Ok(Self {
            dir: dir.to_owned(),
            session: header.session(),
            header,
            log,
            torn: None,
            entries: Vec::new(),
            unsaved: Vec::new(),
            missing: BTreeSet::new(),
            folder: File::open(dir).ok(),
            model: None,
        })
    }

    /// Adds a line on an episode that was driven by its reward.
    pub fn append_driven(&self, line: &str) -> Result<(), SessionError> {
        use std::io::Write as _;

        let path = self.dir.join(DRIVEN_FILE);
        let append = || {
            let mut file = File::options().create(true).append(true).open(&path)?;
            file.write_all(format!("{line}\n").as_bytes())?;
            file.sync_data()
        };
        append().map_err(SessionError::disk("keep what was driven", &path))
    }

    /// Those lines; nothing where there are none.
    pub(super) fn driven(&self) -> Result<Vec<u8>, SessionError> {
        let path = self.dir.join(DRIVEN_FILE);
        match std::fs::read(&path) {
            Err(met) if met.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
            read => read.map_err(SessionError::disk("read what was driven", &path)),
        }
    }

    /// A folder called `name` in `folder`, or the like where there is one already.
    pub fn free_folder(folder: &Path, name: &str) -> PathBuf {
        free_folder(folder, name)
    }

    /// Whether sessions can be kept in the folder `sessions`, made if need be. Nothing is left of the looking.
    pub fn check_folder(sessions: &Path) -> Result<(), SessionError> {
        Ok(check_folder(sessions)?)
    }

    /// A new session in a folder of its own below `sessions`, named by its time; never over another.
    pub fn create_in(sessions: &Path, header: Header) -> Result<Self, SessionError> {
        let dir = free_folder(sessions, &header.folder_name());
        Self::create(&dir, header)
    }

    /// The session in `dir`, which must have been made with this world model, if one is given.
    ///
    /// The half line that a killed program can leave is cut off and told in [`Self::torn`].
    pub fn open(dir: &Path, world_model: Option<&ModelIdentity>) -> Result<Self, SessionError> {
        // The next run of the command that made it may remove it, with whatever was said in it since.
        if is_being_built(dir) {
            return Err(SessionError::Unfinished { path: dir.to_owned() });
        }
        let mut header = Header::read(dir)?;
        check_world_model(dir, &header, world_model)?;
        let path = dir.join(LOG_FILE);
        let (log, contents) = Log::open(&path)?;
        let session = fold(&header, &contents.entries, &contents.lines, &path)?;
        if header.format < FORMAT {
            // What is appended from here on is not for the program that began it.
            header.format = FORMAT;
            header.write(dir)?;
        }
        // Nobody else writes here, so these are nobody's.
        for folder in [dir.to_owned(), dir.join(DREAMS), dir.join(REWARDS)] {
            remove_partials(&folder);
        }
        let mut store = Self {
            dir: dir.to_owned(),
            header,
            session,
            log,
            torn: contents.torn,
            entries: contents.entries,
            unsaved: Vec::new(),
            missing: BTreeSet::new(),
            folder: File::open(dir).ok(),
            model: world_model.cloned(),
        };
        store.missing = store.files().filter(|path| !path.exists()).collect();
        Ok(store)
    }

    /// The files that its log tells of.
    fn files(&self) -> impl Iterator<Item = PathBuf> {
        let dreams = self.session.dreams().iter().map(|kept| &kept.file);
        let all = dreams.chain(self.session.fits().iter().map(|fitted| &fitted.file));
        all.map(|file| self.dir.join(file))
    }

    /// Whether all of the session is on disk under its name, as far as a look at the names can tell.
    ///
    /// What was missing already when it was opened has been said then.
    pub fn check(&self) -> Result<(), SessionError> {
        self.log.check()?;
        let head = std::iter::once(self.dir.join(header::FILE));
        let gone = head.chain(self.files()).find(|path| !path.exists() && !self.missing.contains(path));
        gone.map_or(Ok(()), |path| Err(SessionError::Gone { path }))
    }

    /// What tells another thread whether the log still is under its name, and keeps nothing open.
    pub fn watch(&self) -> Named {
        Named::of(&self.dir.join(LOG_FILE))
    }

    /// What happened and could not be written down: it does not count yet.
    pub fn n_unsaved(&self) -> usize {
        self.unsaved.len()
    }

    /// Takes back what happened last of what could not be written down.
    pub fn forget_unsaved(&mut self) -> Option<Event> {
        self.unsaved.pop().map(|(event, _)| event)
    }

    /// Writes down what could not be before, in its order, and returns it.
    ///
    /// What cannot have happened any more, because something else was written down since, is left out.
    pub fn try_again(&mut self) -> Result<Vec<Event>, SessionError> {
        let mut written = Vec::new();
        self.check()?;
        while let Some((event, at)) = self.unsaved.first().cloned() {
            if self.session.check(&event).is_ok() {
                let entry = self.log.append(event.clone(), at)?;
                self.session.apply(&entry)?;
                self.entries.push(entry);
                written.push(event);
            }
            self.unsaved.remove(0);
        }
        Ok(written)
    }

    /// Puts the lines of another log into this one, which is empty. The files that are `left_out` are nowhere.
    pub(super) fn take_over(&mut self, entries: Vec<Entry>, left_out: &[String]) -> Result<(), SessionError> {
        self.log.append_all(&entries)?;
        self.session = fold(&self.header, &entries, &[], &self.dir.join(LOG_FILE))?;
        self.entries = entries;
        self.missing = left_out.iter().map(|file| self.dir.join(file)).collect();
        Ok(())
    }

    /// Forces all of the log to disk.
    pub(super) fn sync(&self) -> Result<(), SessionError> {
        self.log.sync()
    }

    /// Holds the session and its dreams against its world model, which was not known when it was opened.
    pub fn bind_model(&mut self, model: &ModelIdentity) -> Result<(), SessionError> {
        check_world_model(&self.dir, &self.header, Some(model))?;
        self.model = Some(model.clone());
        Ok(())
    }

    /// Fails where a dream cannot be, or cannot be one of the session's world model.
    pub(super) fn check_dream(&self, episode: &DreamEpisode) -> Result<(), DreamError> {
        arrays::check(episode)?;
        self.model.as_ref().map_or(Ok(()), |model| Ok(episode.require(model)?))
    }

    /// Writes down that `event` happened now; when this returns it is on disk, or nothing has changed.
    ///
    /// What somebody said or chose and could not be written is kept for [`Self::try_again`] and
    /// [`Self::save_as`]. It does not count before.
    pub fn record(&mut self, event: Event) -> Result<(), SessionError> {
        self.record_at(event, now())
    }

    /// The same for an event of another time, in milliseconds since 1970.
    pub fn record_at(&mut self, event: Event, at: u64) -> Result<(), SessionError> {
        self.session.check(&event)?;
        match self.log.append(event.clone(), at) {
            Ok(entry) => {
                self.session.apply(&entry)?;
                log_saved("line", entry.seq, &self.dir.join(LOG_FILE));
                self.entries.push(entry);
                self.overtake(&event);
                Ok(())
            }
            Err(e) => {
                self.overtake(&event);
                if is_said(&event) {
                    self.unsaved.push((event, at));
                }
                Err(e)
            }
        }
    }

    /// Forgets the answers that `event` is another one of.
    fn overtake(&mut self, event: &Event) {
        if let Event::Answered(answer) = event {
            self.unsaved.retain(
                |(before, _)| !matches!(before, Event::Answered(before) if before.query == answer.query),
            );
        }
    }

    /// Keeps a dream: its file first, then the event.
    pub fn save_dream(
        &mut self,
        episode: &DreamEpisode,
        source: DreamSource,
    ) -> Result<DreamId, SessionError> {
        self.keep(episode, source, None)
    }

    /// Keeps a trajectory that was made to be asked about, and what it was made to be.
    pub fn save_trajectory(
        &mut self,
        episode: &DreamEpisode,
        acquisition: Acquisition,
    ) -> Result<DreamId, SessionError> {
        self.keep(episode, DreamSource::Synthesized, Some(acquisition))
    }

    fn keep(
        &mut self,
        episode: &DreamEpisode,
        source: DreamSource,
        acquisition: Option<Acquisition>,
    ) -> Result<DreamId, SessionError> {
        let dream = DreamId(self.session.dreams().len() as u32);
        let episode = tidied(episode);
        let len = episode.len();
        let file = self.free_file(&dream_file(dream));
        let wrong = |met| SessionError::Dream { met, path: self.dir.join(&file) };
        self.check_dream(&episode).map_err(wrong)?;
        let bytes = arrays::dream_to_bytes(&episode);
        self.write(&file, &bytes, "save a dream")?;
        let planned = episode.n_planned();
        let DreamEpisode { unsafe_marks: marks, seed, .. } = episode;
        let sha256 = sha256(&bytes);
        let kept = KeptDream { dream, len, seed, marks, source, acquisition, planned, file, sha256 };
        self.record(Event::DreamKept(kept))?;
        Ok(dream)
    }

    /// The dream of this number.
    pub fn dream(&self, id: DreamId) -> Result<DreamEpisode, SessionError> {
        read_dream(&self.dir, &self.session, id, self.model.as_ref())
    }

    /// A journal for a dream that begins. It is discarded once the dream is kept or thrown away.
    pub fn journal(&self, episode: &DreamEpisode, source: DreamSource) -> Result<DreamJournal, SessionError> {
        self.log.check()?;
        DreamJournal::create(&self.dir.join(DREAMS), episode, source)
    }

    /// The dreams whose program ended before they did. Those that are driven now are not among them.
    pub fn unfinished_dreams(&self) -> Result<Vec<UnfinishedDream>, SessionError> {
        let mut found = journal::unfinished(&self.dir.join(DREAMS))?;
        // The program can end between keeping a dream and removing its journal.
        let is_kept = |left: &UnfinishedDream| {
            let mut kept = self.session.dreams().iter();
            kept.any(|kept| kept.seed == left.episode.seed && kept.len >= left.episode.len())
        };
        for left in found.extract_if(.., |left| is_kept(left)) {
            left.discard()?;
        }
        Ok(found)
    }

    /// Keeps an unfinished dream as far as it was driven.
    pub fn recover(&mut self, unfinished: UnfinishedDream) -> Result<DreamId, SessionError> {
        let dream = self.save_dream(&unfinished.episode, unfinished.source)?;
        unfinished.discard()?;
        Ok(dream)
    }

    /// Keeps the parameters of a reward and how they were learned.
    pub fn save_reward(&mut self, parameters: &Parameters, fit: Fit) -> Result<(), SessionError> {
        let file = self.free_file(&format!("{REWARDS}/{:04}.safetensors", self.session.fits().len()));
        self.write(&file, parameters.bytes(), "save a reward")?;
        self.record(Event::Fitted { fit, file, sha256: parameters.hash() })
    }

    /// The parameters of the reward that was learned last.
    pub fn reward(&self) -> Result<Option<Parameters>, SessionError> {
        let Some(last) = self.session.fits().last() else { return Ok(None) };
        read_parameters(&self.dir, last).map(|(_, parameters)| Some(parameters))
    }

    /// Puts a copy of the world model into the folder, so that the session can travel alone.
    pub fn save_world_model(&self, model: &WorldModel) -> Result<(), SessionError> {
        check_world_model(&self.dir, &self.header, Some(model.identity()))?;
        self.write(WORLD_MODEL_FILE, model.parameters().bytes(), "copy the world model")
    }

    /// The session's world model, found as [`worlds::find`] does.
    pub fn world_model(&self) -> Result<WorldModel, SessionError> {
        world_model(&self.dir, &self.header)
    }

    /// The world model of the session in `dir`, without opening the session for writing.
    pub fn read_world_model(dir: &Path) -> Result<WorldModel, SessionError> {
        world_model(dir, &Header::read(dir)?)
    }

    /// Where the world model is. Its file is read for that.
    pub fn world_model_path(&self) -> Option<PathBuf> {
        worlds::find(&self.dir, &self.header)
    }

    /// The head of the session in `dir` and its state, without opening it for writing.
    pub fn read(dir: &Path) -> Result<(Header, Session), SessionError> {
        read(dir, None).map(|reading| (reading.header, reading.session))
    }

    /// The state of the session in `dir` and the reward that was learned last, without opening it for writing.
    pub fn read_reward(dir: &Path) -> Result<(Session, Option<Parameters>), SessionError> {
        let reading = read(dir, None)?;
        let last = reading.session.fits().last();
        let reward = last.map(|fitted| read_parameters(dir, fitted)).transpose()?;
        Ok((reading.session, reward.map(|(_, parameters)| parameters)))
    }

    /// The state of the session in `dir` and its dreams, deleted ones left out, without opening it for writing.
    ///
    /// It must have been made with this world model.
    pub fn read_dreams(
        dir: &Path,
        world_model: &ModelIdentity,
    ) -> Result<(Session, Vec<(DreamId, DreamEpisode)>), SessionError> {
        let session = read(dir, Some(world_model))?.session;
        let in_use = session.dream_lens().into_iter();
        let dreams = in_use.map(|(id, _)| Ok((id, read_dream(dir, &session, id, Some(world_model))?)));
        let dreams = dreams.collect::<Result<_, SessionError>>()?;
        Ok((session, dreams))
    }

    /// Writes the answers that count as a table to `path`.
    pub fn export_labels(&self, path: &Path) -> Result<(), SessionError> {
        let table = export::labels_csv(&self.session);
        arrays::write_whole(path, table.as_bytes(), "write the table of labels")
    }

    /// The state of the session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The lines of its log, in order.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Its head.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Its folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Where a dream is kept.
    pub(super) fn dream_path(&self, dream: DreamId) -> PathBuf {
        self.dir.join(dream_file(dream))
    }

    /// What was cut off the log when the session was opened, if anything was.
    pub fn torn(&self) -> Option<&str> {
        self.torn.as_deref()
    }

    /// `file`, or the like where the session has such a file: after a repair numbers may lag behind names.
    pub(super) fn free_file(&self, file: &str) -> String {
        let stem = file.trim_end_matches(".safetensors");
        let numbered = (2..).map(|n| format!("{stem}-{n}.safetensors"));
        let dreams = self.session.dreams().iter().map(|kept| kept.file.as_str());
        let taken: BTreeSet<_> =
            dreams.chain(self.session.fits().iter().map(|fit| fit.file.as_str())).collect();
        let mut names = std::iter::once(file.to_owned()).chain(numbered);
        names.find(|name| !taken.contains(name.as_str())).unwrap_or_else(|| file.to_owned())
    }

    pub(super) fn write(&self, file: &str, bytes: &[u8], tried: &'static str) -> Result<(), SessionError> {
        // Where the folder was moved, no other is made in its place.
        self.log.check()?;
        let path = self.dir.join(file);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(SessionError::disk(tried, folder))?;
        }
        arrays::write_whole(&path, bytes, tried)
    }
}

/// Whether somebody said or chose this, so that it must not be lost. What is asked next can be asked again, and what
/// belongs to a file is kept by whoever has the file.
fn is_said(event: &Event) -> bool {
    !matches!(
        event,
        Event::Asked { .. } | Event::AskedTransition { .. } | Event::DreamKept(_) | Event::Fitted { .. }
    )
}

/// A folder called `name` below `sessions`, or the like where there is one.
pub(super) fn free_folder(sessions: &Path, name: &str) -> PathBuf {
    let mut dir = sessions.join(name);
    let mut number = 1;
    while dir.exists() || dir.with_added_extension(PARTIAL).exists() {
        number += 1;
        dir = sessions.join(format!("{name}-{number}"));
    }
    dir
}

/// A session and its head as they stand in a folder, which is left as it is.
#[derive(Debug)]
pub(super) struct Reading {
    pub(super) header: Header,
    pub(super) contents: Contents,
    pub(super) session: Session,
}

/// Reads the session in `dir`, without keeping others from it.
pub(super) fn read(dir: &Path, world_model: Option<&ModelIdentity>) -> Result<Reading, SessionError> {
    let header = Header::read(dir)?;
    check_world_model(dir, &header, world_model)?;
    let path = dir.join(LOG_FILE);
    let contents = log::read(&path)?;
    let session = fold(&header, &contents.entries, &contents.lines, &path)?;
    Ok(Reading { header, contents, session })
}

/// The dream as it is kept: a mark on the step that was never taken marks nothing.
pub(super) fn tidied(episode: &DreamEpisode) -> DreamEpisode {
    let mut episode = episode.clone();
    let len = episode.len();
    episode.unsafe_marks.retain(|mark| *mark < len);
    episode.unsafe_marks.sort_unstable();
    episode.unsafe_marks.dedup();
    episode
}

/// The session that `entries` make. `lines` are their lines in the log, where some of it is no entry.
fn fold(header: &Header, entries: &[Entry], lines: &[usize], path: &Path) -> Result<Session, SessionError> {
    header.session().folded(entries).map_err(|(n_applied, why)| SessionError::ImpossibleLine {
        line: lines.get(n_applied).map_or(n_applied + 1, |line| *line),
        why,
        path: path.to_owned(),
    })
}

fn check_world_model(dir: &Path, header: &Header, model: Option<&ModelIdentity>) -> Result<(), SessionError> {
    match model {
        Some(model) if !model.is(&header.world_model) => Err(SessionError::OtherWorldModel {
            session: header.world_model.clone(),
            model: model.hash(),
            path: dir.to_owned(),
        }),
        _ => Ok(()),
    }
}

/// A dream of the session in `dir`, which must be one of `model`, if that is known.
pub(super) fn read_dream(
    dir: &Path,
    session: &Session,
    id: DreamId,
    model: Option<&ModelIdentity>,
) -> Result<DreamEpisode, SessionError> {
    let kept = session.dreams().get(id.0 as usize).ok_or(SessionError::NoDream(id))?;
    let path = dir.join(&kept.file);
    let episode = arrays::dream_from_bytes(&read_hashed(&path, &kept.sha256)?);
    let wrong = |met| SessionError::Dream { met, path: path.clone() };
    let episode = episode.map_err(wrong)?;
    model.map_or(Ok(()), |model| Ok(episode.require(model)?)).map_err(wrong)?;
    if episode.len() == kept.len {
        Ok(episode)
    } else {
        Err(wrong(DreamError::Length { found: episode.len(), told: kept.len }))
    }
}

/// The parameters of a reward, and where they lie.
pub(super) fn read_parameters(
    dir: &Path,
    fitted: &FittedReward,
) -> Result<(PathBuf, Parameters), SessionError> {
    let path = dir.join(&fitted.file);
    let parameters = parameters(read_hashed(&path, &fitted.sha256)?, &path)?;
    Ok((path, parameters))
}

pub(super) fn world_model(dir: &Path, header: &Header) -> Result<WorldModel, SessionError> {
    let Some(path) = worlds::find(dir, header) else {
        return Err(SessionError::NoWorldModel { hash: header.world_model.clone(), path: dir.to_owned() });
    };
    let bytes = std::fs::read(&path).map_err(SessionError::disk("read the world model", &path))?;
    let parameters = parameters(bytes, &path)?;
    let model =
        WorldModel::load(parameters).map_err(|met| SessionError::WorldModel { met, path: path.clone() })?;
    check_world_model(&path, header, Some(model.identity()))?;
    Ok(model)
}

fn parameters(bytes: Vec<u8>, path: &Path) -> Result<Parameters, SessionError> {
    Parameters::from_bytes(bytes).map_err(|met| SessionError::Parameters { met, path: path.to_owned() })
}

pub(super) fn read_hashed(path: &Path, hash: &str) -> Result<Vec<u8>, SessionError> {
    let bytes = std::fs::read(path).map_err(SessionError::disk("read a file of the session", path))?;
    if sha256(&bytes) == hash { Ok(bytes) } else { Err(SessionError::Changed { path: path.to_owned() }) }
}

/// The file of a dream, from the session's folder.
pub(super) fn dream_file(dream: DreamId) -> String {
    format!("{DREAMS}/{:04}.safetensors", dream.0)
}

/// Milliseconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}
