//! The ranges of numbers on the command line: what lies outside is refused before anything is begun.

use std::ops::RangeInclusive;

use super::error::CliError;

/// Reads a whole number in `range`.
pub(crate) fn count(range: RangeInclusive<usize>) -> impl Fn(&str) -> Result<usize, CliError> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or(CliError::Count { least: *range.start(), most: *range.end() })
    }
}

/// Reads a number in `range`.
pub(crate) fn number(range: RangeInclusive<f64>) -> impl Fn(&str) -> Result<f64, CliError> + Clone {
    // What is no number lies in no range.
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or(CliError::Number { least: *range.start(), most: *range.end() })
    }
}

/// The same in less precision.
pub(crate) fn number32(range: RangeInclusive<f32>) -> impl Fn(&str) -> Result<f32, CliError> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or(CliError::Number32 { least: *range.start(), most: *range.end() })
    }
}

/// Reads a number above the first and up to the second.
pub(crate) fn above(least: f64, most: f64) -> impl Fn(&str) -> Result<f64, CliError> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| *number > least && *number <= most);
        number.ok_or(CliError::Above { least, most })
    }
}

/// Reads what an answer weighs.
pub(crate) fn weight(text: &str) -> Result<f32, CliError> {
    let weight = text.parse().ok().filter(|weight: &f32| *weight > 0.5 && *weight <= 1.0);
    weight.ok_or_else(|| CliError::Weight(text.to_owned()))
}

/// Reads a justification and its weight, such as `grass=1`.
pub(crate) fn named_weight(text: &str) -> Result<(String, f32), CliError> {
    let (name, number) = text.split_once('=').ok_or(CliError::UnnamedWeight)?;
    if name.trim().is_empty() {
        return Err(CliError::EmptyName);
    }
    Ok((name.to_owned(), weight(number)?))
}

/// Reads the name of somebody, which is not to be empty.
pub(crate) fn name(text: &str) -> Result<String, CliError> {
    if text.trim().is_empty() { Err(CliError::Name) } else { Ok(text.to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_lies_in_no_range() {
        for text in ["NaN", "inf", "-inf", "1e400", "", "1,5", "0x1", "-0.1", "1.1"] {
            assert!(number(0.0..=1.0)(text).is_err(), "{text:?}");
            assert!(number32(0.0..=1.0)(text).is_err(), "{text:?}");
            assert!(above(0.0, 1.0)(text).is_err(), "{text:?}");
            assert!(weight(text).is_err(), "{text:?}");
        }
        for text in ["-1", "0", "11", "1e1", "99999999999999999999999", "1.0"] {
            assert!(count(1..=10)(text).is_err(), "{text:?}");
        }
        assert_eq!(
            (count(1..=10)("10").ok(), number(0.0..=1.0)("0").ok(), above(0.0, 0.5)("0.5").ok()),
            (Some(10), Some(0.0), Some(0.5))
        );
    }

    #[test]
    fn a_weight_decides_for_the_side_that_is_meant() {
        assert!(weight("0.5").is_err() && weight("1.01").is_err());
        assert_eq!(named_weight("grass=0.95").ok(), Some(("grass".to_owned(), 0.95)));
        assert!(
            named_weight("grass").is_err() && named_weight("=1").is_err() && named_weight("a=NaN").is_err()
        );
    }
}
