//! Messages of an untrusted peer in any order, for tests and for the fuzz target `link`.

use bytemuck::{bytes_of, cast_slice};
use joulebus_wire::{Forecast, ForecastHeader, SCHEMA_VERSION, Sample, SampleHeader};

use crate::protocol::carried::Carried;
use crate::protocol::message::{
    Body, FleetId, Message, Outgoing, Request, Sender, Status, Worker, read, write_frame,
    write_request,
};
use crate::protocol::receiver::Receiver;
use crate::protocol::selection::Selection;
use crate::protocol::shift::shift;
use crate::protocol::stream::{LocalFrame, Stream};

const FLEET: FleetId = FleetId(7);
/// Maximum number of elements of a frame.
const MAX_ELEMENTS: usize = 4;
const START_NS: u64 = 5_000_000_000;

/// One side of a link whose peer is hostile.
struct Victim {
    now_ns: u64,
    receiver: Receiver,
    stream: Option<Stream>,
    /// Run, time and number of the newest message from which a frame was taken.
    last: Option<(u64, u64, u64)>,
    messages: u64,
    frames: u64,
}

/// Takes the steps that the bytes encode, each as a code, a length and that many bytes. Returns
/// whether a frame was taken.
pub(crate) fn run(mut bytes: &[u8]) -> bool {
    let own = Sender { fleet: FLEET, run: START_NS };
    let mut victim = Victim {
        now_ns: START_NS,
        receiver: Receiver::new(own, Selection::new(u32::MAX, 1, Vec::new())),
        stream: None,
        last: None,
        messages: 0,
        frames: 0,
    };
    while let [code, length, rest @ ..] = bytes {
        let (given, rest) = rest.split_at(usize::from(*length).min(rest.len()));
        bytes = rest;
        match code % 5 {
            0 => victim.message(given),
            1 => victim.message(&patched(frame(victim.now_ns, victim.frames), given)),
            2 => victim.request(&patched(request(victim.now_ns), given)),
            3 => victim.passes(given),
            _ => victim.offers(given),
        }
        victim.asks();
    }
    victim.frames > 0
}

impl Victim {
    fn message(&mut self, bytes: &[u8]) {
        let Ok(message) = read(bytes, FLEET, MAX_ELEMENTS) else {
            return;
        };
        self.messages += 1;
        let Message { run, number, .. } = message;
        let sent_ns = match &message.body {
            Body::Frame(status, _) => status.sent_ns,
            Body::Request(_) => 0,
        };
        let taken = self.receiver.take(&message, bytes.len(), self.now_ns);
        let received = self.receiver.received();
        assert!(received.frames <= self.messages);
        let Ok(accepted) = taken else { return };
        self.frames += 1;
        // Within a run no frame comes twice or backwards, unless the run was silent in between.
        if let Some((last_run, last_ns, last)) = self.last
            && last_run == run
            && received.runs == 1
        {
            assert!((sent_ns, number) > (last_ns, last));
        }
        self.last = Some((run, sent_ns, number));
        let frame = accepted.frame;
        assert!(frame.len() <= MAX_ELEMENTS);
        if frame.service == Carried::FORECASTS {
            let mut header: ForecastHeader = frame.header();
            shift(&mut header, accepted.offset_ns);
            for mut row in frame.elements::<Forecast>() {
                shift(&mut row, accepted.offset_ns);
            }
        }
        if frame.service == Carried::SAMPLES {
            for at in 0..frame.len() {
                shift(&mut frame.element::<Sample>(at), accepted.offset_ns);
            }
        }
    }

    fn request(&mut self, bytes: &[u8]) {
        let Ok(message) = read(bytes, FLEET, 0) else {
            return;
        };
        let Body::Request(request) = message.body else {
            return;
        };
        match &mut self.stream {
            Some(stream) => stream.request(request, self.now_ns),
            None => self.stream = Some(Stream::new(FLEET, request, self.now_ns)),
        }
    }

