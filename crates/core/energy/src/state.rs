//! The energy state of a robot.

// Several arrays are indexed alike, level by level.
#![allow(clippy::needless_range_loop)]

use serde::{Deserialize, Serialize};

use crate::calibration::{
    ErrorBounds, NewErrors, PARTS, PULL, PlatformErrors, class_of, own_share,
};
use crate::command::{CommandModel, Motion};
use crate::levels::{LEVELS, LEVELS_S, Level, NEWEST, Parts, SHADOWS, SHADOWS_S};
use crate::memory::{POWER, Shown, TRUST, shown, shown_trust, trusted};
use crate::model::EnergyModel;
use crate::quantiles;

/// Time before the first shadow forecast, s, because the first readings are not representative.
const SETTLE_S: f32 = 0.75;
/// A shadow forecast with a negative time waits to be made, and is due from here on.
const DUE_S: f32 = -1.0;
/// The shadow forecast whose power is remembered of the robot: of 1 s.
const REMEMBERED: usize = 0;

/// One sample of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergySample {
    /// Power read with it, W. NaN if there was no reading.
    pub power_w: f32,
    /// Time since the robot's sample before, s. 0 or NaN if there was none, or if the time between
    /// the two is not to be counted.
    pub elapsed_s: f32,
    /// Commanded linear velocity from now on, m/s. NaN if unknown.
    pub v_mps: f32,
    /// Commanded angular velocity from now on, rad/s. NaN if unknown.
    pub omega_radps: f32,
}

/// The energy state of a robot: plain numbers without padding, so that it can be kept in columns,
/// in files and in shared memory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[repr(C)]
pub struct EnergyState {
    /// The part that changes with every sample.
    pub metered: Metered,
    /// The part that changes when a shadow forecast has ended.
    pub learned: Learned,
    /// Bounds of the robot's intervals: those of its platform.
    pub bounds: ErrorBounds,
}

/// Sums that every sample adds to, and the command in force.
///
/// Discounted sums over the readings so far give the robot's levels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[repr(C)]
pub struct Metered {
    /// Discounted energy of each level, J.
    pub energy_j: [f32; LEVELS],
    /// Energy by the command model for the same time, J.
    pub command_j: [f32; LEVELS],
    /// Discounted time, s.
    pub time_s: [f32; LEVELS],
    /// The command in force, m/s. NaN if unknown.
    pub v_mps: f32,
    /// The command in force, rad/s. NaN if unknown.
    pub omega_radps: f32,
    /// Power of the command in force, W.
    pub command_w: f32,
    /// Energy measured since each shadow forecast was made, J.
    pub shadow_energy_j: [f32; SHADOWS],
    /// Energy by the command model for the commands since then, J.
    pub shadow_command_j: [f32; SHADOWS],
    /// Time since then, s. Negative while the next one waits to be made.
    pub shadow_s: [f32; SHADOWS],
}

/// Results of the robot's *shadow forecasts*: one at a time for each of [`SHADOWS_S`]. Each is made
/// as if for a planner that knew the commands in advance, and once more as if it did not. It is
/// compared with the measured energy when its time is over, as it was made: what the robot has shown
/// since had no part in it. The lower 16 bits of the numbers of shadow forecasts are 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[repr(C)]
pub struct Learned {
    /// Factor of the command model's energy in each shadow forecast.
    pub shadow_factor: [f32; SHADOWS],
    /// Added power in each shadow forecast, W.
    pub shadow_added_w: [f32; SHADOWS],
    /// Power that each shadow forecast would expect for any commands, W.
    pub shadow_mean_w: [f32; SHADOWS],
    /// Share of this robot's power that the commands explain: 1 as much as the platform's, 0
    /// nothing.
    pub command_trust: f32,
    /// Discounted products of the energy explained by the commands and the energy to be explained.
    pub trust_product: f32,
    /// Discounted squares of the energy explained by the commands.
    pub trust_square: f32,
    /// The last reading when each shadow forecast was made, W.
    pub shadow_last_w: [f32; SHADOWS],
    /// The robot's own mean power then, W.
    pub shadow_own_w: [f32; SHADOWS],
    /// The trust in commands then.
    pub shadow_trust: [f32; SHADOWS],
    /// Power of the outlook then, W.
    pub shadow_outlook_w: [f32; SHADOWS],
}

