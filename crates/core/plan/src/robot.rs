//! One robot's answers.

use joulebus_energy::{
    CommandSum, Commands, EnergyLeft, EnergyModel, EnergyState, ErrorBounds, LEVELS, Learned,
    Metered, SHADOWS,
};
use joulebus_wire::{
    Budget, BudgetHeader, PlanState, PlanStateHeader, Quality, budget_flag, plan_state_flag,
};

use crate::answer::{Answer, Caveats, Doubts, Left, Range, Unknown, Verdict};
use crate::candidates::{Candidates, part};
use crate::error::AskError;
use crate::estimate::{Estimate, Progress};
use crate::limits::{COVERAGE, MAX_STEPS};
use crate::platform::{Frames, Platform};

/// Ticks after which a frame is stale.
const STALE_TICKS: u64 = 2;

/// A robot in one frame: a checked copy of its rows, for questions in any thread.
///
/// It answers for the time of its view, however long it is kept. A [`Verdict::Yes`] does not cover
/// events since then. Take a new view (`joulebus_planner::Planner::view`) before the next
/// questions, and after long questions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robot<'a> {
    platform: &'a Platform,
    id: u32,
    energy: EnergyState,
    /// Reason that the robot's energy is unknown, if it is.
    unknown: Option<Unknown>,
    no_reading: bool,
    outside_training: bool,
    alarms: Doubts,
    battery: Result<Battery, Unknown>,
}

/// The contents of a battery, J.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Battery {
    left_j: f32,
    left_lo_j: f32,
    /// Above the reserve.
    usable_j: f32,
    usable_lo_j: f32,
    /// Same as `usable_j`, but negative below the reserve, with its error.
    spare: EnergyLeft,
    /// Of the monitor that will count the plan's energy.
    counting_sd: f64,
}

impl<'a> Robot<'a> {
    pub(crate) fn new(platform: &'a Platform, frames: &Frames<'_>) -> Self {
        let state = frames.state;
        let energy = energy_state(state);
        let unknown = unknown(frames.header, state, &energy, frames.now_ns);
        Self {
            platform,
            id: state.robot,
            energy,
            unknown,
            no_reading: state.open_steps > 0,
            outside_training: state.flags & plan_state_flag::OUTSIDE_TRAINING != 0,
            alarms: Doubts::from_state(state.flags),
            battery: battery(platform, frames),
        }
    }

