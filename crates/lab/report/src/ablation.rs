//! Figure 2: the gain of each kind of input.

use super::document::{Cell, Column, Part, Section, Table};
use super::figure::{Axis, Categories, Colour, Figure, Interval, Layer, Mark, Panel};
use super::material::{Material, interval, scaled};
use super::paper;
use joulebus_eval::score::ForecasterScore;

/// The section: from velocities alone to the network.
pub(super) fn section(material: &Material<'_>) -> Section {
    let steps = steps(material);
    Section {
        id: "ablation".to_owned(),
        title: "Ablation: which features a forecast needs".to_owned(),
        parts: vec![
            Part::Words(format!(
                "Linear models with an increasing number of past readings, and the network, on the \
                 same rows ({}). Persistence shows what the last reading alone is worth.",
                material.scored.report.design.description
            )),
            Part::Figure(figure(material, &steps)),
            Part::Table(table(material, &steps)),
        ],
    }
}

/// Forecasters in order of increasing inputs.
fn steps<'a>(material: &Material<'a>) -> Vec<&'a ForecasterScore> {
    let forecasters = &material.scored.report.all.forecasters;
    let models = material.models().min(forecasters.len());
    let (networks, others) = forecasters.split_at(models);
    let persistence = others.iter().take(1);
    let mut lines: Vec<&ForecasterScore> = others.iter().skip(1).collect();
    // The model of velocities alone uses no readings.
    let first = lines.drain(..1.min(lines.len())).collect::<Vec<_>>();
    first.into_iter().chain(persistence).chain(lines).chain(networks).collect()
}

fn papers(score: &ForecasterScore) -> f64 {
    match score.name.as_str() {
        "velocities" => paper::R2_VELOCITIES,
        "velocities + 1 lag" => paper::R2_ONE_LAG,
        _ => f64::NAN,
    }
}

fn figure(material: &Material<'_>, steps: &[&ForecasterScore]) -> Figure {
    let names: Vec<String> = steps.iter().map(|score| score.name.clone()).collect();
    let bars = |values: Vec<Interval>| Mark::Bars(Categories { values, slot: [0, 1] });
    let r2 = steps.iter().map(|score| interval(score.r2)).collect();
    let unit = material.unit;
    let mae = steps.iter().map(|score| scaled(score.mae_w, |value_w| unit.scaled_w(value_w)));
    let mut layers = vec![Layer::named("here, with 95 % interval", Colour::Blue, bars(r2))];
    if material.beside_paper {
        let values = steps.iter().map(|score| Interval::exact(papers(score))).collect();
        let dots = Mark::Dots(Categories { values, slot: [0, 1] });
        layers.push(Layer::named("paper", Colour::Vermilion, dots));
    }
    let panel = |title: &str, x: Axis, layers: Vec<Layer>| Panel {
        title: title.to_owned(),
        x,
        y: Axis::names(names.clone()),
        layers,
    };
    material.noted(Figure::new(
        "figure-2-ablation",
        "Figure 2. Ablation of the features.",
        "Coefficient of determination and mean absolute error of linear models with more and more \
         past readings, of persistence and of the network.",
        vec![
            panel("coefficient of determination", Axis::new("R²"), layers),
            panel(
                "error",
                Axis::new(format!("MAE ({})", unit.name())),
                vec![Layer::named("here", Colour::Blue, bars(mae.collect()))],
            ),
        ],
    ))
}

fn table(material: &Material<'_>, steps: &[&ForecasterScore]) -> Table {
    let unit = material.unit;
    let row = |score: &&ForecasterScore| {
        let mut row = vec![
            Cell::words(&score.name),
            Cell::Count(score.count),
            Cell::Number(score.r2.value, 3),
            Cell::Range([score.r2.lo, score.r2.hi], 3),
            unit.cell(score.mae_w.value, true),
        ];
        if material.beside_paper {
            let papers = papers(score);
            row.push(if papers.is_nan() { Cell::Nothing } else { Cell::Number(papers, 2) });
        }
        row
    };
    let mut columns = vec![
        Column::new("forecaster", "forecaster"),
        Column::new("rows", "rows"),
        Column::new("r2", "R²"),
        Column::new("r2_interval", "R², 95 % interval"),
        unit.column("mae", "MAE"),
    ];
    if material.beside_paper {
        columns.push(Column::new("paper_r2", "R² in the paper"));
    }
    Table {
        id: "table-ablation".to_owned(),
        caption: "Ablation of the features: the numbers of figure 2.".to_owned(),
        columns,
        rows: steps.iter().map(row).collect(),
        folded: false,
    }
}
