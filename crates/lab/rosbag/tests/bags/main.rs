//! Bags of rosbag2 in SQLite files: their import, and the refusal of damaged and hostile ones.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod bag;
mod hostile;
mod other_writer;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use joulebus_capture_format::import::{Imported, Mapping, import, import_files};
use joulebus_testkit::{assert_contains, eventually, lab_beside};

use bag::{Bag, convert, joulebus, text};

/// Rows of a bag as imported, through the program.
fn imported(bags: &[&Path]) -> Imported {
    let place = tempfile::tempdir().unwrap();
    let mut files: Vec<(String, File)> = Vec::new();
    for (bag, number) in bags.iter().zip(0..) {
        let out = place.path().join(format!("{number}.mcap"));
        let ended = convert(bag, &out);
        assert_eq!(ended.status.code(), Some(0), "{ended:?}");
        files.push((number.to_string(), File::open(out).unwrap()));
    }
    import_files(&mut files, "bag", &Mapping::default()).unwrap()
}

#[test]
fn readings_commands_and_odometry_of_a_bag_become_rows() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag_0.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..50);
    bag.close();
    let imported = imported(&[&path]);
    let [robot] = &imported.robots[..] else {
        panic!("{imported:?}");
    };
    assert!(imported.is_whole(), "{imported:?}");
    assert_eq!(robot.name, "r1");
    assert_eq!((robot.row_count, robot.battery.messages), (50, 50));
    let row = &robot.rows[20];
    assert_eq!(row.time_ns, bag::time_ns(20));
    assert!((row.voltage_v - 12.0).abs() < 1e-6, "{row:?}");
    // In ROS the current is negative while a battery is discharged.
    assert!((row.current_a - 0.7).abs() < 1e-6, "{row:?}");
    assert!((row.power_w - 8.4).abs() < 1e-5, "{row:?}");
    assert!((row.v_mps - 0.20).abs() < 1e-9, "{row:?}");
    assert!((row.x_m - 20.0).abs() < 1e-9, "{row:?}");
    // Counted by type, though their contents are not copied.
    assert_eq!(imported.others["sensor_msgs/msg/Image"], 50);
}

#[test]
fn a_bag_without_definitions_and_one_whose_messages_are_compressed_have_the_same_rows() {
    let place = tempfile::tempdir().unwrap();
    let rows = |name: &str, make: &dyn Fn(&mut Bag)| {
        let path = place.path().join(name);
        let mut bag = Bag::create(&path);
        make(&mut bag);
        bag.drive(0..30);
        bag.close();
        let imported = imported(&[&path]);
        assert!(imported.is_whole(), "{name}: {imported:?}");
        format!("{:?}", imported.robots[0].rows)
    };
    let plain = rows("plain.db3", &|_| {});
    // The format of Foxy and Humble.
    let old = rows("old.db3", &|bag| bag.run("DROP TABLE message_definitions"));
    let compressed = rows("compressed.db3", &|bag| bag.compress = true);
    let unnamed = rows("no extension, ä?#%.db3", &|_| {});
    assert!(plain.len() > 1_000);
    assert!(plain == old && plain == compressed && plain == unnamed);
}

#[test]
fn a_bag_that_was_split_is_one_recording() {
    let place = tempfile::tempdir().unwrap();
    let [whole, first, second] =
        ["whole", "first", "second"].map(|name| place.path().join(format!("{name}.db3")));
    for (path, steps) in [(&whole, 0..60), (&first, 0..37), (&second, 37..60)] {
        let mut bag = Bag::create(path);
        bag.drive(steps);
        bag.close();
    }
    let expected = imported(&[&whole]);
    for order in [[&*first, &*second], [&*second, &*first]] {
        let found = imported(&order);
        assert_eq!(found.robots.len(), 1);
        // A current of exactly −1 A is unknown, and NaN equals nothing.
        let rows = |imported: &Imported| format!("{:?}", imported.robots[0].rows);
        assert_eq!(rows(&found), rows(&expected));
        assert_eq!(found.others, expected.others);
    }
}

