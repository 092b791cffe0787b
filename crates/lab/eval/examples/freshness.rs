//! Gain of the reading-age features: the tables of `docs/measured/benchmark.md`, as Markdown on
//! stdout.
//!
//! `cargo run --release -p joulebus-eval --example freshness -- [--every N] [--seeds N] [NAME..]`
//!
//! `../shared/data` holds the real recordings; without them only the simulated plant is shown.
//! `--every N` takes every N-th recording, `--seeds N` trains each network N times, and names (or
//! their prefixes) select cases.
#![forbid(unsafe_code)]

use std::error::Error;
use std::path::{Path, PathBuf};

use joulebus_dataset::rows::{Dataset, Row, RowOrigin, TrialRows, sample_rows, trial_rows};
use joulebus_dataset::split::{Source, Split, group_of, split};
use joulebus_dataset::trial::{Column, Trial};
use joulebus_predictor::{FEATURES, FeatureSet, Features, Network};
use joulebus_sim::{protocol, scenario};
use joulebus_statistics::bootstrap::{Bootstrap, Estimate};
use joulebus_statistics::metrics::Tally;
use joulebus_train::linear::{Linear, Terms, known_terms};
use joulebus_train::{TrainSettings, train};
use joulebus_wire::{Sample, sample_flag};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/data");
const TICK_NS: u64 = 33_333_333;
const SECOND_NS: u64 = 1_000_000_000;
/// Position of the newest reading.
const NEWEST: usize = FeatureSet::PowerOnly.first();
const SEED: u64 = 7;
/// Rows of the seven robots' random walk.
const STEPS: usize = 3_000;

struct Options {
    every: usize,
    seeds: u64,
    names: Vec<String>,
}

/// Rows for training, validation and scoring, all with known reading age.
struct Case {
    name: String,
    dataset: Dataset,
}

/// All forecasts of the held-out rows, with their squared and absolute errors.
struct Result {
    /// Persistence, least squares, least squares fitted separately for rows with a reading due,
    /// network, network with reading age, and persistence until a reading is due combined with the
    /// latter.
    models: [Vec<f64>; 6],
}

fn main() -> std::result::Result<(), Box<dyn Error>> {
    let options = options()?;
    println!(
        "| case | rows held out | held readings | persistence | AR(5)+v | AR(5)+v, by due | network | network with freshness | the same, persistence until due | squared error removed (95 %) |"
    );
    println!("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    let mut more = Vec::new();
    for case in cases(&options)? {
        let result = run(&case, &options)?;
        println!("{}", scores(&case, &result));
        more.push(by_kind(&case, &result));
    }
    println!(
        "\n| case | held: network | held: with freshness | new: persistence | new: network | new: with freshness |"
    );
    println!("|---|--:|--:|--:|--:|--:|");
    more.iter().for_each(|line| println!("{line}"));
    Ok(())
}

fn options() -> std::result::Result<Options, Box<dyn Error>> {
    let mut options = Options { every: 1, seeds: 1, names: Vec::new() };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut number = || words.next().ok_or(format!("{word} needs a number"));
        match word.as_str() {
            "--every" => options.every = number()?.parse::<usize>()?.max(1),
            "--seeds" => options.seeds = number()?.parse::<u64>()?.max(1),
            _ => options.names.push(word),
        }
    }
    Ok(options)
}

/// Presentation of a real recording.
#[derive(Clone, Copy)]
enum Shown {
    /// The recorded stamps. A reading equal to the last one counts as held.
    Native,
    /// The newest row at every tick of 30 Hz.
    Held,
    /// Through a monitor polled at a lower rate, returned at 30 Hz: 10 Hz as the GTernal's, or 1
    /// Hz, the default of the public firmware.
    Polled {
        /// Time between two measurements, ns.
        poll_ns: u64,
    },
}

const TEN_HZ: Shown = Shown::Polled { poll_ns: SECOND_NS / 10 };
const ONE_HZ: Shown = Shown::Polled { poll_ns: SECOND_NS };

