//! A toy world and a person to go with it, so that all four steps run in seconds.

use dropj::query::{Preference, SafetyAnswer};
use dropj::world::End;
use dropj::world::Frame;
use dropj::world::cars::{CarAction, CarWorld, Env, Events, Outcome, Seed, Truth};

/// Pixels a side, as the tiny world model wants.
const SIDE: usize = 20;

/// A straight road that drifts away under the car, now to one side and now to the other.
#[derive(Debug, Default)]
pub(crate) struct DummyRoad {
    /// Where the car is: on the road within ±1.
    lateral: f32,
    wind: f32,
    t: usize,
}

impl DummyRoad {
    /// Steps of an episode.
    pub(crate) const LEN: usize = 120;

    /// The road as a world.
    pub(crate) fn world() -> CarWorld {
        CarWorld::of("dummy-road", Self::default())
    }
}

impl Env for DummyRoad {
    fn reset(&mut self, seed: Seed) {
        let Seed::Native(seed) = seed else { panic!("the toy knows our own seeds only") };
        let wind = if seed.is_multiple_of(2) { 0.04 } else { -0.04 };
        *self = Self { lateral: 0.0, wind, t: 0 };
    }

    fn advance(&mut self, action: CarAction) -> Outcome {
        self.t += 1;
        if self.t.is_multiple_of(40) {
            self.wind = -self.wind;
        }
        self.lateral = (self.lateral + 0.12 * action.steer + self.wind).clamp(-2.0, 2.0);
        let grass = self.lateral.abs() > 1.0;
        let events = Events { grass, new_tile: !grass, ..Events::default() };
        let end = (self.t == Self::LEN).then_some(End::Truncated);
        Outcome { reward: if grass { -1.0 } else { 10.0 }, events, end }
    }

    fn frame(&self) -> Frame {
        let mut rgb = vec![0; 3 * SIDE * SIDE];
        for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
            // The car stands still in the middle; the road moves.
            let x = ((i % SIDE) as f32 + 0.5 - SIDE as f32 / 2.0) / 5.0;
            let is_road = (x + self.lateral).abs() < 1.0;
            pixel.copy_from_slice(if is_road { &[110, 110, 110] } else { &[80, 220, 80] });
        }
        Frame::square(SIDE as u32, rgb)
    }

    fn sensors(&self) -> &'static [&'static str] {
        &["wind"]
    }

    fn state(&self) -> Vec<f32> {
        vec![self.wind]
    }

    fn truth(&self) -> Truth {
        Truth { lateral: self.lateral, n_nodes: 300, ..Truth::default() }
    }

    fn picture(&self, _: u32, _: u32) -> Vec<u8> {
        Vec::new()
    }
}

/// A person who looks at what is under the car.
#[derive(Debug)]
pub(crate) struct Oracle;

impl Oracle {
    /// Whether the middle of every picture is road.
    fn stays_safe(clip: &[Frame]) -> bool {
        clip.iter().all(|frame| {
            let middle = &frame.rgb()[3 * (SIDE * SIDE / 2 + SIDE / 2)..];
            i16::from(middle[1]) - i16::from(middle[0]) < 60
        })
    }

    /// The answer to a query in the protocol DROPJ.
    pub(crate) fn answer(left: &[Frame], right: &[Frame]) -> SafetyAnswer {
        match (Self::stays_safe(left), Self::stays_safe(right)) {
            (true, false) => SafetyAnswer::OnlyLeft,
            (false, true) => SafetyAnswer::OnlyRight,
            (false, false) => SafetyAnswer::Neither,
            (true, true) => SafetyAnswer::Both(Preference::Equal),
        }
    }
}
