//! The columns of an archive's files.

use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::schema::types::{Type, TypePtr};

use crate::trial::Column;

/// Version of the schema: files of another one are refused.
pub const SCHEMA: u32 = 1;

/// Key of the schema's version in a file's footer.
pub(super) const SCHEMA_KEY: &str = "joulebus.schema";
/// Key of the columns' units, as JSON.
pub(super) const UNITS_KEY: &str = "joulebus.units";
/// Key of the [`Head`](super::Head), as JSON.
pub(super) const HEAD_KEY: &str = "joulebus.trial";

/// Key of the [`Sum`](super::sum::Sum) of the bytes before the footer.
pub(super) const SUM_KEY: &str = "joulebus.sum";

/// Type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A whole number of 32 bits without sign.
    U32,
    /// A whole number of 64 bits without sign.
    U64,
    /// A whole number of 64 bits with sign.
    I64,
    /// A floating-point number of 64 bits.
    F64,
}

impl Kind {
    /// Its name in SQL, as DuckDB writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U32 => "UINTEGER",
            Self::U64 => "UBIGINT",
            Self::I64 => "BIGINT",
            Self::F64 => "DOUBLE",
        }
    }

    fn parquet(self) -> (Physical, Option<LogicalType>) {
        let unsigned = |bit_width| Some(LogicalType::integer(bit_width, false));
        match self {
            Self::U32 => (Physical::INT32, unsigned(32)),
            Self::U64 => (Physical::INT64, unsigned(64)),
            Self::I64 => (Physical::INT64, None),
            Self::F64 => (Physical::DOUBLE, None),
        }
    }
}

/// A column of an archive's files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub kind: Kind,
    /// Its unit. `1` without one.
    pub unit: &'static str,
    /// True if a row may have no value.
    pub is_nullable: bool,
    /// The column of a trial whose values it has.
    pub(super) column: Option<Column>,
}

/// All columns, in the order of the files.
pub fn fields() -> Vec<Field> {
    let field =
        |name, kind, unit, is_nullable| Field { name, kind, unit, is_nullable, column: None };
    let mut fields =
        vec![field("row", Kind::U32, "1", false), field("timestamp_s", Kind::F64, "s", false)];
    fields.extend(Column::ALL.map(|column| Field {
        column: Some(column),
        ..field(column.name(), Kind::F64, column.unit(), true)
    }));
    fields.extend([
        field("robot_id", Kind::U32, "1", true),
        field("unix_ns", Kind::I64, "ns", true),
        field("stamp_ns", Kind::U64, "ns", true),
        field("measured_ns", Kind::U64, "ns", true),
        field("seq", Kind::U64, "1", true),
        field("flags", Kind::U32, "1", true),
    ]);
    fields
}

/// The columns' units as JSON: `{"timestamp_s":"s",…}`.
pub(super) fn units() -> String {
    let units = fields().into_iter().map(|field| (field.name.to_owned(), field.unit.into()));
    serde_json::Value::Object(units.collect()).to_string()
}

/// The schema of a file.
pub(super) fn schema() -> parquet::errors::Result<TypePtr> {
    let typed = |field: Field| {
        let (physical, logical) = field.kind.parquet();
        let repetition = match field.is_nullable {
            true => Repetition::OPTIONAL,
            false => Repetition::REQUIRED,
        };
        Type::primitive_type_builder(field.name, physical)
            .with_logical_type(logical)
            .with_repetition(repetition)
            .build()
            .map(Arc::new)
    };
    let fields = fields().into_iter().map(typed);
    let fields = fields.collect::<parquet::errors::Result<Vec<_>>>()?;
    Type::group_type_builder("joulebus_trial").with_fields(fields).build().map(Arc::new)
}
