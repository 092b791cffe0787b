//! Consistency of keys that are individually in range.
//!
//! The values have passed their range checks: none is NaN or infinite.

use std::ops::RangeInclusive;
use std::sync::Arc;

use joulebus_settings::bounds::{self, level_limit_for};

use crate::cpus;
use crate::document::{FleetFile, Listed};
use crate::files::{Attached, check_model, complaint};
use crate::key::{DefaultValue, File, Key};
use crate::keys::KEYS;
use crate::problem::Problem;
use crate::robots;
use crate::values::{Location, Values};

/// Robots that there is room for, at most, if a fleet's file does not state the number.
const UNASKED_ROBOTS: u64 = 1_000;
/// Replaces `alarms.level_limit`.
pub(crate) const LEVEL_RATE: &str = "alarms.level_alarms_per_robot_h";

/// Reports every inconsistency. Doubtful values go to `warnings`.
pub(crate) fn check(
    read: &FleetFile,
    (file, attached): (&Arc<str>, Attached<'_>),
    problems: &mut Vec<Problem>,
    warnings: &mut Vec<Problem>,
) {
    let fleet = &read.values;
    missing(fleet, file, None, problems);
    if read.platforms.is_empty() && !problems.iter().any(|problem| problem.key == "platform") {
        problems.push(Problem {
            file: file.to_string(),
            line: None,
            key: "platform".to_owned(),
            what: "is missing: there is no [[platform]]".to_owned(),
            remedy: "Write [[platform]] with `file` and `robots`, or start from configs/fleet.toml"
                .to_owned(),
        });
    }
    tick(fleet, problems);
    intake(fleet, problems, warnings);
    threads(fleet, problems);
    worker(fleet, warnings);
    level_rate(read, warnings);
    for listed in &read.platforms {
        let values = &listed.values;
        if !listed.cut_short {
            missing(values, file, Some(&listed.header), problems);
        }
        check_model(values, attached, problems);
        model(values, problems, warnings);
        times(values, fleet, problems);
        limits(values, problems);
        battery(values, problems);
    }
    names(read, problems);
    ids(read, problems);
    capacity(read, warnings);
    for problem in problems.iter_mut().chain(warnings) {
        if problem.file.is_empty() {
            problem.file = file.to_string();
        }
    }
}

fn missing(
    values: &Values,
    file: &Arc<str>,
    header: Option<&Location>,
    problems: &mut Vec<Problem>,
) {
    let of_platform = header.is_some();
    let wanted = |key: &&Key| {
        key.default == DefaultValue::Required
            && key.path.starts_with("platform.") == of_platform
            && !values.names(key.path)
            && (!key.path.starts_with("platform.battery.") || values.names_any("platform.battery."))
    };
    for key in KEYS.iter().filter(wanted) {
        // A platform's own keys are reported in the platform's file.
        let location = match key.file {
            File::Platform => values.location("platform.name").or(header),
            _ => header,
        };
        problems.push(Problem {
            file: location.map_or(file, |location| &location.file).to_string(),
            line: location.map(|location| location.line),
            key: key.path.to_owned(),
            what: "is missing".to_owned(),
            remedy: format!("{} ({})", key.doc, key.facts()),
        });
    }
}

/// An inconsistency, reported at the first of the two keys that a file sets.
fn contradiction(keys: [(&Values, &str); 2], what: &str, remedy: &str) -> Problem {
    let [first, second] = keys;
    let (values, key) = if first.0.names(first.1) { first } else { second };
    complaint(values, key, format!("contradicts: {what}"), remedy.to_owned())
}

fn tick(fleet: &Values, problems: &mut Vec<Problem>) {
    let (Some(policy), Some(rate_hz), Some(deadline_ms)) =
        (fleet.text("tick.policy"), fleet.number("tick.rate_hz"), fleet.number("tick.deadline_ms"))
    else {
        return;
    };
    if policy == "on_frame" && deadline_ms * rate_hz >= 1000.0 {
        problems.push(contradiction(
            [(fleet, "tick.deadline_ms"), (fleet, "tick.rate_hz")],
            &format!(
                "{} is not below the period of {}, {} ms",
                fleet.quote("tick.deadline_ms"),
                fleet.quote("tick.rate_hz"),
                1000.0 / rate_hz
            ),
            "Lower the deadline or the rate: the next tick would be due before this one",
        ));
    }
}

fn intake(fleet: &Values, problems: &mut Vec<Problem>, warnings: &mut Vec<Problem>) {
    let (Some(jump_s), Some(leave_s)) =
        (fleet.number("intake.max_jump_s"), fleet.number("intake.leave_after_s"))
    else {
        return;
    };
    let (jump, leave) = ("intake.max_jump_s", "intake.leave_after_s");
    if jump_s < leave_s {
        warnings.push(complaint(
            fleet,
            if fleet.names(jump) { jump } else { leave },
            format!("is doubtful: {} is below {}", fleet.quote(jump), fleet.quote(leave)),
            "A robot that returns in between is refused until it has left: raise max_jump_s"
                .to_owned(),
        ));
    }
    let (Some(every_s), Some(rate_hz)) =
        (fleet.number("ledger.every_s"), fleet.number("tick.rate_hz"))
    else {
        return;
    };
    if every_s * rate_hz < 1.0
        && fleet.text("ledger.checkpoint").is_some_and(|path| !path.is_empty())
    {
        problems.push(contradiction(
            [(fleet, "ledger.every_s"), (fleet, "tick.rate_hz")],
            &format!(
                "{} is below one period of {}",
                fleet.quote("ledger.every_s"),
                fleet.quote("tick.rate_hz")
            ),
            "Between two ticks there is nothing new to save: raise every_s",
        ));
    }
}

/// A thread beyond the list would share the main tick thread's CPU and wait for it.
fn threads(fleet: &Values, problems: &mut Vec<Problem>) {
    let (threads, cpus) = ("worker.threads", "worker.cpus");
    let (Some(asked), Some(listed)) =
        (fleet.number(threads), fleet.text(cpus).and_then(|list| cpus::parse(&list)))
    else {
        return;
    };
    let found = listed.len();
    if found > 0 && asked > found as f64 {
        problems.push(contradiction(
            [(fleet, threads), (fleet, cpus)],
            &format!(
                "{} is more than the {found} CPUs of {}",
                fleet.quote(threads),
                fleet.quote(cpus)
            ),
            "Each thread needs its own CPU: list more of them, lower threads, or write threads = 0 \
             for one on each",
        ));
    }
}

/// Default priority of the kernel's interrupt threads.
const INTERRUPTS: f64 = 50.0;

fn worker(fleet: &Values, warnings: &mut Vec<Problem>) {
    let (cpus, priority, memory) = ("worker.cpus", "worker.priority", "worker.memory");
    let Some(asked) = fleet.number(priority) else {
        return;
    };
    if asked >= INTERRUPTS {
        warnings.push(complaint(
            fleet,
            priority,
            format!(
                "is doubtful: {} preempts the kernel's interrupt threads, which have 50",
                fleet.quote(priority)
            ),
            "Use 1 to 49: the tick depends on data that these threads deliver".to_owned(),
        ));
    }
    let nothing = asked == 0.0
        && fleet.text(cpus).is_some_and(|list| list.trim().is_empty())
        && fleet.text(memory).is_some_and(|word| word == "unlocked");
    if nothing && fleet.text("worker.if_refused").is_some_and(|word| word == "stop") {
        warnings.push(complaint(
            fleet,
            "worker.if_refused",
            format!(
                "has no effect: {}, {} and {} are not set",
                fleet.quote(cpus),
                fleet.quote(priority),
                fleet.quote(memory)
            ),
            "Set one of them, or remove this key".to_owned(),
        ));
    }
}

/// The limit of levels that a stated rate of false alarms chooses.
pub(crate) fn level_limit_by_rate(fleet: &Values) -> Option<f32> {
    fleet.number(LEVEL_RATE).and_then(level_limit_for)
}

/// A proven rate, multiplied by the robots, is extrapolated.
fn level_rate(read: &FleetFile, warnings: &mut Vec<Problem>) {
    let fleet = &read.values;
    let (Some(per_robot_h), Some(limit), Some(room)) =
        (fleet.number(LEVEL_RATE), level_limit_by_rate(fleet), room(read))
    else {
        return;
    };
    let own = |listed: &&Listed| listed.values.get("platform.alarms.level_limit").is_some();
    let robots = read.platforms.iter().filter(|listed| !own(listed)).map(listed_robots).sum();
    let robots = u64::from(room).min(robots);
    if robots == 0 {
        let what = "has no effect: every platform has a level_limit of its own".to_owned();
        warnings.push(complaint(fleet, LEVEL_RATE, what, "Remove it, or theirs".to_owned()));
        return;
    }
    let stated = "alarms.level_limit";
    if fleet.names(stated) && fleet.number(stated) != Some(limit.into()) {
        let what = format!("has no effect beside `{LEVEL_RATE}`, which chooses {limit}");
        warnings.push(complaint(fleet, stated, what, "Remove one of them".to_owned()));
    }
    warnings.push(complaint(
        fleet,
        LEVEL_RATE,
        format!(
            "is extrapolated from 200 simulated robot-hours: the {robots} robots without a \
             level_limit of their platform raise at most {:.3} alarms an hour with the chosen one, \
             {limit} standard deviations",
            per_robot_h * robots as f64
        ),
        "`joulebus alarms CAPTURE` shows those that your robots raise".to_owned(),
    ));
}

fn model(values: &Values, problems: &mut Vec<Problem>, warnings: &mut Vec<Problem>) {
    let (model, scale) = ("platform.model", "platform.residual_std_w");
    let persistence = values.text(model).is_some_and(|text| text == "persistence");
    if persistence && !values.names(scale) {
        problems.push(complaint(
            values,
            model,
            "is \"persistence\", and `residual_std_w` is missing".to_owned(),
            "Add residual_std_w: the standard deviation of the difference of consecutive readings, W"
                .to_owned(),
        ));
    }
    if !persistence && values.text(model).is_some() && values.names(scale) {
        warnings.push(complaint(
            values,
            scale,
            format!("has no effect: the file of {} states its own", values.quote(model)),
            "Remove it, or write model = \"persistence\"".to_owned(),
        ));
    }
}

/// Two times of a platform with a required order.
fn times(values: &Values, fleet: &Values, problems: &mut Vec<Problem>) {
    let Some(rate_hz) = values.number("platform.rate_hz") else {
        return;
    };
    let rate = values.quote("platform.rate_hz");
    let mut in_periods = |key: &'static str, allowed: &RangeInclusive<f64>, remedy: &str| {
        let Some(time_s) = values.number(key) else {
            return;
        };
        let periods = time_s * rate_hz;
        let (least, most) = (*allowed.start(), *allowed.end());
        // 1e-9: `2.0 / rate` in decimals counts as two periods.
        if !(least * (1.0 - 1e-9) <= periods && periods <= most * (1.0 + 1e-9)) {
            let what = format!(
                "{} is {periods:.3} sample periods of {rate}, allowed are {least} to {most}",
                values.quote(key)
            );
            problems.push(contradiction(
                [(values, key), (values, "platform.rate_hz")],
                &what,
                remedy,
            ));
        }
    };
    in_periods(
        "platform.stale_after_s",
        &bounds::STALE_AFTER_PERIODS,
        "One late sample must not make a robot Invalid, nor a gap be bridged indefinitely: change one of them",
    );
    in_periods(
        "platform.hold_max_s",
        &(1.0..=f64::INFINITY),
        "Every sample would raise HeldTooLong: raise hold_max_s",
    );
    in_periods(
        "platform.stuck_after_s",
        &(2.0..=f64::INFINITY),
        "Two equal readings would raise StuckSensor: raise stuck_after_s",
    );
    let ordered = [
        (
            (values, "platform.hold_max_s"),
            (values, "platform.stuck_after_s"),
            "A monitor that may hold its reading that long is not stuck earlier: raise stuck_after_s",
        ),
        (
            (values, "platform.stale_after_s"),
            (fleet, "intake.leave_after_s"),
            "A robot would leave before it is stale: raise leave_after_s",
        ),
        (
            (values, "platform.stale_after_s"),
            (fleet, "intake.max_jump_s"),
            "A gap that the model may still bridge would be refused: raise max_jump_s",
        ),
    ];
    for (shorter, longer, remedy) in ordered {
        let (Some(short_s), Some(long_s)) =
            (shorter.0.number(shorter.1), longer.0.number(longer.1))
        else {
            continue;
        };
        if short_s > long_s {
            let what =
                format!("{} is below {}", longer.0.quote(longer.1), shorter.0.quote(shorter.1));
            problems.push(contradiction([longer, shorter], &what, remedy));
        }
    }
    backlog(values, fleet, rate_hz, problems);
}

