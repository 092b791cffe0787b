//! Reference of forecasts that learn online, recomputed from all readings since the robot joined.

use joulebus_energy::Shown;
use joulebus_predictor::{FeatureSet, Features, Model};
use joulebus_settings::Platform;

/// A reading, its predecessors, and its forecasts.
#[derive(Debug, Clone, Copy)]
struct Reading {
    /// The lags and the network's forecast, if the forecast is scored.
    scored: Option<([f32; 5], f32)>,
    last_w: Option<f32>,
    due: bool,
    reading_w: f32,
}

/// The forecasters of one robot during one stay in the fleet.
#[derive(Debug, Clone, Default)]
pub(crate) struct Experts {
    readings: Vec<Reading>,
    /// Of the memory of the platform when the robot joined.
    from_last: bool,
}

/// The forecasts for the robot and by the network.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forecasts {
    pub forecast_w: f32,
    /// True if the robot learns which forecaster to trust.
    pub learns: bool,
    /// A network forecasts what no robot of the platform can draw.
    pub is_absurd: bool,
    pub network_w: f32,
    lag_w: [f32; 5],
}

/// A signed combination of the forecasters.
struct Stack {
    theta: [f32; 4],
    covariance: [[f32; 4]; 4],
    variance: [f32; 4],
}

/// All that a robot has learned.
struct Knowledge {
    confident: Stack,
    sceptic: Stack,
    sceptic_loss: f32,
    mean_w: f32,
    change_w: f32,
    seen: u8,
    from_last: bool,
    /// Excess over the first readings, W², and their number.
    start: (f32, u32),
    /// Weights with a measurement due, and without.
    weights: [Weights; 2],
}

/// Losses of last reading, network and both stacks relative to the confident stack's, and the cost
/// of averaging. `None` before the first.
#[derive(Clone, Copy)]
struct Weights {
    learned: Option<([f32; 4], f32)>,
    experts: f32,
}

/// Nothing else can be published.
pub(crate) fn possible(platform: &Platform, forecast_w: f32) -> f32 {
    forecast_w.clamp(platform.power_min_w, platform.power_max_w)
}

impl Experts {
    pub(crate) fn new(from_last: bool) -> Self {
        Self { readings: Vec::new(), from_last }
    }

    /// What the first thirty readings have shown, after the last of them.
    pub(crate) fn start(&self, platform: &Platform, model: &Model) -> Option<Shown> {
        let known = Knowledge::new(platform, model, &self.readings, self.from_last)?;
        let std_w = model.residual().std_w.max(platform.power_resolution_w);
        let (excess, number) = known.start;
        (self.readings.len() == 30 && number > 0)
            .then(|| joulebus_energy::shown_start(excess / (number as f32 * (std_w * std_w))))
    }

    /// `forecasts` is given if the forecast is scored.
    pub(crate) fn learn(
        &mut self,
        forecasts: Option<&Forecasts>,
        last_w: Option<f32>,
        due: bool,
        reading_w: f32,
    ) {
        self.readings.push(Reading {
            scored: forecasts.map(|forecasts| (forecasts.lag_w, forecasts.network_w)),
            last_w,
            due,
            reading_w,
        });
    }

    pub(crate) fn forecast(
        &self,
        platform: &Platform,
        model: &Model,
        row: &Features,
        network_w: f32,
        due: bool,
    ) -> Forecasts {
        let lag_w = [row[6], row[7], row[8], row[9], row[10]];
        let known = Knowledge::new(platform, model, &self.readings, self.from_last);
        let learns = known.is_some();
        let forecast_w = known.map_or(network_w, |known| {
            let (members_w, _, _) = known.members(model, &lag_w, network_w, due);
            dot(known.shares(due), members_w)
        });
        let apart_w = platform.power_max_w - platform.power_min_w;
        let nearest_w = possible(platform, forecast_w);
        Forecasts {
            forecast_w: nearest_w,
            learns,
            is_absurd: (network_w - nearest_w).abs() > apart_w,
            network_w,
            lag_w,
        }
    }
}

impl Experts {
    /// The diagnostics' values from `mean_w` to `level_w`. `None` if nothing is learned.
    pub(crate) fn learned(&self, platform: &Platform, model: &Model) -> Option<[f32; 11]> {
        let known = Knowledge::new(platform, model, &self.readings, self.from_last)?;
        let ([last, network, confident, sceptic], [held, _, held_stack, _]) =
            (known.shares(true), known.shares(false));
        let stack = (confident + sceptic).min(1.0);
        let [p, n, m, level] = [0, 1, 2, 3].map(|term| {
            let [a, b] = [known.confident.theta[term], known.sceptic.theta[term]];
            b + known.confidence() * (a - b)
        });
        let (mean_w, change_w) = (known.mean_w, known.change_w);
        let level_w = level * change_w;
        Some([mean_w, change_w, last, network, stack, held, held_stack, p, n, m, level_w])
    }
}

