//! Figures as data: panels with labelled axes, and the marks between them. The page draws them by
//! uPlot, and the Python package by matplotlib.

use serde::{Serialize, Serializer};

/// A figure of one or more panels. As JSON it is all that draws it: numbers have six digits, those
/// that are not finite are null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// Its id in the document: lower-case letters, digits and hyphens.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Text alternative (`aria`), a description of what it shows.
    pub description: String,
    /// A note in small print, so that copies keep it.
    pub note: Option<String>,
    pub(crate) panels: Vec<Panel>,
    /// Number of panels per row on paper, at least 1.
    pub(crate) columns: usize,
    /// Height of a panel, CSS pixels.
    pub(crate) panel_height_px: u32,
}

impl Figure {
    /// A figure of panels side by side, 260 px high.
    pub(crate) fn new(
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

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) layers: Vec<Layer>,
}

/// An axis, labelled with the quantity and its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Axis {
    label: String,
    scale: Scale,
    /// `None`: the range of the data plus a margin.
    limits: Option<[f64; 2]>,
    /// A number within its range, such as 0.
    includes: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Scale {
    Linear,
    /// Categories, at 0, 1, 2 and so on. On a vertical axis from the top down.
    Names(Vec<String>),
}

impl Axis {
    pub(crate) fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, limits: None, includes: None }
    }

    pub(crate) fn names(names: Vec<String>) -> Self {
        Self { scale: Scale::Names(names), ..Self::new("") }
    }

    #[must_use]
    pub(crate) fn within(mut self, from: f64, to: f64) -> Self {
        self.limits = Some([from, to]);
        self
    }

    #[must_use]
    pub(crate) fn including(mut self, value: f64) -> Self {
        self.includes = Some(value);
        self
    }
}

/// Marks of one colour and legend entry.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Layer {
    pub(crate) label: Option<String>,
    pub(crate) colour: Colour,
    pub(crate) mark: Mark,
}

impl Layer {
    pub(crate) fn named(label: impl Into<String>, colour: Colour, mark: Mark) -> Self {
        Self { label: Some(label.into()), colour, mark }
    }

    /// A layer without a legend entry.
    pub(crate) fn plain(colour: Colour, mark: Mark) -> Self {
        Self { label: None, colour, mark }
    }
}

/// A number with an interval. NaN: unknown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Interval {
    #[serde(serialize_with = "digits")]
    pub(crate) value: f64,
    #[serde(serialize_with = "digits")]
    pub(crate) low: f64,
    #[serde(serialize_with = "digits")]
    pub(crate) high: f64,
}

impl Interval {
    pub(crate) const fn exact(value: f64) -> Self {
        Self { value, low: f64::NAN, high: f64::NAN }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Direction {
    Across,
    Up,
}

/// Marks on axes. A pair is (x, y).
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Mark {
    /// A line through points in order of x, with a gap at each that is not finite.
    Line {
        #[serde(serialize_with = "line")]
        points: Vec<[f64; 2]>,
        dashed: bool,
    },
    /// A band of points (x, low, high).
    #[serde(serialize_with = "rows")]
    Band(Vec<[f64; 3]>),
    #[serde(serialize_with = "rows")]
    Points(Vec<[f64; 2]>),
    /// A horizontal bar from 0 for each category, with its interval.
    Bars(Categories),
    /// A dot for each category, with its interval.
    Dots(Categories),
    /// Adjacent columns, one between each pair of edges.
    Columns {
        #[serde(serialize_with = "numbers")]
        edges: Vec<f64>,
        #[serde(serialize_with = "numbers")]
        heights: Vec<f64>,
    },
    /// Tiles, darker for higher counts: row by row from the lowest.
    Tiles {
        #[serde(serialize_with = "numbers")]
        x_edges: Vec<f64>,
        #[serde(serialize_with = "numbers")]
        y_edges: Vec<f64>,
        counts: Vec<u64>,
    },
    /// A dashed line over the whole panel: at this y if horizontal, at this x if vertical.
    Rule { at: f64, direction: Direction },
    /// A shaded range of x over the whole height.
    Stripe([f64; 2]),
    /// The dashed line x = y.
    Diagonal,
}

/// A value for each category, in order, beside those of other layers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Categories {
    pub(crate) values: Vec<Interval>,
    /// Index and number of marks per category.
    pub(crate) slot: [usize; 2],
}

impl Mark {
    /// A histogram of `count` equal columns over `ends`: the share of all finite numbers, per unit
    /// of x.
    pub(crate) fn density(values: impl Iterator<Item = f64>, ends: [f64; 2], count: usize) -> Self {
        let (mut counts, mut total) = (vec![0_u64; count], 0_u64);
        for value in values.filter(|value| value.is_finite()) {
            total += 1;
            if let Some(place) = place(value, ends, count) {
                counts[place] += 1;
            }
        }
        let width = (ends[1] - ends[0]) / count as f64;
        let heights = counts.into_iter().map(|found| found as f64 / total as f64 / width);
        Self::Columns { edges: edges(ends, count), heights: heights.collect() }
    }

