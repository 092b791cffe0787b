//! Figure 6: accuracy by horizon in open loop.

use super::document::{Cell, Column, Part, Section, Table};
use super::figure::{Axis, Colour, Direction, Figure, Layer, Mark, Panel};
use super::material::{Material, scaled};
use joulebus_eval::score::{Horizon, HorizonScore};
use joulebus_statistics::bootstrap::Estimate;

/// The section. `None` if no horizon was evaluated.
pub(super) fn section(material: &Material<'_>) -> Option<Section> {
    let horizons = material.scored.report.open_loop.horizons.as_slice();
    if horizons.is_empty() {
        return None;
    }
    Some(Section {
        id: "horizons".to_owned(),
        title: "Longer horizons: open loop".to_owned(),
        parts: vec![
            Part::Words(format!(
                "Starting every {} rows (at shorter horizons, every as many rows as the horizon has ticks), each \
                 forecaster is fed with its own forecasts and the true commands. The paper \
                 evaluates one tick ahead. A planner needs the whole curve.",
                material.scored.report.origins_every
            )),
            Part::Figure(figure(material, horizons)),
            Part::Table(table(material, horizons)),
        ],
    })
}

fn figure(material: &Material<'_>, horizons: &[Horizon]) -> Figure {
    let unit = material.unit;
    let period_ms = 1e3 * material.scored.report.period_s;
    let panel = |title: &str, y: Axis, layers: Vec<Layer>| Panel {
        title: title.to_owned(),
        x: Axis::log(format!("horizon (ticks of {period_ms:.0} ms)")),
        y,
        layers,
    };
    let mut r2 = curves(material, horizons, |score| score.r2, |value| value);
    r2.push(Layer::plain(Colour::Grey, Mark::Rule { at: 0.0, direction: Direction::Across }));
    let mae = curves(material, horizons, |score| score.mae_w, |value_w| unit.scaled_w(value_w));
    let energy = curves(
        material,
        horizons,
        |score| Estimate::alone(score.energy_mape),
        |share| 100.0 * share,
    );
    let skill = curves(material, horizons, against_persistence, |value| value);
    let mut figure = Figure::new(
        "figure-6-horizons",
        "Figure 6. Open loop.",
        "By horizon: (a) coefficient of determination, (b) mean absolute error of the power, (c) \
         mean absolute error of the energy up to the horizon, (d) skill: one minus the squared \
         error over that of persistence. Above 0 is better than repeating the last reading.",
        vec![
            panel("coefficient of determination", Axis::new("R²"), r2),
            panel("error", Axis::new(format!("MAE ({})", unit.name())).including(0.0), mae),
            panel("error of the energy", Axis::new("mean |error| (%)").including(0.0), energy),
            panel("skill against persistence", Axis::new("skill").including(0.0), skill),
        ],
    );
    figure.panel_height_px = 240;
    material.noted(figure)
}

fn against_persistence(score: &HorizonScore) -> Estimate {
    let against = score.skill.iter().find(|skill| skill.against == "persistence");
    against.map_or(Estimate::alone(f64::NAN), |skill| skill.skill)
}

/// A line with its band for each forecaster shown.
fn curves(
    material: &Material<'_>,
    horizons: &[Horizon],
    of: impl Fn(&HorizonScore) -> Estimate,
    scale: impl Fn(f64) -> f64 + Copy,
) -> Vec<Layer> {
    let mut layers = Vec::new();
    for (at, name) in material.compared() {
        let values = horizons.iter().filter_map(|horizon| {
            let score = horizon.forecasters.get(at)?;
            Some((horizon.ticks as f64, scaled(of(score), scale)))
        });
        let values: Vec<_> = values.collect();
        if values.iter().all(|(_, interval)| interval.value.is_nan()) {
            continue;
        }
        let band = values.iter().map(|(ticks, interval)| [*ticks, interval.low, interval.high]);
        let points = values.iter().map(|(ticks, interval)| [*ticks, interval.value]);
        let points: Vec<[f64; 2]> = points.collect();
        let colour = material.colour(at);
        layers.push(Layer::plain(colour, Mark::Band(band.collect())));
        layers.push(Layer::plain(colour, Mark::Points(points.clone())));
        let dashed = at >= material.models();
        layers.push(Layer::named(name, colour, Mark::Line { points, dashed }));
    }
    layers
}

fn table(material: &Material<'_>, horizons: &[Horizon]) -> Table {
    let unit = material.unit;
    let mut rows = Vec::new();
    for horizon in horizons {
        for (at, _) in material.compared() {
            let Some(score) = horizon.forecasters.get(at) else {
                continue;
            };
            let skill = against_persistence(score);
            rows.push(vec![
                Cell::Count(horizon.ticks as u64),
                Cell::Number(horizon.seconds, 2),
                Cell::words(&score.name),
                Cell::Count(horizon.origins),
                Cell::Number(score.r2.value, 3),
                Cell::Range([score.r2.lo, score.r2.hi], 3),
                unit.cell(score.mae_w.value, true),
                Cell::Number(100.0 * score.energy_mape, 2),
                Cell::Number(100.0 * score.energy_error.value, 2),
                if skill.value.is_nan() { Cell::Nothing } else { Cell::Number(skill.value, 3) },
            ]);
        }
    }
    Table {
        id: "table-horizons".to_owned(),
        caption: format!(
            "Open loop by horizon: the numbers of figure 6. Rollouts overlap, so intervals resample whole \
             trials, and need {} of them.",
            joulebus_statistics::bootstrap::MIN_BLOCKS
        ),
        columns: vec![
            Column::new("ticks", "ticks"),
            Column::new("seconds", "seconds"),
            Column::new("forecaster", "forecaster"),
            Column::new("origins", "rollouts"),
            Column::new("r2", "R²"),
            Column::new("r2_interval", "R², 95 % interval"),
            unit.column("mae", "MAE"),
            Column::new("energy_mean_abs_error_percent", "mean |energy error| (%)"),
            Column::new("energy_error_percent", "energy error (%)"),
            Column::new("skill", "skill against persistence"),
        ],
        rows,
        folded: true,
    }
}
