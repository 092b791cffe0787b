//! The shape of a path, whichever points describe it, and how far a robot sees along it.
//!
//! Planners give the same path with two points or with a point every millimetre. A point that lies
//! on the straight line between its neighbours, or that repeats one, says nothing about the shape.

use serde::Serialize;

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

/// Share of a stated tolerance within which points may scatter beside a straight line.
const SCATTER: f64 = 0.25;
/// Largest cell of a grid whose stairs are found without being told, m.
const MAX_CELL_M: f64 = 0.25;
/// Edges between corners of a path, at least, that a grid is found from.
const MIN_GRID_EDGES: usize = 3;
/// Corners that one straight line replaces, at most. This bounds the time.
const MAX_CORNERS: usize = 512;

/// The vertices of a path: the points at which its direction or its speed changes, where the robot
/// waits, and both ends.
#[derive(Debug, Clone)]
pub(crate) struct Shape<'a> {
    path: &'a Path,
    /// Rising by index.
    vertices: Vec<Vertex>,
    simplified: Option<Simplified>,
}

/// A vertex of a path, which may lie beside the corner that it replaces.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    at: Point,
    /// Among the path's points.
    index: usize,
}

/// A path whose corners are cut: the stairs of a planner's grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Simplified {
    /// Points of the path.
    pub points: usize,
    /// Straight lines that are driven instead.
    pub lines: usize,
    /// Distance from the path within which they lie, m.
    pub within_m: f64,
}

