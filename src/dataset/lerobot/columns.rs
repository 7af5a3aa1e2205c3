//! Columns of Parquet files that others wrote: whatever row groups, types and lists they chose.
//!
//! Nothing in such a file is trusted. The footer and the header of every page are looked over before a decoder sees them,
//! so that nothing is allocated that a file merely claims; what a decoder then makes of the rest may be a panic, which
//! is met here.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use parquet::basic::Type as Physical;
use parquet::column::reader::{get_column_reader, get_typed_column_reader};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ParquetMetaData, ParquetMetaDataReader};
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::serialized_reader::SerializedPageReader;

use super::super::parquet_check;
use super::DatasetError;
use super::fault::{self, LeRobotFault};
use super::info::MOST_COMPONENTS;

/// What a Parquet file ends with.
const MAGIC: &[u8] = b"PAR1";
/// The length of the footer and the magic after it.
const TAIL: u64 = 8;
/// Bytes of a footer: with hundreds of columns in thousands of groups of rows.
const MOST_FOOTER: u64 = 32 << 20;
/// Rows of a file.
pub(super) const MOST_ROWS: usize = 20_000_000;
/// Bytes of a page of pictures or texts. Others hold so many numbers.
const MOST_PAGE: usize = 512 << 20;
/// Bytes in which the header of a page ends, with statistics and all.
const MOST_HEADER: usize = 1 << 20;
/// Rows that are decoded at once.
const BATCH: usize = 64;

/// Rows of a file in the order of the file: in which group, and their numbers within it, growing.
pub(super) type Rows = Vec<(usize, Vec<u32>)>;

/// A Parquet file of others.
pub(super) struct Columns {
    file: Positioned,
    metadata: ParquetMetaData,
    path: PathBuf,
}

impl Columns {
    /// Opens the file at `path`, which is needed for `why`.
    pub(super) fn open(path: &Path, why: &str) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(|met| fault::met(met, path, why))?;
        let found = file.metadata().map_err(|met| fault::met(met, path, why))?;
        if !found.is_file() {
            return Err(table("it is no file", path));
        }
        let len = found.len();
        let file = Positioned { file: Arc::new(file), len };
        let disk = |met| fault::met(met, path, why);
        let footer_len = footer_len(&file).map_err(disk)?.ok_or_else(|| LeRobotFault::Killed.at(path))?;
        if footer_len > MOST_FOOTER {
            return Err(table(&format!("its footer has {footer_len} bytes"), path));
        }
        let mut footer = vec![0; footer_len as usize];
        file.file.read_exact_at(&mut footer, len - TAIL - footer_len).map_err(disk)?;
        if !parquet_check::is_footer(&footer) {
            return Err(table("its footer is no footer", path));
        }
        let metadata =
            caught(|| ParquetMetaDataReader::decode_metadata(&footer)).map_err(|why| table(&why, path))?;
        let counts = metadata.row_groups().iter().map(|group| usize::try_from(group.num_rows()).ok());
        let n_rows = counts.into_iter().try_fold(0_usize, |sum, n| sum.checked_add(n?));
        if n_rows.is_none_or(|n| n > MOST_ROWS) {
            return Err(table("it says it has more rows than a file can", path));
        }
        Ok(Self { file, metadata, path: path.to_path_buf() })
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// All rows.
    pub(super) fn all(&self) -> Rows {
        (0..self.metadata.num_row_groups())
            .map(|group| (group, (0..self.n_rows(group) as u32).collect()))
            .collect()
    }

    fn n_rows(&self, group: usize) -> usize {
        self.metadata.row_group(group).num_rows() as usize
    }

    /// The only column of texts, if there is one and no more.
    pub(super) fn only_text(&self) -> Option<String> {
        let schema = self.metadata.file_metadata().schema_descr();
        let texts = schema.columns().iter().filter(|column| column.physical_type() == Physical::BYTE_ARRAY);
        let mut names = texts.filter_map(|column| column.path().parts().first().cloned());
        names.next().filter(|_| names.next().is_none())
    }

