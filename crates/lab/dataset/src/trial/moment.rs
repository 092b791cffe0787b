//! Times that are written as text.

/// Form of a time. All times of a file have the same form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeForm {
    /// A number.
    Number,
    /// A date and a time of day: Unix seconds. Without an offset it is UTC.
    Date,
    /// A time of day, or one that has elapsed: `10:30:00.5`.
    Clock,
    /// Days and a time, as pandas and Python write a difference: `0 days 00:00:00.5`.
    Delta,
}

/// The forms of text, for messages.
pub(super) const ALLOWED: &str =
    "2026-04-07T10:30:00.5Z, 2026-04-07 10:30:00, 10:30:00.5 or 0 days 00:00:00.5";

/// Seconds of a time of day or of more hours: `HH:MM:SS`, with a fraction after a point or comma.
fn clock_s(text: &str) -> Option<f64> {
    let mut parts = text.split(':');
    let [hours, minutes, seconds] = [parts.next()?, parts.next()?, parts.next()?];
    let (whole, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, "0"));
    digits(fraction)?;
    let [hours, minutes, whole_s] = [digits(hours)?, digits(minutes)?, digits(whole)?];
    let is_time = parts.next().is_none() && hours < 1e5 && minutes < 60.0 && whole_s <= 60.0;
    let seconds: f64 = format!("{whole}.{fraction}").parse().ok()?;
    is_time.then_some(hours * 3600.0 + minutes * 60.0 + seconds)
}

/// A number of 1 to 15 digits, and nothing else.
fn digits(text: &str) -> Option<f64> {
    let is_number =
        (1..=15).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| is_number)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar.