impl Metered {
    /// Number of f32 in it.
    pub const FLOATS: usize = 3 * LEVELS + 3 + 3 * SHADOWS;
    /// Places of the longest level's energy and time in [`Metered::to_array`], for loops over
    /// robots that need these alone.
    pub const LONGEST: [usize; 2] = [LEVELS - 1, 3 * LEVELS - 1];
    /// Places of the command in force and its power in it: v, omega, W.
    pub const COMMAND: [usize; 3] = [3 * LEVELS, 3 * LEVELS + 1, 3 * LEVELS + 2];

    /// Takes a sample. Without branches.
    #[inline(always)]
    pub fn advance(&mut self, model: &CommandModel, sample: &EnergySample) {
        let elapsed_s = sample.elapsed_s;
        let counted = (elapsed_s > 0.0) & elapsed_s.is_finite();
        let elapsed_s = if counted { elapsed_s } else { 0.0 };
        let known = counted & sample.power_w.is_finite() & self.command_w.is_finite();
        let added_j = if known { sample.power_w * elapsed_s } else { 0.0 };
        let command_j = if known { self.command_w * elapsed_s } else { 0.0 };
        let added_s = if known { elapsed_s } else { 0.0 };
        for level in 0..LEVELS {
            let keeps = LEVELS_S[level] / (LEVELS_S[level] + elapsed_s);
            self.energy_j[level] = keeps * (self.energy_j[level] + added_j);
            self.command_j[level] = keeps * (self.command_j[level] + command_j);
            self.time_s[level] = keeps * (self.time_s[level] + added_s);
        }
        for shadow in 0..SHADOWS {
            let runs = self.shadow_s[shadow] >= 0.0;
            let next_s = self.shadow_s[shadow] + added_s;
            // One that waits stays negative. One with time missing cannot be compared.
            let waiting_s = next_s.min(0.5 * DUE_S);
            let waiting_s = if runs { DUE_S - SETTLE_S } else { waiting_s };
            self.shadow_s[shadow] = if runs & known { next_s } else { waiting_s };
            self.shadow_energy_j[shadow] += added_j;
            self.shadow_command_j[shadow] += command_j;
        }
        self.command_to(model, sample);
    }

    /// The sample's command is in force from now on.
    #[inline(always)]
    fn command_to(&mut self, model: &CommandModel, sample: &EnergySample) {
        let command = (sample.v_mps, sample.omega_radps);
        let before = (self.v_mps, self.omega_radps);
        let motion = Motion::new(command, before, sample.elapsed_s);
        self.command_w = model.power_w(&motion);
        (self.v_mps, self.omega_radps) = command;
    }

    /// True if a shadow forecast has ended, or the first is due.
    #[inline(always)]
    pub fn has_ended(&self) -> bool {
        let mut ended = false;
        for shadow in 0..SHADOWS {
            ended |= self.is_over(shadow);
        }
        ended
    }

    #[inline(always)]
    fn is_over(&self, shadow: usize) -> bool {
        let shadow_s = self.shadow_s[shadow];
        let due = (DUE_S..0.0).contains(&shadow_s);
        due | (shadow_s >= SHADOWS_S[shadow])
    }

    /// All numbers, in the order of the fields.
    #[inline(always)]
    pub fn to_array(&self) -> [f32; Self::FLOATS] {
        let mut numbers = [0.0; Self::FLOATS];
        let mut at = 0;
        let mut put = |values: &[f32]| {
            for value in values {
                numbers[at] = *value;
                at += 1;
            }
        };
        put(&self.energy_j);
        put(&self.command_j);
        put(&self.time_s);
        put(&[self.v_mps, self.omega_radps, self.command_w]);
        put(&self.shadow_energy_j);
        put(&self.shadow_command_j);
        put(&self.shadow_s);
        numbers
    }