#[test]
fn a_bag_with_a_log_beside_it_is_read_whole_and_not_changed() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("live.db3");
    let mut bag = Bag::create(&path);
    bag.run("PRAGMA journal_mode = WAL; PRAGMA wal_autocheckpoint = 0");
    bag.drive(0..25);
    // Its recorder is killed: the log stays.
    let killed = place.path().join("killed");
    fs::create_dir(&killed).unwrap();
    for end in ["", "-wal"] {
        let name = format!("live.db3{end}");
        fs::copy(place.path().join(&name), killed.join(&name)).unwrap();
    }
    let copy = killed.join("live.db3");
    assert!(fs::metadata(killed.join("live.db3-wal")).unwrap().len() > 0);
    let before = contents(&killed);
    assert_eq!(imported(&[&copy]).robots[0].row_count, 25);
    assert!(before == contents(&killed), "the bag was changed");
    // The index that its recorder left is used and stays.
    let name = "live.db3-shm";
    fs::copy(place.path().join(name), killed.join(name)).unwrap();
    assert_eq!(imported(&[&copy]).robots[0].row_count, 25);
    let names = |folder: &Path| contents(folder).into_keys().collect::<Vec<_>>();
    assert_eq!(names(&killed), ["live.db3", "live.db3-shm", "live.db3-wal"]);
    bag.close();
    // No file appears beside a bag that has none.
    let alone = place.path().join("alone");
    fs::create_dir(&alone).unwrap();
    let path = alone.join("live.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..5);
    bag.close();
    imported(&[&path]);
    assert_eq!(fs::read_dir(&alone).unwrap().count(), 1);
}

/// The files of a folder.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    let file = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().unwrap();
        (name, fs::read(entry.path()).unwrap())
    };
    entries.map(file).collect()
}

#[test]
fn a_bag_whose_recorder_was_killed_within_a_change_names_its_journal() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("live.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..10);
    // More than SQLite keeps in memory: it changes the file before the change is whole.
    bag.run("PRAGMA cache_size = 2; BEGIN");
    for step in 10..60 {
        bag.raw(4, bag::time_ns(step), &[7; 30_000]);
    }
    let killed = place.path().join("killed");
    fs::create_dir(&killed).unwrap();
    for name in ["live.db3", "live.db3-journal"] {
        fs::copy(place.path().join(name), killed.join(name)).unwrap();
    }
    bag.run("COMMIT");
    bag.close();
    let copy = killed.join("live.db3");
    let before = contents(&killed);
    let ended = convert(&copy, &place.path().join("out.mcap"));
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    let message = String::from_utf8(ended.stderr).unwrap();
    assert_contains(&message, ["killed/live.db3-journal", "PRAGMA quick_check"]);
    assert!(before == contents(&killed), "the bag was changed");
    // The message contains the remedy.
    let sqlite = rusqlite::Connection::open(&copy).unwrap();
    sqlite.query_row("PRAGMA quick_check", [], |row| row.get::<_, String>(0)).unwrap();
    sqlite.close().unwrap();
    let imported = imported(&[&copy]);
    assert_eq!(imported.others["sensor_msgs/msg/Image"], 10);
}

#[test]
fn a_journal_that_is_over_does_no_harm() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.run("PRAGMA journal_mode = PERSIST");
    bag.drive(0..10);
    bag.close();
    let journal = place.path().join("bag.db3-journal");
    assert!(fs::metadata(&journal).unwrap().len() > 0);
    assert_eq!(imported(&[&path]).robots[0].row_count, 10);
    for head in [&b"\xd9\xd5"[..], b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7\0\0\0\0"] {
        fs::write(&journal, head).unwrap();
        assert_eq!(imported(&[&path]).robots[0].row_count, 10);
    }
}

#[test]
fn an_odd_row_of_the_topics_costs_its_own_messages_alone() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..10);
    bag.run(
        "CREATE TABLE other AS SELECT * FROM topics; DROP TABLE topics; ALTER TABLE other RENAME TO topics; \
         UPDATE topics SET type = NULL WHERE id = 4; INSERT INTO topics SELECT 'five', name, type, \
         serialization_format, '', '' FROM topics WHERE id = 2; CREATE TABLE d AS SELECT * FROM message_definitions; \
         DROP TABLE message_definitions; ALTER TABLE d RENAME TO message_definitions; \
         INSERT INTO message_definitions VALUES (2, 'nav_msgs/msg/Odometry', NULL, NULL, '')",
    );
    bag.close();
    let out = place.path().join("out.mcap");
    let ended = convert(&path, &out);
    assert_eq!(ended.status.code(), Some(3), "{ended:?}");
    let message = String::from_utf8(ended.stderr).unwrap();
    let parts = "2 topics left out: id is no integer, or name, type or encoding no text | \
        10 messages left out: of a topic that the bag does not name";
    assert_contains(&message, parts.split(" | "));
    let found = import(File::open(&out).unwrap(), "bag", &Mapping::default()).unwrap();
    assert_eq!(found.robots[0].row_count, 10);
}

