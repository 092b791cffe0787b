//! Figure 7: calibration of intervals and forecasts.

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};
use rayon::prelude::*;

use super::document::{Cell, Column, Part, Section, Table};
use super::figure::{Axis, Colour, Direction, Figure, Layer, Mark, Panel};
use super::material::Material;
use joulebus_dataset::trial::Trial;
use joulebus_eval::evaluate::{EvaluateError, RobotEvaluation, Series, evaluate_trial};
use joulebus_eval::score::{Design, Recording, recorded_platform};
use joulebus_statistics::metrics::CoverageTally;

const LEVELS: [f32; 7] = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98];
/// Number of bins of the forecasts.
const PARTS: usize = 20;

/// The live intervals of a model at one level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    nominal: f64,
    live: CoverageTally,
    /// Coverage of intervals of fixed width, from the residual deviation in the model's file.
    fixed: CoverageTally,
}

/// Runs the live path with intervals of every level on every recording, which are in memory.
/// `design` names the rows that are evaluated, else all are.
pub(super) fn levels(
    settings: &FleetSettings,
    platform: Option<&Platform>,
    model: &Model,
    recordings: &[Recording],
    design: Option<&Design>,
) -> Result<Vec<Level>, EvaluateError> {
    let std_w = f64::from(model.residual().std_w);
    let level = |coverage: f32| {
        let reach_w = std_w * normal_reach(coverage.into());
        let in_memory = recordings.par_iter().enumerate();
        let in_memory = in_memory.filter_map(|(at, one)| Some((at, one.id, one.in_memory()?)));
        let each = in_memory.map(|(at, id, contents)| {
            let mut robot = live(settings, platform, model, (id, &contents.trial), coverage)?;
            if let Some(design) = design {
                design.restrict(at, contents, &mut robot);
            }
            let series = Series::new(&robot);
            let (mut live, mut fixed) = (CoverageTally::default(), CoverageTally::default());
            for at in 0..series.len() {
                let (reading_w, forecast_w) = (series.reading_w[at], series.forecast_w[at]);
                live.add(reading_w, series.lo_w[at], series.hi_w[at]);
                fixed.add(reading_w, forecast_w - reach_w, forecast_w + reach_w);
            }
            Ok((live, fixed))
        });
        let mut sums = (CoverageTally::default(), CoverageTally::default());
        for (live, fixed) in each.collect::<Result<Vec<_>, EvaluateError>>()? {
            sums.0.merge(&live);
            sums.1.merge(&fixed);
        }
        Ok(Level { nominal: coverage.into(), live: sums.0, fixed: sums.1 })
    };
    LEVELS.into_iter().map(level).collect()
}

fn live(
    settings: &FleetSettings,
    platform: Option<&Platform>,
    model: &Model,
    (robot, trial): (u32, &Trial),
    coverage: f32,
) -> Result<RobotEvaluation, EvaluateError> {
    let mut settings = settings.clone();
    settings.interval.coverage = coverage;
    let platform = platform.cloned();
    let platform = platform.unwrap_or_else(|| recorded_platform(robot, trial));
    let leave_after_ns = &mut settings.intake.leave_after_ns;
    *leave_after_ns = platform.stale_after_ns.max(*leave_after_ns);
    settings.platforms = vec![platform];
    let models = std::slice::from_ref(model);
    evaluate_trial(&settings, models, robot, trial)
}

