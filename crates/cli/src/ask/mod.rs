//! `joulebus ask`: what a plan costs, computed here from shared memory, or by the worker.

mod path_file;
mod point;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use anyhow::anyhow;
use clap::ArgGroup;
use joulebus_board::{Platforms, model_fit};
use joulebus_bus::{NoWorker, clock};
use joulebus_config::Config;
use joulebus_consumer::{Diagnostics, Feed};
use joulebus_plan::report::{AnswerReport, AnswersReport};
use joulebus_plan::{MAX_STEPS, Path, Plan, Question, QuestionError, Reply};
use joulebus_planner::{ClientError, PlanClient, Planner, QueryError, ViewError};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, log_line};
use joulebus_wire::{Budget, DiagnosticHeader, QueryRefusal};

use crate::budgets::{budgets, present};
use crate::configs;
use point::ReturnTo;

/// Timeout for a frame of the worker, or its answer.
const WORKER_TIMEOUT: Duration = Duration::from_secs(3);
/// The same where there is none when it is asked: one may be starting.
const START_TIMEOUT: Duration = Duration::from_secs(2);
/// Timeout for what pauses have cost, beside a worker's answer.
const BUDGET_TIMEOUT: Duration = Duration::from_millis(500);

/// Maximum number of robots to compare.
const MAX_RANKED: usize = 100_000;

/// Moments along a trip.
const MOMENTS: usize = 48;

/// Ask what energy a plan of a robot costs, whether its battery suffices, and which robot needs
/// least
#[derive(Debug, clap::Args)]
#[command(
    group = ArgGroup::new("who").required(true).args(["robot", "rank"]),
    group = ArgGroup::new("plan").required(true).args(["path", "idle"]),
    after_help = "Examples:\n  \
    joulebus ask --robot 7 --path p.csv                     energy, what is left, whether it suffices\n  \
    joulebus ask --robot 7 --path p.csv --return dock       and back to where the path begins\n  \
    joulebus ask --robot 7 --path p.csv --return 1.5,-0.2   and to a dock at this point, m\n  \
    joulebus ask --rank 7,9,20-29 --path p.csv              the cheapest first, also of `all`\n  \
    joulebus ask --rank 7,50009 --idle 60 --config north.toml --config south.toml   of two fleets\n  \
    joulebus ask --robot 7 --idle 60                        a minute at rest\n  \
    joulebus ask --robot 7 --path p.csv --through worker    computed by the worker\n\n\
    A path file is CSV with the columns x_m and y_m. The robot is at the first point and faces the \
    first that is elsewhere. More columns may follow, and cells of all but time_s may be empty. \
    speed_mps: towards the point, at most the platform's. dwell_s: wait there. load_w: power that \
    the robot draws in addition towards the point and while it waits there. time_s: when it is \
    there. With times, speeds are upper limits, and a repeated point is a wait. The answer says if \
    the robot is more than a second late. charge_to, at the last point: the robot is then charged \
    to this share, and the answer has the time by its earlier charges:\n\n    \
    x_m,y_m,speed_mps,dwell_s,load_w\n    0,0,,,\n    2,0,0.2,30,\n    2,1.5,0.1,,1.5\n\n\
    An order of VDA 5050 with its nodes and edges, or a nav_msgs/Path, as JSON, is a path file too. \
    The maxSpeed of an edge is its speed, but for a lower --speed. Stamps that differ are times.\n\n\
    Only the shape of the path counts, not how many points describe it.\n\n\
    Verdict yes: on every leg, the upper end of the energy fits into the lower bound of what the \
    battery can spare above its reserve. tight: only the expected energy fits, or the robot's own \
    readings are in doubt (none at present, outside the training data, or an alarm such as \
    StuckSensor: it is named), or the model's recordings cannot show what the plan costs. no: the \
    expected energy does not fit. unknown: the answer has the reason. What the model does not know \
    of the plan itself widens the energy to what was recorded, which still can be a yes. Then the \
    probability is unknown, and the answer names the quantity outside the training and the speed \
    at which the path would be inside. A time to turn back is stated if the answer is not a yes. \
    With --return the energy of docking counts too (docking_wh of [battery]). The line charge has \
    the state of charge along the trip, with its interval. JSON has 48 moments of it.\n\n\
    This process computes the answer, from the worker's plan states in shared \
    memory and from the models of the config. These must be the worker's models. So there is no \
    queue and no load on the worker, and a path may have any length. Robots that are not in the \
    fleet are named, and the others are answered. --through worker asks the worker, as programs in \
    other languages do, and needs no models here. The answer has the same bits, and captures \
    record it. Then a path may take at most an hour at 30 Hz.\n\
    Exit code 0: answered, whatever the verdict. 1: no worker, no answer in time, no such robot, \
    or another config or model than the worker's. 2: a wrong question, or a question that is too \
    large for the worker."
)]
pub(crate) struct Args {
    /// The fleet's config. Repeat it to ask about robots of several fleets [default:
    /// the one that other verbs find]
    #[arg(long, value_name = "FILE")]
    config: Vec<PathBuf>,
    /// The robot that the plan is for
    #[arg(long, value_name = "ID")]
    robot: Option<u32>,
    /// Several robots: ids, ranges as 0-19, or all. The answer lists the best first: by verdict,
    /// those without doubt before others, then by energy
    #[arg(long, value_name = "ID,…", value_delimiter = ',')]
    rank: Vec<Ranked>,
    /// Follow this path (CSV, an order of VDA 5050, or a nav_msgs/Path as JSON)
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// Stand still for this time, s
    #[arg(long, value_name = "SECONDS")]
    idle: Option<f32>,
    /// Then return: to where the path begins (dock), or to a point, m
    #[arg(
        long = "return",
        value_name = "dock|X,Y",
        conflicts_with = "idle",
        allow_hyphen_values = true
    )]
    return_to: Option<ReturnTo>,
    /// Speed where the path file states none, m/s [default: the highest that the model was trained
    /// on]
    #[arg(long, value_name = "M/S", conflicts_with = "idle", value_parser = speed)]
    speed: Option<f64>,
    /// Cut corners within this distance of the path, m, up to 1. 0: none [default: half a cell, on the
    /// stairs of a grid of cells up to 0.25 m]
    #[arg(long, value_name = "M", conflicts_with = "idle")]
    tolerance: Option<f32>,
    /// Then charge to this state of charge, 0 to 1: how long that takes by earlier charges [default:
    /// charge_to of the path file]
    #[arg(long, value_name = "SHARE", value_parser = path_file::charge_to)]
    charge_to: Option<f64>,
    /// Coverage of the intervals, 0.5 to 0.999
    #[arg(long, value_name = "SHARE", default_value_t = 0.9)]
    coverage: f32,
    /// With --format json: the power of every step, of one robot that follows a path. Instead of the
    /// charge along it
    #[arg(long, conflicts_with_all = ["idle", "rank"])]
    power: bool,
    /// Who computes: this process, from shared memory, or a thread of the worker
    #[arg(long, value_enum, default_value_t = Through::Memory)]
    through: Through,
}

