//! A process of the user that sends false frames on every service.

use bytemuck::{Zeroable as _, bytes_of_mut};
use joulebus_config::Config;
use joulebus_wire::{
    Channel, Flow, ForEachChannel, FrameHeader as _, FrameOrder, FrameRows, QueryHeader,
    SCHEMA_VERSION, Sample, SampleHeader, WakeEvent, each_channel, sample_flag,
};
use simulated_bus::{Bus, Limits};
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

/// Sends a false frame of a channel, with that schema, process and order.
type SendFalse = Box<dyn FnMut(u32, u32, FrameOrder)>;

/// Opens every channel but samples.
struct Open<'a>(&'a Bus, Limits, Option<Vec<SendFalse>>);

impl ForEachChannel for Open<'_> {
    fn channel<C: Channel>(&mut self) {
        let Self(bus, limits, Some(opened)) = self else { return };
        if C::FLOW == Flow::Sources {
            return;
        }
        let Ok(mut writer) = bus.writer::<C>(limits) else {
            self.2 = None;
            return;
        };
        opened.push(Box::new(move |schema, pid, order| {
            let now_ns = time::monotonic_ns();
            let mut header = C::Header::zeroed();
            bytes_of_mut(&mut header)[..4].copy_from_slice(&schema.to_ne_bytes());
            header.set_order(pid, order);
            header.set_sent(any(now_ns), any(now_ns));
            if let Some(period_ns) = header.period_ns() {
                *period_ns = any(1_000_000_000);
            }
            let mut row = C::Row::zeroed();
            bytes_of_mut(&mut row).fill(host::below(256) as u8);
            let of_robots = C::ROWS == FrameRows::Robots;
            if of_robots {
                bytes_of_mut(&mut row)[..4].copy_from_slice(&FALSE_ROBOT.to_ne_bytes());
            }
            let len = if of_robots { 1 } else { host::below(3) };
            let _ = writer.send(header, len, |_| row);
        }));
    }
}

fn send(config: &Config, frames: u64, regular: usize) -> Option<()> {
    let bus = Bus::join(&config.domain().ok()?, "hostile").ok()?;
    let limits = config.limits();
    let mut open = Open(&bus, limits, Some(Vec::new()));
    each_channel(&mut open);
    let mut channels = open.2?;
    let waker = bus.planner_waker(&limits).ok()?;
    let pids = [PID, 100 + host::below(40) as u32];
    for _ in 0..frames {
        let pid = pids[host::below(2)];
        let order = FrameOrder { run: any(time::monotonic_ns()), number: any(1_000) };
        let schema = schema();
        for send in &mut channels {
            send(schema, pid, order);
        }
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
