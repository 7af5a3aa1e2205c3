//! Small Parquet tables, column by column, as `pyarrow` would have written them, so that older readers open them.
//!
//! Two notes in the footer tell a file that is as it was written from one that is not, before a decoder that trusts its
//! input sees it: `dropj.sha256` (how many bytes stand before the footer, and their SHA-256) and
//! `dropj.sha256.footer` (the SHA-256 of the footer, its own 64 digits taken as zeros).

use std::io::{self, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use bytes::Bytes;
use parquet::basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::column::reader::get_typed_column_reader;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::{ColumnChunkMetaData, FileMetaData, KeyValue, ParquetMetaDataReader};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};
use sha2::{Digest as _, Sha256};

use super::damage::TableError;
use super::hex::to_hex;
use super::{limits, parquet_check};

/// The key of the note that covers all that stands before the footer: how many bytes, and their SHA-256.
const SHA256: &str = "dropj.sha256";
/// The key of the note that covers the footer.
const FOOTER_SHA256: &str = "dropj.sha256.footer";
/// What stands before the digits of that note: its key, then a binary field of 64 bytes.
const FOOTER_MARK: &[u8] = b"dropj.sha256.footer\x18\x40";
/// Digits of a SHA-256.
const N_DIGITS: usize = 64;
/// What a Parquet file begins and ends with.
const MAGIC: &[u8] = b"PAR1";
/// The length of the footer and the magic after it.
const TAIL: usize = 8;
/// What the name of the program that wrote a file begins with, where that was this one.
const CREATED_BY: &str = "dropj ";

/// A column of a table.
pub(super) enum Column {
    /// `bool`
    Bools(Vec<bool>),
    /// `int64`
    Ints(Vec<i64>),
    /// `uint64`
    Unsigned(Vec<u64>),
    /// `float32`
    Floats(Vec<f32>),
    /// `string`
    Texts(Vec<String>),
    /// `list<string>`, one a row
    TextLists(Vec<String>),
    /// `list<float32>` of as many components each
    FloatLists(usize, Vec<f32>),
    /// `float64` in so many lists of lists, all the components of a row
    DoubleLists(usize, Vec<Vec<f64>>),
    /// `struct<bytes: binary, path: string>`: PNG files without a path
    Images(Vec<ByteArray>),
}

/// A column of a table of results.
pub enum TableColumn {
    /// `int64`
    Ints(Vec<i64>),
    /// `float32`
    Floats(Vec<f32>),
    /// `string`
    Texts(Vec<String>),
}

/// A table of results as the bytes of a Parquet file.
///
/// # Errors
/// Where the columns are not equally long, or cannot be written.
pub fn table_bytes(columns: Vec<(String, TableColumn)>) -> Result<Vec<u8>> {
    let columns = columns.into_iter().map(|(name, column)| {
        let column = match column {
            TableColumn::Ints(values) => Column::Ints(values),
            TableColumn::Floats(values) => Column::Floats(values),
            TableColumn::Texts(values) => Column::Texts(values),
        };
        (name, column)
    });
    to_parquet(columns.collect(), Vec::new())
}

