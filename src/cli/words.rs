//! What is said on the command line in words: protocols, what is refused, and errors.

use dropj::query::Protocol;

use super::error::CliError;

/// The protocols' names, one after the other.
pub(crate) fn names(protocols: &[Protocol]) -> String {
    protocols.iter().map(|protocol| protocol.name()).collect::<Vec<_>>().join(", ")
}

/// What the command line is refused for, in one sentence, and how the command is used behind it.
pub(crate) fn refusal(refused: &CliError) -> String {
    match refused {
        CliError::Line(met) => sentence_of(met),
        other => other.to_string(),
    }
}

/// The same of what the parser refuses.
pub(crate) fn sentence_of(met: &clap::Error) -> String {
    let text = met.to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    let (what, usage) = text.split_once("\n\n").unwrap_or((text, ""));
    let what = what.split_whitespace().collect::<Vec<_>>().join(" ");
    if usage.trim().is_empty() { what } else { format!("{what}\n\n{}", usage.trim_end()) }
}

/// An error and its causes in one sentence: nothing is said twice, and no other library tells where in its code it was.
pub(crate) fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        // libtorch puts the stack of its own code behind what it says.
        let said = cause.split("\nException raised from").next().unwrap_or_default();
        let said: Vec<_> = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let said = said.join(" ");
        if words.is_empty() {
            words = said;
        } else if !said.is_empty() && !words.contains(&said) {
            words = format!("{words}: {said}");
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn a_cause_is_said_once_and_without_a_foreign_stack() {
        let torn: Result<(), _> =
            Err(anyhow::anyhow!("the shape is wrong\nException raised from f at x.cpp:1\nframe #0"));
        let error = torn.context("cannot load it: the shape is wrong").context("cannot drive").unwrap_err();
        assert_eq!(in_words(&error), "cannot drive: cannot load it: the shape is wrong");
    }
}