    /// Its id.
    #[must_use]
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Its platform.
    #[must_use]
    pub const fn platform(&self) -> &'a Platform {
        self.platform
    }

    /// Reason that the robot's energy is unknown, if it is.
    #[must_use]
    pub const fn unknown(&self) -> Option<Unknown> {
        self.unknown
    }

    /// The state on which its energy forecasts are based.
    #[must_use]
    pub const fn energy_state(&self) -> &EnergyState {
        &self.energy
    }

    /// The energy of each candidate, and whether the robot makes it. `coverage`: of the intervals,
    /// 0.5 to 0.999.
    ///
    /// # Errors
    /// A command that is not finite or beyond the platform's limits, or another coverage.
    pub fn what_if(
        &self,
        candidates: &Candidates<'_>,
        coverage: f32,
    ) -> Result<Vec<Answer>, AskError> {
        self.check(candidates, coverage)?;
        let answer = |commands| self.answer(&Legs::none(commands), coverage);
        Ok(candidates.iter().map(answer).collect())
    }

    /// Same as [`Robot::what_if`], into memory of the caller. Allocates nothing.
    ///
    /// # Errors
    /// Those of [`Robot::what_if`], or `answers` has another length than there are candidates.
    pub fn what_if_into(
        &self,
        candidates: &Candidates<'_>,
        coverage: f32,
        answers: &mut [Answer],
    ) -> Result<(), AskError> {
        self.check(candidates, coverage)?;
        results(answers.len(), candidates.count())?;
        for (answer, commands) in answers.iter_mut().zip(candidates.iter()) {
            *answer = self.answer(&Legs::none(commands), coverage);
        }
        Ok(())
    }

    /// The power of every step, W, candidate by candidate: `power_w` has `count * steps` elements.
    /// Its sum times the period is the energy's mean, up to rounding. NaN if the robot's state is
    /// unknown.
    ///
    /// # Errors
    /// Those of [`Robot::what_if`], or `power_w` has another length.
    pub fn power_w(
        &self,
        candidates: &Candidates<'_>,
        power_w: &mut [f32],
    ) -> Result<(), AskError> {
        self.check(candidates, COVERAGE.0)?;
        results(power_w.len(), candidates.count() * candidates.steps())?;
        if self.unknown.is_some() {
            power_w.fill(f32::NAN);
            return Ok(());
        }
        let traces = power_w.chunks_exact_mut(candidates.steps());
        for (trace, commands) in traces.zip(candidates.iter()) {
            self.model().power_w(&self.energy, commands, trace);
        }
        Ok(())
    }

    /// Derivatives of each candidate's energy with respect to its commands: J per m/s and J per
    /// rad/s, in the order of the commands. NaN if the robot's state is unknown.
    ///
    /// # Errors
    /// Those of [`Robot::power_w`].
    pub fn gradient(
        &self,
        candidates: &Candidates<'_>,
        by_v: &mut [f32],
        by_omega: &mut [f32],
    ) -> Result<(), AskError> {
        self.check(candidates, COVERAGE.0)?;
        let (steps, places) = (candidates.steps(), candidates.count() * candidates.steps());
        results(by_v.len(), places)?;
        results(by_omega.len(), places)?;
        if self.unknown.is_some() {
            by_v.fill(f32::NAN);
            by_omega.fill(f32::NAN);
            return Ok(());
        }
        let slopes = by_v.chunks_exact_mut(steps).zip(by_omega.chunks_exact_mut(steps));
        for ((by_v, by_omega), commands) in slopes.zip(candidates.iter()) {
            self.model().gradient(&self.energy, commands, by_v, by_omega);
        }
        Ok(())
    }

    /// The energy of standing still for a time, s.
    ///
    /// # Errors
    /// A duration or coverage that is not allowed.
    pub fn idle(&self, duration_s: f32, coverage: f32) -> Result<Answer, AskError> {
        self.idle_along(duration_s, coverage, 0).map(|(answer, _)| answer)
    }

    /// Same as [`Robot::idle`], with the answers to its parts up to evenly spaced moments, of which the
    /// last is the end.
    pub(crate) fn idle_along(
        &self,
        duration_s: f32,
        coverage: f32,
        moments: usize,
    ) -> Result<(Answer, Vec<Answer>), AskError> {
        let period_s = self.period_s();
        let allowed = period_s * MAX_STEPS as f32;
        if !(duration_s > 0.0 && duration_s <= allowed) {
            return Err(AskError::Duration { found: duration_s, allowed });
        }
        let steps = (duration_s / period_s).round().max(1.0) as usize;
        let rest = vec![0.0; steps];
        let period_s = duration_s / steps as f32;
        self.check(&Candidates::new(1, period_s, &rest, &rest)?, coverage)?;
        let legs = Legs::none(Commands { period_s, v_mps: &rest, omega_radps: &rest });
        Ok((self.answer(&legs, coverage), self.along(&legs, coverage, moments)))
    }

    pub(crate) fn period_s(&self) -> f32 {
        self.platform.settings.period_ns as f32 * 1e-9
    }

    fn model(&self) -> &'a EnergyModel {
        &self.platform.energy
    }

    pub(crate) fn check(&self, candidates: &Candidates<'_>, coverage: f32) -> Result<(), AskError> {
        if !(COVERAGE.0 <= coverage && coverage <= COVERAGE.1) {
            return Err(AskError::Coverage { found: coverage });
        }
        let settings = &self.platform.settings;
        candidates.check(&settings.name, (settings.v_max_mps, settings.omega_max_radps))
    }

    /// The answer to checked commands.
    pub(crate) fn answer(&self, legs: &Legs<'_>, coverage: f32) -> Answer {
        let mut walk = Walk::new(self, legs);
        let (_, before_last) = legs.ends.split_last().unwrap_or((&0, &[]));
        let mut limiting_leg = None;
        for (leg, end) in before_last.iter().enumerate() {
            walk.to(*end);
            // A leg at the first point takes no step, and so no energy.
            if limiting_leg.is_none() && *end > 0 && !self.makes(&walk.at.progress, coverage) {
                limiting_leg = Some(leg);
            }
        }
        walk.to(legs.commands.steps());
        let answer = self.answer_at(&walk.at.progress, legs, coverage);
        let verdict = match answer.verdict {
            // Intervals need not widen from leg to leg.
            Verdict::Yes if limiting_leg.is_some() => Verdict::Tight,
            Verdict::Unknown(_) | Verdict::Yes => return answer,
            verdict => verdict,
        };
        let last_leg = legs.ends.len().saturating_sub(1);
        Answer { verdict, limiting_leg: limiting_leg.or(Some(last_leg)), ..answer }
    }

    /// The answers to the parts of a plan up to evenly spaced moments, of which the last is the end.
    pub(crate) fn along(&self, legs: &Legs<'_>, coverage: f32, moments: usize) -> Vec<Answer> {
        let mut walk = Walk::new(self, legs);
        let answers = moments_of(legs.commands.steps(), moments).map(|step| {
            walk.to(step);
            self.answer_at(&walk.at.progress, legs, coverage)
        });
        answers.collect()
    }

    /// The answer to a plan as far as it has been followed.
    fn answer_at(&self, progress: &Progress, legs: &Legs<'_>, coverage: f32) -> Answer {
        let nothing = self.nothing(progress.sum.duration_s());
        if self.unknown.is_some() {
            return nothing;
        }
        let estimate = self.estimate(progress, coverage);
        let Some(energy) = estimate.energy() else {
            return Answer { verdict: Verdict::Unknown(Unknown::NoLevel), ..nothing };
        };
        let caveats = Caveats { late_s: legs.late_s.ceil() as u16, ..estimate.caveats };
        let answer = Answer { energy: Some(energy), caveats, ..nothing };
        let battery = match self.battery {
            Ok(battery) => battery,
            Err(reason) => {
                return Answer { verdict: Verdict::Unknown(reason), ..answer };
            }
        };
        Answer {
            left: Some(Left {
                mean_j: (battery.left_j - energy.mean_j).max(0.0),
                lo_j: (battery.left_lo_j - battery.at_most_j(&energy)).max(0.0),
            }),
            // Nobody knows how wrong a doubtful state is.
            probability: if answer.caveats.bar_yes() {
                None
            } else {
                estimate.probability_below(battery.spare.left as f32, battery.sd_after_j(&energy))
            },
            margin_j: Some(battery.usable_lo_j - battery.at_most_j(&energy)),
            verdict: verdict(&battery, &energy, estimate.caveats),
            ..answer
        }
    }

    /// The sum over a way back, for any robot of the platform, but for its first command. Docking is
    /// part of it.
    pub(crate) fn rest(&self, way: Commands<'_>) -> Progress {
        let first = (way.v_mps[0], way.omega_radps[0]);
        let mut rest = Progress::new(CommandSum::after(first, way.period_s));
        rest.add(self.model(), part(way, 1, way.steps()), 0.0);
        rest.added_j += self.docking_j();
        rest
    }

    /// Energy of docking, J.
    pub(crate) fn docking_j(&self) -> f64 {
        self.platform.settings.battery.as_ref().map_or(0.0, |battery| battery.docking_j)
    }

    /// True if the verdict on a plan, as far as it has been followed, is [`Verdict::Yes`].
    pub(crate) fn makes(&self, progress: &Progress, coverage: f32) -> bool {
        let (None, Ok(battery)) = (self.unknown, self.battery) else {
            return false;
        };
        let estimate = self.estimate(progress, coverage);
        let energy = estimate.energy();
        energy.is_some_and(|energy| verdict(&battery, &energy, estimate.caveats) == Verdict::Yes)
    }

    /// The energy of the followed part, widened where the model's errors do not cover it.
    fn estimate(&self, progress: &Progress, coverage: f32) -> Estimate {
        let settings = &self.platform.settings;
        let possible_w = [settings.power_min_w, settings.power_max_w];
        let mut estimate = progress.estimate(self.model(), &self.energy, possible_w, coverage);
        estimate.caveats = Caveats {
            no_reading: self.no_reading,
            state_outside_training: self.outside_training,
            alarms: self.alarms,
            ..estimate.caveats
        };
        estimate
    }

    /// The caveats of its answers to every plan.
    fn caveats(&self) -> Caveats {
        Caveats {
            no_reading: self.no_reading,
            state_outside_training: self.outside_training,
            alarms: self.alarms,
            ..Caveats::default()
        }
    }

    fn nothing(&self, duration_s: f32) -> Answer {
        Answer {
            duration_s,
            verdict: Verdict::Unknown(self.unknown.unwrap_or(Unknown::NoLevel)),
            caveats: self.caveats(),
            ..Answer::UNKNOWN
        }
    }
}

