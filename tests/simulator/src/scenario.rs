//! The meaning of a seed: a fleet, and its faults.

use joulebus_statistics::noise::Noise;
use simulated_host::disk;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1_000 * MS;

/// A part of the fleet: a process that is restarted when it ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Worker,
    /// A source of samples.
    Source(usize),
    Planner(usize),
    /// A client that asks the worker about plans.
    Client(usize),
    Recorder,
    Display(usize),
    Bridge,
}

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A process dies in its n-th operation from then.
    Kill(Role, u64),
    /// A process dies in its n-th access to the disk from then, and its successor in the m-th.
    KillAtDisk(Role, u64, u64),
    /// The power fails, for a time, in a process's n-th access to the disk from then.
    PowerLossAtDisk(Role, u64, u64),
    /// A process is asked to end.
    End(Role),
    /// A process is stopped, for a time.
    Pause(Role, u64),
    /// Operations of a process take so long, for a time.
    Slow(Role, u64, u64),
    /// The wall clock is set, forward or back.
    WallClock(i64),
    /// The monotonic clock is adjusted by so many millionths.
    Drift(i64),
    /// The machine is suspended, for a time: the wall clock and the time since boot go on alone.
    Suspend(u64),
    /// The whole machine stands still, for a time that the monotonic clock leaves out by a jump.
    Jump(u64),
    /// The disk fails, for a time.
    Disk(disk::Fault, u64),
    /// The power fails; the machine starts again after a time.
    PowerLoss(u64),
    /// Shared memory is full, for a time.
    MemoryFull(u64),
    /// A process has no file descriptors left, for a time.
    NoDescriptors(Role, u64),
    /// All files of the processes in shared memory are removed.
    FilesRemoved,
    /// A bit of the saved ledger changes while the worker is killed.
    DamagedLedger(u64),
    /// A source sends so many frames at once.
    Flood(usize, u64),
    /// A process of the user sends false frames on all services.
    Hostile(u64),
    /// A process is asked to end. Its successor first reads so many false frames on all services.
    HostileAtStart(Role, u64),
    /// So many further sources appear, each with a name and a robot of its own.
    Newcomers(u64),
    /// Another process sends for the robots of a source, under a name of its own.
    Rival(usize, u64),
    /// Another process sends under the name of a source.
    Namesake(usize, u64),
    /// A process asks so many questions that mean nothing, gives most of them up, and leaves.
    Questions(u64),
    /// A process sends frames with the run and the numbers of those of a source.
    Forged(usize, u64),
}

/// A fault and its time, simulated ns.
pub type Planned = (u64, Fault);

#[derive(Debug, Clone)]
pub struct Setup {
    /// Robots of each source.
    pub robots: usize,
    /// Sources that are always there.
    pub sources: usize,
    pub planners: usize,
    /// Interval at which the first planner polls forecasts, ns. 0: each tick wakes it.
    pub poll_every_ns: u64,
    /// Clients that ask the worker about plans.
    pub clients: usize,
    pub displays: usize,
    /// Bridges: sources whose robots follow those of the other ones. One at most.
    pub bridges: usize,
    /// True if there is a recorder.
    pub records: bool,
    /// Period of the samples and of the tick, ns.
    pub period_ns: u64,
    /// `tick.policy` is "timer".
    pub by_timer: bool,
    /// `platform.model` is "persistence".
    pub persistence: bool,
    /// `ledger.every_s`, ns.
    pub save_every_ns: u64,
    /// `intake.buffer_frames`.
    pub buffer_frames: usize,
    /// `intake.max_sources`.
    pub max_sources: usize,
    /// Time since the start of the machine at the beginning, ns.
    pub uptime_ns: u64,
    /// Faults may affect everything, not only what source 0 and the worker do not need.
    pub everything: bool,
}

/// A simulation, completely: it depends on nothing else.
#[derive(Debug, Clone)]
pub struct Scenario {
    pub seed: u64,
    pub setup: Setup,
    /// Duration without the time in which it must recover, ns.
    pub duration_ns: u64,
    /// The duration for which the faults were planned, ns.
    pub whole_ns: u64,
    /// The duration that was asked for, ns.
    pub asked_ns: Option<u64>,
    /// The faults in order, each with its number in the whole plan.
    pub faults: Vec<(usize, Planned)>,
}

