//! Text of others: shown so that it cannot be mistaken for ours, put into tables, told apart, and read from files.
//!
//! A name can hold anything: line ends, the codes that color a terminal, marks that turn the direction of reading, a
//! formula that a spreadsheet would carry out, five thousand letters, or nothing.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

use serde_json::Value;

/// A name is shown up to so many letters.
pub const SHOWN: usize = 60;

/// `text` in one line for a person: what cannot be seen is spelled out, what is long is cut, and nothing is `""`.
///
/// ```
/// use dropj::text::shown;
///
/// assert_eq!(shown("Ann-Sofie 用户"), "Ann-Sofie 用户");
/// assert_eq!(shown("two\nlines"), r"two\nlines");
/// assert_eq!(shown("\u{202e}abc"), r"\u{202e}abc");
/// assert_eq!(shown(""), r#""""#);
/// ```
pub fn shown(text: &str) -> String {
    shown_within(text, SHOWN)
}

/// The same with up to so many letters.
pub fn shown_within(text: &str, most: usize) -> String {
    if text.is_empty() {
        return r#""""#.to_owned();
    }
    let mut rest = text.chars();
    let mut line: String = rest.by_ref().take(most).fold(String::new(), spelled_out);
    if rest.next().is_some() {
        line.push('…');
    }
    // What begins or ends with a space could be taken for another name.
    if line.starts_with(' ') || line.ends_with(' ') { format!("{line:?}") } else { line }
}

/// `line` with `c` behind it, spelled out where it could not be seen or would change how the rest is seen.
fn spelled_out(mut line: String, c: char) -> String {
    if is_hidden(c) {
        line.extend(c.escape_default());
    } else {
        line.push(c);
    }
    line
}

/// Whether a character is not seen by itself, or turns those around it: controls, marks of direction, what has no width.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e0fff}')
}

/// `text` as a cell of a table with commas between (RFC 4180): quotes where needed, controls spelled out, and a `'`
/// before what a spreadsheet would take for a formula.
///
/// ```
/// use dropj::text::cell;
///
/// assert_eq!(cell("anna"), "anna");
/// assert_eq!(cell(r#"Smith, J. "JJ""#), r#""Smith, J. ""JJ""""#);
/// assert_eq!(cell("=1+1"), "'=1+1");
/// assert_eq!(cell("two\nlines"), r"two\nlines");
/// ```
pub fn cell(text: &str) -> String {
    let line = text.chars().fold(String::new(), spelled_out);
    // A spreadsheet may strip spaces before it looks. Full-width signs count as well in some.
    let first = line.trim_start().chars().next();
    let is_formula = matches!(first, Some('=' | '+' | '-' | '@' | '＝' | '＋' | '－' | '＠'))
        || text.starts_with(['\t', '\r', '\n']);
    let line = if is_formula { format!("'{line}") } else { line };
    if line.contains([',', '"', ';']) || line != line.trim() {
        format!("\"{}\"", line.replace('"', "\"\""))
    } else {
        line
    }
}

/// Names for files or folders, no two alike: as much of each path's end as it takes, and a number where even whole
/// paths are the same.
///
/// ```
/// use std::path::Path;
///
/// use dropj::text::distinct;
///
/// let paths = ["monday/s", "tuesday/s", "tuesday/t"].map(Path::new);
/// assert_eq!(distinct(&paths), ["monday/s", "tuesday/s", "t"]);
/// ```
pub fn distinct<P: AsRef<Path>>(paths: &[P]) -> Vec<String> {
    told_apart(paths.iter().map(|path| ends(path.as_ref())).collect())
}

/// The same for files that are called without their extension where that is enough.
///
/// ```
/// use dropj::text::distinct_files;
///
/// assert_eq!(distinct_files(&["a.json", "b.json"]), ["a", "b"]);
/// assert_eq!(distinct_files(&["r1/r.json", "r2/r.json", "r1/r.txt"]), ["r1/r.json", "r2/r.json", "r.txt"]);
/// ```
pub fn distinct_files<P: AsRef<Path>>(paths: &[P]) -> Vec<String> {
    let of = |path: &Path| {
        let mut ends = ends(path);
        ends.extend(path.file_stem().map(|stem| stem.to_string_lossy().into_owned()));
        let last = ends.len().saturating_sub(1);
        ends.rotate_right(usize::from(last > 0));
        ends
    };
    told_apart(paths.iter().map(|path| of(path.as_ref())).collect())
}

/// The ends of a path, the shortest first: its name, its folder's and its name, and so on.
fn ends(path: &Path) -> Vec<String> {
    use std::path::Component;

    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut parts: Vec<String> = Vec::new();
    for part in absolute.components() {
        match part {
            Component::ParentDir => drop(parts.pop()),
            Component::Normal(name) => parts.push(name.to_string_lossy().into_owned()),
            Component::CurDir | Component::RootDir | Component::Prefix(_) => {}
        }
    }
    let ends: Vec<_> = (0..parts.len()).rev().map(|from| parts[from..].join("/")).collect();
    if ends.is_empty() { vec!["/".to_owned()] } else { ends }
}

/// One of each list, no two alike, and each as early in its list as that allows.
fn told_apart(lists: Vec<Vec<String>>) -> Vec<String> {
    // Where the same path is given again, more of it would not help.
    let different: Vec<_> = lists.iter().collect::<BTreeSet<_>>().into_iter().collect();
    let mut at = vec![0; different.len()];
    loop {
        let mut alike: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (i, list) in different.iter().enumerate() {
            alike.entry(&list[at[i]]).or_default().push(i);
        }
        let can_grow = |i: &usize| at[*i] + 1 < different[*i].len();
        let growing: Vec<_> =
            alike.values().filter(|all| all.len() > 1).flatten().copied().filter(can_grow).collect();
        if growing.is_empty() {
            break;
        }
        for i in growing {
            at[i] += 1;
        }
    }
    let mut names: Vec<String> = Vec::new();
    for list in &lists {
        let place = different.iter().position(|other| *other == list).unwrap_or_default();
        let short = &list[at[place]];
        let numbered = (2..).map(|n| format!("{short} ({n})"));
        let name = std::iter::once(short.clone()).chain(numbered).find(|name| !names.contains(name));
        names.extend(name);
    }
    names
}

