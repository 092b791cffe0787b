//! Drawing of marks on their axes.

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind};
use plotters::element::{Circle, DashedPathElement, PathElement, Polygon, Rectangle};
use plotters::style::{Color as _, RGBColor, ShapeStyle};
use plotters_svg::SVGBackend;

use super::axis::Span;
use super::bins::Tiles;
use super::colour::Colour;
use super::mark::{Direction, Interval, Mark};
use super::thin::thinned;
use super::{Axis, Panel};

/// Drawing units per CSS pixel: the library's coordinates are integers.
pub(super) const UNITS: i32 = 10;
/// Maximum number of point columns in a panel: half a CSS pixel each on the widest.
const MAX_COLUMNS: usize = 1_200;
/// Share of a category's width that its marks occupy.
const TAKEN: f64 = 0.78;

pub(super) type Ground<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Plane<'a> = DrawingArea<SVGBackend<'a>, Cartesian2d<Span, Span>>;
pub(super) type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Legend symbol of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Swatch {
    Line,
    Dashes,
    Dot,
    Box,
    Shade,
}

impl Mark {
    pub(super) fn swatch(&self) -> Swatch {
        match self {
            Self::Line { dashed: false, .. } => Swatch::Line,
            Self::Line { .. } | Self::Rule { .. } | Self::Diagonal => Swatch::Dashes,
            Self::Points(_) | Self::Dots { .. } => Swatch::Dot,
            Self::Bars { .. } | Self::Columns { .. } | Self::Tiles(_) => Swatch::Box,
            Self::Band(_) | Self::Stripe(_) => Swatch::Shade,
        }
    }

    /// The points that the axes must include. Either coordinate may be NaN.
    pub(super) fn extent(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Line { points, .. } | Self::Points(points) => points.clone(),
            Self::Band(points) => points
                .iter()
                .filter(|point| point.iter().all(|number| number.is_finite()))
                .flat_map(|[x, low, high]| [[*x, *low], [*x, *high]])
                .collect(),
            Self::Bars { values, direction, .. } => {
                spans(values, *direction).chain([oriented(f64::NAN, 0.0, *direction)]).collect()
            }
            Self::Dots { values, direction, .. } => spans(values, *direction).collect(),
            Self::Columns { edges, heights } => edges
                .iter()
                .map(|edge| [*edge, f64::NAN])
                .chain(heights.iter().map(|height| [f64::NAN, *height]))
                .chain([[f64::NAN, 0.0]])
                .collect(),
            Self::Tiles(tiles) => {
                let x = tiles.x_edges.iter().map(|edge| [*edge, f64::NAN]);
                let y = tiles.y_edges.iter().map(|edge| [f64::NAN, *edge]);
                x.chain(y).collect()
            }
            Self::Rule { at, direction } => match direction {
                Direction::Across => vec![[f64::NAN, *at]],
                Direction::Up => vec![[*at, f64::NAN]],
            },
            Self::Stripe([from, to]) => vec![[*from, f64::NAN], [*to, f64::NAN]],
            Self::Diagonal => Vec::new(),
        }
    }

    /// True if it has data, other than guide lines.
    pub(super) fn has_data(&self, panel: &Panel) -> bool {
        let shown = |axis: &Axis, value: f64| axis.shows(value);
        match self {
            Self::Rule { .. } | Self::Stripe(_) | Self::Diagonal => false,
            Self::Columns { heights, .. } => heights.iter().any(|height| *height > 0.0),
            Self::Tiles(tiles) => tiles.counts.iter().any(|count| *count > 0),
            Self::Bars { values, .. } | Self::Dots { values, .. } => {
                values.iter().any(|interval| interval.value.is_finite())
            }
            Self::Band(points) => points.iter().any(|[x, low, high]| {
                shown(&panel.x, *x) && shown(&panel.y, *low) && shown(&panel.y, *high)
            }),
            Self::Line { .. } | Self::Points(_) => {
                self.extent().into_iter().any(|[x, y]| shown(&panel.x, x) && shown(&panel.y, y))
            }
        }
    }

    pub(super) fn draw(&self, plane: &Plane<'_>, colour: Colour, panel: &Panel) -> Drawn {
        let seen = |[x, y]: [f64; 2]| panel.x.shows(x) && panel.y.shows(y);
        match self {
            Self::Line { points, dashed } => {
                let points = thinned(points, MAX_COLUMNS);
                for run in points.chunk_by(|a, b| seen(*a) == seen(*b)) {
                    if run.first().is_some_and(|point| seen(*point)) {
                        line(plane, run, colour, *dashed)?;
                    }
                }
                Ok(())
            }
            Self::Band(points) => {
                let seen = |[x, low, high]: [f64; 3]| seen([x, low]) && seen([x, high]);
                for run in points.chunk_by(|a, b| seen(*a) == seen(*b)) {
                    if run.first().is_some_and(|point| seen(*point)) {
                        band(plane, run, colour)?;
                    }
                }
                Ok(())
            }
            Self::Points(points) => points
                .iter()
                .filter(|point| seen(**point))
                .try_for_each(|point| dot(plane, *point, 22, colour, 0.7)),
            Self::Bars { values, slot, direction } => {
                bars(plane, values, *slot, *direction, colour)
            }
            Self::Dots { values, slot, direction } => {
                dots(plane, values, *slot, *direction, colour)
            }
            Self::Columns { edges, heights } => edges
                .windows(2)
                .zip(heights)
                .filter(|(_, height)| **height > 0.0 && height.is_finite())
                .try_for_each(|(pair, height)| {
                    rectangle(plane, [pair[0], 0.0], [pair[1], *height], colour, 0.55)
                }),
            Self::Tiles(tiles) => draw_tiles(plane, tiles, colour),
            Self::Rule { at, direction } => rule(plane, *at, *direction, colour),
            Self::Stripe([from, to]) => {
                let [low, high] = plane.as_coord_spec().y_spec().ends();
                rectangle(plane, [*from, low], [*to, high], colour, 0.14)
            }
            Self::Diagonal => diagonal(plane, colour),
        }
    }
}

