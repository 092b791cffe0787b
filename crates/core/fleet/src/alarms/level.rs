//! Level monitoring: a robot's power against its own earlier level under the same commands.
//!
//! The residuals cannot find a load for long, because the network reads the last readings and
//! follows the load within a few of them. What is compared here reads no reading of the present:
//! the mean power of the last seconds, and the power that the robot's *own level* expects for the
//! commands of those seconds. For a platform whose energy model states no errors (untrained,
//! persistence), commands count by their share of the largest allowed ones. Where the model reads no
//! commands, all of them count alike.
//!
//! **Own level.** A line through the robot's levels so far: power over the power that the
//! platform's energy model gives its commands. Of the slope, a priori half is the model's and half
//! the ratio of the two means, with a standard deviation of half of the greater. Where the robot
//! has not been under such commands yet, the slope's variance widens the expectation: who has only
//! stood still is not judged by how it drives.
//!
//! **Deviation.** The mean of 2 s, and that of 12 s, minus what is expected, relative to the
//! expected power, in standard deviations of the robot's own levels. Those start as the platform's,
//! and never fall below them. The platform's are those of the errors of its energy model. A quick mean
//! needs [`QUICK`] of the limit, a slow one [`SLOW`] of it, for [`HOLD_S`].
//!
//! **Among others.** A robot that has had its load from the first sample on has no level without it.
//! So its own level is also compared with the median of its platform's robots, once eight
//! [are known](joulebus_energy::Memory::level), in standard deviations between robots. That needs
//! [`AMONG`] of the limit. While an alarm is raised, the slow mean is compared: it may end it. The own
//! level, if it was apart itself, then begins anew.
//!
//! **The limit grows with time.** A robot that runs for hours has thousands of chances to deviate.
//! So the limit grows by up to [`LATER`] with the seconds of the own level, by half of that at
//! [`LATER_S`], and hardly in the first half minute.
//!
//! **Nothing is learned away.** While an alarm is raised the own level is frozen. While the
//! deviation is above [`CAREFUL_FROM`] of the limit it learns at an eighth of the rate.
//!
//! **New normal.** A person can acknowledge the level, for instance of a payload. The robot then
//! learns its own level anew, and is judged after [`SETTLE_S`]. Its scatter stays. It is no longer
//! compared with other robots.
//!
//! **Where levels come and go.** An alarm that ends by itself doubles the robot's variances
//! ([`GROWTH`]): on changing ground it is raised a few times, and then more seldom.
//!
//! **Another kind.** A robot that has drawn [`UNLIKE`] times the power of its commands for a minute,
//! or that part of it, has the model of another kind of robot: `ModelMismatch`.
//!
//! Not judged: unknown commands of a model that reads them, charging, the first seconds after
//! either.

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]
// The check in `clamp` and the two steps of `contains` are branches, with which it does not.
#![allow(clippy::manual_clamp, clippy::manual_range_contains)]

use joulebus_energy::{EnergyModel, Memory};
use joulebus_settings::{AlarmSettings, Platform};
use joulebus_wire::{Alarm, AlarmSet, PlatformMemory};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{Block as _, LANES, Lanes, block};

