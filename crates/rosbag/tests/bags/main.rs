//! Bags of rosbag2 in SQLite files: what is imported of them, and what damaged and hostile ones do.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod bag;
mod hostile;
mod other_writer;

use std::fs::{self, File};
use std::path::Path;

use joulebus_capture::import::{Imported, Mapping, import, import_files};

use bag::{Bag, convert, joulebus, text};

/// Rows of a bag as imported, through the program.
fn imported(bags: &[&Path]) -> Imported {
    let place = tempfile::tempdir().unwrap();
    let mut files: Vec<File> = Vec::new();
    for (bag, number) in bags.iter().zip(0..) {
        let out = place.path().join(format!("{number}.mcap"));
        let ended = convert(bag, &out);
        assert_eq!(ended.status.code(), Some(0), "{ended:?}");
        files.push(File::open(out).unwrap());
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
    // As ROS has it, a battery that is discharged has a negative current.
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
    // As Foxy and Humble write it.
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
        assert_eq!(found.robots[0].rows, expected.robots[0].rows);
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
    let before = ["live.db3", "live.db3-wal"].map(|name| fs::read(killed.join(name)).unwrap());
    assert_eq!(imported(&[&copy]).robots[0].row_count, 25);
    let after = ["live.db3", "live.db3-wal"].map(|name| fs::read(killed.join(name)).unwrap());
    assert!(before == after, "the bag was changed");
    bag.close();
    // Nothing appears beside a bag that has none.
    let alone = place.path().join("alone");
    fs::create_dir(&alone).unwrap();
    let path = alone.join("live.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..5);
    bag.close();
    imported(&[&path]);
    assert_eq!(fs::read_dir(&alone).unwrap().count(), 1);
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

    // What is missing is said, and the exit code tells.
    let listed =
        "  relative_file_paths:\n    - office_0.db3\n    - office_1.db3\n    - office_2.db3\n";
    fs::write(folder.join("metadata.yaml"), listed).unwrap();
    fs::write(folder.join("office_3.db3.zstd"), "").unwrap();
    fs::remove_file(&out).unwrap();
    let ended = import(&folder);
    assert_eq!(ended.status.code(), Some(3), "{ended:?}");
    let said = String::from_utf8(ended.stdout).unwrap();
    for expected in [
        "office_2.db3: metadata.yaml lists it",
        "zstd -d office_3.db3.zstd",
    ] {
        assert!(said.contains(expected), "{said}");
    }
    let empty = place.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let ended = import(&empty);
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    let said = String::from_utf8(ended.stderr).unwrap();
    assert!(said.contains("no .db3 or .mcap file"), "{said}");
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
    assert_eq!(
        import(alone, "bag", &Mapping::default()).unwrap().robots[0].row_count,
        20
    );
    let out = place.path().join("trials");
    let ended = joulebus(&["import", &text(&folder), "-o", &text(&out)]);
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    let said = String::from_utf8(ended.stdout).unwrap();
    assert!(said.contains("45 rows of r1"), "{said}");
}
