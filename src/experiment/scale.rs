//! How large an experiment is.

use super::description::Description;

/// How large an experiment is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Seconds: whether it runs at all.
    Toy,
    /// Minutes.
    Quick,
    /// As it is reported.
    #[default]
    Full,
}

impl Description {
    /// The same at another scale: with fewer seeds, shorter dreams and episodes, and fewer variants.
    #[must_use]
    pub fn at(mut self, scale: Scale) -> Self {
        let (seeds, dreams, steps, queries, episodes, episode_steps) = match scale {
            Scale::Full => return self,
            Scale::Quick => (2, 4, 400, 100, 1, Some(400)),
            Scale::Toy => (2, 2, 60, 8, 1, Some(24)),
        };
        let share = queries as f64 / self.queries.max(1) as f64;
        let shrunk = |n: usize| ((n as f64 * share).ceil() as usize).max(2);
        self.first = self.first.iter().map(|first| shrunk(*first)).collect();
        self.first.dedup();
        self.seeds.truncate(seeds);
        self.dreams = self.dreams.min(dreams);
        self.dream_steps = self.dream_steps.min(steps);
        self.queries = self.queries.min(queries);
        self.verdicts = self.verdicts.min(queries * 8);
        self.episodes = self.episodes.min(episodes);
        self.episode_steps = episode_steps;
        self.states = self.states.min(queries * 4);
        self.recorded.truncate(2);
        self.iterations = self.iterations.min(if scale == Scale::Toy { 4 } else { 50 });
        if scale == Scale::Toy {
            // As many as there are, so that they stay apart.
            self.recorded = (2..).take(self.recorded.len()).collect();
        }
        self.world_models = self.world_models.map(|it| it.at(scale));
        self.search = self.search.map(|it| it.at(scale));
        self
    }
}
