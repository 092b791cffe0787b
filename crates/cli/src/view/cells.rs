//! Data of a robot as text, the same in every view.

use joulebus_board::Row;
use joulebus_plan::report::Joules;
use joulebus_settings::{CHARGE_UNKNOWN, NO_BATTERY};
use joulebus_wire::{
    Budget, ChargeState, Outlook, Quality, budget_flag, diagnostic_flag, forecast_flag,
};

/// Text of an unknown value.
const UNKNOWN: &str = "–";

const COLUMNS: usize = 14;

/// Column heads, in the order of [`cells`], and the width of each column.
pub(crate) const HEADS: [(&str, u16); COLUMNS] = [
    ("robot", 5),
    ("quality", 12),
    ("read W", 7),
    ("forecast W", 10),
    ("interval W", 13),
    ("off by W", 8),
    ("MAE W", 6),
    ("skill", 6),
    ("inside", 6),
    ("drawn", 8),
    ("charge", 6),
    ("lasts", 8),
    ("next min J", 19),
    ("state", 20),
];

/// Columns that a narrow view omits, in this order.
const DISPENSABLE: [&str; 12] = [
    "drawn",
    "inside",
    "skill",
    "interval W",
    "MAE W",
    "off by W",
    "lasts",
    "read W",
    "charge",
    "next min J",
    "quality",
    "forecast W",
];

/// Columns that are empty in a fleet without batteries.
const OF_BATTERIES: [&str; 2] = ["charge", "lasts"];
/// The column that is empty unless outlooks are read.
const OF_OUTLOOKS: &str = "next min J";
/// Place of its horizon among those of an outlook.
const NEXT_MINUTE: usize = 2;

/// Indices of the columns that fit into `width` with a space between, and the width of the last
/// one.
pub(crate) fn fitting(
    width: u16,
    (has_batteries, has_outlooks): (bool, bool),
) -> (Vec<usize>, u16) {
    let mut places = columns(has_outlooks);
    places.retain(|place| has_batteries || !OF_BATTERIES.contains(&HEADS[*place].0));
    let taken = |places: &[usize]| -> u16 { places.iter().map(|place| HEADS[*place].1 + 1).sum() };
    for dispensable in DISPENSABLE {
        if taken(&places) <= width.saturating_add(1) {
            break;
        }
        places.retain(|place| HEADS[*place].0 != dispensable);
    }
    let others = taken(&places[..places.len().saturating_sub(1)]);
    (places, width.saturating_sub(others))
}

/// Indices of the columns of a table without limits of width.
pub(crate) fn columns(has_outlooks: bool) -> Vec<usize> {
    (0..COLUMNS).filter(|place| has_outlooks || HEADS[*place].0 != OF_OUTLOOKS).collect()
}

pub(crate) fn cells(robot: u32, row: &Row, outlook: Option<&Outlook>) -> [String; COLUMNS] {
    let (forecast, diagnostic, budget) = (&row.forecast, &row.diagnostic, &row.budget);
    let read = forecast.flags & forecast_flag::READING != 0;
    let scored = diagnostic.filter(|diagnostic| diagnostic.flags & diagnostic_flag::SCORES != 0);
    let metered = budget.filter(|budget| budget.flags & budget_flag::LEDGER != 0);
    let battery = budget.filter(|budget| budget.flags & budget_flag::CHARGE != 0);
    let watts = |value: f64| format!("{value:.2}");
    [
        robot.to_string(),
        quality(forecast.quality()),
        or_unknown(read.then(|| watts(forecast.reading_w.into()))),
        or_unknown(forecast.expected_w().map(|power_w| watts(power_w.into()))),
        or_unknown(forecast.interval_w().map(|(lo, hi)| format!("{lo:.2} – {hi:.2}"))),
        or_unknown(row.residual_w.map(|residual_w| format!("{residual_w:+.2}"))),
        or_unknown(scored.map(|diagnostic| format!("{:.3}", diagnostic.mae_w))),
        or_unknown(scored.and_then(|diagnostic| skill(diagnostic.skill))),
        or_unknown(scored.map(|diagnostic| percent(diagnostic.coverage.into()))),
        or_unknown(metered.map(|budget| Joules(budget.drawn_j()).to_string())),
        or_unknown(battery.map(|budget| percent(budget.soc.into()))),
        or_unknown(battery.as_ref().map(lasts)),
        or_unknown(outlook.and_then(next_minute)),
        state(row),
    ]
}