/// Time constants of the quick and the slow mean, s.
const MEANS_S: [f32; 2] = [2.0, 12.0];
/// Share of the limit that a deviation of the quick mean must reach.
const QUICK: f32 = 1.0;
/// That of the slow mean, which scatters less.
const SLOW: f32 = 0.5;
/// That of the own level, beside those of other robots.
const AMONG: f32 = 0.75;
/// Seconds of the own level before it is compared with others, and before it is shown to them.
const AMONG_S: f32 = 10.0;
/// Growth of the limit with the seconds of the own level, and their number at half of it.
const LATER: f32 = 0.375;
const LATER_S: f32 = 100.0;
/// Age from which the slow mean is judged, s.
const SLOW_AGE_S: f32 = 6.0;
/// Time constant of the own level, s.
const OWN_S: f32 = 600.0;
/// Time without a mean after the start of commands, s: motors start with a peak.
const START_S: f32 = 1.0;
/// Seconds of the own level before it is compared with.
const SETTLE_S: f32 = 3.0;
/// Seconds of the own level before its scatter is learned.
const SCATTER_FROM_S: f32 = 0.7;
/// Seconds of readings that weigh as much as the platform's scatter, for both means.
const PRIOR_S: [f32; 2] = [6.0, 12.0];
/// Time in which levels are correlated, s.
const CORRELATED_S: f32 = 3.0;
/// Smallest relative standard deviation.
const LEAST: f32 = 0.02;
/// A deviation counts as this many standard deviations at most when the scatter is learned.
const MAX_SCATTER: f32 = 3.0;
/// Powers are relative to this share of the platform's mean power at least. Of an untrained model,
/// that is the largest power allowed.
const FLOOR: f32 = 0.3;
const UNTRAINED_FLOOR: f32 = 0.02;
/// Relative standard deviations of the two means under an untrained model.
const UNTRAINED_SPREAD: [f32; 2] = [0.1, 0.07];
/// Seconds of the own level before it shows that the model is of another kind of robot.
const KIND_S: f32 = 60.0;
/// Share of [`UNLIKE`] below which that ends.
const KIND_STAYS: f32 = 0.9;
/// Time for which a deviation must stay beyond the limit, s: a load that comes and goes within a
/// second is no fault.
const HOLD_S: f32 = 3.0;
/// Share of the limit below which an alarm ends.
const HALF: f32 = 0.5;
/// Share of the limit from which the own level and its scatter learn slowly, and that rate: in the
/// time until an alarm is raised, its cause must not be learned.
const CAREFUL_FROM: f32 = 0.4;
const CAREFUL: f32 = 0.125;

/// Factor of the variances when an alarm ends.
const GROWTH: f32 = 2.0;

const HIGH: u32 = AlarmSet(0).with(Alarm::LevelHigh).0;
const LOW: u32 = AlarmSet(0).with(Alarm::LevelLow).0;
const KIND: u32 = AlarmSet(0).with(Alarm::ModelMismatch).0;
/// No alarm: a person has accepted the level as the new normal.
const ACCEPTED: u32 = 1 << 31;
/// The own level was apart from those of others when the alarm was raised.
const BY_OTHERS: u32 = 1 << 30;
/// A robot whose level is this many times the platform's, or this part of it, is of another kind.
const UNLIKE: f32 = PlatformMemory::UNLIKE;
/// Least relative standard deviation of such a robot.
const UNLIKE_SCATTER: f32 = 0.25;

/// Rules for the levels of a platform's robots.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LevelRules {
    limit: f32,
    period_s: f32,
    floor_w: f32,
    /// Squared relative standard deviations of the platform's means.
    variances: [f32; 2],
    /// The platform's [`Memory::level`], and its squared [`Memory::spread`].
    among: f32,
    spread: f32,
    command: CommandPower,
}

/// The power that levels take a command for.
#[derive(Debug, Clone, Copy)]
enum CommandPower {
    /// The energy model's.
    Model,
    /// The same for all, W: the energy model reads none.
    Constant(f32),
    /// Of an untrained model, W: this at rest, and as much more at each of the largest allowed
    /// velocities, m/s and rad/s.
    Allowed(f32, [f32; 2]),
}

impl LevelRules {
    pub(crate) fn new(energy: &EnergyModel, alarms: &AlarmSettings, platform: &Platform) -> Self {
        let (is_trained, mean_w) = (energy.calibrated > 0, energy.command.mean_w);
        let spread = |place: usize| {
            if is_trained { energy.spread_at(MEANS_S[place]) } else { UNTRAINED_SPREAD[place] }
        };
        Self {
            limit: alarms.level_limit,
            period_s: platform.period_ns as f32 * 1e-9,
            floor_w: mean_w * if is_trained { FLOOR } else { UNTRAINED_FLOOR },
            variances: [0, 1].map(|place| spread(place) * spread(place)),
            among: 0.0,
            spread: 1.0,
            command: if !is_trained {
                CommandPower::Allowed(mean_w, [platform.v_max_mps, platform.omega_max_radps])
            } else if energy.command.reads_commands() {
                CommandPower::Model
            } else {
                CommandPower::Constant(mean_w)
            },
        }
    }

