//! The folder: whole recordings or none, and nothing of others is touched.

use std::fs;
use std::path::{Path, PathBuf};

use joulebus_dataset::archive::{fields, listings};
use joulebus_dataset::trial::{Column, ColumnMap, Table};
use joulebus_testkit::{Child, Ended, assert_contains, run};

use crate::recordings::{capture, every_kind, full, sparse};
use crate::{LAB, export, export_as, export_mixed, files, joulebus, parquet};

#[test]
fn a_folder_with_other_files_is_refused_and_left_as_it_is() {
    let place = tempfile::tempdir().unwrap();
    let recording = full(place.path(), "a.csv", 50, 1);
    let folder = place.path().join("others");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("thesis.tex"), "mine").unwrap();
    let ended = export(&[&recording], &folder).exits(2);
    assert!(ended.errors().contains("thesis.tex"), "{}", ended.errors());
    assert_eq!(files(&folder).len(), 1);
    let file = place.path().join("a.csv");
    assert_eq!(export(&[&recording], &file).code(), Some(1));
}

#[test]
fn a_further_export_adds_and_reports_it_and_nothing_is_added_twice() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("archive");
    let first = full(place.path(), "b.csv", 50, 1);
    let second = sparse(place.path(), "a.csv", 50, 2);
    assert_eq!(export(&[&first], &folder).code(), Some(0));
    let ended = export(&[&second], &folder).exits(0);
    assert_contains(&ended.errors(), ["adding to the 1 recordings"]);
    assert_eq!(ended.json()["recordings_before"], 1);
    // In the order in which they were exported.
    let info = joulebus("data info --format json", &[&folder]).text();
    assert!(info.find("b.csv").unwrap() < info.find("a.csv").unwrap(), "{info}");
    let before = files(&folder);
    let again = export(&[&second], &folder).exits(2);
    assert!(again.errors().contains("already"), "{}", again.errors());
    assert_eq!(files(&folder), before);
    // An archive is no recording of another one.
    let other = place.path().join("other");
    assert_eq!(export(&[&folder], &other).code(), Some(2));
}

#[test]
fn recordings_before_one_that_cannot_be_read_are_whole_and_of_it_nothing_is_read() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("archive");
    let first = full(place.path(), "a.csv", 50, 1);
    let run = capture(place.path(), "b.mcap", 300, 2);
    let bytes = fs::read(&run).unwrap();
    fs::write(&run, &bytes[..bytes.len() / 2]).unwrap();
    export_mixed(&[&first, &run], &folder).exits(1);
    assert_eq!(listings(&folder).unwrap().len(), 1);
    assert_eq!(joulebus("data info", &[&folder]).code(), Some(0));
    assert_eq!(export(&[&full(place.path(), "c.csv", 50, 1)], &folder).code(), Some(0));
    assert_eq!(parquet(&folder).len(), 2);
}

#[test]
fn an_export_killed_at_any_time_leaves_whole_recordings_and_the_next_one_finishes_it() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    every_kind(&from);
    let whole = place.path().join("whole");
    assert_eq!(export_mixed(&[&from], &whole).code(), Some(0));
    for files_first in [1, 3, 6] {
        let folder = place.path().join(format!("killed-{files_first}"));
        let mut command = std::process::Command::new(LAB);
        command.arg("export").arg(&from).args(["--mixed", "--to", "parquet"]).arg(&folder);
        let mut export_process = Child::spawn("export", command);
        while export_process.is_running()
            && (!folder.exists() || files(&folder).len() < files_first)
        {
            std::thread::yield_now();
        }
        export_process.kill();
        // The listed files are read without a fault.
        let listed = listings(&folder).unwrap_or_default();
        if !listed.is_empty() {
            joulebus("data info", &[&folder]).exits(0);
        }
        // The recordings that are missing.
        let names: Vec<String> = listed
            .iter()
            .map(|path| joulebus_dataset::archive::Listing::read(path).unwrap().name)
            .collect();
        let missing = files(&from).into_iter();
        let missing: Vec<_> =
            missing.filter(|path| !names.contains(&path.display().to_string())).collect();
        if !missing.is_empty() {
            let missing: Vec<&Path> = missing.iter().map(AsRef::as_ref).collect();
            export_mixed(&missing, &folder).exits(0);
        }
        let contents = |archive: &Path| -> Vec<Vec<u8>> {
            let mut all: Vec<_> =
                parquet(archive).iter().map(|path| fs::read(path).unwrap()).collect();
            all.sort();
            all
        };
        assert_eq!(contents(&folder).len(), contents(&whole).len());
        let drafts = files(&folder).into_iter();
        let drafts = drafts.filter(|path| path.display().to_string().ends_with(".part"));
        assert_eq!(drafts.count(), 0);
    }
}

