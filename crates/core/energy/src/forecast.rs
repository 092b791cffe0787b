//! The energy of a plan.

use crate::command::{CommandModel, Motion};
use crate::levels::{LEVELS, Level, NEWEST};
use crate::model::EnergyModel;
use crate::quantiles::{self, KNOTS};
use crate::ridge::{OUTSIDE_SHARE, Outside, Quantity, Ridge};
use crate::state::EnergyState;

/// Commands that a robot will follow, one for each step. The shorter of the two slices gives the
/// number of steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commands<'a> {
    /// Time that each command is in force, s, positive and finite.
    pub period_s: f32,
    /// Linear velocities, m/s.
    pub v_mps: &'a [f32],
    /// Angular velocities, rad/s.
    pub omega_radps: &'a [f32],
}

impl Commands<'_> {
    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.v_mps.len().min(self.omega_radps.len())
    }

    /// Time from the first step to the end of the last, s.
    pub fn duration_s(&self) -> f32 {
        self.steps() as f32 * self.period_s
    }

    /// True if a command moves the robot.
    fn move_robot(&self) -> bool {
        let mut all = self.v_mps.iter().zip(self.omega_radps);
        all.any(|(v_mps, omega_radps)| *v_mps != 0.0 || *omega_radps != 0.0)
    }

    fn get(&self, step: usize) -> (f32, f32) {
        (self.v_mps[step], self.omega_radps[step])
    }

    /// The motion of each step. `before` is the command before the first.
    fn motions(&self, before: (f32, f32)) -> impl Iterator<Item = Motion> {
        (0..self.steps()).map(move |step| {
            let previous = match step.checked_sub(1) {
                Some(previous) => self.get(previous),
                None => before,
            };
            Motion::new(self.get(step), previous, self.period_s)
        })
    }
}

/// Sums of the command model over the commands of a plan so far. With them, the energy of a plan
/// and of each of its prefixes costs one pass over the commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandSum {
    period_s: f32,
    steps: usize,
    power_w: f64,
    /// True if every command that matters is finite.
    is_known: bool,
    steps_outside: usize,
    ridge: RidgeSum,
    /// Of the commands outside the training data, the one that would need the greatest change.
    worst: Option<Worst>,
    /// Greatest absolute velocities, m/s and rad/s.
    fastest_mps: f32,
    fastest_radps: f32,
    /// The last command.
    last: (f32, f32),
}

/// Sums of the ridge regression, and those over the commands outside the training data.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct RidgeSum {
    all_w: f64,
    outside_w: f64,
    /// Of the command model over the commands outside.
    outside_command_w: f64,
    /// Deviations of the regression outside, in that of the farthest command of its training.
    spread: f64,
}

impl RidgeSum {
    const fn join(&mut self, next: &Self) {
        self.all_w += next.all_w;
        self.outside_w += next.outside_w;
        self.outside_command_w += next.outside_command_w;
        self.spread += next.spread;
    }
}

/// A quantity of a command that the training data lacks.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Worst {
    quantity: Quantity,
    value: f32,
    known: [f32; 2],
    /// Share of the speed at which it would be inside. 0 if none would do.
    share: f32,
}

impl Worst {
    fn worse(one: Option<Self>, other: Option<Self>) -> Option<Self> {
        match (one, other) {
            (Some(one), Some(other)) if other.share < one.share => Some(other),
            (None, other) => other,
            (one, _) => one,
        }
    }
}

impl CommandSum {
    /// Before the first command of a plan that begins now. Each command is in force for `period_s`.
    pub fn new(state: &EnergyState, period_s: f32) -> Self {
        Self::after(state.command(), period_s)
    }

