//! What computes: the processor, or an accelerator beside it.

use std::fmt;
use std::str::FromStr;

use rand::Rng;
use tch::{Cuda, Device, Kind, Tensor};

use crate::tensor::normal;

/// The device that is asked for, by its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// An accelerator if there is one, else the processor.
    #[default]
    Auto,
    /// The processor.
    Cpu,
    /// The CUDA device of this number.
    Cuda(usize),
    /// The graphics of an Apple computer.
    Mps,
}

/// Why there is no such device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// No name of one.
    #[error("{0:?} is no device: it is auto, cpu, cuda, cuda:N (the number of one) or mps")]
    Name(String),
    /// A name of one that is not there.
    #[error("there is no {wanted} that this program can compute on: there is {there}")]
    Absent {
        /// What was asked for.
        wanted: String,
        /// What there is.
        there: String,
    },
}

impl FromStr for DeviceChoice {
    type Err = DeviceError;

    fn from_str(name: &str) -> Result<Self, DeviceError> {
        let unknown = || DeviceError::Name(name.to_owned());
        match name {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "cuda" => Ok(Self::Cuda(0)),
            "mps" => Ok(Self::Mps),
            _ => {
                let number = name.strip_prefix("cuda:").ok_or_else(unknown)?;
                let is_plain = number.bytes().all(|byte| byte.is_ascii_digit());
                number.parse().ok().filter(|_| is_plain).map(Self::Cuda).ok_or_else(unknown)
            }
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(number) => write!(f, "cuda:{number}"),
            Self::Mps => f.write_str("mps"),
        }
    }
}

/// A device, and the arithmetic in which it trains large products.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backend {
    /// Where stores are made and batches go.
    pub device: Device,
    /// The arithmetic of large products in training. Parameters and all else are `f32`.
    pub kind: Kind,
}

impl Backend {
    /// The processor.
    pub fn cpu() -> Self {
        Self { device: Device::Cpu, kind: fast_kind() }
    }

    /// What is asked for, if it is there.
    pub fn of(choice: DeviceChoice) -> Result<Self, DeviceError> {
        let there = devices();
        let is_there = |device: &Device| there.contains(device);
        let device = match choice {
            DeviceChoice::Auto => there.first().copied(),
            DeviceChoice::Cpu => Some(Device::Cpu),
            DeviceChoice::Cuda(number) => Some(Device::Cuda(number)).filter(is_there),
            DeviceChoice::Mps => Some(Device::Mps).filter(is_there),
        };
        let absent = || {
            let names: Vec<_> = there.iter().map(|device| name_of(*device)).collect();
            let there = match &names[..] {
                [only] => format!("only {only}"),
                names => names.join(", "),
            };
            DeviceError::Absent { wanted: choice.to_string(), there }
        };
        let device = device.ok_or_else(absent)?;
        Ok(Self::on(device))
    }

    /// What computes on `device`, in its quickest arithmetic.
    pub fn on(device: Device) -> Self {
        Self { device, kind: kind_on(device) }
    }

    /// Whether it is the processor, on which the same seed makes the same numbers.
    pub fn is_cpu(self) -> bool {
        self.device == Device::Cpu
    }

    /// The arithmetic in which a memory is trained: single precision on the processor.
    pub fn recurrent_kind(self) -> Kind {
        if matches!(self.device, Device::Cuda(_)) { self.kind } else { Kind::Float }
    }

    /// Standard normal noise of `shape`: drawn by `rng` for the processor, and elsewhere on the device itself.
    pub fn normal(self, rng: &mut impl Rng, shape: &[i64]) -> Tensor {
        if self.is_cpu() { normal(rng, shape) } else { Tensor::randn(shape, (Kind::Float, self.device)) }
    }

    /// Seeds what the device draws, by `rng`, and chooses the quickest of its convolutions from now on.
    ///
    /// On the processor nothing is drawn by torch, and `rng` stays as it is.
    pub fn begin(self, rng: &mut impl Rng) {
        if !self.is_cpu() {
            tch::manual_seed(rng.next_u64() as i64);
        }
        if matches!(self.device, Device::Cuda(_)) {
            Cuda::cudnn_set_benchmark(true);
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name_of(self.device))
    }
}

