//! The step of a monitor, from its readings.

/// Distance from the grid that counts as on it, steps: recorded numbers are rounded.
const NEAR_GRID: f64 = 0.05;
/// Steps that are tried, from the quantiles of the gaps between readings.
const CANDIDATES: usize = 40;
/// Number of different readings that is too small to show their step.
const FEW_VALUES: usize = 10;
/// Most steps from the lowest reading to the highest: a finer grid is that of the file's decimals.
const MAX_STEPS: f64 = 2e4;

/// The largest step of which all readings are whole multiples apart, if they have one. `sorted`:
/// finite readings in ascending order.
///
/// Each different reading is compared with the final step, so that one reading in front of a
/// continuum is no step of it.
#[must_use]
pub fn resolution(sorted: &[f64]) -> Option<f64> {
    let mut values = sorted.to_vec();
    values.dedup();
    if values.len() <= FEW_VALUES {
        return None;
    }
    let mut gaps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable_by(f64::total_cmp);
    let last = gaps.len() - 1;
    // Recorded numbers are rounded, so the smallest gap may be that of the rounding.
    let candidates = (0..=CANDIDATES).rev().map(|nth| gaps[last * nth / CANDIDATES]);
    candidates.filter_map(|step| grid(&values, step)).next()
}

/// The exact step, if all values are whole steps above the first.
fn grid(values: &[f64], step: f64) -> Option<f64> {
    let start = *values.first()?;
    let span = *values.last()? - start;
    if !(step > 0.0 && span / step < MAX_STEPS) {
        return None;
    }
    let mut exact = step;
    for value in values {
        let steps = ((value - start) / exact).round();
        // The further from the start, the more exact.
        if steps >= 1.0 {
            let refined = (value - start) / steps;
            // A step that moves follows a continuum.
            if (refined / step - 1.0).abs() > NEAR_GRID {
                return None;
            }
            exact = refined;
        }
    }
    let is_on = |value: &f64| {
        let steps = (value - start) / exact;
        (steps - steps.round()).abs() <= NEAR_GRID
    };
    if !values.iter().all(is_on) {
        return None;
    }
    // A step as large as the distance between a few groups shows nothing of the values in them.
    let mut steps: Vec<i64> =
        values.iter().map(|value| ((value - start) / exact).round() as i64).collect();
    steps.dedup();
    (steps.len() > FEW_VALUES).then_some(exact)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_is_found_and_a_continuum_has_none() {
        let mut grid: Vec<f64> =
            (0..200).map(|step| 3.0 + 0.01 * f64::from(step * 7 % 101)).collect();
        grid.sort_unstable_by(f64::total_cmp);
        let step = resolution(&grid).expect("a grid");
        assert!((step - 0.01).abs() < 1e-9, "{step}");
        // Steps of 615.38 mW in a file of two decimals.
        let mut rounded: Vec<f64> = (0..400)
            .map(|at| {
                let exact = f64::from(at % 61) * 0.615_384_6 + f64::from(at % 3) * 1e-5;
                (exact * 1e5).round() / 1e5
            })
            .collect();
        rounded.sort_unstable_by(f64::total_cmp);
        let step = resolution(&rounded).expect("a grid");
        assert!((step - 0.615_384_6).abs() < 1e-4, "{step}");
        let mut smooth: Vec<f64> = (0..200).map(|at| f64::from(at).sqrt()).collect();
        smooth.sort_unstable_by(f64::total_cmp);
        assert_eq!(resolution(&smooth), None);
    }

    /// Numbers that stand for "no reading".
    #[test]
    fn a_step_as_large_as_the_span_is_none() {
        for outlier in [-999.0, -9_999.0, 65_535.0] {
            let mut values: Vec<f64> = (0..200)
                .map(|at| 24.0 + f64::from(at % 97).sqrt() + 1e-4 * f64::from(at))
                .collect();
            values.push(outlier);
            values.sort_unstable_by(f64::total_cmp);
            assert_eq!(resolution(&values), None, "{outlier}");
        }
    }

    /// A zero, a robot that boots, and plain noise, to the recorded decimals.
    #[test]
    fn readings_beside_a_continuum_are_no_step_of_it() {
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        for (first, mean, std) in [(0.0, 4.6, 0.3), (10.0, 40.0, 1.0), (40.0, 40.0, 1.0)] {
            for decimals in [4, 5, 6] {
                let factor = 10f64.powi(decimals);
                let mut values = vec![first];
                values.extend((0..3_000).map(|_| mean + std * normal()));
                values.iter_mut().for_each(|x| *x = (*x * factor).round() / factor);
                values.sort_unstable_by(f64::total_cmp);
                let found = resolution(&values);
                let span = values[values.len() - 1] - values[0];
                // The grid of the file's decimals may be found, if it is coarse enough.
                let decimal = found.is_none_or(|step| step < 2.0 / factor && span * factor < 2e4);
                assert!(decimal, "{first} {mean} {decimals}: {found:?}");
            }
        }
    }
}
