//! A process of the user that sends false frames on every service.

use joulebus_config::Config;
use joulebus_wire::{
    Budget, BudgetHeader, Budgets, Diagnostic, DiagnosticHeader, Diagnostics, Forecast,
    ForecastHeader, Forecasts, Outlook, OutlookHeader, Outlooks, PlanState, PlanStateHeader,
    PlanStates, QueryHeader, SCHEMA_VERSION, Sample, SampleHeader, State, StateHeader, TickHeader,
    Ticks, WakeEvent, budget_flag, sample_flag,
};
use simulated_bus::Bus;
use simulated_host::{self as host, time};

use crate::process::FALSE_ROBOT;

/// Its pid: no other process ever has it.
const PID: u32 = 77_777;
/// Robots whose samples from it are taken.
pub(crate) const OWN_ROBOTS: [usize; 3] = [800_000, 800_001, 800_002];

/// A number as a liar chooses it: current, far ahead, behind, or anything.
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
    if host::once_in(10) { host::below(9) as u32 } else { SCHEMA_VERSION }
}

/// Sends `frames` false frames on each service, and leaves.
pub(crate) fn attack(config: &Config, frames: u64, regular: usize) {
    // It may fail where the fleet's processes do: shared memory is full, or all ports are taken.
    live(|| send(config, frames, regular));
}

/// Sends `frames` frames with the source, run and numbers of frames around that of `header`, and
/// leaves. Their samples, of the source's robots, are impossible, and more than the source's frames
/// have: equal lengths, taken by the worker and missed by the recorder, are a known limitation.
pub(crate) fn forge(config: &Config, frames: u64, header: &SampleHeader, robots: &[u32]) {
    live(|| {
        let bus = Bus::join(&config.domain().ok()?, "hostile").ok()?;
        let most = 2 * robots.len();
        let mut writer = bus.sample_writer(&config.limits(), most).ok()?;
        for _ in 0..frames {
            let ahead = host::below(4) as u64;
            let len = robots.len() as u64;
            let header = SampleHeader {
                frame_seq: header.frame_seq.saturating_add(ahead),
                samples_before: header.samples_before.saturating_add(ahead * len),
                sent_ns: any(time::monotonic_ns()),
                ..*header
            };
            let seq = any(header.frame_seq);
            let count = most - host::below(robots.len());
            let _ = writer.send(header, count, |place| {
                Sample::new(robots[place % robots.len()], seq, any(header.sent_ns))
                    .reading(f32::NAN, 0)
            });
        }
        Some(())
    });
}

/// Asks `count` questions that mean nothing, mostly without waiting for an answer, and leaves.
pub(crate) fn ask(config: &Config, count: u64) {
    live(|| {
        let bus = Bus::join(&config.domain().ok()?, "hostile").ok()?;
        for _ in 0..count {
            let mut client = bus.query_client(&config.limits()).ok()?;
            let values = [f64::NAN, f64::INFINITY, 0.0, 1e300, any(7) as f64];
            let len = host::below(200);
            let header = QueryHeader {
                schema: schema(),
                fleet: any(7),
                deadline_ns: any(time::monotonic_ns()),
                robots: any(1) as u32,
                kind: any(1) as u32,
                steps: any(20) as u32,
                candidates: any(2) as u32,
                ..QueryHeader::default()
            };
            let values: Vec<f64> = (0..len).map(|_| values[host::below(5)]).collect();
            let _ = client.send(header, &values);
        }
        Some(())
    });
}

/// A process that does `work`.
fn live(work: impl FnOnce() -> Option<()>) {
    host::begin_life(PID);
    host::enter(PID, host::USUAL_COST_NS);
    let _ = work();
    let _ = host::leave();
    simulated_bus::remove_process(PID);
    host::end_life(PID);
}

fn send(config: &Config, frames: u64, regular: usize) -> Option<()> {
    let bus = Bus::join(&config.domain().ok()?, "hostile").ok()?;
    let limits = config.limits();
    let mut forecasts = bus.writer::<Forecasts>(&limits).ok()?;
    let mut diagnostics = bus.writer::<Diagnostics>(&limits).ok()?;
    let mut budgets = bus.writer::<Budgets>(&limits).ok()?;
    let mut plan_states = bus.writer::<PlanStates>(&limits).ok()?;
    let mut outlooks = bus.writer::<Outlooks>(&limits).ok()?;
    let mut ticks = bus.writer::<Ticks>(&limits).ok()?;
    let mut state = bus.writer::<State>(&limits).ok()?;
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
        let row = Forecast { robot: FALSE_ROBOT, ..Forecast::default() };
        let _ = forecasts.send(header, 1, |_| row);
        let header = DiagnosticHeader { schema, pid, worker_epoch, tick, ..Default::default() };
        let row = Diagnostic { robot: FALSE_ROBOT, ..Diagnostic::default() };
        let _ = diagnostics.send(header, 1, |_| row);
        let header = BudgetHeader { schema, pid, worker_epoch, tick, ..Default::default() };
        let row = Budget {
            robot: FALSE_ROBOT,
            flags: budget_flag::LEDGER,
            drawn_uj: i64::MAX,
            ..Budget::default()
        };
        let _ = budgets.send(header, 1, |_| row);
        let header = PlanStateHeader {
            schema,
            pid,
            worker_epoch,
            tick,
            sent_ns: any(now_ns),
            ..Default::default()
        };
        let row = PlanState { robot: FALSE_ROBOT, ..PlanState::default() };
        let _ = plan_states.send(header, 1, |_| row);
        let header = OutlookHeader { schema, pid, worker_epoch, tick, ..Default::default() };
        let row = Outlook { robot: FALSE_ROBOT, ..Outlook::default() };
        let _ = outlooks.send(header, 1, |_| row);
        let header = TickHeader { schema, pid, worker_epoch, tick, ..Default::default() };
        let _ = ticks.send(header, 0, |_| Default::default());
        let header = StateHeader { schema, pid, worker_epoch, tick, ..Default::default() };
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
            frame_seq: any(host::number()),
            samples_before: any(number),
            sent_ns: any(now_ns),
            ..SampleHeader::default()
        };
        let _ = writer.send(header, 1 + host::below(4), |_| {
            let own = host::once_in(2);
            let robot = if own { OWN_ROBOTS[host::below(3)] } else { host::below(10 * regular) };
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
