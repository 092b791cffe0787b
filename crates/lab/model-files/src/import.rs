//! Imports a plain network: its convention is checked on recordings, on which its range, residuals
//! and scores are measured.

use joulebus_dataset::trial::Trial;
use joulebus_predictor::{
    FEATURES, FeatureSet, INPUTS, LAGS, Layer, ModelCard, Network, Normalisation, Parameters,
    TrainingRange,
};

use crate::convention::{
    ACTIVATIONS, CommandConvention, Convention, DERIVATIVES, Derivative, LAG_PLACES, LagOrder,
    Lags, MAGNITUDES, Magnitude, ORDERS, PowerUnit, UNITS,
};
use crate::error::ImportError;
use crate::padding::padded;
use crate::plain::Plain;
use crate::score;

/// Features of the command, before the readings.
const COMMANDS: usize = FEATURES - LAGS;
/// Share by which the stated convention's squared error must be larger than another one's to be
/// refused: at R² .9, a difference of .005.
const MIN_EXCESS: f64 = 0.05;

/// A convention with its score on the recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranked {
    /// The convention.
    pub convention: Convention,
    /// Coefficient of determination.
    pub r2: f64,
    /// Mean absolute error, W.
    pub mae_w: f64,
}

/// An imported network.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The stated convention.
    pub stated: Ranked,
    /// The other conventions that differ on these data, best first.
    pub others: Vec<Ranked>,
    /// Readings forecast.
    pub rows: usize,
    /// The step of per-step derivatives, s.
    pub step_s: f64,
    /// The model that the worker loads.
    pub network: Network,
}

/// A convention with its network.
struct Candidate {
    convention: Convention,
    parameters: Parameters,
    /// The mean that is subtracted before the magnitudes are taken, if any.
    centre: Option<[f32; 2]>,
}

impl Plain {
    /// Evaluates the stated convention and all others on the readings of recorded trials. Range,
    /// residuals and scores of the network are those on these readings, as its card states. `name`
    /// is that of the model, `file` that of the plain network.
    ///
    /// # Errors
    /// [`ImportError`]: too few readings, a convention that fits clearly better than the stated
    /// one, or none that fits.
    pub fn import(
        &self,
        trials: &[Trial],
        name: &str,
        file: &str,
    ) -> Result<Imported, ImportError> {
        let set = self.feature_set();
        let data = score::Data::new(trials, set)?;
        let mut candidates: Vec<Candidate> = Vec::new();
        for convention in self.conventions() {
            let candidate = self.candidate(convention, data.step_s);
            let is_same = |other: &Candidate| {
                (&other.parameters, other.centre) == (&candidate.parameters, candidate.centre)
            };
            if !candidates.iter().any(is_same) {
                candidates.push(candidate);
            }
        }
        let mut scored = Vec::new();
        for candidate in candidates {
            let network = Network::new(candidate.parameters.clone(), placeholder(set))?;
            let score = data.score(&network, candidate.centre);
            scored.push((candidate, score));
        }
        // The first one is the stated one.
        let (stated, score) = scored.remove(0);
        scored.sort_by(|(_, a), (_, b)| b.r2.total_cmp(&a.r2));
        if let Some((better, other)) = nearest(&stated, &score, &scored) {
            let (stated_r2, r2) = (score.r2, other.r2);
            let less = 100.0 * (1.0 - (1.0 - r2) / (1.0 - stated_r2));
            return Err(match better.centre {
                Some(_) => ImportError::CannotRun { stated_r2, r2 },
                None => {
                    let better = better.convention;
                    ImportError::Contradicted { stated_r2, better, r2, less }
                }
            });
        }
        // A score that is no number is minus infinity.
        if score.r2 <= 0.0 {
            return Err(ImportError::NothingFits { r2: score.r2, rows: data.rows() });
        }
        let source = match self.source.as_str() {
            "" => format!("imported from {file} (SHA-256 {})", self.sha256),
            source => {
                format!("imported from {file} (SHA-256 {}), converted from {source}", self.sha256)
            }
        };
        let card = data.card(set, &score, name, format!("{source}, as {}", self.convention));
        let ranked = |(candidate, score): &(Candidate, score::Score)| Ranked {
            convention: candidate.convention,
            r2: score.r2,
            mae_w: score.mae_w,
        };
        let others = scored.iter().map(ranked).collect();
        let network = Network::new(stated.parameters.clone(), card)?;
        let (rows, step_s) = (data.rows(), data.step_s);
        Ok(Imported { stated: ranked(&(stated, score)), others, rows, step_s, network })
    }

