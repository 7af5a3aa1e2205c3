//! The only helpers over libtorch: rank checks, initialization, and copies between Rust memory and tensors.

pub mod adam;

use std::sync::{Arc, OnceLock};

use rand::{Rng, RngExt as _};
use rand_distr::{Distribution as _, StandardNormal};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest as _, Sha256};
use tch::{Kind, Tensor, nn};

use crate::env::Frame;

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
/// - returns `[B, P, P, 3]`, channels last
pub fn from_frames(frames: &[Frame]) -> Tensor {
    let side = i64::from(frames.first().map_or(0, Frame::side));
    let mut bytes = Vec::with_capacity(frames.len() * (3 * side * side) as usize);
    for frame in frames {
        bytes.extend_from_slice(frame.rgb());
    }
    let bytes = Tensor::from_slice(&bytes).view([frames.len() as i64, side, side, 3]);
    bytes.to_kind(Kind::Float) / 255.0 // [B, P, P, 3]
}

/// The frames of a tensor of intensities, clipped to `[0, 1]` and rounded to bytes.
///
/// # Shapes
/// - `pixels`: `[B, P, P, 3]`, channels last
pub fn to_frames(pixels: &Tensor) -> Vec<Frame> {
    let [_, side, _, _] = dims(pixels);
    let bytes = (pixels.to_kind(Kind::Float) * 255.0).round().clamp(0.0, 255.0).to_kind(Kind::Uint8);
    let bytes = bytes.contiguous().view(-1);
    let mut all = vec![0u8; bytes.numel()];
    bytes.copy_data(&mut all, bytes.numel());
    all.chunks_exact(3 * (side * side) as usize).map(|rgb| Frame::new(side as u32, rgb)).collect()
}

/// The SHA-256 of `bytes`, as `sha256:` and 64 hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    use std::fmt::Write as _;

    let mut hash = String::from("sha256:");
    for byte in Sha256::digest(bytes) {
        write!(hash, "{byte:02x}").unwrap_or_else(|_| unreachable!("a string takes all"));
    }
    hash
}

/// Why parameters cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ParametersError {
    /// The bytes are not a safetensors file.
    #[error("these are not readable network parameters ({0}); fetch or train them again")]
    Damaged(String),
    /// A tensor is absent.
    #[error("the parameter {0:?} is missing: they belong to another network")]
    Missing(String),
    /// A tensor has another shape than the network.
    #[error("the parameter {name:?} has the shape {found:?} where the network wants {wanted:?}")]
    Shape {
        /// Which one.
        name: String,
        /// Its shape.
        found: Vec<i64>,
        /// The network's.
        wanted: Vec<i64>,
    },
}

/// The parameters of networks as safetensors bytes: what crosses a channel and what lies in a file.
#[derive(Clone)]
pub struct Parameters {
    bytes: Arc<[u8]>,
    /// Their hash, once it was asked for: of a large file it takes a while.
    hash: Arc<OnceLock<String>>,
}

impl Parameters {
    fn new(bytes: Arc<[u8]>) -> Self {
        Self { bytes, hash: Arc::default() }
    }

    /// Those of every variable in `stores`, each under `prefix.name`, with `metadata` in the header.
    pub fn of(stores: &[(&str, &nn::VarStore)], metadata: &[(&str, String)]) -> Self {
        let variables = stores.iter().flat_map(|(prefix, store)| {
            store.variables().into_iter().map(move |(name, tensor)| (format!("{prefix}.{name}"), tensor))
        });
        Self::from_tensors(variables, metadata)
    }

    /// Those given by name, with `metadata` in the header.
    ///
    /// The same parameters have the same bytes, and so the same hash, only with one entry of metadata at the most: the
    /// format keeps several in no order.
    pub fn from_tensors(
        tensors: impl IntoIterator<Item = (String, Tensor)>,
        metadata: &[(&str, String)],
    ) -> Self {
        let mut tensors: Vec<_> = tensors
            .into_iter()
            .map(|(name, tensor)| {
                let values: Vec<u8> = to_vec(&tensor).iter().flat_map(|v| v.to_le_bytes()).collect();
                (name, tensor.size().iter().map(|&n| n as usize).collect::<Vec<_>>(), values)
            })
            .collect();
        tensors.sort_by(|a, b| a.0.cmp(&b.0));
        let views = tensors.iter().map(|(name, shape, values)| {
            let view = TensorView::new(Dtype::F32, shape.clone(), values);
            (name, view.unwrap_or_else(|e| unreachable!("sizes come from the tensor itself: {e}")))
        });
        let metadata = metadata.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        let bytes = safetensors::serialize(views, Some(metadata));
        Self::new(bytes.unwrap_or_else(|e| unreachable!("every view is whole: {e}")).into())
    }

