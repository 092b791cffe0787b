//! The invariants.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;

use bytemuck::bytes_of;
use joulebus_capture_format::Reader;
use joulebus_capture_verify::Verifier;
use joulebus_config::Config;
use joulebus_predictor::Model;
use joulebus_wire::{
    Budget, BudgetHeader, Budgets, Forecast, ForecastHeader, Forecasts, SampleHeader, budget_flag,
    fnv1a, forecast_flag,
};
use simulated_bus::{self as bus, Bus};
use simulated_consumer::End;
use simulated_host::{self as host, disk, time};
use simulated_recorder::{Options, Summary};

use simulated_planner::Answered;

use crate::process::{FALSE_ROBOT, FrameId, Learned, Shown, is_constant, is_possible, power_w};
use crate::scenario::Setup;

/// Pid of the process that observes.
const OBSERVER: u32 = 1;
/// Robots of sources that are always there have lower ids.
pub(crate) const REGULAR_BELOW: u32 = 100;
/// µW·ns in one µJ, times 2, as in the ledger.
const PER_MICROJOULE: i128 = 2_000_000_000;

/// An invariant that does not hold.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Failure {
    pub invariant: &'static str,
    pub found: String,
    /// When, simulated ns.
    pub at_ns: u64,
}

pub(crate) type Checked<T = ()> = Result<T, Failure>;

pub(crate) fn failure(invariant: &'static str, found: String) -> Failure {
    Failure { invariant, found, at_ns: time::now_ns() }
}

fn remember<T>(all: &mut VecDeque<T>, next: T) {
    if all.len() == REMEMBERED {
        all.pop_front();
    }
    all.push_back(next);
}

fn ensure(holds: bool, invariant: &'static str, found: impl FnOnce() -> String) -> Checked {
    if holds {
        return Ok(());
    }
    Err(failure(invariant, found()))
}

/// The answer to a sample, and the ledger with it.
pub(crate) type Answer = ((u16, u16), [u32; 4]);
/// Energy and times of a robot at a stamp.
pub(crate) type Entry = (i64, i64, u64, u64);

/// First answers by robot and sample, ledgers by robot and stamp, of the robots of source 0.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    pub(crate) forecasts: BTreeMap<(u32, u64), Answer>,
    pub(crate) ledgers: BTreeMap<(u32, u64), Entry>,
}

struct Ports {
    forecasts: bus::Reader<Forecasts>,
    budgets: bus::Reader<Budgets>,
}

/// The run of a worker.
struct Life {
    pid: u32,
    /// When it began, simulated ns.
    began_ns: u64,
    /// Run and tick of its newest frame.
    place: Option<(u64, u64)>,
    /// Samples that its frames had, and those that were lost before them.
    taken: u64,
    lost: u64,
    /// Run of each source, and its samples accounted for.
    sources: BTreeMap<u64, (u64, u64)>,
    /// Every name belongs to one source, and every source has a place.
    is_regular: bool,
}

struct Account {
    born_ns: u64,
    row: Budget,
    /// Number of the frame of budgets with it.
    frame: u64,
    /// Life of the worker that published it.
    life: u64,
    /// When that worker ended, simulated ns.
    ended_ns: u64,
    /// Metered time at earlier times (simulated ns).
    history: VecDeque<(u64, u64)>,
}

/// End of a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The worker shut down.
    InOrder,
    /// The worker was killed.
    Killed,
    /// The worker was killed while it shut down.
    Between,
}

/// Frames, and ends of workers, that are remembered.
const REMEMBERED: usize = 4_096;

