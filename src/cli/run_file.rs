//! One file for a run: a TOML table for each of the long commands, as `--config FILE` reads it.
//!
//! A table's keys are the command's own options, and go through the same parser, so what is refused there is refused
//! here; tables within it are the settings of networks, fits and the planner, as the files of this program tell them.
//! What is given on the command line wins.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use dropj::tensor::limits::OutOfRange;
use dropj::text::shown;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::error::CliError;
use super::words::sentence_of;

/// The commands that a file can have a table for, each with the tables that can be in that one.
const COMMANDS: [(&str, &[&str]); 6] = [
    ("fit-world", &["fit", "networks"]),
    ("fit-probe", &["fit"]),
    ("fit-drqv2", &["fit"]),
    ("simulate", &["planner", "reward", "sparse"]),
    ("refit", &["reward", "sparse"]),
    ("deploy", &["planner"]),
];

/// The largest whole number that TOML has.
pub(crate) const MAX_WHOLE: u64 = i64::MAX as u64;

/// Options that say how settings are found, and are none themselves.
const NONE: [&str; 4] = ["config", "print-config", "help", "version"];

/// Where the settings of a command come from.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct RunFile {
    /// A TOML file with a table of options for each command; what is given here as well wins
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print all settings as such a file, and do nothing else
    #[arg(long)]
    print_config: bool,
    #[arg(skip)]
    filling: Filling,
}

/// What only the whole command line tells.
#[derive(Clone, Debug, Default)]
pub(crate) struct Filling {
    /// The name of the command.
    command: String,
    /// All options that have a value, wherever it comes from.
    options: Table,
    /// The tables within the command's.
    tables: Table,
}

impl RunFile {
    /// Puts in what the parser of the command's own options does not see.
    pub(crate) fn fill(&mut self, filling: Filling) {
        self.filling = filling;
    }

    /// `base` with what the file says in the command's table `name` in its place.
    pub(crate) fn over<T: Serialize + DeserializeOwned>(
        &self,
        name: &'static str,
        base: &T,
        check: impl FnOnce(&T) -> Result<(), OutOfRange>,
    ) -> Result<T, CliError> {
        let mut table = table_of(base);
        if let Some(Value::Table(given)) = self.filling.tables.get(name) {
            lay_over(&mut table, given);
        }
        let refused = |why: String| CliError::Settings {
            table: format!("{}.{name}", self.filling.command),
            why,
            path: self.config.clone().unwrap_or_default(),
        };
        let read = table.try_into::<T>().map_err(|met| refused(met.message().to_owned()))?;
        check(&read).map_err(|met| refused(met.to_string()))?;
        Ok(read)
    }

    /// The settings to print where that is all that was asked: the options as they are, for the command to complete.
    pub(crate) fn to_print(&self) -> Option<Settings> {
        let Filling { command, options, .. } = &self.filling;
        self.print_config.then(|| Settings { command: command.clone(), table: options.clone() })
    }
}

/// All settings of a command.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    command: String,
    table: Table,
}

impl Settings {
    /// With the value that an option, or a table, has after all.
    pub(crate) fn with(mut self, name: &str, value: impl Serialize) -> Self {
        let value = Value::try_from(value);
        let mut value = value.unwrap_or_else(|met| unreachable!("{name} can be written: {met}"));
        shorten(&mut value);
        self.table.insert(name.to_owned(), value);
        self
    }

    /// The same where there may be none.
    pub(crate) fn with_any(self, name: &str, value: Option<impl Serialize>) -> Self {
        match value {
            Some(value) => self.with(name, value),
            None => self,
        }
    }

    /// The file that says them.
    pub(crate) fn to_toml(&self) -> String {
        let file = Table::from_iter([(self.command.clone(), Value::Table(self.table.clone()))]);
        toml::to_string(&file).unwrap_or_else(|met| unreachable!("tables of plain values: {met}"))
    }
}

