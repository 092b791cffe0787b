//! Marks on axes.

use serde::Serialize;

use super::bins::{Bins, Tiles};

/// A number with an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The number.
    pub value: f64,
    /// Lower end. NaN: unknown.
    pub low: f64,
    /// Upper end. NaN: unknown.
    pub high: f64,
}

/// Direction of marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Horizontal.
    Across,
    /// Vertical.
    Up,
}

/// Marks on axes. A pair is (x, y).
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mark {
    /// A line through points in order of x.
    Line {
        /// The points.
        points: Vec<[f64; 2]>,
        /// True if it is dashed.
        dashed: bool,
    },
    /// A band of points (x, low, high).
    Band(Vec<[f64; 3]>),
    /// A dot at each point.
    Points(Vec<[f64; 2]>),
    /// A bar from 0 for each category, with its interval.
    Bars {
        /// One per category, in order.
        values: Vec<Interval>,
        /// Index and number of bars per category: `[0, 1]` if there is one.
        slot: [usize; 2],
        /// Direction of the bars. The other axis is categorical.
        direction: Direction,
    },
    /// A dot for each category, with its interval.
    Dots {
        /// One per category, in order.
        values: Vec<Interval>,
        /// Index and number of dots per category.
        slot: [usize; 2],
        /// Direction of the values. The other axis is categorical.
        direction: Direction,
    },
    /// Adjacent columns, one between each pair of edges.
    Columns {
        /// The edges, one more than heights.
        edges: Vec<f64>,
        /// The heights.
        heights: Vec<f64>,
    },
    /// Tiles, darker for higher counts.
    Tiles(Tiles),
    /// A dashed line over the whole panel: at this y if horizontal, at this x if vertical.
    Rule {
        /// Its position.
        at: f64,
        /// Its direction.
        direction: Direction,
    },
    /// A shaded range of x over the whole height.
    Stripe([f64; 2]),
    /// The dashed line x = y.
    Diagonal,
}

impl Interval {
    /// A number without an interval.
    pub const fn exact(value: f64) -> Self {
        Self { value, low: f64::NAN, high: f64::NAN }
    }
}

impl Mark {
    /// Columns of a histogram, with the share of numbers per unit of x as height.
    pub fn density(bins: &Bins) -> Self {
        let total = (bins.counts.iter().sum::<u64>() + bins.outside) as f64;
        let widths = bins.edges.windows(2).map(|pair| pair[1] - pair[0]);
        let counts = bins.counts.iter().map(|count| *count as f64);
        Self::Columns {
            edges: bins.edges.clone(),
            heights: counts.zip(widths).map(|(count, width)| count / total / width).collect(),
        }
    }
}
