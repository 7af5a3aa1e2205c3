//! Going through a session again from its files alone: its state, its clips, and what was learned.

use std::collections::{BTreeMap, BTreeSet, btree_map};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use crate::dream::{DreamEpisode, Rows};
use crate::query::{DreamId, JudgedTransition, LabeledQuery, SEGMENT_LEN, SegmentRef, Transition};
use crate::reward::{
    EpochReport, Learned, RewardConfig, RewardKind, RewardNetworks, fit_anew, fit_sparse_anew, segment_rows,
    transition_row,
};
use crate::session::clip_hash::{self, ClipHash, ClipHashes};
use crate::session::error::SessionError;
use crate::session::header::Header;
use crate::session::store::{read, read_dream, read_parameters};
use crate::session::{FittedReward, Session, log};
use crate::world_model::WorldModel;

/// How far a loss may lie from that of the same fit elsewhere, in nats a label.
///
/// On the same kind of processor nothing differs. Another one may compute the hidden layers in another precision.
pub const REFIT_TOLERANCE: f32 = 0.02;

/// What going through a session again gave.
#[derive(Debug)]
pub struct Replay {
    /// Its folder.
    pub dir: PathBuf,
    /// Its head.
    pub header: Header,
    /// Its state at the end.
    pub session: Session,
    /// A half line at the end of the log, which was passed over.
    pub torn: Option<String>,
    /// Dreams that were deleted and whose files cannot be read.
    pub lost: Vec<DreamId>,
    /// What every segment that was asked about looks like.
    pub clips: ClipHashes,
    /// The rewards that were learned, and from what.
    pub fits: Vec<ReplayedFit>,
}

/// A reward that was learned, with what it was learned from.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayedFit {
    /// As the log tells.
    pub fitted: FittedReward,
    /// The labels of the session as it was when the fit began, in the order of asking.
    pub labels: Vec<LabeledQuery>,
    /// The verdicts on transitions as they were then, in the order of asking.
    pub judged: Vec<JudgedTransition>,
    /// Whether it was learned from those.
    pub is_sparse: bool,
}

impl ReplayedFit {
    /// How many labels or verdicts it was learned from.
    pub fn n_labels(&self) -> usize {
        if self.is_sparse { self.judged.len() } else { self.labels.len() }
    }

    /// Whether the log tells of as many labels, and of losses within [`REFIT_TOLERANCE`] of `losses`.
    pub fn agrees(&self, losses: &[f32]) -> bool {
        let fit = &self.fitted.fit;
        let mut pairs = fit.losses.iter().zip(losses);
        fit.n_labels == self.n_labels()
            && fit.losses.len() == losses.len()
            && pairs.all(|(then, now)| (then - now).abs() <= REFIT_TOLERANCE)
    }
}

/// Goes through the session in `dir` again: folds its log, reads every dream, and decodes every segment asked about.
///
/// Nothing in the folder is changed, and it may be read-only.
pub fn replay(dir: &Path, model: &WorldModel) -> Result<Replay, SessionError> {
    let reading = read(dir, Some(model.identity()))?;
    let session = reading.session;
    let mut starts: BTreeMap<DreamId, BTreeSet<usize>> = BTreeMap::new();
    for SegmentRef { dream, start } in session.queries().iter().flat_map(|a| [a.query.left, a.query.right]) {
        starts.entry(dream).or_default().insert(start);
    }
    let (mut clips, mut lost) = (ClipHashes::new(), Vec::new());
    for kept in session.dreams() {
        // One dream at a time, whether asked about or not: a damaged one is found either way.
        let episode = match read_dream(dir, &session, kept.dream, Some(model.identity())) {
            Err(_) if session.is_dropped(kept.dream) => {
                lost.push(kept.dream);
                continue;
            }
            read => read?,
        };
        for &start in starts.get(&kept.dream).into_iter().flatten() {
            let frames = episode.frames(model, start..start + SEGMENT_LEN);
            clips.insert((kept.dream, start), ClipHash::of(&frames));
        }
    }
    let fits = fits(dir, &reading.header, &reading.contents, &session);
    let (dir, torn) = (dir.to_owned(), reading.contents.torn);
    Ok(Replay { dir, header: reading.header, session, torn, lost, clips, fits })
}

impl Replay {
    /// Writes down what the clips look like now, for later replays to compare with.
    pub fn record_clips(&self) -> Result<(), SessionError> {
        clip_hash::write(&self.dir, &self.clips)
    }