/// Reason that the charge of the robot's battery is unknown, and the remedy.
pub(crate) fn lacks_charge(row: &Row) -> Option<&'static str> {
    match row.budget?.flags & (budget_flag::BATTERY | budget_flag::CHARGE) {
        0 => Some(NO_BATTERY),
        budget_flag::BATTERY => Some(CHARGE_UNKNOWN),
        _ => None,
    }
}

fn or_unknown(text: Option<String>) -> String {
    text.unwrap_or_else(|| UNKNOWN.to_owned())
}

/// The energy of the next minute, with its interval.
fn next_minute(outlook: &Outlook) -> Option<String> {
    let energy_j = outlook.expected_j(NEXT_MINUTE)?;
    let bounds_j = outlook.bounds_j(NEXT_MINUTE);
    let bounds = bounds_j.map(|(lo_j, hi_j)| format!(" ({lo_j:.0} – {hi_j:.0})"));
    Some(format!("{energy_j:.0}{}", bounds.unwrap_or_default()))
}

fn skill(skill: f64) -> Option<String> {
    skill.is_finite().then(|| format!("{skill:+.2}"))
}

/// Time to empty, at the mean power.
fn lasts(budget: &Budget) -> String {
    match budget.charge_state() {
        ChargeState::Charging => "charging".to_owned(),
        _ if budget.flags & budget_flag::TIME_TO_EMPTY == 0 => UNKNOWN.to_owned(),
        _ => duration(budget.time_to_empty_s.into()),
    }
}

fn duration(seconds: f64) -> String {
    // Infinite for a robot that draws nothing.
    let minutes = (seconds / 60.0).min(5_999_999.0) as u64;
    match (minutes / 60, minutes % 60) {
        (0, minutes) => format!("{minutes} min"),
        (hours, _) if hours > 99 => "> 99 h".to_owned(),
        (hours, minutes) => format!("{hours} h {minutes:02}"),
    }
}

/// A fraction in percent.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// Text of a quality.
pub(crate) fn quality(quality: Quality) -> String {
    match quality {
        Quality::Fresh => "fresh".to_owned(),
        Quality::Held => "held".to_owned(),
        Quality::Warmup { have } => format!("warmup {have}/5"),
        Quality::OpenLoop { steps } => format!("open loop {steps}"),
        Quality::Invalid(reason) => format!("✗ {}", reason.name()),
        _ => "unknown".to_owned(),
    }
}

/// Level and most important alarm, marked if a person has acknowledged it, with the number of further alarms.
pub(crate) fn state(row: &Row) -> String {
    state_within(row, usize::MAX)
}

/// The same in at most `width` columns: without the level, the number, or the alarm.
pub(crate) fn state_within(row: &Row, width: usize) -> String {
    let Some(diagnostic) = &row.diagnostic else {
        return UNKNOWN.to_owned();
    };
    let word = diagnostic.level().name();
    let alarms = diagnostic.alarms();
    // A person has acknowledged it.
    let mark = if row.acknowledged.has(alarms.cause()) { " ✓" } else { "" };
    let name = format!("{}{mark}", alarms.cause().name());
    let more = match alarms.iter().count() {
        0 => return shortened(word, width),
        1 => String::new(),
        count => format!(" +{}", count - 1),
    };
    let forms = [format!("{word} {name}{more}"), format!("{name}{more}"), name];
    let fits = |form: &String| form.chars().count() <= width;
    forms.into_iter().find(fits).unwrap_or_else(|| shortened(word, width))
}

/// A text of at most `width` columns. One that is cut ends in an ellipsis.
pub(crate) fn shortened(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let kept: String = text.chars().take(width.saturating_sub(1)).collect();
    format!("{kept}…")
}