/// Maximum duration of a seed that is not set otherwise, ns.
const MAX_DURATION_NS: u64 = 1_800 * SECOND;
/// From this duration on a fleet is small and slow.
const LONG_NS: u64 = 200 * 3_600 * SECOND;
/// Maximum number of faults of a plan.
const MAX_FAULTS: u64 = 4_000;

impl Setup {
    /// `platform.stale_after_s`, ns.
    pub const fn stale_after_ns(&self) -> u64 {
        15 * self.period_ns
    }

    /// `intake.leave_after_s`, ns.
    pub const fn leave_after_ns(&self) -> u64 {
        40 * self.period_ns
    }

    /// Time without faults after which everything must work again, ns.
    pub const fn settle_ns(&self) -> u64 {
        2 * self.leave_after_ns() + 60 * self.period_ns + 20 * SECOND
    }

    /// Robots that sources have all the time.
    pub const fn regular(&self) -> usize {
        (self.sources + self.bridges) * self.robots
    }

    fn draw(noise: &mut Noise, is_long: bool) -> Self {
        let periods_ms: &[u64] =
            if is_long { &[10_000] } else { &[33, 100, 200, 500, 500, 1_000, 1_000, 2_000] };
        let period_ns = periods_ms[noise.below(periods_ms.len())] * MS;
        let uptimes_s = [0, 90, 4_294_967, 4_294_968, 315_360_000];
        Self {
            robots: if is_long { 1 } else { 1 + noise.below(3) },
            sources: if is_long { 2 } else { 1 + noise.below(3) },
            planners: 1 + noise.below(2),
            poll_every_ns: 0,
            clients: 0,
            displays: 0,
            bridges: 0,
            records: !is_long && noise.below(3) == 0,
            period_ns,
            by_timer: noise.below(4) == 0,
            persistence: noise.below(3) == 0,
            save_every_ns: if is_long {
                3_600 * SECOND
            } else {
                let drawn_ns = [SECOND, 2 * SECOND, 10 * SECOND, 60 * SECOND][noise.below(4)];
                drawn_ns.max(2 * period_ns)
            },
            buffer_frames: [2, 4, 8, 32][noise.below(4)],
            max_sources: 4 + noise.below(5),
            uptime_ns: uptimes_s[noise.below(uptimes_s.len())] * SECOND + 1,
            everything: noise.below(4) > 0,
        }
    }

    /// The config of the fleet.
    pub fn toml(&self, ledger: &str) -> String {
        let seconds = |ns: u64| ns as f64 * 1e-9;
        let hz = 1.0 / seconds(self.period_ns);
        let policy = if self.by_timer { "timer" } else { "on_frame" };
        let model =
            if self.persistence { "model = \"persistence\"\nresidual_std_w = 0.1\n" } else { "" };
        format!(
            "[fleet]\nname = \"sim\"\ncapacity = {}\n\
             [domain]\nroot = \"/dev/shm/joulebus-simulated\"\nprefix = \"jbs_\"\n\
             [tick]\npolicy = \"{policy}\"\nrate_hz = {hz:?}\ndeadline_ms = {:?}\n\
             [intake]\nmax_sources = {}\nbuffer_frames = {}\nleave_after_s = {:?}\nmax_jump_s = {:?}\n\
             [readers]\nmax_planners = 6\n[worker]\nthreads = 1\n\
             [ledger]\ncheckpoint = \"{ledger}\"\nevery_s = {:?}\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-999999\"]\n\
             rate_hz = {hz:?}\nstale_after_s = {:?}\nhold_max_s = {:?}\nstuck_after_s = {:?}\n{model}\
             [queries]\nanswer = \"{}\"\n",
            2 * self.regular() + 4,
            seconds(self.period_ns) * 300.0,
            self.max_sources + self.bridges,
            self.buffer_frames,
            seconds(self.leave_after_ns()),
            seconds(self.leave_after_ns()),
            seconds(self.save_every_ns),
            seconds(self.stale_after_ns()),
            seconds(self.stale_after_ns()),
            seconds(4 * self.stale_after_ns()),
            // Years would be spent waiting for questions.
            if self.clients > 0 { "on" } else { "off" },
        )
    }
}