    /// Counts of pairs in `count` by `count` tiles, both axes over `ends`.
    pub(crate) fn tiles(
        pairs: impl Iterator<Item = [f64; 2]>,
        ends: [f64; 2],
        count: usize,
    ) -> Self {
        let mut counts = vec![0; count * count];
        for [x, y] in pairs {
            if let (Some(column), Some(row)) = (place(x, ends, count), place(y, ends, count)) {
                counts[row * count + column] += 1;
            }
        }
        Self::Tiles { x_edges: edges(ends, count), y_edges: edges(ends, count), counts }
    }
}

fn edges([from, to]: [f64; 2], count: usize) -> Vec<f64> {
    (0..=count).map(|place| from + (to - from) * place as f64 / count as f64).collect()
}

fn place(value: f64, [from, to]: [f64; 2], count: usize) -> Option<usize> {
    (from <= value && value <= to && from < to)
        .then(|| (((value - from) / (to - from) * count as f64) as usize).min(count - 1))
}

/// Meaning of a colour. The hues are those of Okabe and Ito (2008), which stay distinct under the
/// common colour vision deficiencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(crate) enum Colour {
    /// Text and readings.
    #[serde(rename = "#1B1F24")]
    Ink,
    #[serde(rename = "#6E7781")]
    Grey,
    /// The network.
    #[serde(rename = "#0072B2")]
    Blue,
    /// Persistence.
    #[serde(rename = "#E69F00")]
    Orange,
    /// AR(5) with velocities.
    #[serde(rename = "#009E73")]
    Green,
    /// Numbers of the paper.
    #[serde(rename = "#D55E00")]
    Vermilion,
    /// A second network, or a further baseline.
    #[serde(rename = "#AA4499")]
    Purple,
    #[serde(rename = "#56B4E9")]
    Sky,
}

/// Equal parts of a long line, of which each keeps its first, least, greatest and last point: no
/// more can be seen.
const PARTS: usize = 400;

/// The visible points of a line in order of x. Points that are not finite are kept as one gap.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let is_known = |[x, y]: &[f64; 2]| x.is_finite() && y.is_finite();
    let mut known = points.iter().filter(|point| is_known(point));
    let (first, last) = (known.next(), known.next_back());
    let (Some([from, _]), Some([to, _])) = (first, last) else {
        return points.to_vec();
    };
    let is_long = points.len() > 4 * PARTS && from < to;
    if !is_long {
        return points.to_vec();
    }
    let part = |x: f64| ((x - from) / (to - from) * PARTS as f64) as usize;
    let mut kept = Vec::with_capacity(4 * PARTS);
    for run in points.chunk_by(|a, b| is_known(a) == is_known(b)) {
        if !is_known(&run[0]) {
            kept.push([f64::NAN; 2]);
            continue;
        }
        for column in run.chunk_by(|a, b| part(a[0]) == part(b[0])) {
            let height = |at: &usize| column[*at][1];
            let by_height = |a: &usize, b: &usize| height(a).total_cmp(&height(b));
            let ends = [(0..column.len()).min_by(by_height), (0..column.len()).max_by(by_height)];
            let mut places: Vec<usize> = ends.into_iter().flatten().collect();
            places.extend([0, column.len() - 1]);
            places.sort_unstable();
            places.dedup();
            kept.extend(places.into_iter().map(|at| column[at]));
        }
    }
    kept
}

/// Six digits are more than a drawing shows.
fn short(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

fn digits<S: Serializer>(value: &f64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_f64(short(*value))
}

fn numbers<S: Serializer>(values: &[f64], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(values.iter().map(|value| short(*value)))
}

fn rows<S: Serializer, const N: usize>(points: &[[f64; N]], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(points.iter().map(|point| point.map(short).to_vec()))
}

fn line<S: Serializer>(points: &[[f64; 2]], to: S) -> Result<S::Ok, S::Error> {
    rows(&thinned(points), to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_keeps_its_ends_its_extremes_and_its_gaps() {
        let mut points: Vec<[f64; 2]> = (0..10_000).map(|i| [f64::from(i), 0.0]).collect();
        points[4_321][1] = 9.0;
        points[777][1] = -9.0;
        points[6_000..6_100].fill([6_050.0, f64::NAN]);
        let kept = thinned(&points);
        assert!(kept.len() <= 4 * PARTS, "{}", kept.len());
        for needed in [points[0], points[4_321], points[777], points[9_999]] {
            assert!(kept.contains(&needed), "{needed:?}");
        }
        assert_eq!(kept.iter().filter(|[_, y]| y.is_nan()).count(), 1);
        assert!(kept.iter().filter(|[x, _]| x.is_finite()).is_sorted_by(|a, b| a[0] <= b[0]));
        assert_eq!(thinned(&points[..1_000]), points[..1_000]);
    }

    #[test]
    fn a_histogram_counts_each_finite_number_once() {
        let values = [0.0, 0.5, 1.0, 1.5, 2.0, -0.1, 2.1, f64::NAN, f64::INFINITY];
        let found = Mark::density(values.into_iter(), [0.0, 2.0], 2);
        let Mark::Columns { edges, heights } = found else { panic!("{found:?}") };
        assert_eq!((edges, heights), (vec![0.0, 1.0, 2.0], vec![2.0 / 7.0, 3.0 / 7.0]));
        let Mark::Tiles { counts, .. } =
            Mark::tiles([[0.1, 1.9], [2.0, 0.0], [3.0, 0.0]].into_iter(), [0.0, 2.0], 2)
        else {
            unreachable!("tiles are tiles")
        };
        assert_eq!(counts, [0, 1, 1, 0]);
    }

    #[test]
    fn unknown_numbers_are_null_and_known_ones_keep_six_digits() {
        let mark = Mark::Points(vec![[1.0, f64::NAN], [123_456.789, -0.000_123_456_789]]);
        let json = serde_json::to_string(&mark).unwrap();
        assert_eq!(json, r#"{"points":[[1.0,null],[123457.0,-0.000123457]]}"#);
    }
}
