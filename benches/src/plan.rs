//! Questions of a planner in its own process: `joulebus_plan`, beside the network's bare rollout.

use std::hint::black_box;
use std::time::Instant;

use crate::arguments::BenchOptions;
use anyhow::Context as _;
use joulebus_energy::{CommandModel, EnergyModel, EnergySample, EnergyState, TERMS};
use joulebus_plan::{Answer, Candidates, Frames, PlanFleet, Platform, Robot};
use joulebus_wire::{
    Budget, BudgetHeader, PlanState, PlanStateHeader, Quality, budget_flag, plan_state_flag,
};

use crate::report::quantile;
use crate::rollout::{Work, title};
use crate::rounds::{Run, calls, interleave};
use crate::{Report, input, kernel, tick};

/// Candidates of one robot, and steps of each.
const CASES: [(usize, usize); 2] = [(16, 50), (1_024, 50)];
/// Steps of the plan whose energy, power and gradient are asked for together.
const GRADIENT_STEPS: usize = 50;
/// Time between two steps, s.
const STEP_S: f32 = 1.0 / 30.0;
const COVERAGE: f32 = 0.9;

/// Measures questions of each size, interleaved with the network's rollout of the same commands.
///
/// # Errors
/// A requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (network, report) = kernel::chosen("plan", options)?;
    let mut report = report.with_input("step_s", STEP_S);
    let fleet = fleet()?;
    let rows = Rows::new(&fleet);
    let robot = rows.robot(&fleet).context("a robot of the fleet")?;
    for (count, steps) in CASES {
        let mut rollout = Work::new(&network, (1, count, steps));
        let (v_mps, omega_radps) = commands(count * steps);
        let candidates = Candidates::new(count, STEP_S, &v_mps, &omega_radps)?;
        let mut answers = robot.what_if(&candidates, COVERAGE)?;
        let case = title((1, count, steps));
        let ask = || timed(|| what_if(&robot, &candidates, &mut answers));
        let runs: Vec<Run<'_>> = vec![Box::new(ask), Box::new(|| rollout.run())];
        let measured = interleave(runs, options.rounds(kernel::ROUNDS), options.each());
        let scaled = |scale: f64| -> Vec<f64> { measured[0].iter().map(|ns| ns * scale).collect() };
        report.less("what_if_us", &case, "µs", &scaled(1e-3));
        let over = scaled(1.0 / quantile(&measured[1], 0.5));
        report.less("what_if_over_rollout", &case, "1", &over);
    }
    gradient(&mut report, &robot, options)?;
    report.notes.push(
        "Each answer has energy, interval, energy left, probability, margin and verdict. Compared with \
         the network's bare rollout, which gives an energy alone. Energy, power of every step and \
         gradient are those of one plan of 50 steps. The energy model reads all of its terms."
            .to_owned(),
    );
    Ok(report)
}

/// Energy with its interval, power of every step and gradient of one plan.
fn gradient(report: &mut Report, robot: &Robot<'_>, options: &BenchOptions) -> anyhow::Result<()> {
    let (v_mps, omega_radps) = commands(GRADIENT_STEPS);
    let candidates = Candidates::new(1, STEP_S, &v_mps, &omega_radps)?;
    let mut answers = robot.what_if(&candidates, COVERAGE)?;
    let mut columns = [(); 3].map(|()| vec![0.0; GRADIENT_STEPS]);
    let mut ask = || {
        let [power_w, by_v, by_omega] = &mut columns;
        what_if(robot, &candidates, &mut answers);
        let traced = robot.power_w(&candidates, power_w);
        let derived = robot.gradient(&candidates, by_v, by_omega);
        assert!(traced.is_ok() && derived.is_ok(), "the lengths agree");
        black_box(&mut columns);
    };
    let repeated = calls(&mut ask);
    let run = || {
        let ns = timed(|| (0..repeated).for_each(|_| ask()));
        ns / repeated as f64
    };
    let measured = interleave(vec![Box::new(run)], options.rounds(kernel::ROUNDS), options.each());
    let us: Vec<f64> = measured[0].iter().map(|ns| ns * 1e-3).collect();
    let case = format!("1 robot x {GRADIENT_STEPS} steps");
    report.less("energy_power_gradient_us", &case, "µs", &us);
    Ok(())
}

fn what_if(robot: &Robot<'_>, candidates: &Candidates<'_>, answers: &mut [Answer]) {
    let asked = black_box(robot).what_if_into(black_box(candidates), COVERAGE, answers);
    assert!(asked.is_ok(), "the commands are allowed: {asked:?}");
    black_box(answers);
}

/// ns of one call.
fn timed(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_nanos() as f64
}

/// Commands that the platform allows and that the model has seen.
fn commands(count: usize) -> (Vec<f32>, Vec<f32>) {
    let wave = |at: usize, times: f64| (times * (at as f64 + input::SEED as f64)).sin() as f32;
    let v = (0..count).map(|at| 0.15 * wave(at, 0.37));
    let omega = (0..count).map(|at| 1.2 * wave(at, 0.53));
    (v.collect(), omega.collect())
}

/// The demo's platform with an energy model that reads all of its terms.
fn fleet() -> anyhow::Result<PlanFleet> {
    let settings = tick::settings(1)?;
    let energy = EnergyModel {
        command: CommandModel { weights: [0.3; TERMS], ..CommandModel::constant(3.0) },
        calibrated: 6,
        errors: [[-0.16, -0.1, -0.08, -0.04, 0.0, 0.04, 0.08, 0.1, 0.16]; 6],
        v_mps: [-0.2, 0.2],
        omega_radps: [-2.0, 2.0],
        ..EnergyModel::untrained(3.6)
    };
    let platform = Platform::new(settings.platforms[0].clone(), energy, 1);
    Ok(PlanFleet::of(vec![platform], settings.fingerprint()))
}

/// The rows of a robot.
struct Rows {
    header: PlanStateHeader,
    state: PlanState,
    budget_header: BudgetHeader,
    budget: Budget,
}

impl Rows {
    fn new(fleet: &PlanFleet) -> Self {
        let mut energy = EnergyState::new(0);
        for step in 0..600u16 {
            let sample = EnergySample {
                power_w: 3.6 + 0.2 * (f32::from(step) * 0.3).sin(),
                elapsed_s: STEP_S,
                v_mps: 0.1,
                omega_radps: 0.2,
            };
            energy.observe(&fleet.platforms()[0].energy, &sample);
        }
        let (quality, quality_detail) = Quality::Fresh.encode();
        Self {
            header: PlanStateHeader::default(),
            state: PlanState {
                flags: plan_state_flag::SAMPLE,
                quality,
                quality_detail,
                v_mps: 0.1,
                omega_radps: 0.2,
                energy_j: energy.metered.energy_j,
                command_j: energy.metered.command_j,
                time_s: energy.metered.time_s,
                error_lower: energy.bounds.lower,
                error_upper: energy.bounds.upper,
                command_trust: energy.learned.command_trust,
                ..PlanState::default()
            },
            budget_header: BudgetHeader::default(),
            budget: Budget {
                flags: budget_flag::BATTERY | budget_flag::CHARGE,
                left_j: 30_000.0,
                usable_j: 27_000.0,
                usable_lo_j: 26_000.0,
                soc: 0.8,
                soc_lo: 0.75,
                ..Budget::default()
            },
        }
    }

    fn robot<'a>(&self, fleet: &'a PlanFleet) -> Option<Robot<'a>> {
        fleet.robot(&Frames {
            header: &self.header,
            state: &self.state,
            budget: Some((&self.budget_header, &self.budget)),
            now_ns: 0,
        })
    }
}
