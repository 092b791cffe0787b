//! One- and two-dimensional histograms.

use serde::Serialize;

/// Counts of numbers in equal bins.
#[derive(Debug, Clone, PartialEq)]
pub struct Bins {
    /// The edges, one more than bins.
    pub edges: Vec<f64>,
    /// Numbers in each bin, lower edge included. The last bin includes its upper edge.
    pub counts: Vec<u64>,
    /// Finite numbers below the first bin and above the last.
    pub outside: u64,
}

/// Counts of pairs in equal tiles.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tiles {
    /// Edges of the columns.
    pub x_edges: Vec<f64>,
    /// Edges of the rows.
    pub y_edges: Vec<f64>,
    /// Pairs in each tile, row by row from the lowest.
    pub counts: Vec<u64>,
}

/// Counts numbers in `count` equal bins from `from` to `to`. NaN is ignored.
pub fn bins(values: impl Iterator<Item = f64>, [from, to]: [f64; 2], count: usize) -> Bins {
    let count = count.max(1);
    let mut found = Bins { edges: edges([from, to], count), counts: vec![0; count], outside: 0 };
    for value in values.filter(|value| value.is_finite()) {
        match place(value, [from, to], count) {
            Some(place) => found.counts[place] += 1,
            None => found.outside += 1,
        }
    }
    found
}

/// Counts pairs in `count` by `count` equal tiles. Pairs outside are ignored.
pub fn tiles(
    pairs: impl Iterator<Item = [f64; 2]>,
    x: [f64; 2],
    y: [f64; 2],
    count: usize,
) -> Tiles {
    let count = count.max(1);
    let mut counts = vec![0; count * count];
    for [at_x, at_y] in pairs {
        if let (Some(column), Some(row)) = (place(at_x, x, count), place(at_y, y, count)) {
            counts[row * count + column] += 1;
        }
    }
    Tiles { x_edges: edges(x, count), y_edges: edges(y, count), counts }
}

fn edges([from, to]: [f64; 2], count: usize) -> Vec<f64> {
    let edge = |place: usize| from + (to - from) * place as f64 / count as f64;
    (0..=count).map(edge).collect()
}

fn place(value: f64, [from, to]: [f64; 2], count: usize) -> Option<usize> {
    (from <= value && value <= to && from < to)
        .then(|| (((value - from) / (to - from) * count as f64) as usize).min(count - 1))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn edges_belong_to_bins_and_nan_to_none() {
        let values = [0.0, 0.5, 1.0, 1.5, 2.0, -0.1, 2.1, f64::NAN];
        let found = bins(values.into_iter(), [0.0, 2.0], 2);
        assert_eq!(found.edges, [0.0, 1.0, 2.0]);
        assert_eq!(found.counts, [2, 3]);
        assert_eq!(found.outside, 2);
        let none = bins([1.0].into_iter(), [1.0, 1.0], 3);
        assert_eq!(none.counts, [0, 0, 0]);
    }

    proptest! {
        #[test]
        fn every_number_is_counted_once(
            values in proptest::collection::vec(-3.0..3.0f64, 0..200), count in 1usize..40,
        ) {
            let found = bins(values.iter().copied(), [-2.0, 2.0], count);
            let counted = found.counts.iter().sum::<u64>() + found.outside;
            prop_assert_eq!(counted, values.len() as u64);
            let pairs = values.iter().map(|value| [*value, -value]);
            let tiles = tiles(pairs, [-3.0, 3.0], [-3.0, 3.0], count);
            prop_assert_eq!(tiles.counts.iter().sum::<u64>(), values.len() as u64);
        }
    }
}