/// The text in the bytes of a file, whatever of the usual ways it is stored in: UTF-8 or UTF-16, with a mark or without.
///
/// What is no text in that encoding becomes `�`. This never fails.
pub fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest),
        [0xff, 0xfe, rest @ ..] => Cow::Owned(utf16(rest, u16::from_le_bytes)),
        [0xfe, 0xff, rest @ ..] => Cow::Owned(utf16(rest, u16::from_be_bytes)),
        // Without a mark: JSON begins with two characters of one byte each.
        [first, 0, second, 0, ..] if *first != 0 && *second != 0 => {
            Cow::Owned(utf16(bytes, u16::from_le_bytes))
        }
        [0, first, 0, second, ..] if *first != 0 && *second != 0 => {
            Cow::Owned(utf16(bytes, u16::from_be_bytes))
        }
        _ => String::from_utf8_lossy(bytes),
    }
}

/// Whether bytes are UTF-16 by their mark.
pub fn is_utf16(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff])
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units = bytes.as_chunks::<2>().0.iter().map(|pair| unit(*pair));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

/// A line without what may stand around it and means nothing: a mark of the encoding, spaces, a carriage return.
pub fn trimmed(line: &[u8]) -> &[u8] {
    line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii()
}

/// The whole JSON objects in a damaged line that begin in one of these ways, and where they stand.
///
/// A beginning with a quote in it is never found within a text, for there quotes are escaped.
pub fn objects_in(line: &[u8], beginnings: &[&[u8]]) -> impl Iterator<Item = (Range<usize>, Value)> {
    let mut from = 0;
    std::iter::from_fn(move || {
        loop {
            let is_start = |at: &usize| beginnings.iter().any(|beginning| line[*at..].starts_with(beginning));
            let start = (from..line.len()).find(is_start)?;
            let mut values = serde_json::Deserializer::from_slice(&line[start..]).into_iter();
            if let Some(Ok(value)) = values.next() {
                from = start + values.byte_offset();
                return Some((start..from, value));
            }
            from = start + 1;
        }
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_shown_is_one_short_line_without_anything_hidden(text in any::<String>()) {
            let shown = shown(&text);
            prop_assert!(!shown.is_empty() && !shown.chars().any(is_hidden), "{shown:?}");
            prop_assert!(shown.chars().count() <= 10 * SHOWN + 3, "{shown:?}");
        }

        #[test]
        fn a_cell_is_one_cell_of_one_line(text in any::<String>()) {
            let cell = cell(&text);
            prop_assert!(!cell.chars().any(is_hidden), "{cell:?}");
            let inside = cell.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
            let content = inside.map_or(cell.clone(), |inside| inside.replace("\"\"", "\""));
            let first = content.trim_start().chars().next();
            prop_assert!(!matches!(first, Some('=' | '+' | '-' | '@')), "{cell:?}");
            match inside {
                Some(inside) => prop_assert!(!inside.replace("\"\"", "").contains('"'), "{cell:?}"),
                None => prop_assert!(!cell.contains([',', '"']), "{cell:?}"),
            }
        }

        #[test]
        fn names_are_as_many_as_paths_and_no_two_alike(paths in prop::collection::vec("[ab./]{0,6}", 0..8)) {
            for names in [distinct(&paths), distinct_files(&paths)] {
                let all: BTreeSet<_> = names.iter().collect();
                prop_assert_eq!(all.len(), paths.len(), "{:?}", names);
            }
        }

        #[test]
        fn any_bytes_are_decoded(bytes in any::<Vec<u8>>()) {
            decoded(&bytes);
        }
    }

    #[test]
    fn a_long_name_is_cut_where_it_is_shown_and_whole_in_a_cell() {
        let name = "x".repeat(5000);
        assert_eq!(shown(&name), format!("{}…", "x".repeat(SHOWN)));
        assert_eq!(cell(&name), name);
    }

    #[test]
    fn hidden_characters_are_spelled_out() {
        assert_eq!(shown("a\u{1b}[31mred\u{7}"), r"a\u{1b}[31mred\u{7}");
        assert_eq!(cell("a\u{1b}[31mred\u{7}"), r"a\u{1b}[31mred\u{7}");
        assert_eq!(shown(" a"), "\" a\"");
        for formula in ["=1+1", "+1", "-1", "@SUM(A1)", " =1", "\t=1", "\r=1"] {
            assert!(cell(formula).trim_start_matches('"').starts_with('\''), "{formula:?}");
        }
    }

    #[test]
    fn the_same_path_twice_is_numbered() {
        assert_eq!(distinct(&["a/s", "a/./s", "b/../a/s"]), ["s", "s (2)", "s (3)"]);
        assert_eq!(distinct_files(&["r.json", "./r.json"]), ["r", "r (2)"]);
    }

    #[test]
    fn text_is_read_in_the_usual_encodings() {
        let text = "{\"a\": 1}\r\n";
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for (mark, bytes) in [
            (&b""[..], text.as_bytes()),
            (b"\xef\xbb\xbf", text.as_bytes()),
            (b"\xff\xfe", &little),
            (b"\xfe\xff", &big),
            (b"", &little),
            (b"", &big),
        ] {
            assert_eq!(decoded(&[mark, bytes].concat()), text);
        }
    }
}
