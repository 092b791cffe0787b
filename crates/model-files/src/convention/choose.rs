//! Evaluates every convention on recordings and chooses the best.

use joulebus_dataset::trial::Trial;
use joulebus_predictor::{
    FEATURES, FeatureSet, INPUTS, LAGS, Layer, ModelCard, Network, Normalisation, Parameters,
    TrainingRange,
};

use super::score;
use super::{
    ChooseError, Convention, DERIVATIVES, Derivative, LagOrder, Lags, MAGNITUDES, Magnitude,
    ORDERS, Origin, PLACES, PowerUnit, UNITS,
};
use crate::{Found, Statistics};

/// Features of the command, before the readings.
const COMMANDS: usize = FEATURES - LAGS;

/// Score of a convention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranked {
    /// The convention.
    pub convention: Convention,
    /// Coefficient of determination.
    pub r2: f64,
    /// Mean absolute error, W.
    pub mae_w: f64,
}

/// The chosen convention, and the ranking.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The chosen convention.
    pub convention: Convention,
    /// Whether it was requested instead of found.
    pub forced: bool,
    /// All conventions that differ on these data, best first.
    pub ranking: Vec<Ranked>,
    /// R² of the best minus that of the second; infinite if there is no other.
    pub margin_r2: f64,
    /// Blocks of 300 readings, ten seconds at 30 Hz.
    pub blocks: usize,
    /// Blocks in which the best has a smaller squared error than the second.
    pub blocks_won: usize,
    /// Readings forecast.
    pub rows: usize,
    /// The step of per-step derivatives, s.
    pub step_s: f64,
    network: Network,
}

/// A convention with its network.
struct Candidate {
    convention: Convention,
    parameters: Parameters,
    /// The mean that is subtracted before the magnitudes are taken, if any.
    centre: Option<[f32; 2]>,
}

impl Found {
    /// Evaluates every convention on the readings of recorded trials and chooses the best one, or
    /// the `forced` one. Range, residuals and scores of the network are those on these readings, as
    /// its card states.
    ///
    /// # Errors
    /// [`ChooseError`]: too few readings, no convention that fits, or one that the worker cannot
    /// compute.
    /// [`ChooseError`]: too few readings, none that fits, one that cannot run.
    pub fn choose(
        &self,
        trials: &[Trial],
        forced: Option<Convention>,
        origin: &Origin<'_>,
    ) -> Result<Choice, ChooseError> {
        let data = score::Data::new(trials, self.feature_set)?;
        let candidates = self.candidates(data.step_s);
        let mut scored = Vec::new();
        for candidate in candidates {
            let network = network(&candidate, placeholder(self.feature_set))?;
            let score = data.score(&network, candidate.centre);
            scored.push((candidate, score));
        }
        scored.sort_by(|(_, a), (_, b)| b.r2.total_cmp(&a.r2));
        let ranking: Vec<Ranked> = scored
            .iter()
            .map(|(candidate, score)| Ranked {
                convention: candidate.convention,
                r2: score.r2,
                mae_w: score.mae_w,
            })
            .collect();
        let place = self.place(&scored, forced, data.rows())?;
        let (candidate, score) = &scored[place];
        let card = data.card(self.feature_set, score, origin, candidate.convention);
        let network = network(candidate, card)?;
        let (margin_r2, blocks_won) = match scored.as_slice() {
            [(_, best), (_, next), ..] => (best.r2 - next.r2, best.blocks_won(next)),
            _ => (f64::INFINITY, score.blocks()),
        };
        Ok(Choice {
            convention: candidate.convention,
            forced: forced.is_some(),
            ranking,
            margin_r2,
            blocks: score.blocks(),
            blocks_won,
            rows: data.rows(),
            step_s: data.step_s,
            network,
        })
    }

