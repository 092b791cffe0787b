//! Configuration of the simulated experiments.

use joulebus_plant::protocol::SAMPLES;
use joulebus_train::TrainSettings;

/// Draws by default.
pub const DRAWS: u32 = 10;

/// Configuration of the simulated experiments.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The first seed. Each draw has the next.
    pub seed: u64,
    /// Draws over which the results are averaged, at least 2.
    pub draws: u32,
    /// Samples of each of the six trials, at least 100.
    pub samples: usize,
    /// Steps of the seven robots, at least 100.
    pub robot_steps: usize,
    /// Training settings. The seed is each draw's.
    pub recipe: TrainSettings,
    /// Number of training threads, 0 for one per core. The result does not depend on it.
    pub threads: usize,
}

impl Simulated {
    /// The paper's sizes and recipe.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            draws: DRAWS,
            samples: SAMPLES,
            robot_steps: SAMPLES,
            recipe: TrainSettings {
                name: "network".to_owned(),
                source: "simulation".to_owned(),
                ..TrainSettings::default()
            },
            threads: 0,
        }
    }
}
