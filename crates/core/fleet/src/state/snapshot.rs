//! A fleet's state as a value, for storing, sending and resuming.

use joulebus_settings::FleetSettings;
use serde::{Deserialize, Serialize};

use crate::estimate::calibration::SavedErrors;
use crate::ingest::admission::AdmissionState;
use crate::ingest::codes::drop_counts;
use crate::ingest::frame::TickIntake;
use crate::ingest::refused::Refused;
use crate::ingest::sources::Source;
use crate::layout::versions;
use crate::ledger::departed::{Account, LOST_WORDS};
use crate::state::columns::{Columns, Needed};

/// First bytes of the encoding. The last of them is its version, incremented whenever a column
/// gains, loses or moves a field.
const MAGIC: [u8; 8] = *b"jbstate\x13";
/// The oldest version that is read too. [`versions`](crate::layout::versions) converts it.
const OLDEST: u8 = 0x11;
const NEWEST: u8 = MAGIC[7];

/// Everything that a tick depends on except the settings and the models, bit for bit: membership,
/// windows, ledgers, intervals, scores, detectors, energy states and their errors, online learning,
/// accounts of departed robots, which of them were given up, sources, refusals and drops.
///
/// A fleet into which it is [restored](crate::Fleet::restore_state) continues exactly like the one
/// from which it was [taken](crate::Fleet::state).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FleetState {
    pub(crate) capacity: u32,
    pub(crate) platforms: u32,
    pub(crate) settings_hash: u64,
    pub(crate) model_hash: u64,
    pub(crate) counters: Counters,
    /// The slots ever used.
    pub(crate) columns: Columns,
    pub(crate) departed: Vec<Account>,
    /// Empty unless an account was given up.
    pub(crate) lost: Vec<u64>,
    pub(crate) sources: Vec<Source>,
    pub(crate) refused: Refused,
    /// One entry a platform.
    pub(crate) errors: Vec<SavedErrors>,
}

/// Counters common to all robots.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Counters {
    #[serde(with = "drop_counts")]
    pub drops: joulebus_wire::DropCounts,
    pub accepted: u64,
    pub reported: u32,
    pub intake: TickIntake,
    pub now_ns: u64,
    pub deadline_missed: bool,
}

/// Errors of restoring a state.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum StateError {
    /// Not a state, or one of another version.
    #[error(
        "not a fleet's state in version {oldest} to {expected}: it begins with {found:02x?}. \
         Read it with the version of joulebus that wrote it"
    )]
    Version { found: Vec<u8>, oldest: u8, expected: u8 },
    /// The bytes end too early or are invalid.
    #[error("a fleet's state of {bytes} bytes cannot be read: {reason}")]
    Malformed { bytes: usize, reason: String },
    /// The state of a fleet with another capacity.
    #[error("a state of a fleet with capacity {found}, expected {expected}. Use the same config")]
    Capacity { found: u32, expected: u32 },
    /// The state of a fleet with other platforms.
    #[error("a state of a fleet with {found} platforms, expected {expected}. Use the same config")]
    Platforms { found: u32, expected: u32 },
    /// The state of a fleet with other settings.
    #[error(
        "a state taken with settings {found:016x}, these are {expected:016x}. Use the same config"
    )]
    FleetSettings { found: u64, expected: u64 },
    /// The state of a fleet with other models.
    #[error(
        "a state taken with models {found:016x}, these are {expected:016x}. Use the same models"
    )]
    Models { found: u64, expected: u64 },
    /// The snapshot is inconsistent.
    #[error("the state contradicts itself: {what} is {found}, allowed is {allowed}")]
    Corrupt { what: &'static str, found: u64, allowed: u64 },
}

impl FleetState {
    /// Allocates and touches memory for the state of a fleet with the capacity of `settings`, so
    /// that [`crate::Fleet::state_into`] neither allocates nor faults. The content is not a valid
    /// state.
    pub fn with_capacity_for(settings: &FleetSettings) -> Self {
        let robots = settings.capacity as usize;
        let mut columns = Columns::new(robots, Needed::by(settings));
        columns.clear();
        Self {
            capacity: 0,
            platforms: 0,
            settings_hash: 0,
            model_hash: 0,
            counters: Counters::default(),
            columns,
            departed: with_capacity(robots, Account::new(0)),
            lost: with_capacity(LOST_WORDS, 0),
            sources: with_capacity(settings.intake.max_sources.into(), Source::default()),
            refused: Refused::default(),
            errors: with_capacity(settings.platforms.len(), SavedErrors::default()),
        }
    }

    /// Encodes the state: eight bytes of magic, then [postcard](https://postcard.jamesmunns.com).
    /// About 480 bytes per robot. Replaces the contents of `bytes`.
    pub fn encode_into(&self, bytes: &mut Vec<u8>) {
        bytes.clear();
        bytes.extend_from_slice(&MAGIC);
        let encoded = postcard::to_extend(self, std::mem::take(bytes));
        // Serialisation into a growing vector of known lengths cannot fail.
        *bytes = encoded.unwrap_or_default();
    }

    /// True if `bytes` begin like an encoding of this version, and not like one of the version
    /// before.
    #[must_use]
    pub fn is_of_this_version(bytes: &[u8]) -> bool {
        bytes.starts_with(&MAGIC)
    }

    /// Decodes a state.
    ///
    /// # Errors
    /// [`StateError::Version`] or [`StateError::Malformed`].
    pub fn decode(bytes: &[u8]) -> Result<Self, StateError> {
        let version = match bytes.strip_prefix(&MAGIC[..7]) {
            Some([version @ OLDEST..=NEWEST, ..]) => *version,
            _ => {
                return Err(StateError::Version {
                    found: bytes.iter().take(MAGIC.len()).copied().collect(),
                    oldest: OLDEST,
                    expected: NEWEST,
                });
            }
        };
        let decoded: Result<(Self, &[u8]), _> =
            versions::decode_version(version, || postcard::take_from_bytes(&bytes[MAGIC.len()..]));
        let malformed = |reason: String| StateError::Malformed { bytes: bytes.len(), reason };
        match decoded {
            Ok((state, [])) => Ok(state),
            Ok((_, more)) => Err(malformed(format!("{} bytes are left over", more.len()))),
            Err(error) => Err(malformed(error.to_string())),
        }
    }

    /// Robots in the fleet.
    pub fn len(&self) -> usize {
        self.present().count()
    }

    /// True if no robot is in the fleet.
    pub fn is_empty(&self) -> bool {
        self.present().next().is_none()
    }

    pub(crate) fn present(&self) -> impl Iterator<Item = (usize, &AdmissionState)> {
        let admissions = self.columns.admissions.iter().enumerate();
        admissions.filter(|(_, admission)| admission.present)
    }

    /// Same as [`crate::Fleet::model_hash`].
    pub fn model_hash(&self) -> u64 {
        self.model_hash
    }
}

/// An empty vector with capacity for `length` items, all of it touched.
fn with_capacity<T: Clone>(length: usize, item: T) -> Vec<T> {
    let mut items = vec![item; length];
    items.clear();
    items
}
