//! Both sides of a stream over a simulated network that delays, loses, repeats, reorders and
//! partitions.

use std::collections::BTreeMap;

use joulebus_wire::{Forecast, ForecastHeader, SCHEMA_VERSION};
use proptest::prelude::*;

use crate::protocol::carried::Carried;
use crate::protocol::message::{Body, FleetId, Sender, Worker, read};
use crate::protocol::offset::shifted;
use crate::protocol::receiver::Receiver;
use crate::protocol::selection::Selection;
use crate::protocol::stream::{LocalFrame, SILENCE_TIMEOUT_NS, Stream};

const FLEET: FleetId = FleetId(3);
const STEP_NS: u64 = 1_000_000;
const TICK_NS: u64 = 33_000_000;
const ROWS: usize = 4;
/// The receiver's clock at the start, and how far the sender's is behind it.
const BEGIN_NS: u64 = 900_000_000_000;

/// Conditions of the network for a span of time.
#[derive(Debug, Clone, Copy)]
struct Weather {
    delay_ns: u64,
    jitter_ns: u64,
    loss_percent: u64,
    again_percent: u64,
    is_cut: bool,
}

const CALM: Weather =
    Weather { delay_ns: 500_000, jitter_ns: 0, loss_percent: 0, again_percent: 0, is_cut: false };

/// One direction of the network, with a bandwidth.
#[derive(Default)]
struct Way {
    /// Messages in flight by time of arrival and order of sending.
    under_way: BTreeMap<(u64, u64), Vec<u8>>,
    sent: u64,
    free_ns: u64,
    dice: u64,
}

impl Way {
    fn roll(&mut self) -> u64 {
        self.dice = self
            .dice
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        self.dice >> 33
    }

    fn send(&mut self, bytes: &[u8], now_ns: u64, weather: Weather, bytes_per_s: u64) {
        if weather.is_cut || self.roll() % 100 < weather.loss_percent {
            return;
        }
        self.free_ns = self.free_ns.max(now_ns) + bytes.len() as u64 * 1_000_000_000 / bytes_per_s;
        let times = 1 + u64::from(self.roll() % 100 < weather.again_percent);
        for _ in 0..times {
            let jitter_ns = self.roll() % (weather.jitter_ns + 1);
            let at_ns = self.free_ns + weather.delay_ns + jitter_ns;
            self.sent += 1;
            self.under_way.insert((at_ns, self.sent), bytes.to_vec());
        }
    }

    fn arrive(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        let (at, _) = self.under_way.first_key_value()?;
        (at.0 <= now_ns).then(|| self.under_way.pop_first().map(|(_, bytes)| bytes))?
    }
}

/// Two hosts, and one fleet whose ticks start with the simulation.
struct Hosts {
    now_ns: u64,
    offset_ns: i128,
    bytes_per_s: u64,
    there: Way,
    back: Way,
    stream: Option<Stream>,
    streams: u64,
    receiver: Receiver,
    tick: u64,
    sent: u64,
    dropped: u64,
    /// Ticks that arrived, with their times of arrival.
    arrived: Vec<(u64, u64)>,
    /// Number of the receiver's requests.
    asked: u64,
    out: Vec<u8>,
}

impl Hosts {
    fn new(offset_ns: i128, bytes_per_s: u64, dice: u64) -> Self {
        let own = Sender { fleet: FLEET, run: BEGIN_NS };
        let way = || Way { dice, ..Way::default() };
        Self {
            now_ns: BEGIN_NS,
            offset_ns,
            bytes_per_s,
            there: way(),
            back: way(),
            stream: None,
            streams: 0,
            receiver: Receiver::new(own, Selection::new(Carried::FORECASTS.bit(), 1, vec![])),
            tick: 0,
            sent: 0,
            dropped: 0,
            arrived: Vec::new(),
            asked: 0,
            out: Vec::new(),
        }
    }

    fn there_ns(&self) -> u64 {
        u64::try_from(i128::from(self.now_ns) - self.offset_ns).unwrap()
    }

    fn run(&mut self, span_ns: u64, weather: Weather) {
        let until_ns = self.now_ns + span_ns;
        while self.now_ns < until_ns {
            self.now_ns += STEP_NS;
            self.sender(weather);
            self.receive(weather);
        }
    }