fn backlog(values: &Values, fleet: &Values, rate_hz: f64, problems: &mut Vec<Problem>) {
    let (Some(tick_hz), Some(most)) =
        (fleet.number("tick.rate_hz"), fleet.number("intake.max_samples_per_tick"))
    else {
        return;
    };
    if rate_hz > tick_hz * most {
        let what = format!(
            "{} is more than {} with {} can take",
            values.quote("platform.rate_hz"),
            fleet.quote("tick.rate_hz"),
            fleet.quote("intake.max_samples_per_tick")
        );
        problems.push(contradiction(
            [(values, "platform.rate_hz"), (fleet, "intake.max_samples_per_tick")],
            &what,
            "Samples would be dropped at every tick: raise max_samples_per_tick or the tick's rate",
        ));
    }
}

fn limits(values: &Values, problems: &mut Vec<Problem>) {
    let (min, max, step) =
        ("platform.power_min_w", "platform.power_max_w", "platform.power_resolution_w");
    let (Some(min_w), Some(max_w)) = (values.number(min), values.number(max)) else {
        return;
    };
    if min_w >= max_w {
        let what = format!("{} is not below {}", values.quote(min), values.quote(max));
        problems.push(contradiction(
            [(values, min), (values, max)],
            &what,
            "No reading would be accepted: change one of them",
        ));
        return;
    }
    if values.number(step).is_some_and(|step_w| step_w >= max_w - min_w) {
        let what = format!(
            "{} is not below the span from {} to {}",
            values.quote(step),
            values.quote(min),
            values.quote(max)
        );
        problems.push(contradiction(
            [(values, step), (values, max)],
            &what,
            "The monitor could not resolve any power in this range: change one of them",
        ));
    }
}