impl Stack {
    fn new(theta: [f32; 4], variance: [f32; 4]) -> Self {
        let diagonal = |row: usize, column: usize| if row == column { variance[row] } else { 0.0 };
        Self {
            theta,
            covariance: [0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| diagonal(row, column))),
            variance,
        }
    }

    fn follow(&mut self, u: [f32; 4], innovation_w: f32, square: f32) {
        let product = self.covariance.map(|row| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|column| row[column] * u[column]);
            (a + b) + (c + d)
        });
        let [a, b, c, d] = [0, 1, 2, 3].map(|row| product[row] * u[row]);
        let gain = 1.0 / (square + ((a + b) + (c + d)));
        for (theta, product) in self.theta.iter_mut().zip(product) {
            *theta = (*theta + product * (gain * innovation_w)).clamp(-100.0, 100.0);
        }
        for row in 0..4 {
            for column in row..4 {
                let start = if row == column { self.variance[row] } else { 0.0 };
                let less = self.covariance[row][column] - product[row] * (product[column] * gain);
                let pulled = less + 0.002 * (start - less);
                (self.covariance[row][column], self.covariance[column][row]) = (pulled, pulled);
            }
        }
    }
}

impl Knowledge {
    /// `None` if nothing is learned.
    fn new(
        platform: &Platform,
        model: &Model,
        readings: &[Reading],
        from_last: bool,
    ) -> Option<Self> {
        if !platform.online || !matches!(model, Model::Network(_)) {
            return None;
        }
        let resolution_w = platform.power_resolution_w;
        let sigma_w = model.residual().std_w.max(resolution_w);
        let error_w = (0.8 * sigma_w).max(resolution_w);
        let reads_commands = model.feature_set().needs_command();
        let mut known = Self {
            confident: Stack::new([0.1, 0.95, 0.1, 0.0], [0.09, 0.04, 0.04, 0.25]),
            sceptic: Stack::new([0.1, 0.5, 0.1, 0.0], [0.09, 0.04, 0.16, 0.25]),
            sceptic_loss: if reads_commands { 0.0 } else { 6.0 },
            mean_w: 0.0,
            change_w: error_w,
            seen: 0,
            from_last,
            start: (0.0, 0),
            weights: [
                Weights { learned: None, experts: 4.0 },
                Weights { learned: None, experts: 2.0 },
            ],
        };
        for reading in readings {
            known.learn(model, reading);
            known.read(resolution_w, reading);
        }
        Some(known)
    }