    fn sender(&mut self, weather: Weather) {
        let there_ns = self.there_ns();
        while let Some(bytes) = self.back.arrive(self.now_ns) {
            let message = read(&bytes, FLEET, ROWS).unwrap();
            let Body::Request(request) = message.body else {
                panic!("not a request");
            };
            match &mut self.stream {
                Some(stream) => {
                    stream.request(request, there_ns);
                }
                None => {
                    self.streams += 1;
                    self.stream = Some(Stream::new(FLEET, request, there_ns));
                }
            }
        }
        if let Some(over) = self.stream.take_if(|stream| stream.is_over(there_ns)) {
            self.dropped += over.sent().dropped;
        }
        let ticks = (self.now_ns - BEGIN_NS) / TICK_NS;
        while self.tick < ticks {
            self.tick += 1;
            let header = ForecastHeader {
                schema: SCHEMA_VERSION,
                tick: self.tick,
                sent_ns: there_ns,
                ..ForecastHeader::default()
            };
            let rows = [Forecast::default(); ROWS];
            let frame = LocalFrame {
                service: Carried::FORECASTS,
                source: 0,
                tick: self.tick,
                header: bytemuck::bytes_of(&header),
                elements: bytemuck::cast_slice(&rows),
            };
            let Some(stream) = &mut self.stream else {
                continue;
            };
            if stream.offer(frame, Worker::Alive.into(), there_ns, &mut self.out) {
                self.sent += 1;
                self.there.send(&self.out, self.now_ns, weather, self.bytes_per_s);
            }
        }
        let Some(stream) = &mut self.stream else {
            return;
        };
        while stream.due(Worker::Alive.into(), there_ns, &mut self.out) {
            self.there.send(&self.out, self.now_ns, weather, self.bytes_per_s);
        }
    }

    fn receive(&mut self, weather: Weather) {
        while let Some(bytes) = self.there.arrive(self.now_ns) {
            let message = read(&bytes, FLEET, ROWS).unwrap();
            if let Ok(accepted) = self.receiver.take(&message, bytes.len(), self.now_ns) {
                let header: ForecastHeader = accepted.frame.header();
                let sent_ns = shifted(header.sent_ns, accepted.offset_ns);
                let true_ns = i128::from(header.sent_ns) + self.offset_ns;
                assert!(i128::from(sent_ns) <= true_ns, "made to look fresher");
                assert!(sent_ns <= self.now_ns, "from the future");
                self.arrived.push((header.tick, self.now_ns));
            }
        }
        self.receiver.becomes_silent(self.now_ns);
        if let Some(request) = self.receiver.request_if_due(self.now_ns) {
            self.asked += 1;
            self.back.send(&request, self.now_ns, weather, u64::MAX / 2_000_000_000);
        }
    }

    fn age_ns(&self, tick: u64, at_ns: u64) -> u64 {
        at_ns - (BEGIN_NS + tick * TICK_NS)
    }
}

const SECOND: u64 = 1_000_000_000;
const FAST: u64 = 100_000_000;

#[test]
fn on_a_calm_network_every_frame_arrives_once_and_nothing_is_counted() {
    for offset_ns in [-70 * i128::from(SECOND), 0, 800 * i128::from(SECOND)] {
        let mut hosts = Hosts::new(offset_ns, FAST, 1);
        hosts.run(10 * SECOND, CALM);
        let ticks: Vec<u64> = hosts.arrived.iter().map(|(tick, _)| *tick).collect();
        let first = ticks[0];
        assert!(first < 10, "{first}");
        assert!(ticks.iter().copied().eq(first..=first + ticks.len() as u64 - 1));
        assert!(hosts.tick - ticks.last().unwrap() <= 1);
        let received = hosts.receiver.received();
        assert_eq!((received.lost, received.repeated, received.dropped), (0, 0, 0));
        assert_eq!((received.runs, received.silences), (1, 0));
        assert_eq!(hosts.receiver.offset().steps, 0);
    }
}

#[test]
fn one_request_acknowledges_two_frames_where_the_way_is_free() {
    let mut hosts = Hosts::new(0, FAST, 1);
    hosts.run(10 * SECOND, CALM);
    let frames = hosts.arrived.len() as u64;
    assert!(hosts.asked < frames / 2 + 20, "{} for {frames}", hosts.asked);
    assert_eq!(hosts.receiver.received().dropped, 0);
}

#[test]
fn a_link_hardly_slower_than_the_fleet_carries_what_it_can() {
    // A frame has 720 bytes and takes 36 to 80 ms.
    for bytes_per_s in [9_000, 12_000, 15_000, 18_000, 20_000] {
        let mut hosts = Hosts::new(0, bytes_per_s, 1);
        hosts.run(60 * SECOND, CALM);
        let can = 60 * bytes_per_s / 720;
        let carried = hosts.arrived.len() as u64;
        assert!(carried * 10 > can * 9, "{carried} of {can}");
    }
}

