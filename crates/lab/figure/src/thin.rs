//! Reduction of long lines to the visible points.

/// The line with at most four points in each of `columns` equal parts of its horizontal extent: the
/// first, the minimum, the maximum and the last. The drawing looks the same, because a pixel column
/// shows no more. Points must be in order of x. A NaN is kept as a gap.
pub(super) fn thinned(points: &[[f64; 2]], columns: usize) -> Vec<[f64; 2]> {
    let known = || points.iter().filter(|[x, y]| x.is_finite() && y.is_finite());
    let (Some(first), Some(last)) = (known().next(), known().next_back()) else {
        return Vec::new();
    };
    if points.len() <= 4 * columns || first[0] >= last[0] {
        return points.to_vec();
    }
    let width = (last[0] - first[0]) / columns as f64;
    let column_of = |x: f64| ((x - first[0]) / width) as usize;
    let mut kept = Vec::with_capacity(4 * columns);
    let is_known = |[x, y]: &[f64; 2]| x.is_finite() && y.is_finite();
    for run in points.chunk_by(|a, b| is_known(a) == is_known(b)) {
        if !run.first().is_some_and(is_known) {
            kept.push([f64::NAN, f64::NAN]);
            continue;
        }
        for column in run.chunk_by(|a, b| column_of(a[0]) == column_of(b[0])) {
            push_extremes(&mut kept, column);
        }
    }
    kept
}

fn push_extremes(kept: &mut Vec<[f64; 2]>, column: &[[f64; 2]]) {
    if column.len() <= 4 {
        kept.extend_from_slice(column);
        return;
    }
    let by_height = |a: &usize, b: &usize| column[*a][1].total_cmp(&column[*b][1]);
    let least = (0..column.len()).min_by(by_height).unwrap_or(0);
    let greatest = (0..column.len()).max_by(by_height).unwrap_or(0);
    let mut places = [0, least, greatest, column.len() - 1];
    places.sort_unstable();
    let mut previous = None;
    for place in places {
        if previous != Some(place) {
            kept.push(column[place]);
        }
        previous = Some(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_keeps_its_ends_and_its_extremes() {
        let mut points: Vec<[f64; 2]> = (0..10_000).map(|i| [f64::from(i), 0.0]).collect();
        points[4_321][1] = 9.0;
        points[777][1] = -9.0;
        let kept = thinned(&points, 100);
        assert!(kept.len() <= 400, "{}", kept.len());
        for needed in [points[0], points[4_321], points[777], points[9_999]] {
            assert!(kept.contains(&needed), "{needed:?}");
        }
        assert!(kept.is_sorted_by(|a, b| a[0] <= b[0]));
    }

    #[test]
    fn gaps_are_kept_and_short_lines_are_unchanged() {
        let short = [[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]];
        let kept = thinned(&short, 10);
        assert_eq!(kept.len(), 3);
        let mut long: Vec<[f64; 2]> = (0..1_000).map(|i| [f64::from(i), 1.0]).collect();
        for point in &mut long[400..500] {
            point[1] = f64::NAN;
        }
        let kept = thinned(&long, 10);
        assert_eq!(kept.iter().filter(|point| point[1].is_nan()).count(), 1);
        assert!(thinned(&[[f64::NAN, 1.0]], 10).is_empty());
    }
}
