//! `dropj labels`.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use dropj::dataset::order_as_types_do;
use dropj::run::{Kind, OutputFile, write_whole};
use dropj::session::SessionStore;
use dropj::session::export::{LabelRow, label_rows, to_csv};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, FloatType, Int64Type};
use parquet::errors::Result as Written;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;

use super::numbers::{named_weight, weight};
use super::refit::reweighted;

#[derive(Debug, clap::Args)]
#[command(after_help = ROWS)]
pub(crate) struct Options {
    /// The folder of the session
    session: PathBuf,
    #[command(flatten)]
    form: Form,
    /// The file to write; without it the table is printed, but for Parquet
    #[arg(long)]
    out: Option<PathBuf>,
    /// What else the justifications weigh in the table, such as grass=1,chuckhole=0.95,default=0.75: in the session's order
    #[arg(long, value_parser = named_weight, value_delimiter = ',')]
    weights: Vec<(String, f32)>,
    /// What it weighs in the table that only one clip is safe
    #[arg(long, value_parser = weight)]
    safety: Option<f32>,
    /// What a preference between safe clips weighs in the table
    #[arg(long, value_parser = weight)]
    default: Option<f32>,
}

/// What the table holds.
const ROWS: &str = "\
There is a row for each answer that counts, skips among them, in the order of answering: the two clips by dream and first step, \
what was said of them, by whom and when (at, in milliseconds since 1970), and mu, the probability with which left ought to \
win. What was only asked again has no mu.";

/// How the table is written.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
#[expect(clippy::struct_excessive_bools, reason = "one for each form")]
struct Form {
    /// A line of names, then a line an answer
    #[arg(long)]
    csv: bool,
    /// A JSON object a line, an answer each
    #[arg(long)]
    jsonl: bool,
    /// One JSON object, with the answers as the list `rows`
    #[arg(long)]
    json: bool,
    /// A Parquet file
    #[arg(long, requires = "out")]
    parquet: bool,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let Options { form, out, .. } = options;
    let kind = if form.jsonl || form.json { Kind::Notes } else { Kind::Table };
    let output = match out {
        Some(out) if form.parquet => {
            anyhow::ensure!(
                !out.exists(),
                "there is something already where the file should be written: {out:?}"
            );
            None
        }
        Some(out) => Some(OutputFile::at(out, kind)?),
        None => None,
    };
    let (_, session) = SessionStore::read(&options.session)?;
    let weights = reweighted(session.weights(), &options.weights, options.safety, options.default)?;
    let rows = label_rows(&session, &weights);
    let text = match form {
        Form { csv: true, .. } => to_csv(&rows),
        Form { json: true, .. } => serde_json::to_string(&serde_json::json!({"rows": rows}))? + "\n",
        _ => to_jsonl(&rows)?,
    };
    match (output, out) {
        (Some(output), _) => output.write(text.as_bytes())?,
        (None, Some(out)) => write_whole(out, &to_parquet(&rows)?)?,
        (None, None) => std::io::stdout().write_all(text.as_bytes())?,
    }
    Ok(())
}

fn to_jsonl(rows: &[LabelRow]) -> serde_json::Result<String> {
    rows.iter().map(|row| Ok(serde_json::to_string(row)? + "\n")).collect()
}

/// A column: what is there of each row.
enum Column {
    /// `bool`
    Bools(Vec<Option<bool>>),
    /// `int64`
    Ints(Vec<Option<i64>>),
    /// `float32`
    Floats(Vec<Option<f32>>),
    /// `string`
    Texts(Vec<Option<String>>),
}

