//! Runs the demo's simulated robots again, and on for 60 s: what its newest outlooks foresaw. Pure.

use std::collections::BTreeMap;

use joulebus_board::{AheadScores, Board};
use joulebus_plant::Plant;
use serde::Serialize;

/// Time that is run ahead, ns.
const AHEAD_NS: u64 = 60_000_000_000;
/// Maximum number of steps of single robots: some tenths of a second in a debug build.
const MAX_ROBOT_STEPS: usize = 200_000;

/// Scores of the newest outlooks over 60 s.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RunAhead {
    /// By the energy that the simulated robots draw.
    Scores(AheadScores),
    /// Reason that there are none.
    NotScored(&'static str),
}

/// Number of robots, from the first, that can be run in time: beyond the past steps, ahead in steps
/// of `period_ns`.
pub(super) fn affordable(steps: usize, period_ns: u64) -> u32 {
    let ahead = AHEAD_NS.div_ceil(period_ns.max(1)) as usize;
    (MAX_ROBOT_STEPS / steps.saturating_add(ahead)) as u32
}

/// Runs `plant` ahead, which is at its start, and scores the board's outlooks by it. The robots'
/// ids count from 0.
pub(super) fn run_ahead(board: &Board, plant: Plant, period_ns: u64) -> RunAhead {
    match drawn_j(board, plant, period_ns) {
        Ok(drawn_j) => RunAhead::Scores(board.score_minute(&drawn_j)),
        Err(why) => RunAhead::NotScored(why),
    }
}

/// Energy of each robot over 60 s from its newest outlook on, J. The plant takes the same steps as
/// that of the source, and each reading that was sent must be found again.
fn drawn_j(
    board: &Board,
    mut plant: Plant,
    period_ns: u64,
) -> Result<BTreeMap<u32, f64>, &'static str> {
    let newest_ns = board.newest_outlooks().map(|(_, at_ns, _)| at_ns).max();
    let at_ns = newest_ns.ok_or("no outlook was read")?;
    let past = &board.steps[..board.steps.partition_point(|(stamp_ns, _)| *stamp_ns <= at_ns)];
    let (Some((first_ns, _)), Some((last_ns, _))) = (past.first(), past.last()) else {
        return Err("no frame of samples was read");
    };
    if *last_ns != at_ns {
        return Err("the frame of the newest outlooks was not read, or the demo was too long");
    }
    // The source sends its first frame one period after its start.
    let start_ns = first_ns.saturating_sub(period_ns);
    for (stamp_ns, power_w) in past {
        let reading = plant.advance(stamp_ns.saturating_sub(start_ns)).first();
        if reading.is_none_or(|reading| reading.power_w != *power_w) {
            return Err("the first robot's readings could not be repeated");
        }
    }
    let readings = plant.advance(0);
    let mut robots = Vec::new();
    for (robot, _, power_w) in board.newest_outlooks().filter(|newest| newest.1 == at_ns) {
        match readings.get(robot as usize) {
            Some(reading) if f64::from(reading.power_w) != power_w => {
                return Err("the last readings could not be repeated");
            }
            Some(_) => robots.push(robot),
            None => {}
        }
    }
    let before_j: Vec<f64> = plant.drawn_j().collect();
    let end_ns = plant.now_ns() + AHEAD_NS;
    while plant.now_ns() < end_ns {
        plant.advance((plant.now_ns() + period_ns.max(1)).min(end_ns));
    }
    let drawn_j: Vec<f64> = plant.drawn_j().zip(before_j).map(|(end, begin)| end - begin).collect();
    Ok(robots.into_iter().map(|robot| (robot, drawn_j[robot as usize])).collect())
}

#[cfg(test)]
mod tests {
    use joulebus_plant::{Fault, SimReading};
    use joulebus_wire::{
        Budget, Forecast, ForecastHeader, OUTLOOK_S, Outlook, Sample, budget_flag, forecast_flag,
        outlook_flag,
    };

    use super::*;

    const PERIOD_NS: u64 = 33_333_333;
    const START_NS: u64 = 5_000_000_000;

    fn plant(seed: u64, load_w: f64) -> Plant {
        let load = Fault::ExtraLoad { power_w: load_w };
        Plant::new(seed, 2).with_fault(1, load, 0.5).unwrap()
    }

