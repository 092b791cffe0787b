//! One mission: the machinery that all policies share.

use std::collections::VecDeque;

use joulebus_plan::Point;
use joulebus_plan::follow::Pose;
use joulebus_plant::arena::Command;
use joulebus_wire::Sample;
use serde::Serialize;

use crate::broker::{Broker, Product};
use crate::error::MissionError;
use crate::machine::{Fed, Machine, is_reached};
use crate::policy::{Asked, Policy};
use crate::scenario::{SPEED_MPS, SWITCHED_ON_EVERY_S, Scenario, Task};

/// Start of all stamps, because 0 means no stamp.
const BASE_NS: u64 = 1_000_000_000;
/// Control steps between two decisions, and between two estimates of the path home.
const DECIDES: u64 = 30;
const LOOKS_HOME: u64 = 150;
/// A robot without a task charges below this state of charge, if a charger is free.
const RESTS_BELOW: f64 = 0.6;
/// Waiting tasks that are offered, the oldest first.
const LOOKS_AT: usize = 8;
/// Above this state of charge a robot need not charge for a task.
const AS_GOOD_AS_FULL: f64 = 0.97;

/// Energy from which on the fleet's metering is compared with the monitor's, J: a poll more or less
/// does not matter then.
const MIN_COMPARED_J: f64 = 200.0;

/// The outcome of a mission.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// Tasks that were finished.
    pub tasks: u64,
    /// Robots whose battery ran empty.
    pub stranded: u64,
    /// Tasks that a robot broke off to charge.
    pub broken_off: u64,
    /// Seconds, over all robots, in which a full one was allowed none of the waiting tasks.
    pub idle_full: u64,
    /// Times that a robot was charged.
    pub charges: u64,
    /// Share of the chargers' time in which one stored energy.
    pub charger_use: f64,
    /// Mean true state of charge at the beginning of a charge.
    pub soc_before: f64,
    /// Mean share of the robots' time spent on tasks.
    pub at_work: f64,
    /// Mean share of their time on the way to a charger or waiting for one.
    pub in_line: f64,
    /// Greatest energy of a battery that is not accounted for, J: 0 but for rounding.
    pub unaccounted_j: f64,
    /// Maximum difference between the energy that the fleet metered of a robot and that of its
    /// monitor, as a share.
    pub metered_error: f64,
    /// Times that a charger held two robots, which it cannot.
    pub shared_chargers: u64,
}

#[derive(Clone, Debug)]
enum Job {
    Idle,
    Task {
        task: Task,
        next: usize,
    },
    ToLine,
    Waiting,
    ToCharger(usize),
    /// Charging at a charger since a control step.
    Charging(usize, u64),
}

struct Mission<'a> {
    scenario: &'a Scenario,
    policy: Policy,
    broker: Broker<'a>,
    machines: Vec<Machine>,
    jobs: Vec<Job>,
    /// Energy that each robot needs to get home, J.
    home_j: Vec<f64>,
    /// The robot that has or is to have each charger.
    chargers: Vec<Option<usize>>,
    arriving: VecDeque<Task>,
    waiting: VecDeque<Task>,
    samples: Vec<Sample>,
    dt_ns: u64,
    step: u64,
    socs_before: f64,
    counted: [u64; 3],
    outcome: Outcome,
}

/// Runs the mission of a seed under a policy.
///
/// # Errors
/// [`MissionError`].
pub fn mission(scenario: &Scenario, policy: Policy, seed: u64) -> Result<Outcome, MissionError> {
    let product = Product::new(scenario, policy.reserve())?;
    let mut mission = Mission::new(scenario, &product, policy, seed)?;
    let period_s = mission.dt_ns as f64 * 1e-9;
    for _ in 0..(scenario.duration_s / period_s) as u64 {
        mission.step()?;
    }
    mission.end()
}

