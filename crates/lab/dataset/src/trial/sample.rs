//! A trial as the samples that a controller would have published.

use joulebus_wire::{Sample, sample_flag};

use super::{Column, Trial};

impl Trial {
    /// The trial as a live stream of robot `robot`, one sample per row, `seq` from 0.
    ///
    /// A controller reads, decides, publishes. So sample `k` carries the reading of row `k`,
    /// measured at the time of row `k`, and the command of row `k + 1`, issued at the time of row
    /// `k + 1`. The last sample carries the last reading and no command, a median period after its
    /// row, so that every reading is scored against a forecast. `base_ns` is the time of the first
    /// row, monotonic ns.
    ///
    /// A value that was not recorded has its flag cleared, and a row on the charger has its flag set.
    /// A reading equal to the bit to that of
    /// the row before (power, voltage and current) is held and keeps the measurement time of the
    /// first of its run. Times that do not advance are passed on unchanged: ingest refuses them.
    pub fn to_samples(&self, robot: u32, base_ns: u64) -> Vec<Sample> {
        self.samples(robot, base_ns).collect()
    }

    /// The same, one by one.
    pub fn samples(&self, robot: u32, base_ns: u64) -> impl Iterator<Item = Sample> + '_ {
        let mut measured_ns = base_ns;
        (0..self.rows()).map(move |row| {
            let held = self.is_held(row);
            if !held {
                measured_ns = base_ns.saturating_add_signed(self.offset_ns[row]);
            }
            let mut sample = Sample::new(robot, row as u64, self.issued_ns(row, base_ns));
            if let Some(power_w) = self.value(Column::Power, row) {
                sample = sample.reading(power_w as f32, measured_ns);
            }
            if held {
                sample.flags |= sample_flag::HELD;
            }
            if self.is_said_to_charge(row) {
                sample.flags |= sample_flag::CHARGING;
            }
            let mut set = |field: &mut f32, flag, column, row| {
                if let Some(value) = self.value(column, row) {
                    *field = value as f32;
                    sample.flags |= flag;
                }
            };
            set(&mut sample.voltage_v, sample_flag::VOLTAGE, Column::Voltage, row);
            set(&mut sample.current_a, sample_flag::CURRENT, Column::Current, row);
            set(&mut sample.soc, sample_flag::SOC, Column::Soc, row);
            set(&mut sample.v_mps, sample_flag::V, Column::V, row + 1);
            set(&mut sample.omega_radps, sample_flag::OMEGA, Column::Omega, row + 1);
            sample
        })
    }

    /// When the command after `row` was issued: at the next row, or a median period after the last.
    fn issued_ns(&self, row: usize, base_ns: u64) -> u64 {
        match self.offset_ns.get(row + 1) {
            Some(next_ns) => base_ns.saturating_add_signed(*next_ns),
            None => {
                base_ns.saturating_add_signed(self.offset_ns[row]).saturating_add(self.period_ns)
            }
        }
    }
}
