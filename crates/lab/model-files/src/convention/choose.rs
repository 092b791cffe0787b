//! Evaluates the conventions that fit the statistics on recordings and chooses the best.

use joulebus_dataset::trial::Trial;
use joulebus_predictor::{
    FEATURES, FeatureSet, INPUTS, LAGS, Layer, ModelCard, Network, Normalisation, Parameters,
    TrainingRange,
};

use super::score;
use super::statistics::{Spread, check_published, distances, is_ruled_out};
use super::{
    ChooseError, Convention, DERIVATIVES, Derivative, LagOrder, Lags, MAGNITUDES, Magnitude,
    ORDERS, Origin, PLACES, PowerUnit, UNITS,
};
use crate::padding::padded;
use crate::{Found, Statistics, StatisticsFrom};

/// Features of the command, before the readings.
const COMMANDS: usize = FEATURES - LAGS;

/// Minimum share by which the second's squared error must be larger: at R² .9, a margin of .005.
const MIN_EXCESS: f64 = 0.05;
/// Conventions named in an error.
const SHOWN: usize = 4;

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
    /// True if it was requested instead of found.
    pub forced: bool,
    /// All conventions that differ on these data and fit the statistics, best first.
    pub ranking: Vec<Ranked>,
    /// Conventions that the statistics ruled out.
    pub ruled_out: Vec<Convention>,
    /// R² of the best minus R² of the second. Infinite if there is no other.
    pub margin_r2: f64,
    /// Blocks of 300 readings, ten seconds at 30 Hz.
    pub blocks: usize,
    /// Blocks in which the best has a smaller squared error than the second.
    pub blocks_won: usize,
    /// Share by which the second's squared error is larger.
    pub excess: f64,
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
    /// Evaluates every convention that fits the statistics on the readings of recorded trials and
    /// chooses the best one, or the `forced` one. Range, residuals and scores of the network are
    /// those on these readings, as its card states.
    ///
    /// # Errors
    /// [`ChooseError`]: too few readings, no convention that fits, several that are equally good,
    /// one that the worker cannot compute, or recordings of another robot than the published one
    /// for a file without constants.
    pub fn choose(
        &self,
        trials: &[Trial],
        forced: Option<Convention>,
        origin: &Origin<'_>,
    ) -> Result<Choice, ChooseError> {
        let data = score::Data::new(trials, self.feature_set)?;
        let (recorded, target) = data.spreads();
        let stated = &self.normalisation.statistics;
        if self.normalisation.from == StatisticsFrom::Assumed {
            check_published(stated, self.feature_set, &recorded, target)?;
        }
        let mut candidates = match self.normalisation.from {
            StatisticsFrom::Recordings => self.by_recordings(&recorded, target, data.step_s),
            _ => self.candidates(stated, &UNITS, data.step_s),
        };
        let ruled_out = match (self.normalisation.from, forced) {
            (StatisticsFrom::File, None) => self.rule_out(&mut candidates, &recorded, target),
            _ => Vec::new(),
        };
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
        let (margin_r2, blocks_won, excess) = match scored.as_slice() {
            [(_, best), (_, next), ..] => {
                (best.r2 - next.r2, best.blocks_won(next), best.excess_of(next))
            }
            _ => (f64::INFINITY, score.blocks(), f64::INFINITY),
        };
        let choice = Choice {
            convention: candidate.convention,
            forced: forced.is_some(),
            ranking,
            ruled_out,
            margin_r2,
            blocks: score.blocks(),
            blocks_won,
            excess,
            rows: data.rows(),
            step_s: data.step_s,
            network,
        };
        choice.clear()
    }

    /// Removes and returns the conventions under which the stated statistics are far from the
    /// recordings'.
    fn rule_out(
        &self,
        candidates: &mut Vec<Candidate>,
        recorded: &[Spread],
        target: Spread,
    ) -> Vec<Convention> {
        let distances: Vec<Vec<f64>> = candidates
            .iter()
            .map(|candidate| {
                let stated = &self.normalisation.statistics;
                let normalisation = &candidate.parameters.normalisation;
                distances(stated, self.feature_set, normalisation, recorded, target)
            })
            .collect();
        let is_out = |own: &Vec<f64>| distances.iter().any(|other| is_ruled_out(own, other));
        let out: Vec<bool> = distances.iter().map(is_out).collect();
        // Statistics that contradict every convention rule out none.
        if out.iter().all(|out| *out) {
            return Vec::new();
        }
        let mut ruled_out = Vec::new();
        let mut at = 0;
        candidates.retain(|candidate| {
            let keep = !out[at];
            at += 1;
            if !keep {
                ruled_out.push(candidate.convention);
            }
            keep
        });
        ruled_out
    }

    /// Candidates by the statistics of the recordings: one pair per feature, and one per quantity.
    fn by_recordings(&self, recorded: &[Spread], target: Spread, step_s: f64) -> Vec<Candidate> {
        let pair = |spread: Spread| (spread.mean, spread.std);
        let power = pair(target);
        let units = [(PowerUnit::Watt, "W")];
        if !self.feature_set.needs_command() {
            let (v, omega) = ((0.0, 1.0), (0.0, 1.0));
            return self.candidates(&Statistics::Shared { v, omega, power }, &units, step_s);
        }
        let commands = &recorded[..COMMANDS];
        let own = Statistics::Own {
            mean: commands.iter().map(|spread| spread.mean).collect(),
            std: commands.iter().map(|spread| spread.std).collect(),
            power,
        };
        let (v, omega) = (pair(recorded[0]), pair(recorded[1]));
        let shared = Statistics::Shared { v, omega, power };
        let mut candidates = self.candidates(&own, &units, step_s);
        // Per second and per step are the same by statistics of their own.
        candidates.retain(|one| one.convention.derivative == Derivative::OwnPerSecond);
        candidates.extend(self.candidates(&shared, &units, step_s));
        candidates
    }

    /// Index of the chosen candidate. Candidates are sorted best first.
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
                    ChooseError::NotACandidate { asked, allowed: allowed.join(", ") }
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

    /// Every convention that the statistics allow, without equivalent ones.
    fn candidates(
        &self,
        statistics: &Statistics,
        units: &[(PowerUnit, &str)],
        step_s: f64,
    ) -> Vec<Candidate> {
        let own = match statistics {
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
        for &(unit, _) in units {
            for (order, _) in ORDERS {
                for &(lags, _) in places {
                    for &(derivative, _) in derivatives {
                        for &(magnitude, _) in magnitudes {
                            let convention =
                                Convention { unit, order, lags, derivative, magnitude };
                            let candidate = self.candidate(statistics, convention, step_s);
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
    fn candidate(&self, stated: &Statistics, convention: Convention, step_s: f64) -> Candidate {
        let place = |feature| file_place(feature, self.feature_set, &convention);
        let statistics = self.statistics(stated, &convention, step_s);
        let scale_w = match convention.unit {
            PowerUnit::Milliwatt => 1e-3,
            PowerUnit::Watt => 1.0,
        };
        let (power_mean, power_std) = match *stated {
            Statistics::Shared { power, .. } | Statistics::Own { power, .. } => power,
        };
        let mut feature_mean = [0.0; INPUTS];
        let mut feature_std = [0.0; INPUTS];
        for feature in self.feature_set.range() {
            let (mean, std) = statistics(feature, place(feature));
            feature_mean[feature] = mean as f32;
            feature_std[feature] = std as f32;
        }
        let inputs = self.feature_set.inputs();
        let mut layers: Vec<Layer> = self.layers.iter().map(|found| found.layer.clone()).collect();
        if let Some(first) = layers.first_mut() {
            let rows = first.weights.chunks(inputs);
            let reordered =
                rows.flat_map(|row| self.feature_set.range().map(|feature| row[place(feature)]));
            first.weights = reordered.collect();
        }
        // Layers that do not fit were refused earlier. A missing one has no shape.
        let nothing = || Layer { weights: Vec::new(), bias: Vec::new() };
        let layers = padded(&layers).unwrap_or_else(|| std::array::from_fn(|_| nothing()));
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
                layers,
            },
            centre: centre(stated, &convention),
        }
    }

    /// The mean and deviation by which the file normalises each of our features, given its index
    /// and its position in the file.
    fn statistics(
        &self,
        stated: &Statistics,
        convention: &Convention,
        step_s: f64,
    ) -> impl Fn(usize, usize) -> (f64, f64) {
        let Convention { unit, derivative, magnitude, .. } = *convention;
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
        let statistics = stated.clone();
        let feature_set = self.feature_set;
        move |feature, place| match &statistics {
            Statistics::Own { mean, std, power } => {
                let scaled = |(mean, std): (f64, f64), by: f64| (mean * by, std * by);
                // Statistics of the command's features alone come before those of the readings.
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
}

/// The means subtracted from the velocities before their magnitudes are taken, if any.
fn centre(stated: &Statistics, convention: &Convention) -> Option<[f32; 2]> {
    match (stated, convention.magnitude) {
        (Statistics::Shared { v, omega, .. }, Magnitude::OfNormalised) => {
            let centre = [v.0 as f32, omega.0 as f32];
            (centre != [0.0, 0.0]).then_some(centre)
        }
        _ => None,
    }
}

impl Choice {
    /// Returns this choice if it was requested or if the recordings distinguish the best convention
    /// from the second.
    ///
    /// The best one's squared error must be smaller by a relevant share, and in more blocks than
    /// chance explains (by twice the square root of their number, which happens by chance once in
    /// some forty times).
    fn clear(self) -> Result<Choice, ChooseError> {
        let (won, all) = (self.blocks_won as f64, self.blocks as f64);
        let is_significant = 2.0 * won - all >= 2.0 * all.sqrt();
        let matters = self.excess >= MIN_EXCESS;
        if self.forced || self.ranking.len() == 1 || (is_significant && matters) {
            return Ok(self);
        }
        let best_r2 = self.ranking[0].r2;
        let close = self.ranking.iter().enumerate().filter(|(place, ranked)| {
            let excess = (best_r2 - ranked.r2) / (1.0 - best_r2).max(f64::MIN_POSITIVE);
            *place < 2 || excess < MIN_EXCESS
        });
        let close: Vec<String> = close
            .map(|(_, ranked)| format!("{} (R² {:.5})", ranked.convention, ranked.r2))
            .collect();
        let mut candidates = close[..close.len().min(SHOWN)].join(", ");
        if close.len() > SHOWN {
            candidates.push_str(&format!(", and {} more", close.len() - SHOWN));
        }
        Err(ChooseError::Indistinguishable { candidates })
    }

    /// The model that the worker loads.
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
    Network::new(candidate.parameters.clone(), card)
        .map_err(|source| ChooseError::Model { convention: candidate.convention, source })
}

/// A card for a network under evaluation.
fn placeholder(feature_set: FeatureSet) -> ModelCard {
    ModelCard::new(TrainingRange { feature_set, min: [0.0; INPUTS], max: [0.0; INPUTS] })
}
