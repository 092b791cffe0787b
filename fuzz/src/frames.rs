//! Frames as another process might write them into shared memory, in any order, at any time:
//! `Fleet` agrees with the oracle.
//!
//! An input is a first byte of options, then steps: a tick some time later, a new run of a source,
//! or a frame of valid samples with any field overwritten.

use std::sync::OnceLock;

use joulebus_fleet::{Fleet, FleetState};
use joulebus_predictor::Model;
use joulebus_settings::FleetSettings;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{DropReason, FieldLayout, Row as _, Sample, SampleHeader};

use super::input::Input;
use super::oracle::{Oracle, compare};

/// The oracle's time per sample grows with the history.
const MAX_STEPS: usize = 64;
const MAX_SAMPLES: usize = 8;
const START_NS: u64 = 60_000 * MS;
/// Fewer than the robot ids that an input can name.
const CAPACITY: u32 = 9;

/// Robots of every platform, and one that is not configured.
const ROBOTS: [u32; 13] = [0, 1, 2, 3, 99, 100, 101, 199, 200, 201, 202, 299, 300];

/// Settings and models, by the options in an input's first byte.
pub(crate) fn setting(options: u8) -> (FleetSettings, Vec<Model>) {
    static MODELS: OnceLock<[Vec<Model>; 2]> = OnceLock::new();
    let models = MODELS.get_or_init(|| [world::models(), world::fresh_models()]);
    let settings = match options & 2 {
        0 => world::settings(CAPACITY),
        _ => world::learning(CAPACITY),
    };
    (settings, models[usize::from(options & 1)].clone())
}

/// The sources of an input, and the numbers of their robots' samples.
struct Sources {
    runs: [Source; 6],
    seqs: [u64; ROBOTS.len()],
}

impl Sources {
    fn new() -> Self {
        Self { runs: std::array::from_fn(|id| Source::new(id as u64, 10)), seqs: [0; ROBOTS.len()] }
    }

    fn restart(&mut self, input: &mut Input<'_>) {
        let run = &mut self.runs[usize::from(input.u8()) % 6];
        let header = run.header;
        *run = Source::new(header.source_id, header.source_epoch + u64::from(input.u8()));
        self.seqs = [0; ROBOTS.len()];
    }

    fn frame(&mut self, input: &mut Input<'_>, now_ns: u64) -> (SampleHeader, Vec<Sample>) {
        let run = usize::from(input.u8()) % 6;
        let samples = usize::from(input.u8()) % (MAX_SAMPLES + 1);
        let mut header = self.runs[run].frame(samples);
        for _ in 0..input.u8() % 4 {
            set_header(&mut header, input.u8(), input.u64());
        }
        let sample = |_| {
            let robot = usize::from(input.u8()) % ROBOTS.len();
            self.seqs[robot] += 1;
            let mut sample = healthy(ROBOTS[robot], self.seqs[robot], now_ns, PERIOD_NS);
            for _ in 0..input.u8() % 4 {
                set_sample(&mut sample, input.u8(), input.u64());
            }
            sample
        };
        (header, (0..samples).map(sample).collect())
    }
}

fn set_header(header: &mut SampleHeader, field: u8, value: u64) {
    match field % 9 {
        0 => header.schema = value as u32,
        1 => header.pid = value as u32,
        2 => header.source_id = value,
        3 => header.source_epoch = value,
        4 => header.frame_seq = value,
        5 => header.samples_before = value,
        6 => header.intended_ns = value,
        7 => header.sent_ns = value,
        _ => header.sent_unix_ns = value,
    }
}

fn set_sample(sample: &mut Sample, field: u8, value: u64) {
    let fields = Sample::LAYOUT.fields;
    match usize::from(field) % (fields.len() + 2) {
        0 => sample.flags ^= 1 << (value % 16),
        1 => sample.stamp_ns = sample.stamp_ns.wrapping_add_signed(i64::from(value as i32)),
        at => {
            let FieldLayout { offset, size, .. } = fields[at - 2];
            let bytes = &mut bytemuck::bytes_of_mut(sample)[offset..offset + size];
            bytes.copy_from_slice(&value.to_ne_bytes()[..size]);
        }
    }
}

pub(crate) fn run(bytes: &[u8]) -> bool {
    let mut input = Input(bytes);
    let (settings, models) = setting(input.u8());
    let mut fleet = Fleet::new(settings.clone(), models.clone()).expect("the settings agree");
    let mut oracle = Oracle::new(settings.clone(), models.clone());
    let mut sources = Sources::new();
    let (mut now_ns, mut offered) = (START_NS, 0);
    for _ in 0..MAX_STEPS {
        if input.is_empty() {
            break;
        }
        match input.u8() % 8 {
            0 => sources.restart(&mut input),
            1..3 => {
                now_ns += u64::from(input.u32());
                fleet.tick(now_ns, false);
                oracle.tick(now_ns);
                compare(&fleet, &oracle, now_ns).expect("the fleet does what the oracle does");
            }
            _ => {
                now_ns += u64::from(input.u8()) * MS;
                let (header, samples) = sources.frame(&mut input, now_ns);
                let parts = samples.split_at(samples.len() / 2);
                let frame = fleet.begin_frame(&header, samples.len() as u64, now_ns);
                fleet.take_part(&frame, parts.0);
                fleet.take_part(&frame, parts.1);
                oracle.take(&header, &samples, now_ns);
                offered += samples.len() as u64;
            }
        }
    }
    let lost = [DropReason::Overflow, DropReason::BeforeJoin];
    let drops = fleet.drops();
    let refused = drops.iter().filter(|(reason, _)| !lost.contains(reason));
    let refused: u64 = refused.map(|(_, count)| count).sum();
    assert_eq!(offered, fleet.accepted() + refused, "sent = accepted + dropped");
    assert!(fleet.len() <= CAPACITY as usize, "{} robots", fleet.len());

    let mut other = Fleet::new(settings, models).expect("the settings agree");
    let kept = encoded(&fleet);
    let state = FleetState::decode(&kept).expect("what was encoded is decoded");
    other.restore_state(&state).expect("the same settings and models");
    assert_eq!(encoded(&other), kept, "a fleet goes on from its own state");
    fleet.accepted() > 0
}

/// The complete state of a fleet.
pub(crate) fn encoded(fleet: &Fleet) -> Vec<u8> {
    let mut bytes = Vec::new();
    fleet.state().encode_into(&mut bytes);
    bytes
}