/// The last step of each of evenly spaced parts of a plan.
pub(crate) fn moments_of(steps: usize, moments: usize) -> impl Iterator<Item = usize> {
    let at = move |moment: usize| (steps as u64 * moment as u64 / moments as u64) as usize;
    (1..=moments).map(move |moment| at(moment).max(1))
}

/// The commands of a plan, and what its legs add.
#[derive(Clone, Copy)]
pub(crate) struct Legs<'a> {
    pub(crate) commands: Commands<'a>,
    /// Steps after which each leg ends.
    pub(crate) ends: &'a [usize],
    /// Power that each leg adds, W. None where it is shorter.
    pub(crate) load_w: &'a [f32],
    /// Steps before the first leg drives, and the power that they add, W.
    pub(crate) start: (usize, f32),
    /// Energy at the end, J.
    pub(crate) docking_j: f64,
    /// The longest delay, s.
    pub(crate) late_s: f32,
    /// Sums from the second step up to the steps at which a walk stops, in their order.
    pub(crate) marks: &'a [Mark],
}

impl<'a> Legs<'a> {
    /// A plan without legs.
    pub(crate) const fn none(commands: Commands<'a>) -> Self {
        Self {
            commands,
            ends: &[],
            load_w: &[],
            start: (0, 0.0),
            docking_j: 0.0,
            late_s: 0.0,
            marks: &[],
        }
    }
}