    /// Those in `bytes`, if they can be read.
    pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, ParametersError> {
        let bytes = bytes.into();
        SafeTensors::deserialize(&bytes).map_err(|e| ParametersError::Damaged(e.to_string()))?;
        Ok(Self::new(bytes))
    }

    /// Copies these into the variables of `store`, whose names here begin with `prefix`.
    pub fn load(&self, prefix: &str, store: &nn::VarStore) -> Result<(), ParametersError> {
        let file =
            SafeTensors::deserialize(&self.bytes).map_err(|e| ParametersError::Damaged(e.to_string()))?;
        for (name, mut variable) in store.variables() {
            let name = format!("{prefix}.{name}");
            let view = file.tensor(&name).map_err(|_| ParametersError::Missing(name.clone()))?;
            let found: Vec<i64> = view.shape().iter().map(|&n| n as i64).collect();
            if found != variable.size() || view.dtype() != Dtype::F32 {
                return Err(ParametersError::Shape { name, found, wanted: variable.size() });
            }
            tch::no_grad(|| variable.copy_(&from_slice(&floats(view.data()), &found)));
        }
        Ok(())
    }

    /// These and others, under the same header.
    pub fn with(&self, others: impl IntoIterator<Item = (String, Tensor)>) -> Self {
        let Ok((_, header)) = SafeTensors::read_metadata(&self.bytes) else { return self.clone() };
        let metadata = header.metadata().clone().unwrap_or_default();
        let metadata: Vec<_> = metadata.iter().map(|(key, value)| (key.as_str(), value.clone())).collect();
        let own =
            header.offset_keys().into_iter().filter_map(|name| Some((name.clone(), self.tensor(&name)?)));
        Self::from_tensors(own.chain(others), &metadata)
    }

    /// The tensor called `name`.
    pub fn tensor(&self, name: &str) -> Option<Tensor> {
        let file = SafeTensors::deserialize(&self.bytes).ok()?;
        let view = file.tensor(name).ok().filter(|view| view.dtype() == Dtype::F32)?;
        let shape: Vec<i64> = view.shape().iter().map(|&n| n as i64).collect();
        Some(from_slice(&floats(view.data()), &shape))
    }

    /// The value of `key` in the header.
    pub fn metadata(&self, key: &str) -> Option<String> {
        let (_, header) = SafeTensors::read_metadata(&self.bytes).ok()?;
        header.metadata().as_ref()?.get(key).cloned()
    }

    /// The bytes of a safetensors file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// What identifies them: the [`sha256`] of the bytes.
    pub fn hash(&self) -> String {
        self.hash.get_or_init(|| sha256(&self.bytes)).clone()
    }
}

/// Little-endian bytes as numbers.
fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

impl std::fmt::Debug for Parameters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Parameters({} bytes)", self.bytes.len())
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn frames_survive_the_way_to_tensors_and_back() {
        let frame = Frame::new(2, (0..12u8).map(|i| i * 23).collect::<Vec<_>>());
        assert_eq!(to_frames(&from_frames(std::slice::from_ref(&frame))), [frame]);
    }

    #[test]
    fn parameters_survive_the_way_to_bytes_and_back() {
        let store = |seed| {
            let store = nn::VarStore::new(tch::Device::Cpu);
            let values = uniform(&mut ChaCha8Rng::seed_from_u64(seed), &[3, 2], 1.0);
            let _ = store.root().var_copy("w", &values);
            store
        };
        let (from, to) = (store(1), store(2));
        let bytes = Parameters::of(&[("net", &from)], &[("config", "{}".to_owned())]);
        assert_eq!(bytes.metadata("config").as_deref(), Some("{}"));
        Parameters::from_bytes(bytes.bytes()).unwrap().load("net", &to).unwrap();
        assert_eq!(to_vec(&from.variables()["w"]), to_vec(&to.variables()["w"]));
        let missing = bytes.load("other", &to).unwrap_err().to_string();
        assert!(missing.contains("other.w"), "{missing}");
    }
}
