//! The fleet: takes samples, ticks, and returns results per robot.

mod intake;
mod membership;
pub(crate) mod online_forecasts;
pub(crate) mod outputs;
mod snapshot;

use std::sync::atomic::AtomicU64;

use joulebus_energy::{EnergyModel, EnergyState};
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_wire::{
    Budget, Diagnostic, DropCounts, Forecast, ForecastHeader, LISTED_MODELS, Outlook, PlanState,
    PlatformMemory, Refusal, combine_hashes, platform_flag,
};

use crate::estimate::online::Learned;
use crate::estimate::scores::Scores;
use crate::ingest::frame::TickIntake;
use crate::ingest::refused::{RefusalLog, Refused};
use crate::ingest::sources::Sources;
use crate::layout::index::Index;
use crate::layout::lanes::{self, LANES};
use crate::layout::slots::{Slots, WORD};
use crate::ledger::departed::Departed;
use crate::ledger::energy::Ledger;
use crate::state::columns::{BlockRef, Columns, ColumnsMut, Needed};
use crate::tick::batch::Batch;
use crate::tick::context::TickContext;
use crate::tick::features::build_rows;
use crate::tick::infer::infer;
use crate::tick::outputs::Outputs;
use crate::tick::score::Score;
use crate::tick::shard::Shard;
use crate::tick::write::budgets::BudgetRows;
use crate::tick::write::diagnostics::DiagnosticRows;
use crate::tick::write::flag::flag;
use crate::tick::write::forecasts::ForecastRows;
use crate::tick::write::learned::LearnedLanes;
use crate::tick::write::outlooks::OutlookRows;
use crate::tick::write::plan_states::PlanStateRows;

/// The state of all robots, in columns indexed by slot, and everything one tick needs.
///
/// All memory is allocated in [`Fleet::new`], for the configured capacity.
#[derive(Debug)]
pub struct Fleet {
    /// Inputs of a tick: settings, platforms with their models, and the time.
    tick: TickContext,
    settings_hash: u64,
    /// Ranges of robot ids, ascending, with their platform.
    ranges: Vec<(u32, u32, u16)>,
    columns: Columns,
    /// The slots in use.
    slots: Slots,
    slot_of: Index,
    departed: Departed,
    /// Expected slot of the next sample: sources list their robots in the same order.
    likely_slot: usize,
    /// For samples that are processed before the tick.
    single: Batch,
    /// For a tick on one thread.
    batch: Batch,
    sources: Sources,
    refused: Refused,
    refusal_log: RefusalLog,
    drops: DropCounts,
    accepted: u64,
    /// Robots that have reported in this tick.
    reported: usize,
    intake: TickIntake,
    /// Lower bound of the times at which the robots' last samples were taken, monotonic ns.
    oldest_ns: AtomicU64,
}

impl Fleet {
    /// A fleet without robots. `models[i]` is the model of `settings.platforms[i]`.
    ///
    /// # Errors
    /// The settings are inconsistent ([`FleetSettings::check`]) or the models do not match.
    pub fn new(settings: FleetSettings, models: Vec<Model>) -> Result<Self, SettingsError> {
        settings.check()?;
        let tick = TickContext::new(settings, models)?;
        let settings = &tick.settings;
        let needed = Needed {
            online: tick.platforms.iter().any(|platform| platform.members.is_some()),
            batteries: settings.has_batteries(),
            levels: true,
        };
        let capacity = settings.capacity as usize;
        Ok(Self {
            settings_hash: settings.fingerprint(),
            ranges: tick.robot_ranges(),
            columns: Columns::new(capacity.next_multiple_of(LANES), needed),
            slots: Slots::new(capacity, tick.platforms.len()),
            slot_of: Index::new(settings.capacity),
            departed: Departed::new(settings.capacity, needed.batteries),
            likely_slot: 0,
            single: Batch::of_slots(WORD),
            batch: Batch::default(),
            sources: Sources::new(settings),
            refused: Refused::default(),
            refusal_log: RefusalLog::default(),
            drops: DropCounts::default(),
            accepted: 0,
            reported: 0,
            intake: TickIntake::default(),
            oldest_ns: AtomicU64::new(u64::MAX),
            tick,
        })
    }

    /// True if every robot whose next sample is due at `now_ns` has reported since the last tick.
    pub fn complete(&self, now_ns: u64) -> bool {
        self.reported == self.len()
            || self.slots.iter().all(|slot| {
                let admission = &self.columns.admissions[slot];
                let platform = &self.tick.platforms[usize::from(admission.platform)].platform;
                let silent_ns = now_ns.saturating_sub(admission.taken_ns);
                let due = silent_ns > platform.period_ns * 3 / 4;
                admission.reported || !due || silent_ns > platform.stale_after_ns
            })
    }

    /// Intake of the tick in preparation so far.
    pub fn intake(&self) -> TickIntake {
        self.intake
    }

