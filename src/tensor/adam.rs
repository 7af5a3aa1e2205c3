//! The Adam optimizer, with a state that can be saved, so that a fit resumes where it was stopped.
//!
//! There are two, because [`Adam`] rounds otherwise than [`pytorch_adam`], whose moments no checkpoint can reach: rewards
//! are learned with the latter, and learned again they must be the same to the last bit.
//!
//! On an accelerator [`Adam`] keeps all variables of a store in one tensor, so that a step is a handful of passes over it:
//! libtorch's own fused one is not among what tch binds.

use tch::nn::{self, OptimizerConfig as _};
use tch::{Device, Kind, Tensor};

/// β₁, β₂ and ε of PyTorch's defaults.
const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Entries that are moved at a time: four arrays of so many stay near the processor, and a step is all memory traffic.
const BLOCK: i64 = 1 << 16;

/// PyTorch's own Adam over every variable of `store`, with its β = 0.9, 0.999 and ε = 1e-8.
pub fn pytorch_adam(store: &nn::VarStore, learning_rate: f64) -> nn::Optimizer {
    let adam = nn::Adam::default().build(store, learning_rate);
    adam.unwrap_or_else(|e| unreachable!("plain numbers make an optimizer: {e}"))
}

/// Adam over every variable of a store.
#[derive(Debug)]
pub struct Adam {
    slots: Vec<Slot>,
    /// On accelerators.
    whole: Option<Whole>,
    n_steps: i64,
}

#[derive(Debug)]
struct Slot {
    name: String,
    variable: Tensor,
    /// Decaying sums of the gradient and of its square.
    moments: [Tensor; 2],
}

/// All variables, and all moments, one after the other. Those of the slots are parts of them.
#[derive(Debug)]
struct Whole {
    values: Tensor,
    moments: [Tensor; 2],
}

impl Adam {
    /// An optimizer that has seen no gradient.
    pub fn new(store: &nn::VarStore) -> Self {
        let mut slots: Vec<_> = store
            .variables()
            .into_iter()
            .map(|(name, variable)| {
                let moment = || variable.detach().zeros_like();
                Slot { name, moments: [moment(), moment()], variable }
            })
            .collect();
        slots.sort_by(|a, b| a.name.cmp(&b.name));
        let whole = (store.device() != Device::Cpu && !slots.is_empty()).then(|| Whole::of(&mut slots));
        Self { slots, whole, n_steps: 0 }
    }

    /// Follows the gradient of `loss` by one step, each of its entries first clipped to `±clip` if that is given.
    pub fn step(&mut self, loss: &Tensor, learning_rate: f64, clip: Option<f64>) {
        let gradient = self.whole.is_some().then(|| self.gradient(loss));
        if gradient.is_none() {
            loss.backward();
        }
        self.n_steps += 1;
        let unbias = |beta: f64| 1.0 - beta.powi(self.n_steps as i32);
        // The moments are kept without their factor 1 − β, which joins the two numbers below instead:
        // variable += mean / (slope · √square + offset) is then PyTorch's step in the fewest passes over memory.
        let rate = learning_rate * (1.0 - BETA_1) / unbias(BETA_1);
        let slope = -((1.0 - BETA_2) / unbias(BETA_2)).sqrt() / rate;
        let offset = -EPSILON / rate;
        if let (Some(whole), Some(gradient)) = (&mut self.whole, gradient) {
            tch::no_grad(|| {
                let gradient = if let Some(clip) = clip { gradient.clamp(-clip, clip) } else { gradient };
                let [mean, square] = &mut whole.moments;
                let _ = mean.g_mul_scalar_(BETA_1).g_add_(&gradient);
                let _ = square.g_mul_scalar_(BETA_2).addcmul_(&gradient, &gradient);
                let scale = square.sqrt().g_mul_scalar_(slope).g_add_scalar_(offset);
                let _ = whole.values.addcdiv_(mean, &scale);
            });
            return;
        }
        tch::no_grad(|| {
            for Slot { variable, moments: [mean, square], .. } in &mut self.slots {
                let all = [variable.detach(), variable.grad(), mean.shallow_clone(), square.shallow_clone()];
                let all = all.map(|tensor| tensor.view(-1));
                let n = all[0].size()[0];
                for start in (0..n).step_by(BLOCK as usize) {
                    let block = |i: usize| all[i].narrow(0, start, BLOCK.min(n - start));
                    let (mut variable, mut gradient, mut mean, mut square) =
                        (block(0), block(1), block(2), block(3));
                    if let Some(clip) = clip {
                        gradient = gradient.clamp_(-clip, clip);
                    }
                    mean = mean.g_mul_scalar_(BETA_1).g_add_(&gradient);
                    square = square.g_mul_scalar_(BETA_2).addcmul_(&gradient, &gradient);
                    let scale = square.sqrt().g_mul_scalar_(slope).g_add_scalar_(offset);
                    let _ = variable.addcdiv_(&mean, &scale);
                    let _ = gradient.zero_();
                }
            }
        });
    }

