//! Draws the world: the square picture for the models, and a larger one for people.
//!
//! Everything is laid out in gym's logical window of 1000 × 800 pixels, y up, which the state image squeezes into a
//! square. That picture is not isotropic, and the models depend on it.

use std::f64::consts::PI;

use super::car::{HULL, WHEEL};
use super::raster::{Canvas, Color};
use super::track::{HALF_WIDTH, NODE_STEP, PLAYFIELD, Track};
use super::trig;

/// Logical window, in window pixels.
const WINDOW: [f64; 2] = [1000.0, 800.0];
/// Where in the window the agent's hull is.
const ANCHOR: [f64; 2] = [500.0, 200.0];
/// Window pixels a unit, at the start and after the first second.
const ZOOM: [f64; 2] = [0.6, 16.2];
/// Units a car unit.
const CAR_SIZE: f32 = 0.02;
/// Radius of the hole and of its rim in units.
const CHUCKHOLE_RADII: [f64; 3] = [0.01, 1.2, 1.5];
/// Corners of a chuckhole.
const CHUCKHOLE_CORNERS: usize = 15;

const GRASS: Color = [102, 204, 102];
const PATCH: Color = [102, 230, 102];
/// A tile that was touched, and the three shades of those that were not.
const TOUCHED: Color = [102; 3];
const TILES: [Color; 3] = [[102; 3], [105; 3], [107; 3]];
const KERBS: [Color; 2] = [[255; 3], [255, 0, 0]];
const HOLE: Color = [255, 153, 0];
const BLACK: Color = [0; 3];
const STRIPE: Color = [76; 3];
const AGENT: Color = [204, 0, 0];
const OTHER: Color = [0, 0, 204];

/// What there is to see.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// The road.
    pub track: &'a Track,
    /// Whether tile `i` was touched and is plain grey.
    pub touched: &'a [bool],
    /// Centers of the chuckholes in units.
    pub chuckholes: &'a [[f64; 2]],
    /// The cars, drawn in this order.
    pub cars: Vec<CarView>,
    /// Seconds since the start: the first is one long zoom.
    pub time: f64,
    /// Where the picture is taken from.
    pub camera: Camera,
    /// The bar at the bottom, where there is one.
    pub indicators: Option<Indicators>,
}

/// Where a body is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Origin in units.
    pub x: f32,
    /// Origin in units.
    pub y: f32,
    /// Radians, counter-clockwise, 0 is +y.
    pub angle: f32,
}

/// A car as it is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarView {
    /// The hull's origin.
    pub hull: Pose,
    /// The wheels, front left, front right, rear left, rear right, each with its phase in radians.
    pub wheels: [(Pose, f64); 4],
    /// The agent's car is red, the others are blue.
    pub is_agent: bool,
}

/// The camera rides on the agent's hull.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Camera {
    /// Hull origin in units.
    pub x: f64,
    /// Hull origin in units.
    pub y: f64,
    /// Hull angle in radians.
    pub angle: f64,
    /// Hull velocity in units a second. Above 0.5 its direction is up.
    pub velocity: [f64; 2],
}

/// What the bar at the bottom shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Indicators {
    /// The score of gym, printed.
    pub score: f64,
    /// Hull speed in units a second.
    pub speed: f64,
    /// Spin of the wheels in radians a second.
    pub omegas: [f64; 4],
    /// Angle of the front left joint in radians.
    pub joint_angle: f64,
    /// Spin of the hull in radians a second.
    pub angular_velocity: f64,
}

/// The picture that the models' frame is made of: `side · side · 3` bytes, not anti-aliased.
pub fn state_image(scene: &Scene, side: u32) -> Vec<u8> {
    let size = f64::from(side);
    let mut painter = Painter::new(scene, side, side, [size / WINDOW[0], size / WINDOW[1]]);
    painter.scene(scene);
    painter.canvas.into_rgb()
}

/// The same scene for people: `width · height · 3` bytes, anti-aliased by 2 × 2 samples, not squeezed.
pub fn picture(scene: &Scene, width: u32, height: u32) -> Vec<u8> {
    let (width, height) = (2 * width, 2 * height);
    let scale = (f64::from(width) / WINDOW[0]).min(f64::from(height) / WINDOW[1]);
    let mut painter = Painter::new(scene, width, height, [scale; 2]);
    painter.scene(scene);
    painter.canvas.into_halved_rgb()
}

