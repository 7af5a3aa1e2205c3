//! Learning a safe reward from a person who drives in a dream and says what they prefer, and why.
//!
//! # The four steps of DROPJ
//!
//! 1. [`world_model`] learns to observe, imagine and decode what a [`world`] shows.
//! 2. In a [`dream`] the user drives inside that model.
//! 3. A [`query`] shows two segments of dreams. Answers become labels, and labels a [`reward`].
//! 4. A [`planner`] acts in the real world by imagining ahead, and [`evaluation`] says how well.
//!
//! A [`session`] remembers all of it, a [`worker`] does each slow part, [`app`] decides what happens next, and [`ui`]
//! shows it; `cli`, a part of the program and not of this library, runs it with or without a window.
//! Data flows down this page: a module names only those before it (`tests/layering.rs`).
//!
//! Five ways to read it:
//!
//! - **An answer**: a key (`ui::label`) becomes an [`app::LabelCommand`], an event in the session's log
//!   ([`worker::SessionWriter`]), a [`query::Label`], a gradient ([`worker::trainer`], [`reward::fit`]), and a plan
//!   ([`worker::driver`], [`planner`]).
//! - **An action**: a stick (`ui::input`) becomes a [`world::Action`], a step of the dream ([`worker::dreamer`],
//!   [`world_model`]), and a picture.
//! - **A world of someone else's**: `world.toml` ([`world::WorldSpec`]) says what recordings have ([`dataset`]), which networks
//!   see them ([`world_model`]), what can be done ([`planner`]), and which process acts in the end ([`world::ProcessWorld`]).
//! - **An episode**: driven by the planner ([`worker::driver`]) or read from results ([`experiment::opened`]), it stands in a run
//!   beside others ([`app::evaluate`]), is told apart from them or not ([`experiment::comparison`]), and is drawn
//!   (`ui::evaluate`).
//! - **A setting**: a flag or a line of TOML (`cli`) becomes a configuration, and with it a fit ([`world_model::fit`]).
//!
//! # Modules
//!
//! | module | owns | invariant |
//! |---|---|---|
//! | [`text`] | names and cells of tables shown safely, paths told apart, encodings | text of others is never taken for ours |
//! | [`world`] | what a world is: its file, the trait, a world in a process, and the built-in cars in a room of their own | knows no tensor; names, counts and ranges come from the file; a seed and the actions decide everything; every wait ends |
//! | [`tensor`] | rank checks, initialization, conversions, devices | the only place that copies between Rust memory and torch |
//! | [`run`] | outputs: files written whole, files that grow, folders, the folder of a long job | a file is as before or as wanted, never in between; what is not ours stays |
//! | [`dataset`] | real episodes on disk: journal, sealed files, streaming reads | memory stays flat however many episodes |
//! | [`world_model`] | VAE, MDN-RNN, their fitting | knows no window or clock; the only place that knows the order `[z \| c \| h]` |
//! | [`query`] | segments and transitions, what can be asked and answered, how pairs are chosen, labels | plain data: no tensor |
//! | [`dream`] | stepping the model as a world, signs that it has left the world | holds no randomness of its own: noise comes from the caller |
//! | [`reward`] | the ensemble of preferences, the classifier of verdicts, their fitting | never sees a frame: features and actions only |
//! | [`planner`] | candidates, imagined returns, the choice; trajectories worth asking about | a pure function of state, models and generator |
//! | [`simulate`] | stand-ins for people: recording, probe, player, annotator | once it labels it sees frames, never the world |
//! | [`evaluation`] | episodes in the real world, metrics, agreement of people | takes a policy, returns numbers; same tracks for every method |
//! | [`clip`] | what was seen as a GIF: pictures beside each other, framed | pictures and answers in, bytes out; marks differ by shape and color |
//! | [`session`] | events, their log, replay, merging; arrays and weights on disk | with [`dataset`] and [`run`] the only modules that touch files; a session *is* its log |
//! | [`experiment`] | grids of trials, their results, what these and other runs come to side by side, Slurm | a trial is a pure function of its description; a folder goes on where it was left |
//! | [`drqv2`] | DrQ-v2, the paper's upper bound: its networks, replay buffer and schedule | learns in the real world by its true reward, and counts what that costs; shares nothing with the method |
//! | [`worker`] | threads | the only module that starts one; a worker owns its models and shares nothing |
//! | [`app`] | the application without a window: state, commands, what follows from reports | no egui, file, thread or clock: all comes in as an argument and leaves as an effect |
//! | [`serve`] | the label room for browsers: who may enter, what is asked, what was acknowledged | an answer is acknowledged once it is on disk; without a token nothing is told |
//! | [`ui`] | egui, input devices, pictures | decides nothing: draws state, returns commands |
//! | `cli` | the command line, in `main.rs` | every step without a window; one error in one sentence |
//!
//! # Shapes
//!
//! | letter | axis | in Car Racing |
//! |---|---|---|
//! | B, T | batch, time | |
//! | Z | latent | 32 |
//! | M | memory: c, and as many h | 256 |
//! | K | mixture components per latent coordinate | 5 |
//! | A | action: a number for each axis of the world | 3 |
//! | E, S, H | ensemble, candidates, horizon | 3, 15, 25 |
//! | P | rows and columns of pixels | 84 |
//!
//! # References
//!
//! - **DROPJ**: Kazantzidis, Norman, Freeman, Du. *Safe Reward Learning from Human Preferences and
//!   Justifications.* ICAART 2026. "Method §n" in these pages is our restatement of it, with its slips put right.
//! - **World Models**: Ha, Schmidhuber. 2018.
//! - **ReQueST**: Reddy et al. *Learning human objectives by evaluating hypothetical behavior.* ICML 2020.
//! - **Multiple-instance learning**: Maron, Lozano-Pérez. *A framework for multiple-instance learning.* NeurIPS 1997.
//! - **PEBBLE**: Lee et al. ICML 2021. · **B-Pref**: Lee et al. NeurIPS 2021.

pub mod text;
pub mod world;
pub mod tensor;
pub mod run;
pub mod dataset;
pub mod world_model;
pub mod query;
pub mod dream;
pub mod reward;
pub mod planner;
pub mod simulate;
pub mod evaluation;
pub mod clip;
pub mod session;
pub mod experiment;
pub mod drqv2;
pub mod worker;
pub mod app;
pub mod serve;
pub mod ui;
