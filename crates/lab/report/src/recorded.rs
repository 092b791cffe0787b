//! A report on recordings.

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};

use super::document::{Cell, Column, Document, Part, Section, Table};
use super::material::{BASELINES, Material};
use super::robots::Grouping;
use super::unit::Unit;
use super::usage::Usage;
use super::{ReportError, ablation, forecast, power, robots, scores};
use joulebus_dataset::trial::TrialError;
use joulebus_eval::score::{
    Design, Options, Recording, Reference, ScoreError, Scored, ScoredRows, Subject, score,
};

/// Inputs of a report on recordings.
#[derive(Debug, Clone)]
pub struct Recorded<'a> {
    /// Ingest and intervals of the live path. Its platforms are ignored.
    pub settings: &'a FleetSettings,
    /// The platform. `None` takes period and limits from each recording.
    pub platform: Option<&'a Platform>,
    /// The models. The first is shown in every figure. Without one, the report is on what the
    /// recordings say by themselves.
    pub models: &'a [Model],
    /// The evaluated recordings.
    pub recordings: &'a [Recording],
    /// The rows that are evaluated, and those that the baselines are fitted on. Those that a model
    /// was trained on are scored apart.
    pub design: &'a Design,
    /// Forecasters to compare with, beside persistence and the linear baselines.
    pub references: Vec<Reference>,
    /// Energy of a battery from full to empty, Wh. `None`: the platform's.
    pub battery_wh: Option<f64>,
}

/// Evaluates the models on the recordings and makes the report.
///
/// # Errors
/// [`ReportError`]: nothing to evaluate, or settings that are refused.
pub fn recorded(what: &Recorded<'_>) -> Result<Document, ReportError> {
    let Recorded { settings, platform, models, recordings, ref references, .. } = *what;
    // Every section needs them.
    let loaded: Result<Vec<Recording>, TrialError> =
        recordings.iter().map(Recording::loaded).collect();
    let recordings = loaded.map_err(ScoreError::from)?;
    let recordings = recordings.as_slice();
    if recordings.is_empty() {
        return Err(ScoreError::NoRecording.into());
    }
    let usage = Usage::new(recordings, platform, what.battery_wh);
    if models.is_empty() {
        return Ok(Document {
            title: format!("Energy in {} recordings", recordings.len()),
            warning: None,
            summary: usage.summary(),
            sections: vec![usage.section()],
        });
    }
    let design = what.design.clone().hold_apart(recordings, models)?;
    let subject = Subject { settings, platform, models, recordings, design: &design };
    let options = Options { references: references.clone(), ..options() };
    let scored = score(subject, &options)?;
    let indexed = recordings.iter().enumerate();
    let evaluated =
        indexed.filter(|(at, _)| design.evaluated(*at).any(|(_, rows)| !rows.is_empty()));
    let evaluated: Vec<Recording> = evaluated.map(|(_, recording)| recording.clone()).collect();
    let recordings = evaluated.as_slice();
    let warnings = scored.report.warnings.iter().cloned();
    let warnings: Vec<String> = simulation(models).into_iter().chain(warnings).collect();
    let seen = match scored.report.scored_rows {
        ScoredRows::TrainedOn | ScoredRows::Mixed => Some("trained on these rows".to_owned()),
        ScoredRows::NotTrainedOn | ScoredRows::NoneRecognised | ScoredRows::Unknown => None,
    };
    let notes: Vec<String> = simulation(models).into_iter().chain(seen).collect();
    let note = (!notes.is_empty()).then(|| notes.join("; "));
    let material = Material {
        recordings,
        scored: &scored,
        unit: Unit::new(scored.report.all.reading_mean_w),
        note: note.as_deref(),
        beside_paper: false,
    };
    let trial = longest(recordings);
    let mut sections = vec![
        usage.section(),
        inputs(&material),
        power::section(&material),
        ablation::section(&material),
    ];
    sections.extend(forecast::section(&material, &trial));
    let chosen = robots::chosen(&material);
    sections.extend(chosen.map(|(kind, sets)| robots::section(&material, kind, sets)));
    sections.push(all_scores(&material, chosen.map(|(kind, _)| kind)));
    let trials = recordings.len();
    Ok(Document {
        title: format!("Power forecasts of {}, on {trials} recordings", material.model()),
        warning: (!warnings.is_empty()).then(|| warnings.join("; ")),
        summary: usage.summary().into_iter().chain([verdict(&scored)]).collect(),
        sections,
    })
}

/// Options of the evaluations in reports.
pub(super) fn options() -> Options {
    Options { baselines: BASELINES.to_vec(), ..Options::default() }
}

/// The warning for models trained on simulated robots only.
fn simulation(models: &[Model]) -> Option<String> {
    let simulated = models.iter().filter(|model| match model {
        Model::Network(network) => network.card().source == "simulation",
        Model::Persistence(_) => false,
    });
    let names: Vec<&str> = simulated.map(Model::name).collect();
    (!names.is_empty()).then(|| {
        let names = names.join(", ");
        format!("trained on simulated robots: {names}")
    })
}

/// Name of the longest recording.
fn longest(recordings: &[Recording]) -> String {
    let longest = recordings.iter().rev().max_by_key(|recording| recording.rows());
    longest.map(|recording| recording.name.clone()).unwrap_or_default()
}