    /// The empty sum before the next command while `command` (m/s, rad/s) is in force: a part of a
    /// plan for any robot.
    pub const fn after(command: (f32, f32), period_s: f32) -> Self {
        let ridge = RidgeSum { all_w: 0.0, outside_w: 0.0, outside_command_w: 0.0, spread: 0.0 };
        Self {
            period_s,
            steps: 0,
            power_w: 0.0,
            is_known: true,
            steps_outside: 0,
            ridge,
            worst: None,
            fastest_mps: 0.0,
            fastest_radps: 0.0,
            last: command,
        }
    }

    /// Adds a part that begins after this sum's last command, and has its period.
    pub fn join(&mut self, next: &Self) {
        self.steps += next.steps;
        self.power_w += next.power_w;
        self.is_known &= next.is_known;
        self.steps_outside += next.steps_outside;
        self.ridge.join(&next.ridge);
        self.worst = Worst::worse(self.worst, next.worst);
        self.fastest_mps = self.fastest_mps.max(next.fastest_mps);
        self.fastest_radps = self.fastest_radps.max(next.fastest_radps);
        self.last = next.last;
    }

    /// Adds the next commands, whose period must be that of the sum. Reads them once and allocates
    /// nothing.
    pub fn add(&mut self, model: &EnergyModel, next: Commands<'_>) {
        let reads_commands = model.command.reads_commands();
        let (mut power_w, mut known, mut outside) = (self.power_w, self.is_known, 0);
        for motion in next.motions(self.last) {
            let command_w = f64::from(model.command.power_w(&motion));
            power_w += command_w;
            known &= motion.is_known() | !reads_commands;
            self.fastest_mps = self.fastest_mps.max(motion.v_mps.abs());
            self.fastest_radps = self.fastest_radps.max(motion.omega_radps.abs());
            let (ridge_w, leverage) = model.ridge_w(&motion);
            self.ridge.all_w += f64::from(ridge_w);
            if reads_commands & model.lies_outside(&motion, leverage) {
                outside += 1;
                self.ridge.outside_w += f64::from(ridge_w);
                self.ridge.outside_command_w += command_w;
                self.ridge.spread += f64::from(Ridge::spread(leverage));
                self.worst = Worst::worse(self.worst, Some(model.worst(&motion, leverage)));
            }
        }
        (self.power_w, self.is_known) = (power_w, known);
        self.steps_outside += outside;
        let steps = next.steps();
        self.steps += steps;
        if let Some(last) = steps.checked_sub(1) {
            self.last = next.get(last);
        }
    }

    /// Time that each command is in force, s.
    pub const fn period_s(&self) -> f32 {
        self.period_s
    }

    /// Number of commands.
    pub const fn steps(&self) -> usize {
        self.steps
    }

    /// Time from the first command to the end of the last, s.
    pub fn duration_s(&self) -> f32 {
        self.steps as f32 * self.period_s
    }

    /// Number of commands that lie outside the training data.
    pub const fn steps_outside(&self) -> usize {
        self.steps_outside
    }

    /// True if a command moves the robot.
    pub const fn moves(&self) -> bool {
        self.fastest_mps > 0.0 || self.fastest_radps > 0.0
    }

    /// The quantity outside the training data that would need the greatest change.
    fn outside(&self) -> Option<Outside> {
        self.worst.map(|worst| Outside {
            quantity: worst.quantity,
            value: worst.value,
            known: worst.known,
            inside_at_mps: (worst.share > 0.0).then_some(worst.share * self.fastest_mps),
        })
    }
}

/// Energy of a plan, with the distribution of its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyForecast {
    /// Expected energy, J. NaN if a command that matters is not finite.
    pub energy_j: f32,
    /// Duration of the plan, s.
    pub duration_s: f32,
    /// Number of commands outside the training data. With any, the interval does not have its
    /// stated coverage.
    pub steps_outside: usize,
    /// What lies outside.
    pub outside: Option<Outside>,
    /// Lowest, expected and highest power of the commands outside the training data, W: the error of
    /// the regression so far away, within what was recorded and what the robot itself has drawn.
    /// `None` without such commands, and if the model does not know what was recorded.
    pub outside_w: Option<[f32; 3]>,
    /// Quantiles of measured minus forecast energy, J.
    errors_j: Option<[f32; KNOTS]>,
}

