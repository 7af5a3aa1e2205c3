//! `dropj serve`: several people label in browsers.

use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use dropj::query::Strategy;
use dropj::serve::{Patience, Rates, ServeConfig, Server, Standing};
use dropj::text::shown;
use serde_json::json;

use super::choices::StrategyName;
use super::models;
use super::numbers::{count, name};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose queries are offered; it stays as it is
    #[arg(long)]
    session: PathBuf,
    /// Who answers; each gets a link and a session of their own
    #[arg(long, value_name = "NAMES", value_parser = name, value_delimiter = ',', required = true)]
    annotators: Vec<String>,
    /// How many queries there are to be; those that are missing are drawn into the session first
    #[arg(long, value_parser = count(1..=1_000_000))]
    queries: Option<usize>,
    /// How those are drawn
    #[arg(long, value_enum, default_value = "uniform", requires = "queries")]
    choice: StrategyName,
    /// The folder for the annotators' sessions [default: beside the session]
    #[arg(long)]
    out: Option<PathBuf>,
    /// The file of the annotators' tokens, made or added to where they have none [default: annotators.toml in the session]
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// The address that is listened at: 127.0.0.1 serves this machine alone, 0.0.0.0 whoever reaches it
    #[arg(long, default_value = "127.0.0.1")]
    address: IpAddr,
    /// The port, or 0 for any that is free [default: that of last time, so that links stay]
    #[arg(long)]
    port: Option<u16>,
    /// A world model other than the session's
    #[arg(long)]
    world: Option<PathBuf>,
    /// Print a JSON object for each annotator, and again when it ends
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let strategy = Strategy::from(options.choice);
    anyhow::ensure!(
        strategy != Strategy::Disagreement,
        "nothing is learned while queries are drawn here, so nothing disagrees: choose another --choice"
    );
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let server = Server::open(
        &ServeConfig {
            session: options.session.clone(),
            out: options.out.clone(),
            annotators: options.annotators.clone(),
            n_queries: options.queries,
            strategy,
            tokens: options.tokens.clone(),
            address: options.address,
            port: options.port,
            patience: Patience::default(),
            rates: Rates::default(),
        },
        &model,
    )?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("cannot be ended in good order")?;
    }
    tell(&server, options)?;
    server.run(&stop)?;
    let standings = server.standings();
    drop(server);
    for standing in &standings {
        let Standing { annotator, session, n_done, n_all, .. } = standing;
        if options.json {
            println!("{}", json!({"ended": annotator, "session": session, "done": n_done, "all": n_all}));
        } else {
            println!("{}: {n_done} of {n_all} queries: {session:?}", shown(annotator));
        }
    }
    if !options.json && standings.len() > 1 {
        let sessions: Vec<_> = standings.iter().map(|standing| format!("{:?}", standing.session)).collect();
        println!("how far they agree: dropj agree {}", sessions.join(" "));
        println!("to learn from all: dropj merge {} --out merged", sessions.join(" "));
    }
    Ok(())
}

/// Says who can answer what, and where.
fn tell(server: &Server, options: &Options) -> anyhow::Result<()> {
    use std::io::Write as _;

    let standings = server.standings();
    for Standing { annotator, link, session, n_done, n_all } in &standings {
        if options.json {
            let told = json!({
                "annotator": annotator, "link": link, "session": session, "done": n_done, "all": n_all
            });
            println!("{told}");
        } else {
            println!(
                "{}: {link}\n  {n_done} of {n_all} queries are answered, in {session:?}",
                shown(annotator)
            );
        }
    }
    if server.n_drawn() > 0 {
        eprintln!("{} queries were drawn into {:?}", server.n_drawn(), options.session);
    }
    if server.at().ip().is_loopback() {
        eprintln!("these links work on this machine alone; --address 0.0.0.0 offers them on its networks");
    } else {
        eprintln!(
            "whoever has a link answers in that name, and what is sent is not encrypted: use a network that you trust, or \
             127.0.0.1 through ssh -L {port}:127.0.0.1:{port}",
            port = server.at().port()
        );
    }
    eprintln!("clips play at {} frames a second; Ctrl-C ends", server.rate());
    Ok(std::io::stdout().flush()?)
}