    /// The gradient of `loss` by all variables, one after the other. None of it stays in the variables.
    fn gradient(&self, loss: &Tensor) -> Tensor {
        let variables: Vec<_> = self.slots.iter().map(|slot| &slot.variable).collect();
        let gradients = Tensor::run_backward(&[loss], &variables, false, false);
        let flat: Vec<_> = gradients.iter().map(|gradient| gradient.reshape([-1])).collect();
        Tensor::cat(&flat, 0)
    }

    /// The moments and the count of steps, by name, for a checkpoint.
    pub fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = vec![("n_steps".to_owned(), Tensor::from_slice(&[self.n_steps as f32]))];
        for slot in &self.slots {
            for (i, moment) in slot.moments.iter().enumerate() {
                state.push((format!("{}.{i}", slot.name), moment.shallow_clone()));
            }
        }
        state
    }

    /// The variables' moments, to be overwritten by a checkpoint's.
    pub fn restore(&mut self, mut saved: impl FnMut(&str) -> Option<Tensor>) -> Option<()> {
        let n_steps = saved("n_steps").filter(|n_steps| n_steps.size() == [1])?.double_value(&[0]);
        self.n_steps = (0.0..=f64::from(i32::MAX - 1)).contains(&n_steps).then_some(n_steps as i64)?;
        for slot in &mut self.slots {
            for (i, moment) in slot.moments.iter_mut().enumerate() {
                let values = saved(&format!("{}.{i}", slot.name)).filter(|v| v.size() == moment.size())?;
                moment.copy_(&values.to_kind(Kind::Float));
            }
        }
        Some(())
    }
}

