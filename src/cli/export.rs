//! `dropj export`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::query::Verdict;
use dropj::reward::sparse::Rules;
use dropj::reward::{RewardEnsemble, RewardNetworks, SparseConfig, SparseReward};
use dropj::run::{read_parameters, write_whole};
use dropj::tensor::Parameters;
use dropj::world_model::{Layer, WorldModel, WorldModelConfig};
use tch::{CModule, Device, Kind, Tensor};

use super::hub::{self, Item};
use super::told::Form;

#[derive(Debug, clap::Args)]
#[command(after_help = FUNCTIONS)]
pub(crate) struct Options {
    /// Write TorchScript, which PyTorch reads in Python and C++: `torch.jit.load`
    #[arg(long, required_unless_present = "hub")]
    torchscript: bool,
    #[command(flatten)]
    hub: hub::HubOptions,
    /// The world model to write
    #[arg(long)]
    world: Option<PathBuf>,
    /// The reward to write
    #[arg(long, required_unless_present_any = ["world", "data"])]
    reward: Option<PathBuf>,
    /// What the files of TorchScript are called: F-observe.pt and so on for F.pt; there must be nothing yet
    #[arg(long, value_name = "F.pt", required_unless_present = "hub", conflicts_with = "hub")]
    out: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

/// What the files hold.
const FUNCTIONS: &str = "\
With --hub, recordings become a LeRobotDataset v3.0 with a card, without journals and what was deleted; a world model or a reward, one \
at a time, becomes model.safetensors with config.json and a card.

With --torchscript, each file is a module with one function, forward, for batches of any size B. Of a world model of Z latents, M memory cells and \
A axes, where a state is its F = Z + 2 M features z, c and h:

  F-observe.pt  frames, uint8 [B, H, W, 3]                        gives z [B, Z]
  F-imagine.pt  features [B, F], actions [B, A], temperature []   gives features [B, F] of the next state, in the mean
  F-sample.pt   the same, uniform [B, Z], normal [B, Z]           gives features [B, F], drawn by that noise
  F-decode.pt   z [B, Z]                                          gives frames, uint8 [B, H, W, 3]

Of a reward:

  F-reward.pt   features [B, F], actions [B, A]                   gives rewards [B]

Actions are as driven. All but frames is float32.";

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let form = options.form;
    let Options { world, reward: learned, hub: hub::HubOptions { hub, data, results }, .. } = options;
    if let Some(folder) = hub {
        let item = match (data, world, learned) {
            (Some(data), ..) => Item::Recordings(data),
            (None, Some(world), None) => Item::World(world),
            (None, None, Some(reward)) => Item::Reward(reward),
            _ => anyhow::bail!(
                "a world model and a reward are two things to the Hub: give --hub one of them, then the other"
            ),
        };
        return hub::write(&item, folder, results.as_deref(), form);
    }
    let out = options.out.as_deref().context("--out is needed for TorchScript")?;
    let mut modules = Vec::new();
    if let Some(path) = &options.world {
        let parameters = WorldModel::relaid(read_parameters(path)?);
        let parameters = parameters.with_context(|| format!("in the file {path:?}"))?;
        let networks = WorldNetworks::of(parameters)?;
        modules.extend(networks.modules()?);
    }
    if let Some(path) = &options.reward {
        let parameters = read_parameters(path)?;
        let module = reward(&parameters).with_context(|| format!("in the file {path:?}"))?;
        modules.push(("reward", module));
    }
    let paths: Vec<_> = modules.iter().map(|(name, _)| place(out, name)).collect();
    if let Some(taken) = paths.iter().find(|path| path.exists()) {
        anyhow::bail!("there is something already where the file should be written: {taken:?}");
    }
    for ((_, module), path) in modules.iter().zip(&paths) {
        write_whole(path, &bytes_of(module)?)?;
    }
    form.tell(&serde_json::json!({"files": paths}), || {
        paths.iter().map(|path| format!("written: {path:?}\n")).collect::<Vec<_>>().concat()
    })
}

