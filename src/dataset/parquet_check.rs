//! Looks over structures in Thrift's compact protocol, of which Parquet's footers and page headers are made, before a
//! decoder allocates what they claim.

/// How deep structures may lie in each other.
const DEPTH: usize = 16;
/// How many columns, and groups of columns, a table may have, and how deep they may lie in each other.
const ELEMENTS: usize = 10_000;
const ELEMENT_DEPTH: usize = 32;

/// How values are stored: plain, or as runs of numbers, which may be those of a dictionary's entries.
const ENCODINGS: [usize; 4] = [0, 2, 3, 8];

/// Whether all of `bytes` is the footer of a Parquet file: a well-formed structure, and no group of columns in it claims
/// more of them than there are.
pub(super) fn is_footer(bytes: &[u8]) -> bool {
    let mut walk = Walk { rest: bytes };
    walk.footer().is_some() && walk.rest.is_empty()
}

/// Whether `pages` are pages from the first byte to the last, of at most `page_bytes` bytes each, which together hold
/// `n_values` values.
pub(super) fn pages_hold(pages: &[u8], n_values: usize, page_bytes: usize) -> bool {
    let mut walk = Walk { rest: pages };
    let mut left = n_values;
    while !walk.rest.is_empty() {
        let Some(page) = walk.page() else { return false };
        // What is stored as it is may be as large as it is.
        let is_sane = page.uncompressed <= page_bytes.max(page.compressed);
        let (Some(rest), true) = (walk.rest.get(page.compressed..), is_sane) else { return false };
        let Some(still) = left.checked_sub(page.n_values) else { return false };
        (walk.rest, left) = (rest, still);
    }
    left == 0
}

/// The header at the beginning of `bytes`, and how long it is. None where it is cut, or not one of a page that is known.
pub(super) fn page_header(bytes: &[u8]) -> Option<(Page, usize)> {
    let mut walk = Walk { rest: bytes };
    let page = walk.page()?;
    Some((page, bytes.len() - walk.rest.len()))
}

/// What the header of a page claims.
pub(super) struct Page {
    pub(super) uncompressed: usize,
    pub(super) compressed: usize,
    /// Of the column. Those of a dictionary are none.
    pub(super) n_values: usize,
}

/// What is still to be looked over.
struct Walk<'a> {
    rest: &'a [u8],
}

