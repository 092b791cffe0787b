//! A bag's SQLite file, opened so that neither it nor any file beside it changes.
//!
//! The file may be hostile. Only tables are read, never views or virtual tables, whose definitions
//! may compute anything. Values are limited in size, and their sum to the size of the file, because
//! SQLite follows pages that refer to each other. Rows must have the types that rosbag2 writes, or
//! are counted.

use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags};

/// Largest message or text, bytes. SQLite refuses larger ones.
pub(crate) const MAX_BYTES: i32 = 256 << 20;
/// Largest text of a topic or a definition, bytes.
const MAX_TEXT_BYTES: i32 = 1 << 20;
/// The start of a rollback journal with pages.
const JOURNAL_MAGIC: &[u8] = &[0xd9, 0xd5, 0x05, 0xf9, 0x20, 0xa1, 0x63, 0xd7];
/// Bytes of a journal's head up to the count of its pages, with it.
const JOURNAL_HEAD: usize = JOURNAL_MAGIC.len() + 4;
/// Minimum size of a row, bytes: the headers of its cell and of its record.
const MIN_ROW_BYTES: u64 = 4;
/// Maximum number of topics of a bag. An MCAP file has no more channels.
const MAX_TOPICS: usize = 65_535;
/// The start of an SQLite file.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Errors of opening a bag.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BagError {
    /// The file cannot be read.
    #[error("cannot read {path:?}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The file is no SQLite database.
    #[error("{path:?} is no SQLite file: it begins with {found:02x?}")]
    Kind {
        /// The file.
        path: PathBuf,
        /// Its first bytes.
        found: Vec<u8>,
    },
    /// Its writer was stopped within a change, which only a writer can undo.
    #[error(
        "{path:?} is changed in part: {journal:?} has what it was before. If no program writes it \
            any more, copy both, then \
         let SQLite undo the change: sqlite3 FILE 'PRAGMA quick_check'"
    )]
    Journal {
        /// The file.
        path: PathBuf,
        /// The journal beside it.
        journal: PathBuf,
    },
    /// A table of rosbag2 is missing.
    #[error(
        "{path:?} is no bag of rosbag2: it has no table {table:?} with the columns {columns:?}"
    )]
    Table {
        /// The file.
        path: PathBuf,
        /// The table.
        table: &'static str,
        /// Its columns.
        columns: &'static [&'static str],
    },
    /// More topics than are read.
    #[error("{path:?} has more than {MAX_TOPICS} topics")]
    TooManyTopics {
        /// The file.
        path: PathBuf,
    },
    /// Its pages name each other.
    #[error("{path:?} has more rows of {table:?} than its {bytes} bytes can hold")]
    Repeats {
        /// The file.
        path: PathBuf,
        /// The table.
        table: &'static str,
        /// Bytes of the file and of the log beside it.
        bytes: u64,
    },
    /// SQLite refuses it.
    #[error("cannot read {path:?}: {reason}")]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// SQLite's reason.
        reason: String,
    },
}

/// A topic.
#[derive(Debug, Clone)]
pub(crate) struct Topic {
    pub(crate) id: i64,
    pub(crate) name: String,
    pub(crate) type_name: String,
    pub(crate) encoding: String,
}

/// The definition of a type.
#[derive(Debug, Clone, Default)]
pub(crate) struct Definition {
    pub(crate) encoding: String,
    pub(crate) text: String,
}

/// The rows of a small table.
#[derive(Debug)]
pub(crate) struct Rows<T> {
    pub(crate) rows: Vec<T>,
    /// Number of rows with types that rosbag2 does not write.
    pub(crate) odd: u64,
}