impl<'a> Mission<'a> {
    fn new(
        scenario: &'a Scenario,
        product: &'a Product,
        policy: Policy,
        seed: u64,
    ) -> Result<Self, MissionError> {
        let machine = |robot: usize| {
            let on_s = SWITCHED_ON_EVERY_S * robot as f64;
            Machine::new(scenario.made(seed, robot), BASE_NS + (on_s * 1e9) as u64)
        };
        Ok(Self {
            policy,
            broker: product.broker()?,
            machines: (0..scenario.robots).map(machine).collect(),
            jobs: vec![Job::Idle; scenario.robots],
            home_j: vec![0.0; scenario.robots],
            chargers: vec![None; scenario.chargers],
            arriving: scenario.tasks(seed).into(),
            waiting: VecDeque::new(),
            samples: Vec::with_capacity(scenario.robots),
            dt_ns: product.period_ns(),
            step: 0,
            socs_before: 0.0,
            counted: [0; 3],
            outcome: Outcome {
                seed,
                tasks: 0,
                stranded: 0,
                broken_off: 0,
                idle_full: 0,
                charges: 0,
                charger_use: 0.0,
                soc_before: 0.0,
                at_work: 0.0,
                in_line: 0.0,
                unaccounted_j: 0.0,
                metered_error: 0.0,
                shared_chargers: 0,
            },
            scenario,
        })
    }

    fn now_ns(&self) -> u64 {
        BASE_NS + self.step * self.dt_ns
    }

    fn now_s(&self) -> f64 {
        (self.step * self.dt_ns) as f64 * 1e-9
    }

    fn is_on(&self, robot: usize) -> bool {
        self.machines[robot].is_on(self.now_ns())
    }

    /// Executes one control step of all robots, one tick of the fleet, and decisions once a second.
    fn step(&mut self) -> Result<(), MissionError> {
        self.step += 1;
        self.samples.clear();
        for robot in 0..self.machines.len() {
            if self.is_on(robot) {
                self.drive(robot);
            }
        }
        let now_ns = self.now_ns();
        self.broker.tick(&self.samples, now_ns);
        if self.step.is_multiple_of(DECIDES) {
            self.decide()?;
        }
        Ok(())
    }

    fn drive(&mut self, robot: usize) {
        let pose = self.machines[robot].pose();
        let target = self.target(robot, &pose);
        let command = target.map_or((0.0, 0.0), |goal| {
            self.broker.product.follower.command(&pose, goal, SPEED_MPS)
        });
        let command = Command { v_mps: command.0.into(), omega_radps: command.1.into() };
        let charger = match self.jobs[robot] {
            Job::Charging(charger, since) => Some((charger, self.is_docked(since))),
            _ => None,
        };
        let is_docked = charger.is_some_and(|(_, is_docked)| is_docked);
        let power_w = self.scenario.charge_w;
        let fed = match self.jobs[robot] {
            Job::Charging(..) if is_docked => Fed::Charge { power_w },
            Job::Waiting | Job::Charging(..) => Fed::Load,
            _ => Fed::Nothing,
        };
        let (now_ns, machine) = (self.now_ns(), &mut self.machines[robot]);
        machine.step(command, self.dt_ns, fed);
        if machine.is_empty() {
            self.strand(robot);
            return;
        }
        let sample = machine.sample(robot as u32, now_ns, is_docked);
        self.counted[0] += 1;
        self.counted[1] += u64::from(matches!(self.jobs[robot], Job::Task { .. }));
        let in_line = matches!(self.jobs[robot], Job::ToLine | Job::Waiting | Job::ToCharger(_));
        self.counted[2] += u64::from(in_line);
        self.outcome.charger_use += if is_docked { 1.0 } else { 0.0 };
        // Only the policy that uses `CannotReturn` states a path home in its samples.
        let states = matches!(self.policy, Policy::Joulebus { .. });
        let home_j = self.home_j[robot];
        let sample =
            if states && home_j.is_finite() { sample.return_energy(home_j as f32) } else { sample };
        self.samples.push(sample);
        if let Some((charger, _)) = charger.filter(|_| self.machines[robot].is_full()) {
            self.chargers[charger] = None;
            self.jobs[robot] = Job::Idle;
        }
    }

