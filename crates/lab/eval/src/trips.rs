//! Trips of recorded drives: each is asked about at its beginning from its commands alone, and
//! compared with what it drew.
//!
//! The energy model is fitted to the other recordings, and knows no reading of the drive. What asks
//! is what answers `joulebus ask` ([`joulebus_plan::first_energy`]).

use std::collections::BTreeSet;
use std::fmt;

use joulebus_dataset::rows::{Dataset, Row, RowOrigin};
use joulebus_dataset::split::median_period_s;
use joulebus_dataset::trial::TrialError;
use joulebus_energy::{Commands, EnergyModel};
use joulebus_plan::first_energy;
use joulebus_predictor::FeatureSet;
use joulebus_statistics::poisson::upper_decay;
use joulebus_train::{energy_model, recorded_features};
use serde::Serialize;

use crate::score::{Contents, Recording, sources};

/// Coverage of the intervals.
const COVERAGE: f32 = 0.9;
/// Lengths of parts of drives that are asked about too, s.
const PARTS_S: [f64; 2] = [20.0, 80.0];
/// Numbers of drives that a model is fitted to, to judge intervals of few.
const FEW: [usize; 4] = [2, 3, 5, 8];
/// Units that are left out by turns, at most. More are left out together.
const MAX_FOLDS: usize = 12;
/// Drives whose mean power is compared.
const LAST: usize = 20;
/// Drives that are listed.
const MAX_LISTED: usize = 12;

/// What was asked about a drive or a part of it, and what it drew.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TripScore {
    /// Name of the recording.
    pub recording: String,
    /// Time driven, s.
    pub driven_s: f64,
    /// Energy that was asked for, J: expected, lower and upper end of the 90 % interval.
    pub asked_j: [f64; 3],
    /// Energy measured, J.
    pub measured_j: f64,
    /// Energy by the mean power of the training, by the ridge regression alone, and by the mean
    /// power of the last 20 drives. NaN where there is none.
    pub others_j: [f64; 3],
    /// Share of the steps that lie outside the training data.
    pub outside: f64,
}

/// Scores of trips of one length, of one kind of left-out recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TripRow {
    /// What was left out of the training: `drive`, `group` (a floor or a day), or all but a few
    /// drives.
    pub left_out: String,
    /// Length of the trips, s. NaN for whole drives.
    pub length_s: f64,
    /// Number of trips.
    pub trips: usize,
    /// Mean absolute error of the energy, relative to what was measured.
    pub mape: f64,
    /// The same of the mean power, the ridge regression, and the mean of the last 20 drives.
    pub others: [f64; 3],
    /// Share of measured energies inside the interval.
    pub coverage: f64,
    /// Interval score through the mean energy. Less is better.
    pub score: f64,
    /// Share of right yeses: each trip is asked about with as much spare energy as the upper end of
    /// its interval.
    pub right_yes: f64,
    /// Upper end of the 95 % interval of the share of wrong yeses (Clopper and Pearson 1934).
    pub wrong_yes_bound: f64,
    /// Share of trips with steps outside the training data.
    pub outside: f64,
}

/// Trips of some recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TripsReport {
    /// Number of drives, and of their groups.
    pub drives: [usize; 2],
    /// Scores, by what was left out and by length.
    pub rows: Vec<TripRow>,
    /// The whole drives, each left out.
    pub trips: Vec<TripScore>,
}

/// Asks about all drives. Each drive and each group is left out in turn, and all drives but few.
///
/// # Errors
/// A recording that cannot be read again.
pub fn trips(recordings: &[Recording]) -> Result<TripsReport, TrialError> {
    let drives = Drives::new(recordings)?;
    let names =
        |of: &dyn Fn(&Recording) -> String| -> Vec<String> { recordings.iter().map(of).collect() };
    let groups = names(&|recording| recording.group.clone());
    let mut units = vec![("drive".to_owned(), drives.turns(&names(&|of| of.name.clone())))];
    if groups.iter().collect::<BTreeSet<_>>().len() > 1 {
        units.push(("group".to_owned(), drives.turns(&groups)));
    }
    for few in FEW.into_iter().filter(|few| *few < recordings.len()) {
        units.push((format!("all but {few} drives"), drives.few(few)));
    }
    let (mut rows, mut listed) = (Vec::new(), Vec::new());
    for (left_out, folds) in units {
        for length_s in PARTS_S.into_iter().chain([f64::NAN]) {
            let mut found = Vec::new();
            for fold in &folds {
                found.extend(
                    fold.asked.iter().flat_map(|place| drives.asked(*place, length_s, fold)),
                );
            }
            rows.extend(row(&left_out, length_s, &found));
            if left_out == "drive" && length_s.is_nan() {
                listed = found;
            }
        }
    }
    let groups: BTreeSet<&String> = groups.iter().collect();
    Ok(TripsReport { drives: [recordings.len(), groups.len()], rows, trips: listed })
}

