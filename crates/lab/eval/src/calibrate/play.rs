//! A recording through the fleet's core: which alarms it raises.

use joulebus_fleet::Fleet;
use joulebus_predictor::Model;
use joulebus_settings::{AlarmLimits, FleetSettings, SettingsError};
use joulebus_wire::{Alarm, AlarmSet, SCHEMA_VERSION, Sample, SampleHeader};

/// Limits: of noise, mismatch and level.
pub(super) const KINDS: usize = 3;

/// Id of the robot that is played.
pub(super) const ROBOT: u32 = 0;
/// Alarms that no limit of the residuals sets.
pub(super) const OTHERS: [Alarm; 3] = [Alarm::StuckSensor, Alarm::HeldTooLong, Alarm::OutOfRange];
/// Alarms with a limit, and the limit's index.
const LIMITED: [(Alarm, usize); 4] =
    [(Alarm::NoiseHigh, 0), (Alarm::ModelMismatch, 1), (Alarm::LevelHigh, 2), (Alarm::LevelLow, 2)];

/// A robot of the platform, alone in a fleet.
#[derive(Debug, Clone)]
pub(super) struct Robot {
    settings: FleetSettings,
    model: Model,
    /// Alarms that find a fault.
    finds: AlarmSet,
}

/// The alarms of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Played {
    /// Alarms that each limit raised.
    pub raised: [u64; KINDS],
    /// [`OTHERS`].
    pub others: [u64; OTHERS.len()],
    /// Time in which the residuals could raise an alarm, s: from their settling on.
    pub watched_s: f64,
    /// When a fault that began at the time asked for was found, ns. Nothing is played after it.
    pub found_ns: Option<u64>,
}

impl Robot {
    /// A robot of the platform number `platform` of the settings.
    pub(super) fn new(settings: &FleetSettings, platform: usize, model: &Model) -> Self {
        let mut own = settings.platforms[platform].clone();
        own.robots = vec![ROBOT..=ROBOT];
        let finds = LIMITED.into_iter().map(|(alarm, _)| alarm).chain(OTHERS);
        Self {
            settings: FleetSettings { capacity: 1, platforms: vec![own], ..settings.clone() },
            model: model.clone(),
            finds: finds.fold(AlarmSet::default(), AlarmSet::with),
        }
    }

    /// The limits that the config has.
    pub(super) fn limits(&self) -> AlarmLimits {
        self.settings.alarms.of(&self.settings.platforms[0]).limits()
    }

    pub(super) const fn settle_samples(&self) -> usize {
        self.settings.alarms.settle_samples as usize
    }

    /// The same robot with other limits.
    pub(super) fn limited(&self, limits: AlarmLimits) -> Self {
        let mut robot = self.clone();
        robot.settings.platforms[0].alarms = Some(limits);
        robot
    }

    /// Plays samples, each in a tick of its own: all of them, or until a fault that begins at
    /// `fault_ns` is found.
    pub(super) fn play(
        &self,
        samples: &[Sample],
        fault_ns: Option<u64>,
    ) -> Result<Played, SettingsError> {
        let mut fleet = Fleet::new(self.settings.clone(), vec![self.model.clone()])?;
        let settles = u64::from(self.settings.alarms.settle_samples);
        let longest_ns = self.settings.platforms[0].stale_after_ns;
        let (mut played, mut before, mut last_ns) = (Played::default(), AlarmSet::default(), 0);
        for (frame, sample) in samples.iter().enumerate() {
            let now_ns = sample.stamp_ns;
            step(&mut fleet, frame as u64, sample);
            if fleet.is_empty() {
                continue;
            }
            let raised = fleet.diagnostic(0).alarms();
            let new = AlarmSet(raised.0 & !before.0);
            played.count(new);
            if fault_ns.is_some_and(|from_ns| now_ns >= from_ns) && new.0 & self.finds.0 != 0 {
                played.found_ns = Some(now_ns);
                break;
            }
            let scores = fleet.scores(ROBOT);
            let elapsed_ns = now_ns.saturating_sub(last_ns);
            if scores.is_some_and(|scores| scores.count >= settles) && elapsed_ns <= longest_ns {
                played.watched_s += elapsed_ns as f64 * 1e-9;
            }
            (before, last_ns) = (raised, now_ns);
        }
        Ok(played)
    }
}

impl Played {
    fn count(&mut self, new: AlarmSet) {
        if new.0 == 0 {
            return;
        }
        for (alarm, kind) in LIMITED {
            self.raised[kind] += u64::from(new.has(alarm));
        }
        for (count, alarm) in self.others.iter_mut().zip(OTHERS) {
            *count += u64::from(new.has(alarm));
        }
    }
}

/// A tick with one sample, at its time.
fn step(fleet: &mut Fleet, frame: u64, sample: &Sample) {
    let now_ns = sample.stamp_ns;
    let header = SampleHeader {
        schema: SCHEMA_VERSION,
        source_id: 1,
        source_epoch: 1,
        frame_seq: frame,
        samples_before: frame,
        intended_ns: now_ns,
        sent_ns: now_ns,
        ..SampleHeader::default()
    };
    fleet.take(&header, std::slice::from_ref(sample), now_ns);
    fleet.tick(now_ns, false);
}