fn battery(values: &Values, problems: &mut Vec<Problem>) {
    if !values.names_any("platform.battery.") {
        return;
    }
    let (reserve, soc, low) = (
        "platform.battery.reserve",
        "platform.battery.initial_soc",
        "platform.battery.initial_soc_lo",
    );
    let (Some(reserve_share), Some(soc_share)) = (values.number(reserve), values.number(soc))
    else {
        return;
    };
    if values.number(low).is_some_and(|low_share| low_share > soc_share) {
        let what = format!("{} is above {}", values.quote(low), values.quote(soc));
        problems.push(contradiction(
            [(values, low), (values, soc)],
            &what,
            "The conservative estimate must not exceed the best estimate: change one of them",
        ));
    }
    for (below, above, why) in [
        ("critical", "low", "A critical battery is low too"),
        ("return_wh", "capacity_wh", "No full battery would be enough"),
        ("docking_wh", "capacity_wh", "No full battery would be enough"),
    ] {
        let [below, above] = [below, above].map(|name| format!("platform.battery.{name}"));
        let shares = (values.number(&below), values.number(&above));
        if let (Some(found), Some(allowed)) = shares
            && found > allowed
        {
            let what = format!("{} is above {}", values.quote(&below), values.quote(&above));
            problems.push(contradiction(
                [(values, &below), (values, &above)],
                &what,
                &format!("{why}: change one of them"),
            ));
        }
    }
    if reserve_share >= soc_share {
        let what = format!("{} is not below {}", values.quote(reserve), values.quote(soc));
        problems.push(contradiction(
            [(values, reserve), (values, soc)],
            &what,
            "No energy would be usable from the start: change one of them",
        ));
    }
}