/// Drives that are asked about with a model of others.
struct Fold {
    asked: Vec<usize>,
    model: EnergyModel,
}

struct Drives {
    names: Vec<String>,
    contents: Vec<std::sync::Arc<Contents>>,
    origins: Vec<RowOrigin>,
    feature_set: FeatureSet,
    period_s: f32,
}

impl Drives {
    fn new(recordings: &[Recording]) -> Result<Self, TrialError> {
        let contents: Vec<_> =
            recordings.iter().map(Recording::contents).collect::<Result<_, _>>()?;
        let names = recordings.iter().map(|recording| (&*recording.name, &*recording.robot));
        let mut drives = Self {
            names: recordings.iter().map(|recording| recording.name.clone()).collect(),
            origins: RowOrigin::of_sources(names),
            contents,
            feature_set: FeatureSet::Full,
            period_s: median_period_s(&sources(recordings)),
        };
        drives.feature_set = recorded_features(&drives.dataset(&|_| true));
        Ok(drives)
    }

    fn dataset(&self, is_in: &dyn Fn(usize) -> bool) -> Dataset {
        let drives = self.contents.iter().zip(&self.origins).enumerate();
        let rows = drives.filter(|(place, _)| is_in(*place)).flat_map(|(_, (contents, origin))| {
            contents.rows.rows.iter().map(|row| row.of(*origin))
        });
        Dataset {
            training: rows.collect(),
            validation: Vec::new(),
            held_out: Vec::new(),
            description: String::new(),
            period_s: self.period_s,
        }
    }

    /// A fold, if the other drives make a model.
    fn fold(&self, asked: Vec<usize>, is_in: &dyn Fn(usize) -> bool) -> Option<Fold> {
        let model = energy_model(&self.dataset(is_in), self.feature_set)?;
        Some(Fold { asked, model })
    }

    /// Each unit left out in turn. Of many units several at a time.
    fn turns(&self, unit_of: &[String]) -> Vec<Fold> {
        let units: Vec<&String> = unit_of.iter().collect::<BTreeSet<_>>().into_iter().collect();
        let folds = units.len().min(MAX_FOLDS);
        let fold_of = |place: usize| units.iter().position(|unit| **unit == unit_of[place]);
        let places = 0..unit_of.len();
        let of_fold = |fold: usize| {
            let is_asked = |place: usize| fold_of(place).is_some_and(|unit| unit % folds == fold);
            let asked = places.clone().filter(|place| is_asked(*place)).collect();
            self.fold(asked, &|place| !is_asked(place))
        };
        (0..folds).filter_map(of_fold).collect()
    }

    /// Some drives, each with a model of the few that follow it.
    fn few(&self, few: usize) -> Vec<Fold> {
        let count = self.names.len();
        let places = (0..count).step_by(count.div_ceil(2 * MAX_FOLDS));
        let of = |asked: usize| {
            let is_in = |place: usize| (1..=few).contains(&((place + count - asked) % count));
            self.fold(vec![asked], &is_in)
        };
        places.filter_map(of).collect()
    }

    /// A drive in parts of a length, or as a whole, asked about with a fold's model.
    fn asked(&self, place: usize, length_s: f64, fold: &Fold) -> Vec<TripScore> {
        let contents = &self.contents[place];
        let (rows, step_s) = (&contents.rows.rows, &contents.step_s);
        let mut ends = vec![0];
        let mut time_s = 0.0;
        for (row, step_s) in step_s.iter().enumerate() {
            time_s += step_s;
            if time_s >= length_s {
                ends.push(row + 1);
                time_s = 0.0;
            }
        }
        if length_s.is_nan() {
            ends.push(rows.len());
        }
        let parts = ends.windows(2).filter(|part| part[0] < part[1]);
        let trip = |part: &[usize]| {
            let part = part[0]..part[1];
            self.trip(place, &rows[part.clone()], &step_s[part], &fold.model)
        };
        parts.filter_map(trip).collect()
    }

    fn trip(
        &self,
        place: usize,
        rows: &[Row],
        step_s: &[f64],
        model: &EnergyModel,
    ) -> Option<TripScore> {
        let driven_s: f64 = step_s.iter().sum();
        let measured =
            rows.iter().zip(step_s).map(|(row, step_s)| f64::from(row.target_w) * step_s);
        let (v_mps, omega_radps): (Vec<f32>, Vec<f32>) =
            rows.iter().map(|row| (row.features[0], row.features[1])).unzip();
        let commands = Commands {
            period_s: (driven_s / rows.len() as f64) as f32,
            v_mps: &v_mps,
            omega_radps: &omega_radps,
        };
        let (energy, caveats) = first_energy(model, commands, COVERAGE)?;
        let by_ridge = |ridge: &joulebus_energy::Ridge| -> f64 {
            let power_w = |(v_mps, omega_radps): (&f32, &f32)| {
                let deviations = ridge.deviations(&model.command, *v_mps, *omega_radps);
                f64::from(ridge.power_w(&deviations))
            };
            let mean_w = v_mps.iter().zip(&omega_radps).map(power_w).sum::<f64>();
            mean_w / rows.len() as f64 * driven_s
        };
        Some(TripScore {
            recording: self.names[place].clone(),
            driven_s,
            asked_j: [energy.mean_j, energy.lo_j, energy.hi_j].map(f64::from),
            measured_j: measured.sum(),
            others_j: [
                f64::from(model.command.mean_w) * driven_s,
                model.ridge.as_ref().map_or(f64::NAN, by_ridge),
                self.last_w(place) * driven_s,
            ],
            outside: caveats.steps_outside_training as f64 / rows.len() as f64,
        })
    }

