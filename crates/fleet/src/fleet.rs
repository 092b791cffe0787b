//! The fleet's state, and the tick.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use joulebus_predictor::{Features, Model};
use joulebus_wire::{DropCounts, DropReason, SCHEMA_VERSION, Sample, SampleHeader};
use serde::{Deserialize, Serialize};

use crate::departed::{Account, Departed};
use crate::detector::Detector;
use crate::interval::Interval;
use crate::refused::Refused;
use crate::robot::{Pending, Robot};
use crate::sources::Sources;
use crate::window::Window;
use crate::{Ledger, Platform, Scores, Settings, SettingsError};

/// A robot in the fleet takes at most 512 bytes: these columns, two lists of slots, and up to 41
/// bytes in the map of ids. The account of one that has left takes up to 113 more.
const _: () = assert!(
    size_of::<Robot>()
        + size_of::<Window>()
        + size_of::<Ledger>()
        + size_of::<Interval>()
        + size_of::<Scores>()
        + size_of::<Detector>()
        + size_of::<Pending>()
        <= 512 - 2 * size_of::<u32>() - 41
);
const _: () = assert!(size_of::<Account>() <= 72);

/// Robots that go through a model together: their rows stay in the core's own cache.
pub(crate) const TILE: usize = 1024;

/// The state of all robots, in columns indexed by slot, and everything one tick needs.
///
/// All memory is taken in [`Fleet::new`], for the configured capacity.
#[derive(Debug)]
pub struct Fleet {
    pub(crate) settings: Settings,
    pub(crate) settings_hash: u64,
    pub(crate) kinds: Vec<Kind>,
    /// Ranges of robot ids, ascending, with the platform they belong to.
    pub(crate) ranges: Vec<(u32, u32, u16)>,

    pub(crate) robots: Vec<Robot>,
    pub(crate) windows: Vec<Window>,
    pub(crate) ledgers: Vec<Ledger>,
    pub(crate) intervals: Vec<Interval>,
    pub(crate) scores: Vec<Scores>,
    pub(crate) detectors: Vec<Detector>,
    /// The sample that waits for the next pass, where `waiting` names the slot.
    pub(crate) pending: Vec<Pending>,

    /// Slots in use, ascending in the order of joining.
    pub(crate) live: Vec<u32>,
    pub(crate) free: Vec<u32>,
    /// Slots that have ever been in use: all below.
    pub(crate) used: usize,
    pub(crate) slot_of: HashMap<u32, u32>,
    pub(crate) departed: Departed,
    /// Slot that the next sample is probably of: sources name their robots in the same order.
    pub(crate) guess: usize,

    pub(crate) batch: Batch,
    pub(crate) sources: Sources,
    pub(crate) refused: Refused,
    pub(crate) drops: DropCounts,
    pub(crate) accepted: u64,
    /// Robots heard of in this tick.
    pub(crate) reported: usize,
    pub(crate) intake: TickIntake,
    pub(crate) now_ns: u64,
    pub(crate) deadline_missed: bool,
}

/// What belongs to one platform.
#[derive(Debug)]
pub(crate) struct Kind {
    pub platform: Platform,
    pub model: Model,
    /// Standard deviation of the residuals in training, not below the monitor's resolution, W.
    pub sigma_w: f32,
    /// Sample periods that the model may run open loop.
    pub longest_steps: u16,
    /// Slots whose sample waits for the next pass.
    pub waiting: Vec<u32>,
}

/// Rows on their way through a model.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    pub slots: Vec<u32>,
    pub rows: Vec<Features>,
    pub forecasts_w: Vec<f32>,
}

/// What one tick took in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TickIntake {
    /// Frames taken.
    pub frames: u32,
    /// When the first of them was meant to be sent, was sent, and was taken, monotonic ns.
    pub first: Option<(u64, u64, u64)>,
}

