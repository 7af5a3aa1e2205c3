//! Clips as pages show them: the twenty pictures of a segment one below the other, as one PNG, so that what is judged in a
//! browser is what is judged in the window, to the last bit.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::dataset::png_bytes;
use crate::dream::DreamEpisode;
use crate::query::{DreamId, Query, QueryId, SegmentRef};
use crate::serve::ServeError;
use crate::tensor::Parameters;
use crate::worker::{ClipperCommand, Inbox, LabelReport, Report, Reports, Worker, clipper};
use crate::world::Frame;

/// Bytes of clips that are kept: several hundred of the built-in worlds.
const MOST: usize = 64 << 20;
/// A clip that takes longer will not come.
const LONGEST: Duration = Duration::from_secs(30);

/// Draws clips, in a thread of its own, and keeps those that were asked for last.
#[derive(Debug)]
pub(super) struct Clips {
    clipper: Worker<ClipperCommand>,
    inbox: Inbox,
    ready: HashMap<SegmentRef, Arc<[u8]>>,
    /// Those that are ready, the oldest first.
    order: VecDeque<SegmentRef>,
    n_bytes: usize,
    next: u32,
}

impl Clips {
    /// Of dreams that were dreamed with this world model.
    pub(super) fn new(model: &Parameters, dreams: Vec<(DreamId, DreamEpisode)>) -> Self {
        let (reports, inbox) = Reports::new(|| ());
        let clipper = clipper::spawn(model.clone(), &reports);
        for (id, dream) in dreams {
            clipper.send(ClipperCommand::AddDream(id, Arc::new(dream)));
        }
        Self { clipper, inbox, ready: HashMap::new(), order: VecDeque::new(), n_bytes: 0, next: 0 }
    }

    /// The clip of `wanted`, one of these two, which are drawn together if they are not ready.
    pub(super) fn png(&mut self, pair: [SegmentRef; 2], wanted: SegmentRef) -> Result<Arc<[u8]>, ServeError> {
        if let Some(png) = self.ready.get(&wanted) {
            return Ok(Arc::clone(png));
        }
        let [left, right] = pair;
        let query = Query { id: QueryId(self.next), left, right };
        self.next = self.next.wrapping_add(1);
        self.clipper.send(ClipperCommand::Decode(query));
        let frames = self.wait_for(query)?;
        for (segment, frames) in pair.into_iter().zip(&frames) {
            self.keep(segment, strip(frames));
        }
        let png = self.ready.get(&wanted).map(Arc::clone);
        png.ok_or_else(|| ServeError::Clip("it is not one of the pair".to_owned()))
    }

    /// Both clips of `query`; what comes of one that was given up before is passed over.
    fn wait_for(&self, query: Query) -> Result<[Vec<Frame>; 2], ServeError> {
        let until = Instant::now() + LONGEST;
        loop {
            match self.inbox.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(Report::Label(LabelReport::Clips { query: of, left, right })) if of == query => {
                    return Ok([left, right]);
                }
                Ok(Report::Failed(failure)) => return Err(ServeError::Clip(failure.error.to_string())),
                Ok(_) => {}
                Err(met) => return Err(ServeError::Clip(met.to_string())),
            }
        }
    }

    fn keep(&mut self, segment: SegmentRef, png: Vec<u8>) {
        self.n_bytes += png.len();
        if let Some(before) = self.ready.insert(segment, png.into()) {
            self.n_bytes -= before.len();
            return;
        }
        self.order.push_back(segment);
        // The pair that was drawn last stays.
        while self.n_bytes > MOST && self.order.len() > 2 {
            let Some(png) = self.order.pop_front().and_then(|oldest| self.ready.remove(&oldest)) else {
                break;
            };
            self.n_bytes -= png.len();
        }
    }
}

/// Pictures of equal size, one below the other, as PNG.
fn strip(frames: &[Frame]) -> Vec<u8> {
    let (height, width) = frames.first().map_or((0, 0), |first| (first.height(), first.width()));
    let rgb: Vec<u8> = frames.iter().flat_map(|frame| frame.rgb().iter().copied()).collect();
    png_bytes(&Frame::new(height * frames.len() as u32, width, rgb))
}