    /// The rules where the platform's robots have shown this.
    #[inline(always)]
    pub(crate) fn among(&self, memory: &Memory) -> Self {
        Self { among: memory.level, spread: memory.spread * memory.spread, ..*self }
    }

    /// The power of a command: `model_w` is the energy model's. NaN if it is unknown.
    #[inline(always)]
    pub(crate) fn command_w(&self, (v_mps, omega_radps): (f32, f32), model_w: f32) -> f32 {
        let known = v_mps.is_finite() & omega_radps.is_finite();
        match self.command {
            CommandPower::Model => {
                if known {
                    model_w
                } else {
                    f32::NAN
                }
            }
            CommandPower::Constant(power_w) => power_w,
            CommandPower::Allowed(rest_w, [v_max_mps, omega_max_radps]) => {
                // A largest velocity of 0 allows 0 alone.
                let share = |value: f32, most: f32| value.abs() / most.max(f32::MIN_POSITIVE);
                let more = share(v_mps, v_max_mps) + share(omega_radps, omega_max_radps);
                rest_w * (1.0 + if known { more } else { 0.0 })
            }
        }
    }

    const fn is_trained(&self) -> bool {
        !matches!(self.command, CommandPower::Allowed(..))
    }
}

/// A sample, as far as the levels need it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LevelSample {
    /// NaN without a reading.
    pub power_w: f32,
    /// Power of its command by the platform's model, in force from now on. NaN if unknown.
    pub command_w: f32,
    /// On its charger, or at the first sample after a break.
    pub apart: bool,
}

block! {
    /// The levels of a robot.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub(crate) struct Level: NONE;

    /// The levels of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct LevelLanes {
        /// Power of the command in force. NaN if unknown.
        command_w: f32 = f32::NAN,
        /// Time for which readings and commands have been known, s.
        known_s: f32 = 0.0,
        /// Weight of the quick mean, s. Its power, and that of its commands, W.
        quick_s: f32 = 0.0,
        quick_w: f32 = 0.0,
        quick_command_w: f32 = 0.0,
        /// The same of the slow mean.
        slow_s: f32 = 0.0,
        slow_w: f32 = 0.0,
        slow_command_w: f32 = 0.0,
        /// Weight of the own level, s. Its means, W.
        own_s: f32 = 0.0,
        own_w: f32 = 0.0,
        own_command_w: f32 = 0.0,
        /// Sums over its time: squares of the commands' deviations from their mean, and their
        /// products with those of power, W² s.
        square: f32 = 0.0,
        product: f32 = 0.0,
        /// Squared relative standard deviations of the two means.
        quick_variance: f32 = 1.0,
        slow_variance: f32 = 1.0,
        /// Time for which they have been learned, s.
        scatter_s: f32 = 0.0,
        /// Bits of [`AlarmSet`], [`ACCEPTED`] and [`BY_OTHERS`].
        raised: u32 = 0,
        /// Time for which a deviation has been beyond the limit, s.
        beyond_s: f32 = 0.0,
    }
}

/// The expectation of a robot's own level.
struct Expected {
    slope: f32,
    slope_variance: f32,
    /// The robot's power over that of its commands.
    ratio: f32,
    /// The robot's own power for relative deviations, W.
    own_w: f32,
    variances: [f32; 2],
}

impl Level {
    /// Before the first sample.
    pub(crate) fn new(rules: &LevelRules) -> Self {
        let [quick_variance, slow_variance] = rules.variances;
        Self { quick_variance, slow_variance, ..Self::NONE }
    }

    /// The power from now on is the robot's own level: what it drew before is forgotten, and its
    /// alarms end. Its scatter stays.
    fn accept(&mut self) {
        *self = Self {
            quick_s: 0.0,
            slow_s: 0.0,
            own_s: 0.0,
            own_w: 0.0,
            own_command_w: 0.0,
            square: 0.0,
            product: 0.0,
            raised: ACCEPTED,
            beyond_s: 0.0,
            ..*self
        };
    }