/// The process that computes an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Through {
    /// This process, with the models that its config names.
    Memory,
    /// The thread of `joulebus run` that answers questions.
    Worker,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let configs = configs::load(&args.config)?;
    let read = |file| path_file::read(file, args.speed);
    let read = args.path.as_deref().map(read).transpose()?;
    let (mut path, charge_to) = read.map_or((None, None), |(path, to)| (Some(path), to));
    let charge_to = args.charge_to.or(charge_to);
    if let Some(path) = &mut path {
        path.tolerance_m = args.tolerance;
    }
    let simplified = path.as_ref().and_then(Path::simplified);
    let (questions, missing) = divide(&configs, args.question(path, &configs)?)?;
    for (config, question) in &questions {
        refuse_impossible(config, &question.plan)?;
    }
    let mut asked = Vec::new();
    for (config, question) in questions {
        asked.push(match args.through {
            Through::Memory => args.compute(config, question)?,
            Through::Worker => args.send(config, &question)?,
        });
    }
    let report = AnswersReport { path: simplified, ..args.report(asked, missing, charge_to) };
    output.report(&report)?;
    Ok(Outcome::Done)
}

/// The answer of one fleet.
struct FleetAnswer<'a> {
    config: &'a Config,
    tick: u64,
    age_ns: u64,
    reply: Reply,
    missing: Vec<u32>,
    /// The robots' budgets, if this process has read them.
    budgets: Vec<Budget>,
}

/// Fleets, with the question for each.
type Questions<'a> = Vec<(&'a Config, Question)>;

