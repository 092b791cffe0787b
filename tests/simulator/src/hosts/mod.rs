//! A fleet over three hosts, joined by links: the controller, its planner and a link on one, and on
//! two others a worker with its link each, of which the holder of the lease serves.
//!
//! Clocks, disk, memory and processes of a simulated host belong to a thread. So each host has a
//! thread, and they take turns: none runs further ahead than a message takes at least. A seed
//! determines everything.

mod fault;
mod machine;

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::Scope;

use joulebus_statistics::noise::Noise;
use simulated_host::disk;
use simulated_link::{Access, Packet, SharedStore, lose, reach};

use crate::check::{Checked, Failure};
use crate::scenario::Setup;
use crate::world::Outcome;
use fault::{BASES, Fault, MS, Part, SECOND};
use machine::{Machine, Report, Seen};

/// All hosts, by number.
const HOSTS: [&str; 3] = ["edge", BASES[0], BASES[1]];
const EDGE: usize = 0;
/// A message takes at least so long, and no host runs further ahead.
const LEAST_DELAY_NS: u64 = MS;
/// Time without faults after which everything works again. A term is remembered for two minutes
/// after the store has lost it, but the store loses nothing here.
const SETTLE_NS: u64 = 60 * SECOND;
/// Time for which the settled hosts are watched.
const WATCH_NS: u64 = 10 * SECOND;
/// Time within which another worker's forecasts come if one hangs: two leases of 3 s, beside the
/// ticks.
const TAKEOVER_NS: u64 = 6 * SECOND;
/// A leader without frames is idle after so many ticks, if that is longer than half a lease.
const IDLE_TICKS: u64 = 5;
/// Time within which forecasts come again after clocks stood still, beside two ticks.
const STEP_NS: u64 = SECOND / 2;
/// Time after which a link notices that a peer is out of reach.
const PEER_TIMEOUT_NS: u64 = SECOND;
/// Frames of workers that are remembered.
const REMEMBERED: usize = 4_096;

type Work = Box<dyn FnOnce(&mut Machine) + Send>;

struct Handle {
    work: Sender<Work>,
    /// When its next step is due, simulated ns.
    due_ns: u64,
    /// Messages on their way to it, and when they arrive.
    arrivals: Vec<(u64, Packet)>,
    access_until_ns: u64,
}

impl Handle {
    fn due_ns(&self) -> u64 {
        self.arrivals.iter().map(|(at_ns, _)| *at_ns).fold(self.due_ns, u64::min)
    }

    /// Runs `work` on the host, and waits for it.
    fn ask<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Machine) -> T + Send + 'static,
    ) -> Checked<T> {
        let (answer, answered) = channel();
        let asked = self.work.send(Box::new(move |machine| {
            let _ = answer.send(work(machine));
        }));
        let answered = asked.ok().and_then(|()| answered.recv().ok());
        answered.ok_or_else(|| broken("the simulation itself works", "a host's thread panicked"))
    }
}

fn broken(invariant: &'static str, found: impl Into<String>) -> Failure {
    Failure { invariant, found: found.into(), at_ns: 0 }
}

/// A fault that has happened: its number, when, s, and what.
pub(crate) type Happened = (usize, f64, String);

/// Runs a seed for `duration_ns` and the time in which everything must work again. Setting `stop`
/// ends it.
pub(crate) fn run(seed: u64, duration_ns: u64, stop: &AtomicBool) -> (Outcome, Vec<Happened>) {
    std::thread::scope(|scope| {
        let mut noise = Noise::new(seed, 0);
        let setup = setup(&mut noise);
        let mut world = match World::begin(scope, seed, &setup, noise) {
            Ok(world) => world,
            Err(error) => {
                let failure = Some(broken("the files are accepted", error.to_string()));
                return (Outcome { failure, ..Outcome::default() }, Vec::new());
            }
        };
        let played = world.play(duration_ns, stop);
        let now_ns = world.now_ns;
        world.outcome.failure = played.err().map(|failure| Failure { at_ns: now_ns, ..failure });
        world.outcome.is_stopped = stop.load(Ordering::Relaxed);
        world.outcome.simulated_ns = now_ns;
        for host in &world.hosts {
            let _ = host.ask(Machine::bury_all);
        }
        (world.outcome, world.happened)
    })
}