impl Scenario {
    /// The simulation that a seed means; `duration_ns` instead of its own.
    pub fn new(seed: u64, asked_ns: Option<u64>) -> Self {
        let mut noise = Noise::new(seed, 0);
        let drawn_ns = (1 + noise.below(30)) as u64 * MAX_DURATION_NS / 30;
        let duration_ns = asked_ns.unwrap_or(drawn_ns);
        let is_long = duration_ns >= LONG_NS;
        let mut setup = Setup::draw(&mut noise, is_long);
        let mut faults = plan(&mut noise, &setup, duration_ns);
        // Numbers of their own, so that earlier seeds keep their meaning.
        faults.extend(forgeries(&mut Noise::new(seed, 2), &setup, duration_ns));
        let mut asking = Noise::new(seed, 3);
        setup.clients = if is_long { 0 } else { asking.below(4) };
        let clients: Vec<Role> = (0..setup.clients).map(Role::Client).collect();
        faults.extend(faults_of(&clients, &mut asking, &setup, duration_ns));
        faults.extend(faults_at_the_disk(&mut Noise::new(seed, 4), &setup, duration_ns));
        faults.extend(hostile_at_starts(&mut Noise::new(seed, 6), &setup, duration_ns));
        faults.extend(standstills(&mut Noise::new(seed, 7), &setup, duration_ns));
        let mut showing = Noise::new(seed, 9);
        // Not in the seeds that once found defects.
        (setup.displays, setup.bridges) = match showing.below(8) {
            2 if !is_long => (2, 0),
            4 if !is_long => (2, 1),
            5 if !is_long => (0, 1),
            _ => (0, 0),
        };
        let displays = (0..setup.displays).map(Role::Display);
        let shows: Vec<Role> = displays.chain((0..setup.bridges).map(|_| Role::Bridge)).collect();
        faults.extend(faults_of(&shows, &mut showing, &setup, duration_ns));
        setup.poll_every_ns = polling(&mut Noise::new(seed, 5), &setup, is_long);
        // The first source that comes owns a robot: source 0, which starts while there is memory,
        // if nothing is to happen to it.
        let begin_ns = if setup.everything { 0 } else { SECOND + 3 * setup.period_ns };
        faults.retain(|(at_ns, _)| *at_ns >= begin_ns);
        faults.sort_by_key(|(at_ns, _)| *at_ns);
        Self {
            seed,
            faults: faults.into_iter().enumerate().collect(),
            setup,
            duration_ns,
            whole_ns: duration_ns,
            asked_ns,
        }
    }

    /// The same, with the faults of these numbers alone.
    #[must_use]
    pub fn only(mut self, numbers: &[usize]) -> Self {
        self.faults.retain(|(number, _)| numbers.contains(number));
        self
    }

    /// The same, which ends at `until_ns`.
    #[must_use]
    pub fn until(mut self, until_ns: u64) -> Self {
        self.duration_ns = self.duration_ns.min(until_ns);
        self.faults.retain(|(_, (at_ns, _))| *at_ns < until_ns);
        self
    }

    /// The same, with source 0 alone and without faults: what its robots must be answered.
    pub fn undisturbed(&self) -> Self {
        let mut same = self.clone();
        same.faults.clear();
        (same.setup.sources, same.setup.planners, same.setup.clients) = (1, 0, 0);
        (same.setup.displays, same.setup.bridges) = (0, 0);
        same.setup.records = false;
        same
    }
}

