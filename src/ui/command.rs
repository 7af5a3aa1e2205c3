//! What panels push while they draw: commands for the application, and those for the window's own settings.

use crate::app::Command;
use crate::ui::settings::SettingsCommand;

/// One thing to do, once the frame is drawn.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum UiCommand {
    /// The application's business.
    App(Command),
    /// The window's own.
    Settings(SettingsCommand),
}

impl From<Command> for UiCommand {
    fn from(command: Command) -> Self {
        Self::App(command)
    }
}

impl From<SettingsCommand> for UiCommand {
    fn from(command: SettingsCommand) -> Self {
        Self::Settings(command)
    }
}

/// The commands of one frame, in the order of asking.
#[derive(Debug, Default)]
pub(crate) struct Commands(Vec<UiCommand>);

impl Commands {
    /// Asks for one more thing.
    pub(crate) fn push(&mut self, command: impl Into<UiCommand>) {
        self.0.push(command.into());
    }

    /// Whether that was asked for already.
    pub(crate) fn contains(&self, command: &Command) -> bool {
        self.0.iter().any(|pushed| matches!(pushed, UiCommand::App(pushed) if pushed == command))
    }

    /// All of them.
    pub(crate) fn take(self) -> Vec<UiCommand> {
        self.0
    }
}
