//! Reading what the window once wrote down about itself, as far as it can be read.
//!
//! Settings are RON, as `eframe` writes it. Its own reader takes all of a text or nothing; this one takes each field by
//! itself, says which it could not read, and goes on after it.

/// So many brackets within each other are more than anybody wrote.
const DEEPEST: usize = 32;

/// A value that was read.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    /// A name or a number, as it is written.
    Word(String),
    /// What stands in quotes.
    Text(String),
    /// `[a, b]`.
    List(Vec<Self>),
    /// `{a: b}`.
    Map(Vec<(Self, Self)>),
    /// `(a: b)`.
    Fields(Vec<(String, Self)>),
    /// `name(a, b)`.
    Call(String, Vec<Self>),
}

/// A field at the top, which may have to be kept as it was written.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) name: String,
    /// How its value is written, if that could be read.
    pub(super) text: String,
    /// Its value, if that could be read.
    pub(super) value: Option<Value>,
}

/// The fields of `(name: value, …)`, and whether that is all of the text.
pub(super) fn fields_of(text: &str) -> (Vec<Field>, bool) {
    let mut reader = Reader { text, at: 0, depth: 0 };
    let mut fields = Vec::new();
    let is_whole = reader.top(&mut fields).is_some();
    (fields, is_whole)
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
}