/// Takes digits off numbers of single precision that say nothing of them: 0.08, not 0.07999999821186066.
fn shorten(value: &mut Value) {
    match value {
        Value::Float(number) => {
            let single = *number as f32;
            if f64::from(single) == *number {
                *number = single.to_string().parse().unwrap_or(*number);
            }
        }
        Value::Array(values) => values.iter_mut().for_each(shorten),
        Value::Table(table) => table.iter_mut().for_each(|(_, value)| shorten(value)),
        _ => {}
    }
}

/// The table that says `settings`, which are plain data.
fn table_of(settings: &impl Serialize) -> Table {
    Table::try_from(settings).unwrap_or_else(|met| unreachable!("settings are a table: {met}"))
}

/// Puts what `given` says in the place of what `table` says, table by table.
fn lay_over(table: &mut Table, given: &Table) {
    for (key, value) in given {
        match (table.get_mut(key), value) {
            (Some(Value::Table(inner)), Value::Table(value)) => lay_over(inner, value),
            _ => drop(table.insert(key.clone(), value.clone())),
        }
    }
}

/// What the parser makes of a command line and of the file that it names, if any, and what [`RunFile::fill`] wants of it.
pub(crate) fn read_line(mut root: Command, line: Vec<OsString>) -> Result<(ArgMatches, Filling), CliError> {
    root.build();
    let lenient = root.clone().ignore_errors(true).try_get_matches_from(&line).ok();
    let (line, tables) = match lenient.as_ref().and_then(named_file) {
        Some((name, given, path)) => with_file(&root, &line, name, given, path)?,
        None => (line, Table::new()),
    };
    let matches = root.clone().try_get_matches_from(line)?;
    let named = matches.subcommand().and_then(|(name, given)| Some((root.find_subcommand(name)?, given)));
    let filling = named.map_or_else(Filling::default, |(command, given)| Filling {
        command: command.get_name().to_owned(),
        options: options_of(command, given),
        tables,
    });
    Ok((matches, filling))
}

/// The command that is given, what is given to it, and the file that is named.
fn named_file(line: &ArgMatches) -> Option<(&str, &ArgMatches, &Path)> {
    let (name, given) = line.subcommand()?;
    let path = given.try_get_one::<PathBuf>("config").ok()??;
    Some((name, given, path))
}

/// `line` with what the file at `path` says of options that are not `given`, and the tables within the command's.
fn with_file(
    root: &Command,
    line: &[OsString],
    name: &str,
    given: &ArgMatches,
    path: &Path,
) -> Result<(Vec<OsString>, Table), CliError> {
    let command = root.find_subcommand(name).unwrap_or_else(|| unreachable!("it was found in this line"));
    let known = COMMANDS.iter().find(|(known, _)| *known == name).map_or(&[][..], |(_, tables)| tables);
    let at = line.iter().position(|arg| arg == name).map_or(line.len(), |at| at + 1);
    let (before, behind) = line.split_at(at);

    let mut tables = Table::new();
    let (mut from_file, mut all) = (before.to_vec(), before.to_vec());
    for (key, value) in read(path, name)? {
        if value.is_table() {
            if !known.contains(&key.as_str()) {
                return Err(unknown("table", name, &key, known.iter().copied(), path));
            }
            tables.insert(key, value);
            continue;
        }
        let Some(arg) = settings(command).find(|arg| arg.get_long() == Some(&key)) else {
            let keys: BTreeSet<_> = settings(command).filter_map(Arg::get_long).collect();
            return Err(unknown("setting", name, &key, keys, path));
        };
        let args = args_of(arg, &key, &value);
        from_file.extend_from_slice(&args);
        if !is_settled(command, given, arg) {
            all.extend(args);
        }
    }
    // What no line could say is refused in the file's name; what is missing in it may be on the line.
    if let Err(refused) = root.clone().try_get_matches_from(from_file)
        && refused.kind() != ErrorKind::MissingRequiredArgument
    {
        let what = sentence_of(&refused);
        let why = what.split("\n\n").next().unwrap_or_default().to_owned();
        return Err(CliError::Settings { table: name.to_owned(), why, path: path.to_owned() });
    }
    all.extend_from_slice(behind);
    Ok((all, tables))
}