    /// Whether there is a column of this name.
    pub(super) fn has(&self, name: &str) -> bool {
        self.leaf(&|parts| parts.first().is_some_and(|first| first == name)).is_some()
    }

    /// Which leaf of the schema is the first that `is_it`.
    fn leaf(&self, is_it: &dyn Fn(&[String]) -> bool) -> Option<usize> {
        let schema = self.metadata.file_metadata().schema_descr();
        schema.columns().iter().position(|column| is_it(column.path().parts()))
    }

    /// The numbers of a column at `rows`, in their order, `width` of them a row: whichever type they have, and whether they
    /// stand in lists or not. What is missing is not a number.
    pub(super) fn numbers(&self, name: &str, width: usize, rows: &Rows) -> Result<Vec<f64>, LeRobotFault> {
        let leaf = self.leaf(&|parts| parts.first().is_some_and(|first| first == name));
        let leaf = leaf.ok_or(LeRobotFault::NoColumn { column: name.to_owned(), wanted: "numbers" })?;
        let physical = self.metadata.file_metadata().schema_descr().column(leaf).physical_type();
        let mut all = Vec::with_capacity(rows.iter().map(|(_, rows)| rows.len()).sum::<usize>() * width);
        for (group, rows) in rows {
            let each = &mut |row: Vec<Option<f64>>| {
                if row.len() != width && row != [None] {
                    return Err(format!("a row has {} numbers, and info.json says {width}", row.len()));
                }
                all.extend((0..width).map(|i| row.get(i).copied().flatten().unwrap_or(f64::NAN)));
                Ok(())
            };
            match physical {
                Physical::BOOLEAN => self.rows::<BoolType, f64>(
                    name,
                    *group,
                    leaf,
                    rows,
                    |value| f64::from(u8::from(*value)),
                    each,
                ),
                Physical::INT32 => {
                    self.rows::<Int32Type, f64>(name, *group, leaf, rows, |value| f64::from(*value), each)
                }
                Physical::INT64 => {
                    self.rows::<Int64Type, f64>(name, *group, leaf, rows, |value| *value as f64, each)
                }
                Physical::FLOAT => {
                    self.rows::<FloatType, f64>(name, *group, leaf, rows, |value| f64::from(*value), each)
                }
                Physical::DOUBLE => {
                    self.rows::<DoubleType, f64>(name, *group, leaf, rows, |value| *value, each)
                }
                other => {
                    Err(LeRobotFault::Column { column: name.to_owned(), why: format!("it holds {other}") })
                }
            }?;
        }
        Ok(all)
    }

    /// Whole numbers of a column at `rows`, none of them negative or missing.
    pub(super) fn counts(&self, name: &str, rows: &Rows) -> Result<Vec<i64>, LeRobotFault> {
        let numbers = self.numbers(name, 1, rows)?;
        let is_count = |number: &f64| number.fract() == 0.0 && (0.0..=1e15).contains(number);
        match numbers.iter().find(|number| !is_count(number)) {
            Some(found) => {
                let why = format!("it has {found}, and must have whole numbers from 0 on");
                Err(LeRobotFault::Column { column: name.to_owned(), why })
            }
            None => Ok(numbers.into_iter().map(|number| number as i64).collect()),
        }
    }

    /// Texts, or other bytes, of a column at `rows`: of itself, or of its member `within` where it has members.
    pub(super) fn bytes(
        &self,
        name: &str,
        member: &str,
        rows: &Rows,
    ) -> Result<Vec<Option<Vec<u8>>>, LeRobotFault> {
        let leaf = self.leaf(&|parts| match parts {
            [one] => one == name,
            [one, two] => one == name && two == member,
            _ => false,
        });
        let leaf =
            leaf.ok_or(LeRobotFault::NoColumn { column: name.to_owned(), wanted: "texts or pictures" })?;
        let column = self.metadata.file_metadata().schema_descr().column(leaf);
        if column.physical_type() != Physical::BYTE_ARRAY {
            let why = format!("it holds {}", column.physical_type());
            return Err(LeRobotFault::Column { column: name.to_owned(), why });
        }
        let mut all = Vec::new();
        for (group, rows) in rows {
            // Copied, for each would keep all of its page.
            let copied = |value: &ByteArray| value.data().to_vec();
            self.rows::<ByteArrayType, Vec<u8>>(name, *group, leaf, rows, copied, &mut |mut row| {
                all.push(row.pop().flatten());
                Ok(())
            })?;
        }
        Ok(all)
    }