    /// Creates it from [`Metered::to_array`].
    #[inline(always)]
    pub fn from_array(numbers: &[f32; Self::FLOATS]) -> Self {
        // Copies, because calls of `from_fn` are not always inlined.
        let levels = |at: usize| {
            let mut levels = [0.0; LEVELS];
            levels.copy_from_slice(&numbers[at..at + LEVELS]);
            levels
        };
        let shadows = |group: usize| {
            let mut shadows = [0.0; SHADOWS];
            let at = 3 * LEVELS + 3 + group * SHADOWS;
            shadows.copy_from_slice(&numbers[at..at + SHADOWS]);
            shadows
        };
        Self {
            energy_j: levels(0),
            command_j: levels(LEVELS),
            time_s: levels(2 * LEVELS),
            v_mps: numbers[Self::COMMAND[0]],
            omega_radps: numbers[Self::COMMAND[1]],
            command_w: numbers[Self::COMMAND[2]],
            shadow_energy_j: shadows(0),
            shadow_command_j: shadows(1),
            shadow_s: shadows(2),
        }
    }
}

impl Learned {
    /// Groups of numbers in it.
    pub const GROUPS: usize = 8;

    /// Before the first shadow forecast has ended.
    pub const fn new() -> Self {
        Self {
            shadow_factor: [0.0; SHADOWS],
            shadow_added_w: [0.0; SHADOWS],
            shadow_mean_w: [0.0; SHADOWS],
            command_trust: 1.0,
            trust_product: 0.0,
            trust_square: 0.0,
            shadow_last_w: [0.0; SHADOWS],
            shadow_own_w: [0.0; SHADOWS],
            shadow_trust: [1.0; SHADOWS],
            shadow_outlook_w: [0.0; SHADOWS],
        }
    }

    fn parts(&self, shadow: usize) -> Parts {
        let (mean_w, own_w) = (self.shadow_mean_w[shadow], self.shadow_own_w[shadow]);
        let share = own_share(error_shares(SHADOWS_S[shadow]));
        Parts {
            factor: self.shadow_factor[shadow],
            added_w: self.shadow_added_w[shadow],
            mean_w,
            without_w: mean_w + share * (own_w - mean_w),
        }
    }

    /// Takes the part of `measured_j` that the commands explained into the sums for the trust in
    /// them: the share with the least squared error between the forecasts with and without
    /// commands. Returns what the sums gained: square and product.
    fn trust(
        &mut self,
        parts: &Parts,
        shadow: usize,
        (command_j, duration_s, measured_j, mean_j): (f32, f32, f32, f32),
    ) -> [f32; 2] {
        /// The discount factor of the sums, by shadow.
        const KEEPS: [f32; SHADOWS] = [0.98, 1.0, 1.0];
        /// Weight of an error. Those of 1 s are many, and commands explain more of a second than of a
        /// minute: they would outvote the long ones.
        const WEIGHTS: [f32; SHADOWS] = [0.1, 1.0, 1.0];
        /// Errors below this share of the platform's mean do not weigh more.
        const MIN: f32 = 0.02;
        let without_j = parts.without_w * duration_s;
        let with_j = parts.factor * command_j + parts.added_w * duration_s;
        let explained = (with_j - without_j) / mean_j;
        let wanted = (measured_j - without_j) / mean_j;
        // Large errors weigh by their size instead of its square.
        let weight = WEIGHTS[shadow] / (wanted.abs() + explained.abs()).max(MIN);
        let gained = [weight * explained * explained, weight * explained * wanted];
        let square = KEEPS[shadow] * self.trust_square + gained[0];
        let product = KEEPS[shadow] * self.trust_product + gained[1];
        if product.is_finite() && square.is_finite() {
            (self.trust_product, self.trust_square) = (product, square);
        }
        gained
    }

    /// The same with the numbers of shadow forecasts as [`EnergyState::compare`] makes them.
    #[must_use]
    pub fn rounded(&self) -> Self {
        let all = |numbers: [f32; SHADOWS]| numbers.map(half_f32);
        Self {
            shadow_factor: all(self.shadow_factor),
            shadow_added_w: all(self.shadow_added_w),
            shadow_mean_w: all(self.shadow_mean_w),
            shadow_last_w: all(self.shadow_last_w),
            shadow_own_w: all(self.shadow_own_w),
            shadow_trust: all(self.shadow_trust),
            shadow_outlook_w: all(self.shadow_outlook_w),
            ..*self
        }
    }

