//! The window: draws the [`State`] of the application and turns clicks, keys and pads into commands.
//!
//! Panels are functions of the state that push commands; the window passes them to the
//! [`App`], what workers report as well, and carries out its effects. Nothing here decides, computes, or
//! touches a file; what is remembered from one start to the next (colors, keys) is in `settings`.

mod command;
mod deploy;
mod dialog;
mod display;
mod dream;
mod guide;
mod evaluate;
mod input;
mod label;
mod layout;
mod rail;
mod record;
mod reward;
mod session;
mod settings;
mod status;
mod tokens;
mod widgets;
mod world_model;

use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui::{self, Context, ViewportBuilder, ViewportCommand};
use eframe::{CreationContext, wgpu};

use crate::app::{App, Command, DreamCommand, Effect, Moment, Panel, Startup, State, Tick, WindowCommand};
use crate::session::now;
use crate::worker::{LiveAction, Workers};
use crate::world::controls::Pad;

pub use input::{Gilrs, InputSource, NoPads, PadButton, PadEvent, system_pads};
pub use settings::keymap::{KeyAction, Keys};
pub use settings::preferences::{Preferences, Problem, SettingsFile, settings_file};

use command::{Commands, UiCommand};
use dialog::Dialog;
use input::Input;
use settings::preferences::Leftover;
use settings::{Settings, SettingsCommand};

/// Starts the workers; what it is given draws the window again, and is called after every report.
pub type SpawnWorkers = Box<dyn FnOnce(Wake) -> Box<dyn Workers>>;

/// Draws the window again.
pub type Wake = Box<dyn Fn() + Send + Sync>;

/// What a window begins with.
pub struct WindowStartup {
    /// What the application begins with.
    pub app: Startup,
    /// Starts those who do the slow work.
    pub workers: SpawnWorkers,
    /// Where pads are read.
    pub input: Box<dyn InputSource>,
}

/// The window.
pub struct Window {
    app: App,
    settings: Settings,
    workers: Box<dyn Workers>,
    /// What is held on keys and pads now.
    action: LiveAction,
    input: Input,
    /// The picture that somebody had seen who does what is taken in now.
    seen: Moment,
    /// What was in the way when settings were read.
    leftover: Leftover,
    dialog: Option<Dialog>,
    /// The file of the world that the program is to begin anew with.
    next_world: NextWorld,
    /// The least time between two pictures of the window.
    pace: Duration,
}

/// What panels read.
pub(crate) struct View<'a> {
    state: &'a State,
    pub settings: &'a Settings,
}

impl Deref for View<'_> {
    type Target = State;

    fn deref(&self) -> &State {
        self.state
    }
}

/// Where a window leaves the file of the world that the program is to begin anew with.
type NextWorld = Arc<Mutex<Option<PathBuf>>>;

/// The name under which the system knows the program, and keeps its settings.
const NAME: &str = "dropj";

/// What an event loop is made by.
type EventLoop = eframe::EventLoopBuilder<eframe::UserEvent>;

/// Opens the window, says these `notices` in it, takes in what is to be `open` as if it were dropped on it, and stays until it is closed; or says what prevents that. Where it was
/// closed to open another world, that one's file.
pub fn run(
    startup: WindowStartup,
    notices: Vec<String>,
    open: Vec<PathBuf>,
) -> Result<Option<PathBuf>, WindowError> {
    let is_x11_forced = display::force_x11()?;
    let viewport = ViewportBuilder::default()
        .with_title(NAME)
        .with_app_id(NAME)
        .with_inner_size([1280.0, 820.0])
        .with_min_inner_size([880.0, 600.0]);
    let mut options = eframe::NativeOptions { viewport, ..eframe::NativeOptions::default() };
    if is_x11_forced {
        options.event_loop_builder = Some(Box::new(open_on_x11));
    }
    let next_world = NextWorld::default();
    let next = Arc::clone(&next_world);
    let create =
        move |cc: &CreationContext<'_>| -> Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>> {
            let mut window = Window::new(cc, startup);
            window.next_world = next;
            for notice in notices {
                window.command(WindowCommand::Fail(notice));
            }
            for path in open {
                window.command(WindowCommand::Drop(path));
            }
            Ok(Box::new(window))
        };
    eframe::run_native(NAME, options, Box::new(create))?;
    Ok(next_world.lock().unwrap_or_else(PoisonError::into_inner).take())
}