/// `F-name.pt` for `F.pt`.
fn place(out: &Path, name: &str) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    out.with_file_name(format!("{stem}-{name}.pt"))
}

/// The file of a module, which libtorch only writes by itself.
fn bytes_of(module: &CModule) -> anyhow::Result<Vec<u8>> {
    let path = std::env::temp_dir().join(format!("dropj-{}.pt", std::process::id()));
    module.save(&path).context("cannot write TorchScript")?;
    let bytes = std::fs::read(&path);
    std::fs::remove_file(&path).ok();
    Ok(bytes?)
}

/// A module of the operations that `function` applies to `inputs`, whatever their first size.
fn traced(inputs: &[Tensor], function: impl Fn(&[Tensor]) -> Tensor) -> anyhow::Result<CModule> {
    let mut function = |inputs: &[Tensor]| vec![function(inputs)];
    tch::no_grad(|| CModule::create_by_tracing("dropj", "forward", inputs, &mut function))
        .context("cannot make TorchScript")
}

/// Weight and bias.
type Affine = [Tensor; 2];

/// The layer of this name.
fn affine(parameters: &Parameters, name: &str) -> anyhow::Result<Affine> {
    let part = |part: &str| {
        let name = format!("{name}.{part}");
        parameters.tensor(&name).with_context(|| format!("the parameter {name:?} is missing"))
    };
    Ok([part("weight")?, part("bias")?])
}

fn linear(x: &Tensor, [weight, bias]: &Affine) -> Tensor {
    x.linear(weight, Some(bias))
}

fn zeros(shape: &[i64]) -> Tensor {
    Tensor::zeros(shape, (Kind::Float, Device::Cpu))
}

/// A world model's networks in plain layers, as PyTorch has them: the program's own are arranged for the processor and compute for
/// a batch whose size they look at.
struct WorldNetworks {
    config: WorldModelConfig,
    /// Pixels where encoder and decoder meet.
    bottom: [i64; 2],
    n_actions: i64,
    encoder: Vec<(Affine, Layer)>,
    mean: Affine,
    decoder_in: Affine,
    decoder: Vec<(Affine, Layer)>,
    of_input: Affine,
    of_output: Affine,
    head: Affine,
}

impl WorldNetworks {
    /// Those in `parameters`, which are in PyTorch's layout.
    fn of(parameters: Parameters) -> anyhow::Result<Self> {
        let config = WorldModel::load(parameters.clone())?.config().clone();
        let convolutions = |name: &str, layers: &[Layer]| -> anyhow::Result<Vec<_>> {
            let one = |(i, layer): (usize, &Layer)| {
                Ok((affine(&parameters, &format!("vae.{name}{}", i + 1))?, *layer))
            };
            layers.iter().enumerate().map(one).collect()
        };
        let shrink = |side, layer: &Layer| (side + 2 * layer.padding - layer.kernel) / layer.stride + 1;
        let bottom = size(&config).map(|side| config.vae.encoder.iter().fold(side, shrink));
        let gates = |part: &str| -> anyhow::Result<Affine> {
            let name = |what| format!("mdn_rnn.lstm.{what}_{part}");
            let tensor = |name: String| {
                parameters.tensor(&name).with_context(|| format!("the parameter {name:?} is missing"))
            };
            Ok([tensor(name("weight"))?, tensor(name("bias"))?])
        };
        let of_input = gates("ih")?;
        Ok(Self {
            bottom,
            n_actions: of_input[0].size()[1] - config.mdn_rnn.latent,
            encoder: convolutions("conv", &config.vae.encoder)?,
            mean: affine(&parameters, "vae.fc_mu")?,
            decoder_in: affine(&parameters, "vae.dec_fc")?,
            decoder: convolutions("deconv", &config.vae.decoder)?,
            of_input,
            of_output: gates("hh")?,
            head: affine(&parameters, "mdn_rnn.head")?,
            config,
        })
    }