impl EnergyForecast {
    /// The energy below which the robot stays with probability `p`, J.
    ///
    /// `None` unless 0 < p < 1, and if errors are unknown: for a model without an energy model, and
    /// for commands that are not finite. Those of a plan that the model does not
    /// [cover](EnergyModel::covers) are extrapolated. For an interval of coverage c use (1 − c)/2 and (1 + c)/2.
    pub fn quantile_j(&self, p: f32) -> Option<f32> {
        let error_j = quantiles::quantile(self.errors_j.as_ref()?, p)?;
        Some(self.energy_j + error_j)
    }

    /// Probability that the energy is below an amount, 0 to 1: `energy_j`, with a normal error of
    /// standard deviation `sd_j`, which may be 0. `None` if [`EnergyForecast::quantile_j`] is, and
    /// for a NaN.
    pub fn probability_below(&self, energy_j: f32, sd_j: f32) -> Option<f32> {
        let errors_j = self.errors_j.as_ref()?;
        let probability = quantiles::probability(errors_j, energy_j - self.energy_j, sd_j);
        (!probability.is_nan()).then_some(probability)
    }
}

impl EnergyModel {
    /// The energy of a plan that begins now. Reads `plan` once and allocates nothing.
    pub fn forecast(&self, state: &EnergyState, plan: Commands<'_>) -> EnergyForecast {
        let mut sum = CommandSum::new(state, plan.period_s);
        sum.add(self, plan);
        self.forecast_of(state, &sum)
    }

    /// The energy of the plan that a sum is of. `state`: that which the sum began with. The fewer
    /// readings it has, the more the regression counts, whose error is that of left-out drives.
    pub fn forecast_of(&self, state: &EnergyState, sum: &CommandSum) -> EnergyForecast {
        let duration_s = sum.duration_s();
        let (level, changed) = state.level(self, duration_s);
        let share = self.ridge_share(state, duration_s, sum.moves());
        let (inside, outside) = (1.0 - f64::from(share), f64::from(OUTSIDE_SHARE * share));
        let (ridge, period_s) = (&sum.ridge, f64::from(sum.period_s));
        let command_j = period_s
            * (inside * (sum.power_w - ridge.outside_command_w)
                + (1.0 - outside) * ridge.outside_command_w);
        let steps = [sum.steps - sum.steps_outside, sum.steps_outside].map(|steps| steps as f64);
        // The robot's level is that of the regression's half outside the training, too.
        let level_s =
            period_s * (inside * steps[0] + (1.0 - outside + outside * inside) * steps[1]);
        let scale = f64::from(level_scale(&level, share));
        let ridge_w =
            f64::from(share) * (ridge.all_w - ridge.outside_w) + outside * scale * ridge.outside_w;
        let energy_j = f64::from(level.factor) * command_j
            + f64::from(level.added_w) * level_s
            + period_s * ridge_w
            + f64::from(self.hotel_w.unwrap_or(0.0) * duration_s);
        let energy_j = if sum.is_known { energy_j as f32 } else { f32::NAN };
        let known = energy_j.is_finite() && self.longest_s() > 0.0;
        EnergyForecast {
            energy_j,
            duration_s,
            steps_outside: sum.steps_outside,
            outside: sum.outside(),
            outside_w: self.outside_w(state, sum, &level, share),
            errors_j: known.then(|| {
                let (middle, half) = state.bounds_at(duration_s);
                let errors = self.errors_within(duration_s, middle, (1.0 + changed) * half);
                let left_out = self.ridge.as_ref().map_or(0.0, |ridge| ridge.left_out);
                let errors = Self::widened(errors, share * left_out);
                let scale_j = self.scale_j(energy_j, duration_s);
                errors.map(|error| error * scale_j)
            }),
        }
    }

