//! Reports: self-contained, the same numbers in every format, and marked as simulated where they
//! are.

use std::collections::HashSet;
use std::ops::ControlFlow;
use std::sync::OnceLock;

use joulebus_eval::score::{Design, Recording, Reference};
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::Protocol;
use joulebus_predictor::Model;
use joulebus_report::{
    Cell, Column, Document, File, Part, Recorded, ReportError, Section, Simulated, SimulatedReport,
    Table, files, html, recorded, simulated,
};
use joulebus_settings::FleetSettings;
use joulebus_sim::protocol::drive_with;
use serde_json::Value;

use super::live::settings;

fn experiment() -> Simulated {
    let mut experiment = Simulated::new(3);
    experiment.draws = 3;
    (experiment.samples, experiment.robot_steps) = (900, 700);
    experiment.recipe.max_epochs = 3;
    experiment
}

fn run(experiment: &Simulated) -> Result<SimulatedReport, ReportError> {
    simulated(experiment, &settings(), |_, _| ControlFlow::Continue(()))
}

/// Made once and shared by all tests.
fn made() -> &'static SimulatedReport {
    static MADE: OnceLock<SimulatedReport> = OnceLock::new();
    MADE.get_or_init(|| run(&experiment()).unwrap())
}

fn written() -> &'static [File] {
    static WRITTEN: OnceLock<[File; 3]> = OnceLock::new();
    WRITTEN.get_or_init(|| files(&made().document).unwrap())
}

fn text(path: &str) -> String {
    written().iter().find(|file| file.name == path).unwrap().text.clone()
}

/// The tables of a report's JSON, in order.
fn tables(json: &Value) -> Vec<&Value> {
    let sections = json["sections"].as_array().unwrap().iter();
    let parts = sections.flat_map(|section| section["parts"].as_array().unwrap());
    parts.filter_map(|part| part.get("table")).collect()
}

#[test]
fn the_page_needs_no_other_file() {
    let whole = text("report.html");
    // The library names where it comes from.
    let page = whole.replace("/*! https://github.com/leeoniya/uPlot", "");
    for outside in ["http", "src=", "url(", "@import", "<link", "import(", "fetch("] {
        assert!(!page.contains(outside), "{outside}");
    }
    let named = page.split(" id=\"").skip(1);
    let ids: Vec<&str> = named.map(|rest| rest.split('"').next().unwrap()).collect();
    let different: HashSet<&str> = ids.iter().copied().collect();
    assert_eq!(ids.len(), different.len(), "an id occurs twice: {ids:?}");
    let (body, _) = page.split_once("<script").unwrap();
    for rest in body.split("href=\"").skip(1) {
        let target = rest.split('"').next().unwrap();
        let id = target.strip_prefix('#').unwrap();
        assert!(different.contains(id), "{target} has no target");
    }
}

/// The figures of a report's JSON, in order.
fn figures(json: &Value) -> Vec<&Value> {
    let sections = json["sections"].as_array().unwrap().iter();
    let parts = sections.flat_map(|section| section["parts"].as_array().unwrap());
    parts.filter_map(|part| part.get("figure")).collect()
}

/// The data in the page.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn the_page_has_the_data_of_the_report_and_a_place_for_every_figure() {
    let page = text("report.html");
    let json: Value = serde_json::from_str(&text("report.json")).unwrap();
    assert_eq!(data(&page), json);
    let found = figures(&json);
    assert_eq!(found.len(), made().document.figures().count());
    let names: Vec<&str> = found.iter().map(|figure| figure["name"].as_str().unwrap()).collect();
    for number in 1..=5 {
        let begin = format!("figure-{number}-");
        assert!(names.iter().any(|name| name.starts_with(&begin)), "{begin} of {names:?}");
    }
    for figure in found {
        let name = figure["name"].as_str().unwrap();
        assert!(page.contains(&format!("<figure id=\"{name}\">")), "{name}");
        for panel in figure["panels"].as_array().unwrap() {
            let layers = panel["layers"].as_array().unwrap();
            assert!(layers.iter().any(|layer| has_number(&layer["mark"])), "{name} shows nothing");
        }
    }
}

fn has_number(value: &Value) -> bool {
    match value {
        Value::Number(_) => true,
        Value::Array(all) => all.iter().any(has_number),
        Value::Object(all) => all.values().any(has_number),
        _ => false,
    }
}