    fn modules(&self) -> anyhow::Result<Vec<(&'static str, CModule)>> {
        // Not one: nothing may be taken for a batch that is always of one.
        const B: i64 = 2;
        let [height, width] = size(&self.config);
        let z = self.config.mdn_rnn.latent;
        let frames = Tensor::zeros([B, height, width, 3], (Kind::Uint8, Device::Cpu));
        let (features, actions) = (zeros(&[B, self.config.n_features()]), zeros(&[B, self.n_actions]));
        let temperature = Tensor::ones([0i64; 0], (Kind::Float, Device::Cpu));
        let step = [features, actions, temperature];
        let noise = [zeros(&[B, z]), zeros(&[B, z])];
        let noisy_step: Vec<_> = step.iter().chain(&noise).map(Tensor::shallow_clone).collect();
        Ok(vec![
            ("observe", traced(&[frames], |given| self.observe(&given[0]))?),
            ("imagine", traced(&step, |given| self.imagine(&given[0], &given[1], &given[2], None))?),
            (
                "sample",
                traced(&noisy_step, |given| {
                    self.imagine(&given[0], &given[1], &given[2], Some([&given[3], &given[4]]))
                })?,
            ),
            ("decode", traced(&[zeros(&[B, z])], |given| self.decode(&given[0]))?),
        ])
    }

    fn observe(&self, frames: &Tensor) -> Tensor {
        let mut x = (frames.to_kind(Kind::Float) / 255.0).permute([0, 3, 1, 2]);
        for ([weight, bias], Layer { stride, padding, .. }) in &self.encoder {
            x = x.conv2d(weight, Some(bias), [*stride; 2], [*padding; 2], [1; 2], 1).relu();
        }
        linear(&x.permute([0, 2, 3, 1]).flatten(1, -1), &self.mean)
    }

    fn decode(&self, z: &Tensor) -> Tensor {
        let [height, width] = self.bottom;
        let mut x = linear(z, &self.decoder_in).unflatten(1, [height, width, -1]).permute([0, 3, 1, 2]);
        let layers = self.decoder.iter().zip(self.config.vae.output_padding());
        for (i, (([weight, bias], Layer { stride, padding, .. }), more)) in layers.enumerate() {
            x = if i > 0 { x.relu() } else { x };
            x = x.conv_transpose2d(weight, Some(bias), [*stride; 2], [*padding; 2], more, 1, [1; 2]);
        }
        (x.sigmoid().permute([0, 2, 3, 1]) * 255.0).round().clamp(0.0, 255.0).to_kind(Kind::Uint8)
    }

    /// The features of the next state: of its mean, or drawn by `noise`, uniform and normal.
    fn imagine(
        &self,
        features: &Tensor,
        actions: &Tensor,
        temperature: &Tensor,
        noise: Option<[&Tensor; 2]>,
    ) -> Tensor {
        let (n_latents, m) = (self.config.mdn_rnn.latent, self.config.mdn_rnn.memory);
        let n_components = self.config.mdn_rnn.components;
        let z = features.narrow(1, 0, n_latents);
        let (c, h) = (features.narrow(1, n_latents, m), features.narrow(1, n_latents + m, m));
        let gates = linear(&Tensor::cat(&[&z, actions], 1), &self.of_input) + linear(&h, &self.of_output);
        let gate = |i| gates.narrow(1, i * m, m);
        let c = gate(1).sigmoid() * c + gate(0).sigmoid() * gate(2).tanh();
        let h = gate(3).sigmoid() * c.tanh();
        let out = linear(&h, &self.head).unflatten(1, [n_latents, 3, n_components]);
        let part = |i| out.select(2, i);
        let weights = (part(0) / temperature).softmax(-1, Kind::Float);
        let z = match noise {
            None => (weights * part(1)).sum_dim_intlist(-1, false, Kind::Float),
            Some([uniform, normal]) => {
                let below = weights.cumsum(-1, Kind::Float).lt_tensor(&uniform.unsqueeze(-1));
                let component = below.sum_dim_intlist(-1, true, Kind::Int64).clamp_max(n_components - 1);
                let chosen = |i| part(i).gather(-1, &component, false).squeeze_dim(-1);
                chosen(1) + chosen(2).exp() * temperature.sqrt() * normal
            }
        };
        Tensor::cat(&[&z, &c, &h], 1)
    }
}

