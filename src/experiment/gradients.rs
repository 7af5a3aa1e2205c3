//! How strongly answers about safety and about taste move a reward while it learns: the paper's Theorem 1, measured.
//!
//! The theorem says that labels further from ½ have larger gradients, so that a reward learns first, and better, what is
//! about safety. By the gap g of two returns the gradient is |p − μ|: at the beginning, where p = ½, it is w − ½ for a
//! weight w, and 0 once p = μ. By a member's parameters it is |p − μ| ‖∂g/∂θ‖, in which the clips have a part as well.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::charts::{Curve, Figure, FigureError, Lines, Place, Words, drawn};
use super::description::{Description, Fit};
use super::table::said;
use crate::evaluation::bootstrap;
use crate::query::{Justification, Preference, Response, SafetyAnswer};
use crate::reward::{EpochReport, GradientNorm, Trainer};

/// What an answer is about, and whether it prefers one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum About {
    /// One clip is better, because it is safe: μ is `w_s`, or 1 − `w_s`.
    Safety,
    /// One clip is better, for another reason: μ is `w_def`, or 1 − `w_def`.
    Default,
    /// Neither is safe, and neither better: μ = ½.
    SafetyEqual,
    /// Both are safe, and neither is better: μ = ½.
    DefaultEqual,
}

impl About {
    /// That of an answer, where `default` is the justification that is not about safety. Nothing of one that was not given.
    pub fn of(response: &Response, default: Justification) -> Option<Self> {
        let about = |is_safety: bool, is_equal: bool| match (is_safety, is_equal) {
            (true, false) => Self::Safety,
            (false, false) => Self::Default,
            (true, true) => Self::SafetyEqual,
            (false, true) => Self::DefaultEqual,
        };
        match response {
            Response::Safety(SafetyAnswer::OnlyLeft | SafetyAnswer::OnlyRight) => Some(Self::Safety),
            Response::Safety(SafetyAnswer::Neither) => Some(Self::SafetyEqual),
            Response::Safety(SafetyAnswer::Both(preference)) | Response::Preferred(preference) => {
                Some(about(false, *preference == Preference::Equal))
            }
            Response::Justified(active, preference) => {
                Some(about(active.most_severe() != default, *preference == Preference::Equal))
            }
            Response::Skipped(_) | Response::Judged(_) => None,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Safety => "better because safe",
            Self::Default => "better otherwise",
            Self::SafetyEqual => "neither safe",
            Self::DefaultEqual => "alike",
        }
    }
}

/// The gradients of the answers of one kind after an epoch of a fit, on average.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GradientRow {
    /// The number of its trial.
    pub trial: usize,
    /// The seed of the chain.
    pub seed: u64,
    /// What answers weigh, where that is not what the world's file says.
    pub weights: String,
    /// How the reward was fitted.
    pub fit: Fit,
    /// After so many epochs; 0 is before the first step.
    pub epoch: usize,
    /// What the answers are about.
    pub about: About,
    /// How many there are.
    pub n: usize,
    /// The mean of |p − μ|.
    pub logit: f64,
    /// The mean norm by all parameters of a member.
    pub parameters: f64,
}

/// Takes down gradients while a reward learns.
pub(super) struct Watch<'a> {
    /// What each answer is about, in the order in which the trainer has them.
    pub about: &'a [About],
    /// A row without its measures.
    pub like: GradientRow,
    pub rows: &'a mut Vec<GradientRow>,
}

impl Watch<'_> {
    /// Measures, and lets the fit go on.
    pub(super) fn look(&mut self, trainer: &Trainer, report: &EpochReport) -> ControlFlow<()> {
        let mut of: BTreeMap<About, Vec<GradientNorm>> = BTreeMap::new();
        for (about, norm) in self.about.iter().zip(trainer.gradients()) {
            of.entry(*about).or_default().push(norm);
        }
        for (about, norms) in of {
            let n = norms.len();
            let mean = |part: fn(&GradientNorm) -> f64| norms.iter().map(part).sum::<f64>() / n as f64;
            let (logit, parameters) = (mean(|norm| norm.logit), mean(|norm| norm.parameters));
            let epoch = report.epoch;
            self.rows.push(GradientRow { epoch, about, n, logit, parameters, ..self.like.clone() });
        }
        ControlFlow::Continue(())
    }
}

/// The rows as the columns of a table.
pub(super) fn columns(rows: &[GradientRow]) -> Vec<(String, Vec<String>)> {
    let column = |name: &str, of: &dyn Fn(&GradientRow) -> String| {
        (name.to_owned(), rows.iter().map(of).collect::<Vec<_>>())
    };
    vec![
        column("trial", &|row| row.trial.to_string()),
        column("seed", &|row| row.seed.to_string()),
        column("weights", &|row| row.weights.clone()),
        column("fit", &|row| said(&row.fit)),
        column("epoch", &|row| row.epoch.to_string()),
        column("about", &|row| said(&row.about)),
        column("n", &|row| row.n.to_string()),
        column("logit", &|row| row.logit.to_string()),
        column("parameters", &|row| row.parameters.to_string()),
    ]
}

