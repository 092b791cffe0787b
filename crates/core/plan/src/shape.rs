//! The shape of a path, whichever points describe it, and how far a robot sees along it.
//!
//! Planners give the same path with two points or with a point every millimetre. A point that lies
//! on the straight line between its neighbours, or that repeats one, says nothing about the shape.

use crate::path::{Path, Point, REACH_M, distance_m};

/// Points this close to the line through their neighbours are rounded, m.
const ROUNDING_M: f64 = 1e-5;
/// Points this close to it do not change how a robot drives, m.
const TOLERANCE_M: f64 = 1e-3;
/// Distance by which a robot may pass beside the path's vertices where it sees past them, m: half
/// of that at which a point is reached.
pub(crate) const BESIDE_M: f64 = 0.025;
/// Vertices that a robot looks past, at most. This bounds the time of a step: a metre of a path whose
/// speed changes every millimetre.
const MAX_PASSED: usize = 1_024;

/// The vertices of a path: the points at which its direction or its speed changes, and both ends.
#[derive(Debug, Clone)]
pub(crate) struct Shape<'a> {
    path: &'a Path,
    /// Their indices among the path's points. Rising.
    vertices: Vec<usize>,
}

/// The point that a robot heads for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ahead {
    pub(crate) goal: Point,
    /// The vertex at the goal, or the one after it.
    pub(crate) vertex: usize,
}

impl<'a> Shape<'a> {
    /// The shape of a path with at least one point.
    pub(crate) fn new(path: &'a Path) -> Self {
        let all: Vec<usize> = (0..path.points.len()).collect();
        let exact = thinned(path, &all, ROUNDING_M);
        Self { path, vertices: thinned(path, &exact, TOLERANCE_M) }
    }

    /// Number of vertices: one if all points are in the same place.
    pub(crate) const fn count(&self) -> usize {
        self.vertices.len()
    }

    /// The place of a vertex.
    pub(crate) fn at(&self, vertex: usize) -> Point {
        self.path.points[self.vertices[vertex]]
    }

    /// Index of a vertex among the path's points.
    pub(crate) fn index(&self, vertex: usize) -> usize {
        self.vertices[vertex]
    }

    /// The speed asked for towards a vertex, m/s.
    pub(crate) fn speed_mps(&self, vertex: usize) -> f64 {
        self.path.speed_mps[self.vertices[vertex]]
    }

    /// True if a robot has passed a vertex, not the last, and is near the line to the next one.
    pub(crate) fn is_behind(&self, from: Point, vertex: usize) -> bool {
        let at = self.at(vertex);
        let (came, goes) = (to(self.at(vertex - 1), at), to(at, self.at(vertex + 1)));
        let past = to(at, from);
        let beside_m = cross(goes, past).abs() / length(goes).max(f64::MIN_POSITIVE);
        dot(came, past) > 0.0 && dot(goes, past) > 0.0 && beside_m <= REACH_M
    }

    /// True if a robot has passed a point of the path which lies before a vertex.
    pub(crate) fn is_abeam(&self, from: Point, point: usize, vertex: usize) -> bool {
        let (begin, end) = (self.at(vertex - 1), self.at(vertex));
        dot(to(begin, end), to(self.path.points[point], from)) > 0.0
    }

    /// The farthest point of the path, from a vertex on, that a robot can drive to in a straight
    /// line and pass no vertex in between at more than [`BESIDE_M`]. It is at least the vertex, and
    /// `look_m` bounds how far the vertices are that it looks past.
    pub(crate) fn ahead(&self, from: Point, vertex: usize, look_m: f64) -> Ahead {
        let mut ahead = Ahead { goal: self.at(vertex), vertex };
        let mut cone = None;
        for passed in vertex..self.count() - 1 {
            let near = to(from, self.at(passed));
            if passed - vertex >= MAX_PASSED || length(near) >= look_m {
                break;
            }
            cone = narrowed(cone, near, BESIDE_M);
            let (along, far) =
                (to(self.at(passed), self.at(passed + 1)), to(from, self.at(passed + 1)));
            // What is behind a robot is seen from where the path turns.
            if dot(along, near) < 0.0 {
                break;
            }
            ahead.vertex = passed + 1;
            let edge = match cone {
                Some((right, _)) if cross(right, far) < 0.0 => right,
                Some((_, left)) if cross(far, left) < 0.0 => left,
                _ => {
                    ahead.goal = self.at(passed + 1);
                    continue;
                }
            };
            // Where the path leaves the cone.
            let share = -cross(edge, near) / cross(edge, along);
            let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
            let at = self.at(passed);
            ahead.goal = Point::new(at.x_m + share * along.0, at.y_m + share * along.1);
            break;
        }
        ahead
    }
}

/// The points of `of` between which the others lie on straight lines of one speed, up to a
/// tolerance, m. The first and the last are among them, unless all are in the same place.
fn thinned(path: &Path, of: &[usize], tolerance_m: f64) -> Vec<usize> {
    let mut kept = Vec::from_iter(of.first().copied());
    // The line from the last kept point: all points since lie within the cone.
    let (mut last, mut farthest_m, mut cone) = (kept[0], 0.0f64, None);
    let mut place = 1;
    while let Some(point) = of.get(place).copied() {
        let from = kept[kept.len() - 1];
        let offset = to(path.points[from], path.points[point]);
        let away_m = length(offset);
        let is_begun = farthest_m > tolerance_m;
        let continues = !is_begun || path.speed_mps[point] == path.speed_mps[last];
        let is_ahead = away_m >= farthest_m - tolerance_m;
        if continues && is_ahead && (away_m <= tolerance_m || is_within(cone, offset)) {
            cone = narrowed(cone, offset, tolerance_m);
            (last, farthest_m) = (point, farthest_m.max(away_m));
            place += 1;
        } else {
            kept.push(last);
            (farthest_m, cone) = (0.0, None);
        }
    }
    if farthest_m > 0.0 {
        kept.push(last);
    }
    kept
}

/// A vector, m.
type Vector = (f64, f64);

/// Directions between two, as unit vectors: clockwise of it the first, counter-clockwise the second.
type Cone = (Vector, Vector);

fn to(from: Point, at: Point) -> Vector {
    (at.x_m - from.x_m, at.y_m - from.y_m)
}

fn length(of: Vector) -> f64 {
    distance_m(Point::new(0.0, 0.0), Point::new(of.0, of.1))
}

fn dot(one: Vector, other: Vector) -> f64 {
    one.0 * other.0 + one.1 * other.1
}

/// Above 0 if the other is counter-clockwise of the one.
fn cross(one: Vector, other: Vector) -> f64 {
    one.0 * other.1 - one.1 * other.0
}

fn is_within(cone: Option<Cone>, direction: Vector) -> bool {
    cone.is_none_or(|(right, left)| cross(right, direction) >= 0.0 && cross(direction, left) >= 0.0)
}

/// The directions of a cone that pass a point within a distance.
fn narrowed(cone: Option<Cone>, point: Vector, within_m: f64) -> Option<Cone> {
    let away_m = length(point);
    if away_m <= within_m {
        return cone;
    }
    let (x, y) = (point.0 / away_m, point.1 / away_m);
    let sine = within_m / away_m;
    let cosine = (1.0 - sine * sine).sqrt();
    let (mut right, mut left) = (
        (x * cosine + y * sine, y * cosine - x * sine),
        (x * cosine - y * sine, y * cosine + x * sine),
    );
    if let Some(before) = cone {
        right = if cross(before.0, right) < 0.0 { before.0 } else { right };
        left = if cross(left, before.1) < 0.0 { before.1 } else { left };
    }
    Some((right, left))
}
