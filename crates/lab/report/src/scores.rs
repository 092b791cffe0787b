//! Tables of scores by forecaster and set of recordings.

use super::document::{Cell, Column, Table};
use super::material::{Material, label, skill_against_persistence};
use joulebus_eval::score::{Cell as Scores, ForecasterScore, IntervalScore};

/// One row for each set of recordings and each forecaster shown.
pub(super) fn table(material: &Material<'_>, id: &str, caption: &str, sets: &[&Scores]) -> Table {
    let unit = material.unit;
    let columns = vec![
        Column::new("recordings", "recordings"),
        Column::new("forecaster", "forecaster"),
        Column::new("rows", "rows"),
        Column::new("r2", "R²"),
        Column::new("r2_interval", "R², 95 % interval"),
        unit.column("mae", "MAE"),
        unit.column("rmse", "RMSE"),
        unit.column("bias", "bias"),
        Column::new("energy_error_percent", "energy error (%)"),
        Column::new("skill", "skill against persistence"),
        Column::new("coverage_percent", "inside interval (%)"),
        unit.column("interval_score", "interval score"),
        unit.column("hindsight_interval_score", "the same, best constant interval afterwards"),
    ];
    let rows = sets.iter().flat_map(|set| {
        let listed = material.listed().into_iter();
        listed.filter_map(|at| Some(row(material, set, set.forecasters.get(at)?)))
    });
    Table {
        id: id.to_owned(),
        caption: caption.to_owned(),
        columns,
        rows: rows.collect(),
        folded: false,
    }
}

fn row(material: &Material<'_>, set: &Scores, score: &ForecasterScore) -> Vec<Cell> {
    let unit = material.unit;
    let skill = skill_against_persistence(score);
    let interval = score.interval.as_ref();
    let of_interval = |cell: &dyn Fn(&IntervalScore) -> Cell| interval.map_or(Cell::Nothing, cell);
    vec![
        Cell::words(label(&set.name)),
        Cell::words(&score.name),
        Cell::Count(score.count),
        Cell::Number(score.r2.value, 3),
        Cell::Range([score.r2.lo, score.r2.hi], 3),
        unit.cell(score.mae_w.value, true),
        unit.cell(score.rmse_w.value, true),
        unit.cell(score.bias_w.value, true),
        Cell::Number(100.0 * score.energy_error.value, 3),
        if skill.value.is_nan() { Cell::Nothing } else { Cell::Number(skill.value, 3) },
        of_interval(&|interval| Cell::Number(100.0 * interval.scores.coverage, 1)),
        of_interval(&|interval| unit.cell(interval.scores.score_w, true)),
        unit.cell(score.hindsight.score_w, true),
    ]
}