/// Of one variant: for each epoch and kind of answer, a value of each seed that has one.
type Courses = BTreeMap<(About, usize), BTreeMap<u64, f64>>;

/// By weights and fit.
fn variants(rows: &[GradientRow], part: fn(&GradientRow) -> f64) -> Vec<(String, Fit, Courses)> {
    let mut all: Vec<(String, Fit, Courses)> = Vec::new();
    for row in rows {
        let is_it =
            |(weights, fit, _): &&mut (String, Fit, Courses)| *weights == row.weights && *fit == row.fit;
        let courses = if let Some((.., courses)) = all.iter_mut().find(is_it) {
            courses
        } else {
            all.push((row.weights.clone(), row.fit, Courses::new()));
            let Some((.., courses)) = all.last_mut() else { continue };
            courses
        };
        courses.entry((row.about, row.epoch)).or_default().insert(row.seed, part(row));
    }
    all
}

fn name_of(weights: &str, fit: Fit) -> String {
    let weights = if weights.is_empty() { "usual weights" } else { weights };
    format!("{weights}, fit: {}", said(&fit))
}

/// What a gradient is taken by: the end of the names of files, words, and its number in a row.
type By = (&'static str, &'static str, fn(&GradientRow) -> f64);
const BY: [By; 2] = [
    ("parameters", "norm of an answer's gradient by the parameters of a member", |row| row.parameters),
    ("logit", "an answer's gradient by the gap of returns, |p − μ|", |row| row.logit),
];

/// Curves over epochs, for each variant a figure by the parameters, and one by the gap of returns.
///
/// # Errors
/// Where one cannot be drawn.
pub(super) fn figures(rows: &[GradientRow]) -> Result<Vec<Figure>, FigureError> {
    let mut all = Vec::new();
    for (slug, y, part) in BY {
        for (i, (weights, fit, courses)) in variants(rows, part).into_iter().enumerate() {
            let mut curves: Vec<Curve> = Vec::new();
            for ((about, epoch), of_seeds) in courses {
                let of: Vec<f64> = of_seeds.into_values().collect();
                let rng = &mut ChaCha8Rng::seed_from_u64(epoch as u64);
                let Some(mean) = bootstrap(&of, rng) else { continue };
                if curves.last().is_none_or(|curve| curve.name != about.words()) {
                    let (number, name) = (curves.len(), about.words().to_owned());
                    curves.push(Curve { number, name, places: Vec::new() });
                }
                let place = Place { x: epoch as f64, mean, of: Vec::new() };
                curves.iter_mut().last().into_iter().for_each(|curve| curve.places.push(place.clone()));
            }
            let (caption, x) = (format!("Answers under {}", name_of(&weights, fit)), "epochs of the fit");
            let words = Words { caption, x: x.to_owned(), y: y.to_owned() };
            all.push(drawn(
                format!("gradients-{}-{slug}", i + 1),
                &Lines { words: &words, curves: &curves },
            )?);
        }
    }
    Ok(all)
}

/// Whether the theorem's inequality was seen, and where.
pub(super) fn words(description: &Description, rows: &[GradientRow]) -> String {
    let mut text = "\n## Gradients\n\n".to_owned();
    text.push_str(
        "The claim (Theorem 1): an answer that prefers a clip because it is safe has a larger gradient than one that prefers it \
         for another reason, as its label is further from ½. Means over the answers of each kind, in seeds that have both; in how many \
         of these the first is larger; and after how many epochs its mean over seeds is, the state before the first step among them.\n",
    );
    for (_, y, part) in BY {
        let _ = writeln!(text, "\nBy {y}:\n");
        text.push_str("| | before the first step: safe, otherwise | seeds | after the last epoch | seeds | larger after so many epochs |\n");
        text.push_str("|---|---:|---:|---:|---:|---|\n");
        for (weights, fit, courses) in variants(rows, part) {
            let _ = writeln!(text, "| {} | {} |", name_of(&weights, fit), compared(&courses));
        }
    }
    let n_few = description.seeds.len();
    let _ = writeln!(
        text,
        "\nThat holds at the beginning by arithmetic, where p = ½ and the weights differ, and says nothing of how a reward drives: \
         answers that weigh 1 are never met, those that weigh less are once p is their weight. {n_few} seeds; no test is made."
    );
    text
}