    /// Index of the chosen candidate; candidates are sorted best first.
    fn place(
        &self,
        scored: &[(Candidate, score::Score)],
        forced: Option<Convention>,
        rows: usize,
    ) -> Result<usize, ChooseError> {
        // There is always a candidate: any statistics match at least one convention.
        let (best, best_score) = &scored[0];
        let place = match forced {
            None if best_score.r2 > 0.0 => 0,
            None => {
                return Err(ChooseError::NothingFits {
                    best: best.convention,
                    r2: best_score.r2,
                    rows,
                });
            }
            Some(asked) => {
                let same = |(candidate, _): &(Candidate, _)| candidate.convention == asked;
                scored.iter().position(same).ok_or_else(|| {
                    let allowed = scored.iter().map(|(candidate, _)| candidate.convention);
                    let allowed: Vec<String> = allowed.map(|c| c.to_string()).collect();
                    ChooseError::NotACandidate {
                        asked,
                        allowed: allowed.join(", "),
                    }
                })?
            }
        };
        let (candidate, score) = &scored[place];
        let runs = |(candidate, _): &&(Candidate, score::Score)| candidate.centre.is_none();
        match (candidate.centre, scored.iter().find(runs)) {
            (Some(_), Some((other, other_score))) => Err(ChooseError::CannotRun {
                convention: candidate.convention,
                r2: score.r2,
                runner_up: other.convention,
                runner_up_r2: other_score.r2,
            }),
            _ => Ok(place),
        }
    }

    /// Every convention that matches the statistics, without equivalent ones.
    fn candidates(&self, step_s: f64) -> Vec<Candidate> {
        let own = match &self.normalisation.statistics {
            Statistics::Own { mean, .. } => mean.len() >= COMMANDS,
            Statistics::Shared { .. } => false,
        };
        let is_full = self.feature_set == FeatureSet::Full;
        let derivatives = match (is_full, own) {
            (true, true) => &DERIVATIVES[..2],
            (true, false) => &DERIVATIVES[2..],
            (false, _) => &DERIVATIVES[..1],
        };
        let magnitudes = match (is_full, own) {
            (true, true) | (false, _) => &MAGNITUDES[..1],
            (true, false) => &MAGNITUDES[1..],
        };
        let places = if is_full { &PLACES[..] } else { &PLACES[..1] };
        let mut candidates: Vec<Candidate> = Vec::new();
        for (unit, _) in UNITS {
            for (order, _) in ORDERS {
                for &(lags, _) in places {
                    for &(derivative, _) in derivatives {
                        for &(magnitude, _) in magnitudes {
                            let convention = Convention {
                                unit,
                                order,
                                lags,
                                derivative,
                                magnitude,
                            };
                            let candidate = self.candidate(convention, step_s);
                            let same = |other: &Candidate| {
                                (&other.parameters, other.centre)
                                    == (&candidate.parameters, candidate.centre)
                            };
                            if !candidates.iter().any(same) {
                                candidates.push(candidate);
                            }
                        }
                    }
                }
            }
        }
        candidates
    }

    /// The network under one convention: columns in our order, statistics of our features.
    fn candidate(&self, convention: Convention, step_s: f64) -> Candidate {
        let place = |feature| file_place(feature, self.feature_set, &convention);
        let statistics = self.statistics(&convention, step_s);
        let scale_w = match convention.unit {
            PowerUnit::Milliwatt => 1e-3,
            PowerUnit::Watt => 1.0,
        };
        let (power_mean, power_std) = match self.normalisation.statistics {
            Statistics::Shared { power, .. } | Statistics::Own { power, .. } => power,
        };
        let mut feature_mean = [0.0; INPUTS];
        let mut feature_std = [0.0; INPUTS];
        for feature in self.feature_set.range() {
            let (mean, std) = statistics(feature, place(feature));
            feature_mean[feature] = mean as f32;
            feature_std[feature] = std as f32;
        }
        let [first, rest @ ..] = &self.layers;
        let inputs = self.feature_set.inputs();
        let reordered = first
            .layer
            .weights
            .chunks(inputs)
            .flat_map(|row| self.feature_set.range().map(|feature| row[place(feature)]));
        let weights = reordered.collect();
        let bias = first.layer.bias.clone();
        let [second, third, fourth] = rest.each_ref().map(|layer| layer.layer.clone());
        Candidate {
            convention,
            parameters: Parameters {
                feature_set: self.feature_set,
                activation: self.activation,
                normalisation: Normalisation {
                    feature_mean,
                    feature_std,
                    power_mean_w: (power_mean * scale_w) as f32,
                    power_std_w: (power_std * scale_w) as f32,
                },
                layers: [Layer { weights, bias }, second, third, fourth],
            },
            centre: self.centre(&convention),
        }
    }

