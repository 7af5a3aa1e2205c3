//! What the trainer knows of dreams.

use std::collections::HashMap;
use std::sync::Arc;

use crate::dream::{DreamEpisode, Rows};
use crate::query::{DreamId, SEGMENT_LEN, SegmentRef, Transition};
use crate::reward::{segment_rows, transition_row};
use crate::worker::error::TaskError;
use crate::world_model::WorldModel;

/// The dreams that are known, each with the features of its steps once they are needed.
#[derive(Default)]
pub(super) struct Dreams(HashMap<DreamId, (Arc<DreamEpisode>, Option<Rows>)>);

impl Dreams {
    pub(super) fn add(&mut self, id: DreamId, episode: Arc<DreamEpisode>) {
        self.0.insert(id, (episode, None));
    }

    /// A segment as the reward reads it, `[k, F + A]`.
    pub(super) fn rows(&mut self, model: &WorldModel, segment: SegmentRef) -> Result<Vec<f32>, TaskError> {
        let SegmentRef { dream, start } = segment;
        let known = self.0.get_mut(&dream).filter(|(episode, _)| start + SEGMENT_LEN <= episode.len());
        let Some((episode, features)) = known else {
            return Err(TaskError::Learn { dream, step: start });
        };
        let features = features.get_or_insert_with(|| episode.features(model));
        Ok(segment_rows(features, &episode.actions, model.ranges(), segment))
    }

    /// A transition as a classifier reads it, `[F + A]`.
    pub(super) fn row(&mut self, model: &WorldModel, transition: Transition) -> Result<Vec<f32>, TaskError> {
        let Transition { dream, step, .. } = transition;
        let known = self.0.get_mut(&dream).filter(|(episode, _)| step < episode.len());
        let Some((episode, features)) = known else {
            return Err(TaskError::Learn { dream, step });
        };
        let features = features.get_or_insert_with(|| episode.features(model));
        Ok(transition_row(features, &episode.actions, step))
    }
}
