//! Sources with random faults on the path to the fleet.

use std::collections::VecDeque;

use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{PERIOD_NS, SLOW_NS, Source, healthy};
use joulebus_wire::{Sample, SampleHeader, sample_flag};

use super::robot::rarely;

/// Fault rates: one event in that many.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    pub sample: u64,
    pub frame: u64,
}

/// A frame in transit.
#[derive(Debug, Clone)]
pub(crate) struct Delivery {
    pub at_ns: u64,
    pub header: SampleHeader,
    pub samples: Vec<Sample>,
    /// Samples of this run that were lost since the last frame that arrived.
    pub lost: u64,
}

/// A source of samples of some robots, once per period.
pub(crate) struct Sender {
    source: Source,
    period_ns: u64,
    robots: Vec<Speaker>,
    due_ns: u64,
    silent_until_ns: u64,
    clock_offset_ns: u64,
    overtaken: Vec<Sample>,
    in_flight: VecDeque<Delivery>,
    lost: u64,
    last_sent: Option<(SampleHeader, Vec<Sample>)>,
}

struct Speaker {
    id: u32,
    seq: u64,
    step: u64,
    measured: Option<(f32, u64)>,
    silent_until_ns: u64,
}

impl Sender {
    pub(crate) fn new(id: u64, robots: &[u32], slow: bool, start_ns: u64) -> Self {
        let speaker =
            |id: &u32| Speaker { id: *id, seq: 0, step: 0, measured: None, silent_until_ns: 0 };
        Self {
            source: Source::new(id, 10),
            period_ns: if slow { SLOW_NS } else { PERIOD_NS },
            robots: robots.iter().map(speaker).collect(),
            due_ns: start_ns + id,
            silent_until_ns: 0,
            clock_offset_ns: 0,
            overtaken: Vec::new(),
            in_flight: VecDeque::new(),
            lost: 0,
            last_sent: None,
        }
    }

    /// The header of its present run.
    pub(crate) const fn header(&self) -> SampleHeader {
        self.source.header
    }

    /// Frames that arrive up to `now_ns`, in the order in which they were sent.
    pub(crate) fn arrivals(
        &mut self,
        now_ns: u64,
        rates: Rates,
        noise: &mut Noise,
    ) -> Vec<Delivery> {
        while self.due_ns <= now_ns {
            self.send(rates, noise);
        }
        let mut arrived = Vec::new();
        while self.in_flight.front().is_some_and(|next| next.at_ns <= now_ns) {
            arrived.extend(self.in_flight.pop_front());
        }
        arrived
    }

    fn send(&mut self, rates: Rates, noise: &mut Noise) {
        let now_ns = self.due_ns;
        // Mostly steady; sometimes up to the limit of a gap, and beyond.
        let jitter_ns = if rarely(noise, 8) { self.period_ns * 5 / 4 } else { self.period_ns / 4 };
        self.due_ns += self.period_ns - jitter_ns / 2 + noise.next_u64() % jitter_ns;
        if now_ns < self.silent_until_ns {
            return;
        }
        if rarely(noise, 4 * rates.frame) {
            // From a moment to longer than the fleet keeps a silent robot.
            self.silent_until_ns = now_ns + (noise.next_u64() % 100) * self.period_ns;
        }
        if rarely(noise, 4 * rates.frame) {
            self.restart(noise);
        }
        let mut samples = std::mem::take(&mut self.overtaken);
        for at in 0..self.robots.len() {
            self.publish(at, now_ns - self.clock_offset_ns, rates, noise, &mut samples);
        }
        let header = self.source.frame(samples.len());
        if rarely(noise, rates.frame) {
            self.lost += samples.len() as u64;
            return; // The next header reports it.
        }
        // The bus keeps the order of one source's frames.
        let not_before = self.in_flight.back().map_or(0, |frame| frame.at_ns);
        let late_ns =
            if rarely(noise, rates.frame) { 8 * self.period_ns } else { self.period_ns / 4 };
        let at_ns = not_before.max(now_ns + noise.next_u64() % late_ns);
        let mut deliver = |header, samples, lost| {
            self.in_flight.push_back(Delivery { at_ns, header, samples, lost });
        };
        // Invalid frames: a duplicate, one from a replaced run, one of another schema.
        if let Some((before, again)) = self.last_sent.take() {
            if rarely(noise, rates.frame) {
                deliver(before, again, 0);
            }
            let (mut old, mut strange) = (header, header);
            old.source_epoch -= 1;
            strange.schema += 1;
            for useless in [old, strange] {
                if rarely(noise, 2 * rates.frame) {
                    deliver(useless, samples.clone(), 0);
                }
            }
        }
        deliver(header, samples.clone(), std::mem::take(&mut self.lost));
        self.last_sent = Some((header, samples));
    }

