//! Between what lies in shared memory and what lies in a capture, bit for bit.

use joulebus_wire as wire;
use prost_types::Timestamp;

use super::proto;

/// A number in a capture that its field in shared memory cannot hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{field} = {found}: allowed are 0 to {allowed}")]
pub struct OutOfRange {
    /// The field.
    pub field: &'static str,
    /// Its number.
    pub found: i128,
    /// The greatest number allowed.
    pub allowed: u64,
}

fn narrow(field: &'static str, found: impl Into<i128>) -> Result<u16, OutOfRange> {
    let found = found.into();
    u16::try_from(found).map_err(|_| OutOfRange {
        field,
        found,
        allowed: u16::MAX.into(),
    })
}

/// Every u64 of ns fits into a timestamp and comes back the same.
fn timestamp(ns: u64) -> Option<Timestamp> {
    Some(Timestamp {
        seconds: (ns / 1_000_000_000) as i64,
        nanos: (ns % 1_000_000_000) as i32,
    })
}

fn ns(field: &'static str, time: Option<Timestamp>) -> Result<u64, OutOfRange> {
    let time = time.unwrap_or_default();
    let found = i128::from(time.seconds) * 1_000_000_000 + i128::from(time.nanos);
    u64::try_from(found).map_err(|_| OutOfRange {
        field,
        found,
        allowed: u64::MAX,
    })
}

impl From<&wire::Sample> for proto::Sample {
    fn from(sample: &wire::Sample) -> Self {
        Self {
            robot: sample.robot,
            flags: sample.flags,
            seq: sample.seq,
            stamp_ns: sample.stamp_ns,
            measured_ns: sample.measured_ns,
            v_mps: Some(sample.v_mps),
            omega_radps: Some(sample.omega_radps),
            power_w: Some(sample.power_w),
            voltage_v: Some(sample.voltage_v),
            current_a: Some(sample.current_a),
            reserved: sample.reserved,
        }
    }
}

impl TryFrom<&proto::Sample> for wire::Sample {
    type Error = OutOfRange;

    fn try_from(sample: &proto::Sample) -> Result<Self, OutOfRange> {
        Ok(Self {
            robot: sample.robot,
            flags: sample.flags,
            seq: sample.seq,
            stamp_ns: sample.stamp_ns,
            measured_ns: sample.measured_ns,
            v_mps: sample.v_mps.unwrap_or(f32::NAN),
            omega_radps: sample.omega_radps.unwrap_or(f32::NAN),
            power_w: sample.power_w.unwrap_or(f32::NAN),
            voltage_v: sample.voltage_v.unwrap_or(f32::NAN),
            current_a: sample.current_a.unwrap_or(f32::NAN),
            reserved: sample.reserved,
        })
    }
}

impl From<&wire::Forecast> for proto::Forecast {
    fn from(forecast: &wire::Forecast) -> Self {
        Self {
            robot: forecast.robot,
            flags: forecast.flags,
            quality: forecast.quality.into(),
            quality_detail: forecast.quality_detail.into(),
            reading_w: Some(forecast.reading_w),
            power_w: Some(forecast.power_w),
            lo_w: Some(forecast.lo_w),
            hi_w: Some(forecast.hi_w),
            generation: forecast.generation,
            sample_seq: forecast.sample_seq,
            stamp_ns: forecast.stamp_ns,
            target_ns: forecast.target_ns,
            reading_age_ns: forecast.reading_age_ns,
            source_epoch: forecast.source_epoch,
        }
    }
}

impl TryFrom<&proto::Forecast> for wire::Forecast {
    type Error = OutOfRange;