#[cfg(target_os = "linux")]
fn open_on_x11(builder: &mut EventLoop) {
    use winit::platform::x11::EventLoopBuilderExtX11 as _;
    builder.with_x11();
}

#[cfg(not(target_os = "linux"))]
fn open_on_x11(_: &mut EventLoop) {}

/// Why there is no window.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// A Wayland display is named that does not answer, and no other is.
    #[error("{}", no_window("WAYLAND_DISPLAY names a display that does not answer"))]
    Wayland,
    /// There is no display, or none that opens a window.
    #[error("{}", no_window("no display answers (is DISPLAY or WAYLAND_DISPLAY set?)"))]
    Display(eframe::Error),
    /// Nobody draws it.
    #[error("{}", no_window(NO_RENDERER))]
    Renderer(eframe::Error),
    /// The program in it did not begin.
    #[error("{}", no_window(&.0.to_string()))]
    Creation(eframe::Error),
}

/// What is missing where nobody can draw a window.
const NO_RENDERER: &str = "there is neither a graphics card nor a software renderer to draw it (on Debian \
                           and Ubuntu `apt install mesa-vulkan-drivers` brings one)";

/// What to tell somebody who has no window, and why.
fn no_window(why: &str) -> String {
    format!(
        "cannot open a window, for {why}; all but the window works from the command line: see `dropj --help`"
    )
}

impl From<eframe::Error> for WindowError {
    fn from(error: eframe::Error) -> Self {
        log::info!("no window: {error}");
        match error {
            eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_) => Self::Display(error),
            eframe::Error::Wgpu(_) => Self::Renderer(error),
            eframe::Error::AppCreation(_) => Self::Creation(error),
        }
    }
}

impl Window {
    /// The window, or what would be one in a test without a screen.
    pub fn new(cc: &CreationContext<'_>, startup: WindowStartup) -> Self {
        let ctx = &cc.egui_ctx;
        tokens::install(ctx);
        ctx.options_mut(|options| options.fallback_theme = egui::Theme::Dark);
        let (adapter, is_software) = adapter(cc);
        // Software paints a whole window in a tenth of a second: left alone it would starve the models.
        let pace = Duration::from_millis(if is_software { 50 } else { 8 });
        let waker = ctx.clone();
        let workers = (startup.workers)(Box::new(move || waker.request_repaint_after(pace)));
        let mut window = Self {
            settings: Settings::new(&startup.app.spec, adapter),
            input: Input::new(&startup.app.spec, startup.input),
            app: App::new(startup.app),
            action: workers.action(),
            workers,
            seen: Moment::default(),
            leftover: Leftover::default(),
            dialog: None,
            next_world: NextWorld::default(),
            pace,
        };
        let spec = window.app.state().spec();
        for command in window.leftover.load(ctx, cc.storage, &spec, &mut window.settings) {
            window.app.command(command, Moment::default());
        }
        window.settle(ctx);
        window
    }

    /// The application in the window.
    pub fn app(&self) -> &App {
        &self.app
    }