    /// Takes a sample, and raises and clears the alarms. Without branches.
    #[inline(always)]
    pub(crate) fn observe(&mut self, rules: &LevelRules, sample: &LevelSample) {
        let counted = self.count(rules, sample);
        let expected = self.expected(rules);
        let [quick, quick_spread] = self.deviation(
            rules,
            &expected,
            (self.quick_w, self.quick_command_w),
            expected.variances[0],
        );
        let [slow, slow_spread] = self.deviation(
            rules,
            &expected,
            (self.slow_w, self.slow_command_w),
            expected.variances[1],
        );
        let limit = self.limit(rules);
        let share = quick / (quick_spread.sqrt() * (QUICK * limit));
        let slow_share = slow / (slow_spread.sqrt() * (SLOW * limit));
        let slow_share = if self.slow_s >= SLOW_AGE_S { slow_share } else { 0.0 };
        let (own_high, own_low) = (share.max(slow_share), (-share).max(-slow_share));
        let among = self.among(rules);
        // An own level that is apart from the others is no level to go back to.
        let by_others = self.raised & BY_OTHERS != 0;
        let (high, low) = (own_high.max(among), own_low.max(-among));
        let (high, low) = if by_others { (among, -among) } else { (high, low) };
        let settled = counted & (self.own_s >= SETTLE_S);
        let beyond = settled & (high.max(low) > 1.0);
        let beyond_s = (self.beyond_s + rules.period_s).min(HOLD_S + rules.period_s);
        self.beyond_s = if beyond { beyond_s } else { 0.0 };
        let was_raised = self.is_raised();
        self.decide(settled, (high, low), among);
        let ends = was_raised & !self.is_raised();
        let growth = if ends { GROWTH } else { 1.0 };
        let begins_anew = ends & by_others;
        self.own_s = if begins_anew { 0.0 } else { self.own_s };
        self.square = if begins_anew { 0.0 } else { self.square };
        self.product = if begins_anew { 0.0 } else { self.product };
        self.raised |= self.kind(rules, expected.ratio);
        let careful = settled & (own_high.max(own_low) > CAREFUL_FROM);
        let rate = if careful { CAREFUL } else { 1.0 };
        let learns = counted & !self.is_raised();
        let learned_s = if learns { rate * rules.period_s } else { 0.0 };
        let scatter_s = if self.own_s > SCATTER_FROM_S { learned_s } else { 0.0 };
        let [quick_variance, slow_variance] = expected.variances;
        let quick_square = (quick * quick / quick_spread).min(MAX_SCATTER * MAX_SCATTER);
        let slow_square = (slow * slow / slow_spread).min(MAX_SCATTER * MAX_SCATTER);
        let weight = |prior_s: f32, scatter: f32| scatter_s / (scatter + prior_s).min(OWN_S);
        let (quick_weight, slow_weight) =
            (weight(PRIOR_S[0], self.scatter_s), weight(PRIOR_S[1], self.scatter_s));
        self.quick_variance += quick_weight * (quick_square * quick_variance - self.quick_variance);
        self.slow_variance += slow_weight * (slow_square * slow_variance - self.slow_variance);
        self.quick_variance *= growth;
        self.slow_variance *= growth;
        self.scatter_s = (self.scatter_s + scatter_s).min(OWN_S);
        self.learn(learned_s);
    }

    /// Adds the sample to the two means. Whether it counted.
    #[inline(always)]
    fn count(&mut self, rules: &LevelRules, sample: &LevelSample) -> bool {
        let period_s = rules.period_s;
        let read = !sample.power_w.is_nan();
        let commanded = !self.command_w.is_nan() & !sample.apart;
        let known = read & commanded;
        let counted = known & (self.known_s >= START_S);
        let known_s = (self.known_s + if known { period_s } else { 0.0 }).min(OWN_S);
        self.known_s = if commanded { known_s } else { 0.0 };
        let power_w = if counted { sample.power_w } else { 0.0 };
        let command_w = if counted { self.command_w } else { 0.0 };
        let added_s = if counted { period_s } else { 0.0 };
        let begun = self.known_s >= START_S;
        let add = |sum_s: &mut f32, mean_w: &mut f32, command: &mut f32, time_s: f32| {
            let before_s = if begun { *sum_s } else { 0.0 };
            let next_s = before_s + added_s;
            let weight = added_s / next_s.max(period_s);
            *mean_w += weight * (power_w - *mean_w);
            *command += weight * (command_w - *command);
            let keeps = time_s / (time_s + added_s);
            *sum_s = keeps * next_s;
        };
        add(&mut self.quick_s, &mut self.quick_w, &mut self.quick_command_w, MEANS_S[0]);
        add(&mut self.slow_s, &mut self.slow_w, &mut self.slow_command_w, MEANS_S[1]);
        self.command_w = sample.command_w;
        counted
    }

