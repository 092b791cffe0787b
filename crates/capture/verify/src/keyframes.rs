//! Compares keyframes with recomputed states.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{BuildHasher as _, RandomState};

use joulebus_fleet::{Fleet, FleetState};
use joulebus_settings::FleetSettings;
use joulebus_wire::fnv1a;

use crate::tick_id::TickId;

/// Number of ticks whose states are remembered. A keyframe arrives after later ticks: its encoding
/// takes a while, and so does sending it in pieces.
const MAX_STATES: usize = 16_384;
/// Number of keyframes that are remembered, to recognise copies.
const MAX_KEYFRAMES: usize = 4_096;
/// Maximum memory of states that wait for their keyframe, bytes. What exceeds it is encoded.
const MAX_WAITING: usize = 256 << 20;
/// Maximum number of states that wait for their keyframe: those of ten seconds at 100 Hz.
const MAX_COPIES: usize = 1_024;
/// Approximate memory of the state of a robot, bytes. Its encoding has about 480.
const ROBOT_BYTES: usize = 1_024;

/// The states after the last recomputed ticks. A keyframe comes for one in 150 ticks, later than its
/// tick, and encoding a state takes as long as half a tick. So a state is only copied, until a
/// keyframe shows which one to encode: that of its tick, and none before it.
#[derive(Debug)]
pub(super) struct States {
    /// Copies that wait, the oldest first.
    copies: VecDeque<(TickId, FleetState)>,
    /// Memory of copies that are not needed any more.
    free: Vec<FleetState>,
    max_copies: usize,
    settings: FleetSettings,
    bytes: Vec<u8>,
    /// With keys of its own, so that nobody can make bytes of the same hash.
    hasher: RandomState,
    /// Hashes of the encodings of states whose copies exceeded the memory.
    hashes: BTreeMap<TickId, u64>,
    /// The newest tick whose copy was compared with a keyframe: those before it are forgotten.
    compared: Option<TickId>,
    /// The newest keyframe of the newest run, by [`fnv1a`], `None` of a broken one.
    newest: Option<(u64, Option<u64>)>,
    /// True if keyframes of the run name the one before them.
    has_names: bool,
    /// The last keyframes, each with its hash.
    seen: BTreeMap<TickId, u64>,
}

/// A keyframe among the others of the capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sequence {
    /// It names the one before it, or is the first.
    Follows,
    /// It names another one, which is missing.
    Gap,
    /// It has been seen before.
    Copy,
    /// Another one of its tick has been seen before.
    Differs,
}

impl States {
    pub(super) fn new(settings: &FleetSettings) -> Self {
        Self {
            copies: VecDeque::new(),
            free: Vec::new(),
            max_copies: (MAX_WAITING / (ROBOT_BYTES * settings.capacity.max(1) as usize))
                .clamp(1, MAX_COPIES),
            settings: settings.clone(),
            bytes: Vec::new(),
            hasher: RandomState::new(),
            hashes: BTreeMap::new(),
            compared: None,
            newest: None,
            has_names: false,
            seen: BTreeMap::new(),
        }
    }

    /// Remembers the state after a tick that was recomputed, if keyframes of it are compared.
    pub(super) fn note(&mut self, id: TickId, fleet: &Fleet, is_compared: bool) {
        if !is_compared {
            return self.remember(id, 0);
        }
        let free = self.free.pop();
        let mut state = free.unwrap_or_else(|| FleetState::with_capacity_for(&self.settings));
        fleet.state_into(&mut state);
        self.copies.push_back((id, state));
        if self.copies.len() > self.max_copies
            && let Some((oldest, state)) = self.copies.pop_front()
        {
            let hash = self.hash(&state);
            self.free.push(state);
            self.remember(oldest, hash);
        }
    }

    fn remember(&mut self, id: TickId, hash: u64) {
        self.hashes.insert(id, hash);
        if self.hashes.len() > MAX_STATES {
            self.hashes.pop_first();
        }
    }

    fn hash(&mut self, state: &FleetState) -> u64 {
        state.encode_into(&mut self.bytes);
        self.hasher.hash_one(&self.bytes)
    }

    /// True if the state after the tick was recomputed, and is remembered.
    pub(super) fn is_known(&self, id: TickId) -> bool {
        self.hashes.contains_key(&id) || self.find(id).is_ok()
    }

    /// True if the state after the tick may have been forgotten.
    pub(super) fn is_forgotten(&self, id: TickId) -> bool {
        let oldest = self.hashes.first_key_value();
        self.compared.is_some_and(|newest| id < newest)
            || (self.hashes.len() == MAX_STATES && oldest.is_some_and(|(oldest, _)| id < *oldest))
    }

    /// The hashes of a keyframe and of the recomputed state, if they differ. Forgets the states
    /// before it, because keyframes come in the order of their ticks.
    pub(super) fn difference(&mut self, id: TickId, bytes: &[u8]) -> Option<(u64, u64)> {
        if let Ok(count) = self.find(id) {
            self.free.extend(self.copies.drain(..count).map(|(_, state)| state));
            if let Some((_, state)) = self.copies.pop_front() {
                let hash = self.hash(&state);
                self.free.push(state);
                self.hashes.clear();
                self.remember(id, hash);
                self.compared = Some(id);
            }
        }
        let (recorded, computed) = (self.hasher.hash_one(bytes), *self.hashes.get(&id)?);
        (recorded != computed).then_some((recorded, computed))
    }

    /// Position of the copy of the state after a tick.
    fn find(&self, id: TickId) -> Result<usize, usize> {
        self.copies.binary_search_by_key(&id, |(of, _)| *of)
    }

    /// Compares a keyframe with those before it in the capture, and with the one that it names.
    /// `is_first_run`: of the recording, which may begin inside it. `must_name`: by the version that
    /// recorded it.
    pub(super) fn sequence(
        &mut self,
        id: TickId,
        before_hash: u64,
        bytes: &[u8],
        (is_first_run, must_name): (bool, bool),
    ) -> Sequence {
        let (run, hash) = (id.run, fnv1a(bytes.iter().copied()));
        match self.seen.get(&id) {
            Some(seen) if *seen == hash => return Sequence::Copy,
            Some(_) => return Sequence::Differs,
            None => self.seen.insert(id, hash),
        };
        if self.seen.len() > MAX_KEYFRAMES {
            self.seen.pop_first();
        }
        let before = self.newest.filter(|(newest, _)| *newest == run);
        if before.is_none() {
            self.has_names = must_name;
        }
        // Earlier versions name none.
        let follows = match before {
            Some((_, Some(hash))) if before_hash > 0 => hash == before_hash,
            // Of a broken keyframe nothing is known: the next one may name any.
            Some((_, None)) if before_hash > 0 => true,
            Some(_) => !self.has_names,
            None => is_first_run || before_hash == 0,
        };
        self.has_names |= before_hash > 0;
        self.newest = Some((run, Some(hash)));
        if follows { Sequence::Follows } else { Sequence::Gap }
    }

    /// Notes a broken keyframe of a run.
    pub(super) fn note_broken(&mut self, run: u64) {
        if self.newest.is_none_or(|(newest, _)| newest <= run) {
            self.newest = Some((run, None));
        }
    }
}