fn names(read: &FleetFile, problems: &mut Vec<Problem>) {
    let name = "platform.name";
    for (index, Listed { values, header, .. }) in read.platforms.iter().enumerate() {
        let Some(text) = values.text(name) else {
            continue;
        };
        let earlier = read.platforms[..index]
            .iter()
            .find(|earlier| earlier.values.text(name).as_ref() == Some(&text));
        if let Some(Listed { header: first, .. }) = earlier {
            problems.push(Problem {
                file: header.file.to_string(),
                line: Some(header.line),
                key: "platform".to_owned(),
                what: format!("contradicts: the platform {text:?} is listed here and at {first}"),
                remedy: "List its robots in one [[platform]], or give one of them another `name`"
                    .to_owned(),
            });
        }
    }
}

/// A range of ids and the platform that lists it.
type Owned<'a> = (RangeInclusive<u32>, &'a Values);

fn ids(read: &FleetFile, problems: &mut Vec<Problem>) {
    let key = "platform.robots";
    let mut ranges: Vec<Owned<'_>> = Vec::new();
    for Listed { values, .. } in &read.platforms {
        let listed = values.robots();
        if values.get(key).is_some() && listed.is_empty() {
            problems.push(complaint(
                values,
                key,
                "is empty".to_owned(),
                "Name at least one robot, or remove the [[platform]]".to_owned(),
            ));
        }
        ranges.extend(listed.into_iter().map(|range| (range, values)));
    }
    ranges.sort_by_key(|(range, _)| (*range.start(), *range.end()));
    // The range with the largest end so far: the next one must begin beyond it.
    let mut reach: Option<Owned<'_>> = None;
    for owned in ranges {
        let (end, start) = (*owned.0.end(), *owned.0.start());
        if let Some(before) = reach.as_ref().filter(|(before, _)| start <= *before.end()) {
            problems.push(shared(before, &owned));
        }
        if reach.as_ref().is_none_or(|(before, _)| end > *before.end()) {
            reach = Some(owned);
        }
    }
}

