//! Figures 3 and 4: one trial, forecast against reading, and over time.

use super::document::{Cell, Column, Part, Section, Table};
use super::figure::{Axis, Colour, Direction, Figure, Layer, Mark, Panel};
use super::material::{Material, label};
use super::paper;
use joulebus_eval::evaluate::Series;
use joulebus_statistics::metrics::{ResidualQuantiles, quantile, sorted, tally};

const TILES: usize = 60;
const BINS: usize = 80;
/// Duration of the detailed view, s.
const WINDOW_S: f64 = 20.0;

/// The section of the trial of this name. `None` if it has no forecast.
pub(super) fn section(material: &Material<'_>, trial: &str) -> Option<Section> {
    let series = material.series(trial).filter(|series| series.len() > 1)?;
    let name = label(trial);
    Some(Section {
        id: "forecast".to_owned(),
        title: format!("One recording: {name}"),
        parts: vec![
            Part::Words(format!(
                "Forecasts of {} one tick ahead, each based on real readings (corrected mode), \
                 in {name}.",
                material.model()
            )),
            Part::Figure(against(material, &series, &name)),
            Part::Table(residuals(material, &series, &name)),
            Part::Figure(over_time(material, &series, &name)),
        ],
    })
}

fn against(material: &Material<'_>, series: &Series, name: &str) -> Figure {
    let unit = material.unit;
    let pairs = || {
        let pairs = series.forecast_w.iter().zip(&series.reading_w);
        pairs.map(|(forecast_w, reading_w)| [unit.scaled_w(*forecast_w), unit.scaled_w(*reading_w)])
    };
    let both = sorted(pairs().flatten());
    let ends = [quantile(&both, 0.0005), quantile(&both, 0.9995)];
    let cloud = Panel {
        title: "forecast and reading".to_owned(),
        x: Axis::new(format!("forecast ({})", unit.name())).within(ends[0], ends[1]),
        y: Axis::new(format!("reading ({})", unit.name())).within(ends[0], ends[1]),
        layers: vec![
            Layer::named("rows, darker: more", Colour::Blue, Mark::tiles(pairs(), ends, TILES)),
            Layer::named("equal", Colour::Grey, Mark::Diagonal),
        ],
    };
    let mut figure = Figure::new(
        "figure-3-forecast",
        "Figure 3. Forecast against reading.",
        format!(
            "{name}. Left: readings over the forecasts made for them. On the dashed line both \
             are equal. Right: distribution of reading minus forecast, with its central 90 %."
        ),
        vec![cloud, residual_panel(material, series)],
    );
    figure.panel_height_px = 320;
    material.noted(figure)
}

fn residual_panel(material: &Material<'_>, series: &Series) -> Panel {
    let unit = material.unit;
    let residuals = sorted(series.residuals_w().map(|residual_w| unit.scaled_w(residual_w)));
    let middle = [quantile(&residuals, 0.05), quantile(&residuals, 0.95)];
    let ends = [quantile(&residuals, 0.005), quantile(&residuals, 0.995)];
    let density = Mark::density(residuals.iter().copied(), ends, BINS);
    let mut layers = vec![
        Layer::named("90 % of residuals", Colour::Sky, Mark::Stripe(middle)),
        Layer::named("residuals", Colour::Blue, density),
    ];
    if material.beside_paper {
        for (at, end_w) in paper::RESIDUAL_90_W.into_iter().enumerate() {
            let mark = Mark::Rule { at: unit.scaled_w(end_w), direction: Direction::Up };
            let label = (at == 0).then(|| "the paper's 90 %".to_owned());
            layers.push(Layer { label, colour: Colour::Vermilion, mark });
        }
    }
    Panel {
        title: "residuals".to_owned(),
        x: Axis::new(format!("reading − forecast ({})", unit.name())),
        y: Axis::new(format!("density (1/{})", unit.name())),
        layers,
    }
}

