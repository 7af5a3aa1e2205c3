//! A world's file, with comments for whoever changes it.

use std::fmt::Write as _;

use super::spec::{Axis, Candidates, Count, EventSpec, Margins, SourceKind, TimeOuts, When};
use super::{CandidateSource, Part, Source, WorldSpec};

impl WorldSpec {
    /// The file that says this world, with comments. Read again it is equal.
    pub fn to_toml(&self) -> String {
        let mut file = String::new();
        let mut line = |text: String| {
            file.push_str(text.trim_end());
            // A block of lines is followed by an empty one.
            file.push_str(if text.ends_with('\n') { "\n\n" } else { "\n" });
        };
        line("# A world for dropj. `dropj world check FILE` says what is wrong with it.".to_owned());
        line(format!("format = {}", self.format));
        line(format!("name = {}  # in files and on the command line", quoted(&self.name)));
        line(format!("title = {}  # for people", quoted(&self.title)));
        line(format!("rate = {:?}  # steps a second, in Hz", self.rate));
        line(format!("longest_episode = {}  # steps", self.longest_episode));
        line(source(&self.source));
        line(image(self));
        line("# What can be done, in the order of an action's numbers. Keys and pad say which value they move it to.".to_owned());
        self.axes.iter().for_each(|each| line(axis(each)));
        if !self.events.is_empty() {
            line(
                "# What can happen in a step, and the field of what the world tells that says it.".to_owned(),
            );
        }
        self.events.iter().for_each(|each| line(event(each)));
        if !self.justifications.is_empty() {
            line("# Reasons for a preference, the most severe first.".to_owned());
        }
        for justification in &self.justifications {
            line("[[justifications]]".to_owned());
            line(format!("name = {}", quoted(&justification.name)));
            let events: Vec<_> = justification.events.iter().map(|name| quoted(name)).collect();
            line(format!("events = [{}]", events.join(", ")));
            line(format!("weight = {:?}  # above 0.5, at most 1\n", justification.weight));
        }
        line("[weights]  # each above 0.5, at most 1".to_owned());
        line(format!("safety = {:?}  # only one of two clips is safe", self.weights.safety));
        line(format!("default = {:?}  # both are safe, or no reason applies\n", self.weights.default));
        line(planner(self));
        line(overrides(self));
        file.truncate(file.trim_end().len());
        file + "\n"
    }
}

fn source(source: &Source) -> String {
    let mut text = format!(
        "\n[source]\nkind = {}  # \"built-in\", \"process\" or \"recordings\"\n",
        quoted(source.kind.name())
    );
    if let Some(world) = &source.world {
        let _ = writeln!(text, "world = {}", quoted(world));
    }
    if source.kind == SourceKind::Process {
        let parts: Vec<_> = source.command.iter().map(|part| quoted(part)).collect();
        let _ = writeln!(text, "command = [{}]", parts.join(", "));
        if let Some(folder) = &source.folder {
            let _ = writeln!(
                text,
                "folder = {}  # from the folder of this file",
                quoted(&folder.to_string_lossy())
            );
        }
        if !source.environment.is_empty() {
            let all = source
                .environment
                .iter()
                .map(|(name, value)| format!("{} = {}", quoted(name), quoted(value)));
            let _ = writeln!(text, "environment = {{ {} }}", all.collect::<Vec<_>>().join(", "));
        }
        let TimeOuts { start, reset, step, close } = source.time_outs;
        let _ = writeln!(
            text,
            "time_outs = {{ start = {start:?}, reset = {reset:?}, step = {step:?}, close = {close:?} }}  # seconds"
        );
    }
    if !source.cameras.is_empty() {
        let names: Vec<_> = source.cameras.iter().map(|name| quoted(name)).collect();
        let _ = writeln!(
            text,
            "cameras = [{}]  # of a dataset, side by side from left to right",
            names.join(", ")
        );
    }
    if let Some(action) = &source.action {
        let _ = writeln!(text, "action = {}  # the column of a dataset", quoted(action));
    }
    text
}

fn image(spec: &WorldSpec) -> String {
    let image = &spec.image;
    let mut text = format!(
        "[image]  # RGB\nheight = {}  # pixels, as the world gives them\nwidth = {}\n",
        image.height, image.width
    );
    for (name, margins, what) in
        [("crop", image.crop, "cut off first"), ("pad", image.pad, "then put around, black")]
    {
        if margins != Margins::default() {
            let sides = margins.each().map(|(side, n)| format!("{side} = {n}")).join(", ");
            let _ = writeln!(text, "{name} = {{ {sides} }}  # {what}");
        }
    }
    if let Some(size) = image.train {
        let _ = writeln!(
            text,
            "train = {{ height = {}, width = {} }}  # the size that networks are trained at",
            size.height, size.width
        );
    }
    text
}

