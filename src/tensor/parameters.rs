//! The parameters of networks as they cross channels and lie in files.

use std::cmp::Reverse;
use std::sync::{Arc, OnceLock};

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};
use tch::{Kind, Tensor, nn};

use crate::tensor::container::{self, Container, ContainerError, Dtype, Part};
use crate::tensor::{from_slice, to_vec};

/// In which order the axes of stored networks stand: PyTorch's own.
///
/// `[out, in, k, k]` for a convolution, `[in, out, k, k]` for a transposed one, `[out, in]` for a linear layer, `[E, out, in]`
/// and `[E, out]` for one of each member of an ensemble. In layout 1 some lay as they lie in memory, see [`Slot`].
pub const LAYOUT: u32 = 2;

/// The SHA-256 of `bytes`, as `sha256:` and 64 hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    use std::fmt::Write as _;

    let mut hash = String::from("sha256:");
    for byte in Sha256::digest(bytes) {
        write!(hash, "{byte:02x}").unwrap_or_else(|_| unreachable!("a string takes all"));
    }
    hash
}

/// Why parameters cannot be loaded, or not be stored as is wanted.
#[derive(Debug, thiserror::Error)]
pub enum ParametersError {
    /// The bytes are not a safetensors file.
    #[error("these are not readable network parameters ({0}); fetch or train them again")]
    Damaged(ContainerError),
    /// The description in the header cannot be understood.
    #[error("these are not readable network parameters ({0}); fetch or train them again")]
    Description(DescriptionError),
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
    /// A tensor does not hold floating numbers.
    #[error("the parameter {name:?} is of the type {found}, and what is read is F32, F16, BF16 and F64")]
    Kind {
        /// Which one.
        name: String,
        /// Its type.
        found: Dtype,
    },
    /// A tensor holds what is no number.
    #[error(
        "the parameter {0:?} holds a number that is infinite or none (NaN), of which nothing can come; fetch or train them \
         again"
    )]
    NotFinite(String),
    /// A number is too large for the type in which it should be stored.
    #[error("the parameter {name:?} holds a number that {dtype} does not reach: choose another --dtype")]
    TooLarge {
        /// Which one.
        name: String,
        /// The type.
        dtype: Dtype,
    },
}

/// Why the description in a header cannot be understood.
#[derive(Debug, thiserror::Error)]
pub enum DescriptionError {
    /// There is none.
    #[error("it has none")]
    Missing,
    /// It is not JSON, or tells something else.
    #[error(transparent)]
    Json(serde_json::Error),
    /// The tensors are in a layout that is not known here.
    #[error("its layout is {0}, and this program reads up to {LAYOUT}")]
    Layout(serde_json::Value),
}

/// Where a number that was computed is infinite or none, at its first appearance.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is infinite or not a number (NaN)")]
pub struct NotFinite(pub String);

impl From<NotFinite> for String {
    fn from(met: NotFinite) -> Self {
        met.to_string()
    }
}

/// One tensor of a network: what it is called, how it is stored, and how it lies in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Its name in the network's store.
    pub name: String,
    /// Its shape in a file: PyTorch's.
    pub shape: Vec<i64>,
    /// How it lies in memory, and lay in files of layout 1, if otherwise.
    rearranged: Option<Rearranged>,
}

/// Axes in another order, some of them merged.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Rearranged {
    /// Which axis of the file's comes first, second, …
    order: Vec<i64>,
    /// The shape that follows.
    shape: Vec<i64>,
}

impl Slot {
    /// A tensor that lies in memory as in a file.
    pub fn plain(name: impl Into<String>, shape: &[i64]) -> Self {
        Self { name: name.into(), shape: shape.to_vec(), rearranged: None }
    }

    /// The same tensor, in memory with its axes in `order`, and then of the shape `in_memory`.
    pub fn rearranged(self, order: &[i64], in_memory: &[i64]) -> Self {
        Self { rearranged: Some(Rearranged { order: order.to_vec(), shape: in_memory.to_vec() }), ..self }
    }

    /// Its shape in a file of this layout.
    pub fn shape_in(&self, layout: u32) -> &[i64] {
        match &self.rearranged {
            Some(Rearranged { shape, .. }) if layout < LAYOUT => shape,
            _ => &self.shape,
        }
    }

