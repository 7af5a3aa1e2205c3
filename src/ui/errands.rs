//! Work on files that somebody asks for now and then, such as putting sessions together: in a thread of its own.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use eframe::egui::Context;

use crate::dataset::Dataset;
use crate::session::header::FILE as SESSION_FILE;
use crate::session::{Annotators, ListedSession, Session, hand_on_in, list_sessions, merge_in, share_dreams};
use crate::text::{distinct, shown};
use crate::ui::App;
use crate::ui::act::counted;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::dialog::{Dialog, Purpose};
use crate::ui::state::{RecentSession, is_called};
use crate::worker::Job;

/// What is done with sessions of several annotators.
#[derive(Clone, Debug, Default)]
pub(crate) struct Several {
    pub is_open: bool,
    /// Sessions that could be put together, once they were looked at.
    pub found: Option<Vec<RecentSession>>,
    /// Those that are to be.
    pub chosen: BTreeSet<PathBuf>,
    /// Folders that were named beside those where sessions are kept.
    added: Vec<PathBuf>,
}

/// What came of an errand.
pub(super) enum Outcome {
    /// Sessions were looked at, so many folders of which had been named.
    Found(Vec<RecentSession>, usize),
    /// Those were compared who answered about the dreams of the session in this folder.
    Compared(PathBuf, Annotators),
    /// A session was made; the sentence says what it holds.
    Made(PathBuf, String),
    /// Recordings were looked at; the sentence says what they are.
    Recordings(PathBuf, String),
}

/// An errand that is being run.
pub(super) type Errand = Job<Result<Outcome, String>>;

impl App {
    /// Runs an errand that is called `doing`, unless another is being run.
    fn run(
        &mut self,
        ctx: &Context,
        doing: &'static str,
        work: impl FnOnce() -> Result<Outcome, String> + Send + 'static,
    ) {
        if let Some(other) = self.state.errand {
            return self.warn(format!("one thing after the other: {other} is not done yet"));
        }
        self.state.errand = Some(doing);
        let waker = ctx.clone();
        self.errand = Some(Job::begin("errand", move || waker.request_repaint(), work));
    }

    /// Hears what came of an errand, and looks at sessions where that is to be seen.
    pub(super) fn hear_errands(&mut self, ctx: &Context) {
        self.hear_errand();
        if self.state.several.is_open && self.state.several.found.is_none() && self.errand.is_none() {
            self.look_for_several(ctx);
        }
    }

    fn hear_errand(&mut self) {
        let Some(job) = &mut self.errand else { return };
        let is_over = job.is_over();
        let outcome = match job.poll() {
            Some(outcome) => outcome,
            None if is_over => Err("this could not be done, and that is a bug of ours".to_owned()),
            None => return,
        };
        (self.errand, self.state.errand) = (None, None);
        match outcome {
            Ok(Outcome::Found(found, n_added)) => {
                let several = &mut self.state.several;
                several.found = Some(found).filter(|_| several.added.len() == n_added);
            }
            Ok(Outcome::Compared(dir, annotators)) => {
                let is_open = self.state.store.as_ref().is_some_and(|store| store.dir() == dir);
                self.state.label.annotators = Some(annotators).filter(|_| is_open);
            }
            Ok(Outcome::Made(dir, said)) => {
                self.state.several = Several::default();
                self.offer(said, vec![("Open it".to_owned(), Command::OpenSession(dir))]);
            }
            Ok(Outcome::Recordings(dir, said)) => {
                let out = dir.with_added_extension("safetensors");
                self.state.fields.insert(Field::Dataset, dir.display().to_string());
                self.state.fields.insert(Field::ModelOut, out.display().to_string());
                self.state.sessions_open = false;
                let ways = [("Record more", Panel::Record), ("Fit a world model", Panel::World)];
                self.offer(said, ways.map(|(name, panel)| (name.to_owned(), Command::Show(panel))).into());
            }
            Err(sentence) => {
                self.state.several.found.get_or_insert_default();
                self.fail(sentence);
            }
        }
    }