#[test]
fn every_output_is_marked_as_simulated() {
    for path in ["report.html", "report.json", "report.txt"] {
        let text = text(path);
        let is_marked = text.contains("Every number here is of simulated robots");
        assert!(is_marked, "{path}");
    }
    for figure in made().document.figures() {
        let note = format!("simulated robots, seed {}", made().shown_seed);
        assert_eq!(figure.note, Some(note), "{}", figure.name);
    }
    assert_eq!(made().network.card().source, "simulation");
    assert!(made().network.card().training_data.contains("simulated"));
}

#[test]
fn page_text_and_json_show_the_same_numbers() {
    let (page, plain) = (text("report.html"), text("report.txt"));
    let json: Value = serde_json::from_str(&text("report.json")).unwrap();
    let found = tables(&json);
    let tables: Vec<&Table> = made().document.tables().collect();
    assert_eq!(found.len(), tables.len());
    for (table, found) in tables.iter().zip(found) {
        assert_eq!(found["id"], table.id);
        let from = page.find(&format!("<table id=\"{}\"", table.id)).unwrap();
        let mut rest = &page[from..];
        rest = &rest[..rest.find("</table>").unwrap()];
        assert!(plain.contains(&table.caption), "{}", table.caption);
        for (row, found) in table.rows.iter().zip(found["rows"].as_array().unwrap()) {
            assert_eq!(row.len(), table.columns.len(), "{}", table.id);
            for (cell, column) in row.iter().zip(&table.columns) {
                let shown = format!(">{}</t", escaped(&cell.shown()));
                let at = rest.find(&shown);
                let at = at.unwrap_or_else(|| panic!("{shown} in {}", table.id));
                rest = &rest[at + shown.len()..];
                assert!(plain.contains(&cell.shown()));
                check_json(cell, &found[column.key.as_str()], table);
            }
        }
    }
}

fn check_json(cell: &Cell, found: &Value, table: &Table) {
    let id = &table.id;
    match cell {
        Cell::Words(words) => assert_eq!(found, words.as_str(), "{id}"),
        Cell::Count(count) => assert_eq!(found.as_u64(), Some(*count), "{id}"),
        Cell::Number(number, _) if number.is_finite() => {
            assert_eq!(found.as_f64(), Some(*number), "{id}");
        }
        Cell::Range([low, high], _) if low.is_finite() => {
            assert_eq!(found[0].as_f64(), Some(*low), "{id}");
            assert_eq!(found[1].as_f64(), Some(*high), "{id}");
        }
        Cell::Spread([mean, std], _) if std.is_finite() => {
            assert_eq!(found["mean"].as_f64(), Some(*mean), "{id}");
            assert_eq!(found["standard_deviation"].as_f64(), Some(*std), "{id}");
        }
        Cell::Spread(..) => assert!(found["standard_deviation"].is_null(), "{id}"),
        Cell::Number(..) | Cell::Nothing => assert!(found.is_null(), "{id}"),
        Cell::Range(..) => assert!(found[0].is_null(), "{id}"),
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[test]
fn the_papers_numbers_are_shown_in_the_right_unit() {
    let json: Value = serde_json::from_str(&text("report.json")).unwrap();
    let tables = tables(&json);
    let table = tables.iter().find(|table| table["id"] == "table-paper");
    let rows = table.unwrap()["rows"].as_array().unwrap();
    let row = |quantity: &str| {
        let row = rows.iter().find(|row| row["quantity"] == quantity);
        row.unwrap().clone()
    };
    assert_eq!(row("mean power (mW)")["paper"], 3652.0);
    assert_eq!(row("MAE on trial 6 (mW)")["paper"], 31.5);
    // The mean power of the simulated trials of every draw, recomputed.
    let mean_mw = |seed: u64| {
        let mut powers_w = Vec::new();
        for protocol in Protocol::ALL {
            let trial = drive_with(protocol, Parts::default(), seed, 900);
            let power = trial.column(joulebus_dataset::trial::Column::Power);
            powers_w.extend_from_slice(power.unwrap());
        }
        1e3 * powers_w.iter().sum::<f64>() / powers_w.len() as f64
    };
    let draws = [3, 4, 5].map(mean_mw);
    let mean = draws.iter().sum::<f64>() / 3.0;
    let square = draws.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / 2.0;
    let here = row("mean power (mW)")["here"].clone();
    let off = (here["mean"].as_f64().unwrap() - mean).abs();
    assert!(off < 1e-6, "{here}");
    let std = here["standard_deviation"].as_f64().unwrap();
    assert!((std - square.sqrt()).abs() < 1e-6, "{here}");
    let ends = row("mean power (mW)")["ends"].clone();
    let least = draws.iter().copied().fold(f64::MAX, f64::min);
    assert!((ends[0].as_f64().unwrap() - least).abs() < 1e-6, "{ends}");
}

#[test]
fn the_page_begins_with_the_published_forecast_over_all_draws() {
    let summary = &made().document.summary;
    let begin = "The forecast that the worker publishes";
    assert!(summary[0].starts_with(begin), "{summary:#?}");
    // Three draws of seven robots.
    assert!(summary[0].contains("of 21 robots"), "{summary:#?}");
    assert!(summary[1].starts_with("The plain network"), "{summary:#?}");
    let first = &made().document.sections[0];
    assert_eq!(first.id, "forecasts");
    // The figures show a draw that is one of those averaged.
    let shown = format!("show seed {}", made().shown_seed);
    assert!(summary[2].contains(&shown) && (3..=5).contains(&made().shown_seed));
}

#[test]
fn one_draw_is_not_enough() {
    let mut experiment = experiment();
    experiment.draws = 1;
    let error = run(&experiment).unwrap_err();
    let ReportError::TooShort { what, found, least } = error else {
        panic!("{error}");
    };
    assert_eq!((what, found, least), ("draws", 1, 2));
}

#[test]
fn the_same_experiments_give_the_same_bytes() {
    let mut experiment = experiment();
    experiment.threads = 1;
    let again = run(&experiment).unwrap();
    assert_eq!(again.network.hash(), made().network.hash());
    assert_eq!(html(&again.document).unwrap(), text("report.html"));
}

fn recordings(count: usize) -> Vec<Recording> {
    let trial = |&protocol| drive_with(protocol, Parts::default(), 5, 500);
    let trials = Protocol::ALL.iter().take(count).map(trial);
    trials.map(|trial| Recording::new(0, trial)).collect()
}

fn on<'a>(
    settings: &'a FleetSettings,
    models: &'a [Model],
    recordings: &'a [Recording],
    design: &'a Design,
) -> Recorded<'a> {
    let references = Reference::OWN.to_vec();
    Recorded { settings, platform: None, models, recordings, design, references, battery_wh: None }
}