/// A canvas with the camera's transformation.
struct Painter {
    canvas: Canvas,
    /// Camera position in units.
    eye: [f64; 2],
    /// Cosine and sine of the camera's angle, times window pixels a unit.
    turn: [f64; 2],
    /// Canvas pixels a window pixel.
    scale: [f64; 2],
    /// Half the size of the canvas in pixels.
    half: [f64; 2],
    /// What lies farther than this many units from the camera is not seen.
    sight: f64,
}

impl Painter {
    fn new(scene: &Scene, width: u32, height: u32, scale: [f64; 2]) -> Self {
        let camera = &scene.camera;
        let [vx, vy] = camera.velocity;
        let angle = if libm::hypot(vx, vy) > 0.5 { trig::atan2(vx, vy) } else { -camera.angle };
        let zoom = ZOOM[0] * (1.0 - scene.time).max(0.0) + ZOOM[1] * scene.time.min(1.0);
        let half = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        let farthest = libm::hypot(half[0] / scale[0], half[1] / scale[1] + WINDOW[1] / 2.0 - ANCHOR[1]);
        Self {
            canvas: Canvas::new(width, height),
            eye: [camera.x, camera.y],
            turn: [zoom * trig::cos(angle), zoom * trig::sin(angle)],
            scale,
            half,
            sight: farthest / zoom,
        }
    }

    /// Paints everything, back to front.
    fn scene(&mut self, scene: &Scene) {
        self.field();
        self.road(scene);
        self.chuckholes(scene.chuckholes);
        for car in &scene.cars {
            self.car(car);
        }
        if let Some(indicators) = &scene.indicators {
            self.indicators(indicators);
        }
    }

    /// The grass, and the patches that show how fast it goes by.
    fn field(&mut self) {
        let p = PLAYFIELD;
        self.world(&[[p, p], [p, -p], [-p, -p], [-p, p]], GRASS);
        let k = PLAYFIELD / 20.0;
        for x in (-20..20).step_by(2).map(f64::from) {
            for y in (-20..20).step_by(2).map(f64::from) {
                if self.sees([k * (x + 0.5), k * (y + 0.5)], k) {
                    let [x0, x1, y0, y1] = [k * x, k * x + k, k * y, k * y + k];
                    self.world(&[[x1, y0], [x0, y0], [x0, y1], [x1, y1]], PATCH);
                }
            }
        }
    }

    /// Tiles and kerbs.
    fn road(&mut self, scene: &Scene) {
        for (i, node) in scene.track.nodes.iter().enumerate() {
            if !self.sees([node.x, node.y], 2.0 * HALF_WIDTH + NODE_STEP) {
                continue;
            }
            self.world(&scene.track.tile(i), if scene.touched[i] { TOUCHED } else { TILES[i % 3] });
            if let Some(kerb) = scene.track.kerb(i) {
                self.world(&kerb, KERBS[i % 2]);
            }
        }
    }

    /// Each chuckhole: an orange hole with a black rim.
    fn chuckholes(&mut self, centers: &[[f64; 2]]) {
        if centers.is_empty() {
            return;
        }
        let corners: [[f64; 2]; CHUCKHOLE_CORNERS] = std::array::from_fn(|i| {
            let angle = 2.0 * PI * i as f64 / CHUCKHOLE_CORNERS as f64;
            [trig::cos(angle), trig::sin(angle)]
        });
        for &center in centers {
            if !self.sees(center, CHUCKHOLE_RADII[2]) {
                continue;
            }
            for (radii, color) in CHUCKHOLE_RADII.windows(2).zip([HOLE, BLACK]) {
                for i in 0..CHUCKHOLE_CORNERS {
                    let [a, b] = [corners[i], corners[(i + 1) % CHUCKHOLE_CORNERS]];
                    let at = |c: [f64; 2], r: f64| [center[0] + r * c[0], center[1] + r * c[1]];
                    let quad = [at(a, radii[0]), at(a, radii[1]), at(b, radii[1]), at(b, radii[0])];
                    self.world(&quad, color);
                }
            }
        }
    }