    /// The power of each step of a plan, W, whose sum times the period is the energy of
    /// [`EnergyModel::forecast`] up to rounding. As with [`Iterator::zip`], steps beyond the
    /// shorter of plan and `power_w` are not written. An unknown command draws the platform's mean.
    pub fn power_w(&self, state: &EnergyState, plan: Commands<'_>, power_w: &mut [f32]) {
        let level = self.level(state, &plan);
        let motions = plan.motions(state.command());
        let hotel_w = self.hotel_w.unwrap_or(0.0);
        let inside = self.ridge_share(state, plan.duration_s(), plan.move_robot());
        for (power_w, motion) in power_w.iter_mut().zip(motions) {
            let command_w = self.command.power_w(&motion);
            let (ridge_w, leverage) = self.ridge_w(&motion);
            let (share, scale, added_w) = self.share(inside, &level, &motion, leverage);
            let level_w = level.factor * command_w + level.added_w;
            *power_w = level_w + share * (scale * ridge_w + added_w - level_w) + hotel_w;
        }
    }

    /// Derivatives of the energy with respect to each command of a plan: J per m/s into `by_v`, and
    /// J per rad/s into `by_omega`. As with [`Iterator::zip`], steps beyond the shortest of plan
    /// and slices are not written.
    pub fn gradient(
        &self,
        state: &EnergyState,
        plan: Commands<'_>,
        by_v: &mut [f32],
        by_omega: &mut [f32],
    ) {
        let level = self.level(state, &plan);
        let inside = self.ridge_share(state, plan.duration_s(), plan.move_robot());
        let whole = if self.command.reads_commands() { level.factor * plan.period_s } else { 0.0 };
        let steps = by_v.len().min(by_omega.len());
        for (step, motion) in plan.motions(state.command()).enumerate() {
            let [v, omega, dv, domega] = self.command.slopes(&motion);
            let (ridge_w, leverage) = self.ridge_w(&motion);
            let (share, of_ridge, _) = self.share(inside, &level, &motion, leverage);
            let scale = (1.0 - share) * whole;
            let of_ridge = share * of_ridge * plan.period_s;
            let [ridge_v, ridge_omega] = match (&self.ridge, self.recorded_w) {
                // A bound has no slope.
                (_, Some([lowest, highest])) if !(lowest < ridge_w && ridge_w < highest) => {
                    [0.0; 2]
                }
                (Some(ridge), _) => {
                    ridge.slopes(&self.command, &motion).map(|slope| of_ridge * slope)
                }
                _ => [0.0; 2],
            };
            let changed = |slope: f32| slope / plan.period_s;
            // The next command changes from this one.
            if let Some(before) = step.checked_sub(1).filter(|before| *before < steps) {
                by_v[before] -= scale * changed(dv);
                by_omega[before] -= scale * changed(domega);
            }
            if step < steps {
                // Without a command before the first step there is no change.
                let known = step > 0 || state.command().0.is_finite();
                let (dv, domega) = if known { (dv, domega) } else { (0.0, 0.0) };
                by_v[step] = scale * (v + changed(dv)) + ridge_v;
                by_omega[step] = scale * (omega + changed(domega)) + ridge_omega;
            }
        }
    }

    fn level(&self, state: &EnergyState, plan: &Commands<'_>) -> Level {
        state.level(self, plan.duration_s()).0
    }

    /// True if the training data has no such motion: a velocity, or a change of one, beyond its
    /// range. Their product is not compared. Both factors are within their ranges, and recordings
    /// that drive and turn alternately would otherwise exclude every robot that turns while it
    /// drives.
    #[inline(always)]
    fn is_outside(&self, motion: &Motion) -> bool {
        let within = |[lowest, highest]: [f32; 2], value: f32| lowest <= value && value <= highest;
        let mut inside =
            within(self.v_mps, motion.v_mps) & within(self.omega_radps, motion.omega_radps);
        let highest = self.combined.unwrap_or_default();
        let terms = CommandModel::combined_terms(motion.to_array());
        for (term, highest) in terms.iter().zip(highest).skip(1) {
            inside &= *term <= REACH * highest;
        }
        !inside
    }

