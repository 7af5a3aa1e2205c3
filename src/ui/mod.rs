//! The window: draws the state, hears keys and pads, and returns commands.
//!
//! Panels are functions of the state that push [`Command`]s; the app carries them out after the frame, and
//! `App::record` is the only place where the session changes. Nothing here touches a file or starts a thread.

mod act;
mod answer;
mod beside;
mod choosing;
mod command;
mod crew;
mod dialog;
mod elsewhere;
mod display;
mod errands;
mod foretelling;
mod hear;
mod input;
mod keys;
mod labeling;
mod opening;
mod pace;
mod pads;
mod panels;
mod playhead;
mod preferences;
mod pressing;
mod recent;
mod rebind;
mod review;
mod router;
mod seen;
mod sessions;
mod shelf;
mod state;
mod thumbnails;
mod toasts;
mod tokens;
mod trajectories;
mod widgets;
mod written;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use eframe::egui::{self, Context, ViewportBuilder};
use eframe::{CreationContext, wgpu};

use crate::query::QueryId;
use crate::session::{LoadedSession, SessionStore};
use crate::tensor::Parameters;
use crate::worker::{Job, Report, Reports};

pub use choosing::Asking;
pub use command::{Command, Field, Panel};
pub use crew::{Crew, Order, Plans, Slots, Threads};
pub use dialog::Purpose;
pub use elsewhere::Elsewhere;
pub use input::{Gilrs, InputSource, NoPads, PadButton, PadEvent, system_pads};
pub use keys::{Deed, Keys};
pub use pace::Budget;
pub use preferences::{Preferences, Problem, SettingsFile, settings_file};
pub use state::{DreamStart, LoadedWorld};

use dialog::Dialog;
use elsewhere::Watching;
use errands::Errand;
use hear::Focus;
use input::Hands;
use opening::{Opening, Reading};
use preferences::Leftover;
use recent::Looking;
use seen::{Picture, Typing};
use state::{State, World};

/// Makes a world model out of a file, or says in a sentence why it cannot.
pub type Load = Arc<dyn Fn(&Path) -> Result<LoadedWorld, String> + Send + Sync>;

/// Starts the workers, which send their reports where they are told.
pub type Hire = Box<dyn FnOnce(&Reports, Option<&Parameters>) -> Box<dyn Crew>>;

/// The world model that a window begins with.
pub enum FirstWorld {
    /// It is here, or it is known why there is none.
    Here(Result<LoadedWorld, String>),
    /// It is in this file, and is read while the window opens.
    In(PathBuf),
}

/// What a window begins with.
pub struct Startup {
    /// The environment that it is about, as on the command line.
    pub env: String,
    /// The folder of sessions.
    pub sessions: PathBuf,
    /// The folder of recordings.
    pub dataset: PathBuf,
    /// The world model.
    pub world: FirstWorld,
    /// The session to go on with; without one, a new one begins with the first dream.
    pub session: Option<SessionStore>,
    /// How other world models are loaded.
    pub load: Load,
    /// Who does the slow work.
    pub hire: Hire,
    /// Where pads are read.
    pub input: Box<dyn InputSource>,
}

/// The window's application.
pub struct App {
    state: State,
    crew: Box<dyn Crew>,
    slots: Slots,
    inbox: Receiver<Report>,
    input: Box<dyn InputSource>,
    hands: Hands,
    /// Keys that were struck faster than the window draws.
    typing: Typing,
    focus: Focus,
    /// What was in the way when settings were read.
    leftover: Leftover,
    load: Load,
    /// A world model that is being read.
    loading: Option<Job<Result<LoadedWorld, String>>>,
    /// A session that is being read.
    opening: Option<Opening>,
    /// The reading of one that nobody wants any more, until it has ended.
    abandoned: Option<Reading>,
    /// The list of sessions that is being read.
    looking: Option<Looking>,
    /// The session to go on with once the world model is there, and where to.
    waiting: Option<(LoadedSession, Option<Panel>)>,
    /// Reports that were not yet heard when others were thrown away.
    unheard: Vec<Report>,
    sessions: PathBuf,
    dialog: Option<Dialog>,
    /// Who looks at where the session is while nothing is drawn.
    watching: Option<Watching>,
    /// Work on files that somebody waits for.
    errand: Option<Errand>,
    next_toast: u64,
    /// Draws the window again when something is done.
    waker: Context,
    /// The least time between two pictures of the window.
    pace: Duration,
}

