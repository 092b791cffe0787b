//! Figure 5: one model on different robots, groups or trials.

use super::document::{Part, Section};
use super::figure::{Axis, Categories, Colour, Figure, Interval, Layer, Mark, Panel};
use super::material::{Material, interval, label, scaled};
use super::{paper, scores};
use joulebus_eval::score::{Cell as Scores, ForecasterScore};

/// Maximum number of names in a figure.
const MAX_SETS: usize = 24;

/// Kind of the sets of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Grouping {
    Robots,
    Groups,
    Trials,
}

impl Grouping {
    const fn plural(self) -> &'static str {
        match self {
            Self::Robots => "robots",
            Self::Groups => "groups",
            Self::Trials => "trials",
        }
    }
}

/// The best sets for comparison: groups of trials, else robots, else trials. `None` for a single
/// recording.
pub(super) fn chosen<'a>(material: &Material<'a>) -> Option<(Grouping, &'a [Scores])> {
    let report = &material.scored.report;
    let sets = [
        (Grouping::Groups, &report.groups),
        (Grouping::Robots, &report.robots),
        (Grouping::Trials, &report.trials),
    ];
    let readable = sets.iter().find(|(_, sets)| (2..=MAX_SETS).contains(&sets.len()));
    let any = readable.or_else(|| sets.iter().find(|(_, sets)| sets.len() > 1));
    any.map(|(kind, sets)| (*kind, sets.as_slice()))
}

pub(super) fn section(material: &Material<'_>, kind: Grouping, sets: &[Scores]) -> Section {
    let shown = &sets[..sets.len().min(MAX_SETS)];
    let what = kind.plural();
    let left_out = if shown.len() < sets.len() {
        format!(" The figure shows the first {MAX_SETS} of {}. The table has all.", sets.len())
    } else {
        String::new()
    };
    let all: Vec<&Scores> = sets.iter().collect();
    let mut table = scores::table(
        material,
        &format!("table-{what}"),
        &format!("Corrected mode, one tick ahead, by {what}."),
        &all,
    );
    table.folded = sets.len() > 12;
    Section {
        id: what.to_owned(),
        title: format!("Generalisation across {what}"),
        parts: vec![
            Part::Words(format!("Forecasts one tick ahead by {what}, on the same rows.{left_out}")),
            Part::Figure(figure(material, kind, shown)),
            Part::Table(table),
        ],
    }
}

fn figure(material: &Material<'_>, kind: Grouping, sets: &[Scores]) -> Figure {
    let what = kind.plural();
    let names: Vec<String> = sets.iter().map(|set| label(&set.name)).collect();
    let axis = || Axis::names(names.clone());
    let unit = material.unit;
    let models = 0..material.models();
    let energy = models.map(|model| {
        let values =
            scores_of(sets, model).map(|score| scaled(score.energy_error, |share| 100.0 * share));
        let slot = [model, material.models()];
        let bars = Mark::Bars(Categories { values: values.collect(), slot });
        let name = material.scored.report.all.forecasters[model].name.clone();
        Layer::named(name, material.colour(model), bars)
    });
    let mae = dots(material, sets, |score| scaled(score.mae_w, |value_w| unit.scaled_w(value_w)));
    let panel = |title: &str, x: String, layers: Vec<Layer>| Panel {
        title: title.to_owned(),
        x: Axis::new(x),
        y: axis(),
        layers,
    };
    let mut r2 = dots(material, sets, |score| interval(score.r2));
    if material.beside_paper && kind == Grouping::Robots {
        let [mean, std] = paper::R2_ROBOTS;
        let stripe = Mark::Stripe([mean - std, mean + std]);
        r2.insert(0, Layer::named("the paper's mean ± one deviation", Colour::Vermilion, stripe));
    }
    let mut panels = vec![
        panel("coefficient of determination", "R²".to_owned(), r2),
        panel("error", format!("MAE ({})", unit.name()), mae),
        panel("error of the energy", "forecast − measured (%)".to_owned(), energy.collect()),
    ];
    panels.push(draw_panel(material, sets, axis()));
    let mut figure = Figure::new(
        format!("figure-5-{what}"),
        format!("Figure 5. By {what}."),
        format!(
            "By {what}, with 95 % intervals: (a) coefficient of determination and (b) mean absolute \
             error of each forecaster, (c) error of the model's forecast energy, (d) mean power."
        ),
        panels,
    );
    figure.panel_height_px = (110 + 34 * sets.len() as u32).clamp(200, 900);
    material.noted(figure)
}

fn scores_of(sets: &[Scores], forecaster: usize) -> impl Iterator<Item = &ForecasterScore> {
    sets.iter().filter_map(move |set| set.forecasters.get(forecaster))
}

fn dots(
    material: &Material<'_>,
    sets: &[Scores],
    value: impl Fn(&ForecasterScore) -> Interval,
) -> Vec<Layer> {
    let compared = material.compared();
    let count = compared.len();
    let each = compared.into_iter().enumerate();
    each.map(|(slot, (at, name))| {
        let values = scores_of(sets, at).map(&value).collect();
        let mark = Mark::Dots(Categories { values, slot: [slot, count] });
        Layer::named(name, material.colour(at), mark)
    })
    .collect()
}

/// Mean power with its standard deviation.
fn draw_panel(material: &Material<'_>, sets: &[Scores], names: Axis) -> Panel {
    let unit = material.unit;
    let values = sets.iter().map(|set| {
        let [value, low, high] = [0.0, -1.0, 1.0]
            .map(|deviations| unit.scaled_w(set.reading_mean_w + deviations * set.reading_std_w));
        Interval { value, low, high }
    });
    let mark = Mark::Dots(Categories { values: values.collect(), slot: [0, 1] });
    Panel {
        title: "power drawn".to_owned(),
        x: Axis::new(format!("power ({})", unit.name())),
        y: names,
        layers: vec![Layer::named("mean ± one standard deviation", Colour::Ink, mark)],
    }
}
