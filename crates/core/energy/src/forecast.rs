//! The energy of a plan.

use crate::command::{CommandModel, Motion};
use crate::levels::Level;
use crate::model::EnergyModel;
use crate::quantiles::{self, KNOTS};
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
    /// The last command.
    last: (f32, f32),
}

impl CommandSum {
    /// Before the first command of a plan that begins now. Each command is in force for `period_s`.
    pub fn new(state: &EnergyState, period_s: f32) -> Self {
        Self::after(state.command(), period_s)
    }

    /// The empty sum before the next command while `command` (m/s, rad/s) is in force: a part of a
    /// plan for any robot.
    pub const fn after(command: (f32, f32), period_s: f32) -> Self {
        Self { period_s, steps: 0, power_w: 0.0, is_known: true, steps_outside: 0, last: command }
    }

    /// Adds a part that begins after this sum's last command, and has its period.
    pub fn join(&mut self, next: &Self) {
        self.steps += next.steps;
        self.power_w += next.power_w;
        self.is_known &= next.is_known;
        self.steps_outside += next.steps_outside;
        self.last = next.last;
    }

    /// Adds the next commands, whose period must be that of the sum. Reads them once and allocates
    /// nothing.
    pub fn add(&mut self, model: &EnergyModel, next: Commands<'_>) {
        let reads_commands = model.command.reads_commands();
        let (mut power_w, mut known, mut outside) = (self.power_w, self.is_known, 0);
        for motion in next.motions(self.last) {
            power_w += f64::from(model.command.power_w(&motion));
            known &= motion.is_known() | !reads_commands;
            outside += usize::from(reads_commands & model.is_outside(&motion));
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

    /// The energy of the plan that a sum is of. `state`: that which the sum began with.
    pub fn forecast_of(&self, state: &EnergyState, sum: &CommandSum) -> EnergyForecast {
        let duration_s = sum.duration_s();
        let (level, changed) = state.level(self, duration_s);
        let command_j = sum.power_w * f64::from(sum.period_s);
        let energy_j =
            f64::from(level.factor) * command_j + f64::from(level.added_w) * f64::from(duration_s);
        let energy_j = if sum.is_known { energy_j as f32 } else { f32::NAN };
        let known = energy_j.is_finite() && self.longest_s() > 0.0;
        EnergyForecast {
            energy_j,
            duration_s,
            steps_outside: sum.steps_outside,
            errors_j: known.then(|| {
                let (middle, half) = state.bounds_at(duration_s);
                let errors = self.errors_within(duration_s, middle, (1.0 + changed) * half);
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
        for (power_w, motion) in power_w.iter_mut().zip(motions) {
            let command_w = self.command.power_w(&motion);
            *power_w = level.factor * command_w + level.added_w;
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
        let scale = if self.command.reads_commands() { level.factor * plan.period_s } else { 0.0 };
        let steps = by_v.len().min(by_omega.len());
        for (step, motion) in plan.motions(state.command()).enumerate() {
            let [v, omega, dv, domega] = self.command.slopes(&motion);
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
                by_v[step] = scale * (v + changed(dv));
                by_omega[step] = scale * (omega + changed(domega));
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
        /// Tolerance for the time step, by which changes are divided: plans have other time steps
        /// than recordings. The Robotarium's are 33 ms, those of a platform at 30 Hz 1 % longer.
        const REACH: f32 = 1.05;
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
}
