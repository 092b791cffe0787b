//! A simulated worker, and the verification of what it sends.

use std::collections::HashMap;
use std::sync::Arc;

use joulebus_capture_format::{Entry, Message, MessageKind, Query};
use joulebus_capture_verify::{Verification, Verifier};
use joulebus_fleet::Fleet;
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{
    BudgetHeader, Budgets, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts, OutlookHeader,
    Outlooks, PlanStateHeader, PlanStates, SCHEMA_VERSION, Sample, Samples, State, StateHeader,
    Statement, TakenFrame, TickHeader, Ticks, fnv1a, sample_flag, tick_flag,
};

pub(crate) const CAPACITY: u32 = 12;
pub(crate) const EPOCH: u64 = 1_000;
pub(crate) const START_NS: u64 = 60_000 * MS;
/// Ticks between two keyframes, and from the state to the keyframe's arrival.
pub(crate) const KEYFRAME_EVERY: u64 = 40;
pub(crate) const KEYFRAME_LATE: u64 = 6;
pub(crate) const PIECE_BYTES: usize = 1_000;
/// A robot that its source finds implausible.
pub(crate) const DOUBTED: u32 = 2;
/// A robot that draws three times as much from a step on, and the tick in which a person has
/// acknowledged that as its new normal. Every third reading is new, so it takes a while to be
/// judged.
pub(crate) const LOADED: u32 = 2;
pub(crate) const LOADED_FROM: u64 = 500;
pub(crate) const NEW_NORMAL_AT: u64 = 800;

/// A simulated worker, with everything that it and its sources send, in order.
pub(crate) struct Simulation {
    fleet: Fleet,
    sources: [Source; 2],
    noise: Noise,
    worker_epoch: u64,
    tick: u64,
    step: u64,
    now_ns: u64,
    pub(crate) sent: Vec<Message>,
    late: Vec<(u64, Message)>,
    /// Hash of the newest keyframe of the run.
    keyframe_hash: u64,
}

impl Simulation {
    pub(crate) fn new(seed: u64) -> Self {
        Self::of(seed, world::fleet(CAPACITY))
    }

    pub(crate) fn of(seed: u64, fleet: Fleet) -> Self {
        let mut simulation = Self {
            fleet,
            sources: [Source::new(1, 1), Source::new(2, 1)],
            noise: Noise(seed),
            worker_epoch: EPOCH,
            tick: 0,
            step: 0,
            now_ns: START_NS,
            sent: Vec::new(),
            late: Vec::new(),
            keyframe_hash: 0,
        };
        simulation.keyframe();
        simulation
    }

    pub(crate) fn restart(&mut self) {
        let late = std::mem::take(&mut self.late);
        self.sent.extend(late.into_iter().map(|(_, message)| message));
        self.fleet = world::fleet(CAPACITY);
        (self.worker_epoch, self.tick) = (self.worker_epoch + 1, 0);
        self.keyframe_hash = 0;
        self.keyframe();
    }

    fn keyframe(&mut self) {
        let mut bytes = Vec::new();
        self.fleet.state().encode_into(&mut bytes);
        let hash = fnv1a(bytes.iter().copied());
        let before_hash = std::mem::replace(&mut self.keyframe_hash, hash);
        let due = if self.tick == 0 { 0 } else { self.tick + KEYFRAME_LATE };
        for (place, piece) in bytes.chunks(PIECE_BYTES).enumerate() {
            let header = StateHeader {
                schema: SCHEMA_VERSION,
                worker_epoch: self.worker_epoch,
                tick: self.tick,
                total_bytes: bytes.len() as u64,
                offset: (place * PIECE_BYTES) as u64,
                before_hash,
                ..StateHeader::default()
            };
            self.late.push((due, Message::of::<State>(header, piece.to_vec())));
        }
    }

    fn samples(&mut self, source: usize) -> Vec<Sample> {
        let robots: &[u32] =
            [&[1, 2, 3, 101, 102, 201][..], &[4, 5, 6, 103, 202, 203, 204][..]][source];
        let mut samples = Vec::new();
        for robot in robots {
            let mut sample = healthy(*robot, self.step, self.now_ns, PERIOD_NS);
            if *robot == LOADED && self.step >= LOADED_FROM {
                sample.power_w *= 3.0;
            }
            if *robot == DOUBTED {
                sample.flags |= sample_flag::IMPLAUSIBLE;
            }
            match self.noise.next_u64() % 40 {
                0 => continue,
                1 => sample.power_w = f32::NAN,
                2 => sample.flags &= !sample_flag::POWER,
                3 => sample.v_mps = 9.0,
                4 => sample.robot += 1_000,
                _ => {}
            }
            samples.push(sample);
        }
        samples
    }