    /// All numbers, in the order of the fields.
    #[inline(always)]
    pub const fn to_groups(&self) -> [[f32; SHADOWS]; Self::GROUPS] {
        [
            self.shadow_factor,
            self.shadow_added_w,
            self.shadow_mean_w,
            [self.command_trust, self.trust_product, self.trust_square],
            self.shadow_last_w,
            self.shadow_own_w,
            self.shadow_trust,
            self.shadow_outlook_w,
        ]
    }

    /// Creates it from [`Learned::to_groups`].
    #[inline(always)]
    pub const fn from_groups(groups: &[[f32; SHADOWS]; Self::GROUPS]) -> Self {
        let [
            shadow_factor,
            shadow_added_w,
            shadow_mean_w,
            [command_trust, trust_product, trust_square],
            shadow_last_w,
            shadow_own_w,
            shadow_trust,
            shadow_outlook_w,
        ] = *groups;
        Self {
            shadow_factor,
            shadow_added_w,
            shadow_mean_w,
            command_trust,
            trust_product,
            trust_square,
            shadow_last_w,
            shadow_own_w,
            shadow_trust,
            shadow_outlook_w,
        }
    }
}

impl Default for Learned {
    fn default() -> Self {
        Self::new()
    }
}

impl EnergyState {
    /// Before the first sample. `phase` spreads the shadow forecasts of robots that start together
    /// over time, for instance the robot's place.
    pub fn new(phase: u32) -> Self {
        let waits_s = SETTLE_S + (phase % 32) as f32 / 32.0;
        Self {
            metered: Metered {
                energy_j: [0.0; LEVELS],
                command_j: [0.0; LEVELS],
                time_s: [0.0; LEVELS],
                v_mps: f32::NAN,
                omega_radps: f32::NAN,
                command_w: f32::NAN,
                shadow_energy_j: [0.0; SHADOWS],
                shadow_command_j: [0.0; SHADOWS],
                shadow_s: [DUE_S - waits_s; SHADOWS],
            },
            learned: Learned::new(),
            bounds: ErrorBounds::TRAINED,
        }
    }

    /// Same as [`EnergyState::new`], for a robot that joins a platform whose robots have shown this.
    pub fn among(phase: u32, platform: &PlatformErrors) -> Self {
        let mut state = Self::new(phase);
        state.learned.command_trust = platform.memory.command_trust;
        state.bounds = platform.plans;
        state
    }

    /// The command in force: m/s and rad/s, NaN if unknown.
    pub fn command(&self) -> (f32, f32) {
        (self.metered.v_mps, self.metered.omega_radps)
    }

    /// Takes a sample of a robot that is alone on its platform.
    pub fn observe(&mut self, model: &EnergyModel, sample: &EnergySample) {
        self.observe_among(model, &PlatformErrors::TRAINED, sample);
    }

    /// Takes a sample of a robot of a platform with these errors. Returns its new ones for
    /// [`crate::Calibration::add`].
    pub fn observe_among(
        &mut self,
        model: &EnergyModel,
        platform: &PlatformErrors,
        sample: &EnergySample,
    ) -> NewErrors {
        self.metered.advance(&model.command, sample);
        let ended = self.metered.has_ended();
        if ended { self.compare(model, platform, sample.power_w) } else { NewErrors::default() }
    }

