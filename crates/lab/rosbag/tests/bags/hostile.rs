//! Damaged and hostile files: an error or a count, never a panic, and never more memory than a
//! message may take.

use std::fs;
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

use crate::bag::{Bag, convert, time_ns};
use joulebus_testkit::assert_contains;

fn message(ended: &Output) -> String {
    String::from_utf8_lossy(&ended.stderr).into_owned()
}

/// Converts a file; it ends by itself with one of the documented codes.
fn code_of(bag: &Path) -> (i32, String) {
    let place = tempfile::tempdir().unwrap();
    let ended = convert(bag, &place.path().join("out.mcap"));
    let code = ended.status.code().unwrap_or_else(|| panic!("killed: {ended:?}"));
    assert!([0, 1, 3].contains(&code), "{ended:?}");
    assert_eq!(code == 0, message(&ended).is_empty(), "{ended:?}");
    (code, message(&ended))
}

fn small_bag(path: &Path) -> Vec<u8> {
    let mut bag = Bag::create(path);
    bag.drive(0..12);
    bag.close();
    fs::read(path).unwrap()
}

#[test]
fn a_bag_cut_at_any_page_or_within_is_refused_or_what_is_lost_is_reported() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let whole = small_bag(&path);
    let pages = (0..whole.len()).step_by(4_096);
    let around = pages.flat_map(|page| [page, page + 1, page + 100, page + 2_047]);
    let mut codes = [0_u32; 4];
    for length in around.filter(|length| *length < whole.len()) {
        fs::write(&path, &whole[..length]).unwrap();
        let (code, message) = code_of(&path);
        assert_ne!(code, 0, "{length} of {} bytes: {message}", whole.len());
        codes[code as usize] += 1;
    }
    println!("figure: {} bytes, cut: exit codes {codes:?}", whole.len());
}

#[test]
fn a_changed_byte_does_no_harm() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let whole = small_bag(&path);
    // The head and the schema, then heads of pages and cells, then anywhere.
    let heads = (0..whole.len()).step_by(4_096);
    let heads = heads.flat_map(|page| [0, 1, 3, 5, 8, 9].map(|at| page + at));
    let places = (0..108).chain(heads).chain((0..whole.len()).step_by(1_021));
    let mut codes = [0_u32; 4];
    for (at, number) in places.zip((0_u8..=u8::MAX).cycle()) {
        let mut changed = whole.clone();
        changed[at] ^= [0xff, 0x80, 0x01][usize::from(number % 3)];
        fs::write(&path, &changed).unwrap();
        codes[code_of(&path).0 as usize] += 1;
    }
    println!("figure: {codes:?} of the exit codes 0 to 3");
    assert!(codes.iter().sum::<u32>() > 200);
}

#[test]
fn what_is_no_bag_is_refused_with_the_reason() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    for (bytes, why) in [
        (&b""[..], "is no SQLite file: it begins with []"),
        (b"SQLite format", "is no SQLite file"),
        (b"\x89MCAP0\r\n and so on, long enough", "is no SQLite file"),
        (b"SQLite format 3\0", "cannot read"),
    ] {
        fs::write(&path, bytes).unwrap();
        let (code, message) = code_of(&path);
        assert_eq!(code, 1, "{message}");
        assert!(message.contains(why), "{message}");
    }
    let (code, message) = code_of(&place.path().join("missing.db3"));
    assert!(code == 1 && message.contains("missing.db3"), "{message}");
    let (code, message) = code_of(place.path());
    assert!(code == 1 && message.contains("is a directory"), "{message}");
}

#[test]
fn only_tables_are_read_and_nothing_that_computes() {
    // Without end, or of any size, if it were read.
    let endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) \
                   SELECT 1 AS topic_id, x AS timestamp, zeroblob(100000) AS data FROM n";
    for (what, sql) in [
        ("a view", format!("DROP TABLE messages; CREATE VIEW messages AS {endless}")),
        (
            "a computed column",
            "DROP TABLE messages; CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER, \
             data BLOB AS (zeroblob(1000000000)))"
                .to_owned(),
        ),
        ("no messages", "DROP TABLE messages".to_owned()),
        ("other columns", "ALTER TABLE messages RENAME COLUMN data TO bytes".to_owned()),
        (
            "a view of topics",
            "DROP TABLE topics; CREATE VIEW topics AS SELECT 1 AS id, 'a' AS name, 'b' AS type, \
             'cdr' AS serialization_format"
                .to_owned(),
        ),
    ] {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("bag.db3");
        let mut bag = Bag::create(&path);
        bag.run(&sql);
        bag.close();
        let began = Instant::now();
        let (code, message) = code_of(&path);
        assert_eq!(code, 1, "{what}: {message}");
        assert!(message.contains("is no bag of rosbag2"), "{what}: {message}");
        assert!(began.elapsed() < Duration::from_secs(100), "{what}");
    }
}

