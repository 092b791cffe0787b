//! Archives from untrusted sources.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_dataset::trial::{Table, TrialError};

use crate::recordings::{capture, full};
use crate::{export, export_mixed, files, joulebus, parquet};
use joulebus_testkit::assert_contains;

fn archive(place: &Path) -> PathBuf {
    let recordings = [full(place, "a.csv", 120, 1), capture(place, "b.mcap", 120, 2)];
    let folder = place.join("archive");
    let paths: Vec<&Path> = recordings.iter().map(AsRef::as_ref).collect();
    export_mixed(&paths, &folder).exits(0);
    folder
}

/// The refusal of an archive that must not be read.
fn refusal(folder: &Path) -> String {
    let ended = joulebus("data info", &[folder]);
    assert_eq!(ended.code(), Some(1), "{}", ended.text());
    let errors = ended.errors();
    assert!(!errors.contains("panicked"), "{errors}");
    errors
}

#[test]
fn a_file_cut_short_or_changed_is_named_before_it_is_decoded() {
    let place = tempfile::tempdir().unwrap();
    let folder = archive(place.path());
    let file = parquet(&folder).remove(0);
    let whole = fs::read(&file).unwrap();
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    let message = refusal(&folder);
    assert_contains(&message, ["damaged", ".parquet"]);
    let mut changed = whole.clone();
    changed[whole.len() / 3] ^= 1;
    fs::write(&file, &changed).unwrap();
    assert!(refusal(&folder).contains("checksum"));
    fs::remove_file(&file).unwrap();
    let message = refusal(&folder);
    assert_contains(&message, ["is missing", "day="]);
}

#[test]
fn pipes_folders_and_links_in_the_place_of_files_do_not_block_or_leave_the_archive() {
    let place = tempfile::tempdir().unwrap();
    let folder = archive(place.path());
    let file = parquet(&folder).remove(0);
    let whole = fs::read(&file).unwrap();
    fs::remove_file(&file).unwrap();
    assert!(Command::new("mkfifo").arg(&file).status().unwrap().success());
    assert!(refusal(&folder).contains("named pipe"));
    fs::remove_file(&file).unwrap();
    fs::create_dir(&file).unwrap();
    assert!(refusal(&folder).contains("directory"));
    fs::remove_dir(&file).unwrap();
    // A link to the same bytes is read, because the checksum decides.
    let elsewhere = place.path().join("elsewhere");
    fs::write(&elsewhere, &whole).unwrap();
    symlink(&elsewhere, &file).unwrap();
    assert_eq!(joulebus("data info", &[&folder]).code(), Some(0));
    let listing = folder.join("_joulebus/000000.recording");
    let text = fs::read_to_string(&listing).unwrap();
    for named in ["/etc/passwd", "../elsewhere", "a/../../elsewhere"] {
        let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
        value["trials"][0]["file"] = named.into();
        fs::write(&listing, value.to_string()).unwrap();
        let message = refusal(&folder);
        assert!(message.contains("not below the archive"), "{message}");
    }
    for (text, part) in
        [("", "no listing"), ("{\"schema\":9,\"name\":\"a\",\"trials\":[]}", "schema 9")]
    {
        fs::write(&listing, text).unwrap();
        assert!(refusal(&folder).contains(part));
    }
}

