//! Small Parquet tables, column by column, as `pyarrow` would have written them.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::sync::Arc;

use parquet::basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::column::reader::get_typed_column_reader;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};
use sha2::{Digest as _, Sha256};

use super::sealed::to_hex;

/// The key of the note that covers all that stands before the footer: how many bytes, and their SHA-256.
const SHA256: &str = "dropj.sha256";

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

/// A table as the bytes of a Parquet file of one row group, with notes in its footer.
pub(super) fn to_parquet(columns: Vec<(String, Column)>, notes: Vec<(String, String)>) -> Result<Vec<u8>> {
    let fields = columns.iter().map(|(name, column)| column.field(name)).collect::<Result<_>>()?;
    let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
    let mut properties = WriterProperties::builder()
        .set_created_by(format!("dropj {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
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
    writer.close()?;
    Ok(file)
}

impl Column {
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

/// A Parquet file that is being read.
pub(super) struct Table {
    file: File,
    reader: SerializedFileReader<File>,
}

impl Table {
    /// Opens a file and reads its footer.
    pub(super) fn new(file: File) -> Result<Self> {
        Ok(Self { reader: SerializedFileReader::new(file.try_clone()?)?, file })
    }

    /// Whether the pages are as they were written.
    pub(super) fn is_intact(&self) -> io::Result<bool> {
        let Some((n_bytes, sha256)) = self.note(SHA256).and_then(|note| note.split_once(' ')) else {
            return Ok(false);
        };
        let Ok(n_bytes) = n_bytes.parse() else { return Ok(false) };
        let mut hasher = Sha256::new();
        let mut file = &self.file;
        file.seek(SeekFrom::Start(0))?;
        let mut file = file.take(n_bytes);
        let mut buffer = vec![0; 1 << 16];
        loop {
            match file.read(&mut buffer)? {
                0 => return Ok(to_hex(&hasher.finalize()) == sha256),
                n_read => hasher.update(&buffer[..n_read]),
            }
        }
    }

    /// How many rows the footer claims.
    pub(super) fn n_rows(&self) -> usize {
        self.reader.metadata().file_metadata().num_rows() as usize
    }

    /// A note in the footer.
    pub(super) fn note(&self, key: &str) -> Option<&str> {
        let notes = self.reader.metadata().file_metadata().key_value_metadata()?;
        notes.iter().find(|note| note.key == key)?.value.as_deref()
    }

    /// The values of the column at a path of names, those that are there.
    pub(super) fn read<T: DataType>(&self, path: &[&str]) -> Result<Vec<T::T>> {
        let mut values = Vec::new();
        for idx in 0..self.reader.num_row_groups() {
            let row_group = self.reader.get_row_group(idx)?;
            let columns = row_group.metadata().columns();
            let column_idx = columns
                .iter()
                .position(|column| {
                    column.column_path().parts() == path && column.column_type() == T::get_physical_type()
                })
                .ok_or_else(|| ParquetError::General(format!("there is no column {:?}", path.join("."))))?;
            let mut reader = get_typed_column_reader::<T>(row_group.get_column_reader(column_idx)?);
            let n_rows = row_group.metadata().num_rows() as usize;
            let (mut defined, mut repeated) = (Vec::new(), Vec::new());
            while reader.read_records(n_rows, Some(&mut defined), Some(&mut repeated), &mut values)?.0 > 0 {}
        }
        Ok(values)
    }
}