/// A plan as far as a walk has come.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mark {
    pub(crate) progress: Progress,
    /// Power that the load of the last step adds, W.
    pub(crate) load_w: f32,
    done: usize,
    leg: usize,
}

/// Follows a plan from step to step.
pub(crate) struct Walk<'a> {
    robot: &'a Robot<'a>,
    legs: &'a Legs<'a>,
    pub(crate) at: Mark,
    /// The first step, which alone depends on the robot, if the plan has marks.
    first: Option<Progress>,
}

impl<'a> Walk<'a> {
    pub(crate) fn new(robot: &'a Robot<'a>, legs: &'a Legs<'a>) -> Self {
        let sum = CommandSum::new(&robot.energy, legs.commands.period_s);
        let at = Mark { progress: Progress::new(sum), load_w: 0.0, done: 0, leg: 0 };
        let first = (!legs.marks.is_empty()).then(|| {
            let mut first = Self { robot, legs, at, first: None };
            first.to(1);
            first.at.progress
        });
        Self { robot, legs, at, first }
    }

    /// The marks of a plan at some steps, ascending, for all robots of a platform.
    pub(crate) fn marks(
        robot: &Robot<'_>,
        legs: &Legs<'_>,
        steps: impl Iterator<Item = usize>,
    ) -> Vec<Mark> {
        let mut walk = Walk::new(robot, legs);
        walk.to(1);
        let command = (legs.commands.v_mps[0], legs.commands.omega_radps[0]);
        walk.at.progress = Progress::new(CommandSum::after(command, legs.commands.period_s));
        let marks = steps.map(|step| {
            walk.to(step);
            walk.at
        });
        marks.collect()
    }

