//! Quality notes on a trial that could be read.

use std::fmt;

use super::table::{Column, LeftOut, Table, is_held, value};

/// Quality notes. Everything noted is kept in the trial. Rows count from 1, those of a CSV as its
/// lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrialNotes {
    /// Rows in the file.
    pub rows: usize,
    /// Median rate, Hz.
    pub rate_hz: f64,
    /// Rows whose time is not later than all times before: ingest refuses their samples.
    pub not_advancing: Vec<usize>,
    /// Rows more than 1.5 median periods after the latest time before them.
    pub gaps: Vec<Gap>,
    /// Readings equal to the previous one.
    pub held_readings: usize,
    /// Rows without a power reading.
    pub missing_readings: usize,
    /// Columns that are missing or all NaN.
    pub missing_columns: Vec<Column>,
    /// Rows without a robot name, while others have one.
    pub unnamed_rows: usize,
    /// Unknown columns of the file.
    pub ignored_columns: Vec<String>,
    /// A CSV does not end with a newline: it may be truncated.
    pub no_final_line_break: bool,
    /// Lines of a CSV that are no whole rows and were left out.
    pub left_out: LeftOut,
    /// Interpretation of the text of a CSV, where it is not usual.
    pub understood: Vec<String>,
    /// Readings on the charger, whose power is no consumption, and unknown.
    pub on_charger: usize,
}

/// A gap between rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// The row after it, from 1.
    pub row: usize,
    /// Time since the latest row before, ns.
    pub length_ns: u64,
}

impl TrialNotes {
    /// True if there are no faults: every row advances, no gap, no missing reading, no unknown
    /// column, the file complete. Held readings and missing columns are not faults.
    pub fn is_clean(&self) -> bool {
        self.not_advancing.is_empty()
            && self.gaps.is_empty()
            && self.missing_readings == 0
            && self.unnamed_rows == 0
            && self.ignored_columns.is_empty()
            && !self.no_final_line_break
            && self.left_out.lines == 0
    }

    /// The readings on the charger in words, if there are any.
    #[must_use]
    pub fn charged(&self) -> Option<String> {
        let Self { on_charger, rows, .. } = self;
        (*on_charger > 0).then(|| {
            format!(
                "{on_charger} of {rows} readings are on the charger: their power is no \
                 consumption, and unknown"
            )
        })
    }
}

impl fmt::Display for TrialNotes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} rows at {:.2} Hz", self.rows, self.rate_hz)?;
        write!(out, ", {} readings held", self.held_readings)?;
        if self.missing_readings > 0 {
            write!(out, ", {} readings missing", self.missing_readings)?;
        }
        if let Some(longest) = self.gaps.iter().max_by_key(|gap| gap.length_ns) {
            let (count, row) = (self.gaps.len(), longest.row);
            let seconds = longest.length_ns as f64 / 1e9;
            write!(out, ", {count} gaps, the longest {seconds:.3} s before row {row}")?;
        }
        if let Some(first) = self.not_advancing.first() {
            let count = self.not_advancing.len();
            write!(out, ", {count} rows whose time does not advance, the first {first}")?;
        }
        if self.unnamed_rows > 0 {
            write!(out, ", {} rows without the robot's name", self.unnamed_rows)?;
        }
        if !self.missing_columns.is_empty() {
            let names = self.missing_columns.iter().map(|column| column.name());
            write!(out, ", without {}", names.collect::<Vec<_>>().join(" "))?;
        }
        if !self.ignored_columns.is_empty() {
            write!(out, ", ignored {}", self.ignored_columns.join(" "))?;
        }
        if self.no_final_line_break {
            write!(out, ", the last line has no newline: the file may be truncated")?;
        }
        for understood in &self.understood {
            write!(out, ", {understood}")?;
        }
        if let Some(charged) = self.charged() {
            write!(out, ", {charged}")?;
        }
        if self.left_out.lines > 0 {
            write!(out, ", {}", self.left_out)?;
        }
        Ok(())
    }
}

/// Time since the first row of each row, rounded to whole ns. The reader bounds the times.
pub(super) fn offsets_ns(timestamp_s: &[f64]) -> Vec<i64> {
    let first_s = timestamp_s.first().copied().unwrap_or_default();
    timestamp_s.iter().map(|time_s| ((time_s - first_s) * 1e9).round() as i64).collect()
}

/// Step from the latest time so far to each row after the first, ns.
fn steps_ns(offset_ns: &[i64]) -> impl Iterator<Item = i64> + '_ {
    let mut latest_ns = offset_ns.first().copied().unwrap_or_default();
    offset_ns.iter().skip(1).map(move |now_ns| {
        let step_ns = now_ns - latest_ns;
        latest_ns = latest_ns.max(*now_ns);
        step_ns
    })
}

/// Lower median of the steps that advance, if there is one.
pub(super) fn median_step_ns(offset_ns: &[i64]) -> Option<u64> {
    let mut steps = steps_ns(offset_ns)
        .filter_map(|step_ns| u64::try_from(step_ns).ok())
        .filter(|step_ns| *step_ns > 0)
        .collect::<Vec<_>>();
    let middle = steps.len().checked_sub(1)? / 2;
    Some(*steps.select_nth_unstable(middle).1)
}

/// The notes on a table in SI units: those on its file are taken from it.
pub(super) fn take(offset_ns: &[i64], period_ns: u64, table: &mut Table) -> TrialNotes {
    let mut notes = TrialNotes {
        rows: offset_ns.len(),
        rate_hz: 1e9 / period_ns as f64,
        ignored_columns: std::mem::take(&mut table.ignored_columns),
        no_final_line_break: table.no_final_line_break,
        unnamed_rows: table.unnamed_rows,
        left_out: std::mem::take(&mut table.left_out),
        understood: std::mem::take(&mut table.understood),
        on_charger: table.on_charger.len(),
        ..TrialNotes::default()
    };
    let columns = &table.columns;
    for (before, step_ns) in steps_ns(offset_ns).enumerate() {
        let row = table.file_row(before + 1);
        match u64::try_from(step_ns) {
            Err(_) | Ok(0) => notes.not_advancing.push(row),
            Ok(length_ns) if length_ns > period_ns + period_ns / 2 => {
                notes.gaps.push(Gap { row, length_ns });
            }
            Ok(_) => {}
        }
    }
    for row in 0..offset_ns.len() {
        notes.held_readings += usize::from(is_held(columns, row));
        notes.missing_readings += usize::from(value(columns, Column::Power, row).is_none());
    }
    notes.missing_columns =
        Column::ALL.into_iter().filter(|column| columns[*column as usize].is_none()).collect();
    notes
}