/// The name under which the system knows the program, and keeps its settings.
const NAME: &str = "dropj";

/// What an event loop is made by.
type EventLoop = eframe::EventLoopBuilder<eframe::UserEvent>;

/// Opens the window, says these `notices` in it, and stays until it is closed; what prevents that is one sentence.
pub fn run(startup: Startup, notices: Vec<String>) -> Result<(), String> {
    let is_x11_forced = display::force_x11().map_err(|met| no_window(&met))?;
    let viewport = ViewportBuilder::default()
        .with_title(NAME)
        .with_app_id(NAME)
        .with_inner_size([1280.0, 820.0])
        .with_min_inner_size([880.0, 600.0]);
    let mut options = eframe::NativeOptions { viewport, ..eframe::NativeOptions::default() };
    if is_x11_forced {
        options.event_loop_builder = Some(Box::new(open_on_x11));
    }
    let create =
        |cc: &CreationContext<'_>| -> Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>> {
            let mut app = App::new(cc, startup);
            for notice in notices {
                app.fail(notice);
            }
            Ok(Box::new(app))
        };
    eframe::run_native(NAME, options, Box::new(create)).map_err(|e| sentence(&e))
}

#[cfg(target_os = "linux")]
fn open_on_x11(builder: &mut EventLoop) {
    use winit::platform::x11::EventLoopBuilderExtX11 as _;
    builder.with_x11();
}

#[cfg(not(target_os = "linux"))]
fn open_on_x11(_: &mut EventLoop) {}

/// What to tell somebody who has no window, and why.
fn no_window(why: &str) -> String {
    format!(
        "cannot open a window, for {why}; all but the window works from the command line: see `dropj --help`"
    )
}

/// What to tell somebody whose window did not open.
fn sentence(error: &eframe::Error) -> String {
    log::info!("no window: {error}");
    let why = match error {
        eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_) => {
            "no display answers (is DISPLAY or WAYLAND_DISPLAY set?)".to_owned()
        }
        eframe::Error::Wgpu(_) => {
            "there is neither a graphics card nor a software renderer to draw it (on Debian \
                                   and Ubuntu `apt install mesa-vulkan-drivers` brings one)"
                .to_owned()
        }
        eframe::Error::AppCreation(_) => error.to_string(),
    };
    no_window(&why)
}

impl App {
    /// The application in a window, or in a test without one.
    pub fn new(cc: &CreationContext<'_>, startup: Startup) -> Self {
        let ctx = &cc.egui_ctx;
        tokens::install(ctx);
        ctx.options_mut(|options| options.fallback_theme = egui::Theme::Dark);
        let (adapter, is_software) = adapter(cc);
        // Software paints a whole window in a tenth of a second: left alone it would starve the models.
        let pace = Duration::from_millis(if is_software { 50 } else { 8 });
        let waker = ctx.clone();
        let (reports, inbox) = Reports::new(move || waker.request_repaint_after(pace));
        let parameters = match &startup.world {
            FirstWorld::Here(Ok(world)) => Some(&world.parameters),
            _ => None,
        };
        let crew = (startup.hire)(&reports, parameters);
        let mut app = Self {
            state: State { adapter, env: startup.env, ..State::default() },
            slots: crew.slots(),
            crew,
            inbox,
            input: startup.input,
            hands: Hands::default(),
            typing: Typing::default(),
            focus: Focus::default(),
            leftover: Leftover::default(),
            load: startup.load,
            loading: None,
            opening: None,
            abandoned: None,
            looking: None,
            waiting: None,
            waker: ctx.clone(),
            unheard: Vec::new(),
            sessions: startup.sessions,
            dialog: None,
            watching: None,
            errand: None,
            next_toast: 0,
            pace,
        };
        app.load_preferences(ctx, cc.storage);
        app.begin(ctx, startup.dataset, startup.world, startup.session);
        app
    }