/// Two ranges that share a robot, reported at the one later in the file.
fn shared(one: &Owned<'_>, other: &Owned<'_>) -> Problem {
    let key = "platform.robots";
    let line = |owned: &Owned<'_>| owned.1.location(key).map_or(0, |location| location.line);
    let quote = |owned: &Owned<'_>| {
        let location = owned.1.location(key).map_or_else(String::new, Location::to_string);
        format!("{} ({location})", robots::text(&owned.0))
    };
    let later = if line(one) > line(other) { one } else { other };
    complaint(
        later.1,
        key,
        format!("contradicts: {} and {} share robot {}", quote(one), quote(other), other.0.start()),
        "Remove it from one of them: a robot belongs to at most one platform, once".to_owned(),
    )
}

/// Room for as many robots as the file states. If it states no number, room for those that the
/// platforms list, at most [`UNASKED_ROBOTS`].
pub(crate) fn room(read: &FleetFile) -> Option<u32> {
    match read.values.get("fleet.capacity") {
        Some(_) => read.values.integer("fleet.capacity"),
        None => u32::try_from(listed(read).clamp(1, UNASKED_ROBOTS)).ok(),
    }
}

fn listed(read: &FleetFile) -> u64 {
    read.platforms.iter().map(listed_robots).sum()
}

fn listed_robots(listed: &Listed) -> u64 {
    listed.values.robots().iter().map(robots::count).sum()
}

fn capacity(read: &FleetFile, warnings: &mut Vec<Problem>) {
    let (Some(room), listed) = (room(read), listed(read)) else {
        return;
    };
    if read.values.get("fleet.capacity").is_none() && listed > room.into() {
        warnings.push(complaint(
            &read.values,
            "fleet.capacity",
            format!("is not set: there is room for {room} of the {listed} robots that are listed"),
            "Set it to the number of robots that run at once".to_owned(),
        ));
    } else if listed > room.into() {
        warnings.push(complaint(
            &read.values,
            "fleet.capacity",
            format!(
                "is doubtful: {} is below the {listed} robots listed under `platform.robots`",
                read.values.quote("fleet.capacity")
            ),
            "The last ones to report will be refused: raise the capacity".to_owned(),
        ));
    }
}
