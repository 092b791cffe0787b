//! Moves a state to the monotonic clock of another host.
//!
//! The declaration of a state says which of its numbers are instants. The compiler therefore demands
//! a decision for each new field. Counts of periods, durations, sequence numbers and runs
//! stay.

use std::slice;

use crate::layout::lanes::for_each;
use crate::layout::shift::Shift;
use crate::state::columns::Columns;
use crate::state::snapshot::{Counters, FleetState};

impl FleetState {
    /// Moves all instants by `offset_ns`, the number to add to the monotonic clock of the state's
    /// host to get this host's. A fleet continues from it as if its samples had been stamped here.
    ///
    /// An instant from before this host's clock started is moved to its start. Such a state looks
    /// as old as this host has been running, and the accounts of energy count the rest as unmetered
    /// time at once.
    #[must_use]
    pub fn shifted(mut self, offset_ns: i64) -> Self {
        let shift = Shift { offset_ns };
        let Self {
            capacity: _,
            platforms: _,
            settings_hash: _,
            model_hash: _,
            counters,
            columns,
            departed,
            sources,
            // Robots, reasons and processes.
            refused: _,
            lost: _,
            errors: _,
        } = &mut self;
        counters.shift(shift);
        columns.shift(shift);
        for account in departed {
            account.shift(shift);
        }
        for source in sources {
            source.shift(shift);
        }
        self
    }
}

impl Counters {
    fn shift(&mut self, shift: Shift) {
        let Self { drops: _, accepted: _, reported: _, intake, now_ns, deadline_missed: _ } = self;
        shift.instant(now_ns);
        intake.shift(shift);
    }
}

impl Columns {
    fn shift(&mut self, shift: Shift) {
        let Self {
            admissions,
            pending,
            // Counts periods.
            windows: _,
            lasts,
            // Intervals of values, not of times.
            intervals: _,
            ledgers,
            scores: _,
            detectors: _,
            // Its times are durations.
            energy: _,
            online: _,
            batteries,
            // Durations.
            levels: _,
        } = self;
        for admission in admissions {
            admission.shift_instants(shift);
        }
        for block in pending {
            let samples = slice::from_mut(&mut block.samples);
            for_each(samples, |sample| _ = sample.shift_instants(shift));
        }
        for_each(lasts, |last| _ = last.shift_instants(shift));
        for_each(ledgers, |ledger| ledger.shift(shift));
        for_each(batteries, |battery| _ = battery.shift_instants(shift));
    }
}
