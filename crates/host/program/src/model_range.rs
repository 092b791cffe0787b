//! Compares a platform's power with the range that its model was trained in.

use joulebus_config::{Config, ModelSource, Problem};
use joulebus_predictor::{FEATURES, LAGS, Model};

/// A platform may allow this many times the highest power of the training. More is another robot.
const MAX_TIMES: f32 = 3.0;

/// Platforms whose limits do not fit the readings that their model was trained on.
#[must_use]
pub fn warnings(config: &Config, models: &[Model]) -> Vec<Problem> {
    let platforms = config.settings().platforms.iter();
    platforms
        .zip(models)
        .zip(config.models())
        .filter_map(|((platform, model), source)| {
            let range = model.training_range()?;
            let lags = FEATURES - LAGS..FEATURES;
            let least_w = range.min[lags.clone()].iter().copied().fold(f32::INFINITY, f32::min);
            let most_w = range.max[lags].iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let (min_w, max_w) = (platform.power_min_w, platform.power_max_w);
            let inside = min_w <= least_w && most_w <= max_w;
            let fits = inside && max_w <= MAX_TIMES * most_w.max(0.0);
            if fits {
                return None;
            }
            let name = match source {
                ModelSource::File(path) => path.display().to_string(),
                _ => model.name().to_owned(),
            };
            Some(Problem {
                file: platform.name.clone(),
                line: None,
                key: "platform.model".to_owned(),
                what: format!(
                    "{name} was trained on readings of {least_w:.2} to {most_w:.2} W, the platform allows \
                     {min_w} to {max_w} W"
                ),
                remedy: "It may be another robot's model: train one (joulebus train trials), or correct \
                         power_min_w and power_max_w"
                    .to_owned(),
            })
        })
        .collect()
}