#[test]
fn standard_output_is_written_if_it_is_an_empty_file() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..10);
    bag.close();
    let [named, redirected] = ["named.mcap", "redirected.mcap"].map(|name| place.path().join(name));
    assert_eq!(convert(&path, &named).status.code(), Some(0));
    let to = |out: Stdio| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-rosbag"));
        command.arg(&path).args(["-o", "-"]).stdout(out);
        command.stderr(Stdio::piped()).spawn().unwrap().wait_with_output().unwrap()
    };
    let ended = to(File::create(&redirected).unwrap().into());
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    assert!(fs::read(&named).unwrap() == fs::read(&redirected).unwrap());
    for out in [Stdio::piped(), File::options().append(true).open(&named).unwrap().into()] {
        let ended = to(out);
        assert_eq!(ended.status.code(), Some(1), "{ended:?}");
        assert!(ended.stdout.is_empty(), "{ended:?}");
        let message = String::from_utf8(ended.stderr).unwrap();
        assert!(message.contains("no empty file"), "{message}");
    }
}

/// A folder with `joulebus-lab` and a reader of bags that writes, reports that, and does not end.
fn slow_reader(place: &Path) -> PathBuf {
    // Another process writes the script. A program that any process has open for writing cannot be
    // started, and processes that other tests start inherit the open files of this one.
    let script = "cp \"$1\" joulebus-lab && cat > joulebus-rosbag && chmod +x joulebus-rosbag";
    let reader = "#!/bin/sh\necho MCAP\ncd \"${0%/*}\"\necho $$ > begun.new\nmv begun.new begun\ncat > /dev/null\n";
    let mut make = Command::new("sh");
    make.args(["-c", script, "sh"]).current_dir(place);
    make.arg(lab_beside(env!("CARGO_BIN_EXE_joulebus-rosbag")));
    let mut make = make.stdin(Stdio::piped()).spawn().unwrap();
    let mut input = make.stdin.take().unwrap();
    input.write_all(reader.as_bytes()).unwrap();
    drop(input);
    assert!(make.wait().unwrap().success());
    place.join("joulebus-lab")
}

#[test]
fn an_import_that_is_ended_leaves_no_file_and_no_process() {
    // Not SIGINT, which a shell in the background has its programs ignore.
    for signal in ["-TERM", "-KILL"] {
        let place = tempfile::tempdir().unwrap();
        let temporary = place.path().join("tmp");
        fs::create_dir(&temporary).unwrap();
        let bag = place.path().join("bag.db3");
        fs::write(&bag, "").unwrap();
        let mut import = Command::new(slow_reader(place.path()));
        import.arg("import").arg(&bag).arg("-o").arg(place.path().join("out"));
        let mut import = import.env("TMPDIR", &temporary).spawn().unwrap();
        let begun = place.path().join("begun");
        eventually("the reader has begun", || begun.exists());
        let reader = fs::read_to_string(&begun).unwrap();
        let killed = Command::new("kill").args([signal, &import.id().to_string()]).status();
        assert!(killed.unwrap().success());
        assert_eq!(import.wait().unwrap().code(), None);
        // Empty once the reader has ended, even before its exit code is collected.
        let words = Path::new("/proc").join(reader.trim()).join("cmdline");
        eventually("the reader has ended", || fs::read(&words).unwrap_or_default().is_empty());
        assert_eq!(contents(&temporary), BTreeMap::new(), "{signal}");
    }
}

