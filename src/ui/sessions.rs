//! What is done with sessions: beginning, opening, and going on where a killed program left off.

use std::ops::ControlFlow;

use crate::query::Protocol;
use crate::session::{Header, LoadedSession, SessionError, SessionStore, UnfinishedDream, now};
use crate::text::shown;
use crate::ui::App;
use crate::ui::act::{counted, fresh_seed};
use crate::ui::command::{Command, Panel};
use crate::ui::crew::Order;
use crate::ui::elsewhere::Saving;
use crate::ui::state::Rewarding;
use crate::worker::{DriverCommand, TrainerCommand};

impl App {
    pub(super) fn new_session(&mut self, protocol: Protocol) {
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        if self.is_unsaved() {
            return self.save_first();
        }
        let Some(world) = &self.state.world.loaded else {
            self.fail("a session needs a world model: load one first".to_owned());
            return;
        };
        let path = world.path.as_ref().and_then(|path| std::path::absolute(path).ok());
        let path = path.map(|path| path.display().to_string());
        let header =
            Header::new(&self.state.env, protocol, fresh_seed() >> 11, &self.state.world.hash, now());
        let header = Header { world_model_path: path, ..header };
        match SessionStore::create_in(&self.sessions, header) {
            Ok(store) => {
                self.state.sessions_open = false;
                self.give_up_opening();
                // There is nothing to read yet.
                if let Some(opened) = LoadedSession::read(store, &mut |_, _| ControlFlow::Continue(())) {
                    self.adopt(opened);
                }
                // Nothing is to be driven: what is asked about is made there.
                if protocol == Protocol::Request {
                    self.act_on_label(Command::MakeTrajectories(true));
                    self.show(Panel::Label);
                }
            }
            Err(e) => {
                self.no_place(&e.to_string());
            }
        }
    }

    pub(super) fn restart(&mut self) {
        if let Some(world) = self.state.world.loaded.clone() {
            self.forget_workers();
            self.crew.change_world(&world.parameters);
        }
        if let Some(store) = self.state.store.take() {
            self.read_session(store);
        }
    }

    /// Goes on with a session, telling the workers all that is in it.
    pub(super) fn adopt(&mut self, opened: LoadedSession) {
        let LoadedSession { store, dreams, reward, unfinished } = opened;
        self.end_dream();
        self.forget_workers();
        self.state.deploy.is_on = false;
        self.state.saving = Saving::default();
        self.forget_troubles();
        (self.state.label, self.state.reward) = (self.state.label.anew(), Rewarding::default());
        if let Some(torn) = store.torn() {
            self.warn(format!(
                "the last line of this session was cut short when the program ended: {}",
                shown(torn)
            ));
        }
        for (id, dream) in dreams {
            match dream {
                Ok(episode) => self.teach_dream(id, episode),
                Err(e) => {
                    self.state.label.unreadable.push(id);
                    self.fail(e.to_string());
                }
            }
        }
        let verdicts = store.session().judged().into_iter().map(TrainerCommand::Judge);
        let labels = store.session().labeled().into_iter();
        let labels = labels.map(|labeled| TrainerCommand::Learn(labeled.query, labeled.label));
        // What was said last is what the next reward is learned from.
        let orders: Vec<_> = if store.session().ends_with_verdicts() {
            labels.chain(verdicts).collect()
        } else {
            verdicts.chain(labels).collect()
        };
        for order in orders {
            self.crew.send(Order::Trainer(order));
        }
        match reward {
            Ok(Some(parameters)) => {
                self.state.reward.n_learned =
                    store.session().fits().last().map_or(0, |fitted| fitted.fit.n_labels);
                self.state.reward.parameters = Some(parameters.clone());
                self.crew.send(Order::Driver(DriverCommand::Reward(parameters)));
            }
            Ok(None) => {}
            Err(e) => self.fail(e.to_string()),
        }
        self.state.store = Some(store);
        self.offer_unfinished(unfinished);
    }

    fn offer_unfinished(&mut self, found: Result<Vec<UnfinishedDream>, SessionError>) {
        match found {
            Ok(found) => self.state.unfinished = found,
            Err(e) => self.fail(e.to_string()),
        }
        let n = self.state.unfinished.len();
        if n > 0 {
            let text = format!("{} survived a program that was ended while driving", counted(n, "dream"));
            let ways = [("Keep", Command::RecoverDreams), ("Throw away", Command::DiscardUnfinished)];
            self.offer(text, ways.map(|(name, command)| (name.to_owned(), command)).into());
        }
    }

    pub(super) fn recover(&mut self) {
        if self.state.unfinished.is_empty() {
            let Some(store) = &self.state.store else { return };
            self.state.unfinished = store.unfinished_dreams().unwrap_or_default();
        }
        for left in std::mem::take(&mut self.state.unfinished) {
            let Some(store) = &mut self.state.store else { return };
            let episode = left.episode.clone();
            match store.recover(left) {
                Ok(id) => {
                    self.teach_dream(id, episode);
                    self.done(format!("dream {} is kept", id.0 + 1));
                }
                Err(e) => self.fail(e.to_string()),
            }
        }
    }

    pub(super) fn discard_unfinished(&mut self) {
        for left in std::mem::take(&mut self.state.unfinished) {
            if let Err(e) = left.discard() {
                self.fail(e.to_string());
            }
        }
    }
}