    /// Follows the plan up to a step, at most its last.
    pub(crate) fn to(&mut self, step: usize) {
        let steps = self.legs.commands.steps();
        if let Some(first) = self.first
            && let Ok(mark) = self.legs.marks.binary_search_by_key(&step, |mark| mark.done)
        {
            self.at = self.legs.marks[mark];
            let rest = std::mem::replace(&mut self.at.progress, first);
            self.at.progress.join(&rest);
        }
        let at = &mut self.at;
        while at.done < step.min(steps) {
            let leg_end = self.legs.ends.get(at.leg).copied().unwrap_or(steps);
            let (started, start_load_w) = self.legs.start;
            let (end, load_w) = match at.done < started {
                true => (started.min(leg_end), start_load_w),
                false => (leg_end, self.legs.load_w.get(at.leg).copied().unwrap_or(0.0)),
            };
            let next = step.min(steps).min(end.max(at.done));
            let commands = part(self.legs.commands, at.done, next);
            at.progress.add(self.robot.model(), commands, load_w);
            at.load_w = if next > at.done { load_w } else { at.load_w };
            (at.done, at.leg) = (next, at.leg + usize::from(next >= leg_end));
            if next == steps {
                at.progress.added_j += self.legs.docking_j;
            }
        }
    }
}

impl Battery {
    /// Standard deviation of its energy after a plan. The monitor has the same error during the plan
    /// as before it. How much of the error before is the monitor's is known roughly, so regenerated
    /// energy does not undo it.
    fn sd_after_j(&self, energy: &Range) -> f32 {
        let amount_j = energy.mean_j.abs().into();
        self.spare.after_drawing(amount_j, self.counting_sd).whole_sd() as f32
    }

    /// Upper bound of what a plan takes from the lower bound of the energy left: its upper end, and
    /// the error of counting it.
    fn at_most_j(&self, energy: &Range) -> f32 {
        energy.hi_j + EnergyLeft::counting_error(energy.mean_j.into(), self.counting_sd) as f32
    }
}

fn verdict(battery: &Battery, energy: &Range, caveats: Caveats) -> Verdict {
    if battery.at_most_j(energy) <= battery.usable_lo_j && !caveats.bar_yes() {
        Verdict::Yes
    } else if energy.mean_j <= battery.usable_j {
        Verdict::Tight
    } else {
        Verdict::No
    }
}

fn results(found: usize, allowed: usize) -> Result<(), AskError> {
    if found == allowed { Ok(()) } else { Err(AskError::Results { found, allowed }) }
}

fn energy_state(state: &PlanState) -> EnergyState {
    const _: () = assert!(LEVELS == 4 && SHADOWS == 3);
    EnergyState {
        metered: Metered {
            energy_j: state.energy_j,
            command_j: state.command_j,
            time_s: state.time_s,
            v_mps: state.v_mps,
            omega_radps: state.omega_radps,
            ..EnergyState::new(0).metered
        },
        learned: Learned { command_trust: state.command_trust, ..Learned::new() },
        bounds: ErrorBounds { lower: state.error_lower, upper: state.error_upper },
    }
}

/// The age of a stale frame. A frame from the future, by a clock that is not the worker's, has no
/// known age.
pub(crate) fn stale(header: &PlanStateHeader, now_ns: u64) -> Option<Unknown> {
    let age_ns = now_ns.abs_diff(header.sent_ns);
    (age_ns > header.period_ns.saturating_mul(STALE_TICKS)).then_some(Unknown::Stale { age_ns })
}

