//! Evaluation reports as one HTML file, as figures, as text and as JSON.
//!
//! [`recorded`] reports on recordings, [`simulated`] runs the paper's experiments on simulated
//! robots. Both return a [`Document`], which is data: [`html`] renders it as one self-contained
//! file, `Display` as text, `serde` as JSON, and [`files`] as all of them with the figures as
//! files.
#![forbid(unsafe_code)]

mod ablation;
mod calibration;
mod comparison;
mod document;
mod draw;
mod error;
mod experiment;
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

pub use document::{Cell, Column, Document, Part, Section, Table};
pub use error::ReportError;
pub use experiment::{DRAWS, Simulated};
pub use files::{File, files};
pub use html::html;
pub use recorded::{Recorded, recorded};
pub use simulated::{NOTE, SimulatedReport, simulated};