    pub(crate) fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.now_ns += PERIOD_NS + self.noise.next_u64() % MS;
            self.step += 1;
            self.turn();
        }
    }

    fn turn(&mut self) {
        let mut taken = Vec::new();
        for source in 0..2 {
            // Sometimes a source stalls, and sends nothing for a while.
            if self.noise.next_u64().is_multiple_of(15) {
                continue;
            }
            let samples = self.samples(source);
            let header = self.sources[source].frame(samples.len());
            let taken_ns = self.now_ns + self.noise.next_u64() % MS;
            self.fleet.take(&header, &samples, taken_ns);
            taken.push(TakenFrame {
                source_id: header.source_id,
                source_epoch: header.source_epoch,
                frame_seq: header.frame_seq,
                taken_ns,
                samples: samples.len() as u32,
                truncated: 0,
            });
            self.sent.push(Message::of::<Samples>(header, samples));
        }
        let start_ns = self.now_ns + 2 * MS;
        // Also in the last tick before a keyframe, and in the first one after it.
        let normal = match self.tick + 1 {
            NEW_NORMAL_AT => Some(LOADED),
            tick if tick % KEYFRAME_EVERY < 2 => Some(LOADED + 1),
            _ => None,
        };
        if let Some(robot) = normal {
            self.fleet.take_statement(robot, Statement::NewNormal, start_ns);
            taken.push(TakenFrame::stated(robot, Statement::NewNormal, start_ns));
        }
        let missed = self.noise.next_u64().is_multiple_of(10);
        let intake = self.fleet.tick(start_ns, missed);
        self.tick += 1;
        let (first_intended_ns, first_sent_ns, first_taken_ns) = intake.first.unwrap_or_default();
        let header = ForecastHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            period_ns: PERIOD_NS,
            model_hash: self.fleet.model_hash(),
            capacity: CAPACITY,
            frames_taken: intake.frames,
            first_intended_ns,
            first_sent_ns,
            first_taken_ns,
            compute_start_ns: start_ns,
            samples_accepted: self.fleet.accepted(),
            samples_dropped: self.fleet.drops(),
            ..ForecastHeader::default()
        };
        self.publish(header);
        let journal = TickHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: self.worker_epoch,
            tick: self.tick,
            start_ns,
            flags: u32::from(missed) * tick_flag::DEADLINE_MISSED
                + u32::from(self.plans()) * (tick_flag::PLAN_STATES | tick_flag::OUTLOOKS),
            ..TickHeader::default()
        };
        self.sent.push(Message::of::<Ticks>(journal, taken));
        if self.tick.is_multiple_of(KEYFRAME_EVERY) {
            self.keyframe();
        }
        let tick = self.tick;
        for (_, message) in self.late.extract_if(.., |(due, _)| *due <= tick) {
            self.sent.push(message);
        }
    }

    /// True if somebody reads what plans start from: for ten of every forty ticks nobody does.
    fn plans(&self) -> bool {
        self.tick % 40 < 30
    }

    fn publish(&mut self, header: ForecastHeader) {
        let robots = 0..self.fleet.len();
        let (worker_epoch, tick) = (self.worker_epoch, self.tick);
        let compute_start_ns = header.compute_start_ns;
        let forecasts = robots.clone().map(|place| self.fleet.forecast(place));
        self.sent.push(Message::of::<Forecasts>(header, forecasts.collect()));
        let header = DiagnosticHeader {
            schema: SCHEMA_VERSION,
            worker_epoch,
            tick,
            refused: self.fleet.refusals(),
            platforms: self.fleet.platform_memories(),
            ..DiagnosticHeader::default()
        };
        let diagnostics = robots.clone().map(|place| self.fleet.diagnostic(place));
        self.sent.push(Message::of::<Diagnostics>(header, diagnostics.collect()));
        let header =
            BudgetHeader { schema: SCHEMA_VERSION, worker_epoch, tick, ..BudgetHeader::default() };
        let budgets = robots.clone().map(|place| self.fleet.budget(place));
        self.sent.push(Message::of::<Budgets>(header, budgets.collect()));
        if !self.plans() {
            return;
        }
        let header = PlanStateHeader {
            schema: SCHEMA_VERSION,
            worker_epoch,
            tick,
            period_ns: PERIOD_NS,
            settings_hash: self.fleet.settings_hash(),
            model_hash: self.fleet.model_hash(),
            models: self.fleet.model_hashes(),
            compute_start_ns,
            ..PlanStateHeader::default()
        };
        let rows = robots.clone().map(|place| self.fleet.plan_state(place));
        self.sent.push(Message::of::<PlanStates>(header, rows.collect()));
        let header = OutlookHeader {
            schema: SCHEMA_VERSION,
            worker_epoch,
            tick,
            period_ns: PERIOD_NS,
            model_hash: self.fleet.model_hash(),
            compute_start_ns,
            ..OutlookHeader::default()
        };
        let rows = robots.map(|place| self.fleet.outlook(place));
        self.sent.push(Message::of::<Outlooks>(header, rows.collect()));
    }
}

pub(crate) fn recorded(seed: u64, ticks: u64) -> Vec<Message> {
    let mut simulation = Simulation::new(seed);
    simulation.run(ticks);
    simulation.sent
}

/// Numbers messages by channel, as a recorder does.
pub(crate) fn entries(messages: Vec<Message>) -> Vec<Entry> {
    let mut sequences: HashMap<MessageKind, u32> = HashMap::new();
    let entry = |(place, message): (usize, Message)| {
        let kind = message.kind().unwrap();
        let sequence = sequences.entry(kind).or_default();
        *sequence += 1;
        Entry {
            topic: kind.topic("lab", 0).into(),
            fleet: Arc::from("lab"),
            log_time_ns: 1_000_000 * place as u64,
            publish_time_ns: 0,
            sequence: *sequence - 1,
            message,
        }
    };
    messages.into_iter().enumerate().map(entry).collect()
}

pub(crate) fn verify(entries: impl IntoIterator<Item = Entry>) -> Verification {
    let verifier = Verifier::new(world::settings(CAPACITY), world::models());
    verify_by(verifier.unwrap().with_period_ns(PERIOD_NS), entries)
}

pub(crate) fn verify_by(
    mut verifier: Verifier,
    entries: impl IntoIterator<Item = Entry>,
) -> Verification {
    for entry in entries {
        verifier.push(entry);
    }
    verifier.finish()
}

pub(crate) fn tick_of(message: &Message) -> u64 {
    // Frames of samples are not of a tick, and keyframes are of one before.
    let is_of_tick = message.frame::<Samples>().is_none() && message.frame::<State>().is_none();
    let frame = message.order().filter(|_| is_of_tick && message.get::<Query>().is_none());
    frame.map_or(0, |place| place.number)
}