/// A count with thousands separated by a space.
pub(crate) fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// A time in µs, in a readable unit.
pub(crate) fn micros(us: f64) -> String {
    match us {
        us if us < 10.0 => format!("{us:.1} µs"),
        us if us < 1_000.0 => format!("{us:.0} µs"),
        us if us < 1_000_000.0 => format!("{:.1} ms", us * 1e-3),
        us => format!("{:.1} s", us * 1e-6),
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::outlook_flag;

    use super::*;

    #[test]
    fn a_narrow_view_omits_columns_instead_of_truncating_them() {
        let heads = |width, has_batteries| -> Vec<&str> {
            let (places, _) = fitting(width, (has_batteries, false));
            places.iter().map(|place| HEADS[*place].0).collect()
        };
        assert_eq!(heads(127, true).len(), HEADS.len() - 1);
        let without = |left_out: &[&str]| -> Vec<&str> {
            let heads = HEADS.map(|(head, _)| head).into_iter();
            heads.filter(|head| !left_out.contains(head) && *head != OF_OUTLOOKS).collect()
        };
        assert_eq!(heads(126, true), without(&["drawn"]));
        assert_eq!(heads(127, false), without(&["charge", "lasts"]));
        let at_78 = ["robot", "quality", "read W", "forecast W", "charge", "lasts", "state"];
        assert_eq!(heads(78, true), at_78);
        let at_58 = ["robot", "quality", "forecast W", "charge", "state"];
        assert_eq!(heads(58, true), at_58);
        let at_58 = ["robot", "quality", "read W", "forecast W", "state"];
        assert_eq!(heads(58, false), at_58);
        assert_eq!(heads(0, true), ["robot", "state"]);
        // No column is wider than what is left.
        for width in 0..200 {
            let (places, left) = fitting(width, (true, true));
            let others = &places[..places.len() - 1];
            let others: u16 = others.iter().map(|place| HEADS[*place].1 + 1).sum();
            assert_eq!(left, width.saturating_sub(others), "{width}");
            assert!(left >= 20 || places.len() == 2, "{width}: {left}");
        }
    }

    #[test]
    fn the_next_minute_is_shown_with_bounds_where_there_are_any() {
        let outlook = Outlook {
            flags: outlook_flag::ENERGY,
            bounded: 3,
            energy_j: [4.0, 40.0, 240.4, 1_200.0],
            energy_lo_j: [3.0, 30.0, 200.0, f32::NAN],
            energy_hi_j: [5.0, 50.0, 290.0, f32::NAN],
            ..Outlook::default()
        };
        assert_eq!(next_minute(&outlook).unwrap(), "240 (200 – 290)");
        assert_eq!(next_minute(&Outlook { bounded: 2, ..outlook }).unwrap(), "240");
        assert_eq!(next_minute(&Outlook { flags: 0, ..outlook }), None);
    }

    #[test]
    fn time_to_empty_is_shown_in_hours_and_minutes_and_not_while_charging() {
        let of = |time_to_empty_s: f32, charge_state: ChargeState| {
            lasts(&Budget {
                flags: budget_flag::BATTERY | budget_flag::CHARGE | budget_flag::TIME_TO_EMPTY,
                charge_state: charge_state.code(),
                time_to_empty_s,
                ..Budget::default()
            })
        };
        let driving = ChargeState::Discharging;
        assert_eq!(of(59.0, driving), "0 min");
        assert_eq!(of(3_599.0, driving), "59 min");
        assert_eq!(of(3_661.0, driving), "1 h 01");
        assert_eq!(of(360_000.0, driving), "> 99 h");
        assert_eq!(of(f32::INFINITY, driving), "> 99 h");
        assert_eq!(of(60.0, ChargeState::Charging), "charging");
        assert_eq!(lasts(&Budget::default()), UNKNOWN);
    }

    #[test]
    fn numbers_have_readable_units() {
        assert_eq!(count(7), "7");
        assert_eq!(count(1234), "1\u{202f}234");
        assert_eq!(count(123_456_789), "123\u{202f}456\u{202f}789");
        assert_eq!(micros(9.94), "9.9 µs");
        assert_eq!(micros(118.4), "118 µs");
        assert_eq!(micros(12_340.0), "12.3 ms");
        assert_eq!(micros(2_000_000.0), "2.0 s");
    }
}