/// A table as the bytes of a Parquet file of one row group, with notes in its footer.
pub(super) fn to_parquet(columns: Vec<(String, Column)>, notes: Vec<(String, String)>) -> Result<Vec<u8>> {
    let fields = columns.iter().map(|(name, column)| column.field(name)).collect::<Result<_>>()?;
    let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
    let mut properties = WriterProperties::builder()
        .set_created_by(format!("{CREATED_BY}{}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .set_write_batch_size(64)
        .set_offset_index_disabled(true)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_key_value_metadata(Some(
            notes.into_iter().map(|(key, note)| KeyValue::new(key, note)).collect(),
        ));
    for (name, column) in &columns {
        if let Column::Images(_) = column {
            // A PNG is compressed already, and no two are alike.
            let bytes = ColumnPath::new(vec![name.clone(), "bytes".into()]);
            properties = properties
                .set_column_compression(bytes.clone(), Compression::UNCOMPRESSED)
                .set_column_dictionary_enabled(bytes.clone(), false)
                .set_column_statistics_enabled(bytes, EnabledStatistics::None);
        }
    }
    let n_leaves = columns.iter().map(|(_, column)| column.n_leaves()).sum();
    let mut file = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut file, Arc::new(schema), Arc::new(properties.build()))?;
    let mut row_group = writer.next_row_group()?;
    for (_, column) in columns {
        column.write(&mut row_group)?;
    }
    row_group.close()?;
    writer.flush()?;
    let checked = writer.inner();
    let sha256 = format!("{} {}", checked.len(), to_hex(&Sha256::digest(checked.as_slice())));
    writer.append_key_value_metadata(KeyValue::new(SHA256.to_owned(), sha256));
    writer.append_key_value_metadata(KeyValue::new(FOOTER_SHA256.to_owned(), "0".repeat(N_DIGITS)));
    writer.close()?;
    order_as_types_do(&mut file, n_leaves)?;
    sign_footer(&mut file)?;
    Ok(file)
}

/// Says of every column that its statistics are in the order of its type.
///
/// Of floats the writer says that they are in IEEE 754's total order, which readers older than 2026 refuse. Among the
/// finite numbers that we write, both are the same. The orders stand at the very end of the footer, three bytes each.
pub fn order_as_types_do(file: &mut [u8], n_leaves: usize) -> Result<()> {
    const TYPE_DEFINED: [u8; 3] = [0x1c, 0, 0];
    const TOTAL: [u8; 3] = [0x2c, 0, 0];
    let not_there =
        || ParquetError::General("the footer does not end in the orders of its columns".to_owned());
    // After them: the end of the footer's structure, then the tail.
    let end = file.len().checked_sub(TAIL + 1).ok_or_else(not_there)?;
    let orders = file.get_mut(..end).and_then(|all| {
        let start = all.len().checked_sub(3 * n_leaves)?;
        Some(all[start..].as_chunks_mut().0)
    });
    for order in orders.ok_or_else(not_there)? {
        if ![TYPE_DEFINED, TOTAL].contains(order) {
            return Err(not_there());
        }
        *order = TYPE_DEFINED;
    }
    Ok(())
}

/// Puts the SHA-256 of the footer where zeros keep its place.
pub(super) fn sign_footer(file: &mut [u8]) -> Result<()> {
    let no_place = || ParquetError::General("there is no place for the checksum of the footer".to_owned());
    let start = footer_start(file).ok_or_else(no_place)?;
    let (digits, sha256) = footer_sha256(&file[start..]).ok_or_else(no_place)?;
    file[start..][digits].copy_from_slice(sha256.as_bytes());
    Ok(())
}

/// Makes the checksum of the pages right, as only somebody can who means harm.
#[cfg(test)]
pub(super) fn sign_pages(file: &mut [u8]) -> Option<()> {
    let start = footer_start(file)?;
    let sha256 = to_hex(&Sha256::digest(&file[..start]));
    let told = format!("{start} ");
    let at =
        file[start..].windows(told.len()).position(|bytes| bytes == told.as_bytes())? + start + told.len();
    file.get_mut(at..at + N_DIGITS)?.copy_from_slice(sha256.as_bytes());
    sign_footer(file).ok()
}

/// Where the footer of a whole file begins.
fn footer_start(file: &[u8]) -> Option<usize> {
    let len = footer_len(*file.last_chunk()?)?;
    file.len().checked_sub(TAIL)?.checked_sub(len).filter(|&start| start >= MAGIC.len())
}

/// How long the footer before the last bytes of a file is.
fn footer_len(tail: [u8; TAIL]) -> Option<usize> {
    let len = tail.strip_suffix(MAGIC)?;
    Some(u32::from_le_bytes(*len.first_chunk()?) as usize)
}

/// Where the digits of its checksum stand in a footer (with or without the tail), and what they should be.
fn footer_sha256(footer: &[u8]) -> Option<(std::ops::Range<usize>, String)> {
    let at = footer.windows(FOOTER_MARK.len()).rposition(|bytes| bytes == FOOTER_MARK)? + FOOTER_MARK.len();
    let (before, rest) = footer.split_at(at);
    let after = rest.get(N_DIGITS..)?;
    let mut hasher = Sha256::new();
    hasher.update(before);
    hasher.update([b'0'; N_DIGITS]);
    hasher.update(after);
    Some((at..at + N_DIGITS, to_hex(&hasher.finalize())))
}

impl Column {
    /// How many leaves of the schema it takes.
    fn n_leaves(&self) -> usize {
        match self {
            Self::Images(_) => 2,
            _ => 1,
        }
    }

    /// The column's place in the schema.
    fn field(&self, name: &str) -> Result<TypePtr> {
        match self {
            Self::Bools(_) => leaf(name, Physical::BOOLEAN, None),
            Self::Ints(_) => leaf(name, Physical::INT64, None),
            Self::Unsigned(_) => leaf(name, Physical::INT64, Some(LogicalType::integer(64, false))),
            Self::Floats(_) => leaf(name, Physical::FLOAT, None),
            Self::Texts(_) => leaf(name, Physical::BYTE_ARRAY, Some(LogicalType::String)),
            Self::TextLists(_) => {
                list(name, leaf("element", Physical::BYTE_ARRAY, Some(LogicalType::String))?)
            }
            Self::FloatLists(..) => list(name, leaf("element", Physical::FLOAT, None)?),
            Self::DoubleLists(depth, _) => {
                let mut field = leaf(if *depth == 0 { name } else { "element" }, Physical::DOUBLE, None)?;
                for level in (0..*depth).rev() {
                    field = list(if level == 0 { name } else { "element" }, field)?;
                }
                Ok(field)
            }
            Self::Images(_) => {
                let bytes = leaf("bytes", Physical::BYTE_ARRAY, None)?;
                let path = leaf("path", Physical::BYTE_ARRAY, Some(LogicalType::String))?;
                let group = Type::group_type_builder(name).with_fields(vec![bytes, path]);
                Ok(Arc::new(group.with_repetition(Repetition::OPTIONAL).build()?))
            }
        }
    }

    /// Writes the column into the row group, at its turn.
    fn write(self, row_group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>) -> Result<()> {
        match self {
            Self::Bools(values) => write::<BoolType>(row_group, &values, 1, 1),
            Self::Ints(values) => write::<Int64Type>(row_group, &values, 1, 1),
            Self::Unsigned(values) => {
                let values: Vec<i64> = values.into_iter().map(u64::cast_signed).collect();
                write::<Int64Type>(row_group, &values, 1, 1)
            }
            Self::Floats(values) => write::<FloatType>(row_group, &values, 1, 1),
            Self::Texts(values) => write::<ByteArrayType>(row_group, &byte_arrays(values), 1, 1),
            Self::TextLists(values) => write::<ByteArrayType>(row_group, &byte_arrays(values), 3, 1),
            Self::FloatLists(width, values) => write::<FloatType>(row_group, &values, 3, width),
            Self::DoubleLists(depth, rows) => {
                let width = rows.first().map_or(1, Vec::len);
                write::<DoubleType>(row_group, &rows.concat(), 2 * depth as i16 + 1, width)
            }
            Self::Images(images) => {
                write::<ByteArrayType>(row_group, &images, 2, 1)?;
                write_levels::<ByteArrayType>(row_group, &[], &vec![1; images.len()], None)
            }
        }
    }
}

/// An optional leaf of the schema.
fn leaf(name: &str, physical: Physical, logical: Option<LogicalType>) -> Result<TypePtr> {
    let leaf = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
    Ok(Arc::new(leaf.with_logical_type(logical).build()?))
}

/// An optional list in the schema, in the three levels that the format asks for.
fn list(name: &str, element: TypePtr) -> Result<TypePtr> {
    let repeated = Type::group_type_builder("list").with_repetition(Repetition::REPEATED);
    let list = Type::group_type_builder(name)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(Some(LogicalType::List))
        .with_converted_type(ConvertedType::LIST)
        .with_fields(vec![Arc::new(repeated.with_fields(vec![element]).build()?)]);
    Ok(Arc::new(list.build()?))
}

/// Texts as Parquet holds them.
fn byte_arrays(texts: Vec<String>) -> Vec<ByteArray> {
    texts.into_iter().map(|text| ByteArray::from(text.into_bytes())).collect()
}

/// Writes values that are all there, `width` of them a row in lists whose inner ones hold one element.
fn write<T: DataType>(
    row_group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>,
    values: &[T::T],
    defined: i16,
    width: usize,
) -> Result<()> {
    let repeated: Vec<i16> = (0..values.len()).map(|index| i16::from(index % width != 0)).collect();
    let is_list = defined >= 3;
    write_levels::<T>(row_group, values, &vec![defined; values.len()], is_list.then_some(&repeated))
}

/// Writes a column of values and levels.
fn write_levels<T: DataType>(
    row_group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>,
    values: &[T::T],
    defined: &[i16],
    repeated: Option<&[i16]>,
) -> Result<()> {
    let mut column = row_group.next_column()?.expect("the schema was made from the columns");
    column.typed::<T>().write_batch(values, Some(defined), repeated)?;
    column.close()
}

/// What the footer of a Parquet file says.
pub(super) struct Footer {
    metadata: FileMetaData,
}

impl Footer {
    /// Reads the footer, and checks that it is as it was written where it says so.
    pub(super) fn read(file: &mut (impl Read + Seek)) -> std::result::Result<Self, TableError> {
        let n_bytes = file.seek(SeekFrom::End(0)).map_err(TableError::Disk)?;
        let tail_at = n_bytes.checked_sub(TAIL as u64).ok_or(TableError::Short)?;
        let mut tail = [0; TAIL];
        file.seek(SeekFrom::Start(tail_at))
            .and_then(|_| file.read_exact(&mut tail))
            .map_err(TableError::Disk)?;
        let len = footer_len(tail).ok_or(TableError::Tail)?;
        let start = tail_at.checked_sub(len as u64).filter(|&start| start >= MAGIC.len() as u64);
        let start = start.ok_or(TableError::Cut)?;
        if len > limits::FOOTER_BYTES {
            return Err(TableError::FooterBytes(len));
        }
        let mut footer = vec![0; len + TAIL];
        file.seek(SeekFrom::Start(start))
            .and_then(|_| file.read_exact(&mut footer))
            .map_err(TableError::Disk)?;
        Self::decode(&footer)
    }

    /// The same of the footer's bytes, with its length and the magic after it.
    fn decode(footer: &[u8]) -> std::result::Result<Self, TableError> {
        // Files of before have no such checksum.
        if footer_sha256(footer).is_some_and(|(digits, sha256)| footer[digits] != *sha256.as_bytes()) {
            return Err(TableError::FooterChecksum);
        }
        let structure = &footer[..footer.len() - TAIL];
        if !parquet_check::is_footer(structure) {
            return Err(TableError::NoFooter);
        }
        let metadata = ParquetMetaDataReader::decode_metadata(structure).map_err(TableError::Parquet)?;
        Ok(Self { metadata: metadata.file_metadata().clone() })
    }

    /// How many rows it claims.
    pub(super) fn n_rows(&self) -> i64 {
        self.metadata.num_rows()
    }

    /// A note in it.
    pub(super) fn note(&self, key: &str) -> Option<&str> {
        let notes = self.metadata.key_value_metadata()?;
        notes.iter().find(|note| note.key == key)?.value.as_deref()
    }

    /// Whether it has a checksum, which it matches.
    pub(super) fn is_signed(&self) -> bool {
        self.note(FOOTER_SHA256).is_some()
    }

    /// The program that wrote the file.
    pub(super) fn created_by(&self) -> &str {
        self.metadata.created_by().unwrap_or("an unnamed program")
    }

    /// Whether this program wrote the file.
    pub(super) fn is_ours(&self) -> bool {
        self.created_by().starts_with(CREATED_BY)
    }

    /// Whether it has a column of this name.
    pub(super) fn has_column(&self, name: &str) -> bool {
        self.metadata.schema_descr().root_schema().get_fields().iter().any(|field| field.name() == name)
    }
}

/// A Parquet file of one row group in memory, whose pages are as they were written.
pub(super) struct Table {
    bytes: Bytes,
    pub(super) footer: Footer,
    reader: SerializedFileReader<Bytes>,
    n_rows: usize,
}

impl Table {
    /// Takes the file apart, and checks that all of it is as it was written: a decoder that trusts its input must not see
    /// a damaged page.
    pub(super) fn new(bytes: Vec<u8>) -> std::result::Result<Self, TableError> {
        let footer = Footer::read(&mut io::Cursor::new(&bytes))?;
        let note = footer.note(SHA256).and_then(|note| note.split_once(' '));
        let pages = note.and_then(|(n_bytes, sha256)| {
            let pages = bytes.get(..n_bytes.parse().ok()?)?;
            (to_hex(&Sha256::digest(pages)) == sha256).then_some(pages.len())
        });
        let is_covered = footer_start(&bytes).is_some() && pages == footer_start(&bytes);
        if !is_covered {
            return Err(TableError::Checksum);
        }
        let bytes = Bytes::from(bytes);
        let reader = SerializedFileReader::new(bytes.clone()).map_err(TableError::Parquet)?;
        let [row_group] = reader.metadata().row_groups() else {
            return Err(TableError::RowGroups);
        };
        let n_rows = usize::try_from(row_group.num_rows()).unwrap_or(usize::MAX);
        if n_rows > limits::STEPS || row_group.num_rows() != footer.n_rows() {
            return Err(TableError::Rows(row_group.num_rows()));
        }
        Ok(Self { bytes, footer, reader, n_rows })
    }

    /// The pages of a column, which lie where it says.
    fn pages(&self, column: &ColumnChunkMetaData) -> Option<&[u8]> {
        let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
        let rest = self.bytes.get(usize::try_from(start).ok()?..)?;
        rest.get(..usize::try_from(column.compressed_size()).ok()?)
    }

    /// The values of the column at a path of names, `width` of them a row.
    pub(super) fn read<T: DataType>(&self, path: &[&str], width: usize) -> Result<Vec<T::T>> {
        let fault = |what: &str| ParquetError::General(format!("{what} {:?}", path.join(".")));
        let row_group = self.reader.get_row_group(0)?;
        let columns = row_group.metadata().columns();
        let is_it = |column: &ColumnChunkMetaData| {
            column.column_path().parts() == path && column.column_type() == T::get_physical_type()
        };
        let idx = columns.iter().position(is_it).ok_or_else(|| fault("there is no column"))?;
        let n_values = self.n_rows * width;
        let pages = self.pages(&columns[idx]);
        // What a page claims is allocated before it is read.
        let is_sane = pages
            .is_some_and(|pages| parquet_check::pages_hold(pages, n_values, limits::page_bytes(n_values)));
        if !is_sane {
            return Err(fault("its pages do not hold the values of"));
        }
        let mut reader = get_typed_column_reader::<T>(row_group.get_column_reader(idx)?);
        let read = || {
            let (mut values, mut defined, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
            while reader.read_records(self.n_rows, Some(&mut defined), Some(&mut repeated), &mut values)?.0
                > 0
            {}
            Ok(values)
        };
        // The decoder trusts pages. Those of a forged file, with checksums that are right, may still make it panic.
        let values =
            catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err(fault("there is no sense in")))?;
        if values.len() != n_values {
            return Err(fault(&format!("{} rows have {} values of", self.n_rows, values.len())));
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Vec<u8> {
        let columns = vec![
            ("numbers".to_owned(), Column::Floats(vec![1.5, -2.0, 0.25])),
            ("lists".to_owned(), Column::FloatLists(2, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
            ("doubles".to_owned(), Column::DoubleLists(1, vec![vec![1.0], vec![2.0], vec![3.0]])),
            ("counts".to_owned(), Column::Ints(vec![1, 2, 3])),
        ];
        to_parquet(columns, vec![("note".to_owned(), "said".to_owned())]).unwrap()
    }

    #[test]
    fn what_is_written_is_read() {
        let table = Table::new(table()).unwrap();
        assert_eq!(table.footer.note("note"), Some("said"));
        assert_eq!(table.read::<FloatType>(&["numbers"], 1).unwrap(), [1.5, -2.0, 0.25]);
        let lists = table.read::<FloatType>(&["lists", "list", "element"], 2).unwrap();
        assert_eq!(lists, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert!(table.read::<FloatType>(&["numbers"], 2).is_err(), "one a row, not two");
        assert!(table.read::<Int64Type>(&["numbers"], 1).is_err(), "of another type");
    }

    #[test]
    fn older_readers_know_the_order_and_the_compression_of_every_column() {
        use parquet::basic::{ColumnOrder, SortOrder};
        let reader = SerializedFileReader::new(Bytes::from(table())).unwrap();
        let orders = reader.metadata().file_metadata().column_orders().unwrap();
        let is_type_defined = |order: &ColumnOrder| matches!(order, ColumnOrder::TYPE_DEFINED_ORDER(order) if *order == SortOrder::SIGNED);
        assert_eq!(orders.len(), 4);
        assert!(orders.iter().all(is_type_defined), "{orders:?}");
        let columns = reader.metadata().row_group(0).columns();
        assert!(columns.iter().all(|column| column.compression() == Compression::SNAPPY));
    }

    #[test]
    fn a_file_cut_or_changed_anywhere_is_torn() {
        let whole = table();
        for len in 0..whole.len() {
            assert!(Table::new(whole[..len].to_vec()).is_err(), "cut to {len} bytes");
        }
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x20;
            // A checksum of another name is none. Episodes have one.
            let is_whole = Table::new(bytes).is_ok_and(|table| table.footer.is_signed());
            assert!(!is_whole, "byte {at}");
        }
    }
}