pub(crate) struct Checker {
    setup: Setup,
    config: Config,
    models: Vec<Model>,
    ports: Option<Ports>,
    life: Option<Life>,
    lives: u64,
    last_epoch: u64,
    accounts: BTreeMap<u32, Account>,
    /// Frames of budgets so far.
    frames: u64,
    /// Run and tick of the last frames of forecasts.
    sent: VecDeque<(u64, u64)>,
    /// The last runs, and how they have ended.
    ends: VecDeque<(u64, Ending)>,
    /// Until then more of the ledger may be lost than promised.
    excused_until_ns: u64,
    /// Until then sources appear that are not always there.
    irregular_until_ns: u64,
    /// A start of the machine lies between the last worker and this one.
    is_rebooted: bool,
    /// Robots of which samples were taken, and which are not always there.
    pub(crate) strangers: BTreeSet<u32>,
    /// The newest frame of each source that was taken.
    newest_of: BTreeMap<u64, SampleHeader>,
    pub(crate) newest: BTreeMap<u32, Forecast>,
    pub(crate) answers: Option<Answers>,
    pub(crate) ticks: u64,
    pub(crate) captures: u64,
    pub(crate) verified_ticks: u64,
}

impl Checker {
    pub(crate) fn new(setup: &Setup, config: &Config, models: Vec<Model>) -> Self {
        Self {
            setup: setup.clone(),
            config: config.clone(),
            models,
            ports: None,
            life: None,
            lives: 0,
            last_epoch: 0,
            accounts: BTreeMap::new(),
            frames: 0,
            sent: VecDeque::new(),
            ends: VecDeque::new(),
            excused_until_ns: 0,
            irregular_until_ns: 0,
            is_rebooted: false,
            strangers: BTreeSet::new(),
            newest_of: BTreeMap::new(),
            newest: BTreeMap::new(),
            answers: None,
            ticks: 0,
            captures: 0,
            verified_ticks: 0,
        }
    }

    /// Joins, also again after a start of the machine.
    pub(crate) fn join(&mut self) {
        host::enter(OBSERVER, 0);
        let full = host::memory_is_full();
        host::fill_memory(false);
        self.ports = self.open();
        host::fill_memory(full);
        let _ = host::leave();
    }

    fn open(&self) -> Option<Ports> {
        let bus = Bus::join(&self.config.domain().ok()?, "observer").ok()?;
        let limits = self.config.limits();
        Some(Ports { forecasts: bus.reader(&limits).ok()?, budgets: bus.reader(&limits).ok()? })
    }

    /// A client's answer is computed from frames that the worker has sent.
    pub(crate) fn answered(&self, answered: &Answered) -> Checked {
        let of_life = self.life.as_ref().and_then(|life| life.place);
        let is_sent = answered.worker_epoch <= self.last_epoch
            && of_life
                .is_none_or(|(epoch, tick)| answered.worker_epoch < epoch || answered.tick <= tick);
        ensure(is_sent, "answers are of the worker's frames", || {
            format!(
                "{answered:?}; the newest frame is {of_life:?}, the last run {}",
                self.last_epoch
            )
        })?;
        ensure(is_possible(&answered.reply), "an energy lies in its interval", || {
            format!("{answered:?}")
        })
    }

    pub(crate) fn worker_begins(&mut self, pid: u32) {
        self.lives += 1;
        let _ = bus::taken_frames(pid);
        self.life = Some(Life {
            pid,
            began_ns: time::now_ns(),
            place: None,
            taken: 0,
            lost: 0,
            sources: BTreeMap::new(),
            is_regular: time::now_ns() > self.irregular_until_ns,
        });
    }

    /// The run of the worker, once it has sent a frame.
    pub(crate) fn run(&self) -> Option<u64> {
        self.life.as_ref()?.place.map(|(run, _)| run)
    }

    /// Returns the run of the worker that has ended, if it has sent a frame.
    pub(crate) fn worker_ends(&mut self, ending: Ending) -> Option<u64> {
        let (run, _) = self.life.take()?.place?;
        remember(&mut self.ends, (run, ending));
        let lives = self.lives;
        for account in self.accounts.values_mut().filter(|account| account.life == lives) {
            account.ended_ns = time::now_ns();
        }
        Some(run)
    }