    /// The mean and deviation by which the file normalises each of our features, given its index
    /// and its position in the file.
    fn statistics(
        &self,
        convention: &Convention,
        step_s: f64,
    ) -> impl Fn(usize, usize) -> (f64, f64) {
        let Convention {
            unit,
            derivative,
            magnitude,
            ..
        } = *convention;
        let scale_w = match unit {
            PowerUnit::Milliwatt => 1e-3,
            PowerUnit::Watt => 1.0,
        };
        // A per-step difference is the derivative times the step.
        let per_s = match derivative {
            Derivative::OwnPerStep | Derivative::NormalisedPerStep | Derivative::RawPerStep => {
                1.0 / step_s
            }
            _ => 1.0,
        };
        let statistics = self.normalisation.statistics.clone();
        let feature_set = self.feature_set;
        move |feature, place| match &statistics {
            Statistics::Own { mean, std, power } => {
                let scaled = |(mean, std): (f64, f64), by: f64| (mean * by, std * by);
                // Statistics of the command's features alone precede those of the readings.
                let only_commands = feature_set == FeatureSet::Full && mean.len() == COMMANDS;
                let own = if only_commands {
                    mean.get(feature).copied().zip(std.get(feature).copied())
                } else {
                    mean.get(place).copied().zip(std.get(place).copied())
                };
                match feature {
                    COMMANDS.. => scaled(own.unwrap_or(*power), scale_w),
                    2 | 3 => scaled(own.unwrap_or((0.0, 1.0)), per_s),
                    _ => own.unwrap_or((0.0, 1.0)),
                }
            }
            Statistics::Shared { v, omega, power } => {
                let (mean, std) = if feature % 2 == 0 { *v } else { *omega };
                match (feature, derivative, magnitude) {
                    (COMMANDS.., ..) => (power.0 * scale_w, power.1 * scale_w),
                    (0 | 1, ..) => (mean, std),
                    (2 | 3, Derivative::RawPerSecond | Derivative::RawPerStep, _) => (0.0, per_s),
                    (2 | 3, ..) => (0.0, std * per_s),
                    (_, _, Magnitude::Raw) => (0.0, 1.0),
                    (_, _, Magnitude::Divided | Magnitude::OfNormalised) => (0.0, std),
                    (_, _, Magnitude::AsVelocity | Magnitude::Own) => (mean, std),
                }
            }
        }
    }

    /// The means subtracted from the velocities before their magnitudes are taken, if any.
    fn centre(&self, convention: &Convention) -> Option<[f32; 2]> {
        match (&self.normalisation.statistics, convention.magnitude) {
            (Statistics::Shared { v, omega, .. }, Magnitude::OfNormalised) => {
                let centre = [v.0 as f32, omega.0 as f32];
                (centre != [0.0, 0.0]).then_some(centre)
            }
            _ => None,
        }
    }
}

impl Choice {
    /// Whether the best convention is significantly better than the second: it wins more blocks
    /// than it loses by at least twice the square root of their number, which happens by chance
    /// once in some forty times; or it was requested.
    #[must_use]
    pub fn is_clear(&self) -> bool {
        let (won, all) = (self.blocks_won as f64, self.blocks as f64);
        self.forced || 2.0 * won - all >= 2.0 * all.sqrt()
    }

    /// The model that the worker loads.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }
}

/// Position of one of our features in the file.
fn file_place(feature: usize, set: FeatureSet, convention: &Convention) -> usize {
    let Some(lag) = feature.checked_sub(COMMANDS) else {
        return match convention.lags {
            Lags::Last => feature,
            Lags::First => feature + LAGS,
        };
    };
    let lag = match convention.order {
        LagOrder::Newest => lag,
        LagOrder::Oldest => LAGS - 1 - lag,
    };
    match (set, convention.lags) {
        (FeatureSet::Full, Lags::Last) => COMMANDS + lag,
        _ => lag,
    }
}

fn network(candidate: &Candidate, card: ModelCard) -> Result<Network, ChooseError> {
    Network::new(candidate.parameters.clone(), card).map_err(|source| ChooseError::Model {
        convention: candidate.convention,
        source,
    })
}

/// A card for a network under evaluation.
fn placeholder(feature_set: FeatureSet) -> ModelCard {
    ModelCard::new(TrainingRange {
        feature_set,
        min: [0.0; INPUTS],
        max: [0.0; INPUTS],
    })
}
