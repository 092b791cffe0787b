//! The fleet's state, and the tick.

mod intake;

use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_predictor::{Model, SimdLevel};
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_wire::{
    Budget, Diagnostic, DropCounts, DropReason, Forecast, Refusal, SCHEMA_VERSION, Sample,
    SampleHeader,
};
use serde::{Deserialize, Serialize};

use crate::estimate::mixture::Learned;
use crate::estimate::scores::Scores;
use crate::ingest::refused::Refused;
use crate::ingest::sources::Sources;
use crate::layout::index::Index;
use crate::layout::lanes::{self, LANES};
use crate::layout::slots::WORD;
use crate::ledger::departed::{self, Departed};
use crate::ledger::energy::Ledger;
use crate::state::columns::{Columns, ColumnsMut};
use crate::tick::batch::Batch;
use crate::tick::features::{self, Rules};
use crate::tick::platform_context::{PlatformContext, ranges};
use crate::tick::score::Account;
use crate::tick::shard::{Outputs, Shard};
use crate::tick::write::{Budgets, Diagnostics, Forecasts, Seen};

/// The state of all robots, in columns indexed by slot, and everything one tick needs.
///
/// All memory is taken in [`Fleet::new`], for the configured capacity.
#[derive(Debug)]
pub struct Fleet {
    pub(crate) settings: FleetSettings,
    pub(crate) settings_hash: u64,
    pub(crate) contexts: Vec<PlatformContext>,
    /// That of the first platform's model.
    simd_level: SimdLevel,
    /// Ranges of robot ids, ascending, with the platform they belong to.
    pub(crate) ranges: Vec<(u32, u32, u16)>,
    pub(crate) columns: Columns,
    pub(crate) slot_of: Index,
    pub(crate) departed: Departed,
    /// Slot that the next sample is probably of: sources name their robots in the same order.
    pub(crate) guess: usize,
    /// For the samples that cannot wait for the tick.
    single: Batch,
    /// For a tick on one thread.
    batch: Batch,
    pub(crate) sources: Sources,
    pub(crate) refused: Refused,
    pub(crate) drops: DropCounts,
    pub(crate) accepted: u64,
    /// Robots heard of in this tick.
    pub(crate) reported: usize,
    pub(crate) intake: TickIntake,
    pub(crate) now_ns: u64,
    pub(crate) deadline_missed: bool,
    /// No robot's last sample was taken before this, monotonic ns.
    pub(crate) oldest_ns: AtomicU64,
}

/// What one tick took in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TickIntake {
    /// Frames taken.
    pub frames: u32,
    /// When the first of them was meant to be sent, was sent, and was taken, monotonic ns.
    pub first: Option<(u64, u64, u64)>,
}

/// A frame that is being taken in.
#[derive(Debug, Clone, Copy)]
pub struct FrameIntake {
    header: SampleHeader,
    now_ns: u64,
    /// Whether its samples may be looked at.
    admitted: Result<(), DropReason>,
}

impl Fleet {
    /// A fleet without robots; `models[i]` is the model of `settings.platforms[i]`.
    ///
    /// # Errors
    /// When the settings contradict themselves ([`FleetSettings::check`]) or the models do not match.
    pub fn new(settings: FleetSettings, models: Vec<Model>) -> Result<Self, SettingsError> {
        settings.check()?;
        let platforms = settings.platforms.clone();
        if platforms.len() != models.len() {
            return Err(SettingsError::Models {
                platforms: platforms.len(),
                models: models.len(),
            });
        }
        let contexts: Vec<PlatformContext> = platforms
            .into_iter()
            .zip(models)
            .map(|(platform, model)| PlatformContext::new(platform, model, &settings))
            .collect();
        let capacity = settings.capacity as usize;
        let simd_level = contexts
            .first()
            .map_or_else(SimdLevel::best, |context| context.model.simd_level());
        Ok(Self {
            simd_level,
            ranges: ranges(&contexts),
            columns: Columns::new(capacity, &contexts),
            settings_hash: settings.fingerprint(),
            slot_of: Index::new(settings.capacity),
            departed: Departed::new(settings.capacity),
            guess: 0,
            single: Batch::of_slots(WORD),
            batch: Batch::default(),
            sources: Sources::new(settings.intake.max_sources),
            refused: Refused::default(),
            drops: DropCounts::default(),
            accepted: 0,
            reported: 0,
            intake: TickIntake::default(),
            now_ns: 0,
            deadline_missed: false,
            oldest_ns: AtomicU64::new(u64::MAX),
            contexts,
            settings,
        })
    }

    /// Goes on with the account of a robot that an earlier run wrote down. Call before the robot's
    /// first sample. `charged`: it has been on its charger since, so that what is in its battery is
    /// not known. As many accounts as the capacity are kept; returns whether this one was.
    pub fn restore(&mut self, robot: u32, ledger: Ledger, charged: bool) -> bool {
        self.departed.keep(departed::Account {
            robot,
            charged,
            ledger,
        })
    }