    /// Compares the shadow forecasts that have ended with the measured energy, and makes the next
    /// ones. It follows [`Metered::advance`] with the reading `power_w` if one [has
    /// ended](Metered::has_ended). Returns the errors.
    pub fn compare(
        &mut self,
        model: &EnergyModel,
        platform: &PlatformErrors,
        power_w: f32,
    ) -> NewErrors {
        let mut errors = NewErrors::default();
        for shadow in 0..SHADOWS {
            if !self.metered.is_over(shadow) {
                continue;
            }
            if self.metered.shadow_s[shadow] >= SHADOWS_S[shadow] {
                let (class, pulls) = self.judge_ahead(model, shadow);
                errors.classes[SHADOWS + shadow] = class;
                errors.pulls[shadow] = pulls;
                errors.classes[shadow] = self.learn(model, platform, shadow, &mut errors.shown);
                if shadow == REMEMBERED {
                    let mean_j = model.command.mean_w * self.metered.shadow_s[shadow];
                    let power = self.metered.shadow_energy_j[shadow] / mean_j;
                    errors.shown[POWER] = shown(POWER, 1.0, power);
                }
            }
            let (parts, _) = self.parts(model, SHADOWS_S[shadow]);
            self.learned.shadow_factor[shadow] = parts.factor;
            self.learned.shadow_added_w[shadow] = parts.added_w;
            self.learned.shadow_mean_w[shadow] = parts.mean_w;
            let spreads = model.newest_spreads();
            let contradictions = contradictions(&self.metered, model.command.mean_w, &spreads);
            let [last_w, _, own_w] =
                outlook_parts(&self.metered, &contradictions, parts.mean_w, power_w);
            self.learned.shadow_last_w[shadow] = last_w;
            self.learned.shadow_own_w[shadow] = own_w;
            self.learned.shadow_trust[shadow] = self.learned.command_trust;
            self.learned.shadow_outlook_w[shadow] =
                mixed(&platform.shares[shadow], &[last_w, parts.mean_w, own_w]);
            self.metered.shadow_energy_j[shadow] = 0.0;
            self.metered.shadow_command_j[shadow] = 0.0;
            self.metered.shadow_s[shadow] = 0.0;
        }
        self.learned = self.learned.rounded();
        self.bounds = platform.plans;
        errors
    }

    /// Adapts the trust in commands. Returns the class of the error, if it has one.
    fn learn(
        &mut self,
        model: &EnergyModel,
        platform: &PlatformErrors,
        shadow: usize,
        new: &mut Shown,
    ) -> Option<u8> {
        let (metered, learned) = (&self.metered, &mut self.learned);
        let (duration_s, command_j) = (metered.shadow_s[shadow], metered.shadow_command_j[shadow]);
        let measured_j = metered.shadow_energy_j[shadow];
        let parts = learned.parts(shadow);
        let trust = learned.shadow_trust[shadow];
        let forecast_j = parts.level(trust).energy_j(command_j, duration_s);
        let mean_j = model.command.mean_w * duration_s;
        let energies = (command_j, duration_s, measured_j, mean_j);
        let [square, product] = learned.trust(&parts, shadow, energies);
        for (sum, gained) in new[TRUST].iter_mut().zip(shown_trust(square, product)) {
            *sum += gained;
        }
        let (product, square) = (learned.trust_product, learned.trust_square);
        learned.command_trust = trusted(product, square, platform.memory.command_trust);
        class(model, shadow, (measured_j, forecast_j, duration_s))
    }

    /// Same as [`EnergyState::learn`], for an outlook. Also returns its pulls.
    fn judge_ahead(&self, model: &EnergyModel, shadow: usize) -> (Option<u8>, [i64; PARTS]) {
        /// Largest pull, in the platform's mean power.
        const MAX: f32 = 4.0;
        let (duration_s, measured_j) =
            (self.metered.shadow_s[shadow], self.metered.shadow_energy_j[shadow]);
        let learned = &self.learned;
        let level_w = learned.shadow_mean_w[shadow];
        let forecast_j = learned.shadow_outlook_w[shadow] * duration_s;
        let class = class(model, shadow, (measured_j, forecast_j, duration_s));
        let side = if forecast_j > measured_j { 1.0 } else { -1.0 };
        let pull = |watts: f32| {
            let share = side * (watts - level_w) / model.command.mean_w;
            if share.is_finite() { share.clamp(-MAX, MAX) } else { 0.0 }
        };
        let (last, own) = (pull(learned.shadow_last_w[shadow]), pull(learned.shadow_own_w[shadow]));
        let pulls = [last, own, (last * last).max(own * own)];
        (class, if class.is_some() { pulls.map(|pull| (pull * PULL) as i64) } else { [0; PARTS] })
    }

    /// Middle and half width of the robot's interval at a horizon, linear between the watched ones
    /// and constant beyond.
    pub(crate) fn bounds_at(&self, horizon_s: f32) -> (f32, f32) {
        let (segment, share) = segment(horizon_s);
        let (from, to) =
            (self.bounds.middle_and_half(segment), self.bounds.middle_and_half(segment + 1));
        (from.0 + share * (to.0 - from.0), from.1 + share * (to.1 - from.1))
    }