fn cases(options: &Options) -> std::result::Result<Vec<Case>, Box<dyn Error>> {
    let wanted = |name: &str| {
        options.names.is_empty() || options.names.iter().any(|start| name.starts_with(start))
    };
    let mut cases = Vec::new();
    for (name, shown) in [
        ("simulated: trial 6", Shown::Native),
        ("simulated: seven robots", Shown::Native),
        ("simulated: trial 6, measured at 1 Hz", ONE_HZ),
        ("simulated: seven robots, measured at 1 Hz", ONE_HZ),
    ] {
        if wanted(name) {
            cases.push(simulated(name, shown));
        }
    }
    for folder in ["robotino", "borealtc_husky", "ase_rover"] {
        for (shown, how) in [
            (Shown::Native, "native rate"),
            (Shown::Held, "held to 30 Hz"),
            (TEN_HZ, "measured at 10 Hz, held to 30 Hz"),
            (ONE_HZ, "measured at 1 Hz, held to 30 Hz"),
        ] {
            let name = format!("{folder}: {how}");
            if wanted(&name) {
                cases.extend(recorded(&name, folder, shown, options)?);
            }
        }
    }
    Ok(cases)
}

/// Rows with known reading age: all models are scored on the same rows.
fn known(rows: Vec<Row>) -> Vec<Row> {
    let is_known = |row: &Row| row.features[FEATURES].is_finite();
    rows.into_iter().filter(is_known).collect()
}

/// The paper's split; or its training part, scored on the seven robots.
fn simulated(name: &str, shown: Shown) -> Case {
    let trials = protocol::trials(SEED);
    let rows = |trials: &[Trial]| -> Vec<Row> {
        let rows = trials.iter().enumerate().flat_map(|(number, trial)| {
            let origin = RowOrigin::recording(number);
            shown_rows(trial, shown).rows.into_iter().map(move |row| row.of(origin))
        });
        known(rows.collect())
    };
    let held_out = match name.contains("robots") {
        true => rows(&scenario::seven_robots(SEED, STEPS)),
        false => rows(&trials[5..]),
    };
    Case {
        name: name.to_owned(),
        dataset: Dataset {
            training: rows(&trials[..4]),
            validation: rows(&trials[4..5]),
            held_out,
            description: name.to_owned(),
            period_s: 0.0,
        },
    }
}

fn recorded(
    name: &str,
    folder: &str,
    shown: Shown,
    options: &Options,
) -> std::result::Result<Option<Case>, Box<dyn Error>> {
    let folder = Path::new(DATA).join(folder);
    if !folder.is_dir() {
        eprintln!("{name}: left out, {} is missing", folder.display());
        return Ok(None);
    }
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::result::Result<_, _>>()?;
    files.retain(|file| file.extension().is_some_and(|end| end == "gz"));
    files.sort();
    let mut sources = Vec::new();
    for file in files.iter().step_by(options.every) {
        let trial = Trial::read(file)?;
        let file = file.display().to_string();
        let mut rows = shown_rows(&trial, shown);
        rows.rows = known(rows.rows);
        sources.push(Source { group: group_of(&file), robot: file.clone(), trial: file, rows });
    }
    let (dataset, _) = split(&sources, Split::default(), name)?;
    Ok(Some(Case { name: name.to_owned(), dataset }))
}

fn shown_rows(trial: &Trial, shown: Shown) -> TrialRows {
    match shown {
        Shown::Native => trial_rows(trial),
        Shown::Held => sample_rows(&held(trial, None), TICK_NS),
        Shown::Polled { poll_ns } => sample_rows(&held(trial, Some(poll_ns)), TICK_NS),
    }
}

