//! Judges what a publisher publishes, and learns what the worker refuses, on a thread of its own.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use std::{io, mem, process, thread};

use joulebus_config::Config;
use joulebus_connect::findings::FindingsFile;
use joulebus_connect::refusals::Refusals;
use joulebus_plausibility::{Kind, Origin};

use crate::not_taken::NotTaken;
use crate::{Charger, Judgement, RobotState};

/// Interval of judging the states that were published meanwhile.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Interval of writing what is implausible, and of reading what is refused.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);
/// Robots that are judged at the same time: 22 MB. Others follow when these are found plausible.
const MAX_JUDGED: usize = 1024;
/// States that wait for the thread, at least. Further ones are not judged.
const MIN_WAITING: usize = 1024;

/// A state, and when it was published (monotonic, ns).
type Published = (RobotState, u64);

/// The publisher's end: it never waits, and allocates nothing after its start.
#[derive(Debug)]
pub(crate) struct Watch {
    waiting: Vec<Published>,
    /// The robots that are implausible, as far as the thread has told. Rising.
    doubted: Vec<u32>,
    not_taken: Option<NotTaken>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// The process that has the thread.
    pid: u32,
}

#[derive(Debug)]
struct Shared {
    handed_over: Mutex<Vec<Published>>,
    /// Robots that are implausible, if that is news.
    doubted: Mutex<Option<Vec<u32>>>,
    not_taken: Mutex<Option<NotTaken>>,
    is_stopped: AtomicBool,
}

impl Watch {
    /// Starts to judge a source of the fleet of `config`. `run`: its id and its run.
    pub(crate) fn start(config: &Config, source: &str, run: (u64, u64)) -> io::Result<Self> {
        let room = || Vec::with_capacity(config.limits().capacity.max(MIN_WAITING));
        let shared = Arc::new(Shared {
            handed_over: Mutex::new(room()),
            doubted: Mutex::new(None),
            not_taken: Mutex::new(None),
            is_stopped: AtomicBool::new(false),
        });
        let (own, taken) = (Arc::clone(&shared), room());
        let findings = FindingsFile::new(config, source);
        let config = config.clone();
        let refused = move || NotTaken::of(&Refusals::of_source(&config, run));
        let thread = thread::Builder::new()
            .name("joulebus-judge".to_owned())
            .spawn(move || judge(&own, taken, findings, refused))?;
        let (waiting, doubted) = (room(), Vec::new());
        let (thread, pid) = (Some(thread), process::id());
        Ok(Self { waiting, doubted, not_taken: None, shared, thread, pid })
    }

    /// Adds a state that is published at `now_ns`, if it has a new reading and there is room.
    pub(crate) fn add(&mut self, state: &RobotState, now_ns: u64) {
        let is_new = state.power_w.is_some() && !state.held;
        if is_new && self.waiting.len() < self.waiting.capacity() {
            self.waiting.push((*state, now_ns));
        }
    }

    /// True if the thread finds a robot implausible.
    pub(crate) fn doubts(&self, robot: u32) -> bool {
        self.doubted.binary_search(&robot).is_ok()
    }

    /// What the worker refuses, as far as the thread has told.
    pub(crate) const fn not_taken(&self) -> Option<NotTaken> {
        self.not_taken
    }

    /// Hands the states over, if the thread has judged those before, and takes its findings.
    pub(crate) fn hand_over(&mut self) {
        if let Ok(mut news) = self.shared.doubted.try_lock()
            && let Some(doubted) = news.take()
        {
            self.doubted = doubted;
        }
        if let Ok(not_taken) = self.shared.not_taken.try_lock() {
            self.not_taken = *not_taken;
        }
        // The thread has the lock for a moment: then the next frame does it.
        if let Ok(mut handed_over) = self.shared.handed_over.try_lock()
            && handed_over.is_empty()
        {
            mem::swap(&mut *handed_over, &mut self.waiting);
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.is_stopped.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else {
            return;
        };
        // A child made by fork has no such thread to wait for.
        if self.pid != process::id() {
            mem::forget(thread);
        } else {
            thread.thread().unpark();
            // A panic there is no reason for one here.
            let _ = thread.join();
        }
    }
}

/// Judges until the publisher ends, and removes the findings then.
fn judge(
    shared: &Shared,
    mut taken: Vec<Published>,
    mut findings: FindingsFile,
    refused: impl Fn() -> Option<NotTaken>,
) {
    // A simulated robot may never change its reading.
    let judgement = Judgement::new(Origin::Program, vec![Kind::Constant]);
    let mut judgement = judgement.of_at_most(MAX_JUDGED);
    let mut written = Instant::now();
    let mut told = Vec::new();
    while !shared.is_stopped.load(Ordering::Relaxed) {
        thread::park_timeout(POLL_INTERVAL);
        if let Ok(mut handed_over) = shared.handed_over.lock() {
            mem::swap(&mut *handed_over, &mut taken);
        }
        for (state, now_ns) in taken.drain(..) {
            // Without commands a robot on its dock looks like one with the other sign.
            let is_known = state.v_mps.is_some() || state.charger != Charger::default();
            let power_w =
                state.power_w.map(|power_w| if is_known { power_w } else { power_w.abs() });
            judgement.take(&RobotState { power_w, ..state }, state.soc, now_ns);
        }
        // The program's own warnings are its `Judgement`'s.
        judgement.take_news();
        if written.elapsed() >= WRITE_INTERVAL {
            written = Instant::now();
            let errors = judgement.records().into_iter();
            // The times are the publisher's own.
            let errors =
                errors.filter(|found| found.finding.is_error() && found.finding.quantity.is_some());
            let errors: Vec<_> = errors.map(|found| (found.robot, found.finding.kind)).collect();
            // By robot, as the records are.
            let mut doubted: Vec<u32> = errors.iter().map(|(robot, _)| *robot).collect();
            doubted.dedup();
            if doubted != told
                && let Ok(mut news) = shared.doubted.lock()
            {
                told.clone_from(&doubted);
                *news = Some(doubted);
            }
            // The next call tries again.
            let _ = findings.write(errors);
            let not_taken = refused();
            if let Ok(mut told) = shared.not_taken.lock() {
                *told = not_taken;
            }
        }
    }
}