impl Reader<'_> {
    /// All fields; nothing where the text ends before they do, or goes on after them.
    fn top(&mut self, fields: &mut Vec<Field>) -> Option<()> {
        self.word();
        self.expect('(')?;
        loop {
            if self.next_is(')') {
                self.blank();
                return (self.at == self.text.len()).then_some(());
            }
            let name = self.word()?;
            self.expect(':')?;
            self.blank();
            let from = self.at;
            let value = self.value();
            let text = self.text[from..self.at].to_owned();
            let value = value.filter(|_| self.is_at_end_of_value());
            if value.is_none() {
                self.at = from;
                self.skip();
            }
            // What is cut short may have been something else.
            if !self.is_at_end_of_value() {
                return None;
            }
            fields.push(Field { name, text, value });
            self.next_is(',');
        }
    }

    fn is_at_end_of_value(&mut self) -> bool {
        self.blank();
        matches!(self.peek(), Some(',' | ')'))
    }

    fn peek(&self) -> Option<char> {
        self.text[self.at..].chars().next()
    }

    fn take(&mut self) -> Option<char> {
        let next = self.peek()?;
        self.at += next.len_utf8();
        Some(next)
    }

    /// Passes over white space and comments.
    fn blank(&mut self) {
        loop {
            let rest = &self.text[self.at..];
            let passed = if rest.starts_with("//") {
                rest.find('\n').unwrap_or(rest.len())
            } else if rest.starts_with("/*") {
                rest.find("*/").map_or(rest.len(), |end| end + 2)
            } else {
                rest.len() - rest.trim_start().len()
            };
            if passed == 0 {
                return;
            }
            self.at += passed;
        }
    }

    fn next_is(&mut self, wanted: char) -> bool {
        self.blank();
        let is_next = self.peek() == Some(wanted);
        self.at += if is_next { wanted.len_utf8() } else { 0 };
        is_next
    }

    fn expect(&mut self, wanted: char) -> Option<()> {
        self.next_is(wanted).then_some(())
    }

    fn word(&mut self) -> Option<String> {
        self.blank();
        let rest = &self.text[self.at..];
        let is_in_word = |c: char| c.is_alphanumeric() || "_+-.#".contains(c);
        let len = rest.find(|c| !is_in_word(c)).unwrap_or(rest.len());
        self.at += len;
        (len > 0).then(|| rest[..len].to_owned())
    }

    fn value(&mut self) -> Option<Value> {
        self.depth += 1;
        let value = if self.depth > DEEPEST { None } else { self.any_value() };
        self.depth -= 1;
        value
    }

    fn any_value(&mut self) -> Option<Value> {
        self.blank();
        match self.peek()? {
            '"' => self.quoted().map(Value::Text),
            '[' => {
                self.take();
                self.until(']', Self::value).map(Value::List)
            }
            '{' => {
                self.take();
                let pair = |reader: &mut Self| {
                    let key = reader.value()?;
                    reader.expect(':')?;
                    Some((key, reader.value()?))
                };
                self.until('}', pair).map(Value::Map)
            }
            '(' => self.round(String::new()),
            _ => {
                let word = self.word()?;
                let end = self.at;
                if self.next_is('(') {
                    self.at -= 1;
                    return self.round(word);
                }
                self.at = end;
                Some(Value::Word(word))
            }
        }
    }

    /// What stands in round brackets: fields where the first has a name, and values otherwise.
    fn round(&mut self, name: String) -> Option<Value> {
        self.expect('(')?;
        let from = self.at;
        let is_named = self.word().is_some() && self.next_is(':');
        self.at = from;
        if !is_named {
            return self.until(')', Self::value).map(|values| Value::Call(name, values));
        }
        let field = |reader: &mut Self| {
            let name = reader.word()?;
            reader.expect(':')?;
            Some((name, reader.value()?))
        };
        self.until(')', field).map(Value::Fields)
    }

    /// Items with commas between them, and maybe one after the last.
    fn until<T>(&mut self, end: char, item: impl Fn(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let mut items = Vec::new();
        while !self.next_is(end) {
            items.push(item(self)?);
            if !self.next_is(',') {
                self.expect(end)?;
                break;
            }
        }
        Some(items)
    }

    fn quoted(&mut self) -> Option<String> {
        self.expect('"')?;
        let mut text = String::new();
        loop {
            match self.take()? {
                '"' => return Some(text),
                '\\' => text.push(self.escaped()?),
                other => text.push(other),
            }
        }
    }

    fn escaped(&mut self) -> Option<char> {
        Some(match self.take()? {
            'n' => '\n',
            'r' => '\r',
            't' => '\t',
            '0' => '\0',
            'x' => {
                let digits = self.text.get(self.at..self.at + 2)?;
                self.at += 2;
                char::from(u8::from_str_radix(digits, 16).ok()?)
            }
            'u' => {
                let rest = &self.text[self.at..];
                let (digits, _) = rest.strip_prefix('{')?.split_once('}')?;
                self.at += digits.len() + 2;
                char::from_u32(u32::from_str_radix(digits, 16).ok()?)?
            }
            other => other,
        })
    }

    /// Passes over a value that cannot be read, to the comma or bracket after it.
    fn skip(&mut self) {
        let mut depth = 0_usize;
        while let Some(next) = self.peek() {
            match next {
                '"' => {
                    if self.quoted().is_none() {
                        self.at = self.text.len();
                    }
                    continue;
                }
                ',' | ')' if depth == 0 => return,
                '(' | '[' | '{' => depth += 1,
                ')' | ']' | '}' => depth = depth.saturating_sub(1),
                _ => {}
            }
            self.take();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn word(word: &str) -> Value {
        Value::Word(word.to_owned())
    }

    /// The names of the fields that could be read, with their values, and whether that is all.
    fn read(text: &str) -> (Vec<(String, Option<Value>)>, bool) {
        let (fields, is_whole) = fields_of(text);
        (fields.into_iter().map(|field| (field.name, field.value)).collect(), is_whole)
    }

    #[test]
    fn every_kind_of_value_is_read() {
        let text = r#"(a: Dark, b: -1.5e3, c: "x \"y\" \u{e9}\\", d: [A, B,], e: {K: [L], 1: "m"},
            f: (g: 1, h: (i: true)), /* and */ j: queries(500), k: (), // the end
            l: None)"#;
        let fields = |fields: &[(&str, Value)]| {
            Value::Fields(fields.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect())
        };
        let expected = [
            ("a", word("Dark")),
            ("b", word("-1.5e3")),
            ("c", Value::Text("x \"y\" é\\".to_owned())),
            ("d", Value::List(vec![word("A"), word("B")])),
            (
                "e",
                Value::Map(vec![
                    (word("K"), Value::List(vec![word("L")])),
                    (word("1"), Value::Text("m".to_owned())),
                ]),
            ),
            ("f", fields(&[("g", word("1")), ("h", fields(&[("i", word("true"))]))])),
            ("j", Value::Call("queries".to_owned(), vec![word("500")])),
            ("k", Value::Call(String::new(), Vec::new())),
            ("l", word("None")),
        ];
        let expected = expected.map(|(name, value)| (name.to_owned(), Some(value)));
        assert_eq!(read(text), (expected.into(), true));
    }

    #[test]
    fn a_field_that_cannot_be_read_does_not_take_the_others_along() {
        let (fields, is_whole) = read(r#"(a: 1, b: @@[(",)"@@, c: [1, 2, d: (e 3), f: 4)"#);
        let readable: Vec<_> = fields.iter().filter(|(_, value)| value.is_some()).collect();
        assert_eq!(readable[0], &("a".to_owned(), Some(word("1"))));
        assert!(!is_whole, "a list that is never closed swallows the rest");
        let (fields, is_whole) = read("(a: @, b: [1 2], c: 3)");
        let expected = [("a", None), ("b", None), ("c", Some(word("3")))];
        assert_eq!((fields, is_whole), (expected.map(|(name, value)| (name.to_owned(), value)).into(), true));
    }

    #[test]
    fn of_a_text_that_is_cut_short_what_is_whole_is_read() {
        let text = r#"(a: Dark, b: 25.0, c: "anna", d: [A, B])"#;
        for end in 0..text.len() {
            let (fields, is_whole) = fields_of(&text[..end]);
            assert!(!is_whole, "{end}");
            let whole = text[..end].matches(", ").count().min(3);
            assert!(fields.len() <= whole + 1 && fields.iter().all(|field| field.value.is_some()), "{end}");
        }
        let (fields, _) = fields_of("(a: Dark, b: 2");
        assert_eq!(fields.len(), 1, "it may have been 25");
    }

    #[test]
    fn what_is_written_in_a_field_can_be_kept_as_it_is() {
        let (fields, _) = fields_of("(a: 1, later: { x : [ 1, (y: 2) ] } , b: 3 // three\n)");
        assert_eq!((&*fields[1].text, &*fields[2].text), ("{ x : [ 1, (y: 2) ] }", "3"));
    }

    #[test]
    fn no_depth_of_brackets_is_too_much_for_it() {
        for deep in ["(", "[", "{", "(a:", "x("] {
            let text = format!("(a: {}", deep.repeat(100_000));
            assert!(!fields_of(&text).1);
            let text = format!("(a: {}, b: 1)", deep.repeat(20));
            assert!(!fields_of(&text).1);
        }
    }
}