    /// One tick of a board, at a time after the plant's start. The outlooks expect `watts`, and
    /// bounds 10 % apart from them.
    fn tick(board: &mut Board, since_ns: u64, readings: &[SimReading], watts: [f64; 2]) {
        let stamp_ns = START_NS + since_ns;
        let first = Sample::new(0, since_ns, stamp_ns).reading(readings[0].power_w, stamp_ns);
        board.source_sent(1, since_ns, Some(&first));
        let of_each = readings.iter().map(|reading| Forecast {
            robot: reading.robot as u32,
            flags: forecast_flag::READING | forecast_flag::SAMPLE,
            reading_w: reading.power_w,
            stamp_ns,
            ..Forecast::default()
        });
        board.forecasts(&ForecastHeader::default(), &of_each.collect::<Vec<_>>(), stamp_ns);
        let budget = |robot| Budget {
            robot,
            flags: budget_flag::LEDGER,
            drawn_uj: (since_ns / 1_000) as i64,
            metered_ns: since_ns,
            stamp_ns,
            ..Budget::default()
        };
        board.budgets(&[budget(0), budget(1)]);
        let outlook = |robot: u32| {
            let joules = |share| OUTLOOK_S.map(|s| (watts[robot as usize] * share) as f32 * s);
            Outlook {
                robot,
                flags: outlook_flag::ENERGY,
                bounded: 4,
                stamp_ns,
                energy_j: joules(1.0),
                energy_lo_j: joules(0.9),
                energy_hi_j: joules(1.1),
                ..Outlook::default()
            }
        };
        board.outlooks(&[outlook(0), outlook(1)]);
    }

    /// A board that has read the plant's first 40 steps, one of which was skipped.
    fn board(watts: [f64; 2]) -> Board {
        let (mut board, mut plant) = (Board::new(0), plant(7, 3.0));
        for since_ns in (1..=40).filter(|step| *step != 20).map(|step| step * PERIOD_NS) {
            tick(&mut board, since_ns, plant.advance(since_ns), watts);
        }
        board
    }

    /// Mean power of both robots by their own readings, over the minute after those of the board.
    fn measured_w() -> [f64; 2] {
        let mut plant = plant(7, 3.0);
        let mut sum_w = [0.0; 2];
        for step in (1..=1840).filter(|step| *step != 20) {
            let readings = plant.advance(step * PERIOD_NS);
            for (sum_w, reading) in sum_w.iter_mut().zip(readings).filter(|_| step > 40) {
                *sum_w += f64::from(reading.power_w) / 1800.0;
            }
        }
        sum_w
    }

    #[test]
    fn outlooks_are_scored_by_what_the_robots_draw_in_the_next_minute() {
        let watts = measured_w();
        assert!(watts[1] > 3.0, "it has the load: {watts:?}");
        for (share, error, coverage) in [(1.0, 0.0, 1.0), (1.5, 0.5, 0.0), (0.5, 0.5, 0.0)] {
            let board = board(watts.map(|watts| share * watts));
            let RunAhead::Scores(scores) = run_ahead(&board, plant(7, 3.0), PERIOD_NS) else {
                panic!("{share}: not scored");
            };
            assert_eq!((scores.horizon_s, scores.compared), (60.0, 2));
            assert!((scores.error.unwrap() - error).abs() < 0.005, "{share}: {scores:?}");
            assert_eq!(scores.coverage, Some(coverage), "{share}: {scores:?}");
            // The ledger of the board meters 1 W.
            let mean_error = 1.0 - 2.0 / watts.iter().sum::<f64>();
            assert!((scores.mean_5s_error.unwrap() - mean_error).abs() < 0.005, "{scores:?}");
        }
    }

    #[test]
    fn a_run_that_differs_from_what_was_read_is_not_scored() {
        let whole = board([4.0; 2]);
        let without = |steps: std::ops::Range<usize>| {
            let mut board = whole.clone();
            board.steps.drain(steps);
            board
        };
        for (board, (seed, load_w), expected) in [
            (Board::new(0), (7, 3.0), "no outlook"),
            (without(0..39), (7, 3.0), "no frame"),
            (without(38..39), (7, 3.0), "newest outlooks"),
            (without(0..1), (7, 3.0), "first robot's"),
            (without(9..12), (7, 3.0), "first robot's"),
            (whole.clone(), (8, 3.0), "first robot's"),
            (whole.clone(), (7, 2.0), "last readings"),
        ] {
            let RunAhead::NotScored(why) = run_ahead(&board, plant(seed, load_w), PERIOD_NS) else {
                panic!("{expected}: scored");
            };
            assert!(why.contains(expected), "{why}");
        }
    }

    #[test]
    fn as_many_robots_are_run_as_time_allows() {
        let found = [(600, PERIOD_NS), (54_000, PERIOD_NS), (usize::MAX, 0)]
            .map(|(steps, period_ns)| affordable(steps, period_ns));
        assert_eq!(found, [83, 3, 0]);
    }
}