/// The trial as a controller at 30 Hz would have published it: the newest row, or the newest at the
/// last poll. A reading is held while it comes from the same row or poll. A gap of the recording
/// longer than one and a half periods, and not filled by a poll, has no reading.
fn held(trial: &Trial, poll_ns: Option<u64>) -> Vec<Sample> {
    let offsets_ns = trial.offset_ns();
    let end_ns = offsets_ns.iter().copied().max().unwrap_or(0) as u64;
    let period_ns = trial.period_ns();
    let newest = |at_ns: u64| offsets_ns.partition_point(|row| *row <= at_ns as i64).max(1) - 1;
    let value = |column, row: usize| trial.column(column).map_or(f64::NAN, |of| of[row]) as f32;
    let mut before = None;
    let mut samples = Vec::new();
    for tick in 0..end_ns / TICK_NS {
        let (now_ns, stamp_ns) = (tick * TICK_NS, (tick + 1) * TICK_NS);
        let measured_ns = poll_ns.map_or(now_ns, |poll_ns| now_ns / poll_ns * poll_ns);
        let (read, commanded) = (newest(measured_ns), newest(stamp_ns));
        let mut sample = Sample::new(0, tick, 1_000_000_000 + stamp_ns);
        let age_ns = measured_ns.saturating_sub(offsets_ns[read] as u64);
        let power_w = value(Column::Power, read);
        if power_w.is_finite() && age_ns <= period_ns + period_ns / 2 {
            let measurement = poll_ns.map_or(read as u64, |_| measured_ns);
            sample = sample.reading(power_w, 1_000_000_000 + measured_ns);
            if before.replace(measurement) == Some(measurement) {
                sample = sample.with(sample_flag::HELD);
            }
        }
        let (v_mps, omega_radps) = (value(Column::V, commanded), value(Column::Omega, commanded));
        if v_mps.is_finite() && omega_radps.is_finite() {
            sample = sample.command(v_mps, omega_radps);
        }
        samples.push(sample);
    }
    samples
}

fn run(case: &Case, options: &Options) -> std::result::Result<Result, Box<dyn Error>> {
    let Dataset { training, held_out, .. } = &case.dataset;
    let (terms, _) = known_terms(&[training, held_out], Terms::AR5_AND_VELOCITIES);
    let has_commands = terms.has(0);
    let sets = match has_commands {
        true => [FeatureSet::Full, FeatureSet::Freshness],
        false => [FeatureSet::PowerOnly, FeatureSet::PowerFreshness],
    };
    let persistence = held_out.iter().map(|row| f64::from(row.features[NEWEST]));
    let line = Linear::fit(training, terms)?.predict_rows(held_out);
    let [plain, fresh] = [networks(case, sets[0], options)?, networks(case, sets[1], options)?];
    let last_w: Vec<f64> = persistence.collect();
    let until_due = fresh.iter().zip(held_out.iter().zip(&last_w).cycle());
    let until_due = until_due.map(|(fresh_w, (row, last_w))| match is_due(row) {
        true => *fresh_w,
        false => *last_w,
    });
    let until_due = until_due.collect();
    Ok(Result {
        models: [last_w, line, by_due(training, held_out, terms)?, plain, fresh, until_due],
    })
}

fn is_due(row: &Row) -> bool {
    row.features[FEATURES + 1] == 1.0
}

/// Separate least-squares fits for rows with and without a reading due.
fn by_due(
    training: &[Row],
    held_out: &[Row],
    terms: Terms,
) -> std::result::Result<Vec<f64>, Box<dyn Error>> {
    let fit = |due: bool| -> std::result::Result<Linear, Box<dyn Error>> {
        let rows: Vec<Row> = training.iter().filter(|row| is_due(row) == due).copied().collect();
        match rows.len() > 100 {
            true => Ok(Linear::fit(&rows, terms)?),
            false => Ok(Linear::fit(training, terms)?),
        }
    };
    let lines = [fit(false)?, fit(true)?];
    let forecast = |row: &Row| lines[usize::from(is_due(row))].predict(&row.features);
    Ok(held_out.iter().map(forecast).collect())
}

/// Forecasts of the held-out rows, concatenated over the seeds.
fn networks(
    case: &Case,
    set: FeatureSet,
    options: &Options,
) -> std::result::Result<Vec<f64>, Box<dyn Error>> {
    let inputs: Vec<Features> = case.dataset.held_out.iter().map(|row| row.features).collect();
    let mut all = Vec::new();
    for seed in 0..options.seeds {
        let start = std::time::Instant::now();
        let settings = TrainSettings::new("example", &case.name, set, seed);
        let trained = train(&case.dataset, &settings, |_| ())?;
        let network: Network = trained.network;
        let mut forecasts_w = vec![0.0; inputs.len()];
        network.predict(&inputs, &mut forecasts_w);
        all.extend(forecasts_w.into_iter().map(f64::from));
        let (epochs, rows) = (trained.epochs.len(), case.dataset.training.len());
        let seconds = start.elapsed().as_secs_f64();
        eprintln!(
            "{}, {}, seed {seed}: {rows} rows, {epochs} epochs, {seconds:.0} s",
            case.name,
            set.name()
        );
    }
    Ok(all)
}

