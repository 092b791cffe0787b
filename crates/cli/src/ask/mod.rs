//! `joulebus ask`: what a plan costs, computed here from shared memory.

mod path_file;
mod place;
mod report;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::ArgGroup;
use joulebus_plan::{Candidates, Planner, Ranked, Robot, Trip, View, rank};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;

use place::{Place, ReturnTo};
use report::{AnswerReport, Report};

/// Timeout for a frame of the worker.
const PATIENCE: Duration = Duration::from_secs(3);

/// Ask what a plan of a robot costs, whether the robot makes it, and which robot does it for the least
#[derive(Debug, clap::Args)]
#[command(
    group = ArgGroup::new("who").required(true).args(["robot", "rank"]),
    group = ArgGroup::new("plan").required(true).args(["path", "idle"]),
    after_help = "Examples:\n  \
    joulebus ask --robot 7 --path p.csv                     energy, what is left, whether it makes it\n  \
    joulebus ask --robot 7 --path p.csv --return dock       and back to where the path begins\n  \
    joulebus ask --robot 7 --path p.csv --return 1.5,-0.2 --format json\n  \
    joulebus ask --rank 7,9,12 --path p.csv                 the cheapest first\n  \
    joulebus ask --robot 7 --idle 60                        a minute at rest\n\n\
    A path file is CSV with the columns x_m,y_m and, if wanted, speed_mps towards each point; the robot \
    is at the first point and looks at the second:\n\n    \
    x_m,y_m,speed_mps\n    0,0,\n    2,0,0.2\n    2,1.5,0.1\n\n\
    Verdicts: yes, the upper end of the energy at the asked coverage fits into the lower bound of what the \
    battery can spare above its reserve, on every leg; tight, the expected energy fits, but not so surely, \
    or something weakens the answer (it is listed); no, it does not fit; unknown, with the reason. \
    Computed in this process from the worker's state in shared memory and the models of the config, \
    which must be the worker's.\n\
    Exit codes: 0 answered, whatever the verdict; 1 no worker, no such robot, or another config or model \
    than the worker's; 2 a wrong question."
)]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
    /// The robot
    #[arg(long, value_name = "ID")]
    robot: Option<u32>,
    /// Several robots, the best first: by verdict, then by energy
    #[arg(long, value_name = "ID,…", value_delimiter = ',')]
    rank: Vec<u32>,
    /// Follow this path (CSV)
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// Stand still for this time, s
    #[arg(long, value_name = "SECONDS")]
    idle: Option<f32>,
    /// Then return: to the dock, or to a point, m
    #[arg(
        long = "return",
        value_name = "dock|X,Y",
        conflicts_with = "idle",
        allow_hyphen_values = true
    )]
    return_to: Option<ReturnTo>,
    /// Where the dock is, m [default: where the path begins]
    #[arg(
        long,
        value_name = "X,Y",
        requires = "return_to",
        allow_hyphen_values = true
    )]
    dock: Option<Place>,
    /// Speed where the path file states none, m/s [default: the platform's greatest]
    #[arg(long, value_name = "M/S", conflicts_with = "idle")]
    speed: Option<f64>,
    /// Coverage of the intervals, 0.5 to 0.999
    #[arg(long, value_name = "SHARE", default_value_t = 0.9)]
    coverage: f32,
    /// With --format json: the power of every step
    #[arg(long)]
    power: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let config = args.config.load()?;
    let path = args.path.as_deref().map(path_file::read).transpose()?;
    let mut planner = Planner::with_config(&config, "ask")?;
    let view = planner.wait(PATIENCE)?;
    let answers = match &path {
        Some(rows) => args.follow(&view, rows)?,
        None => args.rest(&view, args.idle.unwrap_or_default())?,
    };
    output.report(&Report {
        fleet: config.fleet().to_owned(),
        tick: view.tick(),
        age_s: view.age_ns() as f64 * 1e-9,
        coverage: args.coverage,
        answers,
    })?;
    Ok(Outcome::Done)
}

impl Args {
    /// The answers to a path, the best first.
    fn follow(&self, view: &View<'_>, rows: &path_file::Rows) -> anyhow::Result<Vec<AnswerReport>> {
        let robots = self.robots(view)?;
        let path = rows.path(self.speed);
        let begin = path.points[0];
        let back_to = self.return_to.map(|to| match to {
            ReturnTo::Dock => self.dock.map_or(begin, |dock| dock.0),
            ReturnTo::At(place) => place.0,
        });
        let ranked = rank(&robots, &path, back_to, self.coverage)
            .map_err(|error| UsageError(error.to_string()))?;
        let report = |ranked: &Ranked| {
            let robot = robots.iter().find(|robot| robot.id() == ranked.robot);
            // Each was asked about itself.
            robot.map(|robot| self.report_trip(robot, &ranked.trip))
        };
        ranked.iter().filter_map(report).collect()
    }

    /// The answers to a time at rest.
    fn rest(&self, view: &View<'_>, duration_s: f32) -> anyhow::Result<Vec<AnswerReport>> {
        let answer = |robot: &Robot<'_>| {
            let answer = robot
                .idle(duration_s, self.coverage)
                .map_err(|error| UsageError(error.to_string()))?;
            Ok(AnswerReport::new(robot, &answer))
        };
        self.robots(view)?.iter().map(answer).collect()
    }

    fn report_trip(&self, robot: &Robot<'_>, trip: &Trip) -> anyhow::Result<AnswerReport> {
        let mut report = AnswerReport::new(robot, &trip.answer);
        report.turn_back_s = trip.turn_back_s;
        report.asked_to_return = self.return_to.is_some();
        if self.power {
            let followed = &trip.commands;
            let (v_mps, omega_radps) = (&followed.v_mps, &followed.omega_radps);
            let plan = Candidates::new(1, followed.period_s, v_mps, omega_radps)?;
            let mut power_w = vec![f32::NAN; plan.steps()];
            robot.power_w(&plan, &mut power_w)?;
            report.power_w = Some(power_w);
        }
        Ok(report)
    }

    /// The robots asked about.
    fn robots<'a>(&self, view: &View<'a>) -> anyhow::Result<Vec<Robot<'a>>> {
        let asked = self.robot.iter().chain(&self.rank);
        let robots = asked.map(|id| {
            view.robot(*id).with_context(|| {
                let here = view.ids().count();
                format!(
                    "robot {id} is not among the {here} in the fleet: its source must publish samples \
                     of it (`joulebus watch --once` lists the robots)"
                )
            })
        });
        robots.collect()
    }
}
