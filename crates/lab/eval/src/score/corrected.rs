//! One recording: the live path, the baselines, and the sums.

use std::ops::Range;

use joulebus_energy::Calibration;
use joulebus_predictor::FeatureSet;
use joulebus_settings::FleetSettings;

use super::blocks::{Block, Sums};
use super::design::Lines;
use super::members::Member;
use super::references::{Learned, forecasts_w};
use super::{Contents, Options, ScoreError, Subject, recorded_platform};
use crate::energy::{EVERY, EnergyScores, observe_all, untried};
use crate::evaluate::{LeftOut, RobotEvaluation, evaluate_trial};
use joulebus_dataset::trial::Trial;
use joulebus_statistics::metrics::{CoverageTally, Tally};
use joulebus_train::linear::Linear;

/// Forecasts for each row of a recording.
struct Column {
    /// NaN without a forecast.
    power_w: Vec<f32>,
    lo_w: Vec<f32>,
    hi_w: Vec<f32>,
}

/// True if a reference has intervals, and its forecast and their ends for each row, W.
type ReferenceColumn = (bool, Vec<[f64; 3]>);

/// Results of one recording. Empty without rows to evaluate.
pub(super) struct Found<T> {
    /// Sums of the evaluated rows.
    pub(super) sums: Sums,
    /// Sums of the rows that a model was trained on.
    pub(super) trained_on: Sums,
    /// Results of the live path of each model.
    pub(super) live: Vec<T>,
    /// The energy forecasts of each model. Empty if not [asked for](Options::energy).
    pub(super) energy: Vec<EnergyScores>,
    /// Samples without a forecast of the first model.
    pub(super) left_out: Vec<LeftOut>,
}

/// Sums of one recording, and the result of `keep` for the live path of each model.
pub(super) fn one<T>(
    subject: Subject<'_>,
    options: &Options,
    (lines, learned, platforms): (&Lines, &[Vec<Learned>], &[PlatformsBefore]),
    at: usize,
    keep: impl Fn(RobotEvaluation) -> T,
) -> Result<Found<T>, ScoreError> {
    let parts: Vec<_> = subject.design.evaluated(at).collect();
    let apart: Vec<_> = subject.design.apart(at).collect();
    if parts.iter().chain(&apart).all(|(_, rows)| rows.is_empty()) {
        return Ok(Found {
            sums: Sums::default(),
            trained_on: Sums::default(),
            live: Vec::new(),
            energy: Vec::new(),
            left_out: Vec::new(),
        });
    }
    let recording = &subject.recordings[at];
    let contents = &*recording.contents()?;
    let mut live = live(subject, recording.id, &contents.trial)?;
    let columns: Vec<Column> = live.iter().map(|live| column(contents, live)).collect();
    for live in &mut live {
        subject.design.restrict(at, contents, live);
    }
    let left_out = live.first().filter(|_| !parts.is_empty()).map(RobotEvaluation::left_out);
    let live = live.into_iter().filter(|_| !parts.is_empty()).map(keep);
    let live = live.collect();
    let members = Member::of(subject).into_iter();
    let members: Vec<Vec<f32>> = members.map(|(_, member)| member.forecasts_w(contents)).collect();
    let sums_of = |parts: &[(usize, Range<usize>)]| {
        let mut sums = Sums::default();
        for (fold, rows) in parts.iter().filter(|(_, rows)| !rows.is_empty()) {
            let references = options.references.iter().zip(&learned[*fold]);
            let references = references.map(|(reference, learned)| {
                let evaluated = std::slice::from_ref(rows);
                let (name, found) = (&recording.name, (reference, learned));
                let found = forecasts_w(found, name, contents, evaluated)?;
                Ok((reference.has_interval(), found))
            });
            let references = references.collect::<Result<Vec<_>, ScoreError>>()?;
            add_rows(
                &mut sums,
                contents,
                (&columns, &references, &members),
                &lines[*fold],
                rows.clone(),
                options,
            );
        }
        Ok::<_, ScoreError>(sums)
    };
    Ok(Found {
        sums: sums_of(&parts)?,
        trained_on: sums_of(&apart)?,
        live,
        energy: match options.energy {
            true => energy(subject, at, contents, &platforms[at]),
            false => Vec::new(),
        },
        left_out: left_out.unwrap_or_default(),
    })
}

/// Errors of each model's platform before a recording. Empty if it has no evaluated rows.
pub(super) type PlatformsBefore = Vec<Calibration>;

/// Errors of each model's platform before each recording, if its robots drove one after the other,
/// as one fleet. They are the same however the recordings are divided among processes.
///
/// # Errors
/// [`ScoreError::Recording`].
pub(super) fn platforms_before(subject: Subject<'_>) -> Result<Vec<PlatformsBefore>, ScoreError> {
    let mut platforms: Vec<Calibration> = subject.models.iter().map(untried).collect();
    let mut before = Vec::with_capacity(subject.recordings.len());
    for (at, recording) in subject.recordings.iter().enumerate() {
        if subject.design.evaluated(at).all(|(_, rows)| rows.is_empty()) {
            before.push(Vec::new());
            continue;
        }
        before.push(platforms.clone());
        let contents = recording.contents()?;
        for (model, platform) in subject.models.iter().zip(&mut platforms) {
            observe_all(model, &contents.trial, (at as u32, platform));
        }
    }
    Ok(before)
}