    fn try_from(forecast: &proto::Forecast) -> Result<Self, OutOfRange> {
        Ok(Self {
            robot: forecast.robot,
            flags: forecast.flags,
            quality: narrow("Forecast.quality", forecast.quality)?,
            quality_detail: narrow("Forecast.quality_detail", forecast.quality_detail)?,
            reading_w: forecast.reading_w.unwrap_or(f32::NAN),
            power_w: forecast.power_w.unwrap_or(f32::NAN),
            lo_w: forecast.lo_w.unwrap_or(f32::NAN),
            hi_w: forecast.hi_w.unwrap_or(f32::NAN),
            generation: forecast.generation,
            sample_seq: forecast.sample_seq,
            stamp_ns: forecast.stamp_ns,
            target_ns: forecast.target_ns,
            reading_age_ns: forecast.reading_age_ns,
            source_epoch: forecast.source_epoch,
        })
    }
}

impl From<&wire::Diagnostic> for proto::Diagnostic {
    fn from(diagnostic: &wire::Diagnostic) -> Self {
        Self {
            robot: diagnostic.robot,
            flags: diagnostic.flags,
            level: diagnostic.level.into(),
            alarm: diagnostic.alarm.into(),
            alarms: diagnostic.alarms,
            residual_w: Some(diagnostic.residual_w),
            residual_z: Some(diagnostic.residual_z),
            bias_w: Some(diagnostic.bias_w),
            cusum_up: Some(diagnostic.cusum_up),
            cusum_down: Some(diagnostic.cusum_down),
            noise_ratio: Some(diagnostic.noise_ratio),
            coverage: Some(diagnostic.coverage),
            coverage_recent: Some(diagnostic.coverage_recent),
            scored: diagnostic.scored,
            mae_w: Some(diagnostic.mae_w),
            r2: Some(diagnostic.r2),
            persistence_mae_w: Some(diagnostic.persistence_mae_w),
            persistence_r2: Some(diagnostic.persistence_r2),
            skill: Some(diagnostic.skill),
            sample_seq: diagnostic.sample_seq,
            stamp_ns: diagnostic.stamp_ns,
            source_epoch: diagnostic.source_epoch,
            refused: diagnostic.refused,
        }
    }
}

impl TryFrom<&proto::Diagnostic> for wire::Diagnostic {
    type Error = OutOfRange;

    fn try_from(diagnostic: &proto::Diagnostic) -> Result<Self, OutOfRange> {
        Ok(Self {
            robot: diagnostic.robot,
            flags: diagnostic.flags,
            level: narrow("Diagnostic.level", diagnostic.level)?,
            alarm: narrow("Diagnostic.alarm", diagnostic.alarm)?,
            alarms: diagnostic.alarms,
            residual_w: diagnostic.residual_w.unwrap_or(f32::NAN),
            residual_z: diagnostic.residual_z.unwrap_or(f32::NAN),
            bias_w: diagnostic.bias_w.unwrap_or(f32::NAN),
            cusum_up: diagnostic.cusum_up.unwrap_or(f32::NAN),
            cusum_down: diagnostic.cusum_down.unwrap_or(f32::NAN),
            noise_ratio: diagnostic.noise_ratio.unwrap_or(f32::NAN),
            coverage: diagnostic.coverage.unwrap_or(f32::NAN),
            coverage_recent: diagnostic.coverage_recent.unwrap_or(f32::NAN),
            scored: diagnostic.scored,
            mae_w: diagnostic.mae_w.unwrap_or(f64::NAN),
            r2: diagnostic.r2.unwrap_or(f64::NAN),
            persistence_mae_w: diagnostic.persistence_mae_w.unwrap_or(f64::NAN),
            persistence_r2: diagnostic.persistence_r2.unwrap_or(f64::NAN),
            skill: diagnostic.skill.unwrap_or(f64::NAN),
            sample_seq: diagnostic.sample_seq,
            stamp_ns: diagnostic.stamp_ns,
            source_epoch: diagnostic.source_epoch,
            refused: diagnostic.refused,
        })
    }
}