/// All devices on which this program can compute, the best first.
fn devices() -> Vec<Device> {
    let cuda = (0..Cuda::device_count().max(0) as usize).map(Device::Cuda);
    let mps = tch::utils::has_mps().then_some(Device::Mps);
    cuda.chain(mps).chain([Device::Cpu]).collect()
}

fn name_of(device: Device) -> String {
    match device {
        Device::Cpu => "the processor (cpu)".to_owned(),
        Device::Cuda(number) => format!("cuda:{number}"),
        Device::Mps => "mps".to_owned(),
        Device::Vulkan => "vulkan".to_owned(),
    }
}

/// The arithmetic in which large products are quickest on a device.
fn kind_on(device: Device) -> Kind {
    match device {
        Device::Cpu => fast_kind(),
        Device::Cuda(_) => {
            // Older ones have no convolutions in it.
            let picture = Tensor::ones([1, 8, 8, 8], (Kind::BFloat16, device));
            let tried = picture.f_conv2d(&picture, None::<&Tensor>, [1; 2], [0; 2], [1; 2], 1);
            if tried.is_ok() { Kind::BFloat16 } else { Kind::Float }
        }
        Device::Mps | Device::Vulkan => Kind::Float,
    }
}

/// The arithmetic in which large products are quickest on this processor.
///
/// In bf16 where there are tiles for it (AMX), or where its dot product makes twice as much as `f32`'s: Intel's without tiles
/// makes as much, and would have weights rearranged for nothing. On one of those a plan took 1.25 times as long in bf16.
pub fn fast_kind() -> Kind {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512bf16") {
        let cpu = raw_cpuid::CpuId::new();
        let is_intel = cpu.get_vendor_info().is_some_and(|vendor| vendor.as_str() == "GenuineIntel");
        let has_tiles = cpu.get_extended_feature_info().is_some_and(|features| features.has_amx_bf16());
        if has_tiles || !is_intel {
            return Kind::BFloat16;
        }
    }
    Kind::Float
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::tensor::to_vec;

    #[test]
    fn devices_have_names() {
        for (name, choice) in [
            ("auto", DeviceChoice::Auto),
            ("cpu", DeviceChoice::Cpu),
            ("cuda:0", DeviceChoice::Cuda(0)),
            ("cuda:12", DeviceChoice::Cuda(12)),
            ("mps", DeviceChoice::Mps),
        ] {
            assert_eq!(name.parse(), Ok(choice));
            assert_eq!(choice.to_string(), name);
        }
        assert_eq!("cuda".parse(), Ok(DeviceChoice::Cuda(0)));
        for name in ["", "CPU", "cuda:", "cuda:-1", "cuda:+1", "cuda:1.5", "cuda:99999999999999999999", "gpu"]
        {
            let refused = name.parse::<DeviceChoice>().unwrap_err().to_string();
            assert!(refused.contains("cuda:N"), "{refused}");
        }
    }

    #[test]
    fn a_device_that_is_not_there_is_refused_with_what_is_there() {
        let refused = Backend::of(DeviceChoice::Cuda(1000)).unwrap_err().to_string();
        assert!(refused.contains("no cuda:1000") && refused.contains("the processor (cpu)"), "{refused}");
        assert_eq!(Backend::of(DeviceChoice::Cpu), Ok(Backend::cpu()));
        assert!(Backend::of(DeviceChoice::Auto).is_ok(), "there is always the processor");
    }

    #[test]
    fn on_the_processor_noise_is_drawn_in_rust_and_nothing_else_is() {
        let rng = || ChaCha8Rng::seed_from_u64(0);
        let (mut one, mut other) = (rng(), rng());
        Backend::cpu().begin(&mut one);
        assert_eq!(to_vec(&Backend::cpu().normal(&mut one, &[5])), to_vec(&normal(&mut other, &[5])));
        assert_eq!(one, other);
    }
}