impl Path {
    /// How a path's corners are cut before it is driven: within [`Path::tolerance_m`], or the
    /// stairs of a grid within half a cell. `None` if nothing is cut.
    ///
    /// Stairs are corners that turn to one side and back after one cell. The cell is found from a
    /// path whose legs all lie along the axes or halfway between them, in multiples of one length
    /// of at most 25 cm. The first leg and the last may have any direction and length.
    #[must_use]
    pub fn simplified(&self) -> Option<Simplified> {
        (!self.points.is_empty()).then(|| Shape::new(self).simplified).flatten()
    }
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
        let vertex = |(index, at): (usize, &Point)| Vertex { at: *at, index };
        let all: Vec<Vertex> = path.points.iter().enumerate().map(vertex).collect();
        let mut exact = thinned(path, &all, ROUNDING_M);
        let corners = exact.len();
        let cut = match path.tolerance_m {
            Some(within_m) if within_m > 0.0 => {
                // Points that scatter would leave no room at their corners.
                let within_m = f64::from(within_m);
                exact = thinned(path, &exact, SCATTER * within_m);
                Some(Cut { within_m: (1.0 - SCATTER) * within_m, cell_m: None })
            }
            Some(_) => None,
            None => cell_m(&exact).map(|cell| Cut { within_m: 0.5 * cell, cell_m: Some(cell) }),
        };
        let taut = cut.map(|cut| cut.taut(path, &exact));
        let vertices = thinned(path, taut.as_ref().unwrap_or(&exact), TOLERANCE_M);
        let cut_m = path.tolerance_m.map(f64::from).or(cut.map(|cut| cut.within_m));
        let (lines, is_cut) = (vertices.len() - 1, taut.is_some_and(|taut| taut.len() < corners));
        let simplified = cut_m.filter(|_| is_cut).map(|within_m| Simplified {
            points: path.points.len(),
            lines,
            within_m,
        });
        Self { path, vertices, simplified }
    }

    /// Number of vertices: one if all points are in the same place.
    pub(crate) const fn count(&self) -> usize {
        self.vertices.len()
    }

    /// The place of a vertex.
    pub(crate) fn at(&self, vertex: usize) -> Point {
        self.vertices[vertex].at
    }

    /// Index of a vertex among the path's points.
    pub(crate) fn index(&self, vertex: usize) -> usize {
        self.vertices[vertex].index
    }

    /// The speed asked for towards a vertex, m/s.
    pub(crate) fn speed_mps(&self, vertex: usize) -> f64 {
        self.path.speed_mps[self.index(vertex)]
    }

    /// Time that the robot waits at a vertex, s.
    pub(crate) fn dwell_s(&self, vertex: usize) -> f64 {
        self.path.dwell_s.get(self.index(vertex)).copied().unwrap_or(0.0)
    }

    /// The vertex that the robot faces at first: one that is elsewhere, and not in the first cell of
    /// a grid, whose centre says nothing about the way.
    pub(crate) fn faced(&self) -> Point {
        let cell_m = self.simplified.map_or(0.0, |cut| 2.0 * cut.within_m);
        let is_away = |vertex: &usize| length(to(self.at(0), self.at(*vertex))) > cell_m;
        let last = self.count() - 1;
        self.at((1..last).find(is_away).unwrap_or(last))
    }

    /// Share of the edge to a vertex, from 0 to 1, beside which a point lies, and its length, m.
    pub(crate) fn beside(&self, from: Point, vertex: usize) -> (f64, f64) {
        let (begin, end) = (self.at(vertex - 1), self.at(vertex));
        let edge = to(begin, end);
        let square = dot(edge, edge).max(f64::MIN_POSITIVE);
        ((dot(to(begin, from), edge) / square).clamp(0.0, 1.0), length(edge))
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
            let is_far = passed - vertex >= MAX_PASSED || length(near) >= look_m;
            if is_far || self.dwell_s(passed) > 0.0 {
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

/// The vertices of `of` between which the others lie on straight lines of one speed without a wait,
/// up to a tolerance, m. The first and the last are among them, unless all are in the same place.
fn thinned(path: &Path, of: &[Vertex], tolerance_m: f64) -> Vec<Vertex> {
    let mut kept = Vec::from_iter(of.first().copied());
    for part in of.chunk_by(|before, _| !waits(path, *before)) {
        // Each part ends where the robot waits. The next one begins there.
        thin(path, &mut kept, part, tolerance_m);
        let last = part[part.len() - 1];
        if waits(path, last) && kept.last().is_some_and(|end| end.index != last.index) {
            kept.push(last);
        }
    }
    kept
}

fn waits(path: &Path, at: Vertex) -> bool {
    path.dwell_s.get(at.index).is_some_and(|dwell_s| *dwell_s > 0.0)
}

/// Continues `kept`, whose last vertex is where a part begins.
fn thin(path: &Path, kept: &mut Vec<Vertex>, of: &[Vertex], tolerance_m: f64) {
    // The line from the last kept vertex: all since lie within the cone.
    let (mut last, mut farthest_m, mut cone) = (kept[kept.len() - 1], 0.0f64, None);
    let mut place = 0;
    while let Some(point) = of.get(place).copied() {
        let offset = to(kept[kept.len() - 1].at, point.at);
        let away_m = length(offset);
        let is_begun = farthest_m > tolerance_m;
        let speed = |of: Vertex| path.speed_mps[of.index];
        let continues = !is_begun || speed(point) == speed(last);
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
}

/// How corners are cut.
#[derive(Debug, Clone, Copy)]
struct Cut {
    within_m: f64,
    /// Only the stairs of such cells.
    cell_m: Option<f64>,
}

/// Sine of the angle by which the path turns at a corner, above 0 to the left. 0 if it turns back.
fn turn([before, corner, after]: [Point; 3]) -> f64 {
    let (came, goes) = (to(before, corner), to(corner, after));
    let sine = cross(came, goes) / (length(came) * length(goes)).max(f64::MIN_POSITIVE);
    if dot(came, goes) < -1e-9 * length(came) * length(goes) { 0.0 } else { sine }
}

/// Multiples of a cell along both axes, if an edge lies on its grid.
fn cells(edge: Vector, cell_m: f64) -> Option<(f64, f64)> {
    let (x, y) = ((edge.0.abs() / cell_m).round(), (edge.1.abs() / cell_m).round());
    // Planners round to a millimetre.
    let near = |found_m: f64, cells: f64| (found_m.abs() - cells * cell_m).abs() <= 0.05 * cell_m;
    let is_on_grid = near(edge.0, x) && near(edge.1, y) && (x == 0.0 || y == 0.0 || x == y);
    is_on_grid.then_some((x, y))
}

/// The cell of the grid on which a path's corners lie, m.
fn cell_m(vertices: &[Vertex]) -> Option<f64> {
    let inner = vertices.get(1..vertices.len().saturating_sub(1))?;
    let edges = || inner.windows(2).map(|pair| to(pair[0].at, pair[1].at));
    let size = |edge: Vector| edge.0.abs().max(edge.1.abs());
    let cell_m = edges().map(size).fold(f64::INFINITY, f64::min);
    let is_cell = (TOLERANCE_M..=MAX_CELL_M).contains(&cell_m) && edges().count() >= MIN_GRID_EDGES;
    (is_cell && edges().all(|edge| cells(edge, cell_m).is_some())).then_some(cell_m)
}

impl Cut {
    /// The shortest way that passes a path's corners on their inner side, as a taut string does.
    fn taut(&self, path: &Path, of: &[Vertex]) -> Vec<Vertex> {
        let mut kept = Vec::from_iter(of.first().copied());
        let mut begin = 0;
        for end in 1..of.len() {
            if end - begin >= MAX_CORNERS || self.beside_m(path, of, end) <= 0.0 {
                pull(&mut kept, &of[begin..=end], |corner| self.beside_m(path, of, begin + corner));
                begin = end;
            }
        }
        kept
    }

    /// How far from a corner it may be passed, m. 0 where the robot waits or changes its speed, where
    /// the path turns back, and at the end.
    fn beside_m(&self, path: &Path, of: &[Vertex], corner: usize) -> f64 {
        let (at, speed) = (|place: usize| of[place].at, |of: &Vertex| path.speed_mps[of.index]);
        let is_fixed = of.get(corner + 1).is_none_or(|next| speed(next) != speed(&of[corner]));
        if is_fixed || waits(path, of[corner]) || across(of, corner).is_none() {
            return 0.0;
        }
        let sine = |place: usize| {
            let is_inner = place > 0 && place + 1 < of.len();
            if is_inner { turn([at(place - 1), at(place), at(place + 1)]) } else { 0.0 }
        };
        let is_stair = |cell_m: f64| {
            let between = |from: usize, until: usize| {
                let edge = cells(to(at(from), at(until)), cell_m);
                let is_cell = edge.is_some_and(|(x, y)| x.max(y) == 1.0);
                is_cell && sine(from) * sine(until) < -0.25
            };
            between(corner - 1, corner) || between(corner, corner + 1)
        };
        let edges_m = [(corner - 1, corner), (corner, corner + 1)]
            .map(|(from, until)| 0.5 * length(to(at(from), at(until))));
        match self.cell_m {
            Some(cell_m) if !is_stair(cell_m) => 0.0,
            _ => self.within_m.min(edges_m[0]).min(edges_m[1]),
        }
    }
}

/// The direction to the left across a corner's bisector. `None` where the path turns back, or ends.
fn across(of: &[Vertex], corner: usize) -> Option<Vector> {
    let unit = |from: usize, until: usize| {
        let edge = to(of[from].at, of[until].at);
        (length(edge) > 0.0).then(|| (edge.0 / length(edge), edge.1 / length(edge)))
    };
    let goes = (corner + 1 < of.len()).then(|| unit(corner, corner + 1)).flatten()?;
    let came = unit(corner.checked_sub(1)?, corner)?;
    let along = (came.0 + goes.0, came.1 + goes.1);
    (length(along) > 0.5).then(|| (-along.1 / length(along), along.0 / length(along)))
}

/// Appends the shortest way through gates at the corners of a part of a path. `kept` ends where the
/// part begins. This is the funnel algorithm: the funnel holds all directions from its apex that pass
/// the gates so far.
fn pull(kept: &mut Vec<Vertex>, of: &[Vertex], beside_m: impl Fn(usize) -> f64) {
    let last = of.len() - 1;
    // Right and left end of the gate at a corner.
    let gate = |corner: usize| {
        let at = of[corner].at;
        let end = (corner < last).then(|| across(of, corner)).flatten();
        let (wide_m, (x, y)) = end.map_or((0.0, (0.0, 0.0)), |left| (beside_m(corner), left));
        [-wide_m, wide_m].map(|aside_m| Point::new(at.x_m + aside_m * x, at.y_m + aside_m * y))
    };
    let (mut apex, mut right, mut left) = (of[0].at, (of[0].at, 0), (of[0].at, 0));
    let mut place = 1;
    while place <= last {
        let [new_right, new_left] = gate(place);
        let side = |of: Point, beside: Point| cross(to(apex, of), to(apex, beside));
        if side(right.0, new_right) >= 0.0 {
            if right.0 != apex && left.0 != apex && side(left.0, new_right) > 0.0 {
                kept.push(Vertex { at: left.0, index: of[left.1].index });
                place = left.1 + 1;
                (apex, right) = (left.0, left);
                continue;
            }
            right = (new_right, place);
        }
        if side(left.0, new_left) <= 0.0 {
            if left.0 != apex && right.0 != apex && side(right.0, new_left) < 0.0 {
                kept.push(Vertex { at: right.0, index: of[right.1].index });
                place = right.1 + 1;
                (apex, left) = (right.0, right);
                continue;
            }
            left = (new_left, place);
        }
        place += 1;
    }
    kept.push(of[last]);
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