impl From<&wire::Budget> for proto::Budget {
    fn from(budget: &wire::Budget) -> Self {
        Self {
            robot: budget.robot,
            flags: budget.flags,
            charge_state: budget.charge_state as i32,
            reserved: budget.reserved,
            drawn_uj: budget.drawn_uj,
            drawn_remainder: budget.drawn_remainder,
            forecast_uj: budget.forecast_uj,
            metered_ns: budget.metered_ns,
            unmetered_ns: budget.unmetered_ns,
            stamp_ns: budget.stamp_ns,
            valid_until_ns: budget.valid_until_ns,
            mean_power_w: Some(budget.mean_power_w),
            left_j: Some(budget.left_j),
            usable_j: Some(budget.usable_j),
            usable_lo_j: Some(budget.usable_lo_j),
            soc: Some(budget.soc),
            soc_lo: Some(budget.soc_lo),
            time_to_empty_s: Some(budget.time_to_empty_s),
            time_to_empty_lo_s: Some(budget.time_to_empty_lo_s),
            time_to_empty_hi_s: Some(budget.time_to_empty_hi_s),
            reserved2: budget.reserved2,
        }
    }
}

impl TryFrom<&proto::Budget> for wire::Budget {
    type Error = OutOfRange;

    fn try_from(budget: &proto::Budget) -> Result<Self, OutOfRange> {
        Ok(Self {
            robot: budget.robot,
            flags: budget.flags,
            charge_state: budget.charge_state as u32,
            reserved: budget.reserved,
            drawn_uj: budget.drawn_uj,
            drawn_remainder: budget.drawn_remainder,
            forecast_uj: budget.forecast_uj,
            metered_ns: budget.metered_ns,
            unmetered_ns: budget.unmetered_ns,
            stamp_ns: budget.stamp_ns,
            valid_until_ns: budget.valid_until_ns,
            mean_power_w: budget.mean_power_w.unwrap_or(f32::NAN),
            left_j: budget.left_j.unwrap_or(f32::NAN),
            usable_j: budget.usable_j.unwrap_or(f32::NAN),
            usable_lo_j: budget.usable_lo_j.unwrap_or(f32::NAN),
            soc: budget.soc.unwrap_or(f32::NAN),
            soc_lo: budget.soc_lo.unwrap_or(f32::NAN),
            time_to_empty_s: budget.time_to_empty_s.unwrap_or(f32::NAN),
            time_to_empty_lo_s: budget.time_to_empty_lo_s.unwrap_or(f32::NAN),
            time_to_empty_hi_s: budget.time_to_empty_hi_s.unwrap_or(f32::NAN),
            reserved2: budget.reserved2,
        })
    }
}

impl From<&wire::TakenFrame> for proto::TakenFrame {
    fn from(frame: &wire::TakenFrame) -> Self {
        Self {
            source_id: frame.source_id,
            source_epoch: frame.source_epoch,
            frame_seq: frame.frame_seq,
            taken_ns: frame.taken_ns,
            samples: frame.samples,
            truncated: frame.truncated,
        }
    }
}

impl TryFrom<&proto::TakenFrame> for wire::TakenFrame {
    type Error = OutOfRange;

    fn try_from(frame: &proto::TakenFrame) -> Result<Self, OutOfRange> {
        Ok(Self {
            source_id: frame.source_id,
            source_epoch: frame.source_epoch,
            frame_seq: frame.frame_seq,
            taken_ns: frame.taken_ns,
            samples: frame.samples,
            truncated: frame.truncated,
        })
    }
}

impl proto::Samples {
    pub(crate) fn new(header: &wire::SampleHeader, samples: &[wire::Sample]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            frame_seq: header.frame_seq,
            samples_before: header.samples_before,
            intended_ns: header.intended_ns,
            sent_ns: header.sent_ns,
            sent_at: timestamp(header.sent_unix_ns),
            samples: samples.iter().map(Into::into).collect(),
        }
    }

    pub(crate) fn rows(&self) -> Result<Vec<wire::Sample>, OutOfRange> {
        self.samples.iter().map(TryInto::try_into).collect()
    }

    pub(crate) fn header(&self) -> Result<wire::SampleHeader, OutOfRange> {
        Ok(wire::SampleHeader {
            schema: self.schema,
            pid: self.pid,
            source_id: self.source_id,
            source_epoch: self.source_epoch,
            frame_seq: self.frame_seq,
            samples_before: self.samples_before,
            intended_ns: self.intended_ns,
            sent_ns: self.sent_ns,
            sent_unix_ns: ns("Samples.sent_at", self.sent_at)?,
        })
    }
}