    /// True if a robot that is on a charger since a step has made contact.
    fn is_docked(&self, since: u64) -> bool {
        ((self.step - since) * self.dt_ns) as f64 * 1e-9 >= self.scenario.docking_s
    }

    /// The goal of a robot. A goal that it reaches on the way changes its job.
    fn target(&mut self, robot: usize, pose: &Pose) -> Option<Point> {
        let reached = |goal: Point| is_reached(pose.at, goal);
        match &mut self.jobs[robot] {
            Job::Idle | Job::Waiting | Job::Charging(..) => None,
            Job::Task { task, next } => {
                if reached(task.points[*next]) {
                    *next += 1;
                }
                let goal = task.points.get(*next).copied();
                if goal.is_none() {
                    self.outcome.tasks += 1;
                    self.jobs[robot] = Job::Idle;
                }
                goal
            }
            Job::ToLine => {
                let goal = Scenario::line();
                if reached(goal) {
                    self.jobs[robot] = Job::Waiting;
                    return None;
                }
                Some(goal)
            }
            Job::ToCharger(charger) => {
                let charger = *charger;
                let goal = self.scenario.charger(charger);
                if reached(goal) {
                    self.begin_charge(robot, charger);
                    return None;
                }
                Some(goal)
            }
        }
    }

    fn begin_charge(&mut self, robot: usize, charger: usize) {
        let others = self.jobs.iter();
        let taken =
            others.filter(|job| matches!(job, Job::Charging(other, _) if *other == charger));
        self.outcome.shared_chargers += taken.count() as u64;
        self.outcome.charges += 1;
        self.socs_before += self.machines[robot].soc();
        self.jobs[robot] = Job::Charging(charger, self.step);
    }

    fn strand(&mut self, robot: usize) {
        self.outcome.stranded += 1;
        for charger in &mut self.chargers {
            if *charger == Some(robot) {
                *charger = None;
            }
        }
        if let Job::Task { task, .. } = std::mem::replace(&mut self.jobs[robot], Job::Idle) {
            self.waiting.push_front(task);
        }
    }

    fn decide(&mut self) -> Result<(), MissionError> {
        let now_s = self.now_s();
        while self.arriving.front().is_some_and(|task| task.at_s <= now_s) {
            self.waiting.extend(self.arriving.pop_front());
        }
        self.broker.find();
        self.give_chargers();
        self.look_home()?;
        self.give_tasks()
    }

    fn asked(&self, robot: usize) -> Option<Asked> {
        let rows = self.broker.state(robot).filter(|_| self.is_on(robot))?;
        let machine = &self.machines[robot];
        Some(Asked {
            robot,
            pose: machine.pose(),
            rows,
            truth: matches!(self.policy, Policy::Oracle).then(|| machine.clone()),
        })
    }

    /// Energy left by the fleet's account, J.
    fn left_j(&self, robot: usize) -> f64 {
        let state = self.broker.state(robot);
        state.map_or(0.0, |(_, budget)| budget.left_j.into())
    }

    /// Assigns free chargers: first to waiting robots, then to those on the way, least energy
    /// first.
    fn give_chargers(&mut self) {
        for charger in 0..self.chargers.len() {
            if self.chargers[charger].is_some() {
                continue;
            }
            let robots = 0..self.jobs.len();
            let in_line = robots.filter_map(|robot| match self.jobs[robot] {
                _ if !self.is_on(robot) => None,
                Job::Waiting => Some((0, robot)),
                Job::ToLine => Some((1, robot)),
                _ => None,
            });
            let next = in_line.min_by(|(class, one), (other_class, other)| {
                let left = self.left_j(*one).total_cmp(&self.left_j(*other));
                class.cmp(other_class).then(left)
            });
            if let Some((_, robot)) = next {
                self.chargers[charger] = Some(robot);
                self.jobs[robot] = Job::ToCharger(charger);
            }
        }
    }