    /// Computes: residuals, ledgers, windows, forecasts, intervals, alarms. `deadline_missed`: the
    /// tick before this one was late or skipped others. Returns the intake.
    ///
    /// The same as [`Fleet::begin`] and a [`Shard`] of all robots, without output: read
    /// [forecasts](Fleet::forecast), [diagnostics](Fleet::diagnostic) and [budgets](Fleet::budget)
    /// afterwards.
    pub fn tick(&mut self, now_ns: u64, deadline_missed: bool) -> TickIntake {
        let intake = self.begin(now_ns, deadline_missed);
        let (mut shard, batch) = self.shard_and_batch();
        shard.run(batch, Outputs::default(), &mut |_| {});
        intake
    }

    /// Begins a tick: robots that have been silent for too long leave, and the remaining
    /// [`Fleet::len`] robots have to be ticked as a [`Fleet::shard`], once. Returns the intake.
    pub fn begin(&mut self, now_ns: u64, deadline_missed: bool) -> TickIntake {
        self.tick.now_ns = now_ns;
        self.tick.deadline_missed = deadline_missed;
        for context in &mut self.tick.platforms {
            context.errors.add_counted();
        }
        let silent_ns = now_ns.saturating_sub(*self.oldest_ns.get_mut());
        if silent_ns > self.tick.settings.intake.leave_after_ns {
            self.release_departed();
        }
        *self.oldest_ns.get_mut() = u64::MAX;
        self.reported = 0;
        std::mem::take(&mut self.intake)
    }

