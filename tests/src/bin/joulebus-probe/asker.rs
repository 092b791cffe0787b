//! Clients that ask the worker about plans: well-behaved, flooding, hostile.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_plan::answering::Work;
use joulebus_plan::{Path, Plan, Point, Question, Reply, RobotRows, Verdict};
use joulebus_planner::{ClientError, PlanClient, Planner, QueryError};
use joulebus_tests::AskerLine;
use joulebus_wire::{MAX_QUERY_STEPS, QueryHeader, QueryRefusal, fnv1a, query_flag};

use crate::{Done, print_line, stop_with_stdin};

/// Far beyond what an answer takes: only a defect reaches it.
const PATIENCE: Duration = Duration::from_secs(120);

fn commands(robot: u32, candidates: usize, steps: usize) -> Question {
    let wave = |at: usize| ((at * 7 + robot as usize) % 19) as f32 * 0.01;
    let places = 0..candidates * steps;
    Question {
        plan: Plan::WhatIf {
            robot,
            candidates,
            period_s: 1.0 / 30.0,
            v_mps: places.clone().map(wave).collect(),
            omega_radps: places.map(|at| 5.0 * wave(at + 3)).collect(),
        },
        coverage: 0.9,
        power: true,
        moments: 0,
    }
}

/// A path there and back, long enough to take milliseconds.
fn path(robots: &[u32], length_m: f64) -> Question {
    let dock = Point::new(0.0, 0.0);
    let points = [dock, Point::new(length_m, 0.0), Point::new(length_m, 1.0)];
    Question {
        plan: Plan::Follow {
            robots: robots.to_vec(),
            path: Path::new(&points, 0.15),
            back_to: Some(dock),
        },
        coverage: 0.9,
        power: robots.len() == 1,
        moments: 0,
    }
}

fn named(error: &ClientError) -> String {
    match error {
        ClientError::Refused(refused) => refused.reason.name().to_owned(),
        ClientError::Unanswered(error) => {
            let text = format!("{error:?}");
            let end = text.find(|c: char| !c.is_alphanumeric());
            text[..end.unwrap_or(text.len())].to_owned()
        }
        other => format!("{other:?}"),
    }
}

/// Asks as fast as it can until its stdin ends: `heavy` questions take milliseconds. Prints when
/// the first answer has arrived, and again after each failure; failures as they come.
pub(crate) fn flood(config: &Config, heavy: bool) -> Done {
    let stop = stop_with_stdin();
    let mut client = PlanClient::with_config(config, "asker")?;
    let (mut answered, mut is_asking) = (0, false);
    while !stop.load(Ordering::Relaxed) {
        let robot = (answered % 4) as u32;
        let question = if heavy { path(&[0, 1, 2, 3], 4.0) } else { commands(robot, 16, 50) };
        let begun = Instant::now();
        match client.ask(&question, PATIENCE) {
            Ok(_) => {
                answered += 1;
                if !std::mem::replace(&mut is_asking, true) {
                    print_line(&AskerLine::Asking)?;
                }
            }
            Err(error) => {
                let after_ns = begun.elapsed().as_nanos() as u64;
                let name = named(&error);
                if is_asking
                    || !["NoWorker", "NotServed", "NoFrame", "UnknownRobot"]
                        .contains(&name.as_str())
                {
                    print_line(&AskerLine::Failed { name, after_ns })?;
                }
                is_asking = false;
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }
    print_line(&AskerLine::Done { answered })
}

/// Asks heavy questions in six threads of one process, of which the worker lets four wait, until its
/// stdin ends. Prints why a question was refused, once each.
pub(crate) fn crowd(config: &Config) -> Done {
    let stop = stop_with_stdin();
    let refused = std::sync::Mutex::new(std::collections::BTreeSet::new());
    let ask = || -> Result<u64, String> {
        let described = |error: &dyn std::fmt::Display| error.to_string();
        let mut client =
            PlanClient::with_config(config, "crowd").map_err(|error| described(&error))?;
        let mut answered = 0;
        while !stop.load(Ordering::Relaxed) {
            match client.ask(&path(&[0, 1, 2, 3], 4.0), PATIENCE) {
                Ok(_) => answered += 1,
                Err(error) => {
                    let name = named(&error);
                    if refused.lock().map_err(|error| described(&error))?.insert(name.clone()) {
                        let line = AskerLine::Failed { name, after_ns: 0 };
                        print_line(&line).map_err(|error| described(&error))?;
                    }
                    std::thread::sleep(Duration::from_millis(2));
                }
            }
        }
        Ok(answered)
    };
    let answered = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..6).map(|_| scope.spawn(ask)).collect();
        let joined = threads.into_iter().map(|thread| thread.join().expect("it does not panic"));
        joined.sum::<Result<u64, String>>()
    })?;
    print_line(&AskerLine::Done { answered })
}

