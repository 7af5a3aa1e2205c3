//! Fitting the probe of a built-in car: its simulator is driven, and tells what the pictures show.

use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use tch::Device;

use super::{
    Example, FitProbeConfig, Group, GroupKind, Lesson, PAINTED, Painter, Phase, ProbeFit, Progress, Targets,
    auc, learn,
};
use crate::simulate::probe::Probe;
use crate::tensor::NotFinite;
use crate::world::cars::player::{Moment, drive};
use crate::world::cars::sight::{CONTACTS, N_MEASURED, ProbeErrors};
use crate::world::cars::{Env, Sight};
use crate::world_model::WorldModel;

/// Fits a probe on episodes of `env`. Where `report` breaks off, on what has been seen until then.
///
/// It ends at the first loss that is no number.
pub fn fit_car_probe(
    config: &FitProbeConfig,
    env: &mut dyn Env,
    model: Option<&WorldModel>,
    report: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<ProbeFit<ProbeErrors>, NotFinite> {
    let mut tell = |phase, done, n, loss| report(&Progress { phase, done, n, loss });
    let n = config.n_episodes + config.n_held_out;
    let (mut seen, mut held_out) = (Vec::new(), Vec::new());
    for i in 0..n {
        // The held-out episodes come first, so that they are there when the fit is broken off.
        let into = if i < config.n_held_out { &mut held_out } else { &mut seen };
        into.extend(drive(env, i as u64, config.seed, config.stride).into_iter().map(Example::from));
        if tell(Phase::Drive, i + 1, n, 0.0).is_break() {
            break;
        }
    }
    let mut painted = Vec::new();
    if let Some(model) = model {
        let painter = Painter::new(model);
        let rng = &mut ChaCha8Rng::seed_from_u64(config.seed);
        seen.shuffle(rng);
        let n = (config.painted * seen.len() as f64) as usize;
        painted = painter.paint(&held_out, rng);
        let mut all = Vec::new();
        for some in seen[..n].chunks(PAINTED) {
            all.extend(painter.paint(some, rng));
            if tell(Phase::Paint, all.len(), n, 0.0).is_break() {
                break;
            }
        }
        seen.extend(all);
    }
    let lesson = Road { has_contacts: config.probe.n_outputs() > CONTACTS };
    let on_update = &mut |done, loss| tell(Phase::Learn, done, config.n_updates, loss);
    let device = model.map_or(Device::Cpu, |model| model.backend().device);
    let store = learn(config, &lesson, &seen, device, on_update)?;
    let unmeasured = Probe::parameters_of(&config.probe, &store, None, String::new());
    let probe = Probe::load(&unmeasured).unwrap_or_else(|e| unreachable!("just made: {e}"));
    let real = errors(&probe, &held_out);
    let painted = (!painted.is_empty()).then(|| errors(&probe, &painted));
    let told = serde_json::json!({ "real": real, "painted": painted, "fit": config }).to_string();
    Ok(ProbeFit { parameters: Probe::parameters_of(&config.probe, &store, None, told), real, painted })
}

impl From<Moment> for Example<Sight> {
    fn from(Moment { earlier, now, shown }: Moment) -> Self {
        Self { earlier, now, shown }
    }
}

/// Where a car is on its road, and what it touches.
struct Road {
    has_contacts: bool,
}

impl Lesson<Sight> for Road {
    fn groups(&self) -> Vec<Group> {
        let group = |from, n, kind, weight| Group { from, n, kind, weight };
        let mut groups = vec![
            group(0, 2, GroupKind::Chances(None), 1.0),
            group(2, N_MEASURED, GroupKind::Values(0.1), 4.0),
        ];
        // A touch is rare and short, and what an annotator is asked about.
        groups.extend(self.has_contacts.then(|| group(CONTACTS, 2, GroupKind::Chances(None), 4.0)));
        groups
    }

    fn targets(&self, shown: &Sight, is_mirrored: bool, is_still: bool) -> Targets {
        let seen = if is_mirrored { shown.mirrored() } else { *shown };
        let told = shown.told(is_still).map(|counts| if counts { 1.0f32 } else { 0.0 });
        Targets {
            values: [&[seen.off_road, seen.all_off][..], &seen.targets(), &[seen.chuckhole, seen.car]]
                .concat(),
            counts: [&[1.0, 1.0][..], &told, &[1.0, 1.0]].concat(),
        }
    }

    fn has_mirror_images(&self) -> bool {
        true
    }
}

/// How wrong `probe` is on `examples`.
fn errors(probe: &Probe, examples: &[Example<Sight>]) -> ProbeErrors {
    let (earlier, now): (Vec<_>, Vec<_>) =
        examples.iter().map(|example| (example.earlier.clone(), example.now.clone())).unzip();
    let seen = probe.sights(&earlier, &now);
    let pairs: Vec<_> = examples.iter().map(|example| example.shown).zip(seen).collect();
    ProbeErrors::of(&pairs, auc)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::player::{DreamPlayer, Knowledge, Manner};
    use crate::simulate::probe::ProbeConfig;
    use crate::world::cars::sight::GAP;
    use crate::world::cars::{CarAction, CarRacing, Seed};
    use crate::world::{Frame, WorldSpec};

    /// A grey road 8 pixels wide on green. The lateral offset is that of its middle from the picture's.
    fn toy(shift: i32) -> Example<Sight> {
        let mut rgb = Vec::new();
        for _ in 0..20 {
            for x in 0..20 {
                let is_road = (x - 10 + shift).abs() < 4;
                rgb.extend(if is_road { [100, 100, 100] } else { [100, 200, 100] });
            }
        }
        let frame = Frame::square(20, rgb);
        let off_road = if shift.abs() > 3 { 1.0 } else { 0.0 };
        let shown = Sight { off_road, lateral: shift as f32, ..Sight::default() };
        Example { earlier: frame.clone(), now: frame, shown }
    }

    #[test]
    fn a_probe_learns_where_a_toy_road_is() {
        let examples: Vec<_> = (-7..=7).map(toy).collect();
        let config = FitProbeConfig {
            probe: ProbeConfig::tiny(),
            n_updates: 400,
            batch: 15,
            learning_rate: 5e-3,
            ..FitProbeConfig::for_world(&WorldSpec::default())
        };

        let lesson = Road { has_contacts: false };
        let store =
            learn(&config, &lesson, &examples, Device::Cpu, &mut |_, _| ControlFlow::Continue(())).unwrap();

        let probe = Probe::load(&Probe::parameters_of(&config.probe, &store, None, String::new())).unwrap();
        let errors = errors(&probe, &examples);
        assert!(errors.off_road_accuracy > 0.9 && errors.lateral < 0.8, "{errors:?}");
    }

    /// Half an hour of one core: `cargo test --lib -- --ignored --nocapture a_probe_sees_well_enough_to_drive`.
    /// `FIT_PROBE` may hold another configuration as JSON.
    #[test]
    #[ignore = "fits a whole probe, which takes half an hour: for whoever changes the probe or its pilot"]
    #[expect(clippy::print_stderr, reason = "its figures are of interest")]
    fn a_probe_sees_well_enough_to_drive() {
        let config = std::env::var("FIT_PROBE").map_or_else(
            |_| FitProbeConfig::for_world(&WorldSpec::default()),
            |text| serde_json::from_str(&text).unwrap(),
        );
        let begun = std::time::Instant::now();
        let fit = fit_car_probe(&config, &mut CarRacing::new(Seed::Native(0)), None, &mut |progress| {
            if progress.done % 500 == 0 {
                eprintln!("{:.0} s {progress:?}", begun.elapsed().as_secs_f64());
            }
            ControlFlow::Continue(())
        });
        let fit = fit.unwrap();
        eprintln!("{:#?}", fit.real);
        let probe = Probe::load(&fit.parameters).unwrap();
        let (mut n_off, mut n_clips, mut n_unsafe, mut n_steps, mut n_tiles) = (0, 0, 0, 0, 0);
        for seed in 0..8 {
            let mut env = CarRacing::new(Seed::Native(seed));
            let mut player = DreamPlayer::new(&Knowledge::Car, Manner::Exploring, seed);
            let mut frames = vec![env.frame()];
            let mut offs = Vec::new();
            loop {
                if frames.len() % 2 == 1 {
                    let now = frames.len() - 1;
                    player.see(probe.sights(&frames[now.saturating_sub(GAP)..][..1], &frames[now..])[0]);
                }
                let outcome = env.advance(CarAction::from(&*player.act(&[])));
                frames.push(env.frame());
                offs.push(env.truth().wheels_off > 0);
                if outcome.end.is_some() {
                    break;
                }
            }
            n_tiles += env.n_visited();
            n_steps += offs.len();
            n_off += offs.iter().filter(|off| **off).count();
            n_clips += offs.chunks_exact(20).count();
            n_unsafe +=
                offs.chunks_exact(20).filter(|clip| clip.iter().filter(|off| **off).count() > 1).count();
        }
        let off_road = f64::from(n_off as u32) / n_steps as f64;
        eprintln!(
            "off the road {off_road:.3}, unsafe clips {:.3}, {} tiles",
            n_unsafe as f64 / n_clips as f64,
            n_tiles / 8
        );
        assert!(fit.real.off_road_accuracy > 0.97 && fit.real.lateral < 0.6 && fit.real.along < 3.0);
        assert!((0.2..0.5).contains(&off_road), "{off_road} of the time off the road");
    }
}
