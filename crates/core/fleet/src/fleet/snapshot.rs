//! The state of a fleet as a value: saved and restored.

use joulebus_predictor::LAGS;

use crate::fleet::Fleet;
use crate::layout::lanes::{self, LANES};
use crate::ledger::departed::LOST_WORDS;
use crate::state::snapshot::{Counters, FleetState, StateError};

impl Fleet {
    /// The fleet's current state. Allocates.
    pub fn state(&self) -> FleetState {
        let mut state = FleetState::with_capacity_for(&self.tick.settings);
        self.state_into(&mut state);
        state
    }

    /// Same as [`Fleet::state`], into memory of [`FleetState::with_capacity_for`] the same
    /// settings. It copies without allocating, and takes as long as copying all slots ever used.
    pub fn state_into(&self, state: &mut FleetState) {
        state.capacity = self.tick.settings.capacity;
        state.platforms = self.tick.platforms.len() as u32;
        (state.settings_hash, state.model_hash) = (self.settings_hash, self.model_hash());
        state.counters = Counters {
            drops: self.drops,
            accepted: self.accepted,
            reported: self.reported as u32,
            intake: self.intake,
            now_ns: self.tick.now_ns,
            deadline_missed: self.tick.deadline_missed,
        };
        state.columns.copy(&self.columns, self.slots.reach());
        state.departed.clear();
        state.departed.extend(self.departed.accounts());
        copy(&mut state.lost, self.departed.lost());
        copy(&mut state.sources, self.sources.all());
        state.refused.clone_from(&self.refused);
        state.errors.clear();
        state.errors.extend(self.tick.platforms.iter().map(|context| context.errors.saved()));
    }

    /// Continues from `state`, which replaces the whole state of this fleet. It must have been
    /// taken from a fleet with the same settings and models.
    ///
    /// # Errors
    /// [`StateError`]. The fleet is then unchanged.
    pub fn restore_state(&mut self, state: &FleetState) -> Result<(), StateError> {
        self.check_origin(state)?;
        self.check_consistency(state)?;
        self.columns.restore(&state.columns);
        let used = state.columns.admissions.len();
        self.slots.replace(used, state.present().map(|(slot, _)| slot));
        self.slot_of.clear();
        for (slot, admission) in state.present() {
            self.slot_of.insert(admission.id, slot as u32);
        }
        self.likely_slot = 0;
        // Recomputed at the next tick.
        *self.oldest_ns.get_mut() = 0;
        self.departed.replace(&state.departed);
        self.departed.replace_lost(&state.lost);
        self.sources.replace(&state.sources);
        self.refused.clone_from(&state.refused);
        for (context, saved) in self.tick.platforms.iter_mut().zip(&state.errors) {
            context.errors.restore(saved);
        }
        let counters = state.counters;
        (self.drops, self.accepted) = (counters.drops, counters.accepted);
        (self.reported, self.intake) = (counters.reported as usize, counters.intake);
        (self.tick.now_ns, self.tick.deadline_missed) = (counters.now_ns, counters.deadline_missed);
        Ok(())
    }

    /// Refuses the state of another fleet.
    fn check_origin(&self, state: &FleetState) -> Result<(), StateError> {
        let (found, expected) = (state.capacity, self.capacity());
        if found != expected {
            return Err(StateError::Capacity { found, expected });
        }
        let (found, expected) = (state.platforms, self.tick.platforms.len() as u32);
        if found != expected {
            return Err(StateError::Platforms { found, expected });
        }
        let (found, expected) = (state.settings_hash, self.settings_hash);
        if found != expected {
            return Err(StateError::FleetSettings { found, expected });
        }
        let (found, expected) = (state.model_hash, self.model_hash());
        if found != expected {
            return Err(StateError::Models { found, expected });
        }
        Ok(())
    }

    /// Refuses states that no fleet can reach, because the tick relies on it.
    fn check_consistency(&self, state: &FleetState) -> Result<(), StateError> {
        let columns = &state.columns;
        let slots = columns.admissions.len();
        at_most("slots in use", slots, state.capacity as usize)?;
        for (what, length, expected) in self.columns.lengths(columns) {
            exactly(what, length, expected)?;
        }
        at_most("accounts", state.departed.len(), state.capacity as usize)?;
        at_most("words of lost robots", state.lost.len(), LOST_WORDS)?;
        let most = self.tick.settings.intake.max_sources;
        at_most("sources", state.sources.len(), most.into())?;
        at_most("robots that have reported", state.counters.reported as usize, slots)?;
        exactly("platforms' errors", state.errors.len(), self.tick.platforms.len())?;
        let unsound = state.errors.iter().filter(|errors| !errors.is_sound());
        exactly("platforms with unsound counts of errors", unsound.count(), 0)?;
        self.check_slots(state)
    }

    /// Each slot in use holds a distinct robot, of the platform in the settings.
    fn check_slots(&self, state: &FleetState) -> Result<(), StateError> {
        let mut ids = std::collections::HashSet::new();
        for (_, admission) in state.present() {
            let times = 2 - usize::from(ids.insert(admission.id));
            exactly("times a robot is listed", times, 1)?;
            let platform = self.platform_of(admission.id).map_or(usize::MAX, usize::from);
            exactly("platform of a robot", admission.platform.into(), platform)?;
        }
        let mut kept = std::collections::HashSet::new();
        for account in &state.departed {
            let times = 2 - usize::from(kept.insert(account.robot));
            exactly("accounts of a robot", times, 1)?;
        }
        // The loops over a block go over its free lanes too.
        for lane in 0..state.columns.windows.len() * LANES {
            let readings = lanes::get(&state.columns.windows, lane).have();
            at_most("readings in a window", readings.into(), LAGS)?;
        }
        Ok(())
    }
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
    StateError::Corrupt { what, found: found as u64, allowed: allowed as u64 }
}