    /// No frame was sent between two that a planner has read one after the other.
    pub(crate) fn none_between(&self, before: FrameId, after: FrameId) -> Checked {
        let is_missing = |(run, tick): &&(u64, u64)| {
            (*run, *run) == (before.1, after.1) && before.2 < *tick && *tick < after.2
        };
        let missing = self.sent.iter().find(is_missing);
        ensure(missing.is_none(), "planners that poll see every frame", || {
            format!("{after:?} after {before:?}: {missing:?} is missing")
        })
    }

    /// A board has the rows of a frame that the worker has sent.
    pub(crate) fn is_sent(&self, shown: &Shown) -> Checked {
        const NAME: &str = "boards show what the worker has sent";
        let Some(((_, run, tick), _)) = shown.frame else {
            return ensure(shown.robots.is_empty(), NAME, || format!("{shown:?}"));
        };
        let is_old = self.sent.len() == REMEMBERED && self.sent.front() > Some(&(run, tick));
        let is_sent = is_old || self.sent.contains(&(run, tick));
        ensure(is_sent, NAME, || format!("{shown:?}"))?;
        let is_newest = self.sent.back() == Some(&(run, tick));
        let rows = shown.robots.iter().map(|row| (row.robot, bytes_of(row)));
        let is_same = || rows.eq(self.newest.values().map(|row| (row.robot, bytes_of(row))));
        ensure(!is_newest || is_same(), NAME, || format!("{shown:?}, sent was {:?}", self.newest))
    }

    /// A planner that polls distinguishes a shutdown of the run `followed` from a death.
    pub(crate) fn end_is_reported(&self, learned: &Learned, followed: Option<u64>) -> Checked {
        let (Some(end), Some(followed), true) = (learned.end, followed, learned.polls) else {
            return Ok(());
        };
        let ending = self.ends.iter().find(|(run, _)| *run == followed);
        let expected = match ending {
            Some((_, Ending::InOrder)) => End::Ended,
            Some((_, Ending::Killed)) => End::Exited,
            Some((_, Ending::Between)) | None => return Ok(()),
        };
        ensure(end == expected, "a shutdown is told from a death", || {
            format!("run {followed}, {ending:?}: {end:?}, expected {expected:?}")
        })
    }

    /// The newest frame of the source `name` that was taken.
    pub(crate) fn newest_of(&self, name: &str) -> Option<SampleHeader> {
        self.newest_of.get(&fnv1a(name.bytes())).copied()
    }

    pub(crate) fn reboots(&mut self) {
        (self.last_epoch, self.is_rebooted) = (0, true);
        // Runs are numbered by the time since the start of the machine.
        (self.sent, self.ends) = (VecDeque::new(), VecDeque::new());
    }

    /// Until `until_ns` the disk or the worker is hindered: what a kill loses is not bounded.
    pub(crate) fn excuse(&mut self, until_ns: u64) {
        let until_ns = until_ns + 2 * self.setup.save_every_ns + self.slack_ns();
        self.excused_until_ns = self.excused_until_ns.max(until_ns);
    }

    /// Until `until_ns` names are used by several, or there are more than places.
    pub(crate) fn is_irregular(&mut self, until_ns: u64) {
        self.irregular_until_ns = self.irregular_until_ns.max(until_ns);
        if let Some(life) = &mut self.life {
            life.is_regular = false;
        }
    }

    /// A frame of budgets is at most so old when it is saved, ns; and what polling takes.
    const fn slack_ns(&self) -> u64 {
        2 * self.setup.period_ns + 400_000_000
    }

    /// Looks at what the worker has done in a step.
    pub(crate) fn observe(&mut self) -> Checked {
        if let Some(life) = &mut self.life {
            for (header, samples) in bus::taken_frames(life.pid) {
                life.takes(&header, samples);
                self.newest_of.insert(header.source_id, header);
            }
        }
        let Some(mut ports) = self.ports.take() else {
            return Ok(());
        };
        host::enter(OBSERVER, 0);
        let looked = self.look(&mut ports);
        let _ = host::leave();
        self.ports = Some(ports);
        looked
    }