    /// What the clips looked like when that was written down, if it was.
    pub fn recorded_clips(&self) -> Result<Option<ClipHashes>, SessionError> {
        clip_hash::read(&self.dir)
    }

    /// Those of `then` that look otherwise now, or are not asked about. Those that are [lost](Self::lost) are left out.
    pub fn changed_clips(&self, then: &ClipHashes) -> Vec<(DreamId, usize)> {
        let is_same = |clip: &(DreamId, usize), hash: &ClipHash| {
            self.clips.get(clip).is_some_and(|now| now.apart(hash) <= ClipHash::TOLERANCE)
        };
        let then = then.iter().filter(|((dream, _), _)| !self.lost.contains(dream));
        then.filter(|(clip, hash)| !is_same(clip, hash)).map(|(clip, _)| *clip).collect()
    }

    /// Learns a reward of this session again and returns the last loss of each member.
    ///
    /// The shape of the ensemble is that of the saved one. Generator, labels and their order are those of the log.
    pub fn refit(&self, model: &WorldModel, replayed: &ReplayedFit) -> Result<Vec<f32>, SessionError> {
        let (path, parameters) = read_parameters(&self.dir, &replayed.fitted)?;
        let wrong = |met| SessionError::Reward { met, path: path.clone() };
        let mut dreams = Dreams { replay: self, model, read: BTreeMap::new() };
        let seed = replayed.fitted.fit.seed;
        let go_on = |_: &EpochReport| ControlFlow::Continue(());
        let losses = match RewardNetworks::load(&parameters).map_err(wrong)? {
            RewardNetworks::Preferences(reward) => {
                let rows = |segment: SegmentRef| {
                    let (episode, features) = dreams.get(segment.dream)?;
                    Ok::<_, SessionError>(segment_rows(features, &episode.actions, model.ranges(), segment))
                };
                // Losses are those of labels.
                let config = RewardConfig { learned: Learned::Label, ..reward.config().clone() };
                fit_anew(model, config, seed, &replayed.labels, rows, go_on)?.map(|fitted| fitted.losses)
            }
            RewardNetworks::Verdicts(reward) => {
                let row = |transition: Transition| {
                    let (episode, features) = dreams.get(transition.dream)?;
                    Ok::<_, SessionError>(transition_row(features, &episode.actions, transition.step))
                };
                let config = reward.config().clone();
                let fitted = fit_sparse_anew(model, config, seed, &replayed.judged, row, go_on)?;
                fitted.map(|fitted| fitted.losses)
            }
        };
        Ok(losses.expect("nobody stops this fit"))
    }
}

/// The dreams of a session, each read when it is first needed.
struct Dreams<'a> {
    replay: &'a Replay,
    model: &'a WorldModel,
    read: BTreeMap<DreamId, (DreamEpisode, Rows)>,
}

impl Dreams<'_> {
    fn get(&mut self, id: DreamId) -> Result<&(DreamEpisode, Rows), SessionError> {
        Ok(match self.read.entry(id) {
            btree_map::Entry::Occupied(read) => read.into_mut(),
            btree_map::Entry::Vacant(unread) => {
                let episode = {
                    let Replay { dir, session, .. } = self.replay;
                    read_dream(dir, session, id, Some(self.model.identity()))?
                };
                let features = episode.features(self.model);
                unread.insert((episode, features))
            }
        })
    }
}

fn fits(dir: &Path, header: &Header, contents: &log::Contents, session: &Session) -> Vec<ReplayedFit> {
    let replayed = |fitted: &FittedReward| {
        let before = header.session().folded(&contents.entries[..fitted.fit.after as usize]);
        let before = before.unwrap_or_else(|(_, e)| unreachable!("the whole log was folded: {e}"));
        let mut labels = before.labeled();
        labels.sort_by_key(|labeled| labeled.query.id);
        let mut judged = before.judged();
        judged.sort_by_key(|judged| judged.query);
        // One that cannot be read is told of where it is learned again.
        let kind = read_parameters(dir, fitted).ok().and_then(|(_, saved)| RewardKind::of(&saved));
        let is_sparse = kind == Some(RewardKind::Verdicts);
        ReplayedFit { fitted: fitted.clone(), labels, judged, is_sparse }
    };
    session.fits().iter().map(replayed).collect()
}