/// Height and width of what a world model sees.
fn size(config: &WorldModelConfig) -> [i64; 2] {
    [config.vae.height, config.vae.width]
}

/// The reward in `parameters`, of either kind.
fn reward(parameters: &Parameters) -> anyhow::Result<CModule> {
    let mut hazards = None;
    let (key, n_layers, relaid, rules, ranges) = match RewardNetworks::load(parameters)? {
        RewardNetworks::Preferences(reward) => {
            let ranges = reward.inputs().ranges.clone();
            hazards = reward.hazards().map(|hazards| hazards.for_inference(Kind::Float));
            ("reward", reward.config().layers, RewardEnsemble::relaid(parameters)?, None, ranges)
        }
        RewardNetworks::Verdicts(reward) => {
            let SparseConfig { layers, rules, .. } = *reward.config();
            let ranges = reward.inputs().ranges.clone();
            ("sparse_reward", layers, SparseReward::relaid(parameters)?, Some(rules), ranges)
        }
    };
    let layers = (0..=n_layers).map(|i| affine(&relaid, &format!("{key}.{i}")));
    let layers = layers.collect::<anyhow::Result<Vec<Affine>>>()?;
    // Before tracing begins: what is made while it lasts would be taken for a part of the function.
    let of_each =
        |number: fn([f32; 2]) -> f32| Tensor::from_slice(&ranges.iter().map(number).collect::<Vec<f32>>());
    let (low, range) = (of_each(|[low, _]| low), of_each(|[low, high]| high - low));
    let worths = Tensor::from_slice(&Verdict::ALL.map(Verdict::worth));
    let n_actions = ranges.n_axes() as i64;
    let inputs = [zeros(&[2, layers[0][0].size()[2] - n_actions]), zeros(&[2, n_actions])];
    traced(&inputs, |given| {
        let (features, actions) = (&given[0], &given[1]);
        let Some(rules) = rules else {
            let scaled = ((actions - &low) / &range * 2.0 - 1.0).clamp(-1.0, 1.0);
            let said = through(&layers, &Tensor::cat(&[features, &scaled], 1), Tensor::leaky_relu);
            let rewards = said.tanh().squeeze_dim(-1).mean_dim(0, false, Kind::Float);
            let rows = Tensor::cat(&[features, &scaled], 1);
            return match &hazards {
                None => rewards,
                Some(hazards) => rewards - hazards.costs(&rows),
            };
        };
        let logits = through(&layers, &Tensor::cat(&[features, actions], 1), Tensor::relu); // [E, B, 3]
        match rules {
            Rules::Joint => worths.index_select(0, &logits.mean_dim(0, false, Kind::Float).argmax(-1, false)),
            Rules::Apart => {
                let expected = logits.softmax(-1, Kind::Float) * &worths;
                expected.sum_dim_intlist(-1, false, Kind::Float).mean_dim(0, false, Kind::Float)
            }
        }
    })
}

/// What each member of an ensemble makes of the same rows: `[E, B, outputs]`.
fn through(layers: &[Affine], rows: &Tensor, activation: impl Fn(&Tensor) -> Tensor) -> Tensor {
    let mut x = rows.unsqueeze(0);
    for (i, [weight, bias]) in layers.iter().enumerate() {
        x = x.matmul(&weight.transpose(1, 2)) + bias.unsqueeze(1);
        x = if i + 1 < layers.len() { activation(&x) } else { x };
    }
    x
}