/// The table as the bytes of a Parquet file of one row group.
fn to_parquet(rows: &[LabelRow]) -> Written<Vec<u8>> {
    let columns = columns(rows);
    let fields = columns.iter().map(|(name, column)| {
        let leaf =
            Type::primitive_type_builder(name, column.physical()).with_repetition(Repetition::OPTIONAL);
        let logical = matches!(column, Column::Texts(_)).then_some(LogicalType::String);
        Ok(Arc::new(leaf.with_logical_type(logical).build()?))
    });
    let schema = Type::group_type_builder("schema").with_fields(fields.collect::<Written<_>>()?).build()?;
    let properties = WriterProperties::builder()
        .set_created_by(format!("dropj {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .build();
    let n_columns = columns.len();
    let mut file = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut file, Arc::new(schema), Arc::new(properties))?;
    let mut row_group = writer.next_row_group()?;
    for (_, column) in columns {
        column.write(&mut row_group)?;
    }
    row_group.close()?;
    writer.close()?;
    order_as_types_do(&mut file, n_columns)?;
    Ok(file)
}

/// The columns of the table, by their names.
fn columns(rows: &[LabelRow]) -> Vec<(&'static str, Column)> {
    let ints = |of: &dyn Fn(&LabelRow) -> Option<i64>| Column::Ints(rows.iter().map(of).collect());
    let floats = |of: &dyn Fn(&LabelRow) -> Option<f32>| Column::Floats(rows.iter().map(of).collect());
    let bools = |of: &dyn Fn(&LabelRow) -> Option<bool>| Column::Bools(rows.iter().map(of).collect());
    let texts = |of: &dyn Fn(&LabelRow) -> Option<&str>| {
        Column::Texts(rows.iter().map(|row| of(row).map(str::to_owned)).collect())
    };
    let step = |step: usize| i64::try_from(step).ok();
    vec![
        ("query", ints(&|row| Some(row.query.into()))),
        ("left_dream", ints(&|row| Some(row.left_dream.into()))),
        ("left_start", ints(&|row| step(row.left_start))),
        ("right_dream", ints(&|row| Some(row.right_dream.into()))),
        ("right_start", ints(&|row| step(row.right_start))),
        ("choice", texts(&|row| Some(&row.choice))),
        ("protocol", texts(&|row| Some(row.protocol))),
        ("skipped", texts(&|row| row.skipped)),
        ("left_safe", bools(&|row| row.left_safe)),
        ("right_safe", bools(&|row| row.right_safe)),
        ("justification", texts(&|row| row.justification.as_deref())),
        ("preference", texts(&|row| row.preference)),
        ("mu", floats(&|row| row.mu)),
        ("secs", floats(&|row| Some(row.secs))),
        ("loops", ints(&|row| Some(row.loops.into()))),
        ("annotator", texts(&|row| Some(&row.annotator))),
        ("sides_swapped", bools(&|row| Some(row.sides_swapped))),
        ("left_unsafe_from", ints(&|row| row.left_unsafe_from.and_then(step))),
        ("right_unsafe_from", ints(&|row| row.right_unsafe_from.and_then(step))),
        ("at", ints(&|row| i64::try_from(row.at).ok())),
        ("step", ints(&|row| row.step.and_then(step))),
        ("verdict", texts(&|row| row.verdict)),
        ("active", texts(&|row| row.active.as_deref())),
    ]
}

impl Column {
    fn physical(&self) -> Physical {
        match self {
            Self::Bools(_) => Physical::BOOLEAN,
            Self::Ints(_) => Physical::INT64,
            Self::Floats(_) => Physical::FLOAT,
            Self::Texts(_) => Physical::BYTE_ARRAY,
        }
    }

    fn write(self, row_group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>) -> Written<()> {
        match self {
            Self::Bools(values) => write::<BoolType>(row_group, values),
            Self::Ints(values) => write::<Int64Type>(row_group, values),
            Self::Floats(values) => write::<FloatType>(row_group, values),
            Self::Texts(values) => {
                let bytes = |text: String| ByteArray::from(text.into_bytes());
                write::<ByteArrayType>(row_group, values.into_iter().map(|text| text.map(bytes)).collect())
            }
        }
    }
}

/// Writes the next column: the values that are there, and which those are.
fn write<T: DataType>(
    row_group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>,
    values: Vec<Option<T::T>>,
) -> Written<()> {
    let is_there: Vec<i16> = values.iter().map(|value| value.is_some().into()).collect();
    let values: Vec<T::T> = values.into_iter().flatten().collect();
    let mut column = row_group.next_column()?.expect("the schema was made from the columns");
    column.typed::<T>().write_batch(&values, Some(&is_there), None)?;
    column.close()
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use dropj::query::{Protocol, Weights};
    use dropj::session::Session;
    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    use parquet::record::{Field, Row};

    use super::*;

    #[test]
    fn the_columns_of_every_form_are_the_same() {
        let session = Session::new(Protocol::Dropj, Weights::paper());
        let csv = to_csv(&label_rows(&session, session.weights()));
        let names: Vec<_> = columns(&[]).into_iter().map(|(name, _)| name).collect();
        assert_eq!(csv.trim_end(), names.join(","));
        let file = to_parquet(&[]).unwrap();
        let read = SerializedFileReader::new(Bytes::from(file)).unwrap();
        let schema = read.metadata().file_metadata().schema_descr();
        assert_eq!(schema.columns().iter().map(|column| column.name().to_owned()).collect::<Vec<_>>(), names);
    }

    #[test]
    fn a_parquet_file_holds_what_is_there_and_nothing_where_nothing_is() {
        let said = LabelRow {
            query: 7,
            left_dream: 0,
            left_start: 3,
            right_dream: 1,
            right_start: 9,
            choice: "uniform".to_owned(),
            protocol: "DROPJ",
            skipped: None,
            left_safe: Some(true),
            right_safe: Some(true),
            justification: None,
            preference: Some("right"),
            mu: Some(0.25),
            secs: 4.2,
            loops: 1,
            annotator: "anna, \"ø\"".to_owned(),
            sides_swapped: false,
            left_unsafe_from: None,
            right_unsafe_from: Some(4),
            at: 1_795_342_500_000,
            step: None,
            verdict: None,
            active: None,
        };
        let skipped = LabelRow { skipped: Some("other"), mu: None, preference: None, ..said.clone() };
        let file = to_parquet(&[said.clone(), skipped]).unwrap();
        let read = SerializedFileReader::new(Bytes::from(file)).unwrap();
        let rows: Vec<_> = read.get_row_iter(None).unwrap().map(|row| row.unwrap()).collect();
        let told = |row: &Row| -> Vec<(String, Field)> {
            row.get_column_iter().map(|(name, field)| (name.clone(), field.clone())).collect()
        };
        let of = |row: &Row, name: &str| told(row).into_iter().find(|(found, _)| found == name).unwrap().1;
        assert_eq!(of(&rows[0], "mu"), Field::Float(0.25));
        assert_eq!(of(&rows[0], "annotator"), Field::Str(said.annotator));
        assert_eq!((of(&rows[0], "left_safe"), of(&rows[0], "skipped")), (Field::Bool(true), Field::Null));
        assert_eq!(of(&rows[0], "right_unsafe_from"), Field::Long(4));
        assert_eq!((of(&rows[1], "mu"), of(&rows[1], "preference")), (Field::Null, Field::Null));
        assert_eq!(of(&rows[1], "at"), Field::Long(1_795_342_500_000));
    }
}