    /// Mean power of the drives before one, W. NaN for the first.
    fn last_w(&self, place: usize) -> f64 {
        let before = &self.contents[place.saturating_sub(LAST)..place];
        let powers_w =
            before.iter().flat_map(|contents| &contents.rows.rows).map(|row| row.target_w);
        let (count, sum_w) = powers_w
            .fold((0.0, 0.0), |(count, sum), power_w| (count + 1.0, sum + f64::from(power_w)));
        sum_w / count
    }
}

/// The scores of some trips. `None` without any.
fn row(left_out: &str, length_s: f64, trips: &[TripScore]) -> Option<TripRow> {
    let count = trips.len() as f64;
    let mean = |of: &dyn Fn(&TripScore) -> f64| trips.iter().map(of).sum::<f64>() / count;
    let mean_j = mean(&|trip| trip.measured_j.abs());
    let relative = |trip: &TripScore, j: f64| (j - trip.measured_j).abs() / trip.measured_j.abs();
    let is_below = |trip: &TripScore| trip.measured_j <= trip.asked_j[2];
    let wrong = trips.iter().filter(|trip| !is_below(trip)).count();
    (!trips.is_empty()).then(|| TripRow {
        left_out: left_out.to_owned(),
        length_s,
        trips: trips.len(),
        mape: mean(&|trip| relative(trip, trip.asked_j[0])),
        others: std::array::from_fn(|other| {
            let known = trips.iter().map(|trip| relative(trip, trip.others_j[other]));
            let known: Vec<f64> = known.filter(|error| error.is_finite()).collect();
            known.iter().sum::<f64>() / known.len() as f64
        }),
        coverage: mean(&|trip| {
            let [_, lo_j, hi_j] = trip.asked_j;
            f64::from(u8::from((lo_j..=hi_j).contains(&trip.measured_j)))
        }),
        score: mean(&|trip| {
            let [_, lo_j, hi_j] = trip.asked_j;
            let missed_j = (lo_j - trip.measured_j).max(trip.measured_j - hi_j).max(0.0);
            (hi_j - lo_j + 2.0 / f64::from(1.0 - COVERAGE) * missed_j) / mean_j
        }),
        right_yes: 1.0 - wrong as f64 / count,
        wrong_yes_bound: upper_decay(wrong as u64, (trips.len() - wrong) as u64, 0.975),
        outside: mean(&|trip| f64::from(u8::from(trip.outside > 0.0))),
    })
}

fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.1} %", 100.0 * share) } else { "–".to_owned() }
}

impl fmt::Display for TripsReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [drives, groups] = self.drives;
        writeln!(
            out,
            "Trips of {drives} drives in {groups} groups, asked about from their commands alone"
        )?;
        writeln!(
            out,
            "| left out | length | trips | MAPE | mean power | ridge | last {LAST} | in the 90 % | score | right \
             yeses | wrong at most | outside |"
        )?;
        writeln!(out, "|---|---|---|---|---|---|---|---|---|---|---|---|")?;
        for row in &self.rows {
            let length = if row.length_s.is_nan() {
                "whole".to_owned()
            } else {
                format!("{} s", row.length_s)
            };
            let [mean, ridge, last] = row.others.map(percent);
            writeln!(
                out,
                "| {} | {length} | {} | {} | {mean} | {ridge} | {last} | {} | {:.2} | {} | {} | {} |",
                row.left_out,
                row.trips,
                percent(row.mape),
                percent(row.coverage),
                row.score,
                percent(row.right_yes),
                percent(row.wrong_yes_bound),
                percent(row.outside),
            )?;
        }
        if self.trips.len() > MAX_LISTED {
            return Ok(());
        }
        for trip in &self.trips {
            let [asked_j, lo_j, hi_j] = trip.asked_j;
            let name = std::path::Path::new(&trip.recording).file_name().unwrap_or_default();
            write!(
                out,
                "\n{}: asked {asked_j:.0} J ({lo_j:.0} to {hi_j:.0}), driven {:.1} s, measured {:.0} J",
                name.display(),
                trip.driven_s,
                trip.measured_j,
            )?;
        }
        Ok(())
    }
}