    fn passes(&mut self, given: &[u8]) {
        for byte in given {
            self.now_ns = self.now_ns.saturating_add(u64::from(*byte) * 1_000_000);
        }
        self.receiver.becomes_silent(self.now_ns);
        let mut out = Vec::new();
        if let Some(stream) = &mut self.stream {
            let mut sent = 0;
            while stream.due(Worker::Alive.into(), self.now_ns, &mut out) {
                sent += 1;
                assert!(sent <= 1_000, "it does not end");
            }
        }
    }

    /// Offers frames of this host that the peer has requested.
    fn offers(&mut self, given: &[u8]) {
        let Some(stream) = &mut self.stream else {
            return;
        };
        let header = SampleHeader { schema: SCHEMA_VERSION, ..SampleHeader::default() };
        let rows = [Sample::new(1, 0, 0); 3];
        let mut out = Vec::new();
        for source in given {
            let frame = LocalFrame {
                service: Carried::SAMPLES,
                source: u64::from(*source),
                tick: 0,
                header: bytes_of(&header),
                elements: cast_slice(&rows),
            };
            if stream.offer(frame, Worker::Alive.into(), self.now_ns, &mut out) {
                assert!(read(&out, FLEET, rows.len()).is_ok());
            }
        }
    }

    fn asks(&mut self) {
        if let Some(request) = self.receiver.request_if_due(self.now_ns) {
            assert!(read(&request, FLEET, 0).is_ok());
        }
    }
}

/// A good message with changes, given as pairs of a position and a value.
fn patched(mut message: Vec<u8>, patches: &[u8]) -> Vec<u8> {
    for patch in patches.chunks_exact(3) {
        let at = usize::from(u16::from_le_bytes([patch[0], patch[1]]));
        if at < message.len() {
            message[at] = patch[2];
        } else {
            message.truncate(message.len().saturating_sub(usize::from(patch[2])));
        }
    }
    message
}

fn frame(now_ns: u64, number: u64) -> Vec<u8> {
    let header =
        ForecastHeader { schema: SCHEMA_VERSION, sent_ns: now_ns, ..ForecastHeader::default() };
    let rows = [Forecast::default(); 2];
    let rows: &[u8] = cast_slice(&rows);
    let status = Status {
        asked_ns: START_NS,
        received_ns: START_NS,
        sent_ns: now_ns,
        dropped: 0,
        leader: Worker::Alive.into(),
    };
    let sender = Sender { fleet: FLEET, run: 1 };
    let frame = Some(Outgoing {
        service: Carried::FORECASTS,
        header: bytes_of(&header),
        elements: &mut [rows].into_iter(),
    });
    let mut out = Vec::new();
    write_frame(&mut out, (sender, number + 1), status, frame);
    out
}

fn request(now_ns: u64) -> Vec<u8> {
    let sender = Sender { fleet: FLEET, run: 2 };
    let request = Request {
        acknowledged: (0, 0),
        asked_ns: now_ns,
        selection: Selection::new(u32::MAX, 1, vec![(0, 9)]),
    };
    write_request(sender, 1, &request)
}

/// Steps of a working link: a request, its answer, some time, and further frames.
#[cfg(test)]
pub(crate) fn seed() -> Vec<u8> {
    let mut steps = vec![2, 0, 4, 2, 1, 2];
    for _ in 0..4 {
        steps.extend([3, 1, 33, 1, 0]);
    }
    steps
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_seed_of_the_fuzz_target_is_taken() {
        assert!(run(&seed()));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        #[test]
        fn whatever_a_neighbour_sends_nothing_panics_comes_twice_or_grows_without_bound(
            steps in prop::collection::vec((0_u8..5, prop::collection::vec(any::<u8>(), 0..12)), 0..40),
            good in any::<bool>(),
        ) {
            let mut bytes = if good { seed() } else { Vec::new() };
            for (code, given) in steps {
                bytes.extend([code, given.len() as u8]);
                bytes.extend(given);
            }
            run(&bytes);
        }
    }
}
