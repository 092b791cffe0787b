//! Gain of each kind of input to a forecast, on new and on held readings.

use std::ops::Range;

use joulebus_predictor::{Features, Model};
use serde::Serialize;

use super::error::AnalyzeError;
use super::view::View;
use crate::score::Contents;
use joulebus_dataset::rows::Row;
use joulebus_dataset::trial::Trial;
use joulebus_statistics::metrics::Tally;
use joulebus_train::linear::{Linear, Moments, Terms};

/// Forecasts of the same held-out readings by models with more or fewer inputs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ablation {
    /// Rows that the linear models were fitted on: training and validation.
    pub fitted_rows: usize,
    /// Held-out rows, each with a forecast of every model.
    pub rows: usize,
    /// Number of these rows whose reading equals the previous one to the bit.
    pub held_rows: usize,
    /// Rows of both parts left out because a velocity is missing.
    pub unusable_rows: usize,
    /// Mean of the held-out readings, W.
    pub power_mean_w: f64,
    /// Standard deviation of the held-out readings, W.
    pub power_std_w: f64,
    /// The models.
    pub members: Vec<Member>,
}

/// A model and its scores.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Member {
    /// Its name: `persistence`, `velocities + 1 lag`, a model's name.
    pub name: String,
    /// On all held-out readings.
    pub all: Part,
    /// On readings equal to the previous one.
    pub held: Part,
    /// On the other readings.
    pub new: Part,
    /// Reduction of squared error against the mean of all held-out readings: the share of that
    /// reduction on held readings. NaN without a reduction.
    pub held_share_of_gain: f64,
}

/// Scores on a part of the readings. NaN if the part has no variance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Part {
    /// Readings.
    pub rows: u64,
    /// Coefficient of determination, about the mean of the part.
    pub r2: f64,
    /// Mean absolute error, W.
    pub mae_w: f64,
    /// Root of the mean squared error, W.
    pub rmse_w: f64,
}

/// Computes the ablation, and what was skipped with reasons. `ranges` are the rows of each trial of
/// the view by part.
pub(super) fn ablation(
    view: &View<'_>,
    ranges: &[[Range<usize>; 3]],
    has_velocities: bool,
    window: usize,
    models: &[(String, Model)],
) -> Result<(Option<Ablation>, Vec<String>), AnalyzeError> {
    let mut skipped = Vec::new();
    let mut wanted = if has_velocities {
        vec![
            Terms::VELOCITIES,
            Terms::velocities_and_lags(1),
            Terms::velocities_and_lags(window),
            Terms::lags(1),
            Terms::lags(window),
        ]
    } else {
        skipped.push("models with velocities: no trial has recorded them".to_owned());
        vec![Terms::lags(1), Terms::lags(window)]
    };
    wanted.dedup();
    let rows = Rows { view, ranges, has_velocities };
    let (moments, mut unusable_rows) = rows.fitted(&wanted)?;
    let mut forecasters =
        vec![Forecaster { name: "persistence".to_owned(), of: Of::Line(Linear::persistence()) }];
    for terms in wanted {
        match moments.fit(terms) {
            Ok(line) => {
                forecasters.push(Forecaster { name: terms.to_string(), of: Of::Line(line) });
            }
            Err(error) => skipped.push(format!("{terms}: {error}")),
        }
    }
    forecasters.extend(
        models.iter().map(|(name, model)| Forecaster { name: name.clone(), of: Of::Model(model) }),
    );
    let (tallies, left_out) = rows.held_out(&forecasters)?;
    unusable_rows += left_out;
    let [new, held] = tallies[0];
    let all = both([new, held]);
    if all.count() + all.unscored() < 2 {
        skipped.push("the ablation: fewer than two rows are held out".to_owned());
        return Ok((None, skipped));
    }
    let mut members = Vec::with_capacity(forecasters.len());
    for (Forecaster { name, of }, parts) in forecasters.into_iter().zip(tallies) {
        // A line is fitted on usable rows, so it has a forecast of each.
        if matches!(of, Of::Model(_)) && both(parts).unscored() > 0 {
            skipped.push(format!("{name}: it reads velocities, which are not recorded"));
            continue;
        }
        members.push(member(name, parts));
    }
    let found = Ablation {
        fitted_rows: moments.rows(),
        rows: all.count() as usize,
        held_rows: held.count() as usize,
        unusable_rows,
        power_mean_w: all.reading_mean_w(),
        power_std_w: all.reading_std_w(),
        members,
    };
    Ok((Some(found), skipped))
}

/// True if all velocities of a row are known.
pub(super) fn velocities_known(features: &Features) -> bool {
    Terms::VELOCITIES.features().all(|feature| features[feature].is_finite())
}

/// A forecaster and its name.
struct Forecaster<'a> {
    name: String,
    of: Of<'a>,
}

enum Of<'a> {
    Line(Linear),
    Model(&'a Model),
}