    fn look(&mut self, ports: &mut Ports) -> Checked {
        let mut checked = Ok(());
        let read = ports.forecasts.take_all(|header, rows| {
            if checked.is_ok() {
                checked = self.forecasts(header, rows);
            }
        });
        if read.is_err() {
            // Its files were removed with those of the others.
            return Ok(());
        }
        checked?;
        let mut checked = Ok(());
        let _ = ports.budgets.take_all(|header, rows| {
            if checked.is_ok() {
                checked = self.budgets(header, rows);
            }
        });
        checked
    }

    fn forecasts(&mut self, header: &ForecastHeader, rows: &[Forecast]) -> Checked {
        self.ticks += 1;
        let Some(life) = &mut self.life else {
            return Err(failure("only the worker is believed", format!("{header:?}")));
        };
        ensure(header.pid == life.pid, "only the worker is believed", || {
            format!("a frame of process {} while {} is the worker", header.pid, life.pid)
        })?;
        let place = (header.worker_epoch, header.tick);
        let is_next = match life.place {
            Some((epoch, tick)) => epoch == place.0 && tick < place.1,
            None => place.0 > self.last_epoch,
        };
        ensure(is_next, "runs and ticks only grow", || {
            format!("{place:?} after {:?}, the run before was {}", life.place, self.last_epoch)
        })?;
        (life.place, self.last_epoch) = (Some(place), place.0);
        remember(&mut self.sent, place);
        let counted = header.samples_accepted.saturating_add(header.samples_dropped.total());
        let sent = life.taken + life.lost;
        let adds_up = if life.is_regular { counted == sent } else { counted >= life.taken };
        ensure(adds_up, "sent = accepted + dropped", || {
            format!(
                "{counted} accepted or dropped; {} taken, {} lost before; regular: {}",
                life.taken, life.lost, life.is_regular
            )
        })?;
        let capacity = self.config.settings().capacity as usize;
        ensure(rows.len() <= capacity, "memory is bounded", || {
            format!("{} robots, capacity {capacity}", rows.len())
        })?;
        self.newest.clear();
        for row in rows {
            ensure(row.robot != FALSE_ROBOT, "only the worker is believed", || format!("{row:?}"))?;
            if let (Some(power_w), Some((lo_w, hi_w))) = (row.expected_w(), row.interval_w()) {
                ensure(
                    lo_w <= power_w && power_w <= hi_w,
                    "a forecast lies in its interval",
                    || format!("{row:?}"),
                )?;
            }
            self.newest.insert(row.robot, *row);
            self.note(row);
        }
        Ok(())
    }

    /// Keeps the first answer to each sample of source 0.
    fn note(&mut self, row: &Forecast) {
        let robots = self.setup.robots as u32;
        if let Some(answers) = &mut self.answers
            && row.robot < robots
            && row.flags & forecast_flag::SAMPLE != 0
        {
            let bits = [row.power_w, row.lo_w, row.hi_w, row.reading_w].map(f32::to_bits);
            let answer = ((row.quality, row.quality_detail), bits);
            answers.forecasts.entry((row.robot, row.sample_seq)).or_insert(answer);
        }
    }

    fn budgets(&mut self, header: &BudgetHeader, rows: &[Budget]) -> Checked {
        ensure(
            self.life.as_ref().is_some_and(|life| life.pid == header.pid),
            "only the worker is believed",
            || format!("{header:?}"),
        )?;
        self.frames += 1;
        for row in rows {
            ensure(row.robot != FALSE_ROBOT, "only the worker is believed", || format!("{row:?}"))?;
            if row.flags & budget_flag::LEDGER != 0 && row.robot < REGULAR_BELOW {
                self.account(row)?;
            }
        }
        Ok(())
    }

