//! Sessions of several annotators, and other single pieces of work on files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::app::session::is_same;
use crate::app::{
    App, Command, Effect, EvaluateCommand, Field, Panel, RecordCommand, SessionCommand, WindowCommand,
    WorldModelCommand,
};
use crate::session::Annotators;
use crate::worker::{Dropped, JobCommand, SessionItem, WorkerError};

/// What is done with sessions of several annotators.
#[derive(Clone, Debug, Default)]
pub(crate) struct Merging {
    pub is_open: bool,
    /// Sessions that could be merged, once they were looked at.
    pub found: Option<Vec<SessionItem>>,
    /// Those that are to be.
    pub chosen: BTreeSet<PathBuf>,
    /// Folders that were named beside those where sessions are kept.
    added: Vec<PathBuf>,
}

impl App {
    /// Has a piece of work done that is called `doing`, unless another is being done.
    pub(in crate::app) fn begin_job(&mut self, doing: &'static str, job: JobCommand) {
        if let Some(other) = self.state.job {
            return self.warn(format!("one thing after the other: {other} is not done yet"));
        }
        self.state.job = Some(doing);
        self.job(job);
    }

    /// Has the sessions listed that could be merged, where that is to be seen.
    pub(in crate::app) fn advance_merge(&mut self) {
        let merge = &self.state.merge;
        if !merge.is_open || merge.found.is_some() || self.state.job.is_some() {
            return;
        }
        let (sessions, added) = (self.sessions.clone(), merge.added.clone());
        let hash = self.state.header().map_or(&self.state.world.hash, |header| &header.world_model).clone();
        let model = self.state.world.identity.clone();
        self.begin_job("looking at the sessions", JobCommand::ListMergeable { sessions, added, hash, model });
    }

    pub(super) fn mergeable(&mut self, found: Vec<SessionItem>, n_added: usize) {
        self.state.job = None;
        let merge = &mut self.state.merge;
        merge.found = Some(found).filter(|_| merge.added.len() == n_added);
    }

    pub(super) fn annotators_compared(&mut self, dir: &Path, annotators: Annotators) {
        self.state.job = None;
        let is_open = self.state.open.as_ref().is_some_and(|open| open.dir == dir);
        self.state.label.annotators = Some(annotators).filter(|_| is_open);
    }

    pub(super) fn session_made(&mut self, dir: PathBuf, said: String) {
        self.state.job = None;
        self.state.merge = Merging::default();
        let open = Command::Session(SessionCommand::Open(dir));
        self.offer(said, vec![("Open it".to_owned(), open)]);
    }

    pub(super) fn recordings_found(&mut self, dir: &Path, said: String) {
        self.state.job = None;
        let out = dir.with_added_extension("safetensors");
        self.state.fields.insert(Field::Dataset, dir.display().to_string());
        self.state.fields.insert(Field::ModelOut, out.display().to_string());
        self.state.list.is_open = false;
        let ways = [("Record more", Panel::Record), ("Fit a world model", Panel::World)];
        let way =
            |(name, panel): (&str, Panel)| (name.to_owned(), Command::Window(WindowCommand::Show(panel)));
        self.offer(said, ways.map(way).into());
    }

    pub(super) fn job_failed(&mut self, error: &WorkerError) {
        self.state.job = None;
        self.state.merge.found.get_or_insert_default();
        self.fail(error.to_string());
    }

    /// Takes in what was dropped on the window.
    pub(super) fn dropped(&mut self, path: PathBuf, dropped: Dropped) {
        match dropped {
            Dropped::WorldModel => self.world_model_command(WorldModelCommand::Load(path)),
            Dropped::World => self.open_world(path),
            Dropped::Recordings => self.record_command(RecordCommand::UseDataset(path)),
            Dropped::Results => self.evaluate_command(EvaluateCommand::Open(path)),
            Dropped::Session if self.state.merge.is_open => self.add_to_merge(path),
            Dropped::Session => self.session_command(SessionCommand::Open(path)),
        }
    }

    /// Has the program begin anew with the world in this file, once nothing of this one would be lost.
    fn open_world(&mut self, file: PathBuf) {
        if self.is_unsaved() {
            return self.save_first();
        }
        let state = &self.state;
        let why = if state.dream.is_on || state.record.is_on {
            "end this episode first: keep it, or leave it"
        } else if state.world.fit.is_some() {
            "a world model is being fitted: wait for it, or stop it first"
        } else if state.job.is_some() || !self.writing.is_empty() {
            "one moment: something is still being written"
        } else {
            return self.effects.push(Effect::OpenWorld(file));
        };
        self.warn(why.to_owned());
    }

    pub(super) fn toggle_merge(&mut self) {
        let is_open = !self.state.merge.is_open;
        self.state.merge = Merging { is_open, ..Merging::default() };
        if let Some(open) = self.state.open.as_ref().filter(|_| is_open) {
            self.state.merge.chosen.insert(open.dir.clone());
            self.state.merge.added.push(open.dir.clone());
        }
    }

    pub(super) fn add_to_merge(&mut self, dir: PathBuf) {
        let merge = &mut self.state.merge;
        // It keeps the name that it was first added by.
        let known = merge.added.iter().find(|known| is_same(known, &dir)).cloned();
        if known.is_none() {
            merge.added.push(dir.clone());
            merge.found = None;
        }
        merge.chosen.insert(known.unwrap_or(dir));
    }

    pub(super) fn choose_for_merge(&mut self, dir: PathBuf, is_chosen: bool) {
        let chosen = &mut self.state.merge.chosen;
        if is_chosen {
            chosen.insert(dir);
        } else {
            chosen.remove(&dir);
        }
    }

    /// Looks in all sessions for people who answered about the dreams of this one.
    pub(super) fn compare_annotators(&mut self) {
        let Some(open) = &self.state.open else { return };
        let (dir, session) = (open.dir.clone(), Box::new(open.session.clone()));
        let sessions = self.sessions.clone();
        self.begin_job("comparing annotators", JobCommand::CompareAnnotators { dir, session, sessions });
    }

    pub(super) fn merge_sessions(&mut self) {
        // What answers weigh is as in the first: the one that is open, if it is among them.
        let open = self.state.open.as_ref().map(|open| open.dir.clone());
        let merge = &self.state.merge;
        let ticked = merge.found.iter().flatten();
        let ticked = ticked.filter(|it| it.about.is_ok() && merge.chosen.contains(&it.dir));
        let mut dirs: Vec<_> = ticked.map(|it| it.dir.clone()).collect();
        dirs.sort_by_key(|dir| Some(dir) != open.as_ref());
        let sessions = self.sessions.clone();
        self.begin_job("putting sessions together", JobCommand::Merge { dirs, sessions });
    }

    pub(super) fn hand_on(&mut self) {
        let Some(open) = &self.state.open else { return };
        let (dir, sessions) = (open.dir.clone(), self.sessions.clone());
        let annotator = self.state.field(Field::HandOnTo).trim().to_owned();
        self.begin_job("handing the session on", JobCommand::HandOver { dir, sessions, annotator });
    }
}