#[test]
fn recordings_are_compared_with_the_baselines_and_without_the_papers_numbers() {
    let (settings, models) = (settings(), [Model::Network(made().network.clone())]);
    let recordings = recordings(3);
    let design = Design::folds(&recordings);
    let document = recorded(&on(&settings, &models, &recordings, &design)).unwrap();
    let text = document.to_string();
    for name in
        "network|persistence|AR(5) + velocities|mean so far|ridge|trial2 goal navigation".split('|')
    {
        assert!(text.contains(name), "{name}");
    }
    assert!(!text.contains("paper, trial 6"));
    let warning = document.warning.unwrap();
    assert!(warning.contains("trained on simulated robots"), "{warning}");
    assert!(made().document.to_string().contains("paper, trial 6"));
}

#[test]
fn one_short_recording_is_enough_and_none_is_refused() {
    let (settings, models) = (settings(), [Model::Network(made().network.clone())]);
    let one = recordings(1);
    let document = recorded(&on(&settings, &models, &one, &Design::folds(&one))).unwrap();
    html(&document).unwrap();
    let refused = recorded(&on(&settings, &models, &[], &Design::folds(&[]))).unwrap_err();
    assert!(matches!(refused, ReportError::Score(_)), "{refused}");
    let short = Simulated { samples: 99, ..experiment() };
    let refused = run(&short).unwrap_err();
    assert!(refused.to_string().contains("99 samples"), "{refused}");
}

#[test]
fn names_from_files_are_escaped_in_the_page() {
    let hostile = "<script>alert('1')</script><!-- & \"more\" \u{1}\u{2028}";
    let table = Table {
        id: "a-table".to_owned(),
        caption: hostile.to_owned(),
        columns: vec![Column::new("name", hostile), Column::new("value", "value")],
        rows: vec![vec![Cell::words(hostile), Cell::Number(f64::NAN, 1)]],
        folded: true,
    };
    let document = Document {
        title: hostile.to_owned(),
        warning: Some(hostile.to_owned()),
        summary: vec![hostile.to_owned()],
        sections: vec![Section {
            id: "a-section".to_owned(),
            title: hostile.to_owned(),
            parts: vec![Part::Words(hostile.to_owned()), Part::Table(table)],
        }],
    };
    let page = html(&document).unwrap();
    assert!(!page.contains("<script>alert") && !page.contains("<!--"), "{page}");
    assert_eq!(page.matches("</script>").count(), 3, "{page}");
    let json = serde_json::to_value(&document).unwrap();
    assert_eq!(data(&page), json);
    assert!(json["sections"][0]["parts"][1]["table"]["rows"][0]["value"].is_null());
    assert!(document.to_string().contains('\u{2013}'), "not known");
}
