//! Figure 7: calibration of intervals and forecasts.

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};
use rayon::prelude::*;

use super::document::{Cell, Column, Part, Section, Table};
use super::material::{Material, label};
use joulebus_dataset::trial::Trial;
use joulebus_eval::evaluate::{EvaluateError, RobotEvaluation, Series, evaluate_trial};
use joulebus_eval::score::{Cell as Scores, Design, Recording, recorded_platform};
use joulebus_figure::{Axis, Colour, Direction, Figure, Interval, Layer, Mark, Panel};
use joulebus_statistics::metrics::CoverageTally;

/// Nominal coverages.
const LEVELS: [f32; 7] = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98];
/// Number of bins of the forecasts.
const PARTS: usize = 20;
/// Window of coverage over time, s.
const STRETCH_S: f64 = 10.0;
/// Maximum number of names in a figure.
const MAX_SETS: usize = 24;

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
///
/// # Errors
/// The settings are refused.
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

/// The section. `sets` are shown individually. `trial` is shown over time.
pub(super) fn section(
    material: &Material<'_>,
    levels: &[Level],
    sets: &[Scores],
    trial: &str,
) -> Section {
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
            Part::Figure(figure(material, levels, sets, trial)),
            Part::Table(table(material, levels)),
        ],
    }
}

fn figure(material: &Material<'_>, levels: &[Level], sets: &[Scores], trial: &str) -> Figure {
    let series = material.series(trial).unwrap_or_default();
    let nominal = 100.0 * levels_asked(material);

    let mut panels = vec![promise(levels), means(material)];
    panels.push(Panel {
        title: format!("over time, {}", label(trial)),
        x: Axis::new("time (s)"),
        y: Axis::new("readings inside (%)"),
        layers: vec![
            Layer::named("asked for", Colour::Grey, across(nominal)),
            Layer::named(
                format!("inside, by {STRETCH_S:.0} s"),
                Colour::Blue,
                Mark::Line { points: over_time(&series), dashed: false },
            ),
        ],
    });
    let shown = &sets[..sets.len().min(MAX_SETS)];
    if shown.len() > 1 {
        panels.push(each(material, shown, nominal));
    }
    let last =
        if shown.len() > 1 { " (d) Share inside, individually, with 95 % intervals." } else { "" };
    let mut figure = Figure::new(
        "figure-7-calibration",
        "Figure 7. Calibration.",
        format!(
            "(a) Share of readings inside the live interval against the nominal coverage. On the \
                dashed line both are equal. (b) Mean of reading minus forecast in {PARTS} equal \
                parts of the \
             forecasts, from low to high. (c) Share inside over time.{last}"
        ),
        panels,
    );
    figure.panel_height_px = (110 + 18 * shown.len() as u32).clamp(260, 560);
    material.noted(figure)
}

/// Nominal coverage of the live intervals, share.
fn levels_asked(material: &Material<'_>) -> f64 {
    let scores = material.scored.report.all.forecasters.first();
    let interval = scores.and_then(|score| score.interval);
    interval.map_or(f64::NAN, |interval| interval.scores.nominal)
}

const fn across(at: f64) -> Mark {
    Mark::Rule { at, direction: Direction::Across }
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
            Layer::plain(Colour::Grey, across(0.0)),
            Layer::plain(Colour::Blue, Mark::Points(points.clone())),
            Layer::plain(Colour::Blue, Mark::Line { points, dashed: false }),
        ],
    }
}

/// Share inside, in percent, of each time window.
fn over_time(series: &Series) -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    let mut from = 0;
    while from < series.len() {
        let end_s = series.time_s[from] + STRETCH_S;
        let to = series.time_s.partition_point(|time_s| *time_s < end_s).max(from + 1);
        let mut inside = CoverageTally::default();
        for at in from..to {
            inside.add(series.reading_w[at], series.lo_w[at], series.hi_w[at]);
        }
        points.push([series.time_s[from] + STRETCH_S / 2.0, 100.0 * inside.coverage()]);
        from = to;
    }
    points
}

fn each(material: &Material<'_>, sets: &[Scores], nominal: f64) -> Panel {
    let models = 0..material.models();
    let mut layers = vec![
        Layer::plain(Colour::Grey, Mark::Stripe([nominal - 2.0, nominal + 2.0])),
        Layer::named(
            "asked for",
            Colour::Grey,
            Mark::Rule { at: nominal, direction: Direction::Up },
        ),
    ];
    layers.extend(models.map(|model| {
        let values = sets.iter().map(|set| {
            let score = set.forecasters.get(model).and_then(|score| score.interval);
            score.map_or(Interval::exact(f64::NAN), |score| Interval {
                value: 100.0 * score.inside.value,
                low: 100.0 * score.inside.lo,
                high: 100.0 * score.inside.hi,
            })
        });
        let mark = Mark::Dots {
            values: values.collect(),
            slot: [model, material.models()],
            direction: Direction::Across,
        };
        let name = material.scored.report.all.forecasters[model].name.clone();
        Layer::named(name, material.colour(model), mark)
    }));
    Panel {
        title: "individually".to_owned(),
        x: Axis::new("readings inside (%)"),
        y: Axis::names("", sets.iter().map(|set| label(&set.name)).collect()),
        layers,
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

    #[test]
    fn coverage_over_time_counts_each_window_separately() {
        let count = 600;
        let series = Series {
            time_s: (0..count).map(|at| f64::from(at) / 30.0).collect(),
            reading_w: (0..count).map(|at| if at < 300 { 1.0 } else { 5.0 }).collect(),
            forecast_w: vec![1.0; 600],
            lo_w: vec![0.0; 600],
            hi_w: vec![2.0; 600],
        };
        let points = over_time(&series);
        assert_eq!(points, [[5.0, 100.0], [15.0, 0.0]]);
    }
}
