//! A session in its folder: every event is on disk before it counts.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::dream::DreamEpisode;
use crate::planner::synthesis::Acquisition;
use crate::query::DreamId;
use crate::run::sync_folder;
use crate::session::error::SessionError;
use crate::session::event::{DreamSource, Event, Fit, KeptDream};
use crate::session::header::{FORMAT, Header};
use crate::session::journal::{self, DreamJournal, UnfinishedDream};
use crate::session::log::{self, Contents, Log};
use crate::session::{FittedReward, Session, arrays, export};
use crate::tensor::{Parameters, sha256};
use crate::world_model::{ModelIdentity, WorldModel};

pub(super) const LOG_FILE: &str = "events.jsonl";
const DREAMS: &str = "dreams";
const REWARDS: &str = "reward";
const WORLD_MODEL_FILE: &str = "world_model.safetensors";

/// A session that is open, with everything that happens in it going to disk.
#[derive(Debug)]
pub struct SessionStore {
    dir: PathBuf,
    header: Header,
    session: Session,
    log: Log,
    torn: Option<String>,
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
        std::fs::create_dir_all(dir).map_err(SessionError::disk("make the folder of a session", dir))?;
        let log = Log::create(&dir.join(LOG_FILE))?;
        // The header comes last: a folder without one is no session.
        header.write(dir)?;
        sync_folder(dir).map_err(SessionError::disk("make the folder of a session", dir))?;
        Ok(Self { dir: dir.to_owned(), session: header.session(), header, log, torn: None, model: None })
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
        let mut header = Header::read(dir)?;
        check_world_model(dir, &header, world_model)?;
        let path = dir.join(LOG_FILE);
        let (log, contents) = Log::open(&path)?;
        let session = fold(&header, &contents, &path)?;
        if header.format < FORMAT {
            // What is appended from here on is not for the program that began it.
            header.format = FORMAT;
            header.write(dir)?;
        }
        let model = world_model.cloned();
        Ok(Self { dir: dir.to_owned(), header, session, log, torn: contents.torn, model })
    }

    /// Holds the session and its dreams against its world model, which was not known when it was opened.
    pub fn meet(&mut self, model: &ModelIdentity) -> Result<(), SessionError> {
        check_world_model(&self.dir, &self.header, Some(model))?;
        self.model = Some(model.clone());
        Ok(())
    }

    /// Fails where a dream cannot be, or cannot be one of the session's world model.
    pub(super) fn check_dream(&self, episode: &DreamEpisode) -> Result<(), String> {
        arrays::check(episode)?;
        self.model.as_ref().map_or(Ok(()), |model| episode.require(model))
    }

    /// Writes down that `event` happened now; when this returns it is on disk, or nothing has changed.
    pub fn record(&mut self, event: Event) -> Result<(), SessionError> {
        self.record_at(event, now())
    }

    /// The same for an event of another time, in milliseconds since 1970.
    pub fn record_at(&mut self, event: Event, at: u64) -> Result<(), SessionError> {
        self.session.check(&event)?;
        let entry = self.log.append(event, at)?;
        self.session.apply(&entry)?;
        Ok(())
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
        let mut episode = episode.clone();
        // A mark on the step that was never taken marks nothing.
        let len = episode.len();
        episode.unsafe_marks.retain(|mark| *mark < len);
        episode.unsafe_marks.sort_unstable();
        episode.unsafe_marks.dedup();
        let file = dream_file(dream);
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

    /// A journal for a dream that begins; it is discarded once the dream is kept or thrown away.
    pub fn journal(&self, episode: &DreamEpisode, source: DreamSource) -> Result<DreamJournal, SessionError> {
        DreamJournal::create(&self.dir.join(DREAMS), episode, source)
    }

    /// The dreams whose program ended before they did; those that are driven now are not among them.
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
        let file = format!("{REWARDS}/{:04}.safetensors", self.session.fits().len());
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

    /// The session's world model: the copy in its folder, or else where the header says that it was.
    pub fn world_model(&self) -> Result<WorldModel, SessionError> {
        world_model(&self.dir, &self.header)
    }

    /// The world model of the session in `dir`, without opening the session for writing.
    pub fn read_world_model(dir: &Path) -> Result<WorldModel, SessionError> {
        world_model(dir, &Header::read(dir)?)
    }

    /// Where the world model is, if it still is where the session says.
    pub fn world_model_path(&self) -> Option<PathBuf> {
        world_model_path(&self.dir, &self.header)
    }

    /// The state of the session in `dir` and the reward that was learned last, without opening it for writing.
    pub fn read_reward(dir: &Path) -> Result<(Session, Option<Parameters>), SessionError> {
        let reading = read(dir, None)?;
        let last = reading.session.fits().last();
        let reward = last.map(|fitted| read_parameters(dir, fitted)).transpose()?;
        Ok((reading.session, reward.map(|(_, parameters)| parameters)))
    }

    /// The state of the session in `dir` and its dreams, without opening it for writing.
    ///
    /// It must have been made with this world model.
    pub fn read_dreams(
        dir: &Path,
        world_model: &ModelIdentity,
    ) -> Result<(Session, Vec<(DreamId, DreamEpisode)>), SessionError> {
        let session = read(dir, Some(world_model))?.session;
        let read =
            |kept: &KeptDream| Ok((kept.dream, read_dream(dir, &session, kept.dream, Some(world_model))?));
        let dreams = session.dreams().iter().map(read).collect::<Result<_, SessionError>>()?;
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

    pub(super) fn write(&self, file: &str, bytes: &[u8], tried: &'static str) -> Result<(), SessionError> {
        let path = self.dir.join(file);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(SessionError::disk(tried, folder))?;
        }
        arrays::write_whole(&path, bytes, tried)
    }
}

/// A folder called `name` below `sessions`, or the like where there is one.
pub(super) fn free_folder(sessions: &Path, name: &str) -> PathBuf {
    let mut dir = sessions.join(name);
    let mut number = 1;
    while dir.exists() {
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
    let session = fold(&header, &contents, &path)?;
    Ok(Reading { header, contents, session })
}

fn fold(header: &Header, contents: &Contents, path: &Path) -> Result<Session, SessionError> {
    header.session().folded(&contents.entries).map_err(|(n_applied, why)| SessionError::ImpossibleLine {
        line: n_applied + 1,
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
    model.map_or(Ok(()), |model| episode.require(model)).map_err(wrong)?;
    if episode.len() == kept.len {
        Ok(episode)
    } else {
        Err(wrong(format!("it has {} steps where the log says {}", episode.len(), kept.len)))
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
    let Some(path) = world_model_path(dir, header) else {
        return Err(SessionError::NoWorldModel { hash: header.world_model.clone(), path: dir.to_owned() });
    };
    let bytes = std::fs::read(&path).map_err(SessionError::disk("read the world model", &path))?;
    let parameters = parameters(bytes, &path)?;
    let model =
        WorldModel::load(parameters).map_err(|met| SessionError::WorldModel { met, path: path.clone() })?;
    check_world_model(&path, header, Some(model.identity()))?;
    Ok(model)
}

pub(super) fn world_model_path(dir: &Path, header: &Header) -> Option<PathBuf> {
    let hinted = header.world_model_path.as_ref().map(|hint| dir.join(hint));
    [Some(dir.join(WORLD_MODEL_FILE)), hinted].into_iter().flatten().find(|path| path.exists())
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
