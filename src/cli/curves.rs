//! The curves of what a session says and of what was learned from it, in event files of `TensorBoard` in its folder:
//!
//! ```text
//! curves/answers      shares of the answers, over their number
//! curves/fit-0000     the loss of each network over the epochs of that fit, and what it came to
//! ```

use std::path::Path;

use dropj::query::{Response, Verdict};
use dropj::reward::EpochReport;
use dropj::run::Run;
use dropj::session::Session;

/// A share is plotted at so many numbers of answers, at the most.
const MOST: usize = 200;

/// The points of a fit, in their order: a step, and names with values.
#[derive(Debug, Default)]
pub(crate) struct Curves(Vec<(u64, Vec<(String, f32)>)>);

impl Curves {
    /// Adds the losses of an epoch.
    pub(crate) fn epoch(&mut self, report: &EpochReport) {
        let n = report.losses.len();
        let mean = report.losses.iter().sum::<f64>() / n.max(1) as f64;
        let mut points = vec![("reward/loss".to_owned(), mean as f32)];
        if n > 1 {
            let of_each = report.losses.iter().enumerate();
            points.extend(of_each.map(|(i, loss)| (format!("reward/loss of network {i}"), *loss as f32)));
        }
        self.0.push((report.epoch as u64, points));
    }

    /// Adds what was measured once, at the end, on answers that were held out.
    pub(crate) fn held_out(&mut self, loss: f64, predicted: Option<f64>) {
        let last = self.0.last().map_or(0, |(step, _)| *step);
        let mut points = vec![("reward/held out".to_owned(), loss as f32)];
        points.extend(predicted.map(|share| ("reward/held out, predicted".to_owned(), share as f32)));
        self.0.push((last, points));
    }

    /// Writes these as the curves of the latest fit of the session in `dir`, and those of its answers.
    pub(crate) fn write(&self, dir: &Path, session: &Session) -> anyhow::Result<()> {
        let curves = dir.join("curves");
        let fit = session.fits().len().saturating_sub(1);
        plot(&curves.join(format!("fit-{fit:04}")), &self.0)?;
        plot(&curves.join("answers"), &answers(session))
    }
}

fn plot(dir: &Path, all: &[(u64, Vec<(String, f32)>)]) -> anyhow::Result<()> {
    let run = Run::open(dir, false)?;
    for (step, points) in all {
        let points: Vec<(&str, f32)> = points.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        run.plot(*step, &points)?;
    }
    Ok(())
}

/// Which share of so many first answers say what.
fn answers(session: &Session) -> Vec<(u64, Vec<(String, f32)>)> {
    let counted = session.queries().iter().filter(|asked| asked.repeats().is_none());
    let responses: Vec<Response> =
        counted.filter_map(|asked| Some(asked.answer()?.answer.response)).collect();
    let justifications = &session.weights().justifications;
    let is_unsafe = |response: &Response| match response {
        Response::Judged(verdict) => *verdict == Verdict::Unsafe,
        Response::Safety(_) => response.safety().is_some_and(|both| both != [true, true]),
        Response::Justified(active, _) => active.most_severe() != justifications.default(),
        Response::Preferred(_) | Response::Skipped(_) => false,
    };
    let n = responses.len();
    let step = n.div_ceil(MOST).max(1);
    let ends = (1..=n).filter(|end| end % step == 0 || *end == n);
    let points = ends.map(|end| {
        let first = &responses[..end];
        let share = |is: &dyn Fn(&Response) -> bool| {
            first.iter().filter(|response| is(response)).count() as f32 / end as f32
        };
        let mut points = vec![
            ("answers/skipped".to_owned(), share(&|response| matches!(response, Response::Skipped(_)))),
            ("answers/something unsafe".to_owned(), share(&is_unsafe)),
        ];
        if responses.iter().any(|response| matches!(response, Response::Justified(..))) {
            points.extend(justifications.iter().map(|(justification, name, _)| {
                let names = |response: &Response| {
                    matches!(response, Response::Justified(active, _) if active.contains(justification))
                };
                (format!("answers/because of {name}"), share(&names))
            }));
        }
        (end as u64, points)
    });
    points.collect()
}