/// The question for each fleet that has robots of it, and the robots that none has.
fn divide(configs: &[Config], question: Question) -> Result<(Questions<'_>, Vec<u32>), UsageError> {
    if let [config] = configs {
        return Ok((vec![(config, question)], Vec::new()));
    }
    let (mut missing, mut of_fleets) = (Vec::new(), vec![Vec::new(); configs.len()]);
    for robot in robots(&question.plan) {
        let mut fleets = configs.iter().enumerate().filter(|(_, config)| has(config, *robot));
        match (fleets.next(), fleets.next()) {
            (Some((at, _)), None) => of_fleets[at].push(*robot),
            (Some((_, one)), Some((_, other))) => {
                return Err(UsageError(format!(
                    "robot {robot} is in the fleets {} and {}: give each fleet ids of its own \
                     (`platform.robots`), or ask one of them",
                    one.fleet(),
                    other.fleet()
                )));
            }
            (None, _) => missing.push(*robot),
        }
    }
    let mut questions = Vec::new();
    for (config, ids) in configs.iter().zip(of_fleets).filter(|(_, ids)| !ids.is_empty()) {
        let mut question = question.clone();
        if let Plan::Follow { robots, .. } | Plan::Idle { robots, .. } = &mut question.plan {
            *robots = ids;
        }
        questions.push((config, question));
    }
    if questions.is_empty() {
        let fleets: Vec<&str> = configs.iter().map(Config::fleet).collect();
        return Err(UsageError(format!(
            "none of the fleets {} has robot {missing:?}: name robots of `platform.robots`",
            fleets.join(", ")
        )));
    }
    Ok((questions, missing))
}

/// Says what pauses have cost the robots.
fn note_pauses(budgets: &[Budget]) {
    for budget in budgets {
        if let Some(note) = budget.pause_note() {
            log_line(&format!("robot {}: {note}", budget.robot));
        }
    }
}

/// The robots that a plan is for.
fn robots(plan: &Plan) -> &[u32] {
    match plan {
        Plan::Follow { robots, .. } | Plan::Idle { robots, .. } => robots,
        _ => &[],
    }
}

/// True if the fleet may have the robot.
fn has(config: &Config, robot: u32) -> bool {
    let mut platforms = config.settings().platforms.iter();
    platforms.any(|platform| platform.robots.iter().any(|ids| ids.contains(&robot)))
}

/// Robots to compare.
#[derive(Debug, Clone)]
enum Ranked {
    /// Those of the configs.
    All,
    Ids(RangeInclusive<u32>),
}

impl FromStr for Ranked {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        match (text, first.parse(), last.parse()) {
            ("all", ..) => Ok(Self::All),
            (_, Ok(first), Ok(last)) if first <= last => Ok(Self::Ids(first..=last)),
            _ => Err("allowed are ids, ranges such as 0-19, and all"),
        }
    }
}

impl Args {
    /// The robots that are asked about.
    fn robots(&self, configs: &[Config]) -> Result<Vec<u32>, UsageError> {
        let platforms = || configs.iter().flat_map(|config| &config.settings().platforms);
        let all = || platforms().flat_map(|platform| platform.robots.iter().cloned());
        let ranked = self.rank.iter().flat_map(|ranked| match ranked {
            Ranked::All => all().collect(),
            Ranked::Ids(ids) => vec![ids.clone()],
        });
        let mut known = BTreeSet::new();
        let ids = ranked.flatten().chain(self.robot).filter(|robot| known.insert(*robot));
        let ids: Vec<u32> = ids.take(MAX_RANKED + 1).collect();
        match ids.len() <= MAX_RANKED {
            true => Ok(ids),
            false => Err(UsageError(format!("--rank compares at most {MAX_RANKED} robots"))),
        }
    }

    fn question(&self, path: Option<Path>, configs: &[Config]) -> Result<Question, UsageError> {
        let robots = self.robots(configs)?;
        let plan = match path {
            Some(path) => {
                let begin = path.points[0];
                let back_to = self.return_to.map(|to| match to {
                    ReturnTo::Dock => begin,
                    ReturnTo::At(point) => point,
                });
                Plan::Follow { robots, path, back_to }
            }
            None => Plan::Idle { robots, duration_s: self.idle.unwrap_or_default() },
        };
        // In shared memory the powers of a long path leave no room for them.
        let moments = if self.rank.is_empty() && !self.power { MOMENTS } else { 0 };
        Ok(Question { plan, coverage: self.coverage, power: self.power, moments })
    }

