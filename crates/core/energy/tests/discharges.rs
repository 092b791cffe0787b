//! A learned capacity on real discharges: how long a robot lasts from full to empty, forecast from
//! the discharges before.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use joulebus_energy::Capacity;
use joulebus_testkit::recordings::shared;

/// Discharges before the first one that is forecast.
const LEARNED: usize = 20;

/// Minutes of each discharge from a full battery, in time order. Also those in which the robot stood
/// still for a day.
fn minutes() -> Option<Vec<f32>> {
    let text =
        std::fs::read_to_string(shared("data/gopigo_discharges")?.join("discharges.csv")).unwrap();
    let (names, rows) = text.split_once('\n').unwrap();
    let at = |name: &str| names.trim().split(',').position(|other| other == name).unwrap();
    let [undocked, empty, minutes] = ["v_undock", "soc_dock", "minutes"].map(at);
    let rows = rows.lines().filter_map(|row| {
        let row: Vec<&str> = row.split(',').collect();
        let is_full = row[undocked].parse::<f32>().is_ok_and(|volts| volts >= 11.6);
        row[minutes].parse().ok().filter(|_| is_full && row[empty] == "0")
    });
    Some(rows.collect())
}

/// Mean absolute error, and the share of forecasts more than 10 % too long, %.
fn scores(minutes: &[f32], from: usize, forecast: impl Fn(usize) -> f32) -> (f32, f32) {
    let count = (minutes.len() - from) as f32;
    let (mut errors, mut long) = (0.0, 0.0);
    for (at, found) in minutes.iter().enumerate().skip(from) {
        let expected = forecast(at);
        errors += (expected / found - 1.0).abs();
        long += f32::from(u8::from(expected > 1.1 * found));
    }
    (100.0 * errors / count, 100.0 * long / count)
}

fn mean(of: &[f32]) -> f32 {
    of.iter().sum::<f32>() / of.len() as f32
}

/// The constants were chosen on the first half. The second is what counts.
#[test]
fn the_minutes_of_a_robot_whose_battery_ages_are_forecast_from_the_discharges_before() {
    let Some(minutes) = minutes() else {
        return;
    };
    let mut learned = vec![Capacity::default()];
    for minutes in &minutes {
        let mut next = *learned.last().unwrap();
        // Where nothing is stated, the first discharge is.
        assert!(next.learn(next.learned().unwrap_or(*minutes), *minutes, (1.0, 0.0)));
        learned.push(next);
    }
    let rule = |at: usize| learned[at].learned().unwrap();
    let half = minutes.len() / 2;
    for (part, from) in [("all", LEARNED), ("second half", half)] {
        let of = |name, (error, long)| {
            let count = minutes.len() - from;
            println!("{part}, {count}: {name}: MAPE {error:.2} %, {long:.2} % too long");
        };
        of("learned", scores(&minutes, from, rule));
        of(
            "fixed, the mean of the first 20",
            scores(&minutes, from, |_| mean(&minutes[..LEARNED])),
        );
        of("the last one", scores(&minutes, from, |at| minutes[at - 1]));
        of("the mean of the last five", scores(&minutes, from, |at| mean(&minutes[at - 5..at])));
    }
    let inside = (LEARNED..minutes.len()).filter(|at| {
        let off = minutes[*at] / rule(*at) - 1.0;
        off.abs() <= 2.0 * learned[*at].sd
    });
    let inside = inside.count() as f32 / (minutes.len() - LEARNED) as f32;
    println!("inside the interval: {:.1} %", 100.0 * inside);
    let (all, all_long) = scores(&minutes, LEARNED, rule);
    let (second, second_long) = scores(&minutes, half, rule);
    let fixed = scores(&minutes, LEARNED, |_| mean(&minutes[..LEARNED]));
    assert!(all <= 2.5 && all_long <= 2.0, "MAPE {all:.2} %, {all_long:.2} % too long");
    assert!(second <= 2.0 && second_long <= 1.0, "MAPE {second:.2} %, {second_long:.2} %");
    assert!(3.0 * all < fixed.0 && 10.0 * all_long < fixed.1, "{fixed:?}");
    assert!((0.9..0.999).contains(&inside), "{inside}");
}