/// The cells of a variant: seeds that have answers of both kinds are compared, each with itself.
fn compared(courses: &Courses) -> String {
    let both = |epoch: usize| -> Vec<(f64, f64)> {
        let of = |about: About| courses.get(&(about, epoch));
        let (Some(safety), Some(other)) = (of(About::Safety), of(About::Default)) else { return Vec::new() };
        safety.iter().filter_map(|(seed, norm)| Some((*norm, *other.get(seed)?))).collect()
    };
    let last = courses.keys().map(|(_, epoch)| *epoch).max().unwrap_or(0);
    let n_seeds = both(0).len();
    // Fits of few answers have more epochs: those that all seeds have.
    let epochs: Vec<usize> =
        (0..=last).filter(|epoch| n_seeds > 0 && both(*epoch).len() == n_seeds).collect();
    let (Some(&first), Some(&last)) = (epochs.first(), epochs.last()) else {
        return "no seed has answers of both kinds | | | |".to_owned();
    };
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let means = |epoch: usize| {
        let (safety, other): (Vec<f64>, Vec<f64>) = both(epoch).into_iter().unzip();
        (mean(safety), mean(other))
    };
    let cell = |epoch: usize| {
        let (safety, other) = means(epoch);
        let n = both(epoch).iter().filter(|(safety, other)| safety > other).count();
        format!("{safety:.3}, {other:.3} | {n} of {n_seeds}")
    };
    let is_larger = |epoch: &&usize| {
        let (safety, other) = means(**epoch);
        safety > other
    };
    let n_larger = epochs.iter().filter(is_larger).count();
    let turn = epochs.iter().find(|epoch| !is_larger(epoch));
    let turn = turn.map_or(String::new(), |epoch| format!("; first not after {epoch}"));
    format!("{} | {} | {n_larger} of {}{turn}", cell(first), cell(last), epochs.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::named;
    use crate::query::{Active, Weights};

    fn row(seed: u64, epoch: usize, about: About, logit: f64) -> GradientRow {
        let (weights, fit, parameters) = (String::new(), Fit::Ours, 3.0 * logit);
        GradientRow { trial: 0, seed, weights, fit, epoch, about, n: 9, logit, parameters }
    }

    #[test]
    fn answers_are_told_apart_by_what_they_are_about() {
        let weights = Weights::paper();
        let default = weights.justifications.default();
        let of = |response| About::of(&response, default);
        assert_eq!(of(Response::Safety(SafetyAnswer::OnlyRight)), Some(About::Safety));
        assert_eq!(of(Response::Safety(SafetyAnswer::Neither)), Some(About::SafetyEqual));
        assert_eq!(of(Response::Safety(SafetyAnswer::Both(Preference::Left))), Some(About::Default));
        assert_eq!(of(Response::Preferred(Preference::Equal)), Some(About::DefaultEqual));
        assert_eq!(of(Response::Justified(Active::of(default), Preference::Left)), Some(About::Default));
        let named = weights.justifications.iter().next().map(|(justification, ..)| justification).unwrap();
        assert_eq!(of(Response::Justified(Active::of(named), Preference::Left)), Some(About::Safety));
        assert_eq!(of(Response::Skipped(None)), None);
    }

    #[test]
    fn it_is_said_where_the_claim_was_seen_and_where_not() {
        let mut rows = Vec::new();
        for seed in 0..3 {
            for (epoch, safety, default) in [(0, 0.5, 0.25), (1, 0.3, 0.2), (2, 0.1, 0.15)] {
                rows.push(row(seed, epoch, About::Safety, safety));
                rows.push(row(seed, epoch, About::Default, default));
            }
        }
        let text = words(&named("theorem").unwrap(), &rows);
        let line = text.lines().filter(|line| line.starts_with("| usual weights")).nth(1).unwrap();
        assert_eq!(
            line,
            "| usual weights, fit: ours | 0.500, 0.250 | 3 of 3 | 0.100, 0.150 | 0 of 3 | 2 of 3; first not after 2 |"
        );
        let drawn = figures(&rows).unwrap();
        let names: Vec<_> = drawn.iter().map(|figure| figure.name.as_str()).collect();
        assert_eq!(names, ["gradients-1-parameters", "gradients-1-logit"]);
        assert!(drawn[0].svg.contains("better because safe"));
        // A seed that has answers of one kind alone is compared with no other.
        rows.push(row(7, 0, About::Safety, 9.0));
        let said = |rows: &[GradientRow]| words(&named("theorem").unwrap(), rows);
        assert!(said(&rows).contains("| 0.500, 0.250 | 3 of 3 |"));
        rows.retain(|row| (row.about == About::Safety) == (row.seed == 0));
        assert!(said(&rows).contains("no seed has answers of both kinds"));
    }
}
