//! Options that name the columns of a file, each tried on its first rows before it is printed.

use std::path::Path;

use csv::ByteRecord;
use joulebus_plausibility::Judge;

use super::layout::{Layout, alternates};
use super::names::{ColumnMap, MappedColumn, Quantity};
use super::numbers::Numbers;
use super::table::{Cell, Tables};
use super::times::Times;

/// Words in the names of columns, in lower case, and the quantity with the unit that it usually
/// has.
const WORDS: [(&str, &[&str]); 4] = [
    ("time", &["time", "stamp", "date", "zeit", "epoch", "seconds"]),
    ("voltage", &["volt", "vbat", "spannung"]),
    ("current", &["curr", "ampere", "amps", "strom"]),
    ("power", &["power", "watt", "leistung"]),
];
/// Columns of one quantity that are tried, options that are, and that are printed.
const MAX_COLUMNS: usize = 6;
const MAX_TRIED: usize = 64;
const MAX_PRINTED: usize = 4;

/// What to do about columns that a file lacks, as a sentence: options that were tried on its header
/// and first rows. `lacks`: time, power.
pub(super) fn propose(
    path: &Path,
    (header, sample): (&ByteRecord, &[ByteRecord]),
    given: &ColumnMap,
    [time, power]: [bool; 2],
) -> String {
    let names: Vec<String> =
        header.iter().map(|name| String::from_utf8_lossy(name).into_owned()).collect();
    let like = |quantity: &str| -> Vec<&str> {
        let words =
            WORDS.iter().find(|(name, _)| *name == quantity).map_or(&[][..], |(_, words)| words);
        let fits = |name: &&String| {
            let name = name.to_lowercase();
            let is_stamp = quantity != "time" && name.contains("stamp");
            words.iter().any(|word| name.contains(word)) && !is_stamp && !is_other(&name)
        };
        names.iter().filter(fits).map(String::as_str).take(MAX_COLUMNS).collect()
    };
    let of_time: Vec<Vec<String>> = match time {
        true => like("time").into_iter().map(|name| vec![time_option(name)]).collect(),
        false => vec![Vec::new()],
    };
    let (voltages, currents, powers) = (like("voltage"), like("current"), like("power"));
    let mut of_power: Vec<Vec<String>> = Vec::new();
    if power {
        for voltage in &voltages {
            for current in partners(voltage, &currents) {
                of_power
                    .push(vec![option("voltage", "V", voltage), option("current", "A", current)]);
            }
        }
        of_power.extend(powers.iter().map(|name| vec![option("power", "W", name)]));
    } else {
        of_power.push(Vec::new());
    }
    let robot = (0..names.len()).find(|at| alternates(sample, *at));
    let robot = robot.filter(|_| !given.maps(Quantity::Robot));
    let robot = robot.map(|at| format!("robot={}", names[at]));
    let mut fitting: Vec<String> = Vec::new();
    let tried = of_time.iter().flat_map(|time| of_power.iter().map(move |power| (time, power)));
    for (time, power) in tried.take(MAX_TRIED) {
        let options: Vec<&str> =
            time.iter().chain(power).chain(&robot).map(String::as_str).collect();
        if works(path, (header, sample), given, &options) {
            fitting.push(shown(&options));
        }
    }
    let sum = |of: &dyn Fn() -> Option<String>| (fitting.len() > 1 && power).then(of).flatten();
    let products = sum(&|| {
        let pairs: Vec<String> = voltages
            .iter()
            .flat_map(|voltage| {
                partners(voltage, &currents)
                    .into_iter()
                    .map(move |current| format!("{voltage}*{current}"))
            })
            .collect();
        (pairs.len() > 1 && pairs.len() == currents.len()).then(|| pairs.join("+"))
    });
    let powers = sum(&|| (powers.len() > 1).then(|| powers.join("+")));
    let whole = products.or(powers).and_then(|sum| {
        let time = of_time.iter().find_map(|time| {
            let sum = format!("power_W={sum}");
            let options: Vec<&str> =
                time.iter().map(String::as_str).chain([sum.as_str()]).collect();
            works(path, (header, sample), given, &options).then(|| shown(&options))
        });
        time.map(|option| format!("; their sum: {option}"))
    });
    let interval = names.iter().find(|name| name.to_lowercase().contains("interval"));
    match (fitting.as_slice(), interval) {
        ([], Some(interval)) if time => format!(
            "A time can be made of the intervals, in Python: \
             df['time_s'] = df['{interval}'].cumsum() / 1000"
        ),
        ([], _) => "Name them with --map, such as --map time=t,power_W=p".to_owned(),
        ([only], _) => format!("Name them: {only}"),
        (several, _) => format!(
            "Several fit, and none is chosen: {}{}",
            several[..several.len().min(MAX_PRINTED)].join(", or "),
            whole.unwrap_or_default()
        ),
    }
}