    /// All robots, to be ticked on one thread or split among several. Between [`Fleet::begin`] and
    /// the next [`Fleet::take`], all of them must be ticked.
    pub fn shard(&mut self) -> Shard<'_> {
        self.shard_and_batch().0
    }

    fn shard_and_batch(&mut self) -> (Shard<'_>, &mut Batch) {
        let shard = Shard {
            tick: &self.tick,
            columns: self.columns.view_mut(self.slots.words()),
            oldest_ns: &self.oldest_ns,
        };
        (shard, &mut self.batch)
    }

    /// Robots in the fleet: the length of every output frame.
    pub fn len(&self) -> usize {
        self.slots.used()
    }

    /// True if no robot is in the fleet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Maximum number of robots.
    pub fn capacity(&self) -> u32 {
        self.tick.settings.capacity
    }

    /// Samples accepted so far.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Samples dropped so far, by reason.
    pub fn drops(&self) -> DropCounts {
        self.drops
    }

    /// Number of accounts of departed robots that were given up for those of other robots. As many
    /// as the capacity are kept.
    pub fn accounts_given_up(&self) -> u64 {
        self.departed.given_up()
    }

    /// Recently refused robots, with the reason and the source.
    pub fn refusals(&self) -> [Refusal; 16] {
        self.refused.places()
    }

    /// The newest refusals by source, reason and robot. They begin with this value, and are no part
    /// of the [state](crate::FleetState).
    pub const fn refusal_log(&self) -> &RefusalLog {
        &self.refusal_log
    }

    /// Hash of the model of all platforms. If they use different models, a combination of their
    /// hashes in the order of the platforms.
    pub fn model_hash(&self) -> u64 {
        let platforms = self.tick.platforms.iter();
        combine_hashes(platforms.map(|context| context.model.hash()))
    }

    /// Hashes of the platforms' models, in their order. 0 beyond the last.
    pub fn model_hashes(&self) -> [u64; LISTED_MODELS] {
        let mut hashes = [0; LISTED_MODELS];
        for (hash, context) in hashes.iter_mut().zip(&self.tick.platforms) {
            *hash = context.model.hash();
        }
        hashes
    }

    /// What the robots of each platform have shown together. 0 beyond the last platform.
    pub fn platform_memories(&self) -> [PlatformMemory; LISTED_MODELS] {
        let mut memories = [PlatformMemory::default(); LISTED_MODELS];
        for (told, context) in memories.iter_mut().zip(&self.tick.platforms) {
            let (energy, memory) = (&context.energy, &context.errors.platform().memory);
            let trained = energy.calibrated > 0;
            let commands = trained & energy.command.reads_commands();
            *told = PlatformMemory {
                flags: flag(trained, platform_flag::TRAINED)
                    | flag(commands, platform_flag::COMMANDS)
                    | flag(memory.starts_from_last(), platform_flag::FROM_LAST),
                robots: memory.robots,
                drawn: memory.drawn,
                power: memory.power,
                command_trust: memory.command_trust,
                start_excess: memory.start_excess,
                scatter: f32::NAN,
                level: memory.level,
                spread: memory.spread,
            };
        }
        memories
    }

    /// Hash of the settings.
    pub const fn settings_hash(&self) -> u64 {
        self.settings_hash
    }

    /// Scores of a robot, if it is in the fleet.
    pub fn scores(&self, robot: u32) -> Option<Scores> {
        let slot = self.find(robot)?;
        Some(lanes::get(&self.columns.scores, slot))
    }

    /// State of a robot's online learning. `None` for a robot that is not in the fleet, or whose
    /// platform learns nothing online.
    pub fn learned(&self, robot: u32) -> Option<Learned> {
        let slot = self.find(robot)?;
        let platform = usize::from(self.columns.admissions[slot].platform);
        let members = self.tick.platforms[platform].members?;
        let online = lanes::get(&self.columns.online, slot);
        let weights = online.weights(members.sceptic_loss);
        Some(online.learned(&weights))
    }

    /// A robot's state for the energy of its plans, if it is in the fleet.
    pub fn energy(&self, robot: u32) -> Option<EnergyState> {
        let slot = self.find(robot)?;
        let platform = usize::from(self.columns.admissions[slot].platform);
        let errors = &self.tick.platforms[platform].errors;
        Some(self.columns.energy[slot / LANES].state(slot % LANES, errors))
    }

    /// The energy model of the platform at `index` of the settings. One [without
    /// training](EnergyModel::untrained) if its model has none.
    pub fn energy_model(&self, index: usize) -> Option<&EnergyModel> {
        Some(&self.tick.platforms.get(index)?.energy)
    }

    /// Account of a robot, in the fleet or departed.
    pub fn ledger(&self, robot: u32) -> Option<Ledger> {
        let live = self.find(robot);
        let live = live.map(|slot| lanes::get(&self.columns.ledgers, slot));
        live.or_else(|| self.departed.ledger(robot).copied())
    }

    /// The header of the forecasts of a tick that has taken `intake` and begun at `start_ns`, as far
    /// as samples and settings determine it.
    pub fn header(&self, intake: TickIntake, start_ns: u64) -> ForecastHeader {
        let (first_intended_ns, first_sent_ns, first_taken_ns) = intake.first.unwrap_or_default();
        ForecastHeader {
            model_hash: self.model_hash(),
            capacity: self.capacity(),
            frames_taken: intake.frames,
            first_intended_ns,
            first_sent_ns,
            first_taken_ns,
            compute_start_ns: start_ns,
            samples_accepted: self.accepted,
            samples_dropped: self.drops,
            ..ForecastHeader::default()
        }
    }

    /// The forecast of the robot at `place` (0 to [`Fleet::len`] − 1) in the last tick. A [`Shard`]
    /// writes those of all robots faster.
    pub fn forecast(&self, place: usize) -> Forecast {
        let (block, lane) = self.block_of(place);
        ForecastRows::new(block).get(&self.tick, lane)
    }

    /// The diagnostics of the robot at `place`, as of the last tick.
    pub fn diagnostic(&self, place: usize) -> Diagnostic {
        let (block, lane) = self.block_of(place);
        let learned = LearnedLanes::new(&self.tick, &block);
        DiagnosticRows::new(block, &learned).get(&self.tick, lane)
    }

    /// The budget of the robot at `place`, as of the last tick.
    pub fn budget(&self, place: usize) -> Budget {
        let (block, lane) = self.block_of(place);
        BudgetRows::new(&self.tick, block).get(&self.tick, lane)
    }

    /// The outlook of the robot at `place`, as of the last tick.
    pub fn outlook(&self, place: usize) -> Outlook {
        let (block, lane) = self.block_of(place);
        OutlookRows::new(&self.tick, block).get(&self.tick, lane, &self.budget(place))
    }

    /// The start of a plan of the robot at `place`, in the last tick.
    pub fn plan_state(&self, place: usize) -> PlanState {
        let (block, lane) = self.block_of(place);
        let learned = LearnedLanes::new(&self.tick, &block);
        PlanStateRows::new(block, &learned).get(&self.tick, lane)
    }

    /// The block of the robot at a place, and its lane.
    fn block_of(&self, place: usize) -> (BlockRef<'_>, usize) {
        let slot = self.slots.at(place);
        let slot = slot.expect("a place is below the number of robots");
        (self.columns.block(slot / LANES), slot % LANES)
    }

    /// Absorbs and scores the waiting sample of one robot at once, because the next one has
    /// arrived.
    fn catch_up(&mut self, slot: usize) {
        let tick = &self.tick;
        let alone = [1 << (slot % WORD)];
        let (_, from) = self.columns.view_mut(self.slots.words()).split(slot / WORD);
        let mut columns = ColumnsMut { words: &alone, ..from.split(1).0 };
        let platform = columns.admissions[slot % WORD].platform;
        build_rows(tick, platform, &mut columns, &mut self.single, false);
        let context = &tick.platforms[usize::from(platform)];
        infer(context, &mut columns, &mut self.single);
        tick.simd_level.run(Score { tick, columns: &mut columns });
    }
}