/// One row of a bag's messages.
#[derive(Debug)]
pub(crate) enum Row<'a> {
    /// A message.
    Message { topic: i64, time_ns: u64, data: &'a [u8] },
    /// An unusable row, with the reason.
    Odd(&'static str),
    /// The file cannot be read any further.
    Damage(String),
}

/// An open bag.
pub(crate) struct Bag {
    path: PathBuf,
    sqlite: Connection,
    /// Size of the file and of its log, bytes, which bounds the sum of its rows.
    bytes: u64,
}

/// The size that rows may still have, bytes.
struct Left(u64);

impl Left {
    /// Takes a row with values of that size. Returns false if there is no room for it.
    fn take(&mut self, bytes: usize) -> bool {
        let needed = (bytes as u64).saturating_add(MIN_ROW_BYTES);
        let left = self.0.checked_sub(needed);
        self.0 = left.unwrap_or(0);
        left.is_some()
    }
}

impl Bag {
    /// Opens a bag.
    pub(crate) fn open(path: &Path) -> Result<Self, BagError> {
        check_head(path)?;
        check_journal(path)?;
        let bag = Self {
            path: path.to_owned(),
            sqlite: connect(path).map_err(|error| refused(path, &error))?,
            bytes: length(path) + length(&beside(path, "-wal")),
        };
        const TOPICS: &[&str] = &["id", "name", "type", "serialization_format"];
        const MESSAGES: &[&str] = &["topic_id", "timestamp", "data"];
        for (table, columns) in [("topics", TOPICS), ("messages", MESSAGES)] {
            if !bag.has_table(table, columns)? {
                return Err(BagError::Table { path: bag.path, table, columns });
            }
        }
        Ok(bag)
    }

    /// True if it has a table, no view, with these columns.
    fn has_table(&self, table: &str, columns: &[&str]) -> Result<bool, BagError> {
        let look = || -> rusqlite::Result<bool> {
            // Asks SQLite itself, not the text in the file.
            let sql = "SELECT 1 FROM pragma_table_list \
                       WHERE schema = 'main' AND lower(name) = ?1 AND type = 'table'";
            if !self.sqlite.prepare(sql)?.exists([table])? {
                return Ok(false);
            }
            // Generated columns are hidden: 2 and 3. They are computed, so none of rosbag2's.
            let sql = "SELECT name FROM pragma_table_xinfo(?1) WHERE hidden = 0";
            let mut query = self.sqlite.prepare(sql)?;
            let names = query.query_map([table], |row| row.get::<_, String>(0))?;
            let names: Vec<String> = names.collect::<Result<_, _>>()?;
            Ok(columns
                .iter()
                .all(|column| names.iter().any(|name| name.eq_ignore_ascii_case(column))))
        };
        look().map_err(|error| refused(&self.path, &error))
    }

    /// Its topics.
    pub(crate) fn topics(&self) -> Result<Rows<Topic>, BagError> {
        let sql = "SELECT id, name, type, serialization_format FROM topics";
        let topics = self.all("topics", sql, |row| {
            let topic = Topic {
                id: row.get(0)?,
                name: row.get(1)?,
                type_name: row.get(2)?,
                encoding: row.get(3)?,
            };
            let bytes = topic.name.len() + topic.type_name.len() + topic.encoding.len();
            Ok((topic, bytes))
        })?;
        if topics.rows.len() > MAX_TOPICS {
            let path = self.path.clone();
            return Err(BagError::TooManyTopics { path });
        }
        Ok(topics)
    }

    /// Definitions of types, with the types' names. Bags before ROS 2 Iron have none.
    pub(crate) fn definitions(&self) -> Result<Rows<(String, Definition)>, BagError> {
        const TABLE: &str = "message_definitions";
        const COLUMNS: &[&str] = &["topic_type", "encoding", "encoded_message_definition"];
        if !self.has_table(TABLE, COLUMNS)? {
            let rows = Vec::new();
            return Ok(Rows { rows, odd: 0 });
        }
        let sql =
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
        self.all(TABLE, sql, |row| {
            let (name, encoding, text): (String, _, String) =
                (row.get(0)?, row.get(1)?, row.get(2)?);
            let bytes = name.len() + text.len();
            Ok(((name, Definition { encoding, text }), bytes))
        })
    }

    /// The rows of a table, at most one more than the allowed number of topics. `read` returns the
    /// size of a row, or fails for values of other types.
    fn all<T>(
        &self,
        table: &'static str,
        sql: &str,
        read: impl Fn(&rusqlite::Row<'_>) -> rusqlite::Result<(T, usize)>,
    ) -> Result<Rows<T>, BagError> {
        let sqlite = |error: rusqlite::Error| refused(&self.path, &error);
        let mut query = self.sqlite.prepare(sql).map_err(sqlite)?;
        let mut found = query.query([]).map_err(sqlite)?;
        let (mut rows, mut odd, mut left) = (Vec::new(), 0, Left(self.bytes));
        while rows.len() <= MAX_TOPICS
            && let Some(row) = found.next().map_err(sqlite)?
        {
            let (row, bytes) = match read(row) {
                Ok((row, bytes)) => (Some(row), bytes),
                Err(_) => (None, 0),
            };
            if !left.take(bytes) {
                return Err(self.repeats(table));
            }
            odd += u64::from(row.is_none());
            rows.extend(row);
        }
        Ok(Rows { rows, odd })
    }

    fn repeats(&self, table: &'static str) -> BagError {
        let (path, bytes) = (self.path.clone(), self.bytes);
        BagError::Repeats { path, table, bytes }
    }

    /// Gives all messages to `take`, in the order in which they were written, until it fails or the
    /// file is damaged.
    pub(crate) fn each_row<E: From<BagError>>(
        &self,
        mut take: impl FnMut(Row<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let sqlite = |error: rusqlite::Error| refused(&self.path, &error);
        let length = self.sqlite.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_BYTES);
        length.map_err(sqlite)?;
        let mut left = Left(self.bytes);
        let sql = "SELECT topic_id, timestamp, data FROM messages";
        let mut query = self.sqlite.prepare(sql).map_err(sqlite)?;
        let mut rows = query.query([]).map_err(sqlite)?;
        loop {
            let row = match rows.next() {
                Ok(Some(row)) => row,
                Ok(None) => return Ok(()),
                Err(error) => return take(Row::Damage(error.to_string())),
            };
            let value = |column| row.get_ref(column).unwrap_or(ValueRef::Null);
            let bytes = match value(2) {
                ValueRef::Blob(bytes) | ValueRef::Text(bytes) => bytes.len(),
                _ => 0,
            };
            if !left.take(bytes) {
                return take(Row::Damage(self.repeats("messages").to_string()));
            }
            take(match (value(0), value(1), value(2)) {
                (ValueRef::Integer(topic), ValueRef::Integer(time_ns), ValueRef::Blob(data)) => {
                    match u64::try_from(time_ns) {
                        Ok(time_ns) => Row::Message { topic, time_ns, data },
                        Err(_) => Row::Odd("its time is before 1970"),
                    }
                }
                _ => Row::Odd("topic and time are no integers, or the data no blob"),
            })?;
        }
    }
}

/// Checks that the file begins as an SQLite file does.
fn check_head(path: &Path) -> Result<(), BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut found = Vec::new();
    let file = joulebus_files::open(path).map_err(io)?;
    file.take(MAGIC.len() as u64).read_to_end(&mut found).map_err(io)?;
    if found == MAGIC {
        return Ok(());
    }
    let path = path.to_owned();
    Err(BagError::Kind { path, found })
}

/// Refuses a file with a journal that has to be played back first.
fn check_journal(path: &Path) -> Result<(), BagError> {
    let journal = beside(path, "-journal");
    if length(&journal) == 0 {
        return Ok(());
    }
    let mut head = Vec::new();
    let read = joulebus_files::open(&journal)
        .and_then(|file| file.take(JOURNAL_HEAD as u64).read_to_end(&mut head));
    read.map_err(|source| BagError::Io { path: journal.clone(), source })?;
    // A writer that keeps its journal overwrites the head when it has ended a change. The count of
    // pages is 0 until the journal is on the disk, which comes before the first change of the file.
    let (magic, pages) = head.split_at(JOURNAL_MAGIC.len().min(head.len()));
    if magic != JOURNAL_MAGIC || pages.iter().all(|byte| *byte == 0) {
        return Ok(());
    }
    let path = path.to_owned();
    Err(BagError::Journal { path, journal })
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let has_log = length(&beside(path, "-wal")) > 0;
    // Keep the index of the log in memory unless another process has one, because SQLite would
    // leave its file behind. Use no locks: nobody writes without that file, and such a lock needs
    // the right to write.
    let has_own_index = has_log && !beside(path, "-shm").exists();
    let end = match (has_log, has_own_index) {
        // Nothing may change the file. SQLite then writes nothing beside it either.
        (false, _) => "mode=ro&immutable=1",
        (true, false) => "mode=ro",
        (true, true) => "mode=ro&vfs=unix-none",
    };
    let uri = format!("file:{}?{end}", percent_encoded(path));
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX
        | OpenFlags::SQLITE_OPEN_EXRESCODE;
    let sqlite = Connection::open_with_flags(uri, flags)?;
    sqlite.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
    if has_own_index {
        sqlite.pragma_update(None, "locking_mode", "exclusive")?;
    }
    sqlite.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    sqlite.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    sqlite.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
    sqlite.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false)?;
    sqlite.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_TEXT_BYTES)?;
    sqlite.pragma_update(None, "cell_size_check", true)?;
    sqlite.pragma_update(None, "query_only", true)?;
    Ok(sqlite)
}

/// The file of SQLite beside another one.
fn beside(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// Size of a file, bytes. 0 if there is none.
fn length(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |file| file.len())
}

/// A path as part of a URI.
fn percent_encoded(path: &Path) -> String {
    let bytes = path.as_os_str().as_encoded_bytes();
    let mut text = String::new();
    // An absolute path needs an authority, lest its second slash be taken for one.
    if bytes.starts_with(b"/") {
        text.push_str("//");
    }
    for byte in bytes {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'_' | b'.' => {
                text.push(char::from(*byte));
            }
            _ => text.push_str(&format!("%{byte:02x}")),
        }
    }
    text
}

fn refused(path: &Path, error: &rusqlite::Error) -> BagError {
    BagError::Sqlite { path: path.to_owned(), reason: error.to_string() }
}