impl proto::Forecasts {
    pub(crate) fn new(header: &wire::ForecastHeader, forecasts: &[wire::Forecast]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            period_ns: header.period_ns,
            model_hash: header.model_hash,
            capacity: header.capacity,
            frames_taken: header.frames_taken,
            first_intended_ns: header.first_intended_ns,
            first_sent_ns: header.first_sent_ns,
            first_taken_ns: header.first_taken_ns,
            compute_start_ns: header.compute_start_ns,
            compute_end_ns: header.compute_end_ns,
            sent_ns: header.sent_ns,
            sent_at: timestamp(header.sent_unix_ns),
            ticks_skipped: header.ticks_skipped,
            ticks_late: header.ticks_late,
            samples_accepted: header.samples_accepted,
            samples_dropped: Some(drop_counts(&header.samples_dropped)),
            forecasts: forecasts.iter().map(Into::into).collect(),
        }
    }

    pub(crate) fn rows(&self) -> Result<Vec<wire::Forecast>, OutOfRange> {
        self.forecasts.iter().map(TryInto::try_into).collect()
    }

    pub(crate) fn header(&self) -> Result<wire::ForecastHeader, OutOfRange> {
        Ok(wire::ForecastHeader {
            schema: self.schema,
            pid: self.pid,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            period_ns: self.period_ns,
            model_hash: self.model_hash,
            capacity: self.capacity,
            frames_taken: self.frames_taken,
            first_intended_ns: self.first_intended_ns,
            first_sent_ns: self.first_sent_ns,
            first_taken_ns: self.first_taken_ns,
            compute_start_ns: self.compute_start_ns,
            compute_end_ns: self.compute_end_ns,
            sent_ns: self.sent_ns,
            sent_unix_ns: ns("Forecasts.sent_at", self.sent_at)?,
            ticks_skipped: self.ticks_skipped,
            ticks_late: self.ticks_late,
            samples_accepted: self.samples_accepted,
            samples_dropped: counts_of(self.samples_dropped.as_ref()),
        })
    }
}

impl proto::Diagnostics {
    pub(crate) fn new(header: &wire::DiagnosticHeader, diagnostics: &[wire::Diagnostic]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            refused: refusals(&header.refused),
            diagnostics: diagnostics.iter().map(Into::into).collect(),
        }
    }

    pub(crate) fn rows(&self) -> Result<Vec<wire::Diagnostic>, OutOfRange> {
        self.diagnostics.iter().map(TryInto::try_into).collect()
    }

    pub(crate) fn header(&self) -> Result<wire::DiagnosticHeader, OutOfRange> {
        Ok(wire::DiagnosticHeader {
            schema: self.schema,
            pid: self.pid,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            refused: refusals_of(&self.refused),
        })
    }
}

impl proto::Budgets {
    pub(crate) fn new(header: &wire::BudgetHeader, budgets: &[wire::Budget]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            sent_ns: header.sent_ns,
            sent_at: timestamp(header.sent_unix_ns),
            budgets: budgets.iter().map(Into::into).collect(),
        }
    }

    pub(crate) fn rows(&self) -> Result<Vec<wire::Budget>, OutOfRange> {
        self.budgets.iter().map(TryInto::try_into).collect()
    }

    pub(crate) fn header(&self) -> Result<wire::BudgetHeader, OutOfRange> {
        Ok(wire::BudgetHeader {
            schema: self.schema,
            pid: self.pid,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            sent_ns: self.sent_ns,
            sent_unix_ns: ns("Budgets.sent_at", self.sent_at)?,
        })
    }
}