    /// Its shape in memory.
    pub fn shape_in_memory(&self) -> &[i64] {
        self.shape_in(1)
    }

    /// A tensor of PyTorch's shape as it lies in memory.
    pub fn into_memory(&self, stored: &Tensor) -> Tensor {
        match &self.rearranged {
            Some(Rearranged { order, shape }) => {
                stored.permute(order.as_slice()).contiguous().view(shape.as_slice())
            }
            None => stored.shallow_clone(),
        }
    }

    /// The way back of [`Self::into_memory`].
    pub fn from_memory(&self, in_memory: &Tensor) -> Tensor {
        let Some(Rearranged { order, .. }) = &self.rearranged else { return in_memory.shallow_clone() };
        let permuted: Vec<i64> = order.iter().map(|&axis| self.shape[axis as usize]).collect();
        let mut back = vec![0; order.len()];
        for (i, &axis) in order.iter().enumerate() {
            back[axis as usize] = i as i64;
        }
        in_memory.detach().contiguous().view(permuted.as_slice()).permute(back.as_slice()).contiguous()
    }

    /// A tensor from a file of this layout as it lies in memory, if it has the shape that it should have there.
    pub fn read(&self, tensor: &Tensor, layout: u32) -> Option<Tensor> {
        (tensor.size() == self.shape_in(layout)).then(|| self.moved(tensor, layout, 1))
    }

    /// A tensor of a file of layout `from` as it is in one of layout `to`.
    fn moved(&self, tensor: &Tensor, from: u32, to: u32) -> Tensor {
        match (from < LAYOUT, to < LAYOUT) {
            (true, false) => self.from_memory(tensor),
            (false, true) => self.into_memory(tensor),
            _ => tensor.shallow_clone(),
        }
    }
}

/// `what` as text for the metadata of parameters in this program's layout.
pub fn described(what: &impl Serialize) -> String {
    in_layout(&serde_json::to_string(what).unwrap_or_else(|e| unreachable!("plain data: {e}")))
}

/// A description with the mark of the layout at its head.
fn in_layout(description: &str) -> String {
    format!("{{\"layout\":{LAYOUT},{}", description.trim_start().trim_start_matches('{'))
}

/// The way back of [`in_layout`]: the description as files of layout 1 have it.
fn in_layout_1(description: &str) -> Option<String> {
    description.strip_prefix(&format!("{{\"layout\":{LAYOUT},")).map(|rest| format!("{{{rest}"))
}

/// The layout that a description tells. Without one it is the first.
pub fn layout_of(description: Option<&str>) -> Result<u32, DescriptionError> {
    match description {
        Some(description) => describes::<serde_json::Value>(Some(description)).map(|(layout, _)| layout),
        None => Ok(1),
    }
}

/// The layout and what else a description tells, or why it cannot be understood.
pub fn describes<T: DeserializeOwned>(description: Option<&str>) -> Result<(u32, T), DescriptionError> {
    let description = description.ok_or(DescriptionError::Missing)?;
    let mut value: serde_json::Value = serde_json::from_str(description).map_err(DescriptionError::Json)?;
    let layout = match value.as_object_mut().and_then(|fields| fields.remove("layout")) {
        None => 1,
        Some(layout) => match layout.as_u64().and_then(|layout| u32::try_from(layout).ok()) {
            Some(known @ 1..=LAYOUT) => known,
            _ => return Err(DescriptionError::Layout(layout)),
        },
    };
    Ok((layout, serde_json::from_value(value).map_err(DescriptionError::Json)?))
}

/// The parameters of networks as safetensors bytes: what crosses a channel and what lies in a file.
#[derive(Clone)]
pub struct Parameters {
    bytes: Arc<[u8]>,
    /// Their hash, once it was asked for: of a large file it takes a while.
    hash: Arc<OnceLock<String>>,
    /// That of the same parameters in the other layout, likewise.
    other_hash: Arc<OnceLock<Option<String>>>,
}

impl Parameters {
    fn new(bytes: Arc<[u8]>) -> Self {
        Self { bytes, hash: Arc::default(), other_hash: Arc::default() }
    }

