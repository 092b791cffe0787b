//! Figures: what is to be seen, and how it becomes SVG and PNG.
//!
//! A [`Figure`] is data: panels with labelled axes and marks on them. [`Figure::svg`] draws it with
//! `plotters`; [`Figure::png`] rasterises that drawing with a font that lies in this crate, so a
//! picture needs nothing of the machine and its bytes are the same everywhere.
//!
//! Numbers that are NaN or infinite are not drawn: a line has a hole there, a bar is left out. A
//! panel without any number says so instead of showing an empty axis.

mod axis;
mod bins;
mod colour;
mod draw;
mod mark;
mod paint;
mod picture;
mod thin;

pub use axis::{Axis, Scale};
pub use bins::{Bins, Tiles, bins, tiles};
pub use colour::Colour;
pub use mark::{Direction, Interval, Mark};

/// A picture of one or more panels.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Stem of its files and of its ids in the document: lower-case letters, digits and hyphens.
    pub name: String,
    /// What it shows, in a line.
    pub title: String,
    /// What is to be seen in it, for those who do not see it.
    pub description: String,
    /// Written small into the picture itself, so that it goes wherever the picture goes.
    pub note: Option<String>,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
    /// Panels side by side, at least 1.
    pub columns: usize,
    /// Height of a panel in CSS pixels, 100 to 2,000.
    pub panel_height_px: u32,
}

/// Axes and what is marked on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What distinguishes it from the other panels; empty for none.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// What is drawn, the first lowest.
    pub layers: Vec<Layer>,
}

/// Marks of one colour and meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its entry in the legend, which stands above the axes and never on them; none: no entry.
    pub label: Option<String>,
    /// Its colour.
    pub colour: Colour,
    /// What is drawn.
    pub mark: Mark,
}

/// Why a figure could not be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FigureError {
    /// There is nothing to lay out, or the layout is out of range.
    #[error(
        "figure {name}: {panels} panels in {columns} columns of {height_px} px height; allowed are \
         1 to 64 panels, 1 to 8 columns and 100 to 2000 px"
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
    /// The drawing library refused.
    #[error("figure {name} could not be drawn: {reason}")]
    Draw {
        /// The figure.
        name: String,
        /// What it said.
        reason: String,
    },
    /// The drawing could not be made a picture of pixels.
    #[error("figure {name} could not be rasterised: {reason}")]
    Picture {
        /// The figure.
        name: String,
        /// What was said.
        reason: String,
    },
}

impl Layer {
    /// A layer that the legend names.
    #[must_use]
    pub fn named(label: impl Into<String>, colour: Colour, mark: Mark) -> Self {
        Self {
            label: Some(label.into()),
            colour,
            mark,
        }
    }

    /// A layer that the legend does not name.
    #[must_use]
    pub fn plain(colour: Colour, mark: Mark) -> Self {
        Self {
            label: None,
            colour,
            mark,
        }
    }
}

impl Figure {
    /// A figure of panels side by side, 260 px high.
    #[must_use]
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