impl proto::Ticks {
    pub(crate) fn new(header: &wire::TickHeader, frames: &[wire::TakenFrame]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            start_ns: header.start_ns,
            sent_ns: header.sent_ns,
            flags: header.flags,
            unlisted: header.unlisted,
            frames: frames.iter().map(Into::into).collect(),
        }
    }

    pub(crate) fn rows(&self) -> Result<Vec<wire::TakenFrame>, OutOfRange> {
        self.frames.iter().map(TryInto::try_into).collect()
    }

    pub(crate) fn header(&self) -> Result<wire::TickHeader, OutOfRange> {
        Ok(wire::TickHeader {
            schema: self.schema,
            pid: self.pid,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            start_ns: self.start_ns,
            sent_ns: self.sent_ns,
            flags: self.flags,
            unlisted: self.unlisted,
        })
    }
}

impl proto::State {
    pub(crate) fn new(header: &wire::StateHeader, bytes: &[u8]) -> Self {
        Self {
            schema: header.schema,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            total_bytes: header.total_bytes,
            offset: header.offset,
            taken_ns: header.taken_ns,
            sent_ns: header.sent_ns,
            sent_at: timestamp(header.sent_unix_ns),
            bytes: bytes.to_vec(),
        }
    }

    pub(crate) fn header(&self) -> Result<wire::StateHeader, OutOfRange> {
        Ok(wire::StateHeader {
            schema: self.schema,
            pid: self.pid,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            total_bytes: self.total_bytes,
            offset: self.offset,
            taken_ns: self.taken_ns,
            sent_ns: self.sent_ns,
            sent_unix_ns: ns("State.sent_at", self.sent_at)?,
        })
    }
}

fn drop_counts(drops: &wire::DropCounts) -> proto::DropCounts {
    let [
        unknown_robot,
        over_capacity,
        foreign_source,
        old_epoch,
        duplicate,
        out_of_order,
        bad_time,
        not_finite,
        power_out_of_range,
        command_out_of_range,
        bad_flags,
        backlog,
        overflow,
        schema,
        before_join,
        too_many_sources,
        later @ ..,
    ] = drops.counts;
    // Reasons without a name are rare: what follows the last that occurred is not written.
    let used = later.iter().rposition(|count| *count != 0);
    proto::DropCounts {
        unknown_robot,
        over_capacity,
        foreign_source,
        old_epoch,
        duplicate,
        out_of_order,
        bad_time,
        not_finite,
        power_out_of_range,
        command_out_of_range,
        bad_flags,
        backlog,
        overflow,
        schema,
        before_join,
        too_many_sources,
        later: later[..used.map_or(0, |last| last + 1)].to_vec(),
    }
}

fn counts_of(drops: Option<&proto::DropCounts>) -> wire::DropCounts {
    let mut counts = wire::DropCounts::default();
    let Some(drops) = drops else {
        return counts;
    };
    let named = [
        drops.unknown_robot,
        drops.over_capacity,
        drops.foreign_source,
        drops.old_epoch,
        drops.duplicate,
        drops.out_of_order,
        drops.bad_time,
        drops.not_finite,
        drops.power_out_of_range,
        drops.command_out_of_range,
        drops.bad_flags,
        drops.backlog,
        drops.overflow,
        drops.schema,
        drops.before_join,
        drops.too_many_sources,
    ];
    let all = named.iter().chain(&drops.later);
    for (count, found) in counts.counts.iter_mut().zip(all) {
        *count = *found;
    }
    counts
}

/// Places after the last that is taken are not written.
fn refusals(places: &[wire::Refusal]) -> Vec<proto::Refusal> {
    let empty = wire::Refusal::default();
    let used = places.iter().rposition(|place| *place != empty);
    places[..used.map_or(0, |last| last + 1)]
        .iter()
        .map(|place| proto::Refusal {
            robot: place.robot,
            reason: place.reason as i32,
            pid: place.pid,
            count: place.count,
        })
        .collect()
}

fn refusals_of<const PLACES: usize>(refused: &[proto::Refusal]) -> [wire::Refusal; PLACES] {
    let mut places = [wire::Refusal::default(); PLACES];
    for (place, found) in places.iter_mut().zip(refused) {
        *place = wire::Refusal {
            robot: found.robot,
            reason: found.reason as u32,
            pid: found.pid,
            count: found.count,
        };
    }
    places
}
