//! Reports: what was measured, as one HTML file, as pictures, as text and as JSON.

mod document;
mod html;
mod text;

pub use document::{Cell, Column, Document, Part, Section, Table};
pub use html::html;