fn setup(noise: &mut Noise) -> Setup {
    let period_ns = [50, 100, 200, 500][noise.below(4)] * MS;
    Setup {
        robots: 1 + noise.below(3),
        sources: 1,
        planners: 1,
        poll_every_ns: 0,
        clients: 0,
        displays: 0,
        bridges: 0,
        records: false,
        period_ns,
        by_timer: noise.below(2) == 0,
        persistence: true,
        save_every_ns: 10 * SECOND,
        buffer_frames: 8,
        max_sources: 8,
        uptime_ns: 1,
        everything: true,
    }
}

/// The network and the hosts.
struct World {
    noise: Noise,
    hosts: Vec<Handle>,
    store: SharedStore,
    now_ns: u64,
    /// Until when two hosts do not reach each other, and whether they know.
    cuts: BTreeMap<(usize, usize), (u64, u64, bool)>,
    /// Loss and repetition, per mille, maximum delay, and until when.
    weather: ([usize; 2], u64, u64),
    /// When the last message from one host to another arrives.
    last_ns: BTreeMap<(usize, usize), u64>,
    /// Links that others are to miss, and when.
    missing: Vec<(u64, usize)>,
    /// Frames of the workers: tick and digest.
    made: VecDeque<(u64, u64)>,
    /// The run that serves, its host, and those before.
    serving: Option<(usize, u64)>,
    over: Vec<(usize, u64)>,
    newest: Option<Seen>,
    /// Samples that the controller has published, and that the worker knows of.
    samples: (u64, u64),
    /// Until when observers may miss frames of workers, since shared memory is full.
    blind_until_ns: u64,
    taken: [u64; 3],
    robots: usize,
    period_ns: u64,
    outcome: Outcome,
    happened: Vec<Happened>,
}

