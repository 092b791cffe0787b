//! A fleet's state as a value: to be stored, sent, and resumed from.

use joulebus_settings::{FleetSettings, Online, Platform};
use serde::{Deserialize, Serialize};

use crate::alarms::detector::DetectorLanes;
use crate::estimate::interval::IntervalLanes;
use crate::estimate::mixture::Blend;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::admission::AdmissionState;
use crate::ingest::codes::drop_counts;
use crate::ingest::frame::TickIntake;
use crate::ingest::last_sample::LastLanes;
use crate::ingest::pending::PendingBlock;
use crate::ingest::refused::Refused;
use crate::ingest::sources::Source;
use crate::layout::lanes::LANES;
use crate::ledger::departed::Account;
use crate::ledger::energy::Ledger;
use crate::ledger::energy::LedgerLanes;

/// First bytes of the encoded form. The last of them is its version: one more whenever a column
/// gains, loses or moves a field.
const MAGIC: [u8; 8] = *b"jbstate\x06";

/// Everything that a tick depends on but the settings and the models, bit for bit: who is in the
/// fleet and where, windows, ledgers, intervals, scores, detectors, what is learned online, accounts
/// of robots that have left, sources, what was refused and dropped.
///
/// A fleet that is [given](crate::Fleet::restore_state) it continues as the one that it was
/// [taken](crate::Fleet::state) of would have.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FleetState {
    pub(crate) capacity: u32,
    pub(crate) platforms: u32,
    pub(crate) settings_hash: u64,
    pub(crate) model_hash: u64,
    pub(crate) counters: Counters,
    pub(crate) columns: SavedColumns,
    pub(crate) departed: Vec<Account>,
    pub(crate) sources: Vec<Source>,
    pub(crate) refused: Refused,
}

/// What is counted once for all robots.
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

/// The slots that have ever been in use, as in the fleet's own columns.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct SavedColumns {
    pub admissions: Vec<AdmissionState>,
    pub pending: Vec<PendingBlock>,
    pub windows: Vec<WindowLanes>,
    pub lasts: Vec<LastLanes>,
    pub intervals: Vec<IntervalLanes>,
    pub ledgers: Vec<LedgerLanes>,
    pub scores: Vec<ScoreLanes>,
    pub detectors: Vec<DetectorLanes>,
    /// Empty unless a platform learns online.
    pub blends: Vec<Blend>,
}

/// Why a state was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// Not a state, or one of another version.
    #[error(
        "not a fleet's state in version {expected}: it begins with {found:02x?}; read it with the \
         version of joulebus that wrote it"
    )]
    Version {
        /// Its first bytes.
        found: Vec<u8>,
        /// The version that this program reads.
        expected: u8,
    },
    /// The bytes end too early or make no sense.
    #[error("a fleet's state of {bytes} bytes cannot be read: {reason}")]
    Malformed {
        /// Bytes given.
        bytes: usize,
        /// What the decoder said.
        reason: String,
    },
    /// Taken of a fleet with room for another number of robots.
    #[error("a state of a fleet with capacity {found}, expected {expected}; use the same config")]
    Capacity {
        /// Capacity in the state.
        found: u32,
        /// Capacity of this fleet.
        expected: u32,
    },
    /// Taken of a fleet with other platforms.
    #[error("a state of a fleet with {found} platforms, expected {expected}; use the same config")]
    Platforms {
        /// Platforms in the state.
        found: u32,
        /// Platforms of this fleet.
        expected: u32,
    },
    /// Taken under other settings.
    #[error(
        "a state taken under settings {found:016x}, these are {expected:016x}; use the same config"
    )]
    FleetSettings {
        /// Hash of the settings in the state.
        found: u64,
        /// Hash of this fleet's.
        expected: u64,
    },
    /// Taken with other models.
    #[error(
        "a state taken with models {found:016x}, these are {expected:016x}; use the same models"
    )]
    Models {
        /// Hash of the models in the state.
        found: u64,
        /// Hash of this fleet's.
        expected: u64,
    },
    /// It contradicts itself.
    #[error("the state contradicts itself: {what} is {found}, allowed is {allowed}")]
    Corrupt {
        /// What.
        what: &'static str,
        /// What it is.
        found: u64,
        /// What it may be at most.
        allowed: u64,
    },
}