    /// The file of the world that the program is to begin anew with, if it is: for tests.
    pub fn next_world(&self) -> Option<PathBuf> {
        self.next_world.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Which keys do what: for tests.
    pub fn keys(&self) -> &Keys {
        &self.settings.keys
    }

    fn command(&mut self, command: WindowCommand) {
        self.app.command(Command::Window(command), self.seen);
    }

    /// Takes in what keys and pads did since the last picture, and says what passes with this one.
    ///
    /// Without the focus nothing is received but what is plugged in and out: nobody's hands are here.
    fn receive_input(&mut self, ctx: &Context) -> Tick {
        let (moment, is_new) = self.input.begin_picture(ctx);
        let is_leaving = self.input.follow_focus(ctx, is_new);
        let events = self.input.poll();
        let has_left = self.input.has_left();
        let is_writing = ctx.text_edit_focused();
        let is_pressed = |event: &PadEvent| matches!(event, PadEvent::Took(_) | PadEvent::Pressed(_));
        let is_touched = ctx.input(|input| !input.events.is_empty()) || events.iter().any(is_pressed);
        let tick = Tick {
            moment,
            dt: f64::from(ctx.input(|input| input.stable_dt)),
            date: now(),
            has_focus: ctx.input(|input| input.focused),
            is_touched: is_touched && !has_left,
        };
        self.app.tick(tick);
        self.seen = moment;
        if is_leaving {
            self.command(WindowCommand::PauseDriving("Paused, for the window lost the focus"));
        }
        for event in events {
            self.receive_pad(ctx, event, is_writing);
        }
        let state = self.app.state();
        let (is_acting, is_standing) = (state.is_driving(), state.is_standing());
        let is_driving = state.is_driving() && !state.is_covered() && !is_writing && !has_left;
        // Where nothing is drawn, the events are those of the last picture still.
        if is_new {
            self.seen = self.input.receive_keys(ctx, &self.settings.keys, moment, is_driving);
        }
        self.settings.pad = self.input.held.pad();
        if is_acting {
            let dt = if is_standing { 0.0 } else { tick.dt as f32 };
            let held = &mut self.input.held;
            let action = if is_driving { held.step(dt, &self.settings.controls) } else { held.idle() };
            self.app.command(Command::Dream(DreamCommand::Act(action)), moment);
            self.action.put((action, Instant::now()));
        }
        tick
    }

    /// Takes in what a pad did.
    fn receive_pad(&mut self, ctx: &Context, event: PadEvent, is_writing: bool) {
        let settings = &mut self.settings;
        match event {
            PadEvent::Connected(name) => {
                if !settings.pads.contains(&name) {
                    settings.pads.push(name.clone());
                }
                self.command(WindowCommand::Note(format!("{name} is plugged in")));
            }
            PadEvent::Took(name) => {
                if settings.pad_in_use.replace(name.clone()).is_some_and(|former| former != name) {
                    self.command(WindowCommand::Note(format!("{name} controls now")));
                }
            }
            PadEvent::Disconnected(name) => self.unplugged(&name),
            PadEvent::Moved(pad) => self.input.held.hold(pad),
            PadEvent::Pressed(_) if self.input.has_left() => {}
            PadEvent::Pressed(button) => {
                let state = View { state: self.app.state(), settings: &self.settings };
                let command = match self.settings.rebinding_button {
                    Some(key_action) => {
                        Some(UiCommand::Settings(SettingsCommand::BindButton(key_action, button)))
                    }
                    None if state.is_covered() || is_writing => None,
                    None => input::pad_command(&state, button).map(UiCommand::App),
                };
                if let Some(command) = command {
                    self.carry_out(ctx, command, self.seen);
                }
            }
        }
    }

    fn unplugged(&mut self, name: &str) {
        let settings = &mut self.settings;
        settings.pads.retain(|pad| pad != name);
        if let Some(other) = settings.pad_in_use.as_ref().filter(|in_use| *in_use != name) {
            let text = format!("{name} was unplugged, and {other} controls still");
            return self.command(WindowCommand::Note(text));
        }
        settings.pad_in_use = None;
        self.input.held.hold(Pad::default());
        let text = format!("{name} was unplugged: everything on it is let go, and the keys still work");
        self.command(WindowCommand::Warn(text));
    }

    fn receive_dialog(&mut self) {
        let Some(chosen) = self.dialog.as_mut().and_then(Dialog::poll) else { return };
        if let Some(Dialog { purpose, .. }) = self.dialog.take() {
            self.command(WindowCommand::Chosen(purpose, chosen));
        }
    }

    fn carry_out(&mut self, ctx: &Context, command: UiCommand, seen: Moment) {
        match command {
            UiCommand::App(command) => {
                if command == Command::Window(WindowCommand::ToggleHelp) {
                    self.settings.stop_rebinding();
                }
                self.app.command(command, seen);
            }
            UiCommand::Settings(command) => {
                if self.settings.command(ctx, &self.app.state().spec(), command) {
                    self.input.held.release();
                }
            }
        }
    }

    /// Carries out what the application wants done, and passes on what the workers report, until there is no more.
    fn settle(&mut self, ctx: &Context) {
        loop {
            let effects = self.app.take_effects();
            let is_quiet = effects.is_empty();
            for effect in effects {
                match effect {
                    Effect::Worker(command) => self.workers.send(command),
                    Effect::OpenDialog(purpose, at) => self.dialog = Some(Dialog::open(ctx, purpose, &at)),
                    Effect::ReleaseControls => self.input.held.release(),
                    Effect::OpenWorld(file) => {
                        *self.next_world.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
                        ctx.send_viewport_cmd(ViewportCommand::Close);
                    }
                    Effect::KeepOpen => ctx.send_viewport_cmd(ViewportCommand::CancelClose),
                }
            }
            let reports = self.workers.poll();
            if is_quiet && reports.is_empty() {
                return;
            }
            for report in reports {
                self.app.report(report);
            }
        }
    }

    /// Has the window drawn again when something on it moves.
    fn schedule(&self, ctx: &Context) {
        let (state, pace) = (self.app.state(), self.pace);
        let after = |wanted: Duration| ctx.request_repaint_after(pace.max(wanted));
        if state.is_driving() {
            after(Duration::from_millis(16));
        }
        let is_away = state.label.clock.is_away(state.now);
        let shown = state.label.shown.filter(|_| state.panel == Panel::Label);
        if shown.is_some_and(|shown| shown.is_becoming_seen(state.moment)) {
            after(Duration::ZERO);
        }
        if shown.is_some() && !state.label.is_standing && !is_away {
            after(Duration::from_secs_f64(0.5 / state.clip_rate()));
        }
        if state.review.head.is_playing || state.episodes.head.is_playing || state.is_replaying() {
            after(Duration::from_millis(20));
        }
        // Pads are read between two pictures, so there must be some; in software a picture costs too much for many.
        if !self.settings.pads.is_empty() {
            ctx.request_repaint_after(6 * pace);
        }
        if state.opening.is_some() {
            after(Duration::from_millis(100));
        }
        let until = state.messages.iter().filter_map(|message| message.until).reduce(f64::min);
        if let Some(until) = until {
            ctx.request_repaint_after(Duration::from_secs_f64((until - state.now).max(0.05)));
        }
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

impl eframe::App for Window {
    fn logic(&mut self, ctx: &Context, _frame: &mut eframe::Frame) {
        let tick = self.receive_input(ctx);
        self.receive_dialog();
        for file in ctx.input(|input| input.raw.dropped_files.clone()) {
            self.command(WindowCommand::Drop(file.path().to_owned()));
        }
        if ctx.input(|input| input.viewport().close_requested()) {
            self.command(WindowCommand::Close);
        }
        self.settle(ctx);
        self.app.advance(tick);
        self.settle(ctx);
        self.schedule(ctx);
    }

    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        let (state, settings) = (self.app.state(), &self.settings);
        input::set_live(ui.ctx(), !state.has_dialog());
        tokens::animate(ui.ctx(), !state.label.is_motion_reduced);
        let mut commands = Commands::default();
        layout::window_ui(ui, &View { state, settings }, &mut commands);
        widgets::clip::tidy_textures(ui.ctx());
        self.app.drawn();
        let commands = commands.take();
        if !commands.is_empty() {
            // What they change is seen in the next picture only.
            ui.ctx().request_repaint();
        }
        for command in commands {
            self.carry_out(ui.ctx(), command, self.seen);
        }
        self.settle(ui.ctx());
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        self.leftover.save(storage, self.app.state(), &self.settings);
    }

    fn on_exit(&mut self) {
        self.input.held.release();
    }
}

#[cfg(test)]
mod tests {
    use eframe::egui_wgpu::WgpuError;

    use super::*;

    #[test]
    fn who_cannot_have_a_window_is_told_a_way_on() {
        let said = WindowError::from(eframe::Error::Wgpu(WgpuError::NoSurfaceFormatsAvailable)).to_string();
        assert!(said.contains("mesa-vulkan-drivers") && said.contains("dropj --help"), "{said}");
    }
}