    /// Those of every variable in `stores`, each under `prefix.name`, with `metadata` in the header.
    pub fn of(stores: &[(&str, &nn::VarStore)], metadata: &[(&str, String)]) -> Self {
        let variables = stores.iter().flat_map(|(prefix, store)| {
            store.variables().into_iter().map(move |(name, tensor)| (format!("{prefix}.{name}"), tensor))
        });
        Self::from_tensors(variables, metadata)
    }

    /// Those of the networks in `stores` in this program's layout, each under `prefix.name`.
    pub fn stored(stores: &[(&str, &nn::VarStore, &[Slot])], metadata: &[(&str, String)]) -> Self {
        let mut tensors = Vec::new();
        for (prefix, store, slots) in stores {
            let variables = store.variables();
            let there = slots.iter().filter_map(|slot| Some((slot, variables.get(&slot.name)?)));
            tensors.extend(
                there.map(|(slot, tensor)| (format!("{prefix}.{}", slot.name), slot.from_memory(tensor))),
            );
        }
        Self::from_tensors(tensors, metadata)
    }

    /// Those given by name, with `metadata` in the header.
    ///
    /// The same parameters have the same bytes, and so the same hash.
    pub fn from_tensors(
        tensors: impl IntoIterator<Item = (String, Tensor)>,
        metadata: &[(&str, String)],
    ) -> Self {
        let parts = tensors.into_iter().map(|(name, tensor)| part(name, &tensor)).collect();
        let metadata: Vec<_> =
            metadata.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        Self::of_parts(Some(&metadata), parts)
    }

    /// Those in `parts`: first what is wide, so that all lie at multiples of their width, then by name.
    fn of_parts(metadata: Option<&[(String, String)]>, mut parts: Vec<Part>) -> Self {
        parts.sort_by(|a, b| {
            (Reverse(a.dtype.bitsize()), &a.name).cmp(&(Reverse(b.dtype.bitsize()), &b.name))
        });
        Self::new(container::write(metadata, &parts).into())
    }

    /// Those in `bytes`, if they can be read.
    pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, ParametersError> {
        let bytes = bytes.into();
        Container::read(&bytes).map_err(ParametersError::Damaged)?;
        Ok(Self::new(bytes))
    }