    /// Answers here, from shared memory.
    fn compute<'a>(
        &self,
        config: &'a Config,
        question: Question,
    ) -> anyhow::Result<FleetAnswer<'a>> {
        let mut planner = Planner::with_config(config, "ask")?;
        // The answer stands without them.
        let mut diagnostics = planner.subscriber().diagnostics().ok();
        let fleet = planner.fleet().clone();
        let domain = config.domain()?;
        let timeout = match NoWorker::look(&domain) {
            Some(_) => START_TIMEOUT,
            None => WORKER_TIMEOUT,
        };
        let view =
            planner.wait(timeout).map_err(|error| match (error, NoWorker::look(&domain)) {
                (ViewError::Nothing { .. }, Some(no_worker)) => anyhow!("{no_worker}"),
                (error, _) => error.into(),
            })?;
        let (question, missing) = self.among(question, |robot| view.rows(robot).is_some());
        let answered = question.answer(&fleet, |robot| view.rows(robot), MAX_STEPS);
        let reply = answered.map_err(|error| match error {
            QuestionError::Ask(error) => UsageError(error.to_string()).into(),
            error => anyhow::Error::from(error),
        })?;
        let rows = reply.rows.iter().filter_map(|row| view.rows(row.robot)?.budget);
        let budgets: Vec<Budget> = rows.map(|(_, budget)| budget).collect();
        note_pauses(&budgets);
        let (tick, age_ns) = (view.tick(), view.age_ns());
        if let Some(header) = diagnostics.as_mut().and_then(newest_header) {
            let platforms = Platforms::new(config.settings());
            let fit = model_fit(platforms.names(), &header.platforms);
            let asked: BTreeSet<_> =
                reply.rows.iter().filter_map(|row| platforms.of_robot(row.robot)).collect();
            asked.iter().filter_map(|place| fit.get(*place)).for_each(|text| log_line(text));
        }
        Ok(FleetAnswer { config, tick, age_ns, reply, missing, budgets })
    }

    /// Lets the worker answer: about the robots that are there, if several are asked about.
    fn send<'a>(&self, config: &'a Config, question: &Question) -> anyhow::Result<FleetAnswer<'a>> {
        let mut client = PlanClient::with_config(config, "ask")?;
        let (mut others, mut missing) = (None, Vec::new());
        if self.ranks_all() {
            (others, missing) = self.among_present(question, config);
        }
        let mut answered = client.ask(others.as_ref().unwrap_or(question), WORKER_TIMEOUT);
        if others.is_none() && answered.as_ref().is_err_and(is_unknown_robot) {
            (others, missing) = self.among_present(question, config);
            if let Some(others) = &others {
                answered = client.ask(others, WORKER_TIMEOUT);
            }
        }
        let answered = answered.map_err(|error| match error {
            ClientError::Refused(refused) if is_wrong(refused.reason) => {
                UsageError(refused.text).into()
            }
            error => refused(error, config),
        })?;
        let (tick, age_ns, reply) = (answered.tick, answered.age_ns, answered.reply);
        // The answer stands without them, as where all places of planners are taken.
        let robots: Vec<u32> = reply.rows.iter().map(|row| row.robot).collect();
        let read = budgets(config, "ask", &robots, BUDGET_TIMEOUT);
        let budgets = read.map(|(found, _)| found).unwrap_or_default();
        note_pauses(&budgets);
        Ok(FleetAnswer { config, tick, age_ns, reply, missing, budgets })
    }

    /// The question about those of several robots that have a forecast, and the others. `None` if
    /// none is missing or the forecasts cannot be read: the worker says what is wrong.
    fn among_present(&self, question: &Question, config: &Config) -> (Option<Question>, Vec<u32>) {
        let Ok(present) = present(config, "ask", BUDGET_TIMEOUT) else {
            return (None, Vec::new());
        };
        let (others, missing) = self.among(question.clone(), |robot| present.contains(&robot));
        ((!missing.is_empty()).then_some(others), missing)
    }

    /// Splits several robots into a question about those that are there, and the others. If none
    /// is there, the question stays as it is and is refused.
    fn among(
        &self,
        mut question: Question,
        is_there: impl Fn(u32) -> bool,
    ) -> (Question, Vec<u32>) {
        let asked = robots(&question.plan);
        let missing: Vec<u32> = asked.iter().copied().filter(|robot| !is_there(*robot)).collect();
        if self.rank.is_empty() || missing.len() == asked.len() {
            return (question, Vec::new());
        }
        if let Plan::Follow { robots, .. } | Plan::Idle { robots, .. } = &mut question.plan {
            robots.retain(|robot| is_there(*robot));
        }
        (question, missing)
    }

    /// True if the robots are those of the fleet, not those that somebody named.
    fn ranks_all(&self) -> bool {
        self.rank.iter().any(|ranked| matches!(ranked, Ranked::All))
    }

    /// Joins the answers of all fleets, the best first. `missing` are the robots of no fleet.
    fn report(
        &self,
        asked: Vec<FleetAnswer<'_>>,
        mut missing: Vec<u32>,
        charge_to: Option<f64>,
    ) -> AnswersReport {
        let budgets = asked.iter().flat_map(|one| &one.budgets);
        let budgets: BTreeMap<u32, Budget> = budgets.map(|row| (row.robot, *row)).collect();
        let configs: Vec<&Config> = asked.iter().map(|one| one.config).collect();
        let names: Vec<&str> = configs.iter().map(|config| config.fleet()).collect();
        let oldest = asked.iter().map(|one| (one.age_ns, one.tick)).max();
        let (age_ns, tick) = oldest.unwrap_or_default();
        let replies = asked.into_iter().map(|one| {
            // All are those of the fleet, not those that the config lists.
            let is_all = self.ranks_all();
            let is_named = |robot: &u32| {
                let holds = |one: &Ranked| matches!(one, Ranked::Ids(ids) if ids.contains(robot));
                self.rank.iter().any(holds)
            };
            missing.extend(one.missing.into_iter().filter(|robot| !is_all || is_named(robot)));
            one.reply
        });
        let reply = replies.reduce(|mut all, other| {
            all.rows.extend(other.rows);
            all
        });
        let mut answers = Vec::new();
        let along = reply.as_ref().map_or(&[][..], |reply| &reply.along);
        for row in reply.iter().flat_map(Reply::ranked) {
            // Of a single fleet any robot that answers is its own.
            let own = configs.iter().find(|config| has(config, row.robot));
            let Some(config) = own.or(configs.first()) else { continue };
            let mut answer = AnswerReport::new(config.settings(), row);
            answer.fleet = (self.config.len() > 1).then(|| config.fleet().to_owned());
            answer.asked_to_return = self.return_to.is_some();
            let charging = (budgets.get(&row.robot), charge_to);
            answer.set_along(config.settings(), along, charging);
            if self.power {
                answer.power_w = reply.as_ref().map(|reply| reply.power_w.clone());
            }
            answers.push(answer);
        }
        AnswersReport {
            fleet: names.join(", "),
            tick,
            age_s: age_ns as f64 * 1e-9,
            coverage: self.coverage,
            path: None,
            answers,
            missing,
        }
    }
}