impl Whole {
    /// Has the variables and moments of `slots` lie in three tensors, whose parts they then are.
    fn of(slots: &mut [Slot]) -> Self {
        let together = |parts: Vec<Tensor>| Tensor::cat(&parts, 0);
        let flat = |tensor: &Tensor| tensor.detach().reshape([-1]);
        let values = together(slots.iter().map(|slot| flat(&slot.variable)).collect());
        let moments = [0, 1].map(|i| together(slots.iter().map(|slot| flat(&slot.moments[i])).collect()));
        let mut start = 0;
        for Slot { variable, moments: parts, .. } in slots {
            let (n, shape) = (variable.numel() as i64, variable.size());
            let part = |whole: &Tensor| whole.narrow(0, start, n).view(shape.as_slice());
            tch::no_grad(|| variable.set_data(&part(&values)));
            *parts = moments.each_ref().map(part);
            start += n;
        }
        Self { values, moments }
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::tensor::to_vec;

    /// ```python
    /// p = torch.tensor([1., -2.], requires_grad=True); o = torch.optim.Adam([p], lr=0.1)
    /// for _ in range(3): o.zero_grad(); (p ** 2 * torch.tensor([1., 3.])).sum().backward(); o.step()
    /// ```
    #[test]
    fn three_steps_are_pytorchs() {
        let store = nn::VarStore::new(Device::Cpu);
        let p = store.root().var_copy("p", &Tensor::from_slice(&[1.0f32, -2.0]));
        let mut adam = Adam::new(&store);
        for _ in 0..3 {
            let loss = (p.square() * Tensor::from_slice(&[1.0f32, 3.0])).sum(Kind::Float);
            adam.step(&loss, 0.1, None);
        }
        let found = to_vec(&p);
        for (found, wanted) in found.iter().zip([0.701_631_9, -1.700_651_2]) {
            assert!((found - wanted).abs() < 2e-4, "{found} is not {wanted}");
        }
    }

    #[test]
    fn all_variables_at_once_are_moved_as_one_by_one() {
        let network = || {
            let store = nn::VarStore::new(Device::Cpu);
            let p = store.root().var_copy("p", &Tensor::from_slice(&[1.0f32, -2.0, 0.5, 3.0]).view([2, 2]));
            let q = store.root().var_copy("q", &Tensor::from_slice(&[0.3f32]));
            (store, p, q)
        };
        let step = |p: &Tensor, q: &Tensor, adam: &mut Adam| {
            adam.step(&(p.square() * q).sum(Kind::Float), 0.1, Some(2.0));
        };
        let ((one, p, q), (other, r, s)) = (network(), network());
        let (mut by_one, mut at_once) = (Adam::new(&one), Adam::new(&other));
        at_once.whole = Some(Whole::of(&mut at_once.slots));
        for _ in 0..3 {
            step(&p, &q, &mut by_one);
            step(&r, &s, &mut at_once);
        }
        assert_eq!([to_vec(&p), to_vec(&q)], [to_vec(&r), to_vec(&s)]);
        let values = |adam: &Adam| adam.state().iter().map(|(_, tensor)| to_vec(tensor)).collect::<Vec<_>>();
        assert_eq!(values(&by_one), values(&at_once));
        let saved: Vec<_> = by_one.state().into_iter().map(|(name, tensor)| (name, tensor.copy())).collect();
        let (third, t, u) = network();
        let mut restored = Adam::new(&third);
        restored.whole = Some(Whole::of(&mut restored.slots));
        tch::no_grad(|| [t.shallow_clone().copy_(&p), u.shallow_clone().copy_(&q)]);
        restored
            .restore(|name| saved.iter().find(|(n, _)| n == name).map(|(_, t)| t.shallow_clone()))
            .unwrap();
        step(&p, &q, &mut by_one);
        step(&t, &u, &mut restored);
        assert_eq!([to_vec(&p), to_vec(&q)], [to_vec(&t), to_vec(&u)]);
    }

    #[test]
    fn a_restored_optimizer_goes_on_as_if_it_had_not_stopped() {
        let start = || {
            let store = nn::VarStore::new(Device::Cpu);
            let p = store.root().var_copy("p", &Tensor::from_slice(&[1.0f32, -2.0]));
            (store, p)
        };
        let step = |p: &Tensor, adam: &mut Adam| adam.step(&p.square().sum(Kind::Float), 0.1, Some(1.0));
        let (store, p) = start();
        let mut adam = Adam::new(&store);
        step(&p, &mut adam);
        let (saved, at) = (adam.state(), p.detach().copy());
        let saved: Vec<_> = saved.into_iter().map(|(name, tensor)| (name, tensor.copy())).collect();
        step(&p, &mut adam);

        let (store, mut q) = start();
        tch::no_grad(|| q.copy_(&at));
        let mut adam = Adam::new(&store);
        let find = |name: &str| saved.iter().find(|(n, _)| n == name).map(|(_, t)| t.shallow_clone());
        adam.restore(find).unwrap();
        step(&q, &mut adam);
        assert_eq!(to_vec(&p), to_vec(&q));
    }
}