    /// The own level's line, and the robot's scatter.
    #[inline(always)]
    fn expected(&self, rules: &LevelRules) -> Expected {
        let own_w = self.own_w.abs().max(rules.floor_w);
        let ratio = self.own_w.max(0.0) / self.own_command_w.max(f32::MIN_POSITIVE);
        let like = (ratio >= 1.0 / UNLIKE) & (ratio <= UNLIKE);
        let unlike = rules.is_trained() & !like;
        let least = |prior: f32| {
            let of_platform =
                if unlike { prior.max(UNLIKE_SCATTER * UNLIKE_SCATTER) } else { prior };
            of_platform.max(LEAST * LEAST)
        };
        let variances = [
            self.quick_variance.max(least(rules.variances[0])),
            self.slow_variance.max(least(rules.variances[1])),
        ];
        let error = variances[0] * own_w * own_w * CORRELATED_S;
        let greater = ratio.max(1.0).min(f32::MAX);
        let prior = 4.0 / (greater * greater);
        let slope_variance = 1.0 / (prior + self.square / error);
        let half_way = 0.5 + 0.5 * ratio;
        let slope = slope_variance * (half_way * prior + self.product / error);
        let slope = slope.max(0.0).min(UNLIKE * greater);
        Expected { slope, slope_variance, ratio, own_w, variances }
    }

    /// The limit after the seconds of the own level.
    #[inline(always)]
    fn limit(&self, rules: &LevelRules) -> f32 {
        let square = self.own_s * self.own_s;
        rules.limit * (1.0 + LATER * square / (square + LATER_S * LATER_S))
    }

    /// Relative deviation of a mean from what is expected, and its variance.
    #[inline(always)]
    fn deviation(
        &self,
        rules: &LevelRules,
        expected: &Expected,
        (mean_w, command_w): (f32, f32),
        variance: f32,
    ) -> [f32; 2] {
        let apart_w = command_w - self.own_command_w;
        let expected_w = self.own_w + expected.slope * apart_w;
        let scale_w = (0.5 * expected.own_w + 0.5 * expected_w.max(0.0)).max(rules.floor_w);
        let per_w = 1.0 / scale_w;
        let apart = apart_w * per_w;
        let own_s = self.own_s.max(rules.period_s);
        let spread =
            variance + apart * apart * expected.slope_variance + variance * CORRELATED_S / own_s;
        [(mean_w - expected_w) * per_w, spread]
    }

    /// Deviation of the robot's own level, or of its slow mean while an alarm is raised, from the level
    /// of other robots, as a share of the limit. 0 if it is not judged.
    #[inline(always)]
    fn among(&self, rules: &LevelRules) -> f32 {
        let raised = self.is_raised();
        let power_w = if raised { self.slow_w } else { self.own_w };
        let command_w = if raised { self.slow_command_w } else { self.own_command_w };
        let expected_w = rules.among * command_w;
        let scale_w = (0.5 * (power_w.max(0.0) + expected_w)).max(rules.floor_w);
        let spread = rules.spread + rules.variances[1] * (MEANS_S[1] / self.own_s.max(AMONG_S));
        let share =
            (power_w - expected_w) / (scale_w * spread.sqrt() * (AMONG * self.limit(rules)));
        let accepted = self.raised & ACCEPTED != 0;
        let judged = (rules.among > 0.0) & (self.own_s >= AMONG_S) & !accepted;
        if judged { share } else { 0.0 }
    }