fn axis(axis: &Axis) -> String {
    let mut text = format!(
        "[[axes]]\nname = {}\nlow = {:?}\nhigh = {:?}\nneutral = {:?}  # nobody does anything\nmirrored = {}  # whether \
         its mirror image is as good, as with left and right\n",
        quoted(&axis.name),
        axis.low,
        axis.high,
        axis.neutral,
        axis.mirrored
    );
    let keys =
        axis.keys.iter().map(|input| format!("{{ key = {}, to = {:?} }}", quoted(&input.key), input.to));
    let _ = writeln!(text, "keys = [{}]", keys.collect::<Vec<_>>().join(", "));
    let pad = axis
        .pad
        .iter()
        .map(|input| format!("{{ axis = {}, to = {:?} }}", quoted(input.axis.name()), input.to));
    let _ = writeln!(text, "pad = [{}]", pad.collect::<Vec<_>>().join(", "));
    let _ = match axis.key_speed {
        Some(speed) => {
            writeln!(text, "key_speed = {speed:?}  # how fast a held key moves it, units a second")
        }
        None => writeln!(text, "# key_speed = 1.0  # units a second; without it a key moves it at once"),
    };
    let _ = writeln!(
        text,
        "release = {}  # let go, it springs back (\"spring\") or stays (\"stay\")",
        quoted(axis.release.name())
    );
    text
}

fn event(event: &EventSpec) -> String {
    let when = match event.when {
        When::True => quoted("true"),
        When::False => quoted("false"),
        When::Grows => quoted("grows"),
        When::Above(limit) => format!("{{ above = {limit:?} }}"),
        When::Below(limit) => format!("{{ below = {limit:?} }}"),
    };
    let mut text = format!(
        "[[events]]\nname = {}\nkind = {}  # \"safety\" or \"progress\"\ncount = {}  # \"per-step\", \"first-touch\" or \
         \"of-passed\"\nfield = {}\nwhen = {when}  # \"true\", \"false\", \"grows\", {{ above = x }} or {{ below = x }}\n",
        quoted(&event.name),
        quoted(event.kind.name()),
        quoted(event.count.name()),
        quoted(&event.field),
    );
    if let (Some(passed), Count::OfPassed) = (&event.passed, event.count) {
        let _ = writeln!(text, "passed = {}  # the field that says that one more was passed", quoted(passed));
    }
    text
}

fn planner(spec: &WorldSpec) -> String {
    let planner = &spec.planner;
    let mut text = format!(
        "[planner]\nhorizon = {}  # steps that are imagined\nreplan = {}  # steps from plan to plan\ntemperature = {:?}\n",
        planner.horizon, planner.replan, planner.temperature
    );
    let _ = match planner.memory_reset {
        Some(steps) => writeln!(text, "memory_reset = {steps}  # steps until everything is forgotten"),
        None => {
            writeln!(text, "# memory_reset = 50  # steps until everything is forgotten; without it never")
        }
    };
    if !planner.beginnings.is_empty() {
        text.push_str("beginnings = [  # of searches for trajectories worth asking about\n");
        for action in &planner.beginnings {
            let _ = writeln!(text, "    {},", numbers(action));
        }
        text.push_str("]\n");
    }
    text + "\n" + &candidates(&planner.candidates)
}

/// An action as TOML writes it.
fn numbers(action: &[f32]) -> String {
    format!("[{}]", action.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", "))
}

fn candidates(candidates: &Candidates) -> String {
    let mut text = format!(
        "[planner.candidates]\nfrom = {}  # \"file\" or \"recordings\"\n",
        quoted(candidates.from.name())
    );
    if candidates.from == CandidateSource::Recordings {
        if let Some(count) = candidates.count {
            let _ = writeln!(text, "count = {count}");
        }
        return text;
    }
    text.push_str("constant = [  # actions that are kept to throughout\n");
    for action in &candidates.constant {
        let _ = writeln!(text, "    {},", numbers(action));
    }
    text.push_str("]\nstages = [  # each comes first once; the second is drawn from them, by `follows`\n");
    for stage in &candidates.stages {
        let _ =
            writeln!(text, "    {{ action = {}, follows = {:?} }},", numbers(&stage.action), stage.follows);
    }
    text.push_str("]\n");
    if candidates.courses.is_empty() {
        return text;
    }
    text.push_str("courses = [  # whole ones; the last part lasts to the end\n");
    for course in &candidates.courses {
        let part = |part: &Part| format!("{{ action = {}, steps = {} }}", numbers(&part.action), part.steps);
        let _ = writeln!(text, "    [{}],", course.iter().map(part).collect::<Vec<_>>().join(", "));
    }
    text + "]\n"
}

fn overrides(spec: &WorldSpec) -> String {
    let mut text =
        "\n[networks]  # what is not given follows from the image, the axes and the rate\n".to_owned();
    for (name, value, _) in spec.networks.each() {
        if let Some(value) = value {
            let _ = writeln!(text, "{name} = {value}");
        }
    }
    text.push_str("\n[fitting]  # what is not given is as usual\n");
    for (name, value, _) in spec.fitting.each() {
        if let Some(value) = value {
            let _ = writeln!(text, "{name} = {value}");
        }
    }
    if let Some(share) = spec.fitting.held_out {
        let _ = writeln!(text, "held_out = {share:?}");
    }
    if let Some(strength) = spec.fitting.emphasis {
        let _ = writeln!(text, "emphasis = {strength:?}  # of rare colors; 0 is none, 1 as usual");
    }
    text
}

/// A text as TOML writes it.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted + "\""
}