#[test]
fn an_export_that_fails_leaves_nothing_of_what_it_made() {
    let place = tempfile::tempdir().unwrap();
    let run = capture(place.path(), "b.mcap", 300, 2);
    let bytes = fs::read(&run).unwrap();
    fs::write(&run, &bytes[..bytes.len() / 2]).unwrap();
    let folder = place.path().join("archive");
    assert_eq!(export(&[&run], &folder).code(), Some(1));
    assert!(!folder.exists());
    fs::create_dir(&folder).unwrap();
    assert_eq!(export(&[&run], &folder).code(), Some(1));
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
}

#[test]
fn the_same_recordings_give_the_same_bytes() {
    let place = tempfile::tempdir().unwrap();
    let from = place.path().join("runs");
    every_kind(&from);
    let [one, other] = ["one", "other"].map(|name| {
        let folder = place.path().join(name);
        assert_eq!(export_mixed(&[&from], &folder).code(), Some(0));
        let all = files(&folder).into_iter();
        let all = all
            .map(|path| (path.strip_prefix(&folder).unwrap().to_owned(), fs::read(path).unwrap()));
        all.collect::<Vec<_>>()
    });
    assert!(one == other);
}

#[test]
fn robots_and_days_are_partitions_of_their_own() {
    let place = tempfile::tempdir().unwrap();
    let run = capture(place.path(), "run.mcap", 90, 3);
    let folder = place.path().join("archive");
    assert_eq!(export(&[&run], &folder).code(), Some(0));
    let one = folder.join("fleet=yard%203/day=2026-11-22/robot=2");
    assert_eq!(parquet(&one).len(), 1);
    // A partition is read by itself.
    let ended = joulebus("data info --format json", &[&one]).exits(0);
    assert!(ended.text().contains("run.mcap"), "{}", ended.text());
}

#[test]
fn what_no_recording_has_is_no_folder_and_an_archive_has_one_kind_unless_it_is_mixed() {
    let place = tempfile::tempdir().unwrap();
    let table = full(place.path(), "a.csv", 50, 1);
    let unnamed = place.path().join("b.csv");
    fs::write(&unnamed, "time,power_W\n0,1\n1,1.5\n2,1\n").unwrap();
    let run = capture(place.path(), "run.mcap", 90, 2);
    let folder = |name: &str| place.path().join(name);
    export(&[&unnamed], &folder("unnamed")).exits(0);
    assert!(folder("unnamed/000000-0000.parquet").exists());
    export(&[&table], &folder("tables")).exits(0);
    assert!(folder("tables/robot=7/000000-0000.parquet").exists());
    for (archive, other, expected) in [
        ("tables", &unnamed, "neither fleet nor day nor robot"),
        ("tables", &run, "fleet, day, robot"),
        ("unnamed", &table, "have neither"),
    ] {
        let before = files(&folder(archive));
        let refused = export(&[other], &folder(archive)).exits(2);
        assert_contains(
            &refused.errors(),
            [expected, "another folder", "--map robot:=NAME", "pandas and Dask"],
        );
        assert_eq!(files(&folder(archive)), before);
        joulebus("data info", &[&folder(archive)]).exits(0);
    }
    // Nor is anything written of recordings that do not fit together.
    export(&[&table, &run], &folder("both")).exits(2);
    assert!(!folder("both").exists());
    // Nor is a shallow one made deeper afterwards.
    export_mixed(&[&run], &folder("tables")).exits(2);
    // The way out for a robot without a name, and for engines that read nulls.
    let named = ["export", "--map", "robot:=r1", "b.csv", "--to", "parquet", "tables"].map(
        |word| match word {
            "b.csv" | "tables" => folder(word),
            word => word.into(),
        },
    );
    run_lab(named).exits(0);
    assert!(folder("tables/robot=r1").exists());
    export_mixed(&[&run, &table, &unnamed], &folder("mixed")).exits(0);
    assert_eq!(parquet(&folder("mixed/fleet=__HIVE_DEFAULT_PARTITION__")).len(), 2);
    export(&[&full(place.path(), "c.csv", 50, 2)], &folder("mixed")).exits(0);
}

/// Runs the program.
fn run_lab(words: impl IntoIterator<Item = PathBuf>) -> Ended {
    run(LAB, words)
}

