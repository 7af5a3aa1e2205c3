//! What workers tell.

use std::path::PathBuf;

use crate::dream::{DreamEpisode, Rows};
use crate::env::Frame;
use crate::evaluation::EpisodeMetrics;
use crate::planner::synthesis::Acquisition;
use crate::query::{DreamId, Query, SegmentRef};
use crate::session::DreamJournal;
use crate::tensor::Parameters;
use crate::worker::{ClipRewards, Judgement, OpenEpisode, Shelf};
use crate::world_model::fit::Progress;

/// What a worker tells the window: one closed list, one inbox.
#[derive(Debug)]
pub enum Report {
    /// A dream ended and is offered for keeping.
    Dreamt {
        /// As it was driven.
        episode: DreamEpisode,
        /// What to discard once it is kept or thrown away.
        journal: Option<DreamJournal>,
    },
    /// A query's clips are ready.
    Clips {
        /// Which.
        query: Query,
        /// Twenty pictures.
        left: Vec<Frame>,
        /// Twenty pictures.
        right: Vec<Frame>,
    },
    /// A query's thumbnails are ready.
    Glance {
        /// Which.
        query: Query,
        /// From the middle of the left clip, and of the right one.
        frames: [Frame; 2],
    },
    /// A dream has been looked at.
    Signs {
        /// Which.
        dream: DreamId,
        /// Of its noise: another session has a dream of this number, too.
        seed: u64,
        /// The signs of its steps.
        signs: Rows,
    },
    /// Pairs have been weighed.
    Weighed {
        /// Which.
        pairs: Vec<[SegmentRef; 2]>,
        /// How much the members disagree about each; nothing where nothing was learned yet.
        disagreements: Option<Vec<f32>>,
    },
    /// What the reward says of the clips of a query.
    Foretold {
        /// Which.
        query: Query,
        /// Of the left one, and of the right one.
        clips: [ClipRewards; 2],
    },
    /// What the reward says of a dream.
    Judged(Judgement),
    /// A trajectory is being made.
    Synthesizing {
        /// Of which search.
        seed: u64,
        /// Steps of the gradient so far.
        done: usize,
        /// How many there will be.
        n: usize,
    },
    /// A trajectory is made.
    Synthesized {
        /// It, with the seed of its search.
        episode: DreamEpisode,
        /// What it was to be.
        acquisition: Acquisition,
    },
    /// The reward has learned a little.
    Learning(Learning),
    /// The reward has parameters worth planning with.
    Learned {
        /// They.
        parameters: Parameters,
        /// How many answers they rest on.
        n_labels: usize,
        /// Where a full fit has ended: its seed, and each member's loss in its last epoch.
        fit: Option<(u64, Vec<f32>)>,
    },
    /// An episode by plan ended.
    Drove {
        /// Of the track.
        seed: u64,
        /// Its figures.
        metrics: EpisodeMetrics,
    },
    /// A recorded episode is on disk.
    Recorded {
        /// Its number in the dataset.
        episode: usize,
        /// Steps.
        n_steps: usize,
    },
    /// A recording stands, for it cannot be written; what was driven is kept. The sentence says why.
    Held(String),
    /// A recording goes on in this dataset.
    Moved(PathBuf),
    /// A dream is driven and cannot be written down; the sentence says why.
    Unjournaled(String),
    /// So many recordings were left behind by a killed program.
    Unfinished(usize),
    /// What a folder of recordings holds.
    Shelf(Shelf),
    /// A recorded episode has been read.
    Opened(OpenEpisode),
    /// What the reward says of the recorded episode that is open.
    JudgedEpisode {
        /// Which.
        recording: String,
        /// The mean of the members, the lowest and the highest, step by step.
        rewards: [Vec<f32>; 3],
    },
    /// A recorded episode is left out of a fit, or out of the dataset from here on; the sentence says why.
    LeftOut(String),
    /// A world model is being trained.
    Modeling(Progress),
    /// A world model is on disk.
    Modeled(PathBuf),
    /// A worker met an error, or has died of a bug; the sentence says which.
    Failed {
        /// The thread's name.
        worker: &'static str,
        /// One sentence.
        message: String,
    },
}

/// How well the reward fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Learning {
    /// Epochs of a full fit that are done, or the fits so far while answers come in.
    pub epoch: usize,
    /// Cross-entropy of each member.
    pub losses: Vec<f32>,
    /// Cross-entropy of answers predicted before they were learned, where there are enough.
    pub held_out_loss: Option<f32>,
    /// Share of strict answers that were predicted right before they were learned.
    pub agreement: Option<f32>,
    /// Answers learned from.
    pub n_labels: usize,
    /// Whether a full fit is under way, and how many epochs it will have.
    pub fit_epochs: Option<usize>,
}
