//! The state of a fleet as a value: to be kept, written down, and gone on with.

use joulebus_settings::{FleetSettings, Online, Platform};
use serde::{Deserialize, Serialize};

use crate::alarms::detector::DetectorLanes;
use crate::estimate::interval::IntervalLanes;
use crate::estimate::mixture::Blend;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::fleet::Fleet;
use crate::fleet::TickIntake;
use crate::ingest::codes::drop_counts;
use crate::ingest::refused::Refused;
use crate::ingest::robot::{AdmissionState, LastLanes, PendingBlock};
use crate::ingest::sources::Source;
use crate::layout::lanes::{self, LANES};
use crate::ledger::departed::Account;
use crate::ledger::energy::Ledger;
use crate::ledger::energy::LedgerLanes;

/// First bytes of the encoded form. The last of them is its version: one more whenever a column
/// gains, loses or moves a field.
const MAGIC: [u8; 8] = *b"jbstate\x05";

/// Everything that a tick depends on but the settings and the models, bit for bit: who is in the
/// fleet and where, windows, ledgers, intervals, scores, detectors, what is learned online, accounts
/// of robots that have left, sources, what was refused and dropped.
///
/// A fleet that is [given](Fleet::restore_state) it goes on as the one that it was
/// [taken](Fleet::state) of would have.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FleetState {
    capacity: u32,
    platforms: u32,
    settings_hash: u64,
    model_hash: u64,
    counters: Counters,
    columns: Columns,
    departed: Vec<Account>,
    sources: Vec<Source>,
    refused: Refused,
}

/// What is counted once for all robots.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Counters {
    #[serde(with = "drop_counts")]
    drops: joulebus_wire::DropCounts,
    accepted: u64,
    reported: u32,
    intake: TickIntake,
    now_ns: u64,
    deadline_missed: bool,
}

/// The slots that have ever been in use, as in the fleet's own columns.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Columns {
    admissions: Vec<AdmissionState>,
    pending: Vec<PendingBlock>,
    windows: Vec<WindowLanes>,
    lasts: Vec<LastLanes>,
    intervals: Vec<IntervalLanes>,
    ledgers: Vec<LedgerLanes>,
    scores: Vec<ScoreLanes>,
    detectors: Vec<DetectorLanes>,
    /// Empty unless a platform learns online.
    blends: Vec<Blend>,
}

/// Why a state was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
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
    /// [`Fleet::state_into`] neither allocates nor faults. Its content is that of no fleet.
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
            columns: Columns {
                admissions: room(robots, AdmissionState::FREE),
                pending: room(blocks, PendingBlock::default()),
                windows: room(blocks, WindowLanes::default()),
                lasts: room(blocks, LastLanes::default()),
                intervals: room(blocks, IntervalLanes::default()),
                ledgers: room(blocks, LedgerLanes::default()),
                scores: room(blocks, ScoreLanes::default()),
                detectors: room(blocks, DetectorLanes::default()),
                blends: room(if learning { robots } else { 0 }, Blend::NONE),
            },
            departed: room(
                robots,
                Account {
                    robot: 0,
                    charged: false,
                    ledger: Ledger::default(),
                },
            ),
            sources: room(settings.intake.max_sources.into(), Source::default()),
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

    fn present(&self) -> impl Iterator<Item = (usize, &AdmissionState)> {
        let admissions = self.columns.admissions.iter().enumerate();
        admissions.filter(|(_, admission)| admission.present)
    }

    /// As [`Fleet::model_hash`].
    #[must_use]
    pub fn model_hash(&self) -> u64 {
        self.model_hash
    }

    /// Refuses what belongs to another fleet.
    fn check_kin(&self, fleet: &Fleet) -> Result<(), StateError> {
        let (capacity, platforms) = (fleet.capacity(), fleet.contexts.len() as u32);
        if self.capacity != capacity {
            return Err(StateError::Capacity {
                found: self.capacity,
                expected: capacity,
            });
        }
        if self.platforms != platforms {
            return Err(StateError::Platforms {
                found: self.platforms,
                expected: platforms,
            });
        }
        if self.settings_hash != fleet.settings_hash {
            return Err(StateError::FleetSettings {
                found: self.settings_hash,
                expected: fleet.settings_hash,
            });
        }
        if self.model_hash != fleet.model_hash() {
            return Err(StateError::Models {
                found: self.model_hash,
                expected: fleet.model_hash(),
            });
        }
        Ok(())
    }

    /// Refuses what no fleet can have come to: the tick relies on it.
    fn check_sound(&self, fleet: &Fleet) -> Result<(), StateError> {
        let columns = &self.columns;
        let slots = columns.admissions.len();
        at_most("slots in use", slots, self.capacity as usize)?;
        let blocks = slots.div_ceil(LANES);
        for (what, length) in [
            ("blocks of pending", columns.pending.len()),
            ("blocks of windows", columns.windows.len()),
            ("blocks of last samples", columns.lasts.len()),
            ("blocks of intervals", columns.intervals.len()),
            ("blocks of ledgers", columns.ledgers.len()),
            ("blocks of scores", columns.scores.len()),
            ("blocks of detectors", columns.detectors.len()),
        ] {
            exactly(what, length, blocks)?;
        }
        let blends = slots.min(fleet.columns.blends.len());
        exactly(
            "length of what is learned online",
            columns.blends.len(),
            blends,
        )?;
        at_most("accounts", self.departed.len(), self.capacity as usize)?;
        let most = fleet.settings.intake.max_sources;
        at_most("sources", self.sources.len(), most.into())?;
        at_most("robots heard", self.counters.reported as usize, slots)?;
        self.check_slots(fleet)
    }

    /// Each slot in use holds a robot of its own, of the platform that the settings say.
    fn check_slots(&self, fleet: &Fleet) -> Result<(), StateError> {
        let mut ids = std::collections::HashSet::new();
        for (slot, admission) in self.present() {
            let times = 2 - usize::from(ids.insert(admission.id));
            exactly("times a robot is listed", times, 1)?;
            let platform = fleet
                .platform_of(admission.id)
                .map_or(usize::MAX, usize::from);
            exactly("platform of a robot", admission.platform.into(), platform)?;
            lanes::get(&self.columns.windows, slot).check()?;
        }
        Ok(())
    }
}