impl FleetState {
    /// Memory for the state of a fleet of `capacity` robots, taken and touched, so that
    /// [`crate::Fleet::state_into`] neither allocates nor faults. Its content is that of no fleet.
    #[must_use]
    pub fn with_room_for(settings: &FleetSettings) -> Self {
        let robots = settings.capacity as usize;
        let blocks = robots.div_ceil(LANES);
        let learns = |platform: &Platform| platform.online != Online::default();
        let learning = settings.platforms.iter().any(learns);
        Self {
            capacity: 0,
            platforms: 0,
            settings_hash: 0,
            model_hash: 0,
            counters: Counters::default(),
            columns: SavedColumns {
                admissions: with_capacity(robots, AdmissionState::FREE),
                pending: with_capacity(blocks, PendingBlock::default()),
                windows: with_capacity(blocks, WindowLanes::default()),
                lasts: with_capacity(blocks, LastLanes::default()),
                intervals: with_capacity(blocks, IntervalLanes::default()),
                ledgers: with_capacity(blocks, LedgerLanes::default()),
                scores: with_capacity(blocks, ScoreLanes::default()),
                detectors: with_capacity(blocks, DetectorLanes::default()),
                blends: with_capacity(if learning { robots } else { 0 }, Blend::NONE),
            },
            departed: with_capacity(
                robots,
                Account {
                    robot: 0,
                    charged: false,
                    ledger: Ledger::default(),
                },
            ),
            sources: with_capacity(settings.intake.max_sources.into(), Source::default()),
            refused: Refused::default(),
        }
    }

    /// As bytes: eight that say what it is, then [postcard](https://postcard.jamesmunns.com).
    /// About 350 for a robot. Replaces what is in `bytes`.
    pub fn encode_into(&self, bytes: &mut Vec<u8>) {
        bytes.clear();
        bytes.extend_from_slice(&MAGIC);
        let encoded = postcard::to_extend(self, std::mem::take(bytes));
        // Never an error: a vector grows, and every length is known.
        *bytes = encoded.unwrap_or_default();
    }

    /// From bytes.
    ///
    /// # Errors
    /// [`StateError::Version`] or [`StateError::Malformed`].
    pub fn decode(bytes: &[u8]) -> Result<Self, StateError> {
        let Some(encoded) = bytes.strip_prefix(&MAGIC) else {
            return Err(StateError::Version {
                found: bytes.iter().take(MAGIC.len()).copied().collect(),
                expected: MAGIC[7],
            });
        };
        let malformed = |reason: String| StateError::Malformed {
            bytes: bytes.len(),
            reason,
        };
        match postcard::take_from_bytes(encoded) {
            Ok((state, [])) => Ok(state),
            Ok((_, more)) => Err(malformed(format!("{} bytes are left over", more.len()))),
            Err(error) => Err(malformed(error.to_string())),
        }
    }

    /// Robots in the fleet.
    #[must_use]
    pub fn len(&self) -> usize {
        self.present().count()
    }

    /// Whether no robot is in the fleet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.present().next().is_none()
    }

    pub(crate) fn present(&self) -> impl Iterator<Item = (usize, &AdmissionState)> {
        let admissions = self.columns.admissions.iter().enumerate();
        admissions.filter(|(_, admission)| admission.present)
    }

    /// As [`crate::Fleet::model_hash`].
    #[must_use]
    pub fn model_hash(&self) -> u64 {
        self.model_hash
    }
}

/// An empty vector with room for `length` items, all of it written to once.
fn with_capacity<T: Clone>(length: usize, item: T) -> Vec<T> {
    let mut items = vec![item; length];
    items.clear();
    items
}
