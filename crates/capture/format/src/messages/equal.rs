//! Old and new.
use std::fmt::Debug;
use std::time::Instant;

use joulebus_wire::*;
use prost::Message as _;

use super::convert::{from_proto, to_proto};
use super::frame::Frame;
use super::{DecodeError, OutOfRange, parse, proto};

struct Random(u64);
impl Random {
    fn u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    fn fill(&mut self, bytes: &mut [u8]) {
        // Often zeros, ones, all bits.
        let mode = self.u64() % 4;
        for chunk in bytes.chunks_mut(4) {
            let value = match (mode, self.u64() % 8) {
                (0, _) => 0,
                (1, 0..=5) | (_, 0) => 0,
                (_, 1) => 1,
                (_, 2) => u32::MAX,
                (_, 3) => 0x8000_0000,
                (_, 4) => (self.u64() % 300) as u32,
                _ => self.u64() as u32,
            };
            chunk.copy_from_slice(&value.to_ne_bytes()[..chunk.len()]);
        }
    }
    fn row<T: bytemuck::Pod + Default>(&mut self) -> T {
        let mut row = T::default();
        self.fill(bytemuck::bytes_of_mut(&mut row));
        row
    }
}

fn old_decode<C: Channel, P, R>(data: &[u8], rows: impl Fn(&P) -> Result<Vec<C::Row>, OutOfRange>, header: impl Fn(&P) -> Result<C::Header, OutOfRange>) -> Result<Frame<C>, DecodeError>
where P: prost::Message + Default {
    let read: P = parse(data)?;
    Ok(Frame { header: header(&read)?, rows: rows(&read)? })
}

fn same<C: Channel>(old: &Result<Frame<C>, DecodeError>, new: &Result<Frame<C>, DecodeError>, what: &dyn Debug) {
    match (old, new) {
        (Ok(old), Ok(new)) => {
            assert_eq!(bytemuck::bytes_of(&old.header), bytemuck::bytes_of(&new.header), "{what:?} {old:?} {new:?}");
            assert_eq!(bytemuck::cast_slice::<_, u8>(&old.rows), bytemuck::cast_slice::<_, u8>(&new.rows), "{what:?} {:?} {:?}", old.rows, new.rows);
        }
        (Err(DecodeError::OutOfRange(old)), Err(DecodeError::OutOfRange(new))) => assert_eq!(old, new),
        (Err(DecodeError::Protobuf { .. }), Err(DecodeError::Protobuf { .. })) => {}
        _ => panic!("{what:?}: {old:?} {new:?}"),
    }
}

static COUNTS: [std::sync::atomic::AtomicU64; 4] = [const { std::sync::atomic::AtomicU64::new(0) }; 4];