    fn begin(&mut self, ctx: &Context, dataset: PathBuf, world: FirstWorld, session: Option<SessionStore>) {
        let out = dataset.with_added_extension("safetensors");
        let fields = &mut self.state.fields;
        fields.insert(Field::Dataset, dataset.display().to_string());
        fields.insert(Field::ModelOut, out.display().to_string());
        fields.insert(Field::RecordSeed, "1".to_owned());
        fields.insert(Field::DeploySeed, "1".to_owned());
        fields.insert(Field::Session, self.sessions.display().to_string());
        match session {
            Some(store) => self.read_session(store),
            None => self.look_for_place(),
        }
        match world {
            FirstWorld::In(path) => self.load_world(ctx, path),
            FirstWorld::Here(Ok(world)) => {
                self.state.world = World::of(ctx, world, &mut self.state.dream);
            }
            FirstWorld::Here(Err(sentence)) => {
                self.state.panel = Panel::World;
                self.fail(sentence);
            }
        }
    }

    /// What is seen and said now: for tests.
    pub fn panel(&self) -> Panel {
        self.state.panel
    }

    /// Which keys do what: for tests.
    pub fn keys(&self) -> &Keys {
        &self.state.keys
    }

    /// The query whose clips are on the screen: for tests and benches.
    pub fn shown(&self) -> Option<QueryId> {
        self.state.label.shown.map(|shown| shown.query)
    }

    /// Whether they were there for long enough that an answer is taken: for tests and benches.
    pub fn is_answerable(&self) -> bool {
        let State { picture, label, .. } = &self.state;
        let next = Picture { nr: picture.nr + 1, at: picture.at };
        label.shown.is_some_and(|shown| shown.is_seen(next))
    }

    /// How many of the queries that come next are ready to be shown, one after the other: for tests and benches.
    pub fn n_ready(&self) -> usize {
        let pairs = &self.state.label.pairs;
        self.state.upcoming().iter().take_while(|query| pairs.contains_key(&query.id)).count()
    }

    /// The session that is open: for tests.
    pub fn session(&self) -> Option<&SessionStore> {
        self.state.store.as_ref()
    }
}

/// Who draws, in words, and whether it is the processor.
fn adapter(cc: &CreationContext<'_>) -> (String, bool) {
    let Some(render) = &cc.wgpu_render_state else { return ("nobody draws this window".to_owned(), false) };
    let info = render.adapter.get_info();
    let is_software = info.device_type == wgpu::DeviceType::Cpu;
    let how = if is_software { ", in software: at most 20 pictures a second" } else { "" };
    let said = format!("{} by {}{how}", info.name, info.backend);
    log::info!("the window is drawn by {said}");
    (said, is_software)
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &Context, _frame: &mut eframe::Frame) {
        self.hear_hands(ctx);
        self.hear_reports(ctx);
        self.hear_slots(ctx);
        self.hear_dialog(ctx);
        self.hear_drops(ctx);
        self.look_at_session(ctx);
        self.hear_closing(ctx);
        self.hear_errands(ctx);
        self.hear_opener();
        self.hear_looking();
        self.hear_loader(ctx);
        self.show_clips(ctx);
        self.show_review(ctx);
        self.show_shelf(ctx);
        let now = self.state.now;
        self.state.toasts.retain(|toast| toast.until.is_none_or(|until| until > now));
        self.schedule(ctx);
    }

    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        input::set_live(ui.ctx(), !self.state.is_covered());
        let mut commands = Vec::new();
        panels::window_ui(ui, &self.state, &mut commands);
        self.note_drawn();
        if !commands.is_empty() {
            // What they change is seen in the next picture only.
            ui.ctx().request_repaint();
        }
        for command in commands {
            self.act(ui.ctx(), command);
        }
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        self.save_preferences(storage);
    }

    fn on_exit(&mut self) {
        self.leave();
    }
}

#[cfg(test)]
mod tests {
    use eframe::egui_wgpu::WgpuError;

    use super::*;

    #[test]
    fn who_cannot_have_a_window_is_told_a_way_on() {
        let said = sentence(&eframe::Error::Wgpu(WgpuError::NoSurfaceFormatsAvailable));
        assert!(said.contains("mesa-vulkan-drivers") && said.contains("dropj --help"), "{said}");
    }
}
