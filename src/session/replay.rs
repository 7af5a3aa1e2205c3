//! Going through a session again from its files alone: its state, its clips, and what was learned.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::env::Frame;
use crate::query::{DreamId, LabeledQuery, SEGMENT_LEN, SegmentRef};
use crate::session::error::SessionError;
use crate::session::event::Fit;
use crate::session::header::Header;
use crate::session::store::{read, read_dream};
use crate::session::{Session, log};
use crate::tensor::sha256;
use crate::world_model::WorldModel;

/// What going through a session again gave.
#[derive(Debug)]
pub struct Replay {
    /// Its head.
    pub header: Header,
    /// Its state at the end.
    pub session: Session,
    /// A half line at the end of the log, which was passed over.
    pub torn: Option<String>,
    /// The hash of the pictures of every segment that was asked about.
    ///
    /// The same on the same kind of processor; elsewhere arithmetic can differ in the last digit.
    pub clips: BTreeMap<(DreamId, usize), String>,
    /// The fits, each with the labels that it had.
    pub fits: Vec<(Fit, Vec<LabeledQuery>)>,
}

/// Goes through the session in `dir` again: folds its log, reads every dream, and decodes every segment asked about.
///
/// Nothing in the folder is changed, and it may be read-only.
pub fn replay(dir: &Path, model: &WorldModel) -> Result<Replay, SessionError> {
    let reading = read(dir, Some(&model.hash()))?;
    let session = reading.session;
    let mut starts: BTreeMap<DreamId, BTreeSet<usize>> = BTreeMap::new();
    for SegmentRef { dream, start } in session.queries().iter().flat_map(|a| [a.query.left, a.query.right]) {
        starts.entry(dream).or_default().insert(start);
    }
    let mut clips = BTreeMap::new();
    for kept in session.dreams() {
        // One dream at a time, whether asked about or not: a damaged one is found either way.
        let episode = read_dream(dir, &session, kept.dream)?;
        for &start in starts.get(&kept.dream).into_iter().flatten() {
            let frames = episode.frames(model, start..start + SEGMENT_LEN);
            let bytes: Vec<u8> = frames.iter().flat_map(Frame::rgb).copied().collect();
            clips.insert((kept.dream, start), sha256(&bytes));
        }
    }
    let fits = fits(&reading.header, &reading.contents, &session);
    Ok(Replay { header: reading.header, session, torn: reading.contents.torn, clips, fits })
}

/// Each fit with the labels of the session as it was when the fit began.
fn fits(header: &Header, contents: &log::Contents, session: &Session) -> Vec<(Fit, Vec<LabeledQuery>)> {
    let labels = |fit: &Fit| {
        let before = header.session().folded(&contents.entries[..fit.after as usize]);
        before.unwrap_or_else(|(_, e)| unreachable!("the whole log was folded: {e}")).labeled()
    };
    session.fits().iter().map(|fitted| (fitted.fit.clone(), labels(&fitted.fit))).collect()
}
