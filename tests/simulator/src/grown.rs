//! Memory that processes allocate while they work, beyond that at their start.

use serde::Serialize;

use crate::process::Program;
use crate::scenario::Setup;

/// By how much a process of each kind has grown at most, bytes.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Grown {
    pub worker: i64,
    pub source: i64,
    pub planner: i64,
    /// Clients that ask about plans.
    pub client: i64,
    pub recorder: i64,
    pub display: i64,
    pub bridge: i64,
}

impl Grown {
    fn place(&mut self, program: &Program) -> &mut i64 {
        match program {
            Program::Worker(..) => &mut self.worker,
            Program::Source(_) => &mut self.source,
            Program::Planner(_) => &mut self.planner,
            Program::Client(_) => &mut self.client,
            Program::Recorder(..) => &mut self.recorder,
            Program::Display(_) => &mut self.display,
            Program::Bridge(_) => &mut self.bridge,
        }
    }

    pub(crate) fn note(&mut self, program: &Program, bytes: i64) {
        let most = self.place(program);
        *most = bytes.max(*most);
    }

    /// Takes the greater ones of `other`.
    pub(crate) fn take(&mut self, other: &Self) {
        self.worker = self.worker.max(other.worker);
        self.source = self.source.max(other.source);
        self.planner = self.planner.max(other.planner);
        self.client = self.client.max(other.client);
        self.recorder = self.recorder.max(other.recorder);
        self.display = self.display.max(other.display);
        self.bridge = self.bridge.max(other.bridge);
    }
}

/// Maximum growth of a process, however long it works and whatever it is sent, bytes: somewhat more
/// than 300 seeds needed. A worker that is asked about plans opens plan states, and one whose
/// outlooks are read computes them. The recorder has a chunk, and the index of its file.
pub(crate) const fn max_bytes(program: &Program, setup: &Setup) -> i64 {
    const KIB: i64 = 1_024;
    match program {
        Program::Worker(..) if setup.clients + setup.displays + setup.bridges > 0 => 256 * KIB,
        Program::Worker(..) => 96 * KIB,
        Program::Recorder(..) => 16 * KIB * KIB,
        // A board has tracks and runs of workers. With a tap it has steps of a source too.
        Program::Display(_) => 2 * KIB * KIB,
        Program::Bridge(_) => 512 * KIB,
        Program::Source(_) | Program::Planner(_) | Program::Client(_) => 4 * KIB,
    }
}