    /// Calls `each` with the values of each of `rows` of a group.
    fn rows<T: DataType, V>(
        &self,
        name: &str,
        group: usize,
        leaf: usize,
        rows: &[u32],
        value: impl Fn(&T::T) -> V,
        each: &mut dyn FnMut(Vec<Option<V>>) -> Result<(), String>,
    ) -> Result<(), LeRobotFault> {
        let fault = |why: String| LeRobotFault::Column { column: name.to_owned(), why };
        let (Some(&first), Some(&last)) = (rows.first(), rows.last()) else { return Ok(()) };
        let descriptor = self.metadata.file_metadata().schema_descr().column(leaf);
        let [most_defined, most_repeated] = [descriptor.max_def_level(), descriptor.max_rep_level()];
        self.check_pages(group, leaf).map_err(fault)?;
        let open = || {
            let chunk = self.metadata.row_group(group).column(leaf);
            let pages =
                SerializedPageReader::new(Arc::new(self.file.clone()), chunk, self.n_rows(group), None)?;
            let mut reader =
                get_typed_column_reader::<T>(get_column_reader(descriptor.clone(), Box::new(pages)));
            let skipped = reader.skip_records(first as usize)?;
            Ok((reader, skipped))
        };
        let (mut reader, skipped) = caught(open).map_err(fault)?;
        if skipped != first as usize {
            return Err(fault(format!("it ends after {skipped} rows")));
        }
        let (mut at, mut wanted) = (first, rows.iter().copied().peekable());
        let (mut values, mut defined, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
        while at <= last {
            values.clear();
            defined.clear();
            repeated.clear();
            let n = BATCH.min((last - at) as usize + 1);
            let (read, n_values, n_levels) =
                caught(|| reader.read_records(n, Some(&mut defined), Some(&mut repeated), &mut values))
                    .map_err(fault)?;
            if read == 0 {
                return Err(fault(format!("it ends after {at} rows")));
            }
            // Without levels every value is there, and a row of its own.
            let n_levels = n_levels.max(n_values);
            let is_there = |level: usize| most_defined == 0 || defined.get(level) == Some(&most_defined);
            let begins = |level: usize| most_repeated == 0 || repeated.get(level) == Some(&0);
            let mut left = values.iter();
            let mut level = 0;
            for row in at..at + read as u32 {
                let mut found = Vec::new();
                while level < n_levels && (found.is_empty() || !begins(level)) {
                    found.push(if is_there(level) { left.next().map(&value) } else { None });
                    level += 1;
                }
                if wanted.next_if_eq(&row).is_some() {
                    each(found).map_err(fault)?;
                }
            }
            at += read as u32;
        }
        Ok(())
    }

    /// Fails where the pages of a column do not lie one after the other in it, or claim more than they can hold.
    fn check_pages(&self, group: usize, leaf: usize) -> Result<(), String> {
        let chunk = self.metadata.row_group(group).column(leaf);
        let descriptor = self.metadata.file_metadata().schema_descr().column(leaf);
        let start = chunk.dictionary_page_offset().unwrap_or(chunk.data_page_offset());
        let ends = u64::try_from(start).ok().zip(u64::try_from(chunk.compressed_size()).ok());
        let ends = ends.and_then(|(start, len)| Some([start, start.checked_add(len)?]));
        let [mut at, end] =
            ends.filter(|[_, end]| *end <= self.file.len).ok_or("its pages lie outside of the file")?;
        let most_values = self.n_rows(group).saturating_mul(MOST_COMPONENTS);
        let n_values = usize::try_from(chunk.num_values()).ok().filter(|&n| n <= most_values);
        let n_values = n_values.ok_or("it says it has more values than a column can")?;
        let most = match descriptor.physical_type() {
            Physical::BYTE_ARRAY | Physical::FIXED_LEN_BYTE_ARRAY => MOST_PAGE,
            _ => super::super::limits::page_bytes(n_values).min(MOST_PAGE),
        };
        let mut left = n_values;
        while at < end {
            let page = self.page(at, end).map_err(|met| met.to_string())?;
            let unknown = "its pages are stored in a way that is not read here (versions after 1, or an encoding by \
                           differences); write the file again with pyarrow's usual settings";
            let (page, header_len) = page.ok_or(unknown)?;
            if page.uncompressed > most.max(page.compressed) || page.uncompressed > MOST_PAGE {
                return Err(format!("a page of it claims {} bytes", page.uncompressed));
            }
            left = left.checked_sub(page.n_values).ok_or("its pages hold more values than it has")?;
            at = at.saturating_add(header_len as u64).saturating_add(page.compressed as u64);
        }
        if at != end || left > 0 {
            return Err("its pages do not hold its values".to_owned());
        }
        Ok(())
    }

    /// The header of the page at `at`, and its length; nothing where it is of an unknown kind.
    fn page(&self, at: u64, end: u64) -> io::Result<Option<(parquet_check::Page, usize)>> {
        for most in [4 << 10, MOST_HEADER] {
            let mut bytes = vec![0; (end - at).min(most as u64) as usize];
            self.file.file.read_exact_at(&mut bytes, at)?;
            if let Some(found) = parquet_check::page_header(&bytes) {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }
}

/// How long the footer is; nothing where the file ends in none.
fn footer_len(file: &Positioned) -> io::Result<Option<u64>> {
    let Some(at) = file.len.checked_sub(TAIL) else { return Ok(None) };
    let mut tail = [0; TAIL as usize];
    file.file.read_exact_at(&mut tail, at)?;
    let len = tail.strip_suffix(MAGIC).and_then(|len| len.first_chunk::<4>());
    let len = len.map(|len| u64::from(u32::from_le_bytes(*len)));
    Ok(len.filter(|len| at.checked_sub(*len).is_some_and(|start| start >= MAGIC.len() as u64)))
}

/// Whether the file at `path` ends as a Parquet file does.
pub(super) fn is_whole(path: &Path) -> bool {
    let footer = File::open(path).and_then(|file| {
        let len = file.metadata()?.len();
        footer_len(&Positioned { file: Arc::new(file), len })
    });
    footer.is_ok_and(|len| len.is_some())
}

fn table(why: &str, path: &Path) -> DatasetError {
    LeRobotFault::Table(why.to_owned()).at(path)
}

/// What a decoder that trusts its input makes of it; a panic is an error.
fn caught<T>(decode: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(decode)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(met)) => Err(crate::text::shown_within(&met.to_string(), 300)),
        Err(_) => Err("there is no sense in it".to_owned()),
    }
}

/// A file that is read at given places, by several at once.
#[derive(Clone)]
struct Positioned {
    file: Arc<File>,
    len: u64,
}

impl Length for Positioned {
    fn len(&self) -> u64 {
        self.len
    }
}

impl ChunkReader for Positioned {
    type T = BufReader<From>;

    fn get_read(&self, start: u64) -> parquet::errors::Result<Self::T> {
        Ok(BufReader::new(From { file: Arc::clone(&self.file), at: start }))
    }

    fn get_bytes(&self, start: u64, length: usize) -> parquet::errors::Result<Bytes> {
        if start.checked_add(length as u64).is_none_or(|end| end > self.len) {
            return Err(ParquetError::EOF("a page ends behind the file".to_owned()));
        }
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, start)?;
        Ok(bytes.into())
    }
}

/// The bytes of a file from a place on.
struct From {
    file: Arc<File>,
    at: u64,
}

impl Read for From {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read_at(bytes, self.at)?;
        self.at += n as u64;
        Ok(n)
    }
}
