//! Compares a platform's power and rate with those that its model was trained with.

use joulebus_config::{Config, ModelSource, Problem};
use joulebus_predictor::{FEATURES, LAGS, Model};
use joulebus_settings::Platform;

/// A platform may allow this many times the highest power of the training. More is another robot.
const MAX_TIMES: f32 = 3.0;
/// A platform's period may differ from that of the training by this share of it.
const MAX_PERIOD_DIFFERENCE: f64 = 0.2;

/// Platforms whose limits or rates do not fit the readings that their model was trained on.
#[must_use]
pub fn warnings(config: &Config, models: &[Model]) -> Vec<Problem> {
    let platforms = config.settings().platforms.iter();
    let each = platforms.zip(models).zip(config.models());
    let found = each.flat_map(|((platform, model), source)| {
        let name = match source {
            ModelSource::File(path) => path.display().to_string(),
            ModelSource::Attached(path, _) => path.to_string(),
            _ => model.name().to_owned(),
        };
        [of_power(platform, model, &name), of_period(platform, model, &name)]
    });
    found.flatten().collect()
}

fn of_power(platform: &Platform, model: &Model, name: &str) -> Option<Problem> {
    let range = model.training_range()?;
    let lags = FEATURES - LAGS..FEATURES;
    let least_w = range.min[lags.clone()].iter().copied().fold(f32::INFINITY, f32::min);
    let most_w = range.max[lags].iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (min_w, max_w) = (platform.power_min_w, platform.power_max_w);
    let inside = min_w <= least_w && most_w <= max_w;
    if inside && max_w <= MAX_TIMES * most_w.max(0.0) {
        return None;
    }
    let what = format!(
        "{name} was trained on readings of {least_w:.2} to {most_w:.2} W, the platform allows \
         {min_w} to {max_w} W"
    );
    let remedy = "It may be another robot's model: train one (joulebus train trials), or correct \
                  power_min_w and power_max_w";
    Some(problem(platform, what, remedy))
}

fn of_period(platform: &Platform, model: &Model, name: &str) -> Option<Problem> {
    let Model::Network(network) = model else {
        return None;
    };
    let trained_s = f64::from(network.card().period_s()?);
    let period_s = platform.period_ns as f64 * 1e-9;
    let allowed_s = MAX_PERIOD_DIFFERENCE * trained_s;
    if (period_s - trained_s).abs() <= allowed_s {
        return None;
    }
    let what = format!(
        "{name} was trained on a reading every {:.1} ms ({:.2} Hz), the platform has one every \
         {:.1} ms ({:.2} Hz): its changes from reading to reading are others",
        1e3 * trained_s,
        trained_s.recip(),
        1e3 * period_s,
        period_s.recip(),
    );
    let remedy = "Train one on recordings of this rate (joulebus train trials), or correct rate_hz. \
                  Up to 20 % make no warning";
    Some(problem(platform, what, remedy))
}

fn problem(platform: &Platform, what: String, remedy: &str) -> Problem {
    Problem {
        file: platform.name.clone(),
        line: None,
        key: "platform.model".to_owned(),
        what,
        remedy: remedy.to_owned(),
    }
}
