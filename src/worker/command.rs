//! What workers hear.

use std::path::PathBuf;
use std::sync::Arc;

use crate::dream::{DreamEpisode, Rows};
use crate::planner::synthesis::Acquisition;
use crate::query::{DreamId, JudgedTransition, Label, Query, QueryId, SegmentRef};
use crate::session::DreamJournal;
use crate::tensor::Parameters;
use crate::worker::Beside;
use crate::world_model::LatentState;

/// Plays dreams at 50 steps a second, each for [`MAX_STEPS`](crate::env::MAX_STEPS) at the most.
#[derive(Debug)]
pub enum DreamerCommand {
    /// Starts a dream, journalled in `journal` where that is given.
    Start {
        /// Where it begins.
        start: LatentState,
        /// Of its noise.
        seed: u64,
        /// What holds it until it is kept; without a session there is none.
        journal: Option<DreamJournal>,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// One step while the clock stands.
    Step,
    /// Marks the present step as unsafe.
    MarkUnsafe,
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Ends the dream and reports it.
    Finish,
    /// Ends the dream and forgets it, journal and all.
    Discard,
    /// Writes the dream into this journal from now on, and what was driven so far.
    Journal(DreamJournal),
}

/// Draws clips before they are needed.
#[derive(Debug)]
pub enum ClipperCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Decodes both segments of a query.
    Decode(Query),
    /// Decodes one picture of either segment, for a list.
    Glance(Query),
}

/// Looks for signs that dreams have left the world behind.
#[derive(Debug)]
pub enum ScreenerCommand {
    /// Looks at a dream.
    AddDream(DreamId, Arc<DreamEpisode>),
}

/// Makes trajectories that are worth asking about.
#[derive(Debug)]
pub enum SynthesizerCommand {
    /// Makes one, and no longer the one before.
    Make {
        /// Where it begins.
        start: LatentState,
        /// What it is to be.
        acquisition: Acquisition,
        /// The classifier that says so; without one, or where these are a reward of another kind, a fresh one.
        reward: Option<Parameters>,
        /// The latents that transitions led to which were judged, `[N, Z]`.
        seen: Rows,
        /// Of all that is drawn.
        seed: u64,
    },
    /// Makes it no longer.
    Stop,
}

/// Learns a reward while answers come in: from preferences or from verdicts, whichever came last.
#[derive(Debug)]
pub enum TrainerCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Learns from an answer, or from another answer to the same query.
    Learn(Query, Label),
    /// Learns from a verdict on a transition, or from another verdict on the same.
    Judge(JudgedTransition),
    /// Forgets the answer to a query.
    Forget(QueryId),
    /// Says how much the reward is of two minds about each of these pairs.
    Weigh(Vec<[SegmentRef; 2]>),
    /// Learns all answers anew, for they weigh differently.
    Relearn,
    /// Starts afresh and fits all answers to the end.
    Fit {
        /// Of initialization and order.
        seed: u64,
    },
}

/// Drives the real car by plan.
#[derive(Debug)]
pub enum DriverCommand {
    /// Plans with these rewards from now on.
    Reward(Parameters),
    /// Drives an episode on the track of `seed`, once there is a reward.
    Drive {
        /// Of the track and of the planner's draws.
        seed: u64,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode; its figures are not reported, for they are not those of a whole one.
    Stop,
}

/// Looks at kept dreams again.
#[derive(Debug)]
pub enum ReviewerCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Judges by this reward from now on.
    Reward(Parameters),
    /// Compares what the rewards to come say with what the present one says.
    Compare,
    /// Draws this step, and judges the dream where that has not been done by the present reward.
    Look {
        /// Of which dream.
        dream: DreamId,
        /// Which step.
        step: usize,
    },
    /// Says what the present reward thinks of both clips of a query.
    Foretell(Query),
}

/// Lets a person drive the real car and records it; an episode that the environment ends is kept.
#[derive(Debug)]
pub enum RecorderCommand {
    /// Starts an episode on the track of `seed`, kept in the dataset at `dataset`.
    Start {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Of the track.
        seed: u64,
    },
    /// Dreams and plans with this world model from now on.
    Model(Parameters),
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Dreams beside the real car, or no longer.
    Beside(Option<Beside>),
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode and seals it.
    Keep,
    /// Ends the episode and forgets it.
    Discard,
    /// Goes on with the episode in this dataset, with all that was driven so far.
    SaveIn(PathBuf),
    /// Looks in this dataset for episodes that a killed program left behind, unless one is being driven.
    Look(PathBuf),
    /// Seals those, as far as they go.
    Recover(PathBuf),
    /// Throws them away.
    Forget(PathBuf),
}

/// Lists, opens and deletes recorded episodes, which are named by what they were recorded as.
#[derive(Debug)]
pub enum LibrarianCommand {
    /// Lists the episodes of a `LeRobot` folder.
    List(PathBuf),
    /// Opens one of them, and draws its first step.
    Open {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
    /// Draws this step of it.
    Look(usize),
    /// Judges by this world model and reward from now on, or no longer.
    Judge(Option<(Parameters, Parameters)>),
    /// Forgets the one that is open.
    Close,
    /// Deletes one, and lists the others.
    Delete {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
    /// Brings back one if it is the one that was deleted last, and lists all.
    BringBack {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
}

/// Trains a world model.
#[derive(Debug)]
pub enum ModelerCommand {
    /// Fits one to the recordings at `dataset` and writes it to `out`.
    Fit {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// The file to write.
        out: PathBuf,
        /// Whether to go on from a checkpoint.
        resume: bool,
    },
    /// Stops at the next update, which is reported as [`Report::Failed`](crate::worker::Report::Failed); it can be resumed.
    Stop,
}
