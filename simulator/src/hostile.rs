//! A process of the user that sends false frames on every service.

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, SCHEMA_VERSION,
    Sample, SampleHeader, StateHeader, TickHeader, WakeEvent, budget_flag, sample_flag,
};
use simulated_bus::Bus;
use simulated_config::Config;
use simulated_host::{self as host, time};

use crate::process::FALSE_ROBOT;

/// Its pid: no other process ever has it.
const PID: u32 = 77_777;

/// A number as a liar chooses it: of now, far ahead, behind, or anything.
fn any(near: u64) -> u64 {
    match host::below(6) {
        0 => near,
        1 => near.wrapping_add(host::below(1_000) as u64),
        2 => near.wrapping_add(3_600_000_000_000),
        3 => near.saturating_sub(host::below(1_000_000_000) as u64),
        4 => u64::MAX - host::below(3) as u64,
        _ => host::below(1_000) as u64,
    }
}

fn schema() -> u32 {
    if host::once_in(10) {
        host::below(9) as u32
    } else {
        SCHEMA_VERSION
    }
}

/// Sends `frames` false frames on each service, and leaves.
pub(crate) fn attack(config: &Config, frames: u64, regular: usize) {
    host::begin_life(PID);
    host::enter(PID, host::USUAL_COST_NS);
    // It may fail where the fleet's processes do: shared memory is full, or all ports are taken.
    let _ = send(config, frames, regular);
    let _ = host::leave();
    simulated_bus::remove_process(PID);
    host::end_life(PID);
}

fn send(config: &Config, frames: u64, regular: usize) -> Option<()> {
    let bus = Bus::join(&config.domain().ok()?, "hostile").ok()?;
    let limits = config.limits();
    let mut forecasts = bus.forecast_writer(&limits).ok()?;
    let mut diagnostics = bus.diagnostic_writer(&limits).ok()?;
    let mut budgets = bus.budget_writer(&limits).ok()?;
    let mut ticks = bus.tick_writer(&limits).ok()?;
    let mut state = bus.state_writer(&limits).ok()?;
    let waker = bus.planner_waker(&limits).ok()?;
    let pids = [PID, 100 + host::below(40) as u32];
    for _ in 0..frames {
        let now_ns = time::monotonic_ns();
        let pid = pids[host::below(2)];
        let (schema, worker_epoch, tick) = (schema(), any(now_ns), any(1_000));
        let header = ForecastHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            sent_ns: any(now_ns),
            period_ns: any(1_000_000_000),
            ..ForecastHeader::default()
        };
        let row = Forecast {
            robot: FALSE_ROBOT,
            ..Forecast::default()
        };
        let _ = forecasts.send(header, 1, |_| row);
        let header = DiagnosticHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            ..Default::default()
        };
        let row = Diagnostic {
            robot: FALSE_ROBOT,
            ..Diagnostic::default()
        };
        let _ = diagnostics.send(header, 1, |_| row);
        let header = BudgetHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            ..Default::default()
        };
        let row = Budget {
            robot: FALSE_ROBOT,
            flags: budget_flag::LEDGER,
            drawn_uj: i64::MAX,
            ..Budget::default()
        };
        let _ = budgets.send(header, 1, |_| row);
        let header = TickHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            ..Default::default()
        };
        let _ = ticks.send(header, 0, |_| Default::default());
        let header = StateHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            ..Default::default()
        };
        let _ = state.send(header, 9, |_| host::below(256) as u8);
        let event = [WakeEvent::Frame, WakeEvent::Died, WakeEvent::Ended][host::below(3)];
        let _ = waker.wake(event);
    }
    samples(&bus, config, frames, regular)
}

/// False samples: of robots of its own, and impossible ones of the fleet's.
fn samples(bus: &Bus, config: &Config, frames: u64, regular: usize) -> Option<()> {
    let mut writer = bus.sample_writer(&config.limits(), 4).ok()?;
    for number in 0..frames {
        let now_ns = time::monotonic_ns();
        let header = SampleHeader {
            schema: schema(),
            pid: PID,
            source_id: 900_000 + number % 3,
            source_epoch: any(now_ns),
            frame_seq: host::number(),
            samples_before: any(number),
            sent_ns: any(now_ns),
            ..SampleHeader::default()
        };
        let _ = writer.send(header, 1 + host::below(4), |_| {
            let own = host::once_in(2);
            let robot = if own {
                800_000 + host::below(3)
            } else {
                host::below(10 * regular)
            };
            let mut sample = Sample::new(robot as u32, any(number), any(now_ns));
            let wrong = [f32::NAN, f32::INFINITY, -5.0, 1e30][host::below(4)];
            let power_w = if own && host::once_in(2) { 3.0 } else { wrong };
            sample = sample.reading(power_w, any(now_ns));
            if host::once_in(4) {
                sample = sample.with(sample_flag::CHARGING | 1 << 20);
            }
            sample
        });
    }
    Some(())
}
