//! Reference of online learning, recomputed from all readings.

use joulebus_predictor::{Features, Model};
use joulebus_settings::Platform;

/// A reading and its forecasts.
#[derive(Debug, Clone, Copy)]
struct Lesson {
    forecasts_w: [f32; 4],
    due: bool,
    reading_w: f32,
}

/// The experts of one robot during one membership in the fleet.
#[derive(Debug, Clone, Default)]
pub(crate) struct Experts {
    lessons: Vec<Lesson>,
}

/// Forecasts: of the robot, and of each expert.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Said {
    pub forecast_w: f32,
    forecasts_w: [f32; 4],
    due: bool,
}

fn sum(values: [f32; 4]) -> f32 {
    (values[0] + values[1]) + (values[2] + values[3])
}

fn times(a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
    [0, 1, 2, 3].map(|i| a[i] * b[i])
}

impl Experts {
    pub(crate) fn learn(&mut self, said: &Said, reading_w: f32) {
        self.lessons.push(Lesson {
            forecasts_w: said.forecasts_w,
            due: said.due,
            reading_w,
        });
    }

    pub(crate) fn say(
        &self,
        platform: &Platform,
        model: &Model,
        row: &Features,
        network_w: f32,
        due: bool,
    ) -> Said {
        let online = platform.online;
        let Some(sigma_w) = sigma_w(platform, model) else {
            return Said {
                forecast_w: network_w,
                forecasts_w: [network_w; 4],
                due,
            };
        };
        let (gain, offset) = self.fit(sigma_w);
        let bounded = (network_w / sigma_w).clamp(-1e4, 1e4);
        let adapted_w = sigma_w * (gain * bounded + offset);
        let linear_w = model
            .linear()
            .map_or(f32::NAN, |linear| linear.predict(row));
        let forecasts_w = [row[6], linear_w, network_w, adapted_w]
            .map(|watts| if watts.is_finite() { watts } else { network_w });
        let forecast_w = match (online.mixture, online.adapt) {
            (true, _) => {
                let weights = self.weights(platform, model, sigma_w, due);
                sum(times(weights, forecasts_w))
            }
            (false, true) => adapted_w,
            (false, false) => network_w,
        };
        Said {
            forecast_w,
            forecasts_w,
            due,
        }
    }

    /// Discounted AdaHedge, from the first reading on.
    fn weights(&self, platform: &Platform, model: &Model, sigma_w: f32, due: bool) -> [f32; 4] {
        let mut loss = start(platform, model);
        let mut cost = 2.0f32;
        let experts = loss.iter().filter(|loss| loss.is_finite()).count();
        let log = (experts as f64).ln() as f32;
        for lesson in self.lessons.iter().filter(|lesson| lesson.due == due) {
            let rate = log / cost;
            let error = lesson
                .forecasts_w
                .map(|watts| ((watts - lesson.reading_w) / sigma_w).clamp(-1e6, 1e6));
            let raw = loss.map(|loss| libm::expf(-rate * loss));
            let weights = raw.map(|one| one / sum(raw));
            let mixed = sum(times(weights, error));
            let after = [0, 1, 2, 3].map(|i| loss[i] + error[i] * error[i] / 0.999);
            let least = after.into_iter().fold(f32::INFINITY, f32::min);
            let before_log = libm::logf(sum(loss.map(|loss| libm::expf(-rate * (loss - 0.0)))));
            let after_log = libm::logf(sum(after.map(|loss| libm::expf(-rate * (loss - least)))));
            let mix_loss = 0.999 * (least - (after_log - before_log) / rate);
            cost = (0.999 * cost + (mixed * mixed - mix_loss).max(0.0)).max(2.0);
            loss = [0, 1, 2, 3].map(|i| 0.999 * loss[i] + error[i] * error[i]);
            let best = loss.into_iter().fold(f32::INFINITY, f32::min);
            loss = loss.map(|loss| loss - best);
        }
        let raw = loss.map(|loss| libm::expf(-(log / cost) * loss));
        raw.map(|one| one / sum(raw))
    }

    /// Gain and offset by discounted least squares over all readings.
    fn fit(&self, sigma_w: f32) -> (f32, f32) {
        let mut sums = [0.0f32; 5];
        for lesson in &self.lessons {
            let network = (lesson.forecasts_w[2] / sigma_w).clamp(-1e4, 1e4);
            let residual = (lesson.reading_w / sigma_w - network).clamp(-1e4, 1e4);
            let new = [
                1.0,
                network,
                network * network,
                residual,
                network * residual,
            ];
            for (sum, new) in sums.iter_mut().zip(new) {
                *sum = 0.998 * *sum + new;
            }
        }
        let [count, network, square, residual, product] = sums.map(f64::from);
        let (square, count) = (square + 1.0 / 0.002, count + 1.0 / 0.07);
        let determinant = (square * count - network * network).max((1.0 / 0.002) * (1.0 / 0.07));
        let gain = ((product * count - residual * network) / determinant).clamp(-3.0, 3.0);
        let offset = (residual - gain * network) / count;
        (1.0 + gain as f32, offset as f32)
    }
}

/// Unit of errors; `None` without online learning.
fn sigma_w(platform: &Platform, model: &Model) -> Option<f32> {
    let learns = platform.online.mixture || platform.online.adapt;
    let network = matches!(model, Model::Network(_));
    (learns && network).then(|| model.residual().std_w.max(platform.power_resolution_w))
}

/// 40 readings with the errors stated in the model file.
fn start(platform: &Platform, model: &Model) -> [f32; 4] {
    let Model::Network(network) = model else {
        return [0.0; 4];
    };
    let card = network.card();
    let shard = |r2: f32| ((1.0 - r2) / (1.0 - card.scores.network_r2)).clamp(0.0, 10.0);
    let error = [
        shard(card.scores.persistence_r2),
        card.linear.map_or(f32::INFINITY, |linear| shard(linear.r2)),
        1.0,
        if platform.online.adapt {
            1.0
        } else {
            f32::INFINITY
        },
    ];
    let best = error.into_iter().fold(f32::INFINITY, f32::min);
    error.map(|error| 40.0 * (error - best))
}
