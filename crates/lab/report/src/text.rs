//! A report as plain text.

use std::fmt;

use super::document::{Cell, Document, Part, Table};

impl fmt::Display for Document {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Each text begins alike, so that a report replaces another one.
        let title = format!("Report: {}", self.title);
        writeln!(out, "{title}\n{}", "=".repeat(width(&title)))?;
        if let Some(warning) = &self.warning {
            writeln!(out, "\n!! {warning}")?;
        }
        for words in &self.summary {
            writeln!(out, "\n{words}")?;
        }
        for section in &self.sections {
            writeln!(out, "\n{}\n{}", section.title, "-".repeat(width(&section.title)))?;
            for part in &section.parts {
                match part {
                    Part::Words(words) => writeln!(out, "\n{words}")?,
                    Part::Table(table) => write!(out, "\n{table}")?,
                    Part::Figure(figure) => {
                        writeln!(out, "\n[{}] {}", figure.name, figure.title)?;
                    }
                }
            }
        }
        Ok(())
    }
}

impl fmt::Display for Table {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}", self.caption)?;
        let mut lines = vec![self.columns.iter().map(|column| column.title.clone()).collect()];
        lines.extend(self.rows.iter().map(|row| row.iter().map(Cell::shown).collect::<Vec<_>>()));
        let widths: Vec<usize> = (0..self.columns.len())
            .map(|at| lines.iter().filter_map(|line| line.get(at)).map(|cell| width(cell)).max())
            .map(Option::unwrap_or_default)
            .collect();
        for line in &lines {
            let mut text = String::from(" ");
            for (at, (cell, wide)) in line.iter().zip(&widths).enumerate() {
                let room = " ".repeat(wide.saturating_sub(width(cell)));
                text += &if self.is_of_numbers(at) {
                    format!(" {room}{cell}")
                } else {
                    format!(" {cell}{room}")
                };
            }
            writeln!(out, "{}", text.trim_end())?;
        }
        Ok(())
    }
}

impl Table {
    /// True if a column is numeric, and so right-aligned.
    pub(super) fn is_of_numbers(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().filter_map(|row| row.get(column));
        cells.any(Cell::is_number)
    }
}

fn width(text: &str) -> usize {
    text.chars().count()
}