/// Faults at random times, of kinds that the seed allows: each seed has its own mixture.
fn plan(noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    const KINDS: usize = 17;
    let allowed: Vec<usize> = (0..KINDS).filter(|_| noise.below(2) == 0).collect();
    let mean_s = [3.0, 10.0, 30.0, 120.0][noise.below(4)];
    let least_s = duration_ns as f64 * 1e-9 / MAX_FAULTS as f64;
    let mean_s = f64::max(mean_s * (setup.period_ns as f64 * 1e-9).max(0.3), least_s);
    let mut faults = Vec::new();
    let mut at_s = 0.0;
    loop {
        at_s += noise.waiting_s(mean_s);
        let at_ns = (at_s * 1e9) as u64;
        if at_ns >= duration_ns || allowed.is_empty() {
            return faults;
        }
        let kind = allowed[noise.below(allowed.len())];
        if let Some(fault) = draw(noise, setup, kind) {
            faults.push((at_ns, fault));
        }
    }
}

/// In one seed of four, faults at random times that are `mean_s` apart on average.
fn in_one_of_four(
    noise: &mut Noise,
    (duration_ns, mean_s): (u64, f64),
    applies: bool,
    mut draw: impl FnMut(&mut Noise) -> Option<Fault>,
) -> Vec<Planned> {
    let duration_s = duration_ns as f64 * 1e-9;
    let mut faults = Vec::new();
    let mut at_s = 0.0;
    if noise.below(4) > 0 || !applies {
        return faults;
    }
    loop {
        at_s += noise.waiting_s(mean_s);
        if at_s >= duration_s {
            return faults;
        }
        faults.extend(draw(noise).map(|fault| ((at_s * 1e9) as u64, fault)));
    }
}

/// The time between faults of a kind: a share of the run, and at least `least_ns`.
fn apart(duration_ns: u64, shares: f64, least_ns: f64) -> (u64, f64) {
    (duration_ns, f64::max(least_ns * 1e-9, duration_ns as f64 * 1e-9 / shares))
}

/// Frames with run and numbers of a source.
fn forgeries(noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    let times = apart(duration_ns, 100.0, 200.0 * setup.period_ns as f64);
    in_one_of_four(noise, times, true, |noise| {
        let source = source(noise, setup)?;
        Some(Fault::Forged(source, 1 + noise.below(6) as u64))
    })
}

/// Kills and power failures in the middle of what is being written.
fn faults_at_the_disk(noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    let times = apart(duration_ns, 100.0, 3.0 * setup.save_every_ns as f64);
    in_one_of_four(noise, times, setup.everything, |noise| {
        let is_recorder = setup.records && noise.below(4) == 0;
        let role = if is_recorder { Role::Recorder } else { Role::Worker };
        let accesses = 1 + noise.below(12) as u64;
        Some(match noise.below(3) {
            0 => Fault::PowerLossAtDisk(role, accesses, (1 + noise.below(9)) as u64 * SECOND),
            // The next one reads before it writes.
            _ => Fault::KillAtDisk(role, accesses, 1 + noise.below(18) as u64),
        })
    })
}

/// With a recorder, false frames that are the first that it reads.
fn hostile_at_starts(noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    let times = apart(duration_ns, 50.0, 100.0 * setup.period_ns as f64);
    in_one_of_four(noise, times, setup.records, |noise| {
        let frames = 1 + noise.below(20) as u64;
        Some(Fault::HostileAtStart(Role::Recorder, frames))
    })
}

/// The whole machine is suspended or stands still.
fn standstills(noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    let times = apart(duration_ns, 50.0, 200.0 * setup.period_ns as f64);
    in_one_of_four(noise, times, true, |noise| match noise.below(2) {
        0 => Some(Fault::Suspend([1, 600, 86_400, 8_640_000][noise.below(4)] * SECOND)),
        // Within what a robot bridges, beyond it, and until robots have left.
        _ if setup.everything => Some(Fault::Jump([2, 30, 300][noise.below(3)] * setup.period_ns)),
        _ => None,
    })
}

/// Interval at which the first planner polls, in one seed of two. 0: it does not poll.
fn polling(noise: &mut Noise, setup: &Setup, is_long: bool) -> u64 {
    if is_long || noise.below(2) == 0 {
        return 0;
    }
    [10 * MS, setup.period_ns / 2, setup.period_ns, 10 * SECOND][noise.below(4)]
}

