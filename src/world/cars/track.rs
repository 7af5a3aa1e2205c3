//! Random tracks: a closed chain of nodes 3.5 units apart, after gym's `CarRacing-v0`.
//!
//! The rule is gym's (Copyright (c) 2016 `OpenAI`, MIT license), the same since 2016: twelve random checkpoints round
//! the origin, a walk that keeps turning to the next of them, and the last complete lap of that walk.

use std::f64::consts::PI;

use super::random::UniformStream;
use super::trig;

/// Track scale, the `SCALE` of gym.
const SCALE: f64 = 6.0;
/// Mean radius of the track in units.
const RADIUS: f64 = 900.0 / SCALE;
/// Half side of the square field in units. Beyond it the episode ends.
pub const PLAYFIELD: f64 = 2000.0 / SCALE;
/// Distance of neighboring nodes in units.
pub const NODE_STEP: f64 = 21.0 / SCALE;
/// Half the width of the road in units.
pub const HALF_WIDTH: f64 = 40.0 / SCALE;
/// Width of a kerb in units.
const KERB_WIDTH: f64 = 8.0 / SCALE;
/// Sharpest turn from node to node in radians.
const TURN_RATE: f64 = 0.31;
/// How many nodes in a row must bend one way before the road gets a kerb.
const KERB_MIN_NODES: usize = 4;
/// How many checkpoints a track has.
const N_CHECKPOINTS: usize = 12;
/// How many nodes a walk has at most.
const MAX_WALK: usize = 2500;

/// A point of the center line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Polar angle round the origin in radians.
    pub alpha: f64,
    /// Direction of the road in radians, counter-clockwise, 0 is +y.
    pub beta: f64,
    /// Units.
    pub x: f64,
    /// Units.
    pub y: f64,
}

/// A closed track. The car starts at node 0 and drives toward node 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The center line.
    pub nodes: Vec<Node>,
    /// Whether a kerb lies beside tile `i`.
    pub kerbs: Vec<bool>,
    /// How many walks it took until one closed.
    pub attempts: u32,
    /// The unit vector to the right of the road at each node.
    rights: Vec<[f64; 2]>,
}

impl Track {
    /// The next track of a stream.
    pub fn generate(stream: &mut UniformStream) -> Self {
        let mut attempts = 0;
        loop {
            attempts += 1;
            if let Some(nodes) = last_lap(&walk(&checkpoints(stream))) {
                let kerbs = kerbs(&nodes);
                let rights = nodes.iter().map(|node| [trig::cos(node.beta), trig::sin(node.beta)]).collect();
                return Self { nodes, kerbs, attempts, rights };
            }
        }
    }

    /// The corners of tile `i`, which joins node `i − 1` to node `i`: left and right here, right and left behind.
    pub fn tile(&self, i: usize) -> [[f64; 2]; 4] {
        self.strip(i, -HALF_WIDTH, HALF_WIDTH)
    }

    /// The corners of the kerb beside tile `i`, on the inside of the bend. Paint only.
    pub fn kerb(&self, i: usize) -> Option<[[f64; 2]; 4]> {
        if !self.kerbs[i] {
            return None;
        }
        let side = match self.nodes[self.behind(i)].beta - self.nodes[i].beta {
            bend if bend > 0.0 => 1.0,
            bend if bend < 0.0 => -1.0,
            _ => 0.0,
        };
        Some(self.strip(i, side * HALF_WIDTH, side * (HALF_WIDTH + KERB_WIDTH)))
    }

    /// The part of tile `i` between two signed distances from the center line, in units. Positive is right.
    fn strip(&self, i: usize, from: f64, to: f64) -> [[f64; 2]; 4] {
        let behind = self.behind(i);
        [self.across(i, from), self.across(i, to), self.across(behind, to), self.across(behind, from)]
    }

    /// The point at a signed distance from node `i` across the road.
    fn across(&self, i: usize, distance: f64) -> [f64; 2] {
        let (Node { x, y, .. }, [right_x, right_y]) = (self.nodes[i], self.rights[i]);
        [x + distance * right_x, y + distance * right_y]
    }

    /// The node before node `i`, going round.
    fn behind(&self, i: usize) -> usize {
        if i == 0 { self.nodes.len() - 1 } else { i - 1 }
    }
}

/// A point that the walk turns to.
#[derive(Clone, Copy)]
struct Checkpoint {
    alpha: f64,
    x: f64,
    y: f64,
}