#[test]
fn parquet_of_other_programs_and_of_other_schemas_is_refused_with_the_remedy() {
    let place = tempfile::tempdir().unwrap();
    let folder = archive(place.path());
    let whole = fs::read(&parquet(&folder)[0]).unwrap();
    let alone = place.path().join("alone.parquet");
    let refused = |bytes: &[u8]| {
        fs::write(&alone, bytes).unwrap();
        match Table::read(&alone) {
            Err(error @ TrialError::Archive { .. }) => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    fs::write(&alone, &whole).unwrap();
    assert!(Table::read(&alone).is_ok());
    // The schema's key, and its value after it.
    let key = b"joulebus.schema";
    let at = whole.windows(key.len()).position(|bytes| bytes == key).unwrap();
    let mut other = whole.clone();
    other[at] = b'x';
    let message = refused(&other);
    assert_contains(&message, ["another program", "CSV"]);
    let mut other = whole.clone();
    let value = at + key.len() + 2;
    assert_eq!(other[value], b'1');
    other[value] = b'7';
    let message = refused(&other);
    assert_contains(&message, ["\"7\"", "allowed is 1"]);
    // A column of another name.
    let name = b"voltage_mV";
    let mut other = whole.clone();
    let places: Vec<usize> =
        (0..whole.len() - name.len()).filter(|at| whole[*at..].starts_with(name)).collect();
    for at in places {
        other[at] = b'V';
    }
    let message = refused(&other);
    assert_contains(
        &message,
        ["found OPTIONAL DOUBLE Voltage_mV, allowed is OPTIONAL DOUBLE voltage_mV"],
    );
    let mut other = b"PAR1".to_vec();
    other.extend([0; 100]);
    refused(&other);
    refused(b"PAR1");
}

#[test]
fn no_byte_that_is_changed_and_no_cut_ends_the_reader_or_changes_a_value() {
    let place = tempfile::tempdir().unwrap();
    let folder = archive(place.path());
    let whole = fs::read(&parquet(&folder)[0]).unwrap();
    let alone = place.path().join("alone.parquet");
    fs::write(&alone, &whole).unwrap();
    let written = format!("{:?}", Table::read(&alone).unwrap());
    let mut read = 0;
    let mut try_one = |bytes: &[u8]| {
        fs::write(&alone, bytes).unwrap();
        // Statistics, for instance, are not read.
        if let Ok(found) = Table::read(&alone) {
            read += 1;
            assert_eq!(format!("{found:?}"), written);
        }
    };
    for cut in (0..whole.len()).step_by(37) {
        try_one(&whole[..cut]);
    }
    let mut seed = 7_u64;
    for round in 0..4_000 {
        let mut bytes = whole.clone();
        for _ in 0..=round % 3 {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // Most changes are in the footer and the headers of pages, where counts are.
            let at = match round % 2 {
                0 => (seed >> 33) as usize % whole.len(),
                _ => whole.len() - 1 - (seed >> 33) as usize % (whole.len() / 3),
            };
            bytes[at] = match round % 5 {
                0 => 0xff,
                1 => 0x7f,
                _ => (seed >> 24) as u8,
            };
        }
        try_one(&bytes);
    }
    println!("figure: {read} of 4,000 changed files were read");
}

#[test]
fn a_name_that_is_hostile_stays_in_its_partition() {
    let place = tempfile::tempdir().unwrap();
    let recording = place.path().join("a.csv");
    let rows: String = (0..20).map(|row| format!("../../../up\u{1b}[2J,{row},1.5\n")).collect();
    fs::write(&recording, format!("robot_id,time_s,power_W\n{rows}")).unwrap();
    let before = files(place.path()).len();
    let folder = place.path().join("archive");
    assert_eq!(export(&[&recording], &folder).code(), Some(0));
    assert_eq!(files(place.path()).len(), before + files(&folder).len());
    joulebus("data info --format json", &[&folder]).exits(0);
}

#[test]
fn links_in_an_archive_are_not_followed_by_an_export_and_numbers_without_a_next_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let further = full(place.path(), "c.csv", 50, 3);
    let elsewhere = place.path().join("elsewhere");
    let begin = |name: &str| {
        let _ = fs::remove_dir_all(&elsewhere);
        fs::create_dir(&elsewhere).unwrap();
        fs::write(elsewhere.join("letter"), "dear").unwrap();
        let first = full(place.path(), "a.csv", 50, 1);
        let folder = place.path().join(name);
        assert_eq!(export(&[&first], &folder).code(), Some(0));
        folder
    };
    let refuses = |folder: &Path, what: &str| {
        let before = files(folder).len();
        let ended = export(&[&further], folder);
        assert_eq!(ended.code(), Some(1), "{what}: {}", ended.text());
        assert!(!ended.errors().contains("panicked"), "{}", ended.errors());
        assert_eq!(files(folder).len(), before, "{what}");
        assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 1, "{what}");
        assert_eq!(fs::read_to_string(elsewhere.join("letter")).unwrap(), "dear", "{what}");
    };

    let folder = begin("draft");
    symlink(elsewhere.join("letter"), folder.join("_joulebus/000001.part")).unwrap();
    refuses(&folder, "the draft of the listing");

    let folder = begin("partition");
    let fleet = folder.join("robot=7");
    fs::rename(&fleet, folder.join("robot=moved")).unwrap();
    symlink(&elsewhere, &fleet).unwrap();
    refuses(&folder, "a partition");

    let folder = begin("listings");
    let listings = folder.join("_joulebus");
    fs::rename(&listings, place.path().join("their listings")).unwrap();
    symlink(place.path().join("their listings"), &listings).unwrap();
    refuses(&folder, "the folder of listings");

    let folder = begin("numbers");
    let [one, last] =
        ["000000", "4294967295"].map(|name| folder.join(format!("_joulebus/{name}.recording")));
    fs::rename(one, last).unwrap();
    refuses(&folder, "the last number");
}
