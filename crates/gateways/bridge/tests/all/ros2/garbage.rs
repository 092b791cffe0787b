//! A stranger that sends damaged RTPS: real datagrams with changed bytes, and random ones.

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use joulebus_testkit::eventually;

use super::peer::{Peer, RosDomain, cyclonedds};
use super::{discharging, file, is_near};
use crate::fleet::Fleet;

const PREFIX: std::ops::Range<usize> = 8..20;
const ACKNACK: u8 = 6;
const HEARTBEAT: u8 = 7;
const GAP: u8 = 8;
const INFO_DST: u8 = 14;
const DATA: u8 = 21;
/// Parameters of a participant: where it is reached with discovery's messages, and with others.
const LOCATORS: [[u8; 2]; 2] = [[0x32, 0], [0x31, 0]];

fn variable(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Numbers that a seed determines (SplitMix64).
struct Dice(u64);

impl Dice {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound.max(1) as u64) as usize
    }
}

/// A participant that exists in its announcement alone: the others answer its socket.
struct Stranger {
    socket: UdpSocket,
    seeds: Vec<Vec<u8>>,
    announced: Vec<Vec<u8>>,
    /// The bridge's port for discovery.
    to: u16,
}

impl Stranger {
    /// Waits for the announcement of a participant, at a port where discovery looks for one.
    fn listen(domain: &RosDomain) -> Self {
        let port = domain.first_port() + 2 * 7;
        let socket = UdpSocket::bind(("127.0.0.1", port)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let (seeds, announced) = (Vec::new(), Vec::new());
        let mut stranger = Self { socket, seeds, announced, to: domain.first_port() };
        eventually("an announcement", || {
            stranger.receive();
            let all = stranger.seeds.iter();
            stranger.announced = all.filter_map(|seed| announcement(seed, port)).collect();
            !stranger.announced.is_empty()
        });
        stranger
    }

    /// Keeps what has come, and asks for what the writers have.
    fn receive(&mut self) {
        let mut bytes = vec![0; 65_536];
        while let Ok(length) = self.socket.recv(&mut bytes) {
            let seed = bytes[..length].to_vec();
            if let Some(request) = self.announced.first().and_then(|own| request(&seed, own)) {
                self.send(self.to, &request);
                self.seeds.push(request);
            }
            self.seeds.push(seed);
            // The newest are the most varied.
            if self.seeds.len() > 400 {
                self.seeds.drain(10..50);
            }
        }
    }

    /// Number of its seeds with a submessage.
    fn count(&self, of: u8) -> usize {
        self.seeds.iter().filter(|seed| submessages(seed).any(|(id, _)| id == of)).count()
    }

    fn send(&self, port: u16, bytes: &[u8]) {
        let _ = self.socket.send_to(bytes, ("127.0.0.1", port));
    }
}

/// The submessages of a message: what each is, and its content.
fn submessages(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = bytes.get(20..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (&[id, flags, low, high], content) = rest.split_first_chunk()?;
        let length = if flags & 1 == 1 { [low, high] } else { [high, low] };
        let length = usize::from(u16::from_le_bytes(length)).min(content.len());
        let (content, next) = content.split_at(length);
        rest = next;
        Some((id, content))
    })
}

/// Asks for all that the writer of a heartbeat has, as the participant of `own`.
fn request(seed: &[u8], own: &[u8]) -> Option<Vec<u8>> {
    let (_, heartbeat) = submessages(seed).find(|(id, _)| *id == HEARTBEAT)?;
    let (writer, first) = (heartbeat.get(4..8)?, heartbeat.get(8..16)?);
    let reader = [&writer[..3], &[0xc7]].concat();
    let count = (heartbeat.get(24..28)?, 32_u32.to_le_bytes());
    Some(
        [
            own.get(..20)?,
            &[INFO_DST, 1, 12, 0],
            seed.get(PREFIX)?,
            &[ACKNACK, 1, 28, 0],
            &reader,
            writer,
            first,
            &count.1,
            &[0xff; 4],
            count.0,
        ]
        .concat(),
    )
}

/// The announcement of a participant, as that of another one that is reached at `port`.
fn announcement(seed: &[u8], port: u16) -> Option<Vec<u8>> {
    let prefix = seed.get(PREFIX)?.to_vec();
    let mut bytes = seed.to_vec();
    let mut found = 0;
    for at in 0..bytes.len() {
        if LOCATORS.iter().any(|id| bytes[at..].starts_with(&[id[0], id[1], 24, 0, 1, 0, 0, 0])) {
            bytes.get_mut(at + 8..at + 12)?.copy_from_slice(&u32::from(port).to_le_bytes());
            found += 1;
        }
        if bytes[at..].starts_with(&prefix) {
            bytes[at..at + prefix.len()].iter_mut().for_each(|byte| *byte ^= 0x5a);
        }
    }
    (found >= LOCATORS.len()).then_some(bytes)
}

