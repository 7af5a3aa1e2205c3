//! The experiments that the paper made, and a few that it did not, by their names: files as anybody writes them.

use super::description::Description;

/// The names, in the order of the paper, with their files.
const FILES: [(&str, &str); 14] = [
    ("q1-one-shot", include_str!("../../assets/experiments/q1-one-shot.toml")),
    ("q2-preferences", include_str!("../../assets/experiments/q2-preferences.toml")),
    ("q3-justifications", include_str!("../../assets/experiments/q3-justifications.toml")),
    ("weights", include_str!("../../assets/experiments/weights.toml")),
    ("q4-obstacles", include_str!("../../assets/experiments/q4-obstacles.toml")),
    ("q4-obstacles-cars", include_str!("../../assets/experiments/q4-obstacles-cars.toml")),
    ("theorem", include_str!("../../assets/experiments/theorem.toml")),
    ("world-size", include_str!("../../assets/experiments/world-size.toml")),
    ("errors", include_str!("../../assets/experiments/errors.toml")),
    ("second-annotator", include_str!("../../assets/experiments/second-annotator.toml")),
    ("learned-weights", include_str!("../../assets/experiments/learned-weights.toml")),
    ("planner", include_str!("../../assets/experiments/planner.toml")),
    ("choice", include_str!("../../assets/experiments/choice.toml")),
    ("oracle", include_str!("../../assets/experiments/oracle.toml")),
];

/// All names, in the order of the paper.
pub fn names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name)
}

/// The experiment of this name at its full scale.
///
/// # Panics
/// Never: a test reads all of them.
pub fn named(name: &str) -> Option<Description> {
    let (_, text) = FILES.iter().find(|(known, _)| *known == name)?;
    let read = Description::from_toml(text);
    Some(read.unwrap_or_else(|met| unreachable!("{name} is ours: {met}")))
}
