//! The only helpers over libtorch: rank checks, initialization, and copies between Rust memory and tensors.

pub mod adam;
mod backend;
pub mod container;
pub mod limits;
mod parameters;

use rand::{Rng, RngExt as _};
use rand_distr::{Distribution as _, StandardNormal};
use tch::{Device, Kind, Tensor};

use crate::world::Frame;

pub use backend::{Backend, DeviceChoice, DeviceError, fast_kind};
pub use container::Dtype;
pub use parameters::{
    DescriptionError, LAYOUT, NotFinite, Parameters, ParametersError, Slot, described, describes, is_finite,
    layout_of, require_finite, sha256,
};

/// The sizes of `tensor`, which must have `N` axes.
///
/// # Panics
/// Where it has not.
pub fn dims<const N: usize>(tensor: &Tensor) -> [i64; N] {
    tensor.size().try_into().unwrap_or_else(|size| panic!("expected {N} axes, got {size:?}"))
}

/// A tensor of `shape` with entries uniform in `[-bound, bound]`, drawn by `rng`.
pub fn uniform(rng: &mut impl Rng, shape: &[i64], bound: f64) -> Tensor {
    let n = shape.iter().product::<i64>() as usize;
    let bound = bound as f32;
    let values: Vec<f32> = (0..n).map(|_| rng.random_range(-bound..=bound)).collect();
    Tensor::from_slice(&values).view(shape)
}

/// A tensor of `shape` with standard normal entries, drawn by `rng`.
pub fn normal(rng: &mut impl Rng, shape: &[i64]) -> Tensor {
    let n = shape.iter().product::<i64>() as usize;
    let values: Vec<f32> = (0..n).map(|_| StandardNormal.sample(rng)).collect();
    Tensor::from_slice(&values).view(shape)
}

/// The entries of `tensor` as `f32`, in row-major order.
pub fn to_vec(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.to_kind(Kind::Float).contiguous().view(-1);
    let mut values = vec![0.0; flat.numel()];
    flat.copy_data(&mut values, flat.numel());
    values
}

/// `values` as a tensor of `shape`.
pub fn from_slice(values: &[f32], shape: &[i64]) -> Tensor {
    Tensor::from_slice(values).view(shape)
}

/// Frames as a tensor of intensities in `[0, 1]`: always bytes divided by 255.
///
/// # Shapes
/// - returns `[B, H, W, 3]`, channels last
pub fn from_frames(frames: &[Frame]) -> Tensor {
    intensities(&bytes_of_frames(frames))
}

/// The same on a device, to which only the bytes go.
///
/// # Shapes
/// - returns `[B, H, W, 3]`, channels last
pub fn from_frames_on(device: Device, frames: &[Frame]) -> Tensor {
    intensities(&bytes_of_frames(frames).to_device(device))
}

/// Bytes as intensities in `[0, 1]`.
pub fn intensities(bytes: &Tensor) -> Tensor {
    bytes.to_kind(Kind::Float) / 255.0
}

/// Frames as a tensor of bytes.
///
/// # Shapes
/// - returns `[B, H, W, 3]`, channels last
pub fn bytes_of_frames(frames: &[Frame]) -> Tensor {
    let [height, width] =
        frames.first().map_or([0; 2], |frame| [i64::from(frame.height()), i64::from(frame.width())]);
    let mut bytes = Vec::with_capacity(frames.len() * (3 * height * width) as usize);
    for frame in frames {
        bytes.extend_from_slice(frame.rgb());
    }
    Tensor::from_slice(&bytes).view([frames.len() as i64, height, width, 3])
}

/// The frames of a tensor of intensities, clipped to `[0, 1]` and rounded to bytes.
///
/// # Shapes
/// - `pixels`: `[B, H, W, 3]`, channels last
pub fn to_frames(pixels: &Tensor) -> Vec<Frame> {
    let [_, height, width, _] = dims(pixels);
    let bytes = (pixels.to_kind(Kind::Float) * 255.0).round().clamp(0.0, 255.0).to_kind(Kind::Uint8);
    let bytes = bytes.contiguous().view(-1);
    let mut all = vec![0u8; bytes.numel()];
    bytes.copy_data(&mut all, bytes.numel());
    let frame = |rgb| Frame::new(height as u32, width as u32, rgb);
    all.chunks_exact(3 * (height * width) as usize).map(frame).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_survive_the_way_to_tensors_and_back() {
        for (height, width) in [(2, 2), (1, 4), (4, 1)] {
            let frame = Frame::new(height, width, (0..12u8).map(|i| i * 23).collect::<Vec<_>>());
            assert_eq!(to_frames(&from_frames(std::slice::from_ref(&frame))), [frame]);
        }
    }
}
