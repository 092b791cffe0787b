//! Bounds of a rate from a count.

/// Upper bound of a Poisson distribution's mean, given a count of at most `count`, at `confidence`
/// (0 to 1, exclusive): the exact one-sided bound (Garwood 1936). For no event at 95 % it is 3.0.
pub fn upper_mean(count: u64, confidence: f64) -> f64 {
    let rarest = 1.0 - confidence;
    let above = 10.0 + 4.0 * count as f64 - 2.0 * libm::log(rarest);
    // P(at most `count`) falls with the mean.
    bisect(0.0, above, |mean| at_most(count, mean) > rarest)
}

/// Probability of at most `count` events if `mean` are expected.
fn at_most(count: u64, mean: f64) -> f64 {
    // In logarithms, so that large means do not underflow term by term.
    let (mut log_term, mut sum) = (-mean, libm::exp(-mean));
    for number in 1..=count {
        log_term += libm::log(mean / number as f64);
        sum += libm::exp(log_term);
    }
    sum.min(1.0)
}

/// Upper bound of the probability to continue after each step. `steps` is the total number of steps
/// in `runs` runs up to their first stop. It is the exact upper bound at `confidence` of a
/// geometric distribution's parameter, and of a share of which `steps` of `steps + runs` were seen
/// (Clopper and Pearson 1934). 1 without runs.
pub fn upper_decay(steps: u64, runs: u64, confidence: f64) -> f64 {
    if runs == 0 {
        return 1.0;
    }
    let rarest = 1.0 - confidence;
    bisect(0.0, 1.0, |goes_on| few_steps(steps, runs, goes_on) > rarest)
}

/// Probability of at most `steps` before the stop number `runs`: of the negative binomial
/// distribution.
fn few_steps(steps: u64, runs: u64, goes_on: f64) -> f64 {
    let mut log_term = runs as f64 * libm::log1p(-goes_on);
    let mut sum = libm::exp(log_term);
    for step in 1..=steps {
        let step = step as f64;
        log_term += libm::log(goes_on * (runs as f64 + step - 1.0) / step);
        sum += libm::exp(log_term);
    }
    sum.min(1.0)
}

/// The point where `holds`, true below and false above, changes.
fn bisect(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_are_those_of_the_tables() {
        // Garwood, "Fiducial limits for the Poisson distribution", one-sided 95 % and 99 %.
        for (count, confidence, bound) in [
            (0, 0.95, 2.9957),
            (1, 0.95, 4.7439),
            (5, 0.95, 10.513),
            (20, 0.95, 29.062),
            (0, 0.99, 4.6052),
            (10, 0.99, 20.145),
        ] {
            let found = upper_mean(count, confidence);
            assert!((found - bound).abs() < 1e-3 * bound, "{count}: {found}");
            // The count is as rare at the bound as stated.
            assert!((at_most(count, found) - (1.0 - confidence)).abs() < 1e-9);
        }
        // No step in ten runs: (1 − q)¹⁰ = 5 %.
        let decay = upper_decay(0, 10, 0.95);
        assert!((decay - (1.0 - 0.05_f64.powf(0.1))).abs() < 1e-9, "{decay}");
        assert_eq!(upper_decay(3, 0, 0.95), 1.0);
        // Clopper and Pearson, two-sided 95 %: 0 of 10, 1 of 20, 5 of 200.
        for (found, others, expected) in [(0, 10, 0.308), (1, 19, 0.249), (5, 195, 0.0574)] {
            let bound = upper_decay(found, others, 0.975);
            assert!((bound - expected).abs() < 1e-3, "{found} and {others}: {bound}");
        }
    }
}