    /// The robot's level over a horizon: its levels, weighted. With it, the share of the weights
    /// that the newest readings have taken from older ones.
    pub(crate) fn level(&self, model: &EnergyModel, horizon_s: f32) -> (Level, f32) {
        let (parts, changed) = self.parts(model, horizon_s);
        (parts.level(self.learned.command_trust), changed)
    }

    fn parts(&self, model: &EnergyModel, horizon_s: f32) -> (Parts, f32) {
        let (weights, added_share) = model.weights_at(horizon_s);
        let spreads = model.newest_spreads();
        let contradictions = contradictions(&self.metered, model.command.mean_w, &spreads);
        let (weights, changed) = weighted(weights, &contradictions);
        let (spread, mean_w) = (model.spread_at(horizon_s), model.command.mean_w);
        let mut parts = Parts::default();
        for level in 0..LEVELS {
            let weight = weights[level];
            let time_s = self.metered.time_s[level];
            let command_j = self.metered.command_j[level];
            if !((time_s > 0.0) & (command_j > 0.0)) {
                parts.factor += weight;
                parts.mean_w += weight * mean_w;
                continue;
            }
            let energy_j = self.metered.energy_j[level];
            let differs = energy_j / command_j - 1.0;
            let shrunk = shrunk(time_s, model.prior_s[level], differs / spread);
            let above_j = shrunk * (energy_j - command_j);
            parts.factor += weight * (1.0 + (1.0 - added_share) * above_j / command_j);
            parts.added_w += weight * (added_share * above_j / time_s);
            parts.mean_w += weight * (mean_w + shrunk * (energy_j / time_s - mean_w));
        }
        let [_, level_w, own_w] =
            outlook_parts(&self.metered, &contradictions, parts.mean_w, f32::NAN);
        parts.without_w = level_w + own_share(error_shares(horizon_s)) * (own_w - level_w);
        (parts, changed)
    }
}

/// The class of an error of a shadow forecast, if it has one; energies and time: measured, forecast
/// and the horizon.
fn class(
    model: &EnergyModel,
    shadow: usize,
    (measured_j, forecast_j, duration_s): (f32, f32, f32),
) -> Option<u8> {
    let relative = (measured_j - forecast_j) / model.scale_j(forecast_j, duration_s);
    let (middle, half) = quantiles::middle_and_half(&model.errors_at(SHADOWS_S[shadow]));
    let error = (relative - middle) / half;
    error.is_finite().then(|| class_of(error))
}

/// Parts of an outlook's mean, W: the last reading, the level, and the mean of all that the robot
/// drew, unless the newest readings contradict it. `last_w` is NaN if it is unknown.
#[inline(always)]
pub(crate) fn outlook_parts(
    metered: &Metered,
    contradictions: &[f32; LEVELS],
    level_w: f32,
    last_w: f32,
) -> [f32; PARTS] {
    const LONGEST: usize = LEVELS - 1;
    let time_s = metered.time_s[LONGEST];
    let above_w = metered.energy_j[LONGEST] / time_s - level_w;
    let own_w = level_w + above_w / (1.0 + contradictions[LONGEST]);
    let known = (time_s > 0.0) & own_w.is_finite();
    [
        if last_w.is_finite() { last_w } else { level_w },
        level_w,
        if known { own_w } else { level_w },
    ]
}

/// The outlook's power, W.
#[inline(always)]
pub(crate) fn mixed(shares: &[f32; PARTS], parts_w: &[f32; PARTS]) -> f32 {
    shares[0] * parts_w[0] + shares[1] * parts_w[1] + shares[2] * parts_w[2]
}