    /// Raises and clears: `high`, `low` and `among` are shares of the limit.
    #[inline(always)]
    fn decide(&mut self, settled: bool, (high, low): (f32, f32), among: f32) {
        let apart = if among.abs() > HALF { BY_OTHERS } else { 0 };
        let by_others = if self.is_raised() { self.raised & BY_OTHERS } else { apart };
        let judged = |share: f32, bit: u32| {
            let is_new = self.raised & bit == 0;
            let least = if is_new { 1.0 } else { HALF };
            if (share > least) & (!is_new | (self.beyond_s >= HOLD_S)) { bit } else { 0 }
        };
        let raised = judged(high, HIGH) | judged(low, LOW);
        let by_others = if raised == 0 { 0 } else { by_others };
        let others = self.raised & (KIND | ACCEPTED);
        self.raised = if settled { raised | by_others | others } else { self.raised };
    }

    /// True if the level itself is alarmed.
    #[inline(always)]
    const fn is_raised(&self) -> bool {
        self.raised & (HIGH | LOW) != 0
    }

    /// The alarm of a robot that has the model of another kind. A robot that has given back what it
    /// drew is none.
    #[inline(always)]
    fn kind(&mut self, rules: &LevelRules, ratio: f32) -> u32 {
        let most = if self.raised & KIND == 0 { UNLIKE } else { KIND_STAYS * UNLIKE };
        self.raised &= !KIND;
        let beyond = (ratio > most) | ((ratio > 0.0) & (ratio * most < 1.0));
        let raised = rules.is_trained() & (self.own_s >= KIND_S) & beyond;
        if raised { KIND } else { 0 }
    }

    /// What the robot shows to its platform, if it is known: its own level in the power of its
    /// commands.
    pub(crate) fn shown(&self) -> Option<f32> {
        let level = self.own_w.max(0.0) / self.own_command_w.max(f32::MIN_POSITIVE);
        Some(level).filter(|level| (self.own_s >= AMONG_S) & level.is_finite())
    }

    /// The own level takes the quick mean with the weight of `learned_s`.
    #[inline(always)]
    fn learn(&mut self, learned_s: f32) {
        let own_s = self.own_s + learned_s;
        let weight = learned_s / own_s.max(f32::MIN_POSITIVE);
        let command_w = self.quick_command_w - self.own_command_w;
        let power_w = self.quick_w - self.own_w;
        self.own_command_w += weight * command_w;
        self.own_w += weight * power_w;
        let added = learned_s * (1.0 - weight) * command_w;
        let keeps = OWN_S / (OWN_S + learned_s);
        self.square = keeps * (self.square + added * command_w);
        self.product = keeps * (self.product + added * power_w);
        self.own_s = keeps * own_s;
    }
}

impl LevelLanes {
    /// The alarms of the robot in a lane.
    #[inline(always)]
    pub(crate) fn alarms(&self, lane: usize) -> AlarmSet {
        AlarmSet(self.raised[lane] & !(ACCEPTED | BY_OTHERS))
    }

    /// The robot in a lane is compared with its level from now on.
    pub(crate) fn accept(&mut self, lane: usize) {
        let mut level = self.get(lane);
        level.accept();
        self.set(lane, true, level);
    }

    /// Takes the samples of the robots in the mask.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        rules: &LevelRules,
        mask: &Lanes<bool>,
        sample: impl Fn(usize) -> LevelSample,
    ) {
        // Copies, so that the compiler knows that nothing is aliased.
        let (mut copy, rules) = (*self, *rules);
        let (mut power_w, mut command_w, mut apart) = ([0.0; LANES], [0.0; LANES], [false; LANES]);
        for lane in 0..LANES {
            let sample = sample(lane);
            (power_w[lane], command_w[lane], apart[lane]) =
                (sample.power_w, sample.command_w, sample.apart);
        }
        for lane in 0..LANES {
            let mut level = copy.get(lane);
            let sample = LevelSample {
                power_w: power_w[lane],
                command_w: command_w[lane],
                apart: apart[lane],
            };
            level.observe(&rules, &sample);
            copy.set(lane, mask[lane], level);
        }
        *self = copy;
    }
}
