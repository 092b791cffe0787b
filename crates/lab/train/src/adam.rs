//! The Adam optimiser.

/// Adam (Kingma and Ba 2015, algorithm 1) with its bias corrections.
#[derive(Clone, Debug)]
pub(super) struct Adam {
    pub first: Vec<f32>,
    pub second: Vec<f32>,
    /// Steps taken.
    pub steps: u64,
}

/// Adam's hyperparameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hyperparameters {
    pub learning_rate: f64,
    pub first_moment: f64,
    pub second_moment: f64,
    pub epsilon: f64,
}

impl Adam {
    pub(super) fn new(parameters: usize) -> Self {
        Self { first: vec![0.0; parameters], second: vec![0.0; parameters], steps: 0 }
    }

    /// Takes one step against the mean gradient: the sum of `gradients` times `share`.
    pub(super) fn step(
        &mut self,
        values: &mut [f32],
        gradients: &[f32],
        share: f32,
        hyperparameters: Hyperparameters,
    ) {
        self.steps += 1;
        let left = |moment: f64| 1.0 - libm::pow(moment, self.steps as f64);
        let rate = (hyperparameters.learning_rate / left(hyperparameters.first_moment)) as f32;
        let scale = (1.0 / libm::sqrt(left(hyperparameters.second_moment))) as f32;
        let epsilon = hyperparameters.epsilon as f32;
        let (keep_first, keep_second) =
            (hyperparameters.first_moment as f32, hyperparameters.second_moment as f32);
        let (new_first, new_second) = (1.0 - keep_first, 1.0 - keep_second);
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, gradient), (first, second)) in values.iter_mut().zip(gradients).zip(moments) {
            let gradient = gradient * share;
            *first = keep_first * *first + new_first * gradient;
            *second = keep_second * *second + new_second * gradient * gradient;
            *value -= rate * *first / (second.sqrt() * scale + epsilon);
        }
    }
}
