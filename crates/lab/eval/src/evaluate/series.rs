//! The live path of a trial as time series of readings and their forecasts.

use super::RobotEvaluation;

/// Scored readings of a trial, in order. All columns have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Series {
    /// Time since the trial's first row, s.
    pub time_s: Vec<f64>,
    /// The readings, W.
    pub reading_w: Vec<f64>,
    /// The forecast of the reading, made one tick before, W.
    pub forecast_w: Vec<f64>,
    /// Lower end of its interval, W. NaN without an interval.
    pub lo_w: Vec<f64>,
    /// Upper end of its interval, W. NaN without an interval.
    pub hi_w: Vec<f64>,
}

impl Series {
    /// The scored readings of a trial.
    pub fn new(robot: &RobotEvaluation) -> Self {
        let mut series = Self::default();
        let mut interval = [f64::NAN; 2];
        for step in robot.steps.iter().filter(|step| step.accepted) {
            if let (true, Some(reading_w), Some(residual_w)) =
                (step.scored, step.reading_w, step.residual_w)
            {
                series.time_s.push(step.stamp_ns as f64 * 1e-9);
                series.reading_w.push(reading_w.into());
                series.forecast_w.push(f64::from(reading_w) - f64::from(residual_w));
                series.lo_w.push(interval[0]);
                series.hi_w.push(interval[1]);
            }
            interval = [step.lo_w, step.hi_w].map(|end| end.map_or(f64::NAN, f64::from));
        }
        series
    }

    /// Number of readings.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True if there are no readings.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Readings minus their forecasts, W.
    pub fn residuals_w(&self) -> impl Iterator<Item = f64> + '_ {
        let pairs = self.reading_w.iter().zip(&self.forecast_w);
        pairs.map(|(reading_w, forecast_w)| reading_w - forecast_w)
    }

    /// Measured and forecast energy up to each reading, J. Steps longer than `longest_s` are
    /// excluded from both.
    pub fn energy_j(&self, longest_s: f64) -> Vec<[f64; 2]> {
        let mut sums = [0.0; 2];
        let mut before_s = None;
        let mut found = Vec::with_capacity(self.len());
        for at in 0..self.len() {
            let step_s = self.time_s[at] - before_s.unwrap_or(self.time_s[at]);
            before_s = Some(self.time_s[at]);
            if step_s > 0.0 && step_s <= longest_s {
                sums[0] += self.reading_w[at] * step_s;
                sums[1] += self.forecast_w[at] * step_s;
            }
            found.push(sums);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energy_is_summed_over_steps_and_not_over_gaps() {
        let series = Series {
            time_s: vec![0.0, 0.5, 1.0, 9.0, 9.5],
            reading_w: vec![2.0; 5],
            forecast_w: vec![1.0; 5],
            lo_w: vec![f64::NAN; 5],
            hi_w: vec![f64::NAN; 5],
        };
        let energy_j = series.energy_j(1.0);
        assert_eq!(energy_j.last(), Some(&[3.0, 1.5]));
        assert_eq!(energy_j[0], [0.0, 0.0]);
        assert!(series.residuals_w().all(|residual_w| residual_w == 1.0));
    }
}
