//! Reports on recordings and on forecasts of them: one HTML file, text and JSON.
//!
//! ```
//! use joulebus_report::{Cell, Column, Document, Part, Section, Table, html};
//!
//! let table = Table {
//!     id: "errors".to_owned(),
//!     caption: "Errors of a model".to_owned(),
//!     columns: vec![Column::new("robot", "Robot"), Column::new("mae_mw", "MAE (mW)")],
//!     rows: vec![vec![Cell::words("rover"), Cell::Number(12.34, 1)]],
//!     folded: false,
//! };
//! let document = Document {
//!     title: "A report".to_owned(),
//!     warning: None,
//!     summary: vec!["One model on one robot.".to_owned()],
//!     sections: vec![Section {
//!         id: "scores".to_owned(),
//!         title: "Scores".to_owned(),
//!         parts: vec![Part::Table(table)],
//!     }],
//! };
//! assert!(html(&document)?.contains("12.3"));
//! assert!(document.to_string().contains("MAE (mW)"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Document`] is a report as data. [`html`](html()) renders it as one
//! self-contained file, whose figures uPlot draws. `Display` renders it as text, `serde` as JSON
//! with the data of the figures, and [`files`](files()) as all three. [`Recorded`] has the inputs of a report on recordings
//! ([`recorded`](recorded())). [`Simulated`] has those of the paper's experiments on simulated
//! robots ([`simulated`](simulated())).
//!
//! **Units** stand in the titles of columns and axes. An unknown number is NaN, and shown as a
//! dash.
//!
//! **Errors** ([`ReportError`]) are those of the evaluation and of the training, or an experiment
//! that is too short.
//!
//! The program `joulebus-lab` has this crate as `joulebus report`.
//!
//! **In the book**: [a report with one command][1], [figures and reports are data][2], [the
//! simulated robots beside the paper][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/report.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/models-reports.md#figures-and-reports-are-data
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/measured/plant.md
#![forbid(unsafe_code)]

mod ablation;
mod calibration;
mod comparison;
mod document;
mod draw;
mod error;
mod experiment;
mod figure;
mod files;
mod forecast;
mod horizons;
mod html;
mod material;
mod paper;
mod power;
mod recorded;
mod robots;
mod scores;
mod simulated;
mod text;
mod unit;
mod usage;

pub use document::{Cell, Column, Document, Part, Section, Table};
pub use error::ReportError;
pub use experiment::{DRAWS, Simulated};
pub use figure::Figure;
pub use files::{File, files};
pub use html::html;
pub use recorded::{Recorded, recorded};
pub use simulated::{NOTE, SimulatedReport, simulated};