/// Asks `count` small questions, one after the other.
pub(crate) fn calm(config: &Config, count: u64) -> Done {
    let mut client = PlanClient::with_config(config, "calm")?;
    for asked in 0..count {
        let begun = Instant::now();
        if let Err(error) = client.ask(&commands((asked % 4) as u32, 1, 5), PATIENCE) {
            let after_ns = begun.elapsed().as_nanos() as u64;
            let name = named(&error);
            print_line(&AskerLine::Failed { name, after_ns })?;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    print_line(&AskerLine::Done { answered: count })
}

/// Asks whether robots can drive six metres straight on and return. Until `count` answers were a yes for every robot, each about a state that
/// was at most two ticks old.
pub(crate) fn far(config: &Config, count: u64) -> Done {
    let mut client = PlanClient::with_config(config, "far")?;
    let (from, end) = (Point::new(0.0, 0.0), Point::new(6.0, 0.0));
    let question = Question {
        plan: Plan::Follow {
            robots: vec![0, 1, 2, 3],
            path: Path::new(&[from, end], 0.15),
            // No command lies outside the training data.
            back_to: Some(end),
        },
        coverage: 0.9,
        power: false,
        moments: 0,
    };
    let most_age_ns = 2 * config.settings().platforms[0].period_ns;
    let mut answered = 0;
    while answered < count {
        match client.ask(&question, PATIENCE) {
            Ok(of) => {
                let mut rows = of.reply.rows.iter();
                let is_yes = rows.all(|row| row.answer.verdict == Verdict::Yes);
                if is_yes && of.age_ns > most_age_ns {
                    return Err(format!("a yes about a state {} ns old", of.age_ns).into());
                }
                answered += u64::from(is_yes);
            }
            Err(error) if ["NotServed", "NoFrame", "UnknownRobot"].contains(&&*named(&error)) => {
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(error) => return Err(error.into()),
        }
    }
    print_line(&AskerLine::Done { answered })
}

/// Asks once, with a short deadline.
pub(crate) fn late(config: &Config) -> Done {
    let stop = stop_with_stdin();
    let mut client = PlanClient::with_config(config, "late")?;
    while !stop.load(Ordering::Relaxed) {
        let begun = Instant::now();
        let asked = client.ask(&commands(0, 1, 5), Duration::from_millis(200));
        let after_ns = begun.elapsed().as_nanos() as u64;
        match asked {
            Ok(_) => print_line(&AskerLine::Asking)?,
            Err(error) => {
                let name = named(&error);
                print_line(&AskerLine::Failed { name, after_ns })?;
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// Asks the worker and computes here, until `count` answers of the same frames have been compared.
pub(crate) fn bits(config: &Config, count: u64) -> Done {
    let mut planner = Planner::with_config(config, "bits")?;
    let mut client = PlanClient::with_config(config, "bits-client")?;
    let fleet = planner.fleet().clone();
    let mut compared = 0;
    while compared < count {
        let question = match compared % 3 {
            0 => commands(1, 4, 50),
            1 => path(&[2], 1.0),
            _ => path(&[3, 1, 0, 2], 2.0),
        };
        // Frames that are newer than those of the answer have taken their place by then.
        let mut seen: Vec<Vec<RobotRows>> = Vec::new();
        let look = |planner: &mut Planner, seen: &mut Vec<Vec<RobotRows>>| -> Done {
            let view = planner.wait(PATIENCE)?;
            let rows = question.plan.robots().iter().map(|robot| view.rows(*robot));
            seen.extend(rows.collect::<Option<Vec<RobotRows>>>());
            Ok(())
        };
        look(&mut planner, &mut seen)?;
        let answered = match client.ask(&question, PATIENCE) {
            Ok(answered) => answered,
            // It has just been started, and the robots have not sent a sample.
            Err(error) if ["NotServed", "NoFrame", "UnknownRobot"].contains(&&*named(&error)) => {
                std::thread::sleep(Duration::from_millis(5));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        look(&mut planner, &mut seen)?;
        let is_of = |rows: &&Vec<RobotRows>| {
            rows.iter().all(|row| {
                row.header.worker_epoch == answered.worker_epoch
                    && row.header.tick == answered.tick
                    && row.budget.is_some_and(|(of, _)| of.tick == answered.budget_tick)
            })
        };
        let Some(rows) = seen.iter().find(is_of) else {
            continue;
        };
        let find = |robot| rows.iter().find(|row| row.state.robot == robot).copied();
        let mut work = Work::begin(question.clone(), find, MAX_QUERY_STEPS)?;
        while !work.step(&fleet)? {}
        // What was stale when the worker sent it is stale here.
        let sent_ns = rows[0].header.sent_ns + answered.age_ns;
        let here = work.finish_at(sent_ns);
        if !same(&here, &answered.reply) {
            return Err(format!("{here:?}\nis not\n{:?}", answered.reply).into());
        }
        compared += 1;
    }
    print_line(&AskerLine::Done { answered: compared })
}

/// Compares two replies by their bits.
fn same(one: &Reply, other: &Reply) -> bool {
    let words = |reply: &Reply| {
        let (mut header, mut words) = (joulebus_wire::AnswerHeader::default(), Vec::new());
        reply.encode(&mut header, &mut words);
        (header, words)
    };
    !one.rows.is_empty() && words(one) == words(other)
}

/// Sends questions that must be refused, and prints the reasons, each beside what is expected.
pub(crate) fn hostile(config: &Config) -> Done {
    let bus = join(config, "hostile")?;
    let mut client = bus.query_client(&config.limits())?;
    let fleet = fnv1a(config.fleet().bytes());
    for (expected, header, values) in refused(fleet) {
        let deadline_ns = joulebus_consumer::clock::monotonic_ns() + PATIENCE.as_nanos() as u64;
        let is_late = expected == QueryRefusal::Deadline;
        let asked = QueryHeader { deadline_ns: if is_late { 1 } else { deadline_ns }, ..header };
        let found = client.send(asked, &values).and_then(|()| client.wait(deadline_ns));
        let found = match found {
            Ok((answer, _)) => QueryRefusal::decode(answer.refusal)
                .map_or_else(|| "answered".to_owned(), |reason| reason.name().to_owned()),
            Err(QueryError::TooLong { .. }) => "TooLarge".to_owned(),
            Err(error) => error.to_string(),
        };
        print_line(&AskerLine::Refused { expected: expected.name().to_owned(), found })?;
    }
    print_line(&AskerLine::Done { answered: 0 })
}

/// Questions, and why each is refused.
fn refused(fleet: u64) -> Vec<(QueryRefusal, QueryHeader, Vec<f64>)> {
    use QueryRefusal as Reason;
    let (good, values) = commands(0, 4, 10).encode(fleet).expect("it fits");
    let (followed, points) = path(&[0], 1.0).encode(fleet).expect("it fits");
    let value = |at: usize, value: f64| {
        let mut values = values.clone();
        values[at] = value;
        values
    };
    let point = |at: usize, value: f64| {
        let mut points = points.clone();
        points[at] = value;
        points
    };
    type Change = fn(&mut QueryHeader);
    let changes: [(Reason, Change); 14] = [
        (Reason::Schema, |header| header.schema = 0),
        (Reason::Fleet, |header| header.fleet ^= 1),
        (Reason::Kind, |header| header.kind = 0),
        (Reason::Kind, |header| header.kind = u32::MAX),
        (Reason::Kind, |header| header.flags |= query_flag::ALL + 1),
        (Reason::TooLarge, |header| header.robots = u32::MAX),
        (Reason::TooLarge, |header| header.candidates = u32::MAX),
        (Reason::TooLarge, |header| header.steps = u32::MAX),
        (Reason::Length, |header| header.steps = 4_096),
        (Reason::Question, |header| header.coverage = f32::NAN),
        (Reason::Question, |header| header.coverage = 1.0),
        (Reason::Question, |header| header.period_s = -1.0),
        (Reason::Question, |header| header.period_s = f32::NAN),
        (Reason::Deadline, |_| ()),
    ];
    let changed = changes.into_iter().map(|(reason, change)| {
        let mut header = good;
        change(&mut header);
        (reason, header, values.clone())
    });
    let mut all: Vec<_> = changed.collect();
    let (mut of_no_robot, mut of_no_plan) = (good, good);
    (of_no_robot.robots, of_no_plan.candidates) = (0, 0);
    all.extend([
        (Reason::TooLarge, good, vec![0.0; 5_000]),
        (Reason::Length, of_no_robot, values[1..].to_vec()),
        (Reason::Length, good, values[..values.len() - 1].to_vec()),
        (Reason::Length, good, Vec::new()),
        (Reason::UnknownRobot, good, value(0, f64::NAN)),
        (Reason::UnknownRobot, good, value(0, -1.0)),
        (Reason::UnknownRobot, good, value(0, 0.5)),
        (Reason::UnknownRobot, good, value(0, 1e300)),
        (Reason::UnknownRobot, good, value(0, 99.0)),
        (Reason::Question, good, value(1, f64::NAN)),
        (Reason::Question, good, value(2, f64::INFINITY)),
        (Reason::Question, good, value(1, 1e300)),
        (Reason::Question, of_no_plan, values[..1].to_vec()),
        (Reason::Question, followed, point(1, f64::NAN)),
        (Reason::Question, followed, point(4, 1e300)),
        // So far away that following it would take hours.
        (Reason::Question, followed, point(4, 1e6)),
        (Reason::Question, followed, point(6, 0.0)),
        (Reason::Question, followed, point(6, f64::NAN)),
    ]);
    let mut away = followed;
    away.return_x_m = f64::NAN;
    all.push((Reason::Question, away, points.clone()));
    all
}