/// The range of values along an axis.
fn spans(values: &[Interval], direction: Direction) -> impl Iterator<Item = [f64; 2]> + '_ {
    values
        .iter()
        .filter(|interval| interval.value.is_finite())
        .flat_map(|Interval { value, low, high }| [*value, *low, *high])
        .map(move |value| oriented(f64::NAN, value, direction))
}

pub(super) fn rgb(colour: Colour) -> RGBColor {
    let [red, green, blue] = colour.light();
    RGBColor(red, green, blue)
}

/// A line style with a width in tenths of a CSS pixel.
fn stroke(colour: Colour, tenths: u32) -> ShapeStyle {
    ShapeStyle {
        color: rgb(colour).to_rgba(),
        filled: false,
        stroke_width: tenths * UNITS as u32 / 10,
    }
}

fn fill(colour: Colour, opacity: f64) -> ShapeStyle {
    ShapeStyle { color: rgb(colour).mix(opacity), filled: true, stroke_width: 0 }
}

fn pair([x, y]: [f64; 2]) -> (f64, f64) {
    (x, y)
}

fn line(plane: &Plane<'_>, points: &[[f64; 2]], colour: Colour, dashed: bool) -> Drawn {
    let points: Vec<(f64, f64)> = points.iter().copied().map(pair).collect();
    let style = stroke(colour, 13);
    if let ([only], false) = (points.as_slice(), dashed) {
        return plane.draw(&Circle::new(*only, 15, fill(colour, 1.0)));
    }
    if dashed {
        let (dash, gap) = (5 * UNITS, 4 * UNITS);
        plane.draw(&DashedPathElement::new(points, dash, gap, style))
    } else {
        plane.draw(&PathElement::new(points, style))
    }
}

fn band(plane: &Plane<'_>, points: &[[f64; 3]], colour: Colour) -> Drawn {
    let lower = points.iter().map(|[x, low, _]| (*x, *low));
    let upper = points.iter().rev().map(|[x, _, high]| (*x, *high));
    let outline: Vec<(f64, f64)> = lower.chain(upper).collect();
    plane.draw(&Polygon::new(outline, fill(colour, 0.2)))
}

fn rectangle(
    plane: &Plane<'_>,
    from: [f64; 2],
    to: [f64; 2],
    colour: Colour,
    opacity: f64,
) -> Drawn {
    // The backend expects the corners in screen order.
    let (a, b) = (plane.map_coordinate(&pair(from)), plane.map_coordinate(&pair(to)));
    let ordered = [(a.0.min(b.0), a.1.min(b.1)), (a.0.max(b.0), a.1.max(b.1))];
    let ((x_from, x_to), (y_from, y_to)) = bounds(plane);
    let inside =
        ordered.map(|(x, y)| (x.clamp(x_from, x_to) - x_from, y.clamp(y_from, y_to) - y_from));
    plane.strip_coord_spec().draw(&Rectangle::new(inside, fill(colour, opacity)))
}

fn bounds(plane: &Plane<'_>) -> ((i32, i32), (i32, i32)) {
    let (x, y) = plane.get_pixel_range();
    ((x.start, x.end), (y.start, y.end))
}