impl Fleet {
    /// A fleet without robots; `models[i]` is the model of `settings.platforms[i]`.
    ///
    /// # Errors
    /// When the settings contradict themselves ([`Settings::check`]) or the models do not match.
    pub fn new(settings: Settings, models: Vec<Model>) -> Result<Self, SettingsError> {
        settings.check()?;
        let platforms = settings.platforms.clone();
        if platforms.len() != models.len() {
            return Err(SettingsError::Models {
                platforms: platforms.len(),
                models: models.len(),
            });
        }
        let capacity = settings.capacity as usize;
        let kinds: Vec<Kind> = platforms
            .into_iter()
            .zip(models)
            .map(|(platform, model)| Kind::new(platform, model, capacity))
            .collect();
        Ok(Self {
            ranges: ranges(&kinds),
            robots: vec![Robot::ABSENT; capacity],
            windows: vec![Window::EMPTY; capacity],
            ledgers: vec![Ledger::default(); capacity],
            intervals: vec![Interval::new(0.0, 0.0, 0.0, 0.0, 0.0); capacity],
            scores: vec![Scores::default(); capacity],
            detectors: vec![Detector::new(); capacity],
            pending: vec![Pending::default(); capacity],
            live: Vec::with_capacity(capacity),
            free: (0..settings.capacity).rev().collect(),
            used: 0,
            settings_hash: settings.fingerprint(),
            // Twice the capacity: the map then never grows, however often robots come and go.
            slot_of: HashMap::with_capacity(2 * capacity),
            departed: Departed::new(settings.capacity),
            guess: 0,
            batch: Batch::with_capacity(capacity.min(TILE)),
            sources: Sources::new(settings.intake.max_sources),
            refused: Refused::default(),
            drops: DropCounts::default(),
            accepted: 0,
            reported: 0,
            intake: TickIntake::default(),
            now_ns: 0,
            deadline_missed: false,
            kinds,
            settings,
        })
    }

    /// Goes on with the account of a robot that an earlier run wrote down. Call before the robot's
    /// first sample. `charged`: it has been on its charger since, so that what is in its battery is
    /// not known. As many accounts as the capacity are kept; returns whether this one was.
    pub fn restore(&mut self, robot: u32, ledger: Ledger, charged: bool) -> bool {
        self.departed.keep(Account {
            robot,
            charged,
            ledger,
        })
    }

    /// Takes a frame of samples, in the order in which they were sent; `now_ns` is the worker's
    /// monotonic time. What is refused is counted, named, and harms no other robot.
    pub fn take(&mut self, header: &SampleHeader, samples: &[Sample], now_ns: u64) {
        self.intake.frames += 1;
        self.intake
            .first
            .get_or_insert((header.intended_ns, header.sent_ns, now_ns));
        let count = samples.len() as u64;
        if header.schema != SCHEMA_VERSION {
            self.drops.add(DropReason::Schema, count);
            return;
        }
        if let Err(reason) = self.sources.frame(header, count, &mut self.drops) {
            for sample in samples {
                self.refuse(header, sample, reason);
            }
            return;
        }
        for sample in samples {
            match self.accept(header, sample, now_ns) {
                Ok(()) => self.accepted += 1,
                Err(reason) => self.refuse(header, sample, reason),
            }
        }
    }

    /// Whether every robot whose next sample is due at `now_ns` has reported since the last tick.
    #[must_use]
    pub fn complete(&self, now_ns: u64) -> bool {
        self.reported == self.live.len()
            || self.live.iter().all(|slot| {
                let robot = &self.robots[*slot as usize];
                let platform = &self.kinds[usize::from(robot.platform)].platform;
                let silent_ns = now_ns.saturating_sub(robot.taken_ns);
                let due = silent_ns > platform.period_ns * 3 / 4;
                robot.heard || !due || silent_ns > platform.stale_after_ns
            })
    }

    /// What the tick in preparation has taken so far.
    #[must_use]
    pub fn intake(&self) -> TickIntake {
        self.intake
    }

    /// Computes: residuals, ledgers, windows, forecasts, intervals, alarms. `deadline_missed` says
    /// that the tick before this one was late or skipped others. Returns what was taken in.
    pub fn tick(&mut self, now_ns: u64, deadline_missed: bool) -> TickIntake {
        self.now_ns = now_ns;
        self.deadline_missed = deadline_missed;
        for kind in 0..self.kinds.len() {
            self.pass(kind);
            self.run_open(kind);
        }
        self.release_departed();
        for slot in &self.live {
            let robot = &mut self.robots[*slot as usize];
            (robot.taken, robot.heard) = (0, false);
        }
        self.reported = 0;
        std::mem::take(&mut self.intake)
    }

    /// Robots in the fleet: the length of every frame that is written out.
    #[must_use]
    pub fn len(&self) -> usize {
        self.live.len()
    }

