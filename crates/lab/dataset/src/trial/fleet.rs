//! Plays many trials at once, one robot each, in the order of time.

use joulebus_wire::{Sample, sample_flag};

use super::Trial;

/// Options for playing a [`TrialFleet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Playback {
    /// Monotonic time of every trial's first row, ns.
    pub base_ns: u64,
    /// Time from one frame to the next, ns, in the time of the trials. At least 1.
    pub frame_period_ns: u64,
    /// True if a trial restarts when it has ended, each after its own length.
    pub repeat: bool,
}

/// Errors of [`TrialFleet`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum TrialFleetError {
    #[error("found no trial. A fleet needs one or more")]
    NoTrial,
    #[error("robot {robot} has more than one trial. Give each trial an id of its own")]
    DuplicateRobot { robot: u32 },
    #[error("found a frame period of 0 ns, allowed: 1 ns or more")]
    NoPeriod,
}

/// Many trials as one fleet: every sample once, in frames on a grid of the trials' own time.
///
/// Pure: time is an argument. Trial time 0 is the first row of every trial. A frame holds the
/// samples that have become due since the previous frame, ordered by robot and then by time. A
/// robot slower than the frame rate is not in every frame. Frames taken one by one, each at its
/// [`TrialFleet::next_due_ns`], do not depend on how fast they are taken:
///
/// ```no_run
/// # fn send(_: &[joulebus_wire::Sample]) {}
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use joulebus_dataset::trial::{Playback, Trial, TrialFleet};
/// let trials = vec![(100, Trial::read("a.npy")?), (101, Trial::read("b.csv.gz")?)];
/// let playback = Playback { base_ns: 0, frame_period_ns: 33_333_333, repeat: false };
/// let mut fleet = TrialFleet::new(trials, playback)?;
/// let mut frame = Vec::new();
/// while let Some(due_ns) = fleet.next_due_ns() {
///     fleet.frame_into(due_ns, &mut frame);
///     send(&frame);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct TrialFleet {
    players: Vec<Player>,
    playback: Playback,
}

impl TrialFleet {
    /// Trials with the ids of their robots.
    ///
    /// # Errors
    /// [`TrialFleetError`]: no trial, a repeated id, or a frame period of 0.
    pub fn new(trials: Vec<(u32, Trial)>, playback: Playback) -> Result<Self, TrialFleetError> {
        if trials.is_empty() {
            return Err(TrialFleetError::NoTrial);
        }
        if playback.frame_period_ns == 0 {
            return Err(TrialFleetError::NoPeriod);
        }
        let mut players = trials
            .into_iter()
            .map(|(robot, trial)| Player::new(robot, &trial, playback))
            .collect::<Vec<_>>();
        players.sort_by_key(|player| player.robot);
        if let Some(pair) = players.windows(2).find(|pair| pair[0].robot == pair[1].robot) {
            let robot = pair[0].robot;
            return Err(TrialFleetError::DuplicateRobot { robot });
        }
        Ok(Self { players, playback })
    }

    /// Ids of the robots, ascending.
    pub fn robots(&self) -> impl Iterator<Item = u32> + '_ {
        self.players.iter().map(|player| player.robot)
    }

    /// When the next non-empty frame is due, in trial time, ns. `None` at the end, which
    /// [`Playback::repeat`] never reaches.
    pub fn next_due_ns(&self) -> Option<u64> {
        let due_ns = self.players.iter().filter_map(Player::due_ns).min()?;
        let trial_ns = due_ns.saturating_sub(self.playback.base_ns);
        let period_ns = self.playback.frame_period_ns;
        Some(trial_ns.div_ceil(period_ns).saturating_mul(period_ns))
    }

    /// Replaces `frame` by every sample due by the trial time `now_ns` that was not taken before.
    /// Late frames are merged: to keep frames separate, call once for each
    /// [`TrialFleet::next_due_ns`] up to now.
    pub fn frame_into(&mut self, now_ns: u64, frame: &mut Vec<Sample>) {
        frame.clear();
        let until_ns = self.playback.base_ns.saturating_add(now_ns);
        for player in &mut self.players {
            player.take_until(until_ns, frame);
        }
    }
}

#[derive(Debug, Clone)]
struct Player {
    robot: u32,
    samples: Vec<Sample>,
    length_ns: u64,
    repeat: bool,
    pass: u64,
    next: usize,
}

impl Player {
    fn new(robot: u32, trial: &Trial, playback: Playback) -> Self {
        let samples = trial.to_samples(robot, playback.base_ns);
        let latest_ns = trial.offset_ns().iter().copied().max().unwrap_or_default();
        Self {
            robot,
            samples,
            length_ns: latest_ns.unsigned_abs().saturating_add(trial.period_ns()),
            repeat: playback.repeat,
            pass: 0,
            next: 0,
        }
    }

    fn due_ns(&self) -> Option<u64> {
        let stamp_ns = self.samples.get(self.next)?.stamp_ns;
        Some(stamp_ns.saturating_add(self.shift_ns()))
    }

    fn shift_ns(&self) -> u64 {
        self.pass.saturating_mul(self.length_ns)
    }

    fn take_until(&mut self, until_ns: u64, frame: &mut Vec<Sample>) {
        // A sample whose time does not advance follows at once, because the one before it was due.
        while self.due_ns().is_some_and(|due_ns| due_ns <= until_ns) {
            frame.push(self.sample());
            self.next += 1;
            if self.repeat && self.next == self.samples.len() {
                self.next = 0;
                self.pass = self.pass.saturating_add(1);
            }
        }
    }

    fn sample(&self) -> Sample {
        let shift_ns = self.shift_ns();
        let mut sample = self.samples[self.next];
        sample.seq += self.pass.saturating_mul(self.samples.len() as u64);
        sample.stamp_ns = sample.stamp_ns.saturating_add(shift_ns);
        if sample.has(sample_flag::POWER) {
            sample.measured_ns = sample.measured_ns.saturating_add(shift_ns);
        }
        if self.pass > 0 && self.next == 0 {
            sample.flags |= sample_flag::DISCONTINUITY;
        }
        sample
    }
}
