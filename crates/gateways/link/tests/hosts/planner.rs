//! A planner in a process of its own, as on a separate host. It reports to the test what it reads.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use joulebus_bus::clock;
use joulebus_consumer::{Event, Subscriber};
use joulebus_testkit::{Member, send_to_test};
use joulebus_wire::Forecast;
use serde::{Deserialize, Serialize};

const CONFIG: &str = "JOULEBUS_LINK_PLANNER";

/// Maximum number of rows of a frame that are reported.
const ROWS: usize = 10;

/// A forecast: its times, and the other fields as they lie in memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    pub(crate) robot: u32,
    pub(crate) stamp_ns: u64,
    pub(crate) target_ns: u64,
    pub(crate) has_power: bool,
    pub(crate) bits: Vec<u8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Frame {
    pub(crate) epoch: u64,
    pub(crate) tick: u64,
    pub(crate) sent_ns: u64,
    pub(crate) period_ns: u64,
    /// When it was read.
    pub(crate) read_ns: u64,
    pub(crate) runs: u64,
    /// Samples that the worker has dropped or never received.
    pub(crate) dropped: u64,
    pub(crate) rows: Vec<Row>,
}

/// Output of a planner.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Seen {
    Frame(Frame),
    Gone(String),
}

/// The planner's process, which runs until it is killed.
pub(crate) fn run() {
    let Some(config) = std::env::var_os(CONFIG) else {
        return;
    };
    let mut planner = Subscriber::connect(PathBuf::from(config)).unwrap();
    send_to_test("joined");
    loop {
        let runs = planner.counts().workers;
        let seen = match planner.wait_next(Duration::from_secs(1)).unwrap() {
            Event::Frame(frame) => Seen::Frame(Frame {
                epoch: frame.header().worker_epoch,
                tick: frame.header().tick,
                sent_ns: frame.header().sent_ns,
                period_ns: frame.header().period_ns,
                read_ns: clock::monotonic_ns(),
                runs,
                dropped: frame.header().samples_dropped.total(),
                rows: frame.robots().iter().take(ROWS).map(row).collect(),
            }),
            Event::Gone(end) => Seen::Gone(format!("{end:?}")),
            _ => continue,
        };
        send_to_test(serde_json::to_string(&seen).unwrap());
    }
}

fn row(row: &Forecast) -> Row {
    let mut rest = *row;
    (rest.stamp_ns, rest.target_ns) = (0, 0);
    Row {
        robot: row.robot,
        stamp_ns: row.stamp_ns,
        target_ns: row.target_ns,
        has_power: row.expected_w().is_some(),
        bits: bytemuck::bytes_of(&rest).to_vec(),
    }
}

/// A planner of the test.
pub(crate) struct Reader(Member);

impl Reader {
    pub(crate) fn join(config: &Path) -> Self {
        let mut command = Member::command();
        command.env(CONFIG, config);
        let mut member = Member::spawn("planner", command);
        assert_eq!(member.next_line(), "joined");
        Self(member)
    }

    pub(crate) fn pid(&self) -> u32 {
        self.0.pid()
    }

    pub(crate) fn next(&mut self) -> Seen {
        serde_json::from_str(&self.0.next_line()).unwrap()
    }

    pub(crate) fn frame(&mut self) -> Frame {
        loop {
            if let Seen::Frame(frame) = self.next() {
                return frame;
            }
        }
    }

    /// The next frame, or `None` after that time.
    pub(crate) fn frame_within(&mut self, time: Duration) -> Option<Frame> {
        let line = self.0.try_next_line(time)?;
        match serde_json::from_str(&line).unwrap() {
            Seen::Frame(frame) => Some(frame),
            Seen::Gone(_) => None,
        }
    }

    /// The next frame that was sent after this call.
    pub(crate) fn fresh(&mut self) -> Frame {
        let now_ns = clock::monotonic_ns();
        loop {
            let frame = self.frame();
            if frame.sent_ns > now_ns {
                return frame;
            }
        }
    }

    /// The next frame with a sample that was taken after this call.
    pub(crate) fn fresh_sample(&mut self) -> Frame {
        let now_ns = clock::monotonic_ns();
        loop {
            let frame = self.frame();
            if frame.rows.iter().any(|row| row.stamp_ns > now_ns) {
                return frame;
            }
        }
    }

    /// Whether a frame with a sample that was taken after this call comes within that time.
    pub(crate) fn has_sample_within(&mut self, time: Duration) -> bool {
        let (now_ns, until) = (clock::monotonic_ns(), Instant::now() + time);
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let frame = self.frame_within(left);
            if frame.is_some_and(|frame| frame.rows.iter().any(|row| row.stamp_ns > now_ns)) {
                return true;
            }
            if left.is_zero() {
                return false;
            }
        }
    }

    /// Waits for the end of the worker, and returns which kind of end was reported.
    pub(crate) fn gone(&mut self) -> String {
        loop {
            if let Seen::Gone(how) = self.next() {
                return how;
            }
        }
    }

    /// All frames that it has read.
    pub(crate) fn all_frames(self) -> Vec<Frame> {
        let lines = self.0.all_lines();
        // The planner was killed, perhaps while it wrote the last line.
        let seen = lines.iter().filter_map(|line| serde_json::from_str(line).ok());
        let frame = |seen| match seen {
            Seen::Frame(frame) => Some(frame),
            Seen::Gone(_) => None,
        };
        seen.filter_map(frame).collect()
    }

    pub(crate) fn leave(self) {
        self.0.kill();
    }
}