/// Quantile of the normal distribution for a central share, by bisection.
fn normal_reach(share: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if libm::erf(middle / std::f64::consts::SQRT_2) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

pub(super) fn section(material: &Material<'_>, levels: &[Level]) -> Section {
    Section {
        id: "calibration".to_owned(),
        title: "Calibration of the intervals".to_owned(),
        parts: vec![
            Part::Words(
                "The live path adapts the ends of its intervals after every reading, to hold the nominal \
                 coverage. For comparison: intervals of fixed width, those of a normal distribution \
                 with the standard deviation in the model file."
                    .to_owned(),
            ),
            Part::Figure(figure(material, levels)),
            Part::Table(table(material, levels)),
        ],
    }
}

fn figure(material: &Material<'_>, levels: &[Level]) -> Figure {
    material.noted(Figure::new(
        "figure-7-calibration",
        "Figure 7. Calibration.",
        format!(
            "(a) Share of readings inside the live interval against the nominal coverage. On the \
             dashed line both are equal. (b) Mean of reading minus forecast in {PARTS} equal parts \
             of the forecasts, from low to high."
        ),
        vec![promise(levels), means(material)],
    ))
}

fn promise(levels: &[Level]) -> Panel {
    let curve = |of: fn(&Level) -> &CoverageTally| -> Vec<[f64; 2]> {
        let points = levels.iter();
        points.map(|level| [100.0 * level.nominal, 100.0 * of(level).coverage()]).collect()
    };
    let live = curve(|level| &level.live);
    let fixed = curve(|level| &level.fixed);
    Panel {
        title: "nominal and actual coverage".to_owned(),
        x: Axis::new("asked for (%)").within(48.0, 101.0),
        y: Axis::new("readings inside (%)"),
        layers: vec![
            Layer::named("equal", Colour::Grey, Mark::Diagonal),
            Layer::plain(Colour::Vermilion, Mark::Points(fixed.clone())),
            Layer::named(
                "fixed width",
                Colour::Vermilion,
                Mark::Line { points: fixed, dashed: true },
            ),
            Layer::plain(Colour::Blue, Mark::Points(live.clone())),
            Layer::named("live", Colour::Blue, Mark::Line { points: live, dashed: false }),
        ],
    }
}

/// Mean residual by forecast: zero at every level if the model is calibrated.
fn means(material: &Material<'_>) -> Panel {
    let unit = material.unit;
    let pairs = material.live().iter().flat_map(|robot| {
        let series = Series::new(robot);
        let residuals_w: Vec<f64> = series.residuals_w().collect();
        series.forecast_w.into_iter().zip(residuals_w).collect::<Vec<_>>()
    });
    let mut pairs: Vec<(f64, f64)> = pairs.collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = pairs.len().div_ceil(PARTS).max(1);
    let mean = |values: &mut dyn Iterator<Item = f64>, count: usize| {
        unit.scaled_w(values.sum::<f64>() / count as f64)
    };
    let points: Vec<[f64; 2]> = pairs
        .chunks(count)
        .map(|part| {
            let forecast = mean(&mut part.iter().map(|pair| pair.0), part.len());
            [forecast, mean(&mut part.iter().map(|pair| pair.1), part.len())]
        })
        .collect();
    Panel {
        title: "mean residual by forecast".to_owned(),
        x: Axis::new(format!("forecast ({})", unit.name())),
        y: Axis::new(format!("mean residual ({})", unit.name())),
        layers: vec![
            Layer::plain(Colour::Grey, Mark::Rule { at: 0.0, direction: Direction::Across }),
            Layer::plain(Colour::Blue, Mark::Points(points.clone())),
            Layer::plain(Colour::Blue, Mark::Line { points, dashed: false }),
        ],
    }
}

fn table(material: &Material<'_>, levels: &[Level]) -> Table {
    let unit = material.unit;
    let row = |level: &Level| {
        vec![
            Cell::Number(100.0 * level.nominal, 0),
            Cell::Number(100.0 * level.live.coverage(), 2),
            unit.cell(level.live.width_w(), true),
            Cell::Number(100.0 * level.fixed.coverage(), 2),
            unit.cell(level.fixed.width_w(), true),
        ]
    };
    Table {
        id: "table-calibration".to_owned(),
        caption: "Share of readings inside their interval, and its mean width.".to_owned(),
        columns: vec![
            Column::new("asked_percent", "asked for (%)"),
            Column::new("live_percent", "live: inside (%)"),
            unit.column("live_width", "live: width"),
            Column::new("fixed_percent", "fixed width: inside (%)"),
            unit.column("fixed_width", "fixed width: width"),
        ],
        rows: levels.iter().map(row).collect(),
        folded: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_quantiles_equal_the_tabulated_ones() {
        for (share, reach) in [(0.5, 0.674_490), (0.9, 1.644_854), (0.95, 1.959_964)] {
            assert!((normal_reach(share) - reach).abs() < 1e-5, "{share}");
        }
    }
}