/// For each seed, the tally of the rows selected by `counts`.
fn tallies(rows: &[Row], forecasts_w: &[f64], counts: impl Fn(&Row) -> bool) -> Vec<Tally> {
    let tally = |forecasts_w: &[f64]| {
        let mut tally = Tally::default();
        for (row, forecast_w) in rows.iter().zip(forecasts_w) {
            if counts(row) {
                tally.add(f64::from(row.target_w), *forecast_w, 0.0);
            }
        }
        tally
    };
    forecasts_w.chunks(rows.len()).map(tally).collect()
}

/// The mean over the seeds and, of several, their range.
fn over_seeds(tallies: &[Tally], score: impl Fn(&Tally) -> f64, digits: usize) -> String {
    let scores: Vec<f64> = tallies.iter().map(score).collect();
    let mean = scores.iter().sum::<f64>() / scores.len() as f64;
    if scores.len() == 1 {
        return format!("{mean:.digits$}");
    }
    let lo = scores.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    format!("{mean:.digits$} ({lo:.digits$} to {hi:.digits$})")
}

fn scores(case: &Case, result: &Result) -> String {
    let rows = &case.dataset.held_out;
    let held = rows.iter().filter(|row| is_held(row)).count() as f64 / rows.len() as f64;
    let cell = |forecasts_w: &Vec<f64>| {
        let tallies = tallies(rows, forecasts_w, |_| true);
        let r2 = over_seeds(&tallies, Tally::r2, 4);
        let mae_mw = over_seeds(&tallies, |tally| tally.mae_w() * 1e3, 1);
        format!("{r2} · {mae_mw} mW")
    };
    let cells: Vec<String> = result.models.iter().map(cell).collect();
    let Estimate { value, lo, hi } = removed(rows, &result.models[3], &result.models[4]);
    format!(
        "| {} | {} | {:.0} % | {} | {:.1} % ({:.1} to {:.1}) |",
        case.name,
        rows.len(),
        held * 100.0,
        cells.join(" | "),
        value * 100.0,
        lo * 100.0,
        hi * 100.0,
    )
}

/// True if the target reading equals the newest one.
fn is_held(row: &Row) -> bool {
    row.target_w == row.features[NEWEST]
}

/// The share of the network's squared error that the reading-age features remove, over all seeds.
fn removed(rows: &[Row], plain_w: &[f64], fresh_w: &[f64]) -> Estimate {
    let bootstrap = Bootstrap::default();
    let squares = |forecasts_w: &[f64]| -> Vec<f64> {
        let mut squares = vec![0.0; rows.len().div_ceil(bootstrap.block_rows)];
        for forecasts_w in forecasts_w.chunks(rows.len()) {
            for (at, (row, forecast_w)) in rows.iter().zip(forecasts_w).enumerate() {
                squares[at / bootstrap.block_rows] +=
                    (f64::from(row.target_w) - forecast_w).powi(2);
            }
        }
        squares
    };
    let (plain, fresh) = (squares(plain_w), squares(fresh_w));
    let share = |blocks: &[usize]| {
        let sum = |of: &[f64]| blocks.iter().map(|block| of[*block]).sum::<f64>();
        vec![1.0 - sum(&fresh) / sum(&plain)]
    };
    bootstrap.estimate(plain.len(), share)[0]
}

/// Mean absolute errors, separately for held and new readings.
fn by_kind(case: &Case, result: &Result) -> String {
    let rows = &case.dataset.held_out;
    let cell = |model: usize, held: bool| {
        let tallies = tallies(rows, &result.models[model], |row| is_held(row) == held);
        format!("{} mW", over_seeds(&tallies, |tally| tally.mae_w() * 1e3, 1))
    };
    let cells = [cell(3, true), cell(4, true), cell(0, false), cell(3, false), cell(4, false)];
    format!("| {} | {} |", case.name, cells.join(" | "))
}