/// The header of the newest diagnostics. `None` if the worker sends none for lack of time.
fn newest_header(feed: &mut Feed<Diagnostics>) -> Option<DiagnosticHeader> {
    const LOOKS: u32 = 20;
    for _ in 0..LOOKS {
        if let Some(frame) = feed.latest().ok()? {
            return Some(*frame.header());
        }
        clock::sleep(Duration::from_millis(10));
    }
    None
}

/// The error of a question that the worker does not answer. Where there is no worker, it says whose
/// there is.
pub(crate) fn refused(error: ClientError, config: &Config) -> anyhow::Error {
    match (&error, config.domain()) {
        (ClientError::Unanswered(QueryError::NoWorker), Ok(domain)) => {
            anyhow!("{}", NoWorker::seen_nowhere(&domain))
        }
        _ => error.into(),
    }
}

fn is_unknown_robot(error: &ClientError) -> bool {
    matches!(error, ClientError::Refused(refused) if refused.reason == QueryRefusal::UnknownRobot)
}

fn speed(text: &str) -> Result<f64, String> {
    let found: f64 = text.parse().map_err(|error| format!("{error}"))?;
    if 0.0 < found && found.is_finite() {
        return Ok(found);
    }
    Err("a speed is a number above 0, m/s. Leave it out for the highest that the model knows"
        .to_owned())
}

/// Refuses speeds and loads that the platform does not have, before a worker is looked for.
fn refuse_impossible(config: &Config, plan: &Plan) -> Result<(), UsageError> {
    let Plan::Follow { robots, path, .. } = plan else {
        return Ok(());
    };
    for platform in &config.settings().platforms {
        let has = |robot: &u32| platform.robots.iter().any(|ids| ids.contains(robot));
        if robots.iter().any(has) {
            path.check_on(platform).map_err(|error| UsageError(error.to_string()))?;
        }
    }
    Ok(())
}

/// True if it is the question that is wrong, whatever the fleet is doing.
fn is_wrong(reason: QueryRefusal) -> bool {
    matches!(
        reason,
        QueryRefusal::Question | QueryRefusal::Kind | QueryRefusal::TooLarge | QueryRefusal::Length
    )
}