    fn members(
        &self,
        model: &Model,
        lag_w: &[f32; 5],
        network_w: f32,
        due: bool,
    ) -> ([f32; 4], [f32; 4], [f32; 2]) {
        let (bias_w, weights) = match model.linear() {
            Some(linear) if linear.feature_set == FeatureSet::PowerOnly => {
                let [.., a, b, c, d, e, _, _] = linear.weights;
                (linear.bias_w, [a, b, c, d, e])
            }
            _ => (0.0, [1.0, 0.0, 0.0, 0.0, 0.0]),
        };
        let terms = weights.iter().zip(lag_w);
        let auto_w = terms.fold(bias_w, |sum, (weight, lag_w)| sum + weight * lag_w);
        let most_w = 30.0 * self.change_w;
        let from_auto = |watts: f32| (watts - auto_w).clamp(-most_w, most_w);
        let u = [from_auto(lag_w[0]), from_auto(network_w), from_auto(self.mean_w), self.change_w];
        let stacks_w = [&self.confident, &self.sceptic].map(|stack| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|term| stack.theta[term] * u[term]);
            auto_w + ((a + b) + (c + d))
        });
        let [confident_w, sceptic_w] = stacks_w;
        let both_w = sceptic_w + self.confidence() * (confident_w - sceptic_w);
        let stack_w = if due { confident_w } else { both_w };
        let early_w = if due || self.from_last { 0.0 } else { 0.02 * (stack_w - lag_w[0]) };
        let members_w = [lag_w[0] + early_w, network_w, stack_w, sceptic_w];
        (members_w, u, stacks_w)
    }

    fn learn(&mut self, model: &Model, reading: &Reading) {
        let Some((lag_w, network_w)) = reading.scored else {
            return;
        };
        let (members_w, u, stacks_w) = self.members(model, &lag_w, network_w, reading.due);
        if reading.due && self.seen < 30 {
            let [confident_w, sceptic_w] = stacks_w;
            let both_w = sceptic_w + self.confidence() * (confident_w - sceptic_w);
            let wrong = |watts: f32| (watts - reading.reading_w) * (watts - reading.reading_w);
            let (excess, number) = self.start;
            self.start = (excess + (wrong(both_w) - wrong(lag_w[0])), number + 1);
        }
        let square = self.change_w * self.change_w;
        let shares = self.shares(reading.due);
        let (before, cost) = self.losses(reading.due);
        let experts = self.weights[usize::from(!reading.due)].experts;
        let error = members_w.map(|watts| (watts - reading.reading_w).clamp(-1e6, 1e6));
        let loss = error.map(|error| error * error);
        let rate = log(experts) / cost;
        let least = |losses: [f32; 4]| losses.into_iter().fold(f32::INFINITY, f32::min);
        let before = before.map(|loss| loss - least(before));
        let after = [0, 1, 2, 3].map(|i| before[i] + loss[i] * (1.0 / 0.997));
        let lowest = least(after);
        let sum = |losses: [f32; 4], least: f32| {
            let [a, b, c, d] = losses.map(|loss| exp(-rate * (loss - least)));
            (a + b) + (c + d)
        };
        let shrunk = ln_ratio(sum(after, lowest), sum(before, 0.0));
        let mix_loss = 0.997 * (lowest - shrunk * (cost * (1.0 / log(experts))));
        let mixed = dot(shares, error);
        let cost = (0.997 * cost + (mixed * mixed - mix_loss).max(0.0)).max(2.0 * square);
        let (old, _) = self.losses(reading.due);
        let above = [0, 1, 2, 3].map(|i| 0.997 * old[i] + (loss[i] - loss[2]));
        self.weights[usize::from(!reading.due)].learned = Some((above, cost));
        if reading.due {
            let most_w = 2.5 * self.change_w;
            let innovations_w =
                stacks_w.map(|stack_w| (reading.reading_w - stack_w).clamp(-most_w, most_w));
            self.confident.follow(u, innovations_w[0], square);
            self.sceptic.follow(u, innovations_w[1], square);
        }
    }

    fn read(&mut self, resolution_w: f32, reading: &Reading) {
        let seen = f32::from(self.seen);
        self.mean_w += (reading.reading_w - self.mean_w) / (1.0 + seen);
        if let (Some(last_w), true) = (reading.last_w, reading.due) {
            let size_w = (reading.reading_w - last_w).abs();
            let change_w = self.change_w + (size_w - self.change_w) / (1.0 + 8.0 + seen);
            self.change_w = change_w.max(resolution_w);
        }
        self.seen = self.seen.saturating_add(1);
    }

    /// Losses relative to the confident stack's, and the cost of averaging.
    fn losses(&self, due: bool) -> ([f32; 4], f32) {
        let square = self.change_w * self.change_w;
        let sceptic = self.sceptic_loss * square;
        let start = match (!self.from_last, due) {
            (true, true) => [100.0 * square, 1.0 * square, 0.0, sceptic],
            (false, true) => [-5.0 * square, 0.0, 0.0, sceptic],
            (true, false) => [0.0, f32::INFINITY, 0.0, f32::INFINITY],
            (false, false) => [-5.0 * square, f32::INFINITY, 0.0, f32::INFINITY],
        };
        self.weights[usize::from(!due)].learned.unwrap_or((start, 2.0 * square))
    }

    /// The confident stack's part of both stacks' weight where a measurement is due.
    fn confidence(&self) -> f32 {
        let ([.., above], cost) = self.losses(true);
        let raw = exp(-(log(4.0) / cost) * above.abs());
        let larger = 1.0 / (1.0 + raw);
        if above >= 0.0 { larger } else { raw * larger }
    }

    fn shares(&self, due: bool) -> [f32; 4] {
        let (losses, cost) = self.losses(due);
        let rate = log(self.weights[usize::from(!due)].experts) / cost;
        let least = losses.into_iter().fold(f32::INFINITY, f32::min);
        let raw = losses.map(|loss| exp(-rate * (loss - least)));
        let sum = (raw[0] + raw[1]) + (raw[2] + raw[3]);
        raw.map(|raw| raw * (1.0 / sum))
    }
}

fn dot(a: [f32; 4], b: [f32; 4]) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

fn log(experts: f32) -> f32 {
    f64::from(experts).ln() as f32
}

fn exp(x: f32) -> f32 {
    let scaled = x.max(-80.0) * std::f32::consts::LOG2_E;
    let whole = scaled.round_ties_even();
    let rest = (scaled - whole) * std::f32::consts::LN_2;
    let factors = [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];
    let series = factors.iter().fold(1.0f32 / 720.0, |sum, factor| factor + rest * sum);
    series * f32::from_bits(((whole as i32 + 127) as u32) << 23)
}

fn ln_ratio(a: f32, b: f32) -> f32 {
    let s = (a - b) / (a + b);
    let factors = [23.0f32, 21.0, 19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0];
    let series = factors.iter().fold(1.0 / 25.0, |sum, odd| 1.0 / odd + s * s * sum);
    2.0 * s * series
}