/// Forecasts of the energy of the rows that are evaluated, by each model.
fn energy(
    subject: Subject<'_>,
    at: usize,
    contents: &Contents,
    before: &PlatformsBefore,
) -> Vec<EnergyScores> {
    let mut scored = vec![false; contents.trial.rows()];
    let parts = subject.design.evaluated(at).map(|(_, part)| part);
    for row in parts.flatten() {
        // The target of a row is the reading of the sample after its own.
        let target = contents.rows.sample_seq[row] as usize + 1;
        if let Some(scored) = scored.get_mut(target) {
            *scored = true;
        }
    }
    let of = |(model, mut platform): (_, Calibration)| {
        let mut scores = EnergyScores::default();
        let robot = (at as u32, &mut platform);
        scores.add_among(EVERY, model, &contents.trial, &scored, robot);
        scores
    };
    subject.models.iter().zip(before.iter().cloned()).map(of).collect()
}

fn live(subject: Subject<'_>, id: u32, trial: &Trial) -> Result<Vec<RobotEvaluation>, ScoreError> {
    let platform = match subject.platform {
        Some(platform) => platform.clone(),
        None => recorded_platform(id, trial),
    };
    let mut settings = FleetSettings { platforms: vec![platform], ..subject.settings.clone() };
    // A longer silence frees a robot's slot. Here no other robot needs it.
    let stale_after_ns = settings.platforms[0].stale_after_ns;
    let leave_after_ns = &mut settings.intake.leave_after_ns;
    *leave_after_ns = stale_after_ns.max(*leave_after_ns);
    let models = subject.models.iter();
    models
        .map(|model| {
            let model = std::slice::from_ref(model);
            Ok(evaluate_trial(&settings, model, id, trial)?)
        })
        .collect()
}

fn column(contents: &Contents, live: &RobotEvaluation) -> Column {
    let of = |value: fn(&crate::evaluate::Step) -> Option<f32>| -> Vec<f32> {
        let seqs = contents.rows.sample_seq.iter();
        // Samples count from 0 in the order of their rows, one step each.
        seqs.map(|seq| live.steps.get(*seq as usize).and_then(value))
            .map(|value| value.unwrap_or(f32::NAN))
            .collect()
    };
    Column {
        power_w: of(|step| step.power_w),
        lo_w: of(|step| step.lo_w),
        hi_w: of(|step| step.hi_w),
    }
}

/// Adds a range of rows, in blocks.
fn add_rows(
    sums: &mut Sums,
    contents: &Contents,
    (columns, references, members): (&[Column], &[ReferenceColumn], &[Vec<f32>]),
    lines: &[Option<Linear>],
    rows: Range<usize>,
    options: &Options,
) {
    let forecasters = columns.len() + 1 + lines.len() + references.len() + members.len();
    let with_interval = references.iter().filter(|(has, _)| *has).map(|(_, found)| found);
    sums.residuals_w.resize(forecasters, Vec::new());
    let mut forecasts_w = Vec::with_capacity(forecasters);
    for block_rows in row_blocks(rows, options.bootstrap.block_rows) {
        let mut block = Block {
            forecasters: vec![Tally::default(); forecasters],
            intervals: vec![
                CoverageTally::default();
                columns.len() + with_interval.clone().count()
            ],
        };
        for at in block_rows {
            let row = &contents.rows.rows[at];
            forecasts_w.clear();
            forecasts_w.extend(columns.iter().map(|column| f64::from(column.power_w[at])));
            let all_known = forecasts_w.iter().all(|forecast_w: &f64| forecast_w.is_finite());
            forecasts_w.push(f64::from(row.features[FeatureSet::PowerOnly.first()]));
            let predict =
                |line: &Option<Linear>| line.as_ref().map(|line| line.predict(&row.features));
            forecasts_w.extend(lines.iter().map(|line| predict(line).unwrap_or(f64::NAN)));
            forecasts_w.extend(references.iter().map(|(_, found)| found[at][0]));
            forecasts_w.extend(members.iter().map(|member_w| f64::from(member_w[at])));
            // A row without a forecast of each model is scored for no forecaster.
            let reading_w = if all_known { f64::from(row.target_w) } else { f64::NAN };
            for (place, forecast_w) in forecasts_w.iter().enumerate() {
                block.forecasters[place].add(reading_w, *forecast_w, contents.step_s[at]);
                let residual_w = (reading_w - forecast_w) as f32;
                if residual_w.is_finite() {
                    sums.residuals_w[place].push(residual_w);
                }
            }
            let ends = columns.iter().map(|one| [one.lo_w[at], one.hi_w[at]].map(f64::from));
            let ends = ends.chain(with_interval.clone().map(|found| [found[at][1], found[at][2]]));
            for (interval, [lo_w, hi_w]) in block.intervals.iter_mut().zip(ends) {
                interval.add(reading_w, lo_w, hi_w);
            }
        }
        sums.blocks.push(block);
    }
}

/// Blocks of `length` rows. A remainder of less than half of it joins the last block.
fn row_blocks(rows: Range<usize>, length: usize) -> impl Iterator<Item = Range<usize>> {
    let count = ((rows.len() + length / 2) / length).max(1);
    (0..count).map(move |at| {
        let start = rows.start + at * length;
        let end = if at + 1 == count { rows.end } else { start + length };
        start..end
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn blocks_cover_every_row_once_with_about_the_requested_length(
            start in 0usize..50, rows in 1usize..500, length in 1usize..120
        ) {
            let found: Vec<_> = super::row_blocks(start..start + rows, length).collect();
            let flat: Vec<usize> = found.iter().cloned().flatten().collect();
            prop_assert_eq!(flat, (start..start + rows).collect::<Vec<_>>());
            for (at, stretch) in found.iter().enumerate() {
                let is_last = at + 1 == found.len();
                prop_assert!(stretch.len() == length || is_last);
                prop_assert!(2 * stretch.len() < 3 * length + 1 || length == 1);
            }
        }
    }
}