    /// Takes a frame of samples, in the order in which they were sent; `now_ns` is the worker's
    /// monotonic time. What is refused is counted, named, and harms no other robot.
    pub fn take(&mut self, header: &SampleHeader, samples: &[Sample], now_ns: u64) {
        let frame = self.begin_frame(header, samples.len() as u64, now_ns);
        self.take_part(&frame, samples);
    }

    /// Begins a frame of `count` samples that are [taken](Fleet::take_part) in parts, in their
    /// order, all before the next frame or tick. The same as [`Fleet::take`] of the whole frame.
    pub fn begin_frame(&mut self, header: &SampleHeader, count: u64, now_ns: u64) -> FrameIntake {
        self.intake.frames += 1;
        self.intake
            .first
            .get_or_insert((header.intended_ns, header.sent_ns, now_ns));
        let admitted = if header.schema == SCHEMA_VERSION {
            self.sources.frame(header, count, &mut self.drops)
        } else {
            self.drops.add(DropReason::Schema, count);
            Err(DropReason::Schema)
        };
        FrameIntake {
            header: *header,
            now_ns,
            admitted,
        }
    }

    /// Takes the next samples of a frame.
    pub fn take_part(&mut self, frame: &FrameIntake, samples: &[Sample]) {
        let FrameIntake {
            header,
            now_ns,
            admitted,
        } = frame;
        match admitted {
            Ok(()) => {
                for sample in samples {
                    match self.accept(header, sample, *now_ns) {
                        Ok(()) => self.accepted += 1,
                        Err(reason) => self.refuse(header, sample, reason),
                    }
                }
                self.oldest_ns.fetch_min(*now_ns, Ordering::Relaxed);
            }
            // Nothing in it can be relied on, not even the names of the robots; it is counted.
            Err(DropReason::Schema) => {}
            Err(reason) => {
                for sample in samples {
                    self.refuse(header, sample, *reason);
                }
            }
        }
    }

    /// Whether every robot whose next sample is due at `now_ns` has reported since the last tick.
    #[must_use]
    pub fn complete(&self, now_ns: u64) -> bool {
        self.reported == self.len()
            || self.columns.slots.iter().all(|slot| {
                let admission = &self.columns.admissions[slot];
                let platform = &self.contexts[usize::from(admission.platform)].platform;
                let silent_ns = now_ns.saturating_sub(admission.taken_ns);
                let due = silent_ns > platform.period_ns * 3 / 4;
                admission.heard || !due || silent_ns > platform.stale_after_ns
            })
    }

    /// What the tick in preparation has taken so far.
    #[must_use]
    pub fn intake(&self) -> TickIntake {
        self.intake
    }

    /// Computes: residuals, ledgers, windows, forecasts, intervals, alarms. `deadline_missed` says
    /// that the tick before this one was late or skipped others. Returns what was taken in.
    ///
    /// The same as [`Fleet::begin`] and a [`Share`] of all robots, with nothing written out: ask
    /// for [forecasts](Fleet::forecast), [diagnostics](Fleet::diagnostic) and
    /// [budgets](Fleet::budget) afterwards.
    pub fn tick(&mut self, now_ns: u64, deadline_missed: bool) -> TickIntake {
        let intake = self.begin(now_ns, deadline_missed);
        let nothing = Outputs {
            forecasts: &mut [],
            diagnostics: &mut [],
            budgets: &mut [],
        };
        let (mut shard, batch) = self.share_and_batch();
        shard.run(batch, nothing, &mut |_| {});
        intake
    }

    /// Begins a tick: robots that have been silent for too long leave, and what is left is
    /// [`Fleet::len`] robots to be ticked as a [`Fleet::share`], once. Returns what was taken in.
    pub fn begin(&mut self, now_ns: u64, deadline_missed: bool) -> TickIntake {
        self.now_ns = now_ns;
        self.deadline_missed = deadline_missed;
        let silent_ns = now_ns.saturating_sub(*self.oldest_ns.get_mut());
        if silent_ns > self.settings.intake.leave_after_ns {
            self.release_departed();
        }
        *self.oldest_ns.get_mut() = u64::MAX;
        self.reported = 0;
        std::mem::take(&mut self.intake)
    }

