#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod ablation;
mod comparison;
mod document;
mod draw;
mod error;
mod experiment;
mod figure;
mod files;
mod forecast;
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