    /// A new run of the source, possibly with a restarted clock.
    fn restart(&mut self, noise: &mut Noise) {
        let old = self.source.header;
        self.lost = 0; // No header reports it.
        self.source = Source::new(old.source_id, old.source_epoch + 1 + noise.next_u64() % 3);
        if rarely(noise, 2) {
            self.clock_offset_ns = noise.next_u64() % (20 * PERIOD_NS);
        }
        for robot in &mut self.robots {
            robot.seq = 0;
        }
        self.last_sent = None;
    }

    fn publish(
        &mut self,
        at: usize,
        stamp_ns: u64,
        rates: Rates,
        noise: &mut Noise,
        samples: &mut Vec<Sample>,
    ) {
        let robot = &mut self.robots[at];
        robot.step += 1;
        robot.seq += 1;
        if stamp_ns < robot.silent_until_ns {
            return;
        }
        let mut sample = healthy(robot.id, robot.step, stamp_ns, self.period_ns);
        sample.seq = robot.seq;
        if let Some((power_w, measured_ns)) = robot.measured
            && sample.has(sample_flag::HELD)
        {
            (sample.power_w, sample.measured_ns) = (power_w, measured_ns.min(stamp_ns));
        }
        robot.measured = Some((sample.power_w, sample.measured_ns));
        if rarely(noise, 8 * rates.sample) {
            robot.silent_until_ns = stamp_ns + (noise.next_u64() % 90) * self.period_ns;
        }
        if !rarely(noise, rates.sample) {
            samples.push(sample);
            return;
        }
        let spoilt = spoil(sample, noise);
        match noise.next_u64() % 4 {
            0 => {} // Never sent.
            1 => samples.extend([spoilt, spoilt]),
            2 => self.overtaken.push(spoilt),
            _ => samples.push(spoilt),
        }
    }
}

/// Applies one fault to a sample, from minor to absurd.
fn spoil(mut sample: Sample, noise: &mut Noise) -> Sample {
    let absurd =
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -f32::MAX, 1e-40, -5.0, 20.0, -0.0]
            [(noise.next_u64() % 9) as usize];
    match noise.next_u64() % 16 {
        0 => sample.power_w = absurd,
        1 => sample.v_mps = absurd,
        2 => sample.omega_radps = absurd,
        3 => sample = sample.battery(absurd, 0.5),
        4 => sample.flags &= !sample_flag::POWER,
        5 => sample.flags &= !sample_flag::V,
        6 => sample.flags &= !(sample_flag::V | sample_flag::OMEGA),
        7 => sample.flags ^= sample_flag::HELD,
        8 => sample.flags |= sample_flag::CHARGING,
        9 => sample.flags |= sample_flag::DISCONTINUITY,
        // Any but OFF, whose pauses have tests of their own.
        10 => sample.flags |= (1 << (8 + noise.next_u64() % 24)) & !sample_flag::OFF,
        // A battery's values: sensible, absurd, and contradictory.
        15 => match noise.next_u64() % 4 {
            0 => sample = sample.state_of_charge((noise.next_u64() % 101) as f32 / 100.0),
            1 => sample = sample.return_energy((noise.next_u64() % 9_000) as f32),
            2 => sample = sample.with(sample_flag::CHARGING | sample_flag::FULL),
            _ => sample = sample.state_of_charge(absurd).return_energy(-absurd),
        },
        11 => sample.stamp_ns = noise.next_u64() >> (noise.next_u64() % 64),
        12 => sample.measured_ns = sample.stamp_ns + 1,
        13 => sample.seq = sample.seq.saturating_sub(noise.next_u64() % 4),
        14 => sample.robot = [3, 101, 150, 299, 300, u32::MAX][(noise.next_u64() % 6) as usize],
        _ => {}
    }
    sample
}