fn check<C: Channel, P>(
    seed: u64,
    cases: u64,
    to: impl Fn(&C::Header, &[C::Row]) -> P,
    header: impl Fn(&P) -> Result<C::Header, OutOfRange> + Copy,
    rows: impl Fn(&P) -> Result<Vec<C::Row>, OutOfRange> + Copy,
) where
    P: prost::Message + Default,
{
    let old_of = |data: &[u8]| old_decode::<C, P, C::Row>(data, rows, header);
    let mut random = Random(seed);
    let mut pool: Vec<Vec<u8>> = Vec::new();
    for _ in 0..cases {
        let frame = Frame::<C> {
            header: random.row(),
            rows: (0..random.u64() % 5).map(|_| random.row()).collect(),
        };
        let old = to(&frame.header, &frame.rows).encode_to_vec();
        let mut new = Vec::new();
        frame.encode(&mut new);
        assert_eq!(old, new, "{frame:?}");
        let read = Frame::<C>::decode(&new, 0);
        same(&old_of(&old), &read, &"round trip");
        let read = read.unwrap();
        assert_eq!(bytemuck::bytes_of(&frame.header), bytemuck::bytes_of(&read.header));
        assert_eq!(bytemuck::cast_slice::<_, u8>(&frame.rows), bytemuck::cast_slice::<_, u8>(&read.rows));
        // Mutations: bytes changed, cut, inserted, joined with others, fields of generated contents.
        for _ in 0..40 {
            let mut data = new.clone();
            for _ in 0..1 + random.u64() % 3 {
                let at = (random.u64() % (data.len() as u64 + 1)) as usize;
                match random.u64() % 8 {
                    0 if at < data.len() => data[at] = random.u64() as u8,
                    1 if at < data.len() => data[at] ^= 1 << (random.u64() % 8),
                    2 => data.truncate(at),
                    3 => { let add = random.u64() as u8; data.insert(at, add); }
                    4 if at < data.len() => { data.remove(at); }
                    5 if !pool.is_empty() => { let other = &pool[(random.u64() % pool.len() as u64) as usize]; data.extend_from_slice(other); }
                    6 | 7 => {
                        let mut field = Vec::new();
                        generated(&mut random, 3, &mut field);
                        if random.u64() % 2 == 0 { data.extend(field) } else { let tail = data.split_off(at); data.extend(field); data.extend(tail) }
                    }
                    _ => {}
                }
            }
            let (old, new) = (old_of(&data), Frame::<C>::decode(&data, 0));
            same(&old, &new, &data);
            let which = match old { Ok(_) => 0, Err(DecodeError::Protobuf{..}) => 1, Err(_) => 2 };
            COUNTS[which].fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
        for _ in 0..20 {
            let mut data = Vec::new();
            for _ in 0..random.u64() % 6 { generated(&mut random, 3, &mut data); }
            let (old, new) = (old_of(&data), Frame::<C>::decode(&data, 0));
            same(&old, &new, &data);
            let which = match old { Ok(_) => 0, Err(DecodeError::Protobuf{..}) => 1, Err(_) => 2 };
            COUNTS[which].fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
        if pool.len() < 20 { pool.push(new); }
    }
}

fn varint(mut n: u64, out: &mut Vec<u8>) { while n >= 128 { out.push(n as u8 | 128); n >>= 7; } out.push(n as u8); }

fn generated(random: &mut Random, depth: u32, out: &mut Vec<u8>) {
    let number = if random.u64() % 20 == 0 { random.u64() % 600 } else { 1 + random.u64() % 41 };
    let wire = [0, 0, 0, 1, 1, 2, 2, 2, 2, 5, 5, 3, 4][(random.u64() % if random.u64() % 4 == 0 { 13 } else { 12 }) as usize];
    varint(number << 3 | wire, out);
    match wire {
        0 => varint(match random.u64() % 6 { 0 => random.u64(), 1 => 65_535 + random.u64() % 2, 2 => random.u64() % 100, 3 => u64::from(random.u64() as u32), 4 => random.u64() | 1 << 63, _ => random.u64() % 70_000 }, out),
        1 => out.extend(random.u64().to_le_bytes()),
        5 => out.extend((random.u64() as u32).to_le_bytes()),
        2 => {
            let mut inside = Vec::new();
            match random.u64() % 4 {
                0 => (0..random.u64() % 30).for_each(|_| varint(random.u64() >> (random.u64() % 64), &mut inside)),
                1 => (0..random.u64() % 6).for_each(|_| inside.extend(random.u64().to_le_bytes())),
                _ if depth > 0 => (0..random.u64() % 5).for_each(|_| generated(random, depth - 1, &mut inside)),
                _ => {}
            }
            varint(inside.len() as u64, out);
            out.extend(inside);
        }
        3 => {
            if depth > 0 { (0..random.u64() % 3).for_each(|_| generated(random, depth - 1, out)); }
            if random.u64() % 8 != 0 { varint(number << 3 | 4, out); }
        }
        _ => {}
    }
}

fn all(seed: u64, cases: u64) {
    check::<Samples, proto::Samples>(seed, cases, |h, r| proto::Samples { samples: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.samples));
    check::<Forecasts, proto::Forecasts>(seed, cases, |h, r| proto::Forecasts { forecasts: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.forecasts));
    check::<Diagnostics, proto::Diagnostics>(seed, cases, |h, r| proto::Diagnostics { diagnostics: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.diagnostics));
    check::<Budgets, proto::Budgets>(seed, cases, |h, r| proto::Budgets { budgets: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.budgets));
    check::<PlanStates, proto::PlanStates>(seed, cases, |h, r| proto::PlanStates { plan_states: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.plan_states));
    check::<Ticks, proto::Ticks>(seed, cases, |h, r| proto::Ticks { frames: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.frames));
    check::<State, proto::State>(seed, cases, |h, r| proto::State { bytes: r.to_vec(), ..h.into() }, |p| p.try_into(), |p| Ok(p.bytes.clone()));
}

#[test]
fn old_and_new_are_the_same() {
    let cases = std::env::var("CASES").map_or(60, |text| text.parse().unwrap());
    for seed in 0..cases / 20 { all(seed * 1_000_003, 20); }
    eprintln!("accepted, refused, out of range: {COUNTS:?}");
}

fn time<C: Channel, P>(
    to: impl Fn(&C::Header, &[C::Row]) -> P,
    header: impl Fn(&P) -> Result<C::Header, OutOfRange> + Copy,
    rows: impl Fn(&P) -> Result<Vec<C::Row>, OutOfRange> + Copy,
    fill: impl Fn(u32) -> C::Row,
) where P: prost::Message + Default {
    let frame = Frame::<C> { header: Default::default(), rows: (0..1000).map(fill).collect() };
    let mut best = [u128::MAX; 4];
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for _ in 0..300 {
        a.clear(); b.clear();
        let t = Instant::now();
        to(&frame.header, &frame.rows).encode(&mut a).unwrap();
        best[0] = best[0].min(t.elapsed().as_nanos());
        let t = Instant::now();
        frame.encode(&mut b);
        best[1] = best[1].min(t.elapsed().as_nanos());
        let t = Instant::now();
        let found = super::wire_fields::inner(&a, 0);
        let old = old_decode::<C, P, C::Row>(&a, rows, header).unwrap();
        best[2] = best[2].min(t.elapsed().as_nanos());
        let t = Instant::now();
        let found2 = super::wire_fields::inner(&a, 0);
        let new = Frame::<C>::decode(&a, found2).unwrap();
        best[3] = best[3].min(t.elapsed().as_nanos());
        assert!(old.rows.len() == new.rows.len() && found == found2);
    }
    assert_eq!(a, b);
    eprintln!("{:12} {:7} bytes, encode {:7} -> {:7} ns ({:.2}), decode {:7} -> {:7} ns ({:.2})", C::MESSAGE, a.len(), best[0], best[1], best[1] as f64 / best[0] as f64, best[2], best[3], best[3] as f64 / best[2] as f64);
}

#[test]
fn speed() {
    let ns = |i: u32| 86_000_000_000_000 + u64::from(i) * 1000;
    let f = |i: u32| i as f32 * 0.37;
    time::<Samples, proto::Samples>(|h, r| proto::Samples { samples: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.samples),
        |i| Sample::new(i, 12_345, ns(i)).command(f(i), 0.1).reading(f(i), ns(i)));
    time::<Forecasts, proto::Forecasts>(|h, r| proto::Forecasts { forecasts: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.forecasts),
        |i| Forecast { robot: i, flags: 15, quality: 1, power_w: f(i), lo_w: f(i), sample_seq: 12_345, stamp_ns: ns(i), target_ns: ns(i), reading_age_ns: 3_000_000, source_epoch: ns(i), ..Default::default() });
    time::<Diagnostics, proto::Diagnostics>(|h, r| proto::Diagnostics { diagnostics: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.diagnostics),
        |i| Diagnostic { robot: i, flags: 7, level: 1, alarm: 3, alarms: 4, residual_w: f(i), scored: 12_345, mae_w: 0.3, sample_seq: 12_345, stamp_ns: ns(i), source_epoch: ns(i), ..Default::default() });
    time::<Budgets, proto::Budgets>(|h, r| proto::Budgets { budgets: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.budgets),
        |i| Budget { robot: i, flags: 7, charge_state: 1, drawn_uj: i64::from(i) * 1_000_000, forecast_uj: i64::from(i) * 1_000_000, metered_ns: ns(i), stamp_ns: ns(i), valid_until_ns: ns(i), left_j: f(i), ..Default::default() });
    time::<PlanStates, proto::PlanStates>(|h, r| proto::PlanStates { plan_states: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.plan_states),
        |i| PlanState { robot: i, flags: 7, quality: 1, stamp_ns: ns(i), lag1_w: f(i), energy_j: [f(i); 4], ..Default::default() });
    time::<Ticks, proto::Ticks>(|h, r| proto::Ticks { frames: to_proto(r), ..h.into() }, |p| p.try_into(), |p| from_proto(&p.frames),
        |i| TakenFrame { source_id: ns(i), source_epoch: ns(i), frame_seq: 12_345, taken_ns: ns(i), samples: 1, truncated: 0 });
}