    /// What the bytes hold.
    fn container(&self) -> Result<Container<'_>, ParametersError> {
        Container::read(&self.bytes).map_err(ParametersError::Damaged)
    }

    /// Fails where a tensor of a network is not there, or not as the network wants it, before anything is made.
    pub fn require(&self, prefix: &str, slots: &[Slot], layout: u32) -> Result<(), ParametersError> {
        let container = self.container()?;
        for slot in slots {
            let name = format!("{prefix}.{}", slot.name);
            let entry = container.entry(&name).ok_or_else(|| ParametersError::Missing(name.clone()))?;
            let found: Vec<i64> = entry.shape.iter().map(|&n| n as i64).collect();
            let wanted = slot.shape_in(layout);
            if found != wanted {
                return Err(ParametersError::Shape { name, found, wanted: wanted.to_vec() });
            }
            if !is_floating(entry.dtype) {
                return Err(ParametersError::Kind { name, found: entry.dtype });
            }
        }
        Ok(())
    }

    /// Copies the tensors of a network into the variables of its `store`, whose names here begin with `prefix`.
    ///
    /// What [`Self::require`] finds wrong is found here too.
    pub fn fill(
        &self,
        prefix: &str,
        slots: &[Slot],
        layout: u32,
        store: &nn::VarStore,
    ) -> Result<(), ParametersError> {
        self.require(prefix, slots, layout)?;
        let container = self.container()?;
        let mut variables = store.variables();
        for slot in slots {
            let (stored, _) = finite(&container, &format!("{prefix}.{}", slot.name))?;
            let Some(variable) = variables.get_mut(&slot.name) else { continue };
            let in_memory = slot.moved(&stored, layout, 1);
            tch::no_grad(|| variable.copy_(&in_memory));
        }
        Ok(())
    }

    /// Copies these into the variables of `store`, whose names here begin with `prefix` and which lie here as in memory.
    pub fn load(&self, prefix: &str, store: &nn::VarStore) -> Result<(), ParametersError> {
        let container = self.container()?;
        for (name, mut variable) in store.variables() {
            let (tensor, name) = finite(&container, &format!("{prefix}.{name}"))?;
            if tensor.size() != variable.size() {
                return Err(ParametersError::Shape { name, found: tensor.size(), wanted: variable.size() });
            }
            tch::no_grad(|| variable.copy_(&tensor));
        }
        Ok(())
    }

    /// These and others, under the same header. One that has the name of one of these takes its place.
    pub fn with(&self, others: impl IntoIterator<Item = (String, Tensor)>) -> Self {
        let Ok(container) = self.container() else { return self.clone() };
        let others: Vec<_> = others.into_iter().map(|(name, tensor)| part(name, &tensor)).collect();
        let mut parts = parts_of(&container);
        parts.retain(|part| others.iter().all(|other| other.name != part.name));
        parts.extend(others);
        Self::of_parts(container.metadata.as_deref(), parts)
    }

    /// The same with the numbers of all tensors that are `chosen` stored as `dtype`. Each is rounded to the nearest.
    pub fn narrowed(&self, dtype: Dtype, chosen: impl Fn(&str) -> bool) -> Result<Self, ParametersError> {
        let container = self.container()?;
        let mut parts = parts_of(&container);
        for part in parts.iter_mut().filter(|part| chosen(&part.name)) {
            let (tensor, name) = finite(&container, &part.name)?;
            let kind = kind_of(dtype).ok_or(ParametersError::Kind { name, found: dtype })?;
            let narrow = tensor.to_kind(kind);
            if !is_finite(&narrow) {
                return Err(ParametersError::TooLarge { name: part.name.clone(), dtype });
            }
            (part.dtype, part.bytes) = (dtype, bytes_of(&narrow));
        }
        Ok(Self::of_parts(container.metadata.as_deref(), parts))
    }

    /// The same parameters in another layout, all else in its place. Nothing where they cannot be that.
    ///
    /// `key` is where the metadata tells the layout, `from` the one in which they are, and `networks` are prefixes and
    /// the tensors of a network each.
    pub fn relaid(&self, key: &str, networks: &[(&str, &[Slot])], from: u32, to: u32) -> Option<Self> {
        let container = self.container().ok()?;
        let mut metadata = container.metadata.clone()?;
        let description = &mut metadata.iter_mut().find(|(found, _)| found == key)?.1;
        *description = match (from < LAYOUT, to < LAYOUT) {
            (true, false) => in_layout(description),
            (false, true) => in_layout_1(description)?,
            _ => return Some(self.clone()),
        };
        let mut parts = parts_of(&container);
        for (prefix, slots) in networks {
            for slot in slots.iter().filter(|slot| slot.rearranged.is_some()) {
                let name = format!("{prefix}.{}", slot.name);
                let part = parts.iter_mut().find(|part| part.name == name)?;
                let shape: Vec<i64> = part.shape.iter().map(|&n| n as i64).collect();
                if shape != slot.shape_in(from) {
                    return None;
                }
                let tensor = Tensor::f_from_data_size(&part.bytes, &shape, kind_of(part.dtype)?).ok()?;
                let moved = slot.moved(&tensor, from, to);
                part.shape = moved.size().iter().map(|&n| n as usize).collect();
                part.bytes = bytes_of(&moved);
            }
        }
        Some(Self::new(container::write(Some(&metadata), &parts).into()))
    }

    /// The tensor called `name`, if it is one of floating numbers.
    pub fn tensor(&self, name: &str) -> Option<Tensor> {
        let container = self.container().ok()?;
        let entry = container.entry(name)?;
        let shape: Vec<i64> = entry.shape.iter().map(|&n| n as i64).collect();
        Some(from_slice(&container.floats(entry)?, &shape))
    }

    /// The tensor called `name`, if there is one. All its numbers must be finite.
    pub fn finite(&self, name: &str) -> Result<Option<Tensor>, ParametersError> {
        let container = self.container()?;
        if container.entry(name).is_none() {
            return Ok(None);
        }
        finite(&container, name).map(|(tensor, _)| Some(tensor))
    }

    /// The value of `key` in the header.
    pub fn metadata(&self, key: &str) -> Option<String> {
        self.container().ok()?.value(key).map(str::to_owned)
    }

    /// The same with `value` under `key` in the header, whatever stood there.
    pub fn with_metadata(&self, key: &str, value: String) -> Self {
        let Ok(container) = self.container() else { return self.clone() };
        let mut metadata = container.metadata.clone().unwrap_or_default();
        metadata.retain(|(other, _)| other != key);
        metadata.push((key.to_owned(), value));
        Self::of_parts(Some(&metadata), parts_of(&container))
    }

    /// The bytes of a safetensors file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// What identifies them: the [`sha256`] of the bytes.
    pub fn hash(&self) -> String {
        self.hash.get_or_init(|| sha256(&self.bytes)).clone()
    }

    /// The hash of the same parameters as `relaid` writes them, which is asked only once.
    pub(crate) fn other_hash(&self, relaid: impl FnOnce(&Self) -> Option<Self>) -> Option<&str> {
        self.other_hash.get_or_init(|| relaid(self).map(|other| other.hash())).as_deref()
    }
}

