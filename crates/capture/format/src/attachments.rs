//! Attachments and metadata of a capture, which make it replayable on its own.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;

use hmac_sha256::Hash as Sha256;

use joulebus_wire::{ANSWER_RULES, TICK_RULES};

use crate::Clock;

/// Name of the metadata record that describes the file.
const ABOUT: &str = "joulebus";
/// Name of the metadata record with the hash of each attachment, and of the record above.
const HASHES: &str = "joulebus.sha256";
/// Version of the whole format: topics, attachments, metadata.
const FORMAT: &str = "1";
/// Name of a fleet's config among its files.
const CONFIG: &str = "config.toml";

/// A file in a capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attached {
    /// `<fleet>/config.toml`, `<fleet>/models/…`, `build.json`.
    pub name: String,
    /// Its MIME type.
    pub media_type: String,
    /// Its contents.
    pub bytes: Vec<u8>,
}

/// Files and metadata of a capture.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Attachments {
    /// The files.
    pub files: Vec<Attached>,
    /// Metadata by the name of its record.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// When they were assembled, Unix ns.
    pub created_unix_ns: u64,
}

impl Attachments {
    /// The attachments of a capture that is made at `created_unix_ns`, on a host that booted as
    /// `boot_id` and with these clocks.
    #[must_use]
    pub fn begun(created_unix_ns: u64, clock: Clock, boot_id: String) -> Self {
        let mut attachments = Self { created_unix_ns, ..Self::default() };
        attachments.describe("format", FORMAT.to_owned());
        attachments.describe("version", env!("CARGO_PKG_VERSION").to_owned());
        attachments.describe("answer_rules", ANSWER_RULES.to_string());
        attachments.describe("tick_rules", TICK_RULES.to_string());
        attachments.describe("clock_offset_ns", clock.offset_ns.to_string());
        attachments.describe("boot_id", boot_id);
        attachments
    }

    /// Adds a fleet's config and the files that it refers to.
    pub fn add_fleet(&mut self, fleet: &str, config: String, files: Vec<(String, Vec<u8>)>) {
        let text = config.into_bytes();
        self.add(format!("{fleet}/{CONFIG}"), "application/toml", text);
        for (name, bytes) in files {
            let media_type = "application/octet-stream";
            self.add(format!("{fleet}/{name}"), media_type, bytes);
        }
    }

    /// Adds a description of this program and its platform.
    pub fn add_build(&mut self) {
        self.add("build.json".to_owned(), "application/json", build());
    }

    /// Adds a file.
    pub fn add(&mut self, name: String, media_type: &str, bytes: Vec<u8>) {
        self.files.push(Attached { name, media_type: media_type.to_owned(), bytes });
    }

    /// Adds a description of this file.
    pub fn describe(&mut self, key: &str, value: String) {
        let about = self.metadata.entry(ABOUT.to_owned()).or_default();
        about.insert(key.to_owned(), value);
    }

    /// The file's description under `key`.
    #[must_use]
    pub fn about(&self, key: &str) -> Option<&str> {
        Some(self.metadata.get(ABOUT)?.get(key)?.as_str())
    }

    /// Number of the rules by which recorded answers about plans were computed
    /// ([`ANSWER_RULES`]). 1 where the file does not state it.
    pub fn answer_rules(&self) -> u32 {
        self.rules("answer_rules")
    }

    /// Number of the rules by which the recorded ticks were computed ([`TICK_RULES`]). 1 where the
    /// file does not state it.
    pub fn tick_rules(&self) -> u32 {
        self.rules("tick_rules")
    }

    fn rules(&self, of: &str) -> u32 {
        let stated = self.about(of);
        stated.and_then(|number| number.parse().ok()).unwrap_or(1)
    }

    /// The fleets whose configs are attached.
    pub fn fleets(&self) -> impl Iterator<Item = &str> {
        let suffix = "/config.toml";
        let names = self.files.iter().map(|file| file.name.as_str());
        names.filter_map(move |name| name.strip_suffix(suffix))
    }

    /// The config of `fleet`, which refers to attached files only.
    #[must_use]
    pub fn config(&self, fleet: &str) -> Option<&str> {
        let name = format!("{fleet}/{CONFIG}");
        let file = self.files.iter().find(|file| file.name == name)?;
        std::str::from_utf8(&file.bytes).ok()
    }

    /// Relation of the capture's times to the monotonic clock of the recording host.
    pub fn clock(&self) -> Option<Clock> {
        let offset_ns = self.about("clock_offset_ns")?.parse().ok()?;
        Some(Clock { offset_ns })
    }

    /// Paths and bytes of the files of `fleet`, as its config names them.
    #[must_use]
    pub fn files(&self, fleet: &str) -> Vec<(&str, &[u8])> {
        let files = self.files.iter().filter_map(|file| {
            Some((file.name.strip_prefix(fleet)?.strip_prefix('/')?, &file.bytes[..]))
        });
        files.collect()
    }

    /// Attachments whose bytes differ from their hash in the capture, or that have no hash, and the
    /// [`joulebus` record](Attachments::about) if it differs. Earlier versions have no hash of that.
    pub fn altered(&self) -> Vec<&str> {
        let hashes = self.metadata.get(HASHES);
        let of_about = hashes.and_then(|hashes| hashes.get(ABOUT));
        let is_other = of_about.is_some_and(|hash| *hash != self.hash_of_about());
        let is_altered = |file: &&Attached| {
            let hash = hashes.and_then(|hashes| hashes.get(&file.name));
            hash != Some(&hex(&file.bytes))
        };
        let altered = self.files.iter().filter(is_altered);
        let altered = altered.map(|file| file.name.as_str());
        altered.chain(is_other.then_some(ABOUT)).collect()
    }

    fn hash_of_about(&self) -> String {
        let mut text = String::new();
        for (key, value) in self.metadata.get(ABOUT).into_iter().flatten() {
            // Writing to a String cannot fail.
            let _ = write!(text, "{}:{key}{}:{value}", key.len(), value.len());
        }
        hex(text.as_bytes())
    }

    pub(crate) fn metadata_records(&self) -> Vec<mcap::write::Metadata> {
        let mut records = self.metadata.clone();
        let files = self.files.iter();
        let hashes = files.map(|file| (file.name.clone(), hex(&file.bytes)));
        let about = (ABOUT.to_owned(), self.hash_of_about());
        records.insert(HASHES.to_owned(), hashes.chain([about]).collect());
        let records = records.into_iter();
        records.map(|(name, metadata)| mcap::write::Metadata { name, metadata }).collect()
    }
}

impl Attached {
    pub(crate) fn record(&self, unix_ns: u64) -> mcap::Attachment<'_> {
        mcap::Attachment {
            log_time: unix_ns,
            create_time: unix_ns,
            name: self.name.clone(),
            media_type: self.media_type.clone(),
            data: Cow::Borrowed(&self.bytes),
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(64);
    for byte in Sha256::hash(bytes) {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}

/// Description of the program and its platform.
fn build() -> Vec<u8> {
    let program = std::env::current_exe().and_then(std::fs::read);
    let build = serde_json::json!({
        "program": "joulebus",
        "version": env!("CARGO_PKG_VERSION"),
        "profile": if cfg!(debug_assertions) { "debug" } else { "release" },
        "arch": std::env::consts::ARCH,
        "os": std::env::consts::OS,
        "schema": joulebus_wire::SCHEMA_VERSION,
        "program_sha256": program.map(|bytes| hex(&bytes)).ok(),
    });
    build.to_string().into_bytes()
}
