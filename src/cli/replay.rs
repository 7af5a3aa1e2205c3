//! `dropj replay`.

use std::path::PathBuf;

use dropj::query::DreamId;
use dropj::run::{Kind, OutputFile};
use dropj::session::{CLIPS_FILE, replay};
use dropj::text::shown;

use super::models;
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
    println!(
        "{}: {} dreams, {} answers, {} skipped, {} clips decoded, {} fits",
        names(&replayed.session.protocols()),
        replayed.session.dreams().len(),
        statistics.n_answered,
        statistics.n_skipped,
        replayed.clips.len(),
        replayed.fits.len()
    );
    if let Some(torn) = &replayed.torn {
        println!("a half line at the end of the log was passed over: {}", shown(torn));
    }
    for dream in &replayed.lost {
        println!("dream {}, which was deleted, cannot be read any more", dream.0 + 1);
    }
    if options.record {
        replayed.record_clips()?;
    }
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
            println!("{} clips look as recorded", then.len());
        } else {
            println!("what clips look like was never recorded here: `--record` does");
        }
        for (i, fit) in replayed.fits.iter().enumerate() {
            let losses = replayed.refit(&model, fit)?;
            anyhow::ensure!(
                fit.agrees(&losses),
                "fit {i} came to the losses {:?} when it was recorded, and to {losses:?} now",
                fit.fitted.fit.losses
            );
            println!("fit {i}: {} labels, losses {losses:.4?}, as recorded", fit.n_labels());
        }
    }
    Ok(())
}