impl Fleet {
    /// The fleet's state as it is now. Allocates.
    #[must_use]
    pub fn state(&self) -> FleetState {
        let mut state = FleetState::with_room_for(&self.settings);
        self.state_into(&mut state);
        state
    }

    /// As [`Fleet::state`], into memory of [`FleetState::with_room_for`] the same settings: copies
    /// and allocates nothing. Takes as long as copying all slots ever used.
    pub fn state_into(&self, state: &mut FleetState) {
        state.capacity = self.settings.capacity;
        state.platforms = self.contexts.len() as u32;
        (state.settings_hash, state.model_hash) = (self.settings_hash, self.model_hash());
        state.counters = Counters {
            drops: self.drops,
            accepted: self.accepted,
            reported: self.reported as u32,
            intake: self.intake,
            now_ns: self.now_ns,
            deadline_missed: self.deadline_missed,
        };
        let (to, from) = (&mut state.columns, &self.columns);
        let used = from.slots.reach();
        let blocks = used.div_ceil(LANES);
        copy(&mut to.admissions, &from.admissions[..used]);
        copy(&mut to.pending, &from.pending[..blocks]);
        copy(&mut to.windows, &from.windows[..blocks]);
        copy(&mut to.lasts, &from.lasts[..blocks]);
        copy(&mut to.intervals, &from.intervals[..blocks]);
        copy(&mut to.ledgers, &from.ledgers[..blocks]);
        copy(&mut to.scores, &from.scores[..blocks]);
        copy(&mut to.detectors, &from.detectors[..blocks]);
        copy(&mut to.blends, &from.blends[..used.min(from.blends.len())]);
        state.departed.clear();
        state.departed.extend(self.departed.accounts());
        copy(&mut state.sources, self.sources.all());
        state.refused.clone_from(&self.refused);
    }

    /// Goes on from `state`, which replaces all that this fleet has come to. It must have been
    /// taken of a fleet with the same settings and models.
    ///
    /// # Errors
    /// [`StateError`]; the fleet is as it was.
    pub fn restore_state(&mut self, state: &FleetState) -> Result<(), StateError> {
        state.check_kin(self)?;
        state.check_sound(self)?;
        let (from, to) = (&state.columns, &mut self.columns);
        let used = from.admissions.len();
        let blocks = used.div_ceil(LANES);
        to.admissions[..used].copy_from_slice(&from.admissions);
        to.admissions[used..].fill(AdmissionState::FREE);
        to.pending[..blocks].copy_from_slice(&from.pending);
        to.windows[..blocks].copy_from_slice(&from.windows);
        to.lasts[..blocks].copy_from_slice(&from.lasts);
        to.intervals[..blocks].copy_from_slice(&from.intervals);
        to.ledgers[..blocks].copy_from_slice(&from.ledgers);
        to.scores[..blocks].copy_from_slice(&from.scores);
        to.detectors[..blocks].copy_from_slice(&from.detectors);
        to.blends[..from.blends.len()].copy_from_slice(&from.blends);
        to.slots
            .replace(used, state.present().map(|(slot, _)| slot));
        self.slot_of.clear();
        for (slot, admission) in state.present() {
            self.slot_of.insert(admission.id, slot as u32);
        }
        self.guess = 0;
        // Looked up anew at the next tick.
        *self.oldest_ns.get_mut() = 0;
        self.departed.replace(&state.departed);
        self.sources.replace(&state.sources);
        self.refused.clone_from(&state.refused);
        let counters = state.counters;
        (self.drops, self.accepted) = (counters.drops, counters.accepted);
        (self.reported, self.intake) = (counters.reported as usize, counters.intake);
        (self.now_ns, self.deadline_missed) = (counters.now_ns, counters.deadline_missed);
        Ok(())
    }
}

/// An empty vector with room for `length` items, all of it written to once.
fn room<T: Clone>(length: usize, item: T) -> Vec<T> {
    let mut items = vec![item; length];
    items.clear();
    items
}

fn copy<T: Copy>(to: &mut Vec<T>, from: &[T]) {
    to.clear();
    to.extend_from_slice(from);
}

fn at_most(what: &'static str, found: usize, allowed: usize) -> Result<(), StateError> {
    if found > allowed {
        return Err(corrupt(what, found, allowed));
    }
    Ok(())
}

fn exactly(what: &'static str, found: usize, allowed: usize) -> Result<(), StateError> {
    if found != allowed {
        return Err(corrupt(what, found, allowed));
    }
    Ok(())
}

fn corrupt(what: &'static str, found: usize, allowed: usize) -> StateError {
    StateError::Corrupt {
        what,
        found: found as u64,
        allowed: allowed as u64,
    }
}
