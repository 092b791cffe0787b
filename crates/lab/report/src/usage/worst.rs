//! The run that used most, and why.

use super::steps::{AtSpeed, MIN_STEPS, Motion, Run, Speeds, Step, Sums, significant};

/// A run that uses this much more than the others hardly differs.
const HARDLY: f64 = 1.1;
/// Share of a run's time at speeds that the others have too, for a comparison.
const COMPARABLE: f64 = 0.5;
/// A cause with this share of the difference is the main one.
const MAIN: f64 = 2.0 / 3.0;

/// The worst run and the reason, in sentences.
pub(super) fn worst_run(runs: &[Run], speeds: &Speeds) -> String {
    let per_metre: fn(&Sums) -> f64 = Sums::wh_per_m;
    let of = |value: fn(&Sums) -> f64| {
        let long = runs.iter().enumerate().filter(|(_, run)| run.steps.len() >= MIN_STEPS);
        let values = long.map(|(at, run)| (at, value(&run.sums())));
        values.filter(|(_, value)| value.is_finite()).collect::<Vec<_>>()
    };
    let with_speed = of(per_metre);
    let (values, has_speed) = match with_speed.len() {
        ..2 => (of(Sums::mean_w), false),
        _ => (with_speed, true),
    };
    if values.len() < 2 {
        return "Which run is the worst is not known: it takes two with plausible readings."
            .to_owned();
    }
    let Some((worst, value)) = values.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return String::new();
    };
    let run = &runs[worst];
    let compared = values.iter().filter(|(at, _)| *at != worst);
    let others: Vec<&Run> = compared.map(|(at, _)| &runs[*at]).collect();
    let steps = others.iter().flat_map(|run| &run.steps);
    let theirs = Sums::of(steps.clone());
    let (unit, theirs) = match has_speed {
        true => ("Wh per metre", theirs.wh_per_m()),
        false => ("W", theirs.mean_w()),
    };
    let what = format!(
        "Worst run: {}, {} {unit}, where the others together use {}.",
        run.name,
        significant(value).shown(),
        significant(theirs).shown()
    );
    let why = match has_speed {
        true => why(speeds, (&run.steps, value), (steps, theirs)),
        false if runs.iter().any(|run| run.sums().distance_m > 0.0) => {
            "Why is not known: fewer than two runs moved a metre.".to_owned()
        }
        false => "Why is not known: the speeds are not.".to_owned(),
    };
    format!("{what} {why}")
}

/// The share of a run's time in which it rests, and its mean speed otherwise, m/s.
fn driving<'a>(speeds: &Speeds, steps: impl Iterator<Item = &'a Step> + Clone) -> [f64; 2] {
    let drives = |step: &&Step| matches!(speeds.motion(step), Motion::Drives(_));
    let (all, driven) = (Sums::of(steps.clone()), Sums::of(steps.filter(drives)));
    [1.0 - driven.driven_s / all.driven_s, driven.distance_m / driven.driven_s]
}

/// Compares the power at the same speeds, and the speeds.
fn why<'a>(
    speeds: &Speeds,
    (steps, value): (&[Step], f64),
    (others, theirs): (impl Iterator<Item = &'a Step> + Clone, f64),
) -> String {
    if !(theirs > 0.0 && value > 0.0) {
        return "Why is not known: the batteries were charged on the way.".to_owned();
    }
    let ratio = value / theirs;
    if ratio < HARDLY {
        return "It hardly differs from them.".to_owned();
    }
    let known = AtSpeed::of(speeds, &others);
    let known = known.iter().filter(|one| one.motion != Motion::Unknown);
    let known: Vec<(Motion, f64)> = known.map(|one| (one.motion, one.mean_w())).collect();
    let (mut used_j, mut expected_j, mut compared_s) = (0.0, 0.0, 0.0);
    for step in steps {
        let motion = speeds.motion(step);
        let expected =
            known.iter().find(|(known, power_w)| *known == motion && power_w.is_finite());
        if let Some((_, power_w)) = expected {
            used_j += step.power_w * step.duration_s;
            expected_j += power_w * step.duration_s;
            compared_s += step.duration_s;
        }
    }
    let [stands, speed_mps] = driving(speeds, steps.iter());
    let [they_stand, their_speed_mps] = driving(speeds, others);
    let how = format!(
        "It does not drive in {:.0} % of the time, the others in {:.0} %. Otherwise it drives {} \
         m/s, the others {} m/s.",
        100.0 * stands,
        100.0 * they_stand,
        significant(speed_mps).shown(),
        significant(their_speed_mps).shown()
    );
    let time_s = Sums::of(steps).driven_s;
    if !(compared_s >= COMPARABLE * time_s && expected_j > 0.0 && used_j > 0.0) {
        return format!("{how} Whether it draws more at the same speed is not known.");
    }
    let same = used_j / expected_j;
    let share = libm::log(same) / libm::log(ratio);
    let cause = match share {
        _ if share >= MAIN => "So it is mostly the robot, its load or its ground.",
        _ if share <= 1.0 - MAIN => "So it is mostly how it was driven.",
        _ => "So it is both: the robot, its load or its ground, and how it was driven.",
    };
    let percent = (100.0 * (same - 1.0)).round();
    let same = match percent {
        _ if percent > 0.0 => format!("it draws {percent} % more power than they do"),
        _ if percent < 0.0 => format!("it draws {} % less power than they do", -percent),
        _ => "it draws the same power".to_owned(),
    };
    let compared = match (100.0 * compared_s / time_s).round() {
        all if all >= 100.0 => String::new(),
        part => format!(" ({part} % of its time are compared)"),
    };
    format!("At the same speeds {same}{compared}. {how} {cause}")
}