#[test]
fn wrong_words_are_refused_with_what_is_allowed() {
    for (words, part) in [
        (&["a.csv", "--to", "arrow", "/tmp/x"][..], "parquet"),
        (&["a.csv", "--to", "parquet"], "2 values"),
        (&["--to", "parquet", "/tmp/x"], "PATH"),
        (&["a.csv", "--to", "parquet", "/tmp/x", "--map", "nonsense"], "nonsense"),
    ] {
        let ended = run(LAB, ["export"].iter().chain(words));
        assert_eq!(ended.code(), Some(2), "{words:?}: {}", ended.errors());
        assert!(ended.errors().contains(part), "{words:?}: {}", ended.errors());
    }
}

#[test]
fn the_documents_table_has_every_column_with_its_type_and_unit() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/how-to/archives.md");
    let docs = fs::read_to_string(docs).unwrap();
    for field in fields() {
        let row = format!("| `{}` | {} | {} |", field.name, field.kind.name(), field.unit);
        assert!(docs.contains(&row), "docs/how-to/archives.md lacks {row}");
    }
}

#[test]
fn parquet_files_that_no_listing_names_are_kept() {
    let place = tempfile::tempdir().unwrap();
    let [one, two, three] = [("a.csv", 1), ("b.csv", 2), ("c.csv", 3)]
        .map(|(name, seed)| full(place.path(), name, 50, seed));
    let [folder, other] = ["archive", "other"].map(|name| place.path().join(name));
    assert_eq!(export(&[&one, &two], &folder).code(), Some(0));
    assert_eq!(export(&[&three, &two, &one], &other).code(), Some(0));
    // Partitions of another archive, whose numbers are taken, next or far ahead; and a listing that
    // got lost.
    let mut kept = Vec::new();
    for (at, file) in parquet(&other).into_iter().enumerate() {
        let partition = folder.join(format!("fleet=yard/day=2026-11-{:02}/robot=7", at + 1));
        fs::create_dir_all(&partition).unwrap();
        kept.push(partition.join(file.file_name().unwrap()));
        fs::copy(&file, &kept[at]).unwrap();
    }
    kept.extend(parquet(&folder));
    fs::remove_file(folder.join("_joulebus/000000.recording")).unwrap();
    export(&[&three], &folder).exits(0);
    assert!(kept.iter().all(|file| file.exists()), "{kept:?}");
}

/// A capture has joulebus's sign: only the caller turns it.
#[test]
fn a_capture_is_turned_if_the_caller_asks_for_it_and_never_by_a_config() {
    let place = tempfile::tempdir().unwrap();
    let run = capture(place.path(), "a.mcap", 300, 1);
    let read = |path: &Path, map: &ColumnMap| -> Vec<f64> {
        let tables = Table::read_mapped(path, map).unwrap();
        let currents = tables.iter().filter_map(|one| one.column(Column::Current));
        currents.flatten().copied().collect()
    };
    let sum = |values: Vec<f64>| {
        values.into_iter().filter(|one| !one.is_nan()).fold(0.0, |sum, one| sum + one)
    };
    let own = ColumnMap::default();
    let original = sum(read(&run, &own));
    assert!(original > 0.0);
    for (number, options, sign) in
        [(0, &[][..], 1.0), (1, &["--current", "discharge-negative"][..], -1.0)]
    {
        let folder = place.path().join(format!("archive{number}"));
        export_as(options, &[&run], &folder).exits(0);
        let listing = listings(&folder).unwrap().remove(0);
        assert_eq!(sum(read(&listing, &own)), sign * original);
        let configured = own.clone().configured_discharge_negative(true);
        assert_eq!(sum(read(&listing, &configured)), sign * original);
        let turned = own.clone().discharge_negative(true);
        assert_eq!(sum(read(&listing, &turned)), -sign * original);
    }
    let configured = own.configured_discharge_negative(true);
    assert_eq!(sum(read(&run, &configured)), original);
}

#[test]
fn lines_that_are_left_out_are_counted_and_the_exit_code_shows_it() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("cut.csv");
    fs::write(&path, "timestamp_s,power_mW\n0,4500\n1,4600\n2,4700\n3,\0\0\n").unwrap();
    let folder = place.path().join("archive");
    let ended = export_as(&["--whole-rows"], &[&path], &folder).exits(3);
    assert_eq!(ended.json()["left_out_lines"], 1);
    assert_eq!(ended.json()["rows"], 3);
    assert_contains(&ended.errors(), ["cut.csv", "1 lines", "NUL"]);
}