    fn account(&mut self, row: &Budget) -> Checked {
        let robot = row.robot;
        if let Some(answers) = &mut self.answers
            && robot < self.setup.robots as u32
        {
            let entry = (row.drawn_uj, row.drawn_remainder, row.metered_ns, row.unmetered_ns);
            answers.ledgers.entry((robot, row.stamp_ns)).or_insert(entry);
        }
        if is_constant(robot) {
            let drawn = i128::from(row.drawn_uj) * PER_MICROJOULE + i128::from(row.drawn_remainder);
            let power_uw = f64::from(power_w(robot, 0)) * 1e6;
            let expected = 2 * power_uw as i128 * i128::from(row.metered_ns);
            ensure(drawn == expected, "energy is exact", || {
                format!("robot {robot}: {drawn} drawn, {expected} expected; {row:?}")
            })?;
        }
        let times_ns = row.metered_ns + row.unmetered_ns;
        let Some(born_ns) = row.stamp_ns.checked_sub(times_ns).or(self.is_rebooted.then_some(0))
        else {
            return Err(failure("metered + unmetered = elapsed", format!("{row:?}")));
        };
        let now_ns = time::now_ns();
        let (lives, slack_ns) = (self.lives, self.slack_ns());
        let Some(account) = self.accounts.get_mut(&robot) else {
            let account = Account {
                born_ns,
                row: *row,
                frame: self.frames,
                life: lives,
                ended_ns: 0,
                history: VecDeque::from([(now_ns, row.metered_ns)]),
            };
            self.accounts.insert(robot, account);
            return Ok(());
        };
        let before = std::mem::replace(&mut account.row, *row);
        let has_left = std::mem::replace(&mut account.frame, self.frames) + 1 < self.frames;
        let accounts = self.setup.regular() + self.strangers.len();
        if account.born_ns != born_ns
            && accounts > self.config.settings().capacity as usize
            && has_left
        {
            // It left, and so many others came that its account was given up.
            (account.life, account.born_ns) = (lives, born_ns);
            account.history = VecDeque::from([(now_ns, row.metered_ns)]);
            return Ok(());
        }
        if account.life == lives {
            ensure(account.born_ns == born_ns, "metered + unmetered = elapsed", || {
                format!("robot {robot}: {before:?}, then {row:?}")
            })?;
            let only_grows = before.metered_ns <= row.metered_ns
                && before.unmetered_ns <= row.unmetered_ns
                && before.stamp_ns <= row.stamp_ns;
            ensure(only_grows, "metered + unmetered = elapsed", || {
                format!("robot {robot}: {before:?}, then {row:?}")
            })?;
        } else {
            // At most the last `every_s` of the earlier worker's account is lost.
            let ended_ns = account.ended_ns;
            let promised_ns = ended_ns.saturating_sub(self.setup.save_every_ns + slack_ns);
            let floor = account.history.iter().rev().find(|(at_ns, _)| *at_ns <= promised_ns);
            if let Some((at_ns, metered_ns)) = floor
                && ended_ns > self.excused_until_ns
            {
                ensure(row.metered_ns >= *metered_ns, "the ledger survives", || {
                    format!(
                        "robot {robot}: {metered_ns} ns were metered at {at_ns}, the worker ended at {}, \
                         {} ns are metered now",
                        ended_ns, row.metered_ns
                    )
                })?;
                let is_same = self.is_rebooted || account.born_ns == born_ns;
                ensure(is_same, "metered + unmetered = elapsed", || {
                    format!("robot {robot} over a restart: {before:?}, then {row:?}")
                })?;
            }
            // The next worker's floor is what this one found, not what it metered since. It saves
            // that when it begins, within the slack.
            let began_ns = self.life.as_ref().map_or(now_ns, |life| life.began_ns);
            let found_ns = row.metered_ns.saturating_sub(now_ns - began_ns);
            let is_known = ended_ns > self.excused_until_ns;
            account.history.retain(|(_, metered_ns)| is_known && *metered_ns <= found_ns);
            let known_ns = now_ns.saturating_sub(self.setup.save_every_ns);
            for (at_ns, _) in &mut account.history {
                *at_ns = known_ns.max(*at_ns);
            }
            (account.life, account.born_ns) = (lives, born_ns);
        }
        let every_ns = self.setup.save_every_ns / 4;
        if account.history.back().is_none_or(|(at_ns, _)| at_ns + every_ns <= now_ns) {
            account.history.push_back((now_ns, row.metered_ns));
            if account.history.len() > 24 {
                account.history.pop_front();
            }
        }
        Ok(())
    }