/// True for names of totals, and of other things that have such a word.
fn is_other(name: &str) -> bool {
    ["wh", "ah", "tot", "energy", "temp", "percent", "timeout", "interval"]
        .iter()
        .any(|word| name.contains(word))
        && !name.contains("power tot")
}

/// The currents that belong to a voltage: those whose names differ from its by their words alone,
/// else all.
fn partners<'n>(voltage: &str, currents: &[&'n str]) -> Vec<&'n str> {
    let digits = |name: &str| name.chars().filter(char::is_ascii_digit).collect::<String>();
    let same: Vec<&str> =
        currents.iter().copied().filter(|current| digits(current) == digits(voltage)).collect();
    if same.is_empty() { currents.to_vec() } else { same }
}

/// The option for a column, with a unit where its name states none.
fn option(quantity: &str, unit: &str, column: &str) -> String {
    let plain = format!("{quantity}={column}");
    let states_unit = plain.parse::<MappedColumn>().is_ok_and(|mapped| mapped.names_unit());
    if states_unit { plain } else { format!("{quantity}_{unit}={column}") }
}

/// The same for a time, whose unit may stand at the end of its name: `TimeUS`, `epoch_ms`.
fn time_option(column: &str) -> String {
    let lower = column.to_lowercase();
    let unit = ["us", "ms", "ns"].into_iter().find(|unit| lower.ends_with(unit));
    match unit.filter(|_| !lower.ends_with("dns")) {
        Some(unit) => format!("time_{unit}={column}"),
        None => option("time", "s", column),
    }
}

fn shown(options: &[&str]) -> String {
    format!("--map '{}'", options.join(","))
}

/// True if a trial can be made of the first rows with these options, without a time that repeats,
/// and without an error among its findings.
fn works(
    path: &Path,
    (header, sample): (&ByteRecord, &[ByteRecord]),
    given: &ColumnMap,
    options: &[&str],
) -> bool {
    let columns = options.iter().map(|option| option.parse::<MappedColumn>());
    let Ok(columns) = columns.collect::<Result<Vec<_>, _>>() else {
        return false;
    };
    let Ok(layout) = Layout::find(path, header, sample, &given.clone().with(columns)) else {
        return false;
    };
    let (mut numbers, mut tables) = (Numbers::default(), Tables::default());
    let mut times = Times::new(layout.day_first);
    for (record, row) in sample.iter().zip(1..) {
        let cell = Cell { path, row };
        let row = layout.row(cell, record, &mut numbers, &mut times);
        if row.and_then(|row| layout.push(cell, &row, &mut tables)).is_err() {
            return false;
        }
    }
    let mut tables = tables.finish(path, &[], false);
    if times.finish(path, &mut tables, &layout.time_name, &mut Vec::new()).is_err() {
        return false;
    }
    layout.finish(&mut tables, &times, &mut Vec::new());
    tables.into_iter().all(|table| {
        let Ok(trial) = table.into_trial() else {
            return false;
        };
        let mut judge = Judge::new(trial.known());
        trial.observations().for_each(|seen| judge.take(&seen));
        let advances = trial.timestamp_s().windows(2).all(|pair| pair[0] < pair[1]);
        advances && !judge.findings().iter().any(|finding| finding.is_error())
    })
}