#[test]
fn a_file_that_was_unpacked_beside_its_compressed_one_counts_once() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("office");
    fs::create_dir(&folder).unwrap();
    let path = folder.join("office_0.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..20);
    bag.close();
    let compressed = zstd::bulk::compress(&fs::read(&path).unwrap(), 3).unwrap();
    fs::write(folder.join("office_0.db3.zstd"), compressed).unwrap();
    let out = place.path().join("robot.csv");
    for listed in ["office_0.db3.zstd", "office_0.db3"] {
        let text_of = format!("  relative_file_paths:\n    - {listed}\n");
        fs::write(folder.join("metadata.yaml"), text_of).unwrap();
        let ended = joulebus(&["import", &text(&folder), "-o", &text(&out)]);
        assert_eq!(ended.status.code(), Some(0), "{ended:?}");
        assert_eq!(fs::read_to_string(&out).unwrap().lines().count(), 1 + 20);
        fs::remove_file(&out).unwrap();
    }
    // One that is compressed only is named once.
    fs::rename(&path, folder.join("office_1.db3")).unwrap();
    let ended = joulebus(&["import", &text(&folder), "-o", &text(&out)]);
    assert_eq!(ended.status.code(), Some(3), "{ended:?}");
    let message = String::from_utf8(ended.stdout).unwrap();
    assert_eq!(message.matches("left out").count(), 1, "{message}");
    assert!(message.contains("zstd -d office_0.db3.zstd"), "{message}");
}

#[test]
fn joulebus_imports_files_and_folders() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("office");
    fs::create_dir(&folder).unwrap();
    for (name, steps) in [("office_0.db3", 0..20), ("office_1.db3", 20..45)] {
        let mut bag = Bag::create(&folder.join(name));
        bag.drive(steps);
        bag.close();
    }
    let out = place.path().join("robot.csv");
    let import =
        |bag: &Path| joulebus(&["import", &text(bag), "-o", &text(&out), "--format", "json"]);
    let ended = import(&folder);
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    let lines = fs::read_to_string(&out).unwrap().lines().count();
    assert_eq!(lines, 1 + 45);
    fs::remove_file(&out).unwrap();
    let ended = import(&folder.join("office_1.db3"));
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    assert_eq!(fs::read_to_string(&out).unwrap().lines().count(), 1 + 25);

    // Missing parts are listed, and the exit code shows them.
    let listed =
        "  relative_file_paths:\n    - office_0.db3\n    - office_1.db3\n    - office_2.db3\n";
    fs::write(folder.join("metadata.yaml"), listed).unwrap();
    fs::write(folder.join("office_3.db3.zstd"), "").unwrap();
    fs::remove_file(&out).unwrap();
    let ended = import(&folder);
    assert_eq!(ended.status.code(), Some(3), "{ended:?}");
    let message = String::from_utf8(ended.stdout).unwrap();
    assert_contains(
        &message,
        "office_2.db3: metadata.yaml lists it | zstd -d office_3.db3.zstd".split(" | "),
    );
    let empty = place.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let ended = import(&empty);
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    let message = String::from_utf8(ended.stderr).unwrap();
    assert!(message.contains("no .db3 or .mcap file"), "{message}");
}

#[test]
fn a_folder_of_mcap_files_is_one_recording() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("bag");
    fs::create_dir(&folder).unwrap();
    for (number, steps) in [(0, 0..20), (1, 20..45)] {
        let path = place.path().join(format!("{number}.db3"));
        let mut bag = Bag::create(&path);
        bag.drive(steps);
        bag.close();
        let ended = convert(&path, &folder.join(format!("bag_{number}.mcap")));
        assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    }
    let alone = File::open(folder.join("bag_0.mcap")).unwrap();
    assert_eq!(import(alone, "bag", &Mapping::default()).unwrap().robots[0].row_count, 20);
    let out = place.path().join("trials");
    let ended = joulebus(&["import", &text(&folder), "-o", &text(&out)]);
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    let message = String::from_utf8(ended.stdout).unwrap();
    assert!(message.contains("45 rows of r1"), "{message}");
    // A last file that a loss of power left empty is named, and the others are read.
    fs::write(folder.join("bag_2.mcap"), "").unwrap();
    let out = place.path().join("whole");
    let ended = joulebus(&["import", &text(&folder), "-o", &text(&out)]);
    assert_eq!(ended.status.code(), Some(3), "{ended:?}");
    let message = String::from_utf8(ended.stdout).unwrap();
    assert_contains(&message, ["45 rows of r1", "bag_2.mcap: byte 0: found an empty file"]);
}