#[test]
fn a_link_slower_than_the_fleet_brings_the_newest_frames_and_counts_those_that_it_leaves_out() {
    // A frame has about 700 bytes, so 30 a second are 21 kB/s.
    let mut hosts = Hosts::new(0, 7_000, 1);
    hosts.run(60 * SECOND, CALM);
    let late: Vec<u64> =
        hosts.arrived.iter().map(|(tick, at_ns)| hosts.age_ns(*tick, *at_ns)).collect();
    let worst_ns = late[20..].iter().max().unwrap();
    assert!(
        *worst_ns < 400_000_000,
        "{worst_ns}: two frames of .1 s each, and the wait for a place"
    );
    let received = hosts.receiver.received();
    assert!(hosts.arrived.len() > 300, "{}", hosts.arrived.len());
    assert_eq!(received.lost, 0);
    let waiting = hosts.tick - hosts.sent - received.dropped;
    let left_out = hosts.tick - hosts.arrived[0].0 - hosts.arrived.len() as u64;
    assert!(received.dropped.abs_diff(left_out) <= 5 + waiting.min(3), "{received:?} {left_out}");
}

#[test]
fn after_a_partition_everything_goes_on_by_itself_and_silence_is_reported_within_its_bound() {
    for cut_ns in [SECOND / 2, 2 * SECOND, 60 * SECOND] {
        let mut hosts = Hosts::new(5_000, FAST, 1);
        hosts.run(5 * SECOND, CALM);
        assert!(hosts.receiver.is_sending());
        let cut = Weather { is_cut: true, ..CALM };
        let from_ns = hosts.now_ns;
        hosts.run(cut_ns.min(1_400_000_000), cut);
        assert!(hosts.receiver.is_sending());
        hosts.run(cut_ns.saturating_sub(1_400_000_000), cut);
        assert_eq!(
            hosts.receiver.is_sending(),
            cut_ns < SECOND,
            "reported within 1.6 s of {from_ns}"
        );
        let healed_ns = hosts.now_ns;
        hosts.run(5 * SECOND, CALM);
        assert!(hosts.receiver.is_sending());
        let back = hosts.arrived.iter().find(|(_, at_ns)| *at_ns > healed_ns);
        let (_, back_ns) = back.expect("frames come again");
        assert!(back_ns - healed_ns < SECOND, "{}", back_ns - healed_ns);
        assert_eq!(hosts.receiver.received().silences, u64::from(cut_ns > SECOND));
        assert_eq!(hosts.streams, 1 + u64::from(cut_ns > SECOND));
    }
}

/// As of a virtual machine: its time stands still, and the sender's goes on.
#[test]
fn after_a_pause_of_the_receivers_clock_frames_come_again_within_half_a_second_as_a_counted_step() {
    for pause_ns in [20_000_000, SECOND / 2, 1_400_000_000, 2 * SECOND, 60 * SECOND] {
        let mut hosts = Hosts::new(5_000, FAST, 1);
        hosts.run(5 * SECOND, CALM);
        while !hosts.there.under_way.is_empty() || !hosts.back.under_way.is_empty() {
            hosts.run(STEP_NS, CALM);
        }
        let before = hosts.receiver.received();
        let paused_ns = hosts.now_ns;
        hosts.offset_ns -= i128::from(pause_ns);
        hosts.run(5 * SECOND, CALM);
        let back = hosts.arrived.iter().find(|(_, at_ns)| *at_ns > paused_ns);
        let (_, back_ns) = back.expect("frames come again");
        assert!(back_ns - paused_ns < SECOND / 2, "{pause_ns}: {}", back_ns - paused_ns);
        // After a longer pause the sender has begun another stream.
        let is_same_run = pause_ns < SILENCE_TIMEOUT_NS;
        let received = hosts.receiver.received();
        assert_eq!(received.runs, before.runs + u64::from(!is_same_run), "{pause_ns}");
        assert_eq!(hosts.receiver.offset().steps, u64::from(is_same_run), "{pause_ns}");
        assert_eq!(received.silences, 0, "{pause_ns}");
    }
}

#[test]
fn a_long_way_holds_as_many_frames_as_it_takes() {
    let mut hosts = Hosts::new(0, FAST, 1);
    let far = Weather { delay_ns: 150_000_000, ..CALM };
    hosts.run(20 * SECOND, far);
    let share = hosts.arrived.len() as f64 / hosts.tick as f64;
    assert!(share > 0.95, "{share}");
}