    /// Takes in what is dropped on the window.
    pub(super) fn hear_drops(&mut self, ctx: &Context) {
        let dropped = ctx.input(|input| input.raw.dropped_files.clone());
        for path in dropped.iter().map(|file| file.path().to_owned()) {
            let is_file = path.extension().is_some_and(|extension| extension == "safetensors");
            let is_session = path.join(SESSION_FILE).exists();
            let command = match path {
                path if is_file => Command::LoadWorld(path),
                path if !is_session => Command::UseRecordings(path),
                path if self.state.several.is_open => Command::AddToSeveral(path),
                path => Command::OpenSession(path),
            };
            self.act(ctx, command);
        }
    }

    pub(super) fn hear_dialog(&mut self, ctx: &Context) {
        let Some(chosen) = self.dialog.as_mut().and_then(Dialog::poll) else { return };
        let Some(Dialog { purpose, .. }) = self.dialog.take() else { return };
        let chosen = match chosen {
            Ok(chosen) => chosen,
            Err(sentence) => return self.fail(sentence),
        };
        for path in chosen {
            match purpose {
                Purpose::Field(field) => drop(self.state.fields.insert(field, path.display().to_string())),
                Purpose::World => self.act(ctx, Command::LoadWorld(path)),
                Purpose::Recordings => self.act(ctx, Command::UseRecordings(path)),
                Purpose::Several => self.act(ctx, Command::AddToSeveral(path)),
            }
        }
    }

    pub(super) fn act_on_errands(&mut self, ctx: &Context, command: &Command) {
        let several = &mut self.state.several;
        match command {
            Command::Import(purpose) => self.dialog = Some(Dialog::open(ctx, *purpose, "")),
            Command::UseRecordings(dir) => self.use_recordings(ctx, dir.clone()),
            Command::CompareAnnotators => self.compare_annotators(ctx),
            Command::ToggleSeveral if several.is_open => *several = Several::default(),
            Command::ToggleSeveral => {
                *several = Several { is_open: true, ..Several::default() };
                if let Some(store) = &self.state.store {
                    several.chosen.insert(store.dir().to_owned());
                    several.added.push(store.dir().to_owned());
                }
            }
            Command::AddToSeveral(dir) => {
                // It keeps the name that it was first added by.
                let known = several.added.iter().find(|known| is_same(known, dir)).cloned();
                if known.is_none() {
                    several.added.push(dir.clone());
                    several.found = None;
                }
                several.chosen.insert(known.unwrap_or_else(|| dir.clone()));
            }
            Command::ChooseForSeveral(dir, is_chosen) => {
                if *is_chosen {
                    several.chosen.insert(dir.clone());
                } else {
                    several.chosen.remove(dir);
                }
            }
            Command::Merge => self.merge(ctx),
            Command::HandOn => self.hand_on(ctx),
            _ => {}
        }
    }

    /// Looks in all sessions for people who answered about the dreams of this one.
    fn compare_annotators(&mut self, ctx: &Context) {
        let Some(store) = &self.state.store else { return };
        let (own, dir, sessions) = (store.session().clone(), store.dir().to_owned(), self.sessions.clone());
        self.run(ctx, "comparing annotators", move || {
            let found = list_sessions(&sessions).map_err(|e| e.to_string())?;
            let others = found.iter().filter(|recent| !is_same(&recent.dir, &dir));
            let others = others.filter_map(|recent| Some((&recent.dir, &recent.session.as_ref().ok()?.1)));
            let others = others.filter(|(_, other)| share_dreams(&own, other));
            let (dirs, all): (Vec<_>, Vec<_>) = std::iter::once((&dir, &own)).chain(others).unzip();
            let named: Vec<_> = distinct(&dirs).into_iter().zip(all).collect();
            Ok(Outcome::Compared(dir.clone(), Annotators::of_sessions(&named)))
        });
    }

    fn look_for_several(&mut self, ctx: &Context) {
        let (sessions, added) = (self.sessions.clone(), self.state.several.added.clone());
        let hash = self.state.header().map_or(&self.state.world.hash, |header| &header.world_model).clone();
        let identity = self.state.world.identity.clone();
        self.run(ctx, "looking at the sessions", move || {
            let is_ours = |named: &str| hash.is_empty() || is_called(identity.as_ref(), &hash, named);
            let mut found = list_sessions(&sessions).map_err(|e| e.to_string())?;
            // A folder of those may have been named once more.
            let is_new = |dir: &&PathBuf| !found.iter().any(|known| is_same(&known.dir, dir));
            let new: Vec<_> = added.iter().filter(is_new).map(|dir| ListedSession::read(dir)).collect();
            found.extend(new);
            let found: Vec<_> = found.iter().map(|recent| described(recent, &is_ours, &added)).collect();
            let names = distinct(&found.iter().map(|session| &session.dir).collect::<Vec<_>>());
            let found = found.into_iter().zip(names);
            let found =
                found.map(|(session, name)| RecentSession { name: shown(&name), ..session }).collect();
            Ok(Outcome::Found(found, added.len()))
        });
    }

