//! What workers show: plain data for the eye.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::dataset::Summary;
use crate::evaluation::EpisodeMetrics;
use crate::query::DreamId;
use crate::world::{Action, Frame, Status};

/// What a person sees while driving, and how well the clock keeps.
#[derive(Clone, Debug)]
pub struct LiveView {
    /// What the models see.
    pub frame: Frame,
    /// The real scene as a person sees it, where that is what is driven: width, height, RGB bytes.
    pub picture: Option<(u32, u32, Arc<[u8]>)>,
    /// Its number, from 0.
    pub step: usize,
    /// The action that was taken.
    pub action: Action,
    /// Steps a second over the last second.
    pub steps_per_sec: f32,
    /// Pictures a second over the last second: steps are never left out, but pictures are where time is short.
    pub pictures_per_sec: f32,
    /// Steps that came more than a step too late, since the start.
    pub n_late: usize,
    /// Whether the clock stands.
    pub is_paused: bool,
    /// Marks given so far.
    pub n_unsafe_marks: usize,
    /// Whether the planner drives, and not a person.
    pub is_planned: bool,
    /// What of the real world's present moment is worth a few words.
    pub status: Option<Status>,
}

/// How a rollout of the world model is compared with the real world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RolloutComparison {
    /// After how many steps it looks at the real world and begins anew, if ever.
    pub reset: Option<usize>,
}

/// A rollout of the world model beside the real world, under the same actions.
#[derive(Clone, Debug)]
pub struct RolloutView {
    /// What is dreamt.
    pub frame: Frame,
    /// The step of the real world.
    pub step: usize,
    /// How many steps ago the rollout last saw the real world.
    pub since: usize,
    /// How far the dream's picture is from the real one: the root of the mean squared difference, in `[0, 1]`.
    pub drift: f32,
}

/// What is predicted of one course of action.
#[derive(Clone, Debug, PartialEq)]
pub struct Promise {
    /// Its actions in words, run by run: `left 4 · straight 11`.
    pub actions: String,
    /// The return that the reward predicts of it.
    pub now: f32,
    /// The return that the reward predicted which it is compared with.
    pub before: Option<f32>,
}

/// A step of a kept dream, looked at again.
#[derive(Clone, Debug)]
pub struct ReviewView {
    /// Of which dream.
    pub dream: DreamId,
    /// Which step.
    pub step: usize,
    /// What was seen.
    pub frame: Frame,
    /// What the planner would choose from there; nothing without a reward.
    pub promises: Vec<Promise>,
    /// The one that it would drive.
    pub chosen: usize,
    /// The one that it would have driven by the reward that this one is compared with.
    pub chosen_before: Option<usize>,
}

/// What the reward says of every step of a dream.
#[derive(Clone, Debug, PartialEq)]
pub struct DreamRewards {
    /// Which dream.
    pub dream: DreamId,
    /// The mean of the ensemble, step by step.
    pub rewards: Vec<f32>,
    /// The lowest of its members.
    pub low: Vec<f32>,
    /// The highest.
    pub high: Vec<f32>,
}

/// What the reward says of every step of a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipRewards {
    /// The reward, step by step.
    pub rewards: Vec<f32>,
    /// What each member says alone.
    pub members: Vec<Vec<f32>>,
}

impl ClipRewards {
    /// What the clip is worth as a whole: the sum over its steps, by which clips are compared.
    pub fn sum(&self) -> f32 {
        self.rewards.iter().sum()
    }
}

/// What a folder of recordings holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EpisodeList {
    /// The `LeRobot` folder.
    pub dataset: PathBuf,
    /// Its sealed episodes, in the order of their numbers.
    pub episodes: Vec<Summary>,
    /// Why some of its files cannot be read, a sentence each.
    pub damaged: Vec<String>,
    /// The episode that was deleted last, if it can be brought back.
    pub deleted: Option<Summary>,
    /// Whether this is reported because an episode was deleted or brought back, or was to be.
    pub is_changed: bool,
}

/// A recorded episode without its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenEpisode {
    /// Which.
    pub recording: String,
    /// What was done at each step.
    pub actions: Vec<Action>,
    /// What the environment gave for it, which the method never sees.
    pub rewards: Vec<f32>,
    /// The steps in which something went on that must not happen.
    pub unsafe_steps: Vec<Range<usize>>,
    /// The steps that the planner drove.
    pub planned: Vec<Range<usize>>,
}

/// A step of a recorded episode.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeView {
    /// Of which.
    pub recording: String,
    /// Which step.
    pub step: usize,
    /// What the models see there.
    pub frame: Frame,
}

/// A step of an episode that the planner drove, and that was driven again.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayView {
    /// Of which.
    pub replay: u64,
    /// Which step.
    pub step: usize,
    /// What the models see there.
    pub frame: Frame,
}

/// One imagined future, for the eye.
#[derive(Clone, Debug)]
pub struct CandidateView {
    /// Its actions in words, run by run: `left 4 · straight 11`.
    pub actions: String,
    /// The return that the reward predicts.
    pub predicted_return: f32,
    /// Its last picture, and a few on the way.
    pub frames: Vec<Frame>,
}

/// The real car under the planner, and the plans that it considered.
#[derive(Clone, Debug)]
pub struct DriveView {
    /// What the models see.
    pub frame: Frame,
    /// The scene as a person sees it: width, height, RGB bytes.
    pub picture: (u32, u32, Arc<[u8]>),
    /// Steps so far.
    pub step: usize,
    /// The running figures of this episode.
    pub metrics: EpisodeMetrics,
    /// The candidates of a recent plan, in order: the latest one that there was time to draw.
    pub candidates: Arc<[CandidateView]>,
    /// Which of these was chosen.
    pub chosen: usize,
    /// How long the latest plan took, in milliseconds.
    pub plan_ms: f32,
    /// What of this moment is worth a few words.
    pub status: Option<Status>,
}
