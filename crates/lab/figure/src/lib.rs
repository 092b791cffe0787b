//! Figures as data, and their drawing as SVG and PNG.
//!
//! ```
//! use joulebus_figure::{Axis, Colour, Figure, Layer, Mark, Panel};
//!
//! let points = vec![[0.0, 4.0], [1.0, 4.2], [2.0, f64::NAN], [3.0, 4.1]];
//! let panel = Panel {
//!     title: String::new(),
//!     x: Axis::new("time (s)"),
//!     y: Axis::new("power (W)"),
//!     layers: vec![Layer::named("readings", Colour::Ink, Mark::Line { points, dashed: false })],
//! };
//! let figure = Figure::new("power", "Power", "Three readings with a gap.", vec![panel]);
//! assert!(figure.svg()?.contains("power (W)"));
//! assert_eq!(figure.svg()?, figure.svg()?);
//! # Ok::<(), joulebus_figure::FigureError>(())
//! ```
//!
//! **Three types to know.** A [`Figure`] is data: panels with labelled axes. [`Figure::svg`] draws
//! it with `plotters`, and [`Figure::png`] rasterises that drawing with the font in this crate. So
//! a figure depends on nothing of the machine, and its bytes are the same everywhere. A [`Panel`]
//! is two axes and the layers between them. A [`Mark`] is what a layer draws.
//!
//! **Units** stand in the labels of the axes. Sizes are in CSS pixels.
//!
//! **Unknown values.** Numbers that are NaN or infinite are not drawn: a line has a gap there, a
//! bar is omitted. A panel without data shows a note instead of an empty axis. In JSON they are
//! null, so that another library can draw the figure.
//!
//! **Errors** ([`FigureError`]) name the figure: a layout out of range with the allowed one, or the
//! failure of a drawing library.
//!
//! **In the book**: [figures and reports are data][1], [a report with one command][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/figures.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/report.md
#![forbid(unsafe_code)]

mod axis;
mod bins;
mod colour;
mod draw;
mod mark;
mod paint;
mod picture;
mod thin;

use serde::Serialize;

pub use axis::{Axis, Scale};
pub use bins::{Bins, Tiles, bins, tiles};
pub use colour::Colour;
pub use mark::{Direction, Interval, Mark};

/// A figure of one or more panels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// Stem of its file names and ids in the document: lower-case letters, digits and hyphens.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Text alternative (`aria`), a description of what it shows.
    pub description: String,
    /// A note in small print inside the figure, so that copies keep it.
    pub note: Option<String>,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
    /// Number of panels per row, at least 1.
    pub columns: usize,
    /// Height of a panel in CSS pixels, 100 to 2,000.
    pub panel_height_px: u32,
}

/// Axes with marks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Panel {
    /// Its title. Empty for none.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The layers, drawn in order.
    pub layers: Vec<Layer>,
}

/// Marks of one colour and legend entry.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Layer {
    /// Its legend entry, above the axes. `None`: no entry.
    pub label: Option<String>,
    /// Its colour.
    pub colour: Colour,
    /// Its marks.
    pub mark: Mark,
}

/// Errors of drawing a figure.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FigureError {
    /// There are no panels, or the layout is out of range.
    #[error(
        "figure {name}: {panels} panels in {columns} columns of {height_px} px height, allowed \
            are 1 to 64 panels, 1 to 8 columns and 100 to 2000 px"
    )]
    Layout {
        /// The figure.
        name: String,
        /// Its panels.
        panels: usize,
        /// Its columns.
        columns: usize,
        /// Its panels' height, px.
        height_px: u32,
    },
    /// The drawing library failed.
    #[error("figure {name} could not be drawn: {reason}")]
    Draw {
        /// The figure.
        name: String,
        /// Its error.
        reason: String,
    },
    /// The drawing could not be rasterised.
    #[error("figure {name} could not be rasterised: {reason}")]
    Picture {
        /// The figure.
        name: String,
        /// The error.
        reason: String,
    },
}

impl Layer {
    /// A layer with a legend entry.
    pub fn named(label: impl Into<String>, colour: Colour, mark: Mark) -> Self {
        Self { label: Some(label.into()), colour, mark }
    }

    /// A layer without a legend entry.
    pub fn plain(colour: Colour, mark: Mark) -> Self {
        Self { label: None, colour, mark }
    }
}

impl Figure {
    /// A figure of panels side by side, 260 px high.
    pub fn new(
        name: impl Into<String>,
        title: impl Into<String>,
        description: impl Into<String>,
        panels: Vec<Panel>,
    ) -> Self {
        Self {
            name: name.into(),
            title: title.into(),
            description: description.into(),
            note: None,
            columns: panels.len().clamp(1, 2),
            panels,
            panel_height_px: 260,
        }
    }
}
