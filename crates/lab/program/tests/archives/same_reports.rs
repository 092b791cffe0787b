//! Every verb reads an archive as the recordings that were exported.

use std::fs;
use std::path::{Path, PathBuf};

use joulebus_dataset::archive::listings;
use joulebus_dataset::trial::{Table, Trial};

use crate::recordings::{capture, every_kind, full};
use crate::{export_mixed, joulebus};

/// A folder of an archive of the recordings in `from`.
fn exported(from: &Path, place: &Path) -> PathBuf {
    let archive = place.join("archive");
    export_mixed(&[from], &archive).exits(0);
    archive
}

/// Results of a verb must be the same bytes.
fn same(words: &str, from: &Path, archive: &Path, more: &[&Path]) {
    let of = |folder: &Path| {
        let paths: Vec<&Path> = [folder].into_iter().chain(more.iter().copied()).collect();
        let ended = joulebus(words, &paths);
        (ended.code(), ended.text(), ended.errors())
    };
    let (recordings, read) = (of(from), of(archive));
    assert!(!recordings.1.is_empty(), "{words}: {}", recordings.2);
    assert_eq!((read.0, &read.1), (recordings.0, &recordings.1), "{words}: {}", read.2);
}

fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs/models/gternal-sim.safetensors")
}

#[test]
fn tables_of_an_archive_are_those_of_the_recordings_in_all_that_they_have() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    every_kind(&from);
    let archive = exported(&from, place.path());
    let mut recordings = 0;
    for listing in listings(&archive).unwrap() {
        let read = Table::read_robots(&listing).unwrap();
        let original = Table::read_robots(read[0].path()).unwrap();
        assert_eq!(read.len(), original.len());
        for (read, original) in read.into_iter().zip(original) {
            // NaN is not equal to itself: by the text of all fields, which shows every bit of a
            // number but −0's sign.
            assert_eq!(format!("{read:?}"), format!("{original:?}"));
            let (read, original) = (read.into_trial().unwrap(), original.into_trial().unwrap());
            let bits = |trial: &Trial| -> Vec<u32> {
                let samples = trial.to_samples(1, 5).into_iter();
                samples.flat_map(|one| [one.omega_radps.to_bits(), one.power_w.to_bits()]).collect()
            };
            assert_eq!(bits(&read), bits(&original));
        }
        recordings += 1;
    }
    assert_eq!(recordings, 6);
}

#[test]
fn eval_and_analyze_of_an_archive_report_the_same_bytes() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    every_kind(&from);
    let archive = exported(&from, place.path());
    let model = model();
    let words = "eval --format json --resamples 50 --energy --model";
    for words in [words, "eval --resamples 0 --split time --horizons 1,3 --model"] {
        let with = |folder: &Path| joulebus(words, &[&model, folder]);
        let (recordings, read) = (with(&from), with(&archive));
        assert_eq!(recordings.code(), Some(0), "{}", recordings.errors());
        assert_eq!(read.text(), recordings.text(), "{}", read.errors());
    }
    same("analyze --format json --each", &from, &archive, &[]);
    same("data info --format json", &from, &archive, &[]);
    same("data check --format json", &from, &archive, &[]);
}

#[test]
fn training_on_an_archive_gives_the_same_model_to_the_byte() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    fs::create_dir(&from).unwrap();
    for number in 0..3 {
        full(&from, &format!("full_{number}.csv"), 300, number);
    }
    capture(&from, "run.mcap", 300, 2);
    let archive = exported(&from, place.path());
    let recipe = place.path().join("short.toml");
    fs::write(&recipe, "[training]\nmax_epochs = 2\n").unwrap();
    let trained = |folder: &Path, name: &str| {
        let out = place.path().join(name);
        let words = "train trials --split time --features power --name a --recipe";
        joulebus(words, &[&recipe, folder, Path::new("--out"), &out]).exits(0);
        fs::read(out).unwrap()
    };
    assert!(trained(&from, "a.safetensors") == trained(&archive, "b.safetensors"));
}

#[test]
fn real_recordings_report_the_same_from_an_archive() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    if !data.is_dir() {
        assert!(std::env::var("CI").as_deref() != Ok("true"), "{}", data.display());
        println!("skipped: {} is missing", data.display());
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    fs::create_dir(&from).unwrap();
    // Three platforms: with velocities, at 6.5 Hz, without velocities.
    for (folder, begin) in [
        ("robotino", "one_surface_type_brown_surface_exp0"),
        ("borealtc_husky", "ICE_0"),
        ("ase_rover", "baseline_on_track_0"),
    ] {
        let all = crate::files(&data.join(folder)).into_iter();
        let begins =
            |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with(begin);
        for path in all.filter(begins).take(3) {
            fs::copy(&path, from.join(path.file_name().unwrap())).unwrap();
        }
    }
    let archive = exported(&from, place.path());
    same("analyze --native --format json", &from, &archive, &[]);
    let model = model();
    let words = "eval --format json --resamples 0 --horizons 1,10 --model";
    let with = |folder: &Path| joulebus(words, &[&model, folder]);
    let (recordings, read) = (with(&from), with(&archive));
    assert_eq!(recordings.code(), Some(0), "{}", recordings.errors());
    assert_eq!(read.text(), recordings.text(), "{}", read.errors());
}

#[test]
fn an_archive_is_played_as_the_recordings_in_their_order() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    fs::create_dir_all(&from).unwrap();
    for number in 0..3 {
        full(&from, &format!("run_{number}.csv"), 60 + number, number);
    }
    let archive = exported(&from, place.path());
    let root = format!("/dev/shm/jbarc-{}", std::process::id());
    let fleet = place.path().join("fleet.toml");
    let text = format!(
        "[fleet]\nname = \"archive\"\ncapacity = 20\n[domain]\nroot = \"{root}\"\nprefix = \"jbarc_\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n"
    );
    fs::write(&fleet, text).unwrap();
    let played = |folder: &Path| {
        let words = "publish trial --no-wait --rate 1000 --format json --first-robot 4 --config";
        let ended = joulebus(words, &[&fleet, folder]).exits(0);
        let report = ended.json();
        (report["trials"].clone(), report["samples_sent"].clone())
    };
    let expected = played(&from);
    assert_eq!(expected.1, 60 + 61 + 62);
    assert_eq!(played(&archive), expected);
    let _ = fs::remove_dir_all(root);
}

#[test]
fn simulated_trials_in_arrays_are_exported_whole() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    joulebus("data simulate --steps 500", &[&from]).exits(0);
    let arrays = crate::files(&from);
    assert_eq!(arrays.len(), 6 + 7);
    let archive = exported(&from, place.path());
    let listed = listings(&archive).unwrap();
    assert_eq!(listed.len(), arrays.len());
    for listing in listed {
        let read = Table::read(&listing).unwrap();
        let original = Table::read(read.path()).unwrap();
        assert!(original.path().extension().is_some_and(|end| end == "npy"));
        assert_eq!(format!("{read:?}"), format!("{original:?}"));
    }
    same("analyze --format json", &from, &archive, &[]);
}