/// One sentence that compares the first model with the baselines.
pub(super) fn verdict(scored: &Scored) -> String {
    let all = &scored.report.all;
    let Some(first) = all.forecasters.first() else {
        return String::new();
    };
    let skills = first
        .skill
        .iter()
        .filter(|skill| skill.against == "persistence" || skill.against == "AR(5) + velocities");
    let skills: Vec<String> = skills
        .map(|skill| {
            let found = skill.skill;
            let value = Cell::Number(found.value, 3).shown();
            if !(found.lo.is_finite() && found.hi.is_finite()) {
                return format!(
                    "of skill {value} against {}, with too few blocks for an interval",
                    skill.against
                );
            }
            let word = if found.is_above(0.0) {
                "better than"
            } else if found.is_below(0.0) {
                "worse than"
            } else {
                "statistically indistinguishable from"
            };
            let [lo, hi] = [found.lo, found.hi].map(|skill| Cell::Number(skill, 3).shown());
            format!("{word} {} (skill {value}, 95 % interval {lo} to {hi})", skill.against)
        })
        .collect();
    let whose = match scored.report.scored_rows {
        ScoredRows::NotTrainedOn => " that no model was trained on".to_owned(),
        ScoredRows::NoneRecognised => {
            let (rows, untold) = (scored.report.design.rows, scored.report.untold_rows);
            format!(" (trained on: none recognised of {rows}; {untold} cannot be told)")
        }
        ScoredRows::TrainedOn => " that a model was trained on".to_owned(),
        ScoredRows::Mixed => ", on some of which a model was trained".to_owned(),
        ScoredRows::Unknown => String::new(),
    };
    format!(
        "On {} rows of {} trials{whose}, one tick ahead, {} reaches R² {:.3} and is {}.",
        all.rows,
        all.trials,
        first.name,
        first.r2.value,
        skills.join(", and ")
    )
}

/// The inputs of the evaluation.
fn inputs(material: &Material<'_>) -> Section {
    let report = &material.scored.report;
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    let mut row =
        |what: &str, value: String| rows.push(vec![Cell::words(what), Cell::Words(value)]);
    for model in &report.models {
        let data = model.training_data.as_deref().unwrap_or("nothing");
        row("model", format!("{} ({}), trained on: {data}", model.name, model.hash));
        let members = match model.members.as_slice() {
            [] => String::new(),
            members => format!(", learned for each robot from {}", members.join(", ")),
        };
        let trained_on = match &model.trained_on {
            Some(found) => {
                let known = match found.rows {
                    0 => format!("none recognised of {} rows here", found.of),
                    rows => {
                        let percent = 100.0 * found.share;
                        format!("{rows} of {} rows here ({percent:.1} %)", found.of)
                    }
                };
                match found.untold {
                    0 => known,
                    untold => format!("{known}; {untold} cannot be told"),
                }
            }
            None => "unknown: its file does not state its rows".to_owned(),
        };
        row("of which trained on", trained_on);
        row("forecast scored", format!("{}{members}", model.forecast));
    }
    row("platform", report.platform.clone());
    row("recordings", report.design.trials.to_string());
    row("rows evaluated", report.design.rows.to_string());
    row("rows scored apart", report.design.trained_on_rows.to_string());
    row("baselines", report.design.description.clone());
    row("period", format!("{:.1} ms", 1e3 * report.period_s));
    let bootstrap = report.bootstrap;
    row(
        "95 % intervals",
        format!(
            "block bootstrap, {} draws, seed {}; blocks of {} rows, or whole trials from {} trials on",
            bootstrap.resamples, bootstrap.seed, bootstrap.block_rows, bootstrap.trials_from
        ),
    );
    Section {
        id: "inputs".to_owned(),
        title: "What was evaluated".to_owned(),
        parts: vec![Part::Table(Table {
            id: "table-inputs".to_owned(),
            caption: "Models, recordings and method.".to_owned(),
            columns: vec![Column::new("what", "what"), Column::new("value", "value")],
            rows,
            folded: false,
        })],
    }
}

/// Every table not shown in an earlier section.
pub(super) fn all_scores(material: &Material<'_>, shown: Option<Grouping>) -> Section {
    let report = &material.scored.report;
    let mut parts = vec![Part::Table(scores::table(
        material,
        "table-all",
        "All recordings together, one tick ahead.",
        &[&report.all],
    ))];
    if let Some(apart) = &report.trained_on {
        parts.push(Part::Table(scores::table(
            material,
            "table-trained-on",
            "Rows that a model was trained on, one tick ahead: no measure of other recordings.",
            &[apart],
        )));
    }
    let sets = [
        (Grouping::Groups, "group", &report.groups),
        (Grouping::Robots, "robot", &report.robots),
        (Grouping::Trials, "trial", &report.trials),
    ];
    for (kind, word, sets) in sets {
        if sets.is_empty() || shown == Some(kind) {
            continue;
        }
        let sets: Vec<_> = sets.iter().collect();
        let caption = format!("By {word}, one tick ahead.");
        let mut table = scores::table(material, &format!("table-by-{word}"), &caption, &sets);
        table.folded = true;
        parts.push(Part::Table(table));
    }
    Section { id: "scores".to_owned(), title: "All scores".to_owned(), parts }
}

#[cfg(test)]
mod tests {
    use super::super::material::label;

    #[test]
    fn trials_are_labelled_by_what_distinguishes_them() {
        for (name, called) in [
            ("simulated/energy_data_trial6_steady_state.npy", "trial6 steady state"),
            ("recordings/ICE_03.csv.gz", "ICE 03"),
            ("all", "all"),
            ("7", "robot 7"),
            ("captures/run.mcap 25", "run robot 25"),
            ("", ""),
        ] {
            assert_eq!(label(name), called);
        }
    }
}