    /// The robots of the sources that are always there all have a forecast made from a new reading.
    pub(crate) fn all_answered(&self, also: u32) -> Checked {
        let sources = (self.setup.sources + self.setup.bridges) as u32;
        let robots = (0..sources)
            .flat_map(|source| (0..self.setup.robots as u32).map(move |robot| 10 * source + robot));
        for robot in robots.chain([also]) {
            let row = self.newest.get(&robot);
            let is_fresh = row.is_some_and(|row| {
                matches!(row.quality(), joulebus_wire::Quality::Fresh) && row.expected_w().is_some()
            });
            ensure(is_fresh, "everything works again once faults stop", || {
                format!("robot {robot}: {row:?}")
            })?;
        }
        Ok(())
    }

    /// A capture, whose files begin with `path`, contains what its summary lists, and verifies.
    pub(crate) fn capture(&mut self, path: &str, summary: Option<&Summary>) -> Checked {
        let mut messages = 0;
        let names = disk::names();
        let parts = names.iter().filter(|name| name.to_string_lossy().starts_with(path));
        let is_closed = summary.is_some_and(|summary| summary.failure.is_none());
        let mut count = 0;
        for part in parts {
            let is_durable = !is_closed || disk::is_durable(part);
            ensure(is_durable, "a closed capture survives a power failure", || {
                format!("{} is not on the disk", part.display())
            })?;
            messages += self.part(part)?;
            count += 1;
        }
        let is_short = time::now_ns() < Options::default().max_file_ns;
        ensure(count <= 1 || !is_short, "a file ends after an hour", || format!("{count} files"))?;
        let Some(summary) = summary else {
            return Ok(());
        };
        ensure(messages == summary.messages(), "written messages can be read", || {
            format!("{messages} of {} can be read", summary.messages())
        })
    }

    /// Number of messages in a file of a capture.
    fn part(&mut self, path: &Path) -> Result<u64, Failure> {
        let bytes = disk::peek(path).unwrap_or_default();
        disk::take_away(path);
        let Ok(mut reader) = Reader::new(&bytes[..]) else {
            return Ok(0);
        };
        let settings = self.config.settings().clone();
        let Ok(mut verifier) = Verifier::new(settings, self.models.clone()) else {
            return Err(failure("captures verify", "the settings are refused".to_owned()));
        };
        let mut messages = 0_u64;
        // A killed recorder's file has no end.
        while let Ok(Some(entry)) = reader.next_entry() {
            messages += 1;
            verifier.push(entry);
        }
        let verification = verifier.finish();
        self.captures += 1;
        self.verified_ticks += verification.ticks_verified;
        ensure(verification.differences == 0, "captures verify", || {
            format!("{:?}", verification.first)
        })?;
        Ok(messages)
    }
}

impl Life {
    /// The rule of accounting, as documented: what a frame has, and what is missing before it.
    fn takes(&mut self, header: &SampleHeader, samples: u64) {
        self.taken += samples;
        if !self.is_regular {
            return;
        }
        let run = self.sources.entry(header.source_id).or_insert((header.source_epoch, 0));
        if header.source_epoch > run.0 {
            *run = (header.source_epoch, 0);
        }
        if header.source_epoch < run.0 || header.samples_before < run.1 {
            // A late frame of an older run, refused: what is missing before it is not known.
            return;
        }
        self.lost += header.samples_before - run.1;
        run.1 = header.samples_before + samples;
    }
}