fn over_time(material: &Material<'_>, series: &Series, name: &str) -> Figure {
    let unit = material.unit;
    let residuals: Vec<[f64; 2]> = series
        .time_s
        .iter()
        .zip(series.residuals_w())
        .map(|(time_s, residual_w)| [*time_s, unit.scaled_w(residual_w)])
        .collect();
    let steps = sorted(series.time_s.windows(2).map(|pair| pair[1] - pair[0]));
    let energy_j = series.energy_j(1.5 * quantile(&steps, 0.5));
    let curve = |of: fn(&[f64; 2]) -> f64| -> Vec<[f64; 2]> {
        let pairs = series.time_s.iter().zip(&energy_j);
        pairs.map(|(time_s, energy_j)| [*time_s, of(energy_j)]).collect()
    };
    let line = |points, dashed| Mark::Line { points, dashed };
    let zero = || Layer::plain(Colour::Grey, Mark::Rule { at: 0.0, direction: Direction::Across });
    let panel = |title: &str, y: String, layers| Panel {
        title: title.to_owned(),
        x: Axis::new("time (s)"),
        y: Axis::new(y),
        layers,
    };
    // At first the measured energy is small, and the relative error large and meaningless.
    let mut error = curve(|[measured, forecast]| 100.0 * (forecast - measured) / measured);
    let error = error.split_off(error.len() / 20);
    let figure = Figure::new(
        "figure-4-time",
        "Figure 4. One recording over time.",
        format!(
            "{name}. (a) {WINDOW_S:.0} s from its middle, with the live interval. (b) Reading \
             minus forecast over the whole recording. (c) Energy since the beginning, as measured and \
             as forecast. (d) Their difference."
        ),
        vec![
            window(material, series),
            panel(
                "residuals",
                format!("reading − forecast ({})", unit.name()),
                vec![zero(), Layer::plain(Colour::Blue, line(residuals, false))],
            ),
            panel(
                "energy",
                "energy (J)".to_owned(),
                vec![
                    Layer::named("measured", Colour::Ink, line(curve(|sums| sums[0]), false)),
                    Layer::named("forecast", Colour::Orange, line(curve(|sums| sums[1]), true)),
                ],
            ),
            panel(
                "error of the energy",
                "forecast − measured (%)".to_owned(),
                vec![zero(), Layer::plain(Colour::Blue, line(error, false))],
            ),
        ],
    );
    material.noted(figure)
}

/// A few seconds from the middle, where single ticks are visible.
fn window(material: &Material<'_>, series: &Series) -> Panel {
    let unit = material.unit;
    let middle_s = series.time_s[series.len() / 2];
    let from = series.time_s.partition_point(|time_s| *time_s < middle_s - WINDOW_S / 2.0);
    let to = series.time_s.partition_point(|time_s| *time_s <= middle_s + WINDOW_S / 2.0);
    let curve = |values_w: &[f64]| Mark::Line {
        points: (from..to).map(|at| [series.time_s[at], unit.scaled_w(values_w[at])]).collect(),
        dashed: false,
    };
    let band = (from..to).map(|at| {
        [series.time_s[at], unit.scaled_w(series.lo_w[at]), unit.scaled_w(series.hi_w[at])]
    });
    Panel {
        title: "forecast and reading".to_owned(),
        x: Axis::new("time (s)"),
        y: Axis::new(format!("power ({})", unit.name())),
        layers: vec![
            Layer::named("live interval", Colour::Blue, Mark::Band(band.collect())),
            Layer::named("reading", Colour::Ink, curve(&series.reading_w)),
            Layer::named("forecast", Colour::Orange, curve(&series.forecast_w)),
        ],
    }
}

/// Numbers of figure 3.
fn residuals(material: &Material<'_>, series: &Series, name: &str) -> Table {
    let unit = material.unit;
    let found = tally(&series.reading_w, &series.forecast_w, f64::NAN);
    let quantiles = ResidualQuantiles::new(series.residuals_w());
    let with = material.beside_paper;
    let mut rows = Vec::new();
    let mut row = |what: &str, here: Cell, paper: Option<Cell>| {
        let mut cells = vec![Cell::words(what), here];
        if with {
            cells.push(paper.unwrap_or(Cell::Nothing));
        }
        rows.push(cells);
    };
    row("R²", Cell::Number(found.r2(), 3), Some(Cell::Number(paper::R2_TRIAL_6, 2)));
    let power = |name: &str| format!("{name} ({})", unit.name());
    row(&power("MAE"), unit.cell(found.mae_w(), true), Some(unit.cell(paper::MAE_TRIAL_6_W, true)));
    row(&power("RMSE"), unit.cell(found.rmse_w(), true), None);
    row(
        &power("mean of reading − forecast"),
        unit.cell(found.bias_w(), true),
        Some(unit.cell(paper::RESIDUAL_MEAN_W, true)),
    );
    row(
        &power("90 % of the residuals, from 5 % to 95 %"),
        unit.range([quantiles.q05_w, quantiles.q95_w], true),
        Some(unit.range(paper::RESIDUAL_90_W, false)),
    );
    row(
        &power("least and greatest residual"),
        unit.range([quantiles.min_w, quantiles.max_w], true),
        None,
    );
    let mut columns = vec![Column::new("quantity", "quantity"), Column::new("here", "here")];
    if with {
        columns.push(Column::new("paper", "paper, trial 6"));
    }
    Table {
        id: "table-residuals".to_owned(),
        caption: format!("Forecasts of {} in {name}.", material.model()),
        columns,
        rows,
        folded: false,
    }
}
