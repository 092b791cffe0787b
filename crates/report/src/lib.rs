//! Reports: what was measured, as one HTML file, as pictures, as text and as JSON.
//!
//! [`recorded`] reports on recordings, [`simulated`] runs the paper's whole course on simulated
//! robots. Both give a [`Document`], which is data: [`html`] makes one file of it that needs no other,
//! `Display` makes text, `serde` makes JSON, and [`files`] makes all of them with the pictures beside.
#![forbid(unsafe_code)]

mod ablation;
mod calibration;
mod document;
mod error;
pub mod figure;
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
mod series;
mod simulated;
mod text;
mod unit;

pub use document::{Cell, Column, Document, Part, Section, Table};
pub use error::ReportError;
pub use files::{File, files};
pub use html::html;
pub use recorded::{Recorded, recorded};
pub use simulated::{NOTE, Simulated, SimulatedReport, simulated};