    /// Breaks off tasks of robots that must go to their charger.
    fn look_home(&mut self) -> Result<(), MissionError> {
        for robot in 0..self.jobs.len() {
            if !matches!(self.jobs[robot], Job::Idle | Job::Task { .. }) {
                self.home_j[robot] = f64::NAN;
                continue;
            }
            let Some(asked) = self.asked(robot) else {
                continue;
            };
            if (self.step + DECIDES * robot as u64).is_multiple_of(LOOKS_HOME) {
                let way = &self.broker.product.home;
                let home_j = self.policy.needed_j(&self.broker, &asked, way)?;
                self.home_j[robot] = home_j;
            }
            if !self.policy.must_go(&self.broker, &asked, self.home_j[robot]) {
                continue;
            }
            let job = std::mem::replace(&mut self.jobs[robot], Job::ToLine);
            if let Job::Task { task, .. } = job {
                self.outcome.broken_off += 1;
                self.waiting.push_front(task);
            }
        }
        Ok(())
    }

    /// Assigns the oldest tasks first. Robots that may do none of them go to charge.
    fn give_tasks(&mut self) -> Result<(), MissionError> {
        let mut idle: Vec<Asked> = (0..self.jobs.len())
            .filter(|robot| matches!(self.jobs[*robot], Job::Idle))
            .filter_map(|robot| self.asked(robot))
            .collect();
        let mut place = 0;
        while place < self.waiting.len().min(LOOKS_AT) && !idle.is_empty() {
            let task = &self.waiting[place];
            let Some(robot) = self.policy.choose(&self.broker, &idle, task)? else {
                place += 1;
                continue;
            };
            idle.retain(|asked| asked.robot != robot);
            if let Some(task) = self.waiting.remove(place) {
                self.jobs[robot] = Job::Task { task, next: 0 };
            }
        }
        if self.waiting.is_empty() {
            self.rest(&idle);
            return Ok(());
        }
        for asked in idle {
            if f64::from(asked.rows.1.soc) > AS_GOOD_AS_FULL {
                self.outcome.idle_full += 1;
            } else {
                self.jobs[asked.robot] = Job::ToLine;
            }
        }
        Ok(())
    }

    /// Lets robots without tasks charge while chargers are free.
    fn rest(&mut self, idle: &[Asked]) {
        let mut free = self.chargers.iter().filter(|holder| holder.is_none()).count();
        for asked in idle {
            if free > 0 && f64::from(asked.rows.1.soc) < RESTS_BELOW {
                self.jobs[asked.robot] = Job::ToLine;
                free -= 1;
            }
        }
    }

    fn metered_error(&self) -> f64 {
        let errors = self.machines.iter().enumerate().map(|(robot, machine)| {
            let shown_j = machine.shown_j();
            let state = self.broker.state(robot).filter(|_| shown_j > MIN_COMPARED_J);
            state.map_or(0.0, |(_, budget)| (budget.drawn_j() / shown_j - 1.0).abs())
        });
        errors.fold(0.0, f64::max)
    }

    fn end(mut self) -> Result<Outcome, MissionError> {
        self.outcome.metered_error = self.metered_error();
        let refused = self.broker.refused();
        let outcome = &mut self.outcome;
        if refused > 0 {
            let seed = outcome.seed;
            return Err(MissionError::Refused { seed, refused });
        }
        let [steps, working, in_line] = self.counted.map(|count| count as f64);
        (outcome.at_work, outcome.in_line) = (working / steps, in_line / steps);
        outcome.charger_use /= self.chargers.len() as f64 * self.step as f64;
        outcome.soc_before = self.socs_before / outcome.charges as f64;
        let unaccounted = self.machines.iter().map(|machine| machine.unaccounted_j().abs());
        outcome.unaccounted_j = unaccounted.fold(0.0, f64::max);
        Ok(self.outcome)
    }
}