/// The checkpoints of one attempt, in order of their angle.
fn checkpoints(stream: &mut UniformStream) -> [Checkpoint; N_CHECKPOINTS] {
    let n = N_CHECKPOINTS as f64;
    std::array::from_fn(|c| {
        // Both numbers are drawn even where they are then not used.
        let noise = stream.uniform(0.0, 2.0 * PI * 1.0 / n);
        let radius = stream.uniform(RADIUS / 3.0, RADIUS);
        let (alpha, radius) = match c {
            0 => (0.0, 1.5 * RADIUS),
            _ if c == N_CHECKPOINTS - 1 => (2.0 * PI * c as f64 / n, 1.5 * RADIUS),
            _ => (2.0 * PI * c as f64 / n + noise, radius),
        };
        Checkpoint { alpha, x: radius * trig::cos(alpha), y: radius * trig::sin(alpha) }
    })
}

/// The angle at which laps are told apart, half a checkpoint before the x axis.
fn start_alpha() -> f64 {
    2.0 * PI * -0.5 / N_CHECKPOINTS as f64
}

/// Walks from checkpoint to checkpoint for about five laps.
fn walk(checkpoints: &[Checkpoint; N_CHECKPOINTS]) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(MAX_WALK);
    let (mut x, mut y, mut beta) = (1.5 * RADIUS, 0.0, 0.0);
    let mut destination = 0;
    let mut laps = 0;
    let mut other_side = false;
    while laps <= 4 && nodes.len() < MAX_WALK {
        let mut alpha = trig::atan2(y, x);
        if other_side && alpha > 0.0 {
            laps += 1;
            other_side = false;
        }
        if alpha < 0.0 {
            other_side = true;
            alpha += 2.0 * PI;
        }
        let next = loop {
            let checkpoint = checkpoints[destination % N_CHECKPOINTS];
            if alpha <= checkpoint.alpha {
                break checkpoint;
            }
            destination += 1;
            if destination % N_CHECKPOINTS == 0 {
                alpha -= 2.0 * PI;
            }
        };
        let right = [trig::cos(beta), trig::sin(beta)];
        let ahead = [-right[1], right[0]];
        let offset = SCALE * (right[0] * (next.x - x) + right[1] * (next.y - y));
        while beta - alpha > 1.5 * PI {
            beta -= 2.0 * PI;
        }
        while beta - alpha < -1.5 * PI {
            beta += 2.0 * PI;
        }
        let before = beta;
        let turn = (0.001 * offset).abs().min(TURN_RATE);
        if offset > 0.3 {
            beta -= turn;
        }
        if offset < -0.3 {
            beta += turn;
        }
        x += ahead[0] * NODE_STEP;
        y += ahead[1] * NODE_STEP;
        nodes.push(Node { alpha, beta: before * 0.5 + beta * 0.5, x, y });
    }
    nodes
}

/// The last complete lap of a walk, if it has one whose ends meet.
fn last_lap(walk: &[Node]) -> Option<Vec<Node>> {
    let start = start_alpha();
    let mut crossings =
        (1..walk.len()).rev().filter(|&i| walk[i].alpha > start && walk[i - 1].alpha <= start);
    let end = crossings.next()?;
    let begin = crossings.next()?;
    let lap = &walk[begin..end - 1];
    let [first, last] = [lap.first()?, lap.last()?];
    let across = trig::cos(first.beta) * (first.x - last.x);
    let along = trig::sin(first.beta) * (first.y - last.y);
    let gap = (across * across + along * along).sqrt();
    (gap <= NODE_STEP).then(|| lap.to_vec())
}

/// Which tiles have a kerb: those of at least four nodes in a row that bend sharply to one side.
fn kerbs(nodes: &[Node]) -> Vec<bool> {
    let n = nodes.len();
    let back = |i: usize, by: usize| (i + n - by) % n;
    let mut flags: Vec<bool> = (0..n)
        .map(|i| {
            let bend = |by: usize| nodes[back(i, by)].beta - nodes[back(i, by + 1)].beta;
            (0..KERB_MIN_NODES).all(|by| bend(by) > TURN_RATE * 0.2)
                || (0..KERB_MIN_NODES).all(|by| bend(by) < -(TURN_RATE * 0.2))
        })
        .collect();
    // In place, as in gym: what early tiles set across the start is seen again by late ones.
    for i in 0..n {
        for by in 0..KERB_MIN_NODES {
            let marked = flags[i];
            flags[back(i, by)] |= marked;
        }
    }
    flags
}