    /// The stated convention, then each other one that the statistics allow.
    fn conventions(&self) -> Vec<Convention> {
        let stated = self.convention;
        let mut all = vec![stated];
        let commands: Vec<Option<CommandConvention>> = match stated.command {
            None => vec![None],
            Some(stated) => commands(&stated).into_iter().map(Some).collect(),
        };
        for (unit, _) in UNITS {
            for (order, _) in ORDERS {
                let with = |command: &Option<CommandConvention>| Convention {
                    unit,
                    order,
                    command: *command,
                    ..stated
                };
                all.extend(commands.iter().map(with));
            }
        }
        let activations = ACTIVATIONS.iter().map(|(activation, _)| *activation);
        all.extend(activations.map(|activation| Convention { activation, ..stated }));
        all
    }

    /// The network under one convention: columns in our order, statistics of our features, SI
    /// units.
    fn candidate(&self, convention: Convention, step_s: f64) -> Candidate {
        let set = self.feature_set();
        let scale_w = match convention.unit {
            PowerUnit::Milliwatt => 1e-3,
            PowerUnit::Watt => 1.0,
        };
        // A per-step difference is the derivative times the step.
        let per_s = match convention.command.map(|command| command.derivative) {
            Some(
                Derivative::OwnPerStep | Derivative::NormalisedPerStep | Derivative::RawPerStep,
            ) => 1.0 / step_s,
            _ => 1.0,
        };
        let mut feature_mean = [0.0; INPUTS];
        let mut feature_std = [0.0; INPUTS];
        for feature in set.range() {
            let scale = match feature {
                COMMANDS.. => scale_w,
                2 | 3 => per_s,
                _ => 1.0,
            };
            let (mean, std) = self.normalisation(feature, &convention);
            feature_mean[feature] = (mean * scale) as f32;
            feature_std[feature] = (std * scale) as f32;
        }
        let mut layers = self.layers.clone();
        if let Some(first) = layers.first_mut() {
            let rows = first.weights.chunks(self.inputs.len());
            let in_order = |row: &[f32]| -> Vec<f32> {
                set.range().map(|feature| row[self.place(feature, &convention)]).collect()
            };
            first.weights = rows.flat_map(in_order).collect();
        }
        // Layers that do not fit were refused by the reader. A missing one has no shape.
        let nothing = || Layer { weights: Vec::new(), bias: Vec::new() };
        let layers = padded(&layers).unwrap_or_else(|| std::array::from_fn(|_| nothing()));
        let (power_mean, power_std) = self.power;
        Candidate {
            convention,
            parameters: Parameters {
                feature_set: set,
                activation: convention.activation,
                normalisation: Normalisation {
                    feature_mean,
                    feature_std,
                    power_mean_w: (power_mean * scale_w) as f32,
                    power_std_w: (power_std * scale_w) as f32,
                },
                layers,
            },
            centre: self.centre(&convention),
        }
    }

    /// Position of one of our features in the file under a convention.
    pub(super) fn place(&self, feature: usize, convention: &Convention) -> usize {
        let lags = convention.command.map(|command| command.lags);
        let Some(lag) = feature.checked_sub(COMMANDS) else {
            return if lags == Some(Lags::First) { feature + LAGS } else { feature };
        };
        let lag = match convention.order {
            LagOrder::Newest => lag,
            LagOrder::Oldest => LAGS - 1 - lag,
        };
        if lags == Some(Lags::Last) { COMMANDS + lag } else { lag }
    }

    /// Mean and deviation by which one of our features is normalised under a convention, in the
    /// file's units.
    pub(super) fn normalisation(&self, feature: usize, convention: &Convention) -> (f64, f64) {
        let stated = |feature: usize| self.inputs[self.place(feature, &self.convention)];
        let own = self.inputs[self.place(feature, convention)];
        let Some(CommandConvention { derivative, magnitude, .. }) = convention.command else {
            return own;
        };
        // Statistics of a quantity alone go with that quantity, others with their place.
        let is_of_quantity = magnitude != Magnitude::Own;
        match (feature, derivative, magnitude) {
            (0 | 1 | COMMANDS.., ..) => {
                if is_of_quantity {
                    stated(feature)
                } else {
                    own
                }
            }
            (2 | 3, Derivative::OwnPerSecond | Derivative::OwnPerStep, _) => own,
            (2 | 3, Derivative::RawPerSecond | Derivative::RawPerStep, _) => (0.0, 1.0),
            (2 | 3, ..) => (0.0, stated(feature - 2).1),
            (_, _, Magnitude::Own) => own,
            (_, _, Magnitude::Raw) => (0.0, 1.0),
            (_, _, Magnitude::Divided | Magnitude::OfNormalised) => (0.0, stated(feature - 4).1),
            (_, _, Magnitude::AsVelocity) => stated(feature - 4),
        }
    }

