//! What can stand on axes.

use super::bins::{Bins, Tiles};

/// A number and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The number.
    pub value: f64,
    /// Lower end; NaN: not known.
    pub low: f64,
    /// Upper end; NaN: not known.
    pub high: f64,
}

/// Which way something goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From left to right.
    Across,
    /// From the bottom up.
    Up,
}

/// Marks on axes. A pair is (x, y).
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A line through points in order of x.
    Line {
        /// The points.
        points: Vec<[f64; 2]>,
        /// Whether it is dashed.
        dashed: bool,
    },
    /// A ribbon, from (x, low, high) to (x, low, high).
    Band(Vec<[f64; 3]>),
    /// A dot at each point.
    Points(Vec<[f64; 2]>),
    /// A bar from 0 for each name of an axis, as long as its value, with its interval.
    Bars {
        /// One a name, in order.
        values: Vec<Interval>,
        /// Which of how many bars of each name: `[0, 1]` if there is one.
        slot: [usize; 2],
        /// Which way the bars go; the names are on the other axis.
        direction: Direction,
    },
    /// A dot for each name of an axis, with its interval.
    Dots {
        /// One a name, in order.
        values: Vec<Interval>,
        /// Which of how many dots of each name.
        slot: [usize; 2],
        /// Which way the values go; the names are on the other axis.
        direction: Direction,
    },
    /// Columns without gaps, from each edge to the next.
    Columns {
        /// The edges, one more than heights.
        edges: Vec<f64>,
        /// The heights.
        heights: Vec<f64>,
    },
    /// Tiles, the darker the more pairs lie in them.
    Tiles(Tiles),
    /// A dashed line over the whole panel: at this y if it goes across, at this x if it goes up.
    Rule {
        /// Where.
        at: f64,
        /// Which way.
        direction: Direction,
    },
    /// What lies between two x, over the whole height.
    Stripe([f64; 2]),
    /// The dashed line on which both axes have the same number.
    Diagonal,
}

impl Interval {
    /// A number of which nothing more is known.
    #[must_use]
    pub const fn exact(value: f64) -> Self {
        Self {
            value,
            low: f64::NAN,
            high: f64::NAN,
        }
    }
}

impl Mark {
    /// Columns of a histogram, with the share of numbers per unit of x as height.
    #[must_use]
    pub fn density(bins: &Bins) -> Self {
        let total = (bins.counts.iter().sum::<u64>() + bins.outside) as f64;
        let widths = bins.edges.windows(2).map(|pair| pair[1] - pair[0]);
        let counts = bins.counts.iter().map(|count| *count as f64);
        Self::Columns {
            edges: bins.edges.clone(),
            heights: counts
                .zip(widths)
                .map(|(count, width)| count / total / width)
                .collect(),
        }
    }
}