#[test]
fn a_false_number_or_run_hides_nothing_and_a_time_that_lies_ahead_is_refused() {
    let mut hosts = Hosts::new(7_000, FAST, 1);
    hosts.run(2 * SECOND, CALM);
    for at in 0..50 {
        // The newest real frame again, with one change.
        let before = hosts.arrived.len();
        let stream = hosts.stream.as_mut().unwrap();
        let mut forged = Vec::new();
        let there_ns = u64::try_from(i128::from(hosts.now_ns) - hosts.offset_ns).unwrap();
        stream.write_status(Worker::Alive.into(), there_ns, &mut forged);
        let field = match at % 3 {
            0 => RUN,
            1 => NUMBER,
            _ => SENT,
        };
        forged[field + at / 8] ^= 0x80;
        hosts.there.send(&forged, hosts.now_ns, CALM, FAST);
        hosts.run(SECOND, CALM);
        let came = hosts.arrived.len() - before;
        assert!((29..=32).contains(&came), "{came} after {at}");
    }
    let received = hosts.receiver.received();
    assert_eq!((received.runs, received.silences), (1, 0), "{received:?}");
    assert!(received.other_runs > 10 && received.future > 5, "{received:?}");
    // Each of the other runs sent once, and the accepted one continued.
    assert_eq!(received.contested, received.other_runs, "{received:?}");
    assert_eq!(hosts.receiver.offset().steps, 0);
}

#[test]
fn a_frame_that_claims_it_was_sent_after_its_message_is_refused() {
    let mut hosts = Hosts::new(7_000, FAST, 1);
    hosts.run(2 * SECOND, CALM);
    let at = SENT + 32 + std::mem::offset_of!(ForecastHeader, sent_ns);
    for ahead_ns in [1, SECOND, u64::MAX / 2] {
        // The newest real frame in flight.
        while hosts.there.under_way.values().all(|bytes| bytes.len() <= at) {
            hosts.run(STEP_NS, Weather { delay_ns: 5_000_000, ..CALM });
        }
        let frame = hosts.there.under_way.values_mut().find(|bytes| bytes.len() > at).unwrap();
        let sent_ns = u64::from_le_bytes(*frame[SENT..].first_chunk().unwrap());
        frame[at..at + 8].copy_from_slice(&(sent_ns + ahead_ns).to_le_bytes());
        let future = hosts.receiver.received().future;
        hosts.run(20_000_000, CALM);
        assert_eq!(hosts.receiver.received().future, future + 1, "{ahead_ns}");
    }
    let before = hosts.arrived.len();
    hosts.run(SECOND, CALM);
    assert!((29..=32).contains(&(hosts.arrived.len() - before)));
}

/// Offsets of these fields in a message.
const RUN: usize = 48;
const NUMBER: usize = 56;
const SENT: usize = 96;

fn weather() -> impl Strategy<Value = (u64, Weather)> {
    let spans = (50_u64..4_000, 0_u64..200, 0_u64..300, 0_u64..60, 0_u64..60, 0_u32..4);
    spans.prop_map(|(span_ms, delay_ms, jitter_ms, loss_percent, again_percent, cut)| {
        let weather = Weather {
            delay_ns: delay_ms * 1_000_000,
            jitter_ns: jitter_ms * 1_000_000,
            loss_percent,
            again_percent,
            is_cut: cut == 0,
        };
        (span_ms * 1_000_000, weather)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// 200 histories of delay, loss, repetition, reordering and partitions.
    #[test]
    fn in_any_weather_no_frame_comes_twice_or_backwards_and_calm_brings_all_back(
        spans in prop::collection::vec(weather(), 1..12),
        offset_ns in -800_000_000_000_i64..800_000_000_000,
        dice: u64,
    ) {
        let mut hosts = Hosts::new(i128::from(offset_ns), FAST, dice);
        for (span_ns, weather) in spans {
            hosts.run(span_ns, weather);
        }
        hosts.run(3 * SECOND, CALM);
        let before = hosts.arrived.len();
        let tick = hosts.tick;
        hosts.run(2 * SECOND, CALM);
        let ticks: Vec<u64> = hosts.arrived.iter().map(|(tick, _)| *tick).collect();
        prop_assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]), "{ticks:?}");
        let came = (hosts.arrived.len() - before) as u64;
        prop_assert!(came.abs_diff(hosts.tick - tick) <= 1, "{came} of {}", hosts.tick - tick);
        let received = hosts.receiver.received();
        prop_assert_eq!(received.frames, hosts.arrived.len() as u64);
        // Messages of a run may arrive after the first one of the next run, which the sender starts
        // after a silence.
        prop_assert!(received.contested == 0 || hosts.streams > 1);
        prop_assert!(hosts.arrived.len() as u64 <= hosts.tick);
        let late_ns = hosts.age_ns(*ticks.last().unwrap(), hosts.arrived.last().unwrap().1);
        prop_assert!(late_ns < 20_000_000, "{late_ns}");
    }
}