    /// True if a motion is outside the training data by itself, or by its leverage.
    #[inline(always)]
    fn lies_outside(&self, motion: &Motion, leverage: f32) -> bool {
        let is_near = leverage <= REACH;
        self.is_outside(motion) | !is_near
    }

    /// The regression's power of a motion, W, and its leverage. 0 without a regression. The power is
    /// within what was recorded.
    #[inline(always)]
    fn ridge_w(&self, motion: &Motion) -> (f32, f32) {
        let Some(ridge) = &self.ridge else { return (0.0, 0.0) };
        if !motion.is_known() {
            return (self.command.mean_w, 0.0);
        }
        let deviations = ridge.deviations(&self.command, motion.v_mps, motion.omega_radps);
        let power_w = ridge.power_w(&deviations);
        let [lowest, highest] = self.recorded_w.unwrap_or([f32::MIN, f32::MAX]);
        (power_w.max(lowest).min(highest), ridge.leverage(&deviations))
    }

    /// Share of the regression in the power of commands inside the training data. The more exact the
    /// model is with a level, and the farther that lies from the training's, the less the regression
    /// counts. The level of a robot at rest tells a plan that moves nothing.
    fn ridge_share(&self, state: &EnergyState, duration_s: f32, moves: bool) -> f32 {
        let Some(ridge) = &self.ridge else { return 0.0 };
        let metered = &state.metered;
        let (energy_j, time_s) = (metered.command_j[LEVELS - 1], metered.time_s[LEVELS - 1]);
        let rest_w = self.command.weights[0];
        let above_w = (self.command.mean_w - rest_w).max(f32::MIN_POSITIVE);
        let driven = ((energy_j / time_s - rest_w) / above_w).clamp(0.0, 1.0);
        let read_s = if moves && driven < 1.0 { driven * time_s } else { time_s };
        let (_, half) = quantiles::middle_and_half(&self.errors_at(duration_s));
        let level = metered.energy_j[LEVELS - 1] / energy_j;
        ridge.share((if time_s > 0.0 { read_s } else { 0.0 }, level), half)
    }

    /// The one or the other, and of the regression's power the factor and what is added to it, W.
    fn share(&self, inside: f32, level: &Level, motion: &Motion, leverage: f32) -> (f32, f32, f32) {
        match self.lies_outside(motion, leverage) {
            true => {
                let added_w = (1.0 - inside) * level.added_w;
                (OUTSIDE_SHARE * inside, level_scale(level, inside), added_w)
            }
            false => (inside, 1.0, 0.0),
        }
    }

    /// See [`EnergyForecast::outside_w`]. `share` of the regression's error is that of every command.
    fn outside_w(
        &self,
        state: &EnergyState,
        sum: &CommandSum,
        level: &Level,
        share: f32,
    ) -> Option<[f32; 3]> {
        let [mut lowest, mut highest] = self.recorded_w.filter(|_| sum.steps_outside > 0)?;
        // A robot that draws more than its platform does so under every command.
        (lowest, highest) =
            (lowest * level.factor.clamp(0.0, 1.0), highest * level.factor.max(1.0));
        let [command_w, ridge_w, spread] =
            [sum.ridge.outside_command_w, sum.ridge.outside_w, sum.ridge.spread]
                .map(|all| (all / sum.steps_outside as f64) as f32);
        let level_w = level.factor * command_w + level.added_w;
        let ridge_w = level_scale(level, share) * ridge_w + (1.0 - share) * level.added_w;
        let expected_w = level_w + OUTSIDE_SHARE * share * (ridge_w - level_w);
        if let Some(ridge) = &self.ridge {
            let error_w = ridge.left_out * (spread - share).max(0.0) * expected_w.abs();
            (lowest, highest) =
                (lowest.max(expected_w - error_w), highest.min(expected_w + error_w));
        }
        // Means over long enough that a moment does not count.
        let metered = state.metered.energy_j.iter().zip(state.metered.time_s).skip(NEWEST);
        for (energy_j, time_s) in metered.filter(|(_, time_s)| *time_s > 0.0) {
            (lowest, highest) = (lowest.min(energy_j / time_s), highest.max(energy_j / time_s));
        }
        let bounds = [lowest.min(expected_w), expected_w, highest.max(expected_w)];
        bounds.iter().all(|power_w| power_w.is_finite()).then_some(bounds)
    }