impl World {
    fn begin<'scope>(
        scope: &'scope Scope<'scope, '_>,
        seed: u64,
        setup: &Setup,
        mut noise: Noise,
    ) -> anyhow::Result<Self> {
        let store = SharedStore::default();
        let mut hosts = Vec::new();
        for (number, name) in HOSTS.into_iter().enumerate() {
            let files = machine::files(setup, name)?;
            let parts: &'static [Part] = match number {
                EDGE => &[Part::Link, Part::Source, Part::Planner],
                _ => &[Part::Worker, Part::Link],
            };
            let uptimes_s = [0, 90, 4_294_968, 315_360_000];
            let uptime_ns = uptimes_s[noise.below(uptimes_s.len())] * SECOND + 1;
            let (work, works): (Sender<Work>, Receiver<Work>) = channel();
            let (setup, store) = (setup.clone(), store.clone());
            scope.spawn(move || {
                let seed = (seed * HOSTS.len() as u64 + number as u64, uptime_ns);
                let mut machine = Machine::new(seed, &setup, files, parts);
                reach(&store, Access::Lossy(100));
                works.into_iter().for_each(|work| work(&mut machine));
            });
            hosts.push(Handle { work, due_ns: 0, arrivals: Vec::new(), access_until_ns: u64::MAX });
        }
        Ok(Self {
            noise,
            hosts,
            store,
            now_ns: 0,
            cuts: BTreeMap::new(),
            weather: CALM,
            last_ns: BTreeMap::new(),
            missing: Vec::new(),
            made: VecDeque::new(),
            serving: None,
            over: Vec::new(),
            newest: None,
            samples: (0, 0),
            blind_until_ns: 0,
            taken: [0; 3],
            robots: setup.robots,
            period_ns: setup.period_ns,
            outcome: Outcome::default(),
            happened: Vec::new(),
        })
    }

    fn play(&mut self, duration_ns: u64, stop: &AtomicBool) -> Checked {
        self.run_until(15 * SECOND)?;
        while self.now_ns < duration_ns && !stop.load(Ordering::Relaxed) {
            let pause_ns = self.below(30_000) * MS;
            self.run_until(self.now_ns + pause_ns)?;
            let (at, fault) = self.draw();
            let happened = format!("{}: {fault:?}", HOSTS[at]);
            self.happened.push((self.happened.len(), self.now_ns as f64 * 1e-9, happened));
            self.outcome.faults += 1;
            self.happens(at, fault)?;
        }
        self.everything_works_again()
    }

    fn below(&mut self, bound: usize) -> u64 {
        self.noise.below(bound) as u64
    }

    /// Draws a fault, and its host.
    fn draw(&mut self) -> (usize, Fault) {
        let host = self.noise.below(HOSTS.len());
        let parts: &[Part] = match host {
            EDGE => &[Part::Link, Part::Link, Part::Source, Part::Planner],
            _ => &[Part::Worker, Part::Link],
        };
        let part = parts[self.noise.below(parts.len())];
        let for_ns = self.below(20_000) * MS;
        let fault = match self.noise.below(17) {
            0..3 => Fault::Kill(part, 1 + self.below(20_000)),
            3 => Fault::KillAtDisk(part, 1 + self.below(40)),
            4 => Fault::End(part),
            5 => Fault::Pause(part, for_ns / 2),
            6 => Fault::Suspend(for_ns),
            7 => Fault::Jump(for_ns / 4),
            8 => Fault::WallClock(self.below(20_000) as i64 * SECOND as i64 - for_ns as i64),
            9 => Fault::Drift(self.below(1_001) as i64 - 500),
            10 => {
                let faults = [disk::Fault::Failing, disk::Fault::Full, disk::Fault::Short];
                Fault::Disk(faults[self.noise.below(3)], for_ns / 2)
            }
            11 => Fault::MemoryFull(for_ns / 4),
            12 => Fault::PowerLoss(for_ns),
            13 => Fault::Cut((host + 1) % HOSTS.len(), for_ns),
            14 => {
                let all = [Access::Cut, Access::Silent, Access::Lossy(3)];
                Fault::Store(all[self.noise.below(3)], for_ns)
            }
            // After a pause a worker may serve the host's neighbours for the rest of its permit. So
            // only a host without one is paused.
            15 if host == EDGE => Fault::StandStill(for_ns / 4),
            15 => Fault::Pause(Part::Worker, 3 * for_ns),
            _ => {
                let permille = [self.noise.below(300), self.noise.below(100)];
                Fault::Weather(permille, LEAST_DELAY_NS + self.below(300) * MS, for_ns)
            }
        };
        (host, fault)
    }

    fn happens(&mut self, at: usize, fault: Fault) -> Checked {
        let now_ns = self.now_ns;
        match fault {
            Fault::Cut(other, ns) => {
                let cut = (now_ns + ns, now_ns + PEER_TIMEOUT_NS, false);
                self.cuts.insert((at.min(other), at.max(other)), cut);
            }
            Fault::Store(access, ns) => {
                let store = self.store.clone();
                self.hosts[at].ask(move |_| reach(&store, access))?;
                self.hosts[at].access_until_ns = now_ns + ns;
            }
            Fault::Weather(permille, delay_ns, ns) => {
                self.weather = (permille, delay_ns, now_ns + ns);
            }
            Fault::MemoryFull(ns) if at != EDGE => self.blind_until_ns = now_ns + ns + SECOND,
            _ => {}
        }
        self.hosts[at].due_ns = self.hosts[at].ask(move |machine| {
            simulated_host::time::pass_until(now_ns);
            machine.happens(fault).map(|()| machine.due_ns())
        })??;
        Ok(())
    }

    fn run_until(&mut self, until_ns: u64) -> Checked {
        while self.now_ns < until_ns {
            self.end_windows()?;
            let due_ns = self.hosts.iter().map(Handle::due_ns).min().unwrap_or(u64::MAX);
            self.now_ns = self.now_ns.max(due_ns).min(until_ns);
            let end_ns = (self.now_ns + LEAST_DELAY_NS).min(until_ns);
            // Workers' hosts first: their frames are known before others have them.
            for at in [1, 2, EDGE] {
                if self.hosts[at].due_ns() < end_ns {
                    let arrivals = std::mem::take(&mut self.hosts[at].arrivals);
                    let report = self.hosts[at]
                        .ask(move |machine| machine.run_until(end_ns, arrivals))??;
                    self.takes(at, report)?;
                }
            }
            self.now_ns = end_ns;
        }
        Ok(())
    }

    /// Ends faults that last for a time, and lets links miss each other.
    fn end_windows(&mut self) -> Checked {
        let now_ns = self.now_ns;
        if now_ns >= self.weather.2 {
            self.weather = CALM;
        }
        for at in 0..self.hosts.len() {
            if now_ns >= self.hosts[at].access_until_ns {
                let store = self.store.clone();
                self.hosts[at].ask(move |_| reach(&store, Access::Lossy(100)))?;
                self.hosts[at].access_until_ns = u64::MAX;
            }
        }
        let mut lost = Vec::new();
        for ((one, other), (_, at_ns, is_known)) in &mut self.cuts {
            if now_ns >= *at_ns && !*is_known {
                *is_known = true;
                lost.extend([(*one, *other), (*other, *one)]);
            }
        }
        self.cuts.retain(|_, (until_ns, ..)| now_ns < *until_ns);
        for (_, name) in self.missing.extract_if(.., |(at_ns, _)| now_ns >= *at_ns) {
            lost.extend((0..HOSTS.len()).filter(|at| *at != name).map(|at| (at, name)));
        }
        for (at, name) in lost {
            self.hosts[at].ask(move |_| lose(HOSTS[name]))?;
            self.hosts[at].due_ns = now_ns;
        }
        Ok(())
    }

    /// Takes the report of the host `at`.
    fn takes(&mut self, at: usize, report: Report) -> Checked {
        self.hosts[at].due_ns = report.due_ns;
        self.taken[at] += report.samples;
        if let Some(published) = report.published.filter(|_| at == EDGE) {
            self.samples.0 = published;
        }
        self.outcome.processes += report.processes;
        self.outcome.ticks += report.learned;
        for _ in 0..report.links_ended {
            let after_ns = self.below(1_200) * MS;
            self.missing.push((self.now_ns + after_ns, at));
        }
        for frame in report.frames {
            match at {
                EDGE => self.follows(frame)?,
                _ => self.serves(at, frame)?,
            }
        }
        report.sent.iter().for_each(|packet| self.travels(at, packet));
        Ok(())
    }

    /// A worker of the host `at` has sent a frame: no worker may, once another has.
    fn serves(&mut self, at: usize, frame: Seen) -> Checked {
        self.samples.1 = frame.known;
        let own = (at, frame.run);
        if self.over.contains(&own) {
            let found = format!("{} sends {frame:?}, although {:?}", HOSTS[at], self.serving);
            return Err(broken("one worker serves at a time", found));
        }
        if self.serving != Some(own) {
            self.over.extend(self.serving.replace(own));
        }
        if self.made.len() == REMEMBERED {
            self.made.pop_front();
        }
        self.made.push_back((frame.tick, frame.digest));
        Ok(())
    }

    /// The planner's host has a frame: a worker has made it so.
    fn follows(&mut self, frame: Seen) -> Checked {
        let is_made = self.made.contains(&(frame.tick, frame.digest));
        if !is_made && self.now_ns > self.blind_until_ns {
            return Err(broken("no bit changes on the way", format!("{frame:?} is no worker's")));
        }
        self.newest = Some(frame);
        Ok(())
    }

    /// A message is on its way from the host `from`.
    fn travels(&mut self, from: usize, packet: &Packet) {
        let Some(to) = HOSTS.iter().position(|name| *name == packet.to) else {
            return;
        };
        let ([lost, repeated], delay_ns, _) = self.weather;
        let is_cut = self.cuts.contains_key(&(from.min(to), from.max(to)));
        if is_cut || self.noise.below(1_000) < lost {
            return;
        }
        let copies = 1 + u64::from(self.noise.below(1_000) < repeated);
        for _ in 0..copies {
            let spread = (delay_ns - LEAST_DELAY_NS) as usize + 1;
            let mut at_ns = self.now_ns + 2 * LEAST_DELAY_NS + self.below(spread);
            if self.weather == CALM {
                // In order.
                let last_ns = self.last_ns.entry((from, to)).or_default();
                at_ns = at_ns.max(*last_ns);
                *last_ns = at_ns;
            }
            self.hosts[to].arrivals.push((at_ns, packet.clone()));
        }
    }

    /// Once faults stop, everything works again.
    fn everything_works_again(&mut self) -> Checked {
        self.weather = CALM;
        self.cuts.clear();
        for at in 0..self.hosts.len() {
            self.hosts[at].access_until_ns = 0;
            self.hosts[at].due_ns = self.hosts[at].ask(|machine| {
                machine.spare();
                machine.due_ns()
            })?;
        }
        // A host may be suspended, or off.
        let due_ns = self.hosts.iter().map(|host| host.due_ns).max().unwrap_or_default();
        self.run_until(due_ns.max(self.now_ns) + SETTLE_NS)?;
        self.goes_on()?;
        self.links_start_again()?;
        self.clocks_stand_still()?;
        self.worker_hangs()?;
        self.goes_on()
    }

    /// A link alone starts again, some times: the controller's, and those of the workers. What was
    /// published meanwhile is lost, and counted.
    fn links_start_again(&mut self) -> Checked {
        let before = self.samples;
        for at in [EDGE, EDGE, EDGE, 1, 2, 1, 2] {
            self.happens(at, Fault::End(Part::Link))?;
            self.run_until(self.now_ns + 4 * SECOND)?;
        }
        self.every_sample_is_known(before)
    }

    /// Of the samples since `before`, the worker that serves knows as many as were published.
    fn every_sample_is_known(&self, before: (u64, u64)) -> Checked {
        let (published, known) = (self.samples.0 - before.0, self.samples.1 - before.1);
        // Some samples are on their way, or wait for the next tick.
        if published.abs_diff(known) > 4 * self.robots as u64 {
            let found = format!("{published} samples were published, and the worker knows {known}");
            return Err(broken("every sample is accepted or dropped", found));
        }
        Ok(())
    }

    /// A virtual machine with planners is paused. The others go on.
    fn clocks_stand_still(&mut self) -> Checked {
        let pause_ns = SECOND;
        self.happens(EDGE, Fault::StandStill(pause_ns))?;
        let resumed_ns = self.now_ns + pause_ns;
        self.run_until(resumed_ns + STEP_NS + 2 * self.period_ns)?;
        let newest_ns = self.newest.map_or(0, |frame| frame.at_ns);
        if newest_ns <= resumed_ns + 3 * LEAST_DELAY_NS {
            let found = format!("after a pause until {resumed_ns} ns: {:?}", self.newest);
            return Err(broken("a step of a clock is measured at once", found));
        }
        Ok(())
    }

    /// The worker that serves hangs, and nothing else. Then its link alone starts again, and the
    /// other link is stopped until its lease has ended.
    fn worker_hangs(&mut self) -> Checked {
        let Some((hung, _)) = self.serving else {
            return Err(broken("everything goes on", "no worker has served"));
        };
        let (other, before) = (HOSTS.len() - hung, self.samples);
        self.happens(hung, Fault::Pause(Part::Worker, 1_000 * SECOND))?;
        self.run_until(self.now_ns + TAKEOVER_NS + IDLE_TICKS * self.period_ns)?;
        let is_back = self.newest.is_some_and(|frame| {
            let every_ns = 2 * self.period_ns + SECOND / 5;
            frame.at_ns + every_ns > self.now_ns
        });
        if !is_back || self.serving.is_none_or(|(at, _)| at != other) {
            let found = format!("{:?} serves, the newest frame is {:?}", self.serving, self.newest);
            return Err(broken("another takes over from a worker that hangs", found));
        }
        self.happens(hung, Fault::End(Part::Link))?;
        self.run_until(self.now_ns + 3 * SECOND)?;
        self.happens(other, Fault::Pause(Part::Link, 6 * SECOND))?;
        for _ in 0..200 {
            self.run_until(self.now_ns + SECOND / 10)?;
            if self.store.holder().is_some_and(|holder| holder == HOSTS[hung]) {
                let found = format!("{} holds the lease again", HOSTS[hung]);
                return Err(broken("a worker that hangs gets no lease", found));
            }
        }
        self.hosts[hung].due_ns = self.hosts[hung].ask(|machine| {
            machine.spare();
            machine.due_ns()
        })?;
        self.run_until(self.now_ns + 10 * SECOND)?;
        self.every_sample_is_known(before)
    }

    fn goes_on(&mut self) -> Checked {
        let (taken, frames, serving) = (self.taken, self.outcome.ticks, self.serving);
        self.run_until(self.now_ns + WATCH_NS)?;
        let expected = WATCH_NS / self.period_ns * 7 / 10;
        let frames = self.outcome.ticks - frames;
        let robots = self.newest.map_or(0, |header| header.robots);
        let taken = [1, 2].map(|at| (self.taken[at] - taken[at]) / self.robots as u64);
        if frames < expected || robots != self.robots || taken.iter().any(|count| *count < expected)
        {
            let found = format!(
                "in {WATCH_NS} ns the planner had {frames} frames of {robots} robots, and the \
                 workers {taken:?} frames of samples, expected {expected} of {}",
                self.robots
            );
            return Err(broken("everything goes on", found));
        }
        if serving != self.serving {
            let found = format!("{:?} serves, a moment ago {serving:?}", self.serving);
            return Err(broken("everything goes on", found));
        }
        Ok(())
    }
}

const CALM: ([usize; 2], u64, u64) = ([0, 0], 5 * MS, u64::MAX);
