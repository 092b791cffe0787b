//! Evaluation of every Robotino recording: reading, building rows, scoring and formatting tables,
//! on one and two threads.
//!
//! `cargo bench -p joulebus-eval --bench eval [FOLDER]`; without a folder,
//! `../shared/data/robotino`.
#[path = "../tests/all/live.rs"]
mod live;

use std::path::{Path, PathBuf};
use std::time::Instant;

use joulebus_dataset::split::{By, Split};
use joulebus_dataset::trial::ColumnMap;
use joulebus_eval::score::{Design, Options, Recording, Subject, read_recordings, score};
use joulebus_predictor::{Model, Network};
use joulebus_statistics::bootstrap::Bootstrap;
use live::settings;

const ROUNDS: usize = 5;

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let named = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    let folder = named.map_or_else(|| root.join("../shared/data/robotino"), PathBuf::from);
    let Some(files) = recordings(&folder) else {
        println!("skipped: no recordings in {}", folder.display());
        return;
    };
    let model = root.join("configs/models/gternal-sim.safetensors");
    let model = std::fs::read(model).expect("a model ships");
    let model =
        Model::Network(Network::from_safetensors(&model).expect("the shipped model is valid"));
    println!(
        "{} on {}, release profile: {} recordings, medians of {ROUNDS} rounds",
        env!("CARGO_PKG_VERSION"),
        std::env::consts::ARCH,
        files.len()
    );
    let mut reports = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let report = pool.expect("threads").install(|| run(&files, &model, threads));
        reports.push(report);
    }
    assert!(reports[0] == reports[1], "the number of threads changes no bit");
}

fn recordings(folder: &Path) -> Option<Vec<(u32, PathBuf)>> {
    let entries = std::fs::read_dir(folder).ok()?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
    paths.sort();
    (!paths.is_empty()).then(|| (0..).zip(paths).collect())
}

/// Median duration of several rounds, s, and the last result.
fn median<T>(mut run: impl FnMut() -> T) -> (f64, T) {
    let mut seconds = Vec::new();
    let mut last = None;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        last = Some(run());
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    (seconds[ROUNDS / 2], last.expect("there are rounds"))
}

fn run(files: &[(u32, PathBuf)], model: &Model, threads: usize) -> String {
    let (reading_s, found) =
        median(|| read_recordings(files, &ColumnMap::default()).expect("they can be read"));
    let rows: usize = found.iter().map(|one| one.trial_rows()).sum();
    println!("{threads} thread(s): reading {rows} rows and making features {reading_s:.3} s");
    let everything = Options::default();
    let corrected = Options { horizons: Vec::new(), ..everything.clone() };
    let plain = Options {
        bootstrap: Bootstrap { resamples: 0, ..Bootstrap::default() },
        ..corrected.clone()
    };
    let folds = || Design::folds(&found);
    let split = || {
        Design::held_out(&found, Split { by: By::Trial, ..Split::default() }).expect("many trials")
    };
    let design: [(&str, &Options, &dyn Fn() -> Design); 4] = [
        ("corrected, all rows, no intervals", &plain, &folds),
        ("corrected, all rows, intervals", &corrected, &folds),
        ("open loop too, all rows, intervals", &everything, &folds),
        ("open loop too, held-out 15 %, intervals", &everything, &split),
    ];
    let mut last = String::new();
    for (what, options, design) in design {
        let (seconds, report) = median(|| evaluate(&found, model, &design(), options));
        println!("{threads} thread(s): {what} {seconds:.3} s");
        last = report;
    }
    last
}

fn evaluate(recordings: &[Recording], model: &Model, design: &Design, options: &Options) -> String {
    let subject = Subject {
        settings: &settings(),
        platform: None,
        models: std::slice::from_ref(model),
        recordings,
        design,
    };
    score(subject, options).expect("sound data").report.to_string()
}