impl Forecaster<'_> {
    fn forecasts_w(&self, rows: &[Row]) -> Vec<f64> {
        match &self.of {
            Of::Line(line) => line.predict_rows(rows),
            Of::Model(model) => {
                let inputs: Vec<Features> = rows.iter().map(|row| row.features).collect();
                let mut forecasts_w = vec![0.0; rows.len()];
                model.predict(&inputs, &mut forecasts_w);
                forecasts_w.into_iter().map(f64::from).collect()
            }
        }
    }
}

/// Scores on new readings, and on held ones.
type Tallies = [Tally; 2];

fn both([new, held]: Tallies) -> Tally {
    let mut all = new;
    all.merge(&held);
    all
}

/// Rows that are forecast at a time.
const BATCH_ROWS: usize = 4_096;

/// The rows of a view, by part.
struct Rows<'a> {
    view: &'a View<'a>,
    ranges: &'a [[Range<usize>; 3]],
    has_velocities: bool,
}

impl Rows<'_> {
    fn is_usable(&self, row: &Row) -> bool {
        row.target_w.is_finite() && (!self.has_velocities || velocities_known(&row.features))
    }

    /// Moments of the rows to fit on, and the number of those that are unusable.
    fn fitted(&self, wanted: &[Terms]) -> Result<(Moments, usize), AnalyzeError> {
        let any = wanted.iter().fold(Terms::new(&[]), |any, terms| any.or(*terms));
        let (mut moments, mut unusable) = (Moments::new(any), 0);
        self.view.each(
            |at, contents| {
                let [training, validation, _] = &self.ranges[at];
                let rows = |range: &Range<usize>| contents.rows.rows[range.clone()].iter();
                let all = rows(training).chain(rows(validation));
                let usable: Vec<Row> = all.filter(|row| self.is_usable(row)).copied().collect();
                let unusable = training.len() + validation.len() - usable.len();
                Ok((Moments::of(&usable, any), unusable))
            },
            |_, (of_trial, count)| {
                unusable += count;
                Ok(moments.merge(&of_trial)?)
            },
        )?;
        Ok((moments, unusable))
    }

    /// The scores of each forecaster on the held-out rows, and the number of those that are
    /// unusable.
    fn held_out(
        &self,
        forecasters: &[Forecaster<'_>],
    ) -> Result<(Vec<Tallies>, usize), AnalyzeError> {
        let mut tallies = vec![Tallies::default(); forecasters.len()];
        let mut unusable = 0;
        self.view.each(
            |at, contents| Ok(self.held_out_of(contents, &self.ranges[at][2], forecasters)),
            |_, (of_trial, count)| {
                unusable += count;
                for (all, one) in tallies.iter_mut().flatten().zip(of_trial.iter().flatten()) {
                    all.merge(one);
                }
                Ok(())
            },
        )?;
        Ok((tallies, unusable))
    }

    fn held_out_of(
        &self,
        contents: &Contents,
        range: &Range<usize>,
        forecasters: &[Forecaster<'_>],
    ) -> (Vec<Tallies>, usize) {
        let mut tallies = vec![Tallies::default(); forecasters.len()];
        let mut unusable = 0;
        let usable = range.clone().filter(|at| {
            let is_usable = self.is_usable(&contents.rows.rows[*at]);
            unusable += usize::from(!is_usable);
            is_usable
        });
        let usable: Vec<usize> = usable.collect();
        for batch in usable.chunks(BATCH_ROWS) {
            let rows: Vec<Row> = batch.iter().map(|at| contents.rows.rows[*at]).collect();
            let seqs = batch.iter().map(|at| contents.rows.sample_seq[*at]);
            let held: Vec<bool> = seqs.map(|seq| target_is_held(&contents.trial, seq)).collect();
            for (forecaster, tallies) in forecasters.iter().zip(&mut tallies) {
                let forecasts_w = forecaster.forecasts_w(&rows);
                for ((row, forecast_w), held) in rows.iter().zip(forecasts_w).zip(&held) {
                    let reading_w = f64::from(row.target_w);
                    tallies[usize::from(*held)].add(reading_w, forecast_w, f64::NAN);
                }
            }
        }
        (tallies, unusable)
    }
}

fn member(name: String, [new, held]: Tallies) -> Member {
    let all = both([new, held]);
    // Reduction of squared error against the mean of all readings, on new and on held ones.
    let gain_w2 = [new, held]
        .map(|tally| tally.squares_about_w2(all.reading_mean_w()) - tally.squared_residuals_w2());
    let total_w2 = gain_w2[0] + gain_w2[1];
    Member {
        name,
        all: Part::new(&all),
        held: Part::new(&held),
        new: Part::new(&new),
        held_share_of_gain: if total_w2 > 0.0 { gain_w2[1] / total_w2 } else { f64::NAN },
    }
}

impl Part {
    fn new(tally: &Tally) -> Self {
        Self { rows: tally.count(), r2: tally.r2(), mae_w: tally.mae_w(), rmse_w: tally.rmse_w() }
    }
}

/// True if the target reading of a sample's forecast equals the one before it.
fn target_is_held(trial: &Trial, sample_seq: u64) -> bool {
    usize::try_from(sample_seq).is_ok_and(|sample| trial.is_held(sample + 1))
}