    /// Wheels, then the hull.
    fn car(&mut self, car: &CarView) {
        if !self.sees([f64::from(car.hull.x), f64::from(car.hull.y)], 4.0) {
            return;
        }
        let [w, l] = WHEEL[1].map(|x| x as f32);
        for (pose, phase) in &car.wheels {
            self.body(pose, &[[-w, l], [w, l], [w, -l], [-w, -l]], BLACK);
            if let Some([near, far]) = stripe(*phase) {
                let [near, far] = [l * near as f32, l * far as f32];
                self.body(pose, &[[-w, near], [w, near], [w, far], [-w, far]], STRIPE);
            }
        }
        for part in HULL {
            let polygon: Vec<_> = part.iter().map(|corner| corner.map(|x| x as f32)).collect();
            self.body(&car.hull, &polygon, if car.is_agent { AGENT } else { OTHER });
        }
    }

    /// The bar: score, speed, spin of the wheels, steering, spin of the hull.
    fn indicators(&mut self, values: &Indicators) {
        const WHITE: Color = [255; 3];
        const BLUE: Color = [0, 0, 255];
        const VIOLET: Color = [51, 0, 255];
        let (s, h) = (WINDOW[0] / 40.0, WINDOW[1] / 40.0);
        // The bar reaches as far as the picture does, should that be wider or higher than the window.
        self.window([-WINDOW[0], 2.0 * WINDOW[0]], [-WINDOW[1], 5.0 * h], BLACK);
        let [w0, w1, w2, w3] = values.omegas;
        let upright = [
            (5.0, 0.02 * values.speed, WHITE),
            (7.0, 0.01 * w0, BLUE),
            (8.0, 0.01 * w1, BLUE),
            (9.0, 0.01 * w2, VIOLET),
            (10.0, 0.01 * w3, VIOLET),
        ];
        for (place, value, color) in upright {
            self.window([place * s, (place + 1.0) * s], [h, h + h * value], color);
        }
        let lying = [
            (20.0, -10.0 * values.joint_angle, [0, 255, 0]),
            (30.0, -0.8 * values.angular_velocity, [255, 0, 0]),
        ];
        for (place, value, color) in lying {
            self.window([place * s, (place + value) * s], [2.0 * h, 4.0 * h], color);
        }
        self.digits(&format!("{:04}", values.score as i64), WHITE);
    }

    /// The score in small blocks.
    // DIFFERENCE: gym prints in the font it finds. The bar never reaches a model, so plain blocks do.
    fn digits(&mut self, text: &str, color: Color) {
        const BLOCK: f64 = 7.0;
        let (mut x, top) = (20.0, 50.0 + 2.5 * BLOCK);
        for character in text.chars() {
            for (row, bits) in glyph(character).into_iter().enumerate() {
                for column in 0..3 {
                    if bits >> (2 - column) & 1 == 1 {
                        let left = x + BLOCK * f64::from(column);
                        let upper = top - BLOCK * row as f64;
                        self.window([left, left + BLOCK], [upper - BLOCK, upper], color);
                    }
                }
            }
            x += 4.0 * BLOCK;
        }
    }

    /// Whether anything within `radius` units of a point may be in the picture.
    fn sees(&self, [x, y]: [f64; 2], radius: f64) -> bool {
        let [dx, dy] = [x - self.eye[0], y - self.eye[1]];
        let reach = self.sight + radius;
        dx * dx + dy * dy <= reach * reach
    }

    /// Fills a polygon given in units.
    fn world(&mut self, corners: &[[f64; 2]; 4], color: Color) {
        let pixels = corners.map(|corner| self.pixel_from_world(corner));
        self.canvas.fill(&pixels, color);
    }

    /// Fills a polygon given in car units on a body. Placed in single precision, as the physics does.
    fn body(&mut self, pose: &Pose, corners: &[[f32; 2]], color: Color) {
        let (sin, cos) = (trig::sin_f32(pose.angle), trig::cos_f32(pose.angle));
        let mut pixels = [[0.0; 2]; 8];
        for (pixel, corner) in pixels.iter_mut().zip(corners) {
            let [x, y] = corner.map(|c| c * CAR_SIZE);
            let placed = [cos * x - sin * y + pose.x, sin * x + cos * y + pose.y];
            *pixel = self.pixel_from_world(placed.map(f64::from));
        }
        self.canvas.fill(&pixels[..corners.len()], color);
    }