    fn merge(&mut self, ctx: &Context) {
        // What answers weigh is as in the first: the one that is open, if it is among them.
        let open = self.state.store.as_ref().map(|store| store.dir().to_owned());
        let several = &self.state.several;
        let ticked = several.found.iter().flatten();
        let ticked = ticked.filter(|it| it.about.is_ok() && several.chosen.contains(&it.dir));
        let mut dirs: Vec<_> = ticked.map(|it| it.dir.clone()).collect();
        dirs.sort_by_key(|dir| Some(dir) != open.as_ref());
        let sessions = self.sessions.clone();
        self.run(ctx, "putting sessions together", move || {
            let merged = merge_in(&dirs, &sessions).map_err(|e| e.to_string())?;
            let n = counted(dirs.len(), "session");
            let said = format!("{n} put together in {}: {}", name(merged.dir()), holds(merged.session()));
            Ok(Outcome::Made(merged.dir().to_owned(), said))
        });
    }

    fn hand_on(&mut self, ctx: &Context) {
        let Some(dir) = self.state.store.as_ref().map(|store| store.dir().to_owned()) else { return };
        let (sessions, annotator) =
            (self.sessions.clone(), self.state.field(Field::HandOnTo).trim().to_owned());
        self.run(ctx, "handing the session on", move || {
            let handed = hand_on_in(&dir, &sessions, &annotator).map_err(|e| e.to_string())?;
            let n = handed.session().pending().count();
            let queries = if n == 1 { "1 query waits".to_owned() } else { format!("{n} queries wait") };
            let said = format!("{queries} for {} in {}", shown(&annotator), name(handed.dir()));
            Ok(Outcome::Made(handed.dir().to_owned(), said))
        });
    }

    fn use_recordings(&mut self, ctx: &Context, dir: PathBuf) {
        if self.state.record.is_on {
            return self.warn("end the recording first: keep it, or leave it".to_owned());
        }
        let env = self.state.env.clone();
        self.run(ctx, "looking at the recordings", move || {
            let dataset = Dataset::open(&dir).map_err(|e| e.to_string())?;
            if dataset.env().is_some_and(|found| found != env) {
                let found = dataset.env().unwrap_or_default();
                return Err(format!(
                    "these recordings are of {found} and this window is about {env}: start `dropj --env {found}` for them"
                ));
            }
            let (episodes, steps) = (counted(dataset.n_episodes(), "episode"), dataset.n_steps());
            let damaged = match dataset.damaged().len() {
                0 => String::new(),
                n => format!("; {} cannot be read", counted(n, "file")),
            };
            let said = format!("recordings are in {} from here on: {episodes}, {steps} steps{damaged}", name(&dir));
            Ok(Outcome::Recordings(dir, said))
        });
    }
}

/// Whether both name the same folder.
pub(super) fn is_same(one: &Path, other: &Path) -> bool {
    std::path::absolute(one).ok() == std::path::absolute(other).ok()
}

/// A session among those that could be put together with one of the world model that is called what `is_ours` says.
///
/// One of `added` keeps the name that it was added by.
fn described(recent: &ListedSession, is_ours: &dyn Fn(&str) -> bool, added: &[PathBuf]) -> RecentSession {
    let about = match &recent.session {
        Ok((header, _)) if !is_ours(&header.world_model) => {
            Err("dreamed with another world model".to_owned())
        }
        Ok((_, session)) => Ok(holds(session)),
        Err(e) => Err(e.to_string()),
    };
    let dir = added.iter().find(|dir| is_same(dir, &recent.dir)).unwrap_or(&recent.dir).clone();
    RecentSession { name: name(&dir), dir, about }
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
