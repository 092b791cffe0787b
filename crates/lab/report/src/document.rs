//! A report as data: sections of text, tables and figures, from which HTML, text and JSON are made,
//! so that all three agree.

use serde::ser::{SerializeMap as _, SerializeSeq as _};
use serde::{Serialize, Serializer};

use super::figure::Figure;

/// A report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Document {
    /// Its title.
    pub title: String,
    /// A warning before the first number, such as that the robots are simulated.
    pub warning: Option<String>,
    /// A summary of the method, in a few sentences.
    pub summary: Vec<String>,
    /// The sections, in order.
    pub sections: Vec<Section>,
}

/// A part of a report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Section {
    /// Its id in the document: lower-case letters, digits and hyphens.
    pub id: String,
    /// Its title.
    pub title: String,
    /// Its parts, in order.
    pub parts: Vec<Part>,
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    /// A paragraph.
    Words(String),
    /// A table.
    Table(Table),
    /// A figure, with its data.
    Figure(Figure),
}

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Its id in the document: lower-case letters, digits and hyphens.
    pub id: String,
    /// Caption, which states what the figure shows.
    pub caption: String,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Its rows. As many cells as columns.
    pub rows: Vec<Vec<Cell>>,
    /// True if it repeats a figure's data: it is then collapsed in HTML.
    pub folded: bool,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Its key in JSON, unit last: `mae_mw`.
    pub key: String,
    /// Its title, with the unit.
    pub title: String,
}

impl Column {
    /// A column of this key and title.
    pub fn new(key: impl Into<String>, title: impl Into<String>) -> Self {
        Self { key: key.into(), title: title.into() }
    }
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Text.
    Words(String),
    /// A count.
    Count(u64),
    /// A number with a number of decimals. NaN: unknown.
    Number(f64, usize),
    /// Two ends with a number of decimals. NaN: unknown.
    Range([f64; 2], usize),
    /// Mean and standard deviation with a number of decimals. NaN: unknown.
    Spread([f64; 2], usize),
    /// An empty cell.
    Nothing,
}

/// Shown for an unknown number.
pub(super) const UNKNOWN: &str = "\u{2013}";

impl Cell {
    /// A cell with text.
    pub fn words(words: impl Into<String>) -> Self {
        Self::Words(words.into())
    }

    /// The cell as text.
    pub fn shown(&self) -> String {
        match self {
            Self::Words(words) => words.clone(),
            Self::Count(count) => number(*count as f64, 0),
            Self::Number(value, decimals) => number(*value, *decimals),
            Self::Range([low, high], _) if low.is_nan() && high.is_nan() => UNKNOWN.to_owned(),
            Self::Range([low, high], decimals) => {
                format!("{} to {}", number(*low, *decimals), number(*high, *decimals))
            }
            Self::Spread([mean, std], decimals) => {
                format!("{} ± {}", number(*mean, *decimals), number(*std, *decimals))
            }
            Self::Nothing => String::new(),
        }
    }

    /// True if it is numeric, and so right-aligned.
    pub(super) fn is_number(&self) -> bool {
        !matches!(self, Self::Words(_) | Self::Nothing)
    }
}

fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return UNKNOWN.to_owned();
    }
    let text = format!("{value:.decimals$}");
    // A number that rounds to zero has no sign.
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    match text.strip_prefix('-') {
        Some(digits) if is_zero => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Words(words) => to.serialize_str(words),
            Self::Count(count) => to.serialize_u64(*count),
            // Numbers that are not finite become null.
            Self::Number(value, _) => to.serialize_f64(*value),
            Self::Range(ends, _) => ends.serialize(to),
            Self::Spread([mean, std], _) => {
                to.collect_map([("mean", mean), ("standard_deviation", std)])
            }
            Self::Nothing => to.serialize_none(),
        }
    }
}

impl Serialize for Table {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut map = to.serialize_map(Some(3))?;
        map.serialize_entry("id", &self.id)?;
        map.serialize_entry("caption", &self.caption)?;
        map.serialize_entry("rows", &Rows(self))?;
        map.end()
    }
}

/// The rows as objects.
struct Rows<'a>(&'a Table);

impl Serialize for Rows<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut seq = to.serialize_seq(Some(self.0.rows.len()))?;
        for cells in &self.0.rows {
            seq.serialize_element(&Row { columns: &self.0.columns, cells })?;
        }
        seq.end()
    }
}

struct Row<'a> {
    columns: &'a [Column],
    cells: &'a [Cell],
}

impl Serialize for Row<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let keys = self.columns.iter().map(|column| &column.key);
        to.collect_map(keys.zip(self.cells))
    }
}

impl Document {
    /// All figures, in order.
    pub fn figures(&self) -> impl Iterator<Item = &Figure> {
        self.parts().filter_map(|part| match part {
            Part::Figure(figure) => Some(figure),
            Part::Words(_) | Part::Table(_) => None,
        })
    }

    /// All tables, in order.
    pub fn tables(&self) -> impl Iterator<Item = &Table> {
        self.parts().filter_map(|part| match part {
            Part::Table(table) => Some(table),
            Part::Words(_) | Part::Figure(_) => None,
        })
    }

    fn parts(&self) -> impl Iterator<Item = &Part> {
        self.sections.iter().flat_map(|section| &section.parts)
    }
}