fn days(date: &str) -> Option<f64> {
    let mut parts = date.split(['-', '/']);
    let (year, month, day) = (parts.next()?, parts.next()?, parts.next()?);
    if year.len() != 4 || parts.next().is_some() {
        return None;
    }
    let [year, month, day] = [year, month, day].map(|part| digits(part).unwrap_or(0.0) as i64);
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let lengths = [31, if leap { 29 } else { 28 }, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let at = usize::try_from(month - 1).ok()?;
    let in_month = (1..=*lengths.get(at)?).contains(&day) && year >= 1;
    let before: i64 = lengths[..at].iter().sum();
    let leaps = |year: i64| year / 4 - year / 100 + year / 400;
    let years = (year - 1970) * 365 + leaps(year - 1) - leaps(1969);
    in_month.then_some((years + before + day - 1) as f64)
}

/// The offset from UTC at the end of a time of day, s: `Z`, `+02:00`, `+0200` or `+02`.
fn offset_s(text: &str) -> Option<(&str, f64)> {
    if let Some(clock) = text.strip_suffix(['Z', 'z']).or(text.strip_suffix(" UTC")) {
        return Some((clock, 0.0));
    }
    let Some(at) = text.rfind(['+', '-']) else {
        return Some((text, 0.0));
    };
    let (clock, offset) = text.split_at(at);
    let sign = if offset.starts_with('-') { -1.0 } else { 1.0 };
    let offset = offset[1..].replace(':', "");
    let [hours, minutes] = match offset.len() {
        2 => [digits(&offset)?, 0.0],
        4 => [digits(&offset[..2])?, digits(&offset[2..])?],
        _ => return None,
    };
    let is_offset = hours <= 18.0 && minutes < 60.0;
    is_offset.then_some((clock.trim_end(), sign * (hours * 3600.0 + minutes * 60.0)))
}

/// The time that a text states, s. A date alone states none.
pub(super) fn parse(text: &str) -> Option<(TimeForm, f64)> {
    if !text.is_ascii() {
        return None;
    }
    if let Some(seconds) = clock_s(text) {
        return Some((TimeForm::Clock, seconds));
    }
    if let Some((days, rest)) = text.split_once(" day") {
        let clock = rest.trim_start_matches('s').trim_start_matches(',').trim();
        let (sign, days) = days.strip_prefix('-').map_or((1.0, days), |days| (-1.0, days));
        let clock = clock.strip_prefix('+').unwrap_or(clock);
        let seconds = clock_s(clock).filter(|seconds| *seconds <= DAY_S)?;
        return Some((TimeForm::Delta, sign * digits(days)? * DAY_S + seconds));
    }
    let (date, clock) = text.split_once(['T', 't', ' '])?;
    let (clock, offset_s) = offset_s(clock.trim())?;
    let of_day_s = clock_s(clock).filter(|seconds| *seconds <= DAY_S)?;
    Some((TimeForm::Date, days(date)? * DAY_S + of_day_s - offset_s))
}

/// Seconds of a day.
pub(super) const DAY_S: f64 = 86_400.0;
/// Rows may be written so much too late, s.
const LATE_S: f64 = 600.0;

/// Times of day in the order of a file, and how often they passed midnight.
#[derive(Debug)]
pub(super) struct Midnights {
    pub(super) days: usize,
    before_s: f64,
}

impl Default for Midnights {
    fn default() -> Self {
        Self { days: 0, before_s: f64::NAN }
    }
}

impl Midnights {
    /// The time with a day for each midnight before it: there times fall by more than half a day. A
    /// row that was written late, minutes after a midnight, belongs to the day before.
    pub(super) fn take(&mut self, time_s: f64) -> f64 {
        let step_s = time_s - self.before_s;
        // A time of day, with a leap second. An elapsed time may be longer.
        if step_s < -DAY_S / 2.0 && self.before_s < DAY_S + 1.0 {
            self.days += 1;
        } else if step_s > DAY_S - LATE_S && self.days > 0 {
            self.days -= 1;
        }
        self.before_s = time_s;
        time_s + self.days as f64 * DAY_S
    }
}

#[cfg(test)]
mod tests {
    use super::{Midnights, TimeForm, parse};

    #[test]
    fn times_are_read_as_people_and_programs_write_them() {
        for (text, form, seconds) in [
            ("1970-01-01T00:00:00Z", TimeForm::Date, 0.0),
            ("2026-04-07T10:30:00", TimeForm::Date, 1_775_557_800.0),
            ("2026-04-07 10:30:00.25", TimeForm::Date, 1_775_557_800.25),
            ("2026/04/07 10:30:00,25", TimeForm::Date, 1_775_557_800.25),
            ("2026-04-07T12:30:00+02:00", TimeForm::Date, 1_775_557_800.0),
            ("2026-04-07 05:00:00-0530", TimeForm::Date, 1_775_557_800.0),
            ("2026-04-07 10:30:00 UTC", TimeForm::Date, 1_775_557_800.0),
            ("2024-02-29T23:59:60Z", TimeForm::Date, 1_709_251_200.0),
            ("1969-12-31T23:59:59.5Z", TimeForm::Date, -0.5),
            ("00:00:01.957", TimeForm::Clock, 1.957),
            ("123:00:00", TimeForm::Clock, 442_800.0),
            ("0 days 00:00:00.1", TimeForm::Delta, 0.1),
            ("1 day, 0:00:01", TimeForm::Delta, 86_401.0),
            ("-1 days +23:59:59", TimeForm::Delta, -1.0),
        ] {
            assert_eq!(parse(text), Some((form, seconds)), "{text}");
        }
        for wrong in [
            "2026-04-07",
            "2026-04-07T10:30",
            "2025-02-29T10:30:00",
            "2026-13-01T10:30:00",
            "07/04/2026 10:30:00",
            "10:61:00",
            "10:30",
            "2026-04-07T25:00:00",
            "2026-04-07T10:30:00+2",
            "1 days",
            "x days 00:00:00",
            "10:30:00.",
            "1:2:3:4",
            "",
            "T",
            "٣:00:00",
            "2026-04-07T10:30:00+é9",
        ] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn times_of_day_go_on_after_midnight() {
        let days = |times_s: &[f64]| -> Vec<f64> {
            let mut midnights = Midnights::default();
            times_s.iter().map(|time_s| (midnights.take(*time_s) - time_s) / 86_400.0).collect()
        };
        for (times_s, expected) in [
            (
                &[86_399.0, 86_399.9, 0.1, 86_399.95, 0.2, 1.0][..],
                &[0.0, 0.0, 1.0, 0.0, 1.0, 1.0][..],
            ),
            // It pauses for more than half a day.
            (&[86_399.0, 600.0, 47_400.0], &[0.0, 1.0, 1.0]),
            // A leap second.
            (&[86_399.0, 86_400.0, 0.0, 1.0], &[0.0, 0.0, 1.0, 1.0]),
            // It went back by less than half a day, or had more than a day.
            (&[30_000.0, 20_000.0], &[0.0, 0.0]),
            (&[90_000.0, 0.0], &[0.0, 0.0]),
        ] {
            assert_eq!(days(times_s), expected, "{times_s:?}");
        }
    }
}