    /// The means subtracted from the velocities before their magnitudes are taken, if any.
    fn centre(&self, convention: &Convention) -> Option<[f32; 2]> {
        let magnitude = convention.command.map(|command| command.magnitude);
        let mean = |feature| self.normalisation(feature, convention).0 as f32;
        let centre = [0, 1].map(mean);
        (magnitude == Some(Magnitude::OfNormalised) && centre != [0.0, 0.0]).then_some(centre)
    }
}

/// The conventions of the command's features: with statistics of their own if those are stated,
/// else with all that the velocities' statistics give.
fn commands(stated: &CommandConvention) -> Vec<CommandConvention> {
    let (own_derivatives, derivatives) = DERIVATIVES.split_at(2);
    let (own_magnitudes, magnitudes) = MAGNITUDES.split_at(1);
    let is_own = own_derivatives.iter().any(|(derivative, _)| *derivative == stated.derivative);
    let derivatives = if is_own { own_derivatives } else { derivatives };
    let is_own = stated.magnitude == Magnitude::Own;
    let magnitudes = if is_own { own_magnitudes } else { magnitudes };
    let mut all = Vec::new();
    for (lags, _) in LAG_PLACES {
        for &(derivative, _) in derivatives {
            let with = |&(magnitude, _): &(Magnitude, &str)| CommandConvention {
                lags,
                derivative,
                magnitude,
            };
            all.extend(magnitudes.iter().map(with));
        }
    }
    all
}

/// Of the conventions that contradict the stated one, best first, the one that is nearest to it. It
/// is the best one, or one of those that its squared error hardly distinguishes from the best.
fn nearest<'a>(
    stated: &Candidate,
    score: &score::Score,
    others: &'a [(Candidate, score::Score)],
) -> Option<&'a (Candidate, score::Score)> {
    let contradicting = || others.iter().filter(|(_, other)| is_contradicted(score, other));
    let (_, best) = contradicting().next()?;
    // A best one without any error has no excess.
    let near = contradicting().filter(|(_, other)| {
        let excess = best.excess_of(other);
        excess.is_nan() || excess < MIN_EXCESS
    });
    near.min_by_key(|(other, _)| differences(&stated.convention, &other.convention))
}

/// In how many statements two conventions differ.
fn differences(one: &Convention, other: &Convention) -> usize {
    let command = |of: fn(&CommandConvention, &CommandConvention) -> bool| {
        one.command.zip(other.command).is_some_and(|(one, other)| of(&one, &other))
    };
    let all = [
        one.unit != other.unit,
        one.order != other.order,
        one.activation != other.activation,
        command(|one, other| one.lags != other.lags),
        command(|one, other| one.derivative != other.derivative),
        command(|one, other| one.magnitude != other.magnitude),
    ];
    all.into_iter().filter(|differs| *differs).count()
}

/// True if another convention's squared error is smaller by a relevant share, and in more blocks
/// than chance explains (by twice the square root of their number, which happens by chance once in
/// some forty times).
fn is_contradicted(stated: &score::Score, other: &score::Score) -> bool {
    let (won, all) = (other.blocks_won(stated) as f64, other.blocks() as f64);
    let is_significant = 2.0 * won - all >= 2.0 * all.sqrt();
    // A stated convention that forecasts no number has no error to compare.
    let is_no_number = stated.r2 == f64::NEG_INFINITY && other.r2 > stated.r2;
    is_no_number || (is_significant && other.excess_of(stated) >= MIN_EXCESS)
}

/// A card for a network under evaluation.
fn placeholder(feature_set: FeatureSet) -> ModelCard {
    ModelCard::new(TrainingRange { feature_set, min: [0.0; INPUTS], max: [0.0; INPUTS] })
}