impl Walk<'_> {
    fn take(&mut self, n: usize) -> Option<&[u8]> {
        let (taken, rest) = self.rest.split_at_checked(n)?;
        self.rest = rest;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|byte| byte[0])
    }

    fn varint(&mut self) -> Option<u64> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(number);
            }
        }
        None
    }

    /// A whole number that must not be negative.
    fn size(&mut self) -> Option<usize> {
        let zigzag = self.varint()?;
        if zigzag & 1 == 0 { usize::try_from(zigzag >> 1).ok() } else { None }
    }

    /// The next field's number and type, given the number of the one before. Nothing at the end of the structure.
    fn field(&mut self, before: i64) -> Option<Option<(i64, u8)>> {
        let head = self.byte()?;
        if head == 0 {
            return Some(None);
        }
        let id = match i64::from(head >> 4) {
            0 => {
                let zigzag = self.varint()?;
                (zigzag >> 1) as i64 ^ -((zigzag & 1) as i64)
            }
            delta => before.checked_add(delta)?,
        };
        Some(Some((id, head & 15)))
    }

    /// The length of a list, and the type of its elements, which take a byte each at least.
    fn list(&mut self) -> Option<(usize, u8)> {
        let head = self.byte()?;
        let len = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
        let len = usize::try_from(len).ok().filter(|&len| len <= self.rest.len())?;
        Some((len, head & 15))
    }

    fn footer(&mut self) -> Option<()> {
        let mut before = 0;
        while let Some((id, kind)) = self.field(before)? {
            match (id, kind) {
                (2, 9) => self.schema()?,
                (_, 1 | 2) => {}
                (_, kind) => self.skip(kind, 0)?,
            }
            before = id;
        }
        Some(())
    }

    /// The elements of a schema: each group is followed by its children.
    fn schema(&mut self) -> Option<()> {
        let (len, kind) = self.list()?;
        if kind != 12 || len > ELEMENTS {
            return None;
        }
        // How many children of each group around the next element are still to come.
        let mut groups: Vec<usize> = Vec::new();
        for left in (0..len).rev() {
            if let Some(children) = groups.last_mut() {
                *children -= 1;
            }
            let children = self.schema_element()?;
            if children > left || groups.len() >= ELEMENT_DEPTH {
                return None;
            }
            if children > 0 {
                groups.push(children);
            }
            while groups.last() == Some(&0) {
                groups.pop();
            }
        }
        groups.is_empty().then_some(())
    }

    /// How many children an element of a schema has.
    fn schema_element(&mut self) -> Option<usize> {
        let (mut before, mut children) = (0, 0);
        while let Some((id, kind)) = self.field(before)? {
            match (id, kind) {
                (5, 5) => children = self.size()?,
                (_, 1 | 2) => {}
                (_, kind) => self.skip(kind, 1)?,
            }
            before = id;
        }
        Some(children)
    }

    fn skip_struct(&mut self, depth: usize) -> Option<()> {
        let mut before = 0;
        while let Some((id, kind)) = self.field(before)? {
            // A truth value stands in its field's type.
            if !matches!(kind, 1 | 2) {
                self.skip(kind, depth)?;
            }
            before = id;
        }
        Some(())
    }

    fn skip(&mut self, kind: u8, depth: usize) -> Option<()> {
        if depth > DEPTH {
            return None;
        }
        match kind {
            1..=3 => self.byte().map(drop),
            4..=6 => self.varint().map(drop),
            7 => self.take(8).map(drop),
            8 => {
                let len = usize::try_from(self.varint()?).ok()?;
                self.take(len).map(drop)
            }
            9 | 10 => {
                let (len, kind) = self.list()?;
                (0..len).try_for_each(|_| self.skip(kind, depth + 1))
            }
            12 => self.skip_struct(depth + 1),
            // Parquet has no maps.
            _ => None,
        }
    }

    /// The header of a page.
    fn page(&mut self) -> Option<Page> {
        let (mut uncompressed, mut compressed, mut n_values) = (None, None, None);
        let mut before = 0;
        while let Some((id, kind)) = self.field(before)? {
            match (id, kind) {
                (2, 5) => uncompressed = Some(self.size()?),
                (3, 5) => compressed = Some(self.size()?),
                (5, 12) => n_values = Some(self.values()?),
                (7, 12) => {
                    self.values()?;
                    n_values = Some(0);
                }
                (_, 1 | 2) => {}
                (_, kind) => self.skip(kind, 0)?,
            }
            before = id;
        }
        Some(Page { uncompressed: uncompressed?, compressed: compressed?, n_values: n_values? })
    }

    /// How many values a page of the first version or a dictionary claims, in an encoding that we write.
    fn values(&mut self) -> Option<usize> {
        let Some((1, 5)) = self.field(0)? else { return None };
        let n_values = self.size()?;
        let mut before = 1;
        while let Some((id, kind)) = self.field(before)? {
            match (id, kind) {
                // Of the values, then of two kinds of levels.
                (2..=4, 5) => drop(Some(self.size()?).filter(|encoding| ENCODINGS.contains(encoding))?),
                (_, 1 | 2) => {}
                (_, kind) => self.skip(kind, 1)?,
            }
            before = id;
        }
        Some(n_values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_that_claims_more_than_there_is_is_no_structure() {
        assert!(is_footer(&[0]), "an empty one");
        // Field 1, a list of three 32-bit numbers.
        assert!(is_footer(&[0x19, 0x35, 2, 4, 6, 0]));
        assert!(!is_footer(&[0x19, 0x35, 2, 4, 0]), "of two");
        // Of 2^35 empty structures.
        assert!(!is_footer(&[0x19, 0xfc, 0xff, 0xff, 0xff, 0xff, 0x7f, 0, 0]));
        assert!(!is_footer(&[0x1c; 100]), "structures without an end");
    }

    #[test]
    fn a_schema_that_claims_more_columns_than_there_are_is_no_footer() {
        // Field 2, a list of structures, each with its number of children in field 5.
        let footer = |children: &[u8]| {
            let elements = children.iter().flat_map(|&children| [0x55, 2 * children, 0]);
            [0x29, ((children.len() as u8) << 4) + 12]
                .into_iter()
                .chain(elements)
                .chain([0])
                .collect::<Vec<_>>()
        };
        assert!(is_footer(&footer(&[3, 0, 1, 0, 0])));
        assert!(!is_footer(&footer(&[60, 0, 1, 0, 0])), "of 60");
        assert!(!is_footer(&footer(&[4, 0, 1, 0, 0])), "one is missing");
        let deep: Vec<u8> =
            [0x29, 0xfc, 100].into_iter().chain([0x55, 2, 0].repeat(99)).chain([0x55, 0, 0, 0]).collect();
        assert!(!is_footer(&deep), "a hundred groups in each other");
    }

    #[test]
    fn a_page_that_claims_more_than_it_can_hold_is_refused() {
        // Type 0, 8 bytes of 8 compressed ones, a data page of 2 values.
        let encoded = |uncompressed: u8, n_values: u8, encoding: u8| {
            let head = [
                0x15,
                0,
                0x15,
                2 * uncompressed,
                0x15,
                16,
                0x2c,
                0x15,
                2 * n_values,
                0x15,
                2 * encoding,
                0,
                0,
            ];
            [head.as_slice(), &[7; 8]].concat()
        };
        let page = |uncompressed, n_values| encoded(uncompressed, n_values, 0);
        assert!(pages_hold(&page(8, 2), 2, 8));
        assert!(pages_hold(&[page(8, 2), page(8, 1)].concat(), 3, 8));
        assert!(!pages_hold(&page(60, 2), 2, 16), "it would grow to 60 bytes");
        assert!(!pages_hold(&page(8, 2), 3, 8), "a value is missing");
        assert!(!pages_hold(&page(8, 3), 2, 8), "a value too many");
        assert!(!pages_hold(&page(8, 2)[..17], 2, 8), "cut");
        assert!(!pages_hold(&encoded(8, 2, 9), 2, 8), "in an encoding that we never wrote");
    }
}