fn dot(plane: &Plane<'_>, at: [f64; 2], tenths: i32, colour: Colour, opacity: f64) -> Drawn {
    plane.draw(&Circle::new(pair(at), tenths * UNITS / 10, fill(colour, opacity)))
}

/// The intervals with a value, each with the position of its `slot` in its category, and half of
/// its width.
fn placed(
    values: &[Interval],
    [slot, slots]: [usize; 2],
) -> impl Iterator<Item = (Interval, f64, f64)> {
    let slots = slots.max(1) as f64;
    let named = values.iter().enumerate();
    let known = named.filter(|(_, interval)| interval.value.is_finite());
    known.map(move |(name, interval)| {
        let centre = name as f64 + ((slot as f64 + 0.5) / slots - 0.5) * TAKEN;
        (*interval, centre, TAKEN / slots * 0.42)
    })
}

fn oriented(along: f64, value: f64, direction: Direction) -> [f64; 2] {
    match direction {
        Direction::Up => [along, value],
        Direction::Across => [value, along],
    }
}

fn bars(
    plane: &Plane<'_>,
    values: &[Interval],
    slot: [usize; 2],
    direction: Direction,
    colour: Colour,
) -> Drawn {
    for (interval, centre, half) in placed(values, slot) {
        let from = oriented(centre - half, 0.0, direction);
        let to = oriented(centre + half, interval.value, direction);
        rectangle(plane, from, to, colour, 0.8)?;
        whisker(plane, interval, centre, half * 0.5, direction, Colour::Ink)?;
    }
    Ok(())
}

fn dots(
    plane: &Plane<'_>,
    values: &[Interval],
    slot: [usize; 2],
    direction: Direction,
    colour: Colour,
) -> Drawn {
    for (interval, centre, half) in placed(values, slot) {
        whisker(plane, interval, centre, half * 0.4, direction, colour)?;
        let at = oriented(centre, interval.value, direction);
        dot(plane, at, 36, colour, 1.0)?;
    }
    Ok(())
}

fn whisker(
    plane: &Plane<'_>,
    interval: Interval,
    centre: f64,
    half: f64,
    direction: Direction,
    colour: Colour,
) -> Drawn {
    let Interval { low, high, .. } = interval;
    if !(low.is_finite() && high.is_finite()) {
        return Ok(());
    }
    let caps = [low, high].map(|end| [(centre - half, end), (centre + half, end)]);
    for [(from, at), (to, until)] in [[(centre, low), (centre, high)], caps[0], caps[1]] {
        let ends = [oriented(from, at, direction), oriented(to, until, direction)];
        line(plane, &ends, colour, false)?;
    }
    Ok(())
}

fn draw_tiles(plane: &Plane<'_>, tiles: &Tiles, colour: Colour) -> Drawn {
    let most = tiles.counts.iter().max().copied().unwrap_or(0) as f64;
    let columns = tiles.x_edges.len().saturating_sub(1).max(1);
    for (place, count) in tiles.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let (column, row) = (place % columns, place / columns);
        let from = [tiles.x_edges[column], tiles.y_edges[row]];
        let to = [tiles.x_edges[column + 1], tiles.y_edges[row + 1]];
        let share = libm::log1p(*count as f64) / libm::log1p(most);
        // Quantised to twentieths, to keep the numbers in the file short.
        let opacity = libm::round((0.12 + 0.88 * share) * 20.0) / 20.0;
        rectangle(plane, from, to, colour, opacity)?;
    }
    Ok(())
}

fn rule(plane: &Plane<'_>, at: f64, direction: Direction, colour: Colour) -> Drawn {
    let across = direction == Direction::Across;
    let spec = plane.as_coord_spec();
    let (along, beside) =
        if across { (spec.x_spec(), spec.y_spec()) } else { (spec.y_spec(), spec.x_spec()) };
    let ([low, high], [first, last]) = (along.ends(), beside.ends());
    if !(first <= at && at <= last) {
        return Ok(());
    }
    let ends = [low, high].map(|end| if across { [end, at] } else { [at, end] });
    line(plane, &ends, colour, true)
}

fn diagonal(plane: &Plane<'_>, colour: Colour) -> Drawn {
    let spec = plane.as_coord_spec();
    let ([left, right], [bottom, top]) = (spec.x_spec().ends(), spec.y_spec().ends());
    let (from, to) = (left.max(bottom), right.min(top));
    if from < to {
        line(plane, &[[from, from], [to, to]], colour, true)?;
    }
    Ok(())
}
