//! The application driven by a script in place of a person and a window: what happens to a session happens as there.

use std::path::PathBuf;
use std::sync::Arc;

use dropj::app::{
    App, Command, DreamCommand, Effect, FirstWorld, LabelCommand, MessageKind, Moment, RewardCommand,
    Startup, Tick,
};
use dropj::dream::DreamEpisode;
use dropj::planner::synthesis::Acquisition;
use dropj::query::{QueryId, Response, SegmentRef};
use dropj::session::{Choice, DreamSource, Fit, Session, SessionStore, now};
use dropj::tensor::Parameters;
use dropj::worker::{
    Cause, JobCommand, Learning, LoadedWorld, Report, RewardReport, SessionReport, SessionWriter,
    SessionWriterCommand, WorkerCommand, jobs,
};
use dropj::world_model::WorldModel;

/// An application with a session, whose files are written at once and in this thread.
pub(crate) struct Script {
    app: App,
    writer: SessionWriter,
    released: Option<Box<SessionStore>>,
    moment: Moment,
}

impl Script {
    /// Goes on with the session in `store`, which is one of `model`.
    pub(crate) fn new(store: SessionStore, model: &WorldModel) -> anyhow::Result<Self> {
        let world = LoadedWorld {
            name: model.hash(),
            path: None,
            parameters: model.parameters().clone(),
            card: Vec::new(),
            starts: Vec::new(),
            compact: None,
        };
        let app = App::new(Startup {
            spec: Arc::clone(model.spec()),
            spec_file: None,
            sessions: store.dir().parent().map_or_else(PathBuf::new, PathBuf::from),
            dataset: PathBuf::new(),
            seed: store.header().seed,
            world: FirstWorld::Here(Ok(Box::new(world))),
            session: Some(store),
        });
        let (writer, moment) = (SessionWriter::default(), Moment::default());
        let mut script = Self { app, writer, released: None, moment };
        script.settle()?;
        anyhow::ensure!(script.app.open().is_some(), "the session cannot be gone on with");
        Ok(script)
    }

    /// What the session's log says.
    pub(crate) fn session(&self) -> &Session {
        self.app.open().map_or_else(|| unreachable!("it was opened first"), dropj::app::OpenSession::session)
    }

    /// Has something done, and waits until all that follows from it is on disk.
    pub(crate) fn command(&mut self, command: Command) -> anyhow::Result<()> {
        let moment = Moment { nr: self.moment.nr + 1, at: self.moment.at + 1.0 };
        self.moment = moment;
        self.app.tick(Tick { moment, dt: 1.0, date: now(), has_focus: true, is_touched: true });
        self.app.command(command, moment);
        self.settle()
    }

    /// Keeps a dream, or a trajectory that was synthesized to be this.
    pub(crate) fn keep_dream(
        &mut self,
        episode: &DreamEpisode,
        source: DreamSource,
        acquisition: Option<Acquisition>,
    ) -> anyhow::Result<()> {
        let episode = Box::new(episode.clone());
        self.command(Command::Dream(DreamCommand::Offer { episode, source, acquisition }))
    }

    /// Asks about a pair.
    pub(crate) fn ask(&mut self, pair: [SegmentRef; 2], choice: Choice) -> anyhow::Result<()> {
        self.command(Command::Label(LabelCommand::Ask(pair, choice)))
    }

    /// Answers a query.
    pub(crate) fn answer(
        &mut self,
        query: QueryId,
        response: Response,
        annotator: &str,
    ) -> anyhow::Result<()> {
        let annotator = annotator.to_owned();
        self.command(Command::Label(LabelCommand::AnswerFor { query, response, annotator }))
    }

    /// Keeps a reward that was fitted to the session as it is now.
    pub(crate) fn keep_reward(&mut self, parameters: Parameters, fit: &Fit) -> anyhow::Result<()> {
        self.command(Command::Reward(RewardCommand::Fit { seed: Some(fit.seed) }))?;
        self.app.report(Report::Reward(RewardReport::Learning(Learning {
            epoch: fit.epochs as usize,
            losses: fit.losses.clone(),
            held_out_loss: fit.held_out,
            agreement: None,
            n_labels: fit.n_labels,
            fit_epochs: None,
        })));
        let (n_labels, fit) = (fit.n_labels, Some((fit.seed, fit.losses.clone())));
        self.app.report(Report::Reward(RewardReport::Learned { parameters, n_labels, fit }));
        self.settle()
    }

    /// The session, once nothing more is done with it here.
    pub(crate) fn finish(mut self) -> anyhow::Result<SessionStore> {
        let released = &mut self.released;
        self.writer.handle(SessionWriterCommand::Release, &mut |report| {
            if let SessionReport::Released(store) = report {
                *released = Some(store);
            }
        });
        let store = self.released.ok_or_else(|| anyhow::anyhow!("the session was not open"))?;
        Ok(*store)
    }

    /// Carries out what the application wants done, until there is no more; what it could not do is the error.
    fn settle(&mut self) -> anyhow::Result<()> {
        loop {
            let effects = self.app.take_effects();
            if effects.is_empty() {
                break;
            }
            let mut reports = Vec::new();
            for effect in effects {
                match effect {
                    Effect::Worker(WorkerCommand::SessionWriter(command)) => {
                        self.writer.handle(command, &mut |report| reports.push(Report::Session(report)));
                    }
                    Effect::Worker(WorkerCommand::Jobs(command @ JobCommand::ReadSession(_))) => {
                        let load: dropj::worker::LoadWorldModel = Arc::new(|path| {
                            let met = format!("nobody loads {path:?} here");
                            Err(Arc::new(std::io::Error::other(met)) as Cause)
                        });
                        jobs::run(command, &load, &mut |report| reports.push(Report::Job(report)));
                    }
                    // The script does itself what else there is to do: it shows nothing and fits at the end.
                    Effect::Worker(_)
                    | Effect::OpenDialog(..)
                    | Effect::ReleaseControls
                    | Effect::OpenWorld(_)
                    | Effect::KeepOpen => {}
                }
            }
            for report in reports {
                self.app.report(report);
            }
        }
        let messages = self.app.state().messages();
        match messages.iter().find(|message| message.kind == MessageKind::Error) {
            Some(message) => anyhow::bail!("{}", message.text),
            None => Ok(()),
        }
    }
}
