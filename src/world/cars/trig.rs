//! Sines and cosines that are the same on every platform.
//!
//! The standard library asks the system's maths library, and libraries differ in the last bit: after a few hundred
//! steps two machines would drive different episodes. So the product uses the pure Rust `libm`, and only the
//! cross-checks against recorded Python runs ask the system ([`Trig::System`]).

/// Which maths library the physics asks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trig {
    /// `libm`: the same episode on every platform.
    #[default]
    Portable,
    /// The system's library. Bit-equal to Box2D where that is glibc.
    System,
}

impl Trig {
    /// Sine and cosine of `angle` in radians.
    #[inline]
    pub fn sin_cos(self, angle: f32) -> (f32, f32) {
        match self {
            Self::Portable => (libm::sinf(angle), libm::cosf(angle)),
            Self::System => (angle.sin(), angle.cos()),
        }
    }
}

/// Sine of `angle` in radians.
#[inline]
pub fn sin(angle: f64) -> f64 {
    libm::sin(angle)
}

/// Cosine of `angle` in radians.
#[inline]
pub fn cos(angle: f64) -> f64 {
    libm::cos(angle)
}

/// The angle of the point `(x, y)` in `[-π, π]` radians.
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// Sine of `angle` in radians, in single precision.
#[inline]
pub fn sin_f32(angle: f32) -> f32 {
    libm::sinf(angle)
}

/// Cosine of `angle` in radians, in single precision.
#[inline]
pub fn cos_f32(angle: f32) -> f32 {
    libm::cosf(angle)
}