/// The tensor called `name`, whose numbers must be finite, and its name.
fn finite(container: &Container<'_>, name: &str) -> Result<(Tensor, String), ParametersError> {
    let name = name.to_owned();
    let Some(entry) = container.entry(&name) else { return Err(ParametersError::Missing(name)) };
    let Some(values) = container.floats(entry) else {
        return Err(ParametersError::Kind { name, found: entry.dtype });
    };
    if !values.iter().all(|value| value.is_finite()) {
        return Err(ParametersError::NotFinite(name));
    }
    let shape: Vec<i64> = entry.shape.iter().map(|&n| n as i64).collect();
    Ok((from_slice(&values, &shape), name))
}

/// Whether every number of `tensor` is one.
pub fn is_finite(tensor: &Tensor) -> bool {
    tch::no_grad(|| tensor.isfinite().all().int64_value(&[]) == 1)
}

/// Fails where a variable of `store` is not finite. `whose` says of what it is one.
pub fn require_finite(store: &nn::VarStore, whose: &str) -> Result<(), NotFinite> {
    let variables = store.variables();
    let mut names: Vec<_> = variables.iter().filter(|(_, tensor)| !is_finite(tensor)).collect();
    names.sort_by_key(|(name, _)| *name);
    match names.first() {
        Some((name, _)) => Err(NotFinite(format!("the parameter {name:?} of {whose}"))),
        None => Ok(()),
    }
}

fn is_floating(dtype: Dtype) -> bool {
    matches!(dtype, Dtype::F64 | Dtype::F32 | Dtype::F16 | Dtype::BF16)
}

/// What libtorch calls numbers of this type.
fn kind_of(dtype: Dtype) -> Option<Kind> {
    Some(match dtype {
        Dtype::F64 => Kind::Double,
        Dtype::F32 => Kind::Float,
        Dtype::F16 => Kind::Half,
        Dtype::BF16 => Kind::BFloat16,
        _ => return None,
    })
}

fn bytes_of(tensor: &Tensor) -> Vec<u8> {
    let tensor = tensor.contiguous();
    let mut bytes = vec![0; tensor.numel() * tensor.kind().elt_size_in_bytes()];
    tensor.copy_data_u8(&mut bytes, tensor.numel());
    bytes
}

fn part(name: String, tensor: &Tensor) -> Part {
    let bytes = to_vec(tensor).iter().flat_map(|v| v.to_le_bytes()).collect();
    Part { name, dtype: Dtype::F32, shape: tensor.size().iter().map(|&n| n as usize).collect(), bytes }
}