    /// The quantity of a motion outside the training data that would need the greatest change, and
    /// the share of the speed at which it would be inside.
    #[cold]
    fn worst(&self, motion: &Motion, leverage: f32) -> Worst {
        let drives = motion.v_mps != 0.0;
        let mut worst = None;
        let mut consider = |quantity, value: f32, [lowest, highest]: [f32; 2], power: f32| {
            if lowest <= value && value <= highest {
                return;
            }
            let bound = if value > highest { highest } else { lowest };
            let share = bound / value;
            // A speed of 0 is no advice, and a turn on the spot does not depend on the speed.
            let mends = drives && lowest <= 0.0 && 0.0 <= highest && share > 0.0;
            let share = if !mends {
                0.0
            } else if power == 0.5 {
                share.sqrt()
            } else {
                share
            };
            let known = [lowest, highest];
            worst = Worst::worse(worst, Some(Worst { quantity, value, known, share }));
        };
        consider(Quantity::Velocity, motion.v_mps, self.v_mps, 1.0);
        consider(Quantity::AngularVelocity, motion.omega_radps, self.omega_radps, 1.0);
        let highest = self.combined.unwrap_or_default().map(|highest| REACH * highest);
        let [_, faster_v, faster_omega, dv, domega] =
            CommandModel::combined_terms(motion.to_array());
        consider(Quantity::Acceleration, faster_v, [0.0, highest[1]], 0.5);
        consider(Quantity::AngularAcceleration, faster_omega, [0.0, highest[2]], 0.5);
        consider(Quantity::VelocityChange, dv, [0.0, highest[3]], 1.0);
        consider(Quantity::AngularVelocityChange, domega, [0.0, highest[4]], 1.0);
        // Commands that are not finite are outside every range.
        let known = [0.0, 1.0];
        worst.unwrap_or_else(|| Worst {
            quantity: Quantity::Together,
            value: leverage.sqrt(),
            known,
            share: if drives { self.inside_share(motion) } else { 0.0 },
        })
    }

    /// Greatest share of a motion's speed whose leverage is within the training's, to a hundredth.
    /// 0 if there is none. Shares between two quarters outside are not looked at, so that it costs
    /// at most nine leverages.
    fn inside_share(&self, motion: &Motion) -> f32 {
        let is_inside = |percent: &i32| {
            let share = 0.01 * *percent as f32;
            let (v_mps, omega_radps) = (share * motion.v_mps, share * motion.omega_radps);
            self.ridge_w(&Motion { v_mps, omega_radps, ..*motion }).1 <= REACH
        };
        let Some(mut inside) = [75, 50, 25, 1].into_iter().find(is_inside) else { return 0.0 };
        let mut outside = 25 * (inside / 25 + 1);
        while outside - inside > 1 {
            let middle = (inside + outside) / 2;
            if is_inside(&middle) { inside = middle } else { outside = middle }
        }
        0.01 * inside as f32
    }
}

/// Factor of the regression's power outside the training: the robot's level, as far as it is known.
fn level_scale(level: &Level, share: f32) -> f32 {
    level.factor + share * (1.0 - level.factor)
}

/// Tolerance for the time step, by which changes are divided: plans have other time steps than
/// recordings. The Robotarium's are 33 ms, those of a platform at 30 Hz 1 % longer.
const REACH: f32 = 1.05;