/// Reason that a robot's energy is unknown, if it is.
fn unknown(
    header: &PlanStateHeader,
    state: &PlanState,
    energy: &EnergyState,
    now_ns: u64,
) -> Option<Unknown> {
    if let Some(stale) = stale(header, now_ns) {
        return Some(stale);
    }
    match state.quality() {
        Quality::Invalid(reason) => return Some(Unknown::Invalid { reason }),
        Quality::Warmup { have } => return Some(Unknown::Warmup { have }),
        Quality::Fresh | Quality::Held | Quality::OpenLoop { .. } => {}
        _ => return Some(Unknown::Unreadable),
    }
    let has_sample = state.flags & plan_state_flag::SAMPLE != 0;
    let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
    let (metered, learned) = (&energy.metered, &energy.learned);
    let known = has_sample
        && metered.time_s.iter().all(|time_s| *time_s > 0.0)
        && finite(&metered.energy_j)
        && finite(&metered.command_j)
        && finite(&metered.time_s)
        && energy.bounds.is_sound()
        && (0.0..=1.0).contains(&learned.command_trust);
    (!known).then_some(Unknown::NoLevel)
}

/// The contents of the battery by a budget that is as new as the robot's state.
fn battery(platform: &Platform, frames: &Frames<'_>) -> Result<Battery, Unknown> {
    let Some(settings) = &platform.settings.battery else {
        return Err(Unknown::NoBattery);
    };
    let (header, state) = (frames.header, frames.state);
    let budget = frames.budget.filter(|(of, row)| is_current(header, state, of, row));
    let (of, budget) = budget.ok_or(Unknown::NoBudget)?;
    let age_ns = frames.now_ns.abs_diff(of.sent_ns);
    if age_ns > header.period_ns.saturating_mul(STALE_TICKS) {
        return Err(Unknown::NoBudget);
    }
    // A battery with a measured charge below the counted one may be another battery.
    let is_known =
        budget.flags & (budget_flag::CHARGE | budget_flag::CONTRADICTED) == budget_flag::CHARGE;
    let learned =
        budget.learned_capacity_j().map(|(joules, sd_j)| (f64::from(joules), f64::from(sd_j)));
    let (capacity_j, sd_j) = learned.unwrap_or((settings.capacity_j, 0.0));
    // The monitor that counts a plan's energy has learned the capacity, so its error is that of the
    // energy left.
    let (counted_sd, counting_sd) = match learned {
        Some(_) => (sd_j / capacity_j, 0.0),
        None => (settings.counting_sd, settings.counting_sd),
    };
    let reserve_j = settings.reserve * capacity_j;
    let soc_lo_j = f64::from(budget.soc_lo) * capacity_j;
    let learned_lo_j = f64::from(budget.usable_lo_j) + reserve_j.min(soc_lo_j);
    let left_j = f64::from(budget.left_j);
    let spare = EnergyLeft::stated(
        left_j - reserve_j,
        f64::from(budget.soc_sd) * capacity_j,
        counted_sd * (capacity_j - left_j),
    );
    let battery = Battery {
        left_j: budget.left_j,
        left_lo_j: (if learned.is_some() { learned_lo_j } else { soc_lo_j }) as f32,
        usable_j: budget.usable_j,
        usable_lo_j: budget.usable_lo_j,
        spare: EnergyLeft {
            monitor: spare.monitor - sd_j * spare.left.max(0.0) / capacity_j,
            ..spare
        },
        counting_sd,
    };
    let all = [battery.left_j, battery.left_lo_j, battery.usable_j, battery.usable_lo_j];
    let is_finite = all.iter().all(|joules| joules.is_finite()) && budget.soc_sd >= 0.0;
    if is_known && is_finite { Ok(battery) } else { Err(Unknown::BatteryUnknown) }
}

/// True if a budget is of the robot, and of the run of the worker that the state is of, and not of
/// an earlier tick: one from before the robot left and came back is of its previous stay.
fn is_current(
    header: &PlanStateHeader,
    state: &PlanState,
    of: &BudgetHeader,
    budget: &Budget,
) -> bool {
    let is_its = budget.robot == state.robot && of.worker_epoch == header.worker_epoch;
    is_its && of.tick >= header.tick
}