/// Contradiction of each level by the newest readings, 0 or more: the floor, the load or the robot
/// has changed since. A level of 1 loses half of its weight. The shortest is never contradicted.
///
/// A level is compared with each of the two shortest ones that is shorter. The difference of what
/// they draw beyond their commands counts in deviations of the errors at about that horizon, which
/// are `spreads`. `mean_w` is the platform's.
#[inline(always)]
pub(crate) fn contradictions(
    metered: &Metered,
    mean_w: f32,
    spreads: &[f32; NEWEST],
) -> [f32; LEVELS] {
    /// Deviations by which a level loses half of its weight.
    const HALF: f32 = 2.0;
    /// Least power that a deviation is of, as a share of the platform's mean.
    const MIN: f32 = 0.02;
    let (mut above_w, mut power_w, mut is_known) = ([0.0; LEVELS], [0.0; LEVELS], [false; LEVELS]);
    for level in 0..LEVELS {
        let per_s = 1.0 / metered.time_s[level];
        above_w[level] = per_s * (metered.energy_j[level] - metered.command_j[level]);
        power_w[level] = (per_s * metered.energy_j[level]).abs();
        is_known[level] = (metered.time_s[level] > 0.0) & (metered.command_j[level] > 0.0);
    }
    let mut contradictions = [0.0; LEVELS];
    for level in 1..LEVELS {
        for newer in 0..NEWEST.min(level) {
            let size_w = (power_w[newer] + power_w[level]).max(MIN * mean_w);
            let deviation_w = 0.5 * HALF * size_w * spreads[newer];
            let deviations = (above_w[newer] - above_w[level]) / deviation_w;
            let square = deviations * deviations;
            let known = is_known[newer] & is_known[level];
            contradictions[level] += if known { square * square } else { 0.0 };
        }
    }
    contradictions
}

/// Takes weight from levels that are contradicted. Returns the weights, 1 in all, and the share
/// that was taken.
#[inline(always)]
pub(crate) fn weighted(
    mut weights: [f32; LEVELS],
    contradictions: &[f32; LEVELS],
) -> ([f32; LEVELS], f32) {
    let mut kept = 0.0;
    for level in 0..LEVELS {
        // A factor, which is the same for all horizons.
        weights[level] *= 1.0 / (1.0 + contradictions[level]);
        kept += weights[level];
    }
    // Without the shortest level nothing may be left.
    let is_left = (kept > f32::MIN_POSITIVE) & kept.is_finite();
    let per_kept = 1.0 / kept;
    for level in 0..LEVELS {
        let alone = if level == 0 { 1.0 } else { 0.0 };
        weights[level] = if is_left { weights[level] * per_kept } else { alone };
    }
    (weights, if is_left { (1.0 - kept).clamp(0.0, 1.0) } else { 1.0 })
}

/// The watched horizon before a horizon, and the share of the one after.
fn segment(horizon_s: f32) -> (usize, f32) {
    let last = SHADOWS - 2;
    let segment = (0..last).find(|index| horizon_s < SHADOWS_S[index + 1]).unwrap_or(last);
    let (from_s, to_s) = (SHADOWS_S[segment], SHADOWS_S[segment + 1]);
    (segment, ((horizon_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0))
}

/// The weight of each watched horizon's bounds at a horizon, as in [`EnergyState::bounds_at`].
pub(crate) fn error_shares(horizon_s: f32) -> [f32; SHADOWS] {
    let (segment, share) = segment(horizon_s);
    let mut shares = [0.0; SHADOWS];
    (shares[segment], shares[segment + 1]) = (1.0 - share, share);
    shares
}

/// The nearest number whose lower 16 bits are 0: a shadow forecast needs three digits, and a robot
/// has 21 numbers of them. Off by at most 0.2 %.
fn half_f32(number: f32) -> f32 {
    if !number.is_finite() {
        return number;
    }
    let bits = number.to_bits();
    // To even. The largest numbers become infinite.
    f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000)
}

/// Time after which most of a deviation is not due to the first readings, s.
pub(crate) const START_S: f32 = 3.0;

/// Weight of a level after `time_s` of readings. The rest is the platform's level, because few
/// readings are not representative. `deviation` is the level's distance from the platform's, in
/// deviations of the forecast errors. A level that is too far away for a robot of this platform,
/// for instance on another floor, is drawn to the platform's for a shorter time.
fn shrunk(time_s: f32, prior_s: f32, deviation: f32) -> f32 {
    let is_level = time_s / (time_s + START_S);
    let square = deviation * deviation * time_s / (time_s + prior_s);
    let prior_s = prior_s / (1.0 + square * is_level * is_level);
    time_s / (time_s + prior_s)
}