/// Faults of clients, and questions of strangers, or faults of displays and bridges, at random
/// times.
fn faults_of(roles: &[Role], noise: &mut Noise, setup: &Setup, duration_ns: u64) -> Vec<Planned> {
    let duration_s = duration_ns as f64 * 1e-9;
    let mean_s = f64::max(60.0 * setup.period_ns as f64 * 1e-9, duration_s / 200.0);
    let mut faults = Vec::new();
    let mut at_s = 0.0;
    if roles.is_empty() {
        return faults;
    }
    loop {
        at_s += noise.waiting_s(mean_s);
        if at_s >= duration_s {
            return faults;
        }
        let role = roles[noise.below(roles.len())];
        let long = (1 + noise.below(100)) as u64 * setup.period_ns;
        let fault = match (noise.below(5), role) {
            (0 | 1, _) => Fault::Kill(role, 1 + noise.below(60) as u64),
            (2, _) => Fault::End(role),
            (3, _) => Fault::Pause(role, long),
            (_, Role::Client(_)) => Fault::Questions(1 + noise.below(20) as u64),
            _ => Fault::NoDescriptors(role, long),
        };
        faults.push(((at_s * 1e9) as u64, fault));
    }
}

/// A process; in a run in which source 0 is not disturbed, neither that one nor the worker.
fn role(noise: &mut Noise, setup: &Setup) -> Option<Role> {
    let role = match noise.below(6) {
        0 | 1 => Role::Worker,
        2 | 3 => Role::Source(noise.below(setup.sources)),
        4 => Role::Planner(noise.below(setup.planners)),
        _ => Role::Recorder,
    };
    let is_needed = matches!(role, Role::Worker | Role::Source(0));
    let exists = role != Role::Recorder || setup.records;
    (exists && (setup.everything || !is_needed)).then_some(role)
}

/// A source; in a run in which source 0 is not disturbed, another one.
fn source(noise: &mut Noise, setup: &Setup) -> Option<usize> {
    let source = noise.below(setup.sources);
    (setup.everything || source > 0).then_some(source)
}

fn draw(noise: &mut Noise, setup: &Setup, kind: usize) -> Option<Fault> {
    let short = (1 + noise.below(8)) as u64 * setup.period_ns;
    let long = short * (1 + noise.below(20)) as u64;
    let only = |fault: Fault| setup.everything.then_some(fault);
    match kind {
        0 => Some(Fault::Kill(role(noise, setup)?, 1 + noise.below(400) as u64)),
        1 => Some(Fault::End(role(noise, setup)?)),
        2 => Some(Fault::Pause(role(noise, setup)?, long)),
        3 => {
            let cost_ns = setup.period_ns / [20, 100, 1_000][noise.below(3)];
            // There is one processor: a slow process delays the source that is not to be disturbed.
            only(Fault::Slow(role(noise, setup)?, cost_ns, short))
        }
        4 => {
            let step_s = [1, 3_600, 86_400, 300_000_000][noise.below(4)];
            let sign = if noise.below(2) == 0 { 1 } else { -1 };
            Some(Fault::WallClock(sign * step_s * SECOND as i64))
        }
        5 => Some(Fault::Drift(noise.below(1_001) as i64 - 500)),
        6 => {
            let faults = [disk::Fault::Failing, disk::Fault::Full, disk::Fault::Short];
            Some(Fault::Disk(faults[noise.below(3)], long))
        }
        7 => only(Fault::PowerLoss(long)),
        8 => Some(Fault::MemoryFull(long)),
        9 => Some(Fault::NoDescriptors(role(noise, setup)?, long)),
        10 => only(Fault::FilesRemoved),
        11 => only(Fault::DamagedLedger(noise.bits())),
        12 => Some(Fault::Flood(source(noise, setup)?, 1 + noise.below(100) as u64)),
        13 => Some(Fault::Hostile(1 + noise.below(40) as u64)),
        14 => Some(Fault::Newcomers(1 + noise.below(2 * setup.max_sources) as u64)),
        15 => Some(Fault::Rival(noise.below(setup.sources), 1 + noise.below(30) as u64)),
        _ => Some(Fault::Namesake(source(noise, setup)?, 1 + noise.below(30) as u64)),
    }
}