#[test]
fn rows_that_are_no_messages_are_counted_by_reason() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..10);
    bag.run(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES \
         (1, -5, x'00'), (1, 'soon', x'00'), (1, 5, 'text'), (77, 5, x'00'), (78, 5, x'00')",
    );
    let mut bomb = zstd::bulk::compress(&vec![0; 50 << 20], 19).unwrap();
    bag.raw(1, time_ns(11), &bomb);
    bomb.truncate(20);
    bag.raw(1, time_ns(12), &bomb);
    bag.close();
    let (code, message) = code_of(&path);
    assert_eq!(code, 3, "{message}");
    let parts = "1 messages left out: its time is before 1970 | \
        2 messages left out: topic and time are no integers | \
        2 messages left out: of a topic that the bag does not name | \
        messages left out: compressed: ";
    assert_contains(&message, parts.split(" | "));
}

#[test]
fn a_message_larger_than_allowed_ends_the_bag_without_taking_its_memory() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.drive(0..10);
    bag.run("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 5, zeroblob(268435457))");
    bag.close();
    let (code, message) = code_of(&path);
    assert_eq!(code, 3, "{message}");
    assert_contains(&message, ["this one and all after it: string or blob too big"]);
}

/// An inner page of a table's tree, all of whose cells name the page `child`.
fn inner_page(child: u32, cells: u16) -> Vec<u8> {
    let mut page = vec![0; PAGE];
    let first = PAGE - usize::from(cells) * 5;
    page[0] = 5;
    page[3..5].copy_from_slice(&cells.to_be_bytes());
    page[5..7].copy_from_slice(&(first as u16).to_be_bytes());
    page[8..12].copy_from_slice(&child.to_be_bytes());
    for cell in 0..usize::from(cells) {
        let at = first + cell * 5;
        page[12 + cell * 2..14 + cell * 2].copy_from_slice(&(at as u16).to_be_bytes());
        page[at..at + 4].copy_from_slice(&child.to_be_bytes());
        page[at + 4] = 1;
    }
    page
}

const PAGE: usize = 4_096;

/// The bag with the root of `table` in place of a tree of three inner pages above it: 200 to the
/// third times its rows.
fn multiplied(path: &Path, table: &str) -> Vec<u8> {
    let sqlite = rusqlite::Connection::open(path).unwrap();
    let sql = "SELECT rootpage FROM sqlite_master WHERE name = ?1";
    let root: u32 = sqlite.query_row(sql, [table], |row| row.get(0)).unwrap();
    sqlite.close().unwrap();
    let root = root as usize;
    let mut bytes = fs::read(path).unwrap();
    let pages = bytes.len() / PAGE;
    let leaf = bytes[(root - 1) * PAGE..root * PAGE].to_vec();
    assert_eq!(leaf[0], 13, "the root of a small table is a leaf");
    bytes.extend(leaf);
    for below in 0..2 {
        bytes.extend(inner_page((pages + 1 + below) as u32, 200));
    }
    let top = inner_page((pages + 3) as u32, 200);
    bytes[(root - 1) * PAGE..root * PAGE].copy_from_slice(&top);
    bytes[28..32].copy_from_slice(&((pages + 3) as u32).to_be_bytes());
    bytes
}

#[test]
fn pages_that_name_each_other_give_no_more_rows_than_a_file_can_hold() {
    for table in ["messages", "topics"] {
        let place = tempfile::tempdir().unwrap();
        let (path, out) = (place.path().join("bag.db3"), place.path().join("out.mcap"));
        let bag = Bag::create(&path);
        bag.raw(1, time_ns(0), &[7; 100]);
        bag.close();
        fs::write(&path, multiplied(&path, table)).unwrap();
        let ended = convert(&path, &out);
        let written = fs::metadata(&out).map_or(0, |file| file.len());
        let (code, message) = (ended.status.code(), message(&ended));
        assert!(matches!(code, Some(1 | 3)), "{table}: {message}");
        assert!(message.contains("than its"), "{table}: {message}");
        let most = 8 * fs::metadata(&path).unwrap().len();
        assert!(written < most, "{table}: {written} bytes, allowed {most}");
    }
}

#[test]
fn a_table_is_not_what_the_text_of_its_definition_contains() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("bag.db3");
    let mut bag = Bag::create(&path);
    bag.run(
        "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data); \
         PRAGMA writable_schema = 1; \
         UPDATE sqlite_master SET sql = replace(sql, 'CREATE VIRTUAL', 'CREATE/**/VIRTUAL') WHERE name = 'messages'",
    );
    bag.close();
    let (code, message) = code_of(&path);
    assert_eq!(code, 1, "{message}");
    assert!(message.contains("is no bag of rosbag2"), "{message}");
}