/// The table of the command `name` in the file at `path`.
fn read(path: &Path, name: &str) -> Result<Table, CliError> {
    let text = std::fs::read_to_string(path);
    let text = text.map_err(|cause| CliError::RunFile { cause, path: path.to_owned() })?;
    let refused = |cause| CliError::NoToml { cause, path: path.to_owned() };
    let mut file: Table = text.parse().map_err(|met| refused(one_line(&met, &text)))?;
    let commands = COMMANDS.iter().map(|(name, _)| *name);
    for (key, value) in &file {
        if !commands.clone().any(|command| command == key) {
            let commands = commands.collect::<Vec<_>>().join(", ");
            let key = shown(key);
            return Err(CliError::Unknown { what: "table", key, known: commands, path: path.to_owned() });
        }
        if !value.is_table() {
            return Err(refused(format!("{key} is no table")));
        }
    }
    match file.remove(name) {
        Some(Value::Table(table)) => Ok(table),
        _ => Ok(Table::new()),
    }
}

/// What is wrong with a file of TOML, and in which line.
fn one_line(met: &toml::de::Error, text: &str) -> String {
    let lines = met.span().and_then(|span| text.get(..span.start)).map(|before| before.matches('\n').count());
    let what = met.message().lines().collect::<Vec<_>>().join(" ");
    lines.map_or(what.clone(), |n| format!("line {}: {what}", n + 1))
}

/// That a file has a `what` called `key` in the table `table`, and what it could have.
fn unknown<'a>(
    what: &'static str,
    table: &str,
    key: &str,
    known: impl IntoIterator<Item = &'a str>,
    path: &Path,
) -> CliError {
    let known = known.into_iter().collect::<Vec<_>>().join(", ");
    let key = format!("{table}.{}", shown(key));
    CliError::Unknown { what, key, known, path: path.to_owned() }
}

/// The options of a command that are settings.
fn settings(command: &Command) -> impl Iterator<Item = &Arg> {
    let is_setting = |arg: &&Arg| arg.get_long().is_some_and(|long| !NONE.contains(&long));
    command.get_arguments().filter(is_setting)
}

/// What says on a command line that `arg` is `value`.
fn args_of(arg: &Arg, key: &str, value: &Value) -> Vec<OsString> {
    let is_flag = matches!(arg.get_action(), ArgAction::SetTrue);
    match value {
        Value::Boolean(true) if is_flag => vec![format!("--{key}").into()],
        Value::Boolean(false) if is_flag => Vec::new(),
        Value::Array(values) => values.iter().flat_map(|value| args_of(arg, key, value)).collect(),
        Value::String(text) => vec![format!("--{key}={text}").into()],
        other => vec![format!("--{key}={other}").into()],
    }
}

/// Whether the line itself says what `arg` is, or something that does not go with it.
fn is_settled(command: &Command, given: &ArgMatches, arg: &Arg) -> bool {
    let is_given = |arg: &Arg| given.value_source(arg.get_id().as_str()) == Some(ValueSource::CommandLine);
    let excludes = |one: &Arg, other: &Arg| {
        command.get_arg_conflicts_with(one).iter().any(|arg| arg.get_id() == other.get_id())
    };
    let is_excluded = |other: &Arg| is_given(other) && (excludes(arg, other) || excludes(other, arg));
    is_given(arg) || settings(command).any(is_excluded)
}

/// The options of a command as the line gives them, its defaults among them.
fn options_of(command: &Command, given: &ArgMatches) -> Table {
    let mut table = Table::new();
    for arg in settings(command) {
        let (Some(long), Some(values)) = (arg.get_long(), given.get_raw(arg.get_id().as_str())) else {
            continue;
        };
        let mut values: Vec<_> = values.map(|value| value_of(&value.to_string_lossy())).collect();
        let value = match (values.len(), arg.get_action()) {
            (1, ArgAction::Set | ArgAction::SetTrue) => values.remove(0),
            _ => Value::Array(values),
        };
        table.insert(long.to_owned(), value);
    }
    table
}

