//! Files with several recordings, and rows that have only some columns.

use joulebus_dataset::inspect::{Limits, check_files, judge};
use joulebus_dataset::trial::{Column, ColumnMap, Table, Trial};
use joulebus_plausibility::Kind;
use joulebus_testkit::trials::Files;

const HEADER: &str = "time,voltage_V,current_A";

fn row(time_s: f64, number: u32) -> String {
    let ampere = 1.0 + 0.1 * (0.7 * f64::from(number)).sin();
    format!("{time_s:.2},{:.4},{ampere:.4}\n", 12.0 - 0.1 * ampere)
}

/// Rows of the trials in a text, and whether the judgement states where each but the first begins.
fn lengths(files: &Files, text: &str, map: &ColumnMap) -> (Vec<usize>, usize) {
    let path = files.write("log.csv", text.as_bytes());
    let trials = Trial::read_mapped(&path, map).unwrap();
    let found = trials.iter().flat_map(|trial| judge(trial, &Limits::default()));
    let begun = found.filter(|one| {
        one.finding.kind == Kind::Clock && one.place.what.contains("are another trial")
    });
    let begun = begun.count();
    let check = check_files(&[path.to_owned()], map, &Limits::default(), 4);
    assert_eq!(check.trials, trials.len());
    (trials.iter().map(Trial::rows).collect(), begun)
}

#[test]
fn another_trial_begins_where_the_time_goes_back_or_the_header_comes_again() {
    let files = Files::new();
    let text = |times: &[f64], again: Option<usize>| {
        let mut text = format!("{HEADER}\n");
        for (number, time_s) in times.iter().enumerate() {
            if Some(number) == again {
                text += &format!("{HEADER}\n");
            }
            text += &row(*time_s, number as u32);
        }
        text
    };
    let run = |from: f64, rows: u32| (0..rows).map(move |row| from + f64::from(row) * 0.1);
    let plain = ColumnMap::default();
    let whole = ColumnMap::default().whole_rows(true);
    let twice: Vec<f64> = run(0.0, 100).chain(run(0.0, 60)).collect();
    assert_eq!(lengths(&files, &text(&twice, None), &plain), (vec![100, 60], 1));
    assert_eq!(lengths(&files, &text(&twice, Some(100)), &whole), (vec![100, 60], 1));
    let thrice: Vec<f64> = run(5.0, 100).chain(run(2.0, 60)).chain(run(0.0, 50)).collect();
    assert_eq!(lengths(&files, &text(&thrice, None), &plain), (vec![100, 60, 50], 2));
    // A clock that goes on, beside a header.
    let later: Vec<f64> = run(0.0, 100).chain(run(50.0, 60)).collect();
    assert_eq!(lengths(&files, &text(&later, Some(100)), &whole), (vec![100, 60], 1));
    // A row that came late, and one with a wrong time, begin none.
    let mut late: Vec<f64> = run(0.0, 100).collect();
    (late[40], late[70]) = (3.95, 0.0);
    assert_eq!(lengths(&files, &text(&late, None), &plain), (vec![100], 0));
    // Two recordings, row by row.
    let mixed: Vec<f64> = run(50.0, 40).zip(run(0.0, 40)).flat_map(|(a, b)| [a, b]).collect();
    assert_eq!(lengths(&files, &text(&mixed, None), &plain).0, [80]);
    // A conversion keeps them together.
    let path = files.write("log.csv", text(&twice, None).as_bytes());
    assert_eq!(Table::read_mapped(path, &plain).unwrap().len(), 1);
}

#[test]
fn rows_of_several_topics_are_joined_by_the_rule_of_holding() {
    let files = Files::new();
    let mut text = "__time,/r/battery_state/voltage,/r/battery_state/current,\
                    /r/cmd_vel/linear/x,/r/odom/twist/twist/linear/x\n"
        .to_owned();
    for number in 0..100_u32 {
        let time_s = f64::from(number) * 0.1;
        text += &row(time_s, number).replace('\n', ",,\n");
        // The controller falls silent after 5 s.
        if number < 50 {
            text += &format!("{:.2},,,0.2,\n", time_s + 0.02);
        }
        text += &format!("{:.2},,,,0.19\n", time_s + 0.04);
    }
    let path = files.write("log.csv", text.as_bytes());
    let trial = Trial::read(path).unwrap();
    assert_eq!(trial.rows(), 100);
    assert!(trial.notes().to_string().contains("100 of 250 rows"), "{}", trial.notes());
    let known = |column| {
        let values = trial.column(column).unwrap();
        values.iter().filter(|value| !value.is_nan()).count()
    };
    // None before the first command, and none 0.5 s after the last one.
    assert_eq!(known(Column::V), 50 - 1 + 5);
    assert_eq!((known(Column::VMeasured), known(Column::Power)), (99, 100));
    // Voltage and current in rows of their own.
    let mut text = "__time,/v/voltage,/i/current\n".to_owned();
    for number in 0..60 {
        let time_s = f64::from(number) * 0.1;
        text += &format!("{time_s:.2},12.5,\n{:.2},,2\n", time_s + 0.01);
    }
    let trial = Trial::read(files.write("apart.csv", text.as_bytes())).unwrap();
    assert_eq!(trial.rows(), 60);
    assert!(trial.column(Column::Power).unwrap().iter().all(|power_w| *power_w == 25.0));
}