/// A seed with up to eight changes, or random bytes behind the header of RTPS.
fn damaged(dice: &mut Dice, seeds: &[Vec<u8>]) -> Vec<u8> {
    if dice.below(10) == 0 {
        let length = dice.below(1_400);
        let random = (0..length).map(|_| dice.bits() as u8);
        return b"RTPS\x02\x04\x01\x10".iter().copied().chain(random).collect();
    }
    let mut bytes = seeds[dice.below(seeds.len())].clone();
    for _ in 0..=dice.below(8) {
        let at = dice.below(bytes.len());
        let Some(byte) = bytes.get_mut(at) else { break };
        match dice.below(7) {
            0 => *byte ^= 1 << dice.below(8),
            1 => *byte = dice.bits() as u8,
            2 => *byte = [0, 1, 0x7f, 0x80, 0xff][dice.below(5)],
            // A length, a count or a number at its limit.
            3 => bytes[at..].iter_mut().take(4).for_each(|byte| *byte = 0xff),
            4 => bytes[at..].iter_mut().take(8).for_each(|byte| *byte = 0),
            5 => bytes.truncate(at),
            _ => {
                let other = &seeds[dice.below(seeds.len())];
                let from = dice.below(other.len());
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
        }
    }
    bytes
}

/// True if it announces numbers of messages. rustdds 0.15 makes a list of all that are announced
/// and missing (`missing_seqnums`), whatever their number: one false heartbeat of a writer that it
/// knows takes gigabytes. RELIABILITY.md states it.
fn announces_numbers(bytes: &[u8]) -> bool {
    submessages(bytes).any(|(id, _)| matches!(id, HEARTBEAT | GAP))
}

#[test]
fn damaged_rtps_stops_neither_the_bridge_nor_the_robots_that_it_reads() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let seed = variable("JOULEBUS_SEED").unwrap_or(1);
    let seconds = variable("JOULEBUS_DDS_S").unwrap_or(5);
    println!("seed {seed}");
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut peer = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/reading_w", "Float64");
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    let is_read = |document: &serde_json::Value| is_near(&document["data"], 4.4);
    peer.wait_for("/r1/joulebus/reading_w", 0, is_read);

    let mut stranger = Stranger::listen(&domain);
    let ports = [domain.first_port(), domain.first_port() + 1];
    // The bridge answers it with the announcements of its readers and writers.
    eventually("the bridge takes the stranger for a participant", || {
        stranger.announced.iter().for_each(|packet| stranger.send(ports[0], packet));
        std::thread::sleep(Duration::from_millis(50));
        stranger.receive();
        // The peer announces itself.
        stranger.count(ACKNACK) > 0 && stranger.count(DATA) > 2 * stranger.announced.len() + 4
    });
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", bridge.pid())).unwrap();
    let memory = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
    assert!(memory.contains("1073741824"), "{memory}");
    let (mut dice, mut sent) = (Dice(seed), 0_u64);
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(seconds) {
        for _ in 0..20 {
            let bytes = damaged(&mut dice, &stranger.seeds);
            if !announces_numbers(&bytes) {
                stranger.send(ports[dice.below(2)], &bytes);
                sent += 1;
            }
        }
        stranger.receive();
        // As fast as the bridge reads: what its socket drops tests nothing.
        std::thread::sleep(Duration::from_millis(2));
    }
    let of = [HEARTBEAT, ACKNACK, DATA].map(|of| stranger.count(of));
    println!("figure: {sent} damaged datagrams of {of:?} real ones, seed {seed}");
    assert!(bridge.is_running(), "{}", bridge.errors());
    let from = peer.received();
    peer.wait_for("/r1/joulebus/reading_w", from + 30, is_read);
    let ended = bridge.end();
    assert!(matches!(ended.exit_code(), 0 | 3), "{ended:?}");
    assert!(!ended.errors().contains("panicked"), "{}", ended.errors());
    // A later participant may not be found until the bridge starts again.
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut late = Peer::start(&python, &domain);
    late.subscribe("/r2/joulebus/reading_w", "Float64");
    late.publish("/fleet/r2/battery_state", "BatteryState", &discharging());
    late.wait_for("/r2/joulebus/reading_w", 0, is_read);
    bridge.end();
    worker.stop();
}
