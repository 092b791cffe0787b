//! Reports: what was measured, as one HTML file, as pictures, as text and as JSON.
//!
//! [`recorded`] reports on recordings, [`simulated`] runs the paper's whole course on simulated
//! robots. Both give a [`Document`], which is data: [`html`] makes one file of it that needs no other,
//! `Display` makes text, `serde` makes JSON, and [`files`] makes all of them with the pictures beside.
#![forbid(unsafe_code)]

mod ablation;
mod calibration;
mod document;
pub mod figure;
mod files;
mod forecast;
mod horizons;
mod html;
mod material;
pub mod paper;
mod power;
mod recorded;
mod robots;
mod scores;
mod series;
mod simulated;
mod text;
mod unit;

pub use document::{Cell, Column, Document, Part, Section, Table};
pub use files::{File, files};
pub use html::html;
pub use recorded::{Recorded, recorded};
pub use simulated::{NOTE, Simulated, SimulatedReport, simulated};

use crate::figure::FigureError;
use joulebus_eval::evaluate::EvaluateError;
use joulebus_eval::score::ScoreError;
use joulebus_train::TrainError;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The course is too short to be evaluated.
    #[error("{found} {what}: allowed are 100 or more")]
    TooShort {
        /// What.
        what: &'static str,
        /// How many.
        found: usize,
    },
    /// The evaluation was refused.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// The live path refused.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// The training was refused or went astray.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A picture could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The report could not be written as JSON.
    #[error("the report cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}