    /// Whether no robot has been heard of.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.live.is_empty()
    }

    /// Robots that there is room for.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.settings.capacity
    }

    /// Samples accepted so far.
    #[must_use]
    pub fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Samples dropped so far, by reason.
    #[must_use]
    pub fn drops(&self) -> DropCounts {
        self.drops
    }

    /// Hash over the models of all platforms, in order.
    #[must_use]
    pub fn model_hash(&self) -> u64 {
        self.kinds.iter().fold(0xcbf2_9ce4_8422_2325, |hash, kind| {
            (hash ^ kind.model.hash())
                .wrapping_mul(0x0000_0100_0000_01b3)
                .rotate_left(23)
        })
    }

    /// Scores of a robot, if it is in the fleet.
    #[must_use]
    pub fn scores(&self, robot: u32) -> Option<&Scores> {
        self.slot_of
            .get(&robot)
            .map(|slot| &self.scores[*slot as usize])
    }

    /// Account of a robot, in the fleet or departed.
    #[must_use]
    pub fn ledger(&self, robot: u32) -> Option<&Ledger> {
        let live = self
            .slot_of
            .get(&robot)
            .map(|slot| &self.ledgers[*slot as usize]);
        live.or_else(|| self.departed.ledger(robot))
    }

    /// Frees the slots of robots that have been silent for too long; their accounts are kept.
    fn release_departed(&mut self) {
        let leave_after_ns = self.settings.intake.leave_after_ns;
        let gone = |robot: &Robot| self.now_ns.saturating_sub(robot.taken_ns) > leave_after_ns;
        let Some(first) = self
            .live
            .iter()
            .position(|slot| gone(&self.robots[*slot as usize]))
        else {
            return;
        };
        let mut kept = first;
        for at in first..self.live.len() {
            let slot = self.live[at];
            let index = slot as usize;
            let robot = &mut self.robots[index];
            if self.now_ns.saturating_sub(robot.taken_ns) <= leave_after_ns {
                self.live[kept] = slot;
                kept += 1;
                continue;
            }
            robot.present = false;
            robot.generation = robot.generation.wrapping_add(1);
            let (id, charged) = (robot.id, robot.last.charged);
            self.slot_of.remove(&id);
            self.free.push(slot);
            self.departed.keep(Account {
                robot: id,
                charged,
                ledger: self.ledgers[index],
            });
        }
        self.live.truncate(kept);
    }
}

impl Kind {
    fn new(platform: Platform, model: Model, capacity: usize) -> Self {
        let ids =
            |range: &RangeInclusive<u32>| range.end().saturating_sub(*range.start()) as usize + 1;
        let most = platform.robots.iter().map(ids).sum::<usize>();
        let sigma_w = model.residual().std_w.max(platform.power_resolution_w);
        // `Settings::check` has bounded the quotient by 1000.
        let longest_steps = (platform.stale_after_ns / platform.period_ns) as u16;
        Self {
            platform,
            model,
            sigma_w,
            longest_steps,
            waiting: Vec::with_capacity(most.min(capacity)),
        }
    }
}

impl Batch {
    fn with_capacity(capacity: usize) -> Self {
        Self {
            slots: Vec::with_capacity(capacity),
            rows: Vec::with_capacity(capacity),
            forecasts_w: vec![0.0; capacity],
        }
    }

    pub(crate) fn clear(&mut self) {
        self.slots.clear();
        self.rows.clear();
    }

    pub(crate) fn push(&mut self, slot: u32, row: Features) {
        self.slots.push(slot);
        self.rows.push(row);
    }

    /// Runs the rows through the model; gives each slot with its forecast, W.
    pub(crate) fn infer(&mut self, model: &Model) -> impl Iterator<Item = (usize, f32)> + '_ {
        let forecasts_w = &mut self.forecasts_w[..self.rows.len()];
        model.predict(&self.rows, forecasts_w);
        self.slots
            .iter()
            .map(|slot| *slot as usize)
            .zip(forecasts_w.iter().copied())
    }
}

fn ranges(kinds: &[Kind]) -> Vec<(u32, u32, u16)> {
    let mut ranges: Vec<(u32, u32, u16)> = Vec::new();
    for (index, kind) in kinds.iter().enumerate() {
        let spans = kind
            .platform
            .robots
            .iter()
            .map(|range| (*range.start(), *range.end(), index as u16));
        ranges.extend(spans);
    }
    ranges.sort_unstable();
    ranges
}