    /// Fills a rectangle given in window pixels.
    fn window(&mut self, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], color: Color) {
        let pixels = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|corner| self.pixel_from_window(corner));
        self.canvas.fill(&pixels, color);
    }

    fn pixel_from_world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = [x - self.eye[0], y - self.eye[1]];
        let [cos, sin] = self.turn;
        self.pixel_from_window([ANCHOR[0] + cos * dx - sin * dy, ANCHOR[1] + sin * dx + cos * dy])
    }

    /// Window pixels count from the bottom left, canvas pixels from the top left. The centers coincide.
    fn pixel_from_window(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.half[0] + (x - WINDOW[0] / 2.0) * self.scale[0],
            self.half[1] + (WINDOW[1] / 2.0 - y) * self.scale[1],
        ]
    }
}

/// The ends of the stripe on a wheel that shows its rotation, in half wheel lengths, unless it is underneath.
fn stripe(phase: f64) -> Option<[f64; 2]> {
    let (s1, c1) = (trig::sin(phase), trig::cos(phase));
    let (s2, c2) = (trig::sin(phase + 1.2), trig::cos(phase + 1.2));
    let seen = |sin: f64, cos: f64| {
        if sin > 0.0 { f64::from(i8::from(cos > 0.0) - i8::from(cos < 0.0)) } else { cos }
    };
    (s1 <= 0.0 || s2 <= 0.0).then(|| [seen(s1, c1), seen(s2, c2)])
}

/// A character as five rows of three bits.
fn glyph(character: char) -> [u8; 5] {
    match character {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 2, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '-' => [0, 0, 7, 0, 0],
        _ => [0; 5],
    }
}

#[cfg(test)]
mod tests {
    use super::super::Seed;
    use super::super::random::UniformStream;
    use super::*;

    fn scene<'a>(track: &'a Track, touched: &'a [bool]) -> Scene<'a> {
        let node = track.nodes[0];
        let hull = Pose { x: node.x as f32, y: node.y as f32, angle: node.beta as f32 };
        let camera = Camera { x: node.x, y: node.y, angle: node.beta, velocity: [0.0; 2] };
        let car = CarView { hull, wheels: [(hull, 0.0); 4], is_agent: true };
        Scene { track, touched, chuckholes: &[], cars: vec![car], time: 2.0, camera, indicators: None }
    }

    fn pixel(rgb: &[u8], width: usize, column: usize, row: usize) -> [u8; 3] {
        let at = 3 * (row * width + column);
        [rgb[at], rgb[at + 1], rgb[at + 2]]
    }

    #[test]
    fn the_car_is_drawn_a_quarter_up_on_the_middle_of_a_grey_road() {
        let track = Track::generate(&mut UniformStream::track(Seed::Native(0)));
        let touched = vec![true; track.nodes.len()];

        let rgb = state_image(&scene(&track, &touched), 96);

        assert_eq!(pixel(&rgb, 96, 48, 72), AGENT, "the hull");
        assert_eq!(pixel(&rgb, 96, 42, 72), TOUCHED, "the road beside it");
        assert_eq!(pixel(&rgb, 96, 42, 64), TOUCHED, "the road ahead");
    }

    #[test]
    fn a_picture_in_the_shape_of_the_window_shows_what_the_state_image_shows() {
        let track = Track::generate(&mut UniformStream::track(Seed::Native(1)));
        let touched = vec![false; track.nodes.len()];
        let scene = scene(&track, &touched);

        let state = state_image(&scene, 100);
        let large = picture(&scene, 500, 400);

        let same =
            |&(x, y): &(usize, usize)| pixel(&state, 100, x, y) == pixel(&large, 500, 5 * x + 2, 4 * y + 2);
        let n_same = (0..100).flat_map(|x| (0..100).map(move |y| (x, y))).filter(same).count();
        assert!(n_same > 9_800, "{n_same} of 10000 pixels agree");
    }

    #[test]
    fn the_stripe_of_a_wheel_hides_while_it_is_underneath() {
        assert_eq!(stripe(PI / 2.0 - 0.6), None, "both ends are underneath");
        assert!(stripe(-PI / 2.0 - 0.6).is_some(), "both ends are on top");
    }
}
