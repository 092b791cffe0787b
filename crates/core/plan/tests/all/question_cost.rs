//! The cost of a question whose paths are followed once for all robots.

use std::time::Instant;

use crate::world::{Rows, fleet};
use joulebus_plan::answering::Work;
use joulebus_plan::{Path, Plan, Point, Question, RobotRows};
use joulebus_wire::MAX_QUERY_STEPS;

fn rows(robot: u32) -> RobotRows {
    let mut rows = Rows::with_usable(20_000.0);
    (rows.state.robot, rows.budget.robot) = (robot, robot);
    RobotRows {
        header: rows.header,
        state: rows.state,
        budget: Some((rows.budget_header, rows.budget)),
        now_ns: rows.now_ns,
    }
}

/// `cargo test --release -p joulebus-plan --test all question_cost -- --ignored --nocapture`
#[test]
#[ignore = "prints times: CONTRIBUTING.md has the command"]
fn what_a_path_and_the_time_to_turn_back_cost() {
    let fleet = fleet();
    println!("a path at 0.15 m/s, 30 Hz, until when each robot can turn back; best");
    println!("robots  m    each by itself ms  as a question ms  longest step ms  from new rows ms");
    for (robots, length_m, times) in
        [(1, 6.0, 20), (4, 6.0, 20), (20, 6.0, 20), (64, 6.0, 20), (1, 520.0, 3), (20, 520.0, 1)]
    {
        let (from, end) = (Point::new(0.0, 0.0), Point::new(length_m, 0.0));
        let path = Path::new(&[from, end], 0.15);
        let ids: Vec<u32> = (0..robots).collect();
        let mut best_ms = [f64::INFINITY; 4];
        for _ in 0..times {
            let begun = Instant::now();
            for id in &ids {
                let rows = rows(*id);
                let robot = fleet.robot(&rows.frames()).unwrap();
                robot.can_finish(&path, Some(end), 0.9).unwrap();
            }
            let alone_ms = begun.elapsed().as_secs_f64() * 1e3;
            let plan = Plan::Follow { robots: ids.clone(), path: path.clone(), back_to: Some(end) };
            let question = Question { plan, ..Question::default() };
            let find = |robot| Some(rows(robot));
            let begun = Instant::now();
            let mut work = Work::begin(question, find, MAX_QUERY_STEPS).unwrap();
            let mut longest_ms: f64 = 0.0;
            loop {
                let step = Instant::now();
                let is_done = work.step(&fleet).unwrap();
                longest_ms = longest_ms.max(step.elapsed().as_secs_f64() * 1e3);
                if is_done {
                    break;
                }
            }
            let whole_ms = begun.elapsed().as_secs_f64() * 1e3;
            let begun = Instant::now();
            let mut work = work.renew(find).unwrap();
            assert!(work.rest(&fleet).unwrap());
            let renewed_ms = begun.elapsed().as_secs_f64() * 1e3;
            for (best, found) in
                best_ms.iter_mut().zip([alone_ms, whole_ms, longest_ms, renewed_ms])
            {
                *best = best.min(found);
            }
        }
        let [alone, whole, longest, renewed] = best_ms;
        println!(
            "{robots:>6} {length_m:>4} {alone:>17.2} {whole:>17.2} {longest:>16.3} {renewed:>17.3}"
        );
    }
}
