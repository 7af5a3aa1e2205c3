//! `dropj replay`.

use std::fmt::Write as _;
use std::path::PathBuf;

use dropj::query::DreamId;
use dropj::run::{Kind, OutputFile};
use dropj::session::{CLIPS_FILE, replay};
use dropj::text::shown;

use super::meter::Meter;
use super::models;
use super::told::Form;
use super::words::names;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of the session
    session: PathBuf,
    /// Fail where clips look other than was recorded, or where a reward that is fitted again has other losses
    #[arg(long)]
    check: bool,
    /// Write into the session what its clips look like, for later checks
    #[arg(long)]
    record: bool,
    /// A world model other than the session's own
    #[arg(long)]
    world: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let model = models::of_session(&options.session, options.world.as_deref())?;
    if options.record {
        // Decoding every clip takes a while; that they can be written is known before.
        drop(OutputFile::at(&options.session.join(CLIPS_FILE), Kind::Notes)?);
    }
    let replayed = replay(&options.session, &model)?;
    let statistics = replayed.session.statistics();
    let mut words = format!(
        "{}: {} dreams, {} answers, {} skipped, {} clips decoded, {} fits\n",
        names(&replayed.session.protocols()),
        replayed.session.dreams().len(),
        statistics.n_answered,
        statistics.n_skipped,
        replayed.clips.len(),
        replayed.fits.len()
    );
    if let Some(torn) = &replayed.torn {
        writeln!(words, "a half line at the end of the log was passed over: {}", shown(torn))?;
    }
    for dream in &replayed.lost {
        writeln!(words, "dream {}, which was deleted, cannot be read any more", dream.0 + 1)?;
    }
    if options.record {
        replayed.record_clips()?;
    }
    let (mut n_clips, mut losses_now) = (None, Vec::new());
    if options.check {
        if let Some(then) = replayed.recorded_clips()? {
            let changed = replayed.changed_clips(&then);
            let name = |(dream, start): &(DreamId, usize)| format!("{}/{start}", dream.0);
            let (asked, others): (Vec<_>, Vec<_>) =
                changed.iter().partition(|clip| replayed.clips.contains_key(clip));
            anyhow::ensure!(
                asked.is_empty(),
                "these clips (dream/first step) look other than recorded: {}",
                asked.into_iter().map(name).collect::<Vec<_>>().join(", ")
            );
            anyhow::ensure!(
                others.is_empty(),
                "clips.json tells of clips (dream/first step) that nobody is asked about here, so it is of another session: \
                 {}; `dropj replay --record` writes it anew",
                others.into_iter().map(name).collect::<Vec<_>>().join(", ")
            );
            n_clips = Some(then.len());
            writeln!(words, "{} clips look as recorded", then.len())?;
        } else {
            words += "what clips look like was never recorded here: `--record` does\n";
        }
        let mut meter = Meter::new();
        for (i, fit) in replayed.fits.iter().enumerate() {
            meter.at("fitting again", i, replayed.fits.len(), String::new);
            let losses = replayed.refit(&model, fit)?;
            anyhow::ensure!(
                fit.agrees(&losses),
                "fit {i} came to the losses {:?} when it was recorded, and to {losses:?} now",
                fit.fitted.fit.losses
            );
            writeln!(words, "fit {i}: {} labels, losses {losses:.4?}, as recorded", fit.n_labels())?;
            losses_now.push(losses);
        }
    }
    let lost: Vec<u32> = replayed.lost.iter().map(|dream| dream.0).collect();
    let told = serde_json::json!({
        "protocols": replayed.session.protocols(), "dreams": replayed.session.dreams().len(),
        "answered": statistics.n_answered, "skipped": statistics.n_skipped, "clips": replayed.clips.len(),
        "fits": replayed.fits.len(), "lost_dreams": lost, "torn": replayed.torn, "checked": options.check,
        "clips_as_recorded": n_clips, "losses": losses_now
    });
    options.form.tell(&told, || words)
}