fn parts_of(container: &Container<'_>) -> Vec<Part> {
    let part = |entry: &container::Entry| Part {
        name: entry.name.clone(),
        dtype: entry.dtype,
        shape: entry.shape.clone(),
        bytes: container.bytes(entry).to_vec(),
    };
    container.entries.iter().map(part).collect()
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
    use crate::tensor::uniform;

    fn store(seed: u64) -> nn::VarStore {
        let store = nn::VarStore::new(tch::Device::Cpu);
        let values = uniform(&mut ChaCha8Rng::seed_from_u64(seed), &[3, 2], 1.0);
        let _ = store.root().var_copy("w", &values);
        store
    }

    #[test]
    fn parameters_survive_the_way_to_bytes_and_back() {
        let (from, to) = (store(1), store(2));
        let bytes = Parameters::of(&[("net", &from)], &[("config", "{}".to_owned())]);
        assert_eq!(bytes.metadata("config").as_deref(), Some("{}"));
        Parameters::from_bytes(bytes.bytes()).unwrap().load("net", &to).unwrap();
        assert_eq!(to_vec(&from.variables()["w"]), to_vec(&to.variables()["w"]));
        let missing = bytes.load("other", &to).unwrap_err().to_string();
        assert!(missing.contains("other.w"), "{missing}");
    }

    #[test]
    fn what_is_rearranged_in_memory_is_stored_as_pytorch_has_it() {
        let slot = Slot::plain("w", &[2, 3, 1, 1]).rearranged(&[2, 3, 1, 0], &[3, 2]);
        let (from, to) = (store(1), store(2));
        let parameters = Parameters::stored(
            &[("net", &from, std::slice::from_ref(&slot))],
            &[("config", described(&serde_json::json!({"k": 1})))],
        );
        let stored = parameters.tensor("net.w").unwrap();
        let in_memory = from.variables()["w"].shallow_clone();
        assert_eq!(stored.size(), [2, 3, 1, 1]);
        assert_eq!(stored.double_value(&[1, 2, 0, 0]), in_memory.double_value(&[2, 1]));

        parameters.fill("net", std::slice::from_ref(&slot), LAYOUT, &to).unwrap();
        assert_eq!(to_vec(&in_memory), to_vec(&to.variables()["w"]));
        let slots: &[(&str, &[Slot])] = &[("net", &[slot])];
        let earlier = parameters.relaid("config", slots, LAYOUT, 1).unwrap();
        assert_eq!(
            earlier.bytes(),
            Parameters::of(&[("net", &from)], &[("config", "{\"k\":1}".to_owned())]).bytes()
        );
        assert_eq!(earlier.relaid("config", slots, 1, LAYOUT).unwrap().bytes(), parameters.bytes());
    }

    #[test]
    fn halves_are_read_as_the_numbers_that_they_are() {
        let (from, to) = (store(1), store(2));
        let parameters = Parameters::of(&[("net", &from)], &[]);
        for (dtype, kind) in [(Dtype::F16, Kind::Half), (Dtype::BF16, Kind::BFloat16)] {
            let narrow = parameters.narrowed(dtype, |_| true).unwrap();
            assert_eq!(parts_of(&narrow.container().unwrap())[0].bytes.len(), 12, "half of 24");
            narrow.load("net", &to).unwrap();
            let rounded = from.variables()["w"].to_kind(kind).to_kind(Kind::Float);
            assert_eq!(to_vec(&to.variables()["w"]), to_vec(&rounded));
        }
        let large = parameters.with([("net.w".to_owned(), Tensor::from_slice(&[1e6_f32]))]);
        let refused = large.narrowed(Dtype::F16, |_| true).unwrap_err().to_string();
        assert!(refused.contains("net.w") && refused.contains("F16"), "{refused}");
    }

    #[test]
    fn what_is_not_a_number_is_refused_by_name() {
        let parameters = Parameters::of(&[("net", &store(1))], &[]);
        let bad = parameters.with([("net.w".to_owned(), from_slice(&[f32::NAN; 6], &[3, 2]))]);
        let refused = bad.load("net", &store(2)).unwrap_err().to_string();
        assert!(refused.contains("net.w") && refused.contains("NaN"), "{refused}");
        assert!(bad.finite("net.w").is_err() && parameters.finite("net.v").unwrap().is_none());
    }

    #[test]
    fn a_layout_that_is_not_known_is_refused() {
        let read = |text: &str| describes::<std::collections::BTreeMap<String, i64>>(Some(text));
        assert_eq!(read("{\"k\":1}").unwrap().0, 1);
        assert_eq!(read("{\"layout\":2,\"k\":1}").map(|(layout, all)| (layout, all.len())).unwrap(), (2, 1));
        assert!(read("{\"layout\":3}").unwrap_err().to_string().contains("up to 2"));
        assert!(read("{\"layout\":-1}").is_err() && read("7").is_err());
    }
}