    /// All robots, to be ticked on one thread or split among several. Between [`Fleet::begin`] and
    /// the next [`Fleet::take`], all of it has to be ticked.
    pub fn shard(&mut self) -> Shard<'_> {
        self.share_and_batch().0
    }

    fn share_and_batch(&mut self) -> (Shard<'_>, &mut Batch) {
        let shard = Shard {
            rules: Rules {
                settings: &self.settings,
                contexts: &self.contexts,
                simd_level: self.simd_level,
                now_ns: self.now_ns,
                deadline_missed: self.deadline_missed,
            },
            columns: self.columns.view_mut(),
            oldest_ns: &self.oldest_ns,
        };
        (shard, &mut self.batch)
    }

    /// Robots in the fleet: the length of every frame that is written out.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.slots.used()
    }

    /// Whether no robot has been heard of.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
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

    /// Robots refused of late, with the reason and the source.
    #[must_use]
    pub fn refusals(&self) -> [Refusal; 16] {
        self.refused.places()
    }

    /// Hash over the models of all platforms, in order.
    #[must_use]
    pub fn model_hash(&self) -> u64 {
        self.contexts
            .iter()
            .fold(0xcbf2_9ce4_8422_2325, |hash, context| {
                (hash ^ context.model.hash())
                    .wrapping_mul(0x0000_0100_0000_01b3)
                    .rotate_left(23)
            })
    }

    /// Scores of a robot, if it is in the fleet.
    #[must_use]
    pub fn scores(&self, robot: u32) -> Option<Scores> {
        let slot = self.find(robot)?;
        Some(lanes::get(&self.columns.scores, slot))
    }

    /// What a robot's forecast has learned from its readings; `None` for a robot that is not in the
    /// fleet, or whose platform learns nothing online.
    #[must_use]
    pub fn learned(&self, robot: u32) -> Option<Learned> {
        let slot = self.find(robot)?;
        let context = usize::from(self.columns.admissions[slot].platform);
        let blending = self.contexts[context].blending.as_ref()?;
        Some(self.columns.blends[slot].learned(blending))
    }

    /// Account of a robot, in the fleet or departed.
    #[must_use]
    pub fn ledger(&self, robot: u32) -> Option<Ledger> {
        let live = self.find(robot);
        let live = live.map(|slot| lanes::get(&self.columns.ledgers, slot));
        live.or_else(|| self.departed.ledger(robot).copied())
    }

    /// The forecast of the robot at `place` (0 to [`Fleet::len`] − 1), as of the last tick. A
    /// [`Share`] writes those of all robots faster.
    #[must_use]
    pub fn forecast(&self, place: usize) -> Forecast {
        let (seen, lane) = self.seen(place);
        Forecasts::of(seen).get(&self.rules(), lane)
    }

    /// The diagnostics of the robot at `place`, as of the last tick.
    #[must_use]
    pub fn diagnostic(&self, place: usize) -> Diagnostic {
        let (seen, lane) = self.seen(place);
        Diagnostics::of(seen).get(&self.rules(), lane)
    }

    /// The budget of the robot at `place`, as of the last tick.
    #[must_use]
    pub fn budget(&self, place: usize) -> Budget {
        let (seen, lane) = self.seen(place);
        Budgets::of(&self.rules(), seen).get(&self.rules(), lane)
    }

    /// The slot of a robot that is in the fleet.
    pub(crate) fn find(&self, robot: u32) -> Option<usize> {
        let found = self
            .slot_of
            .find(robot, |slot| self.columns.admissions[slot as usize].id);
        found.map(|slot| slot as usize)
    }

    pub(crate) fn rules(&self) -> Rules<'_> {
        Rules {
            settings: &self.settings,
            contexts: &self.contexts,
            simd_level: self.simd_level,
            now_ns: self.now_ns,
            deadline_missed: self.deadline_missed,
        }
    }

    /// The block that the robot at a place lies in, and its lane.
    fn seen(&self, place: usize) -> (Seen<'_>, usize) {
        let slot = self.columns.slots.at(place);
        let slot = slot.expect("a place is below the number of robots");
        (self.columns.seen(slot / LANES), slot % LANES)
    }

    /// Takes the waiting sample of one robot at once, because another of it has come.
    pub(crate) fn catch_up(&mut self, slot: usize) {
        let rules = Rules {
            settings: &self.settings,
            contexts: &self.contexts,
            simd_level: self.simd_level,
            now_ns: self.now_ns,
            deadline_missed: self.deadline_missed,
        };
        let alone = [1 << (slot % WORD)];
        let (_, from) = self.columns.view_mut().split(slot / WORD);
        let mut columns = ColumnsMut {
            words: &alone,
            ..from.split(1).0
        };
        let context = columns.admissions[slot % WORD].platform;
        features::absorb(&rules, context, &mut columns, &mut self.single, false);
        let its = &rules.contexts[usize::from(context)];
        features::infer(its, &mut columns, &mut self.single);
        rules.simd_level.run(Account {
            rules: &rules,
            columns: &mut columns,
        });
    }

    /// Frees the slots of robots that have been silent for too long; their accounts are kept.
    fn release_departed(&mut self) {
        let leave_after_ns = self.settings.intake.leave_after_ns;
        for slot in 0..self.columns.admissions.len() {
            let admission = &self.columns.admissions[slot];
            let silent_ns = self.now_ns.saturating_sub(admission.taken_ns);
            if !admission.present || silent_ns <= leave_after_ns {
                continue;
            }
            self.catch_up(slot);
            let admission = &mut self.columns.admissions[slot];
            admission.present = false;
            admission.generation = admission.generation.wrapping_add(1);
            let (robot, charged) = (admission.id, admission.charged);
            let admissions = &self.columns.admissions;
            self.slot_of
                .remove(robot, |slot| admissions[slot as usize].id);
            self.columns.slots.free(slot);
            self.departed.keep(departed::Account {
                robot,
                charged,
                ledger: lanes::get(&self.columns.ledgers, slot),
            });
        }
    }
}