/// The value that is written so: a number where it would be written so again.
fn value_of(text: &str) -> Value {
    if let Ok(truth) = text.parse() {
        Value::Boolean(truth)
    } else if let Some(whole) = text.parse::<i64>().ok().filter(|whole| whole.to_string() == text) {
        Value::Integer(whole)
    } else if let Some(number) =
        text.parse::<f64>().ok().filter(|number| number.is_finite() && number.to_string() == text)
    {
        Value::Float(number)
    } else {
        Value::String(text.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parse;

    /// What the program says of a line, in whose folder is this file.
    fn said(file: &str, line: &str) -> Option<String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.toml");
        std::fs::write(&path, file).unwrap();
        let line = ["dropj"].into_iter().chain(line.split(' ')).map(OsString::from);
        let line = line.chain(["--config".into(), path.into()]);
        parse(line).err().map(|refused| super::super::refusal(&refused))
    }

    #[test]
    fn what_nobody_knows_or_could_say_is_refused_with_the_file() {
        for (file, wanted) in [
            ("[simulat]\n", "there is no table simulat; there are fit-world, "),
            ("[simulate]\nquery = 5", "there is no setting simulate.query; there are "),
            ("[simulate]\nconfig = 'other.toml'", "there is no setting simulate.config"),
            ("[simulate.rewards]\n", "there is no table simulate.rewards; there are planner, reward, sparse"),
            ("[simulate]\nqueries = 0", "'--queries <QUERIES>': it must be a whole number"),
            ("[simulate]\nqueries = [1, 2]", "'--queries <QUERIES>' cannot be used multiple times"),
            ("[simulate]\nchoice = 'sing'", "[possible values: uniform"),
            ("[simulate]\nseed = -1", "'--seed <SEED>'"),
            ("queries = 5\n", "there is no table queries"),
            ("simulate = 5\n", "simulate is no table"),
            ("[simulate]\nqueries = 1\nqueries = 2\n", "line 3: "),
            ("[simulate", "line 1: "),
        ] {
            let said = said(file, "simulate --out X").unwrap_or_default();
            assert!(said.contains(wanted) && said.contains("run.toml"), "{file}: {said}");
        }
    }

    #[test]
    fn a_line_and_its_file_are_whole_together() {
        assert_eq!(said("[simulate]\nout = 'X'", "simulate"), None);
        assert_eq!(said("[refit]\nupdates = 5", "simulate --out X"), None, "tables of others are let be");
        assert!(said("", "simulate").is_some_and(|said| said.contains("--out")), "what both lack is named");
        assert_eq!(said("[deploy]\nstraight-on = true", "deploy --session s"), None, "the line wins");
        assert_eq!(said("[deploy]\nsession = 's'\nstraight-on = false", "deploy"), None);
        let both = said("[deploy]\nsession = 's'\nstraight-on = true", "deploy").unwrap();
        assert!(both.contains("cannot be used with") && both.contains("run.toml"), "{both}");
    }

    #[test]
    fn a_value_is_written_as_it_was_given() {
        for (text, value) in [
            ("5", Value::Integer(5)),
            ("0.95", Value::Float(0.95)),
            ("true", Value::Boolean(true)),
            ("05", Value::String("05".into())),
            ("nan", Value::String("nan".into())),
            ("18446744073709551615", Value::String("18446744073709551615".into())),
        ] {
            assert_eq!(value_of(text), value);
        }
    }

    #[test]
    fn numbers_of_single_precision_are_written_short() {
        let mut value = Value::try_from([0.08_f32, 1.5]).unwrap();
        shorten(&mut value);
        assert_eq!(value.to_string(), "[0.08, 1.5]");
    }
}
