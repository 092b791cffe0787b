//! Times that are written as text.

/// Form of a time. All times of a file have the same form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeForm {
    /// A number.
    Number,
    /// A date and a time of day: Unix seconds. Without an offset it is UTC.
    Date,
    /// A time of day, or one that has elapsed: `10:30:00.5`.
    Clock,
    /// Minutes and seconds, as Excel shows a time of day: `30:00.5`.
    Minutes,
    /// Days and a time, as pandas and Python write a difference: `0 days 00:00:00.5`.
    Delta,
}

/// The forms of text, for messages.
pub const ALLOWED: &str =
    "2026-04-07T10:30:00.5Z, 2026-04-07 10:30:00, 10:30:00.5 or 0 days 00:00:00.5";

const MONTHS: [&str; 12] =
    ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// Seconds of a time of day or of more hours: `HH:MM:SS`, with a fraction after a point or comma,
/// or of twelve hours with AM or PM.
fn clock_s(text: &str) -> Option<f64> {
    let lower = text.to_ascii_lowercase();
    let half = ["am", "pm"].into_iter().position(|end| lower.ends_with(end));
    let text = if half.is_some() { text[..text.len() - 2].trim_end() } else { text };
    let mut parts = text.split(':');
    let [hours, minutes, seconds] = [parts.next()?, parts.next()?, parts.next()?];
    let (minutes, seconds) = (digits(minutes)?, seconds_s(seconds)?);
    let hours = match (digits(hours)?, half) {
        (hours, None) => hours,
        (hours, Some(half)) if (1.0..=12.0).contains(&hours) => hours % 12.0 + 12.0 * half as f64,
        _ => return None,
    };
    let is_time = parts.next().is_none() && hours < 1e5 && minutes < 60.0;
    is_time.then_some(hours * 3600.0 + minutes * 60.0 + seconds)
}

/// Seconds up to a leap second, with a fraction after a point or comma.
fn seconds_s(text: &str) -> Option<f64> {
    let (whole, fraction) = text.split_once(['.', ',']).unwrap_or((text, "0"));
    digits(fraction)?;
    let seconds = format!("{whole}.{fraction}").parse().ok()?;
    (digits(whole)? <= 60.0).then_some(seconds)
}

/// A number of 1 to 15 digits, and nothing else.
fn digits(text: &str) -> Option<f64> {
    let is_number =
        (1..=15).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| is_number)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar.
fn days([year, month, day]: [&str; 3]) -> Option<f64> {
    if year.len() != 4 {
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

/// The days of a date in numbers. `2026-04-07` and `07.04.2026` have one order. Whether the day is
/// first in `07/04/2026` has to be known.
fn date_days(text: &str, day_first: Option<bool>) -> Option<f64> {
    let parts: Vec<&str> = text.split(['-', '/', '.']).collect();
    let [first, second, third] = <[&str; 3]>::try_from(parts).ok()?;
    match (first.len(), text.contains('.'), day_first) {
        (4, false, _) => days([first, second, third]),
        (1..=2, true, _) | (1..=2, _, Some(true)) => days([third, second, first]),
        (1..=2, _, Some(false)) => days([third, first, second]),
        _ => None,
    }
}

/// Whether the day is first in dates such as `07/04/2026`, by a number above 12 in any of them, or
/// by AM and PM, which stand behind months.
pub fn day_first<'a>(texts: impl Iterator<Item = &'a str>) -> Option<bool> {
    let (mut known, mut has_halves) = (None, false);
    for text in texts {
        let date = text.split([' ', 'T']).next().unwrap_or_default();
        let mut parts = date.split(['/', '-']).map(|part| digits(part).filter(|_| part.len() <= 2));
        if let (Some(Some(first)), Some(Some(second))) = (parts.next(), parts.next()) {
            known = known.or((first > 12.0).then_some(true)).or((second > 12.0).then_some(false));
            has_halves |= text.ends_with(['M', 'm']);
        }
    }
    known.or(has_halves.then_some(false))
}

/// True for a date without a time.
#[must_use]
pub fn is_date(text: &str, day_first: Option<bool>) -> bool {
    date_days(text, day_first).is_some()
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

/// A date with the name of its month, as JavaScript, C and mails write it:
/// `Tue Apr 07 2026 10:59:40 GMT+0200 (CEST)`. Unix seconds.
fn worded_s(text: &str) -> Option<f64> {
    let (mut month, mut numbers, mut clock, mut away_s) = (None, Vec::new(), None, 0.0);
    for word in text.split([' ', ',']).filter(|word| !word.is_empty() && !word.starts_with('(')) {
        let lower = word.to_ascii_lowercase();
        let named = MONTHS.iter().position(|name| lower.starts_with(name));
        if word.contains(':') && clock.is_none() {
            clock = Some(clock_s(word)?);
        } else if digits(word).is_some() {
            numbers.push(word);
        } else if let (Some(named), None) = (named, &month) {
            month = Some((named + 1).to_string());
        } else if let Some(zone) = lower.strip_prefix("gmt").or(lower.strip_prefix("utc")) {
            away_s += offset_s(zone)?.1;
        } else if word.starts_with(['+', '-']) {
            away_s += offset_s(word)?.1;
        } else if !["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
            .iter()
            .any(|day| lower.starts_with(day))
        {
            return None;
        }
    }
    let [one, other] = <[&str; 2]>::try_from(numbers).ok()?;
    let (year, day) = if one.len() == 4 { (one, other) } else { (other, one) };
    Some(days([year, &month?, day])? * DAY_S + clock.filter(|s| *s <= DAY_S)? - away_s)
}

/// The time that a text states, s. A date alone states none. `day_first`: of dates with slashes, if
/// it is known.
#[must_use]
pub fn parse(text: &str, day_first: Option<bool>) -> Option<(TimeForm, f64)> {
    if !text.is_ascii() {
        return None;
    }
    if let Some(seconds) = clock_s(text) {
        return Some((TimeForm::Clock, seconds));
    }
    if let Some((minutes, seconds)) = text.split_once(':')
        && seconds.contains(['.', ','])
        && let (Some(minutes), Some(seconds)) = (digits(minutes), seconds_s(seconds))
    {
        return (minutes < 60.0).then_some((TimeForm::Minutes, minutes * 60.0 + seconds));
    }
    if let Some((days, rest)) = text.split_once(" day") {
        let clock = rest.trim_start_matches('s').trim_start_matches(',').trim();
        let (sign, days) = days.strip_prefix('-').map_or((1.0, days), |days| (-1.0, days));
        let clock = clock.strip_prefix('+').unwrap_or(clock);
        let seconds = clock_s(clock).filter(|seconds| *seconds <= DAY_S)?;
        return Some((TimeForm::Delta, sign * digits(days)? * DAY_S + seconds));
    }
    if text.starts_with(|letter: char| letter.is_ascii_alphabetic()) || text.contains(", ") {
        return Some((TimeForm::Date, worded_s(text)?));
    }
    let (date, clock) = text.split_once(['T', 't', ' '])?;
    let Some(days) = date_days(date, day_first) else {
        return Some((TimeForm::Date, worded_s(text)?));
    };
    let (clock, offset_s) = offset_s(clock.trim())?;
    let of_day_s = clock_s(clock).filter(|seconds| *seconds <= DAY_S)?;
    Some((TimeForm::Date, days * DAY_S + of_day_s - offset_s))
}

/// Seconds of a day, and of an hour.
const DAY_S: f64 = 86_400.0;
const HOUR_S: f64 = 3_600.0;
/// Rows may be written so much too late, as a share of the day or hour.
const LATE: f64 = 1.0 / 144.0;

/// Times of day, or of an hour, in the order of a file, and how often they began again.
#[derive(Debug)]
pub struct Midnights {
    days: usize,
    before_s: f64,
    whole_s: f64,
}

impl Default for Midnights {
    fn default() -> Self {
        Self { days: 0, before_s: f64::NAN, whole_s: DAY_S }
    }
}

impl Midnights {
    /// The time with a day (of minutes, an hour) for each midnight before it: there times fall by
    /// more than half of it. A row that was written late, minutes after a midnight, belongs to the
    /// day before.
    #[must_use]
    pub fn take(&mut self, form: TimeForm, time_s: f64) -> f64 {
        if form == TimeForm::Minutes {
            self.whole_s = HOUR_S;
        }
        let step_s = time_s - self.before_s;
        // A time of day, with a leap second. An elapsed time may be longer.
        if step_s < -self.whole_s / 2.0 && self.before_s < self.whole_s + 1.0 {
            self.days += 1;
        } else if step_s > self.whole_s * (1.0 - LATE) && self.days > 0 {
            self.days -= 1;
        }
        self.before_s = time_s;
        time_s + self.days as f64 * self.whole_s
    }

    /// What was passed, in words, if anything was.
    #[must_use]
    pub fn note(&self, name: &str) -> Option<String> {
        let Self { days, whole_s, .. } = self;
        match (*days, *whole_s == DAY_S) {
            (0, true) => None,
            (_, true) => {
                Some(format!("the times of {name} have no date and pass midnight {days} times"))
            }
            _ => Some(format!(
                "the times of {name} are minutes and seconds without the hour, which passes {days} \
                 times"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Midnights, TimeForm, day_first, parse};

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
            ("07.04.2026 10:30:00.5", TimeForm::Date, 1_775_557_800.5),
            ("Tue Apr 07 2026 12:30:00 GMT+0200 (CEST)", TimeForm::Date, 1_775_557_800.0),
            ("Tue Apr  7 10:30:00 2026", TimeForm::Date, 1_775_557_800.0),
            ("Tue, 07 Apr 2026 12:30:00 +0200", TimeForm::Date, 1_775_557_800.0),
            ("2026-04-07 10:30:00 AM", TimeForm::Date, 1_775_557_800.0),
            ("12:00:01 am", TimeForm::Clock, 1.0),
            ("12:00:01 PM", TimeForm::Clock, 43_201.0),
            ("30:00.5", TimeForm::Minutes, 1_800.5),
            ("-1 days +23:59:59", TimeForm::Delta, -1.0),
        ] {
            assert_eq!(parse(text, None), Some((form, seconds)), "{text}");
        }
        let wrong = "2026-04-07|2026-04-07T10:30|2025-02-29T10:30:00|2026-13-01T10:30:00|\
             07/04/2026 10:30:00|10:61:00|10:30|2026-04-07T25:00:00|2026-04-07T10:30:00+2|\
             1 days|x days 00:00:00|10:30:00.|13:30:00 PM|70:00.5|Tue Apr 31 2026 10:30:00|\
             April 2026|1:2:3:4||T|٣:00:00|2026-04-07T10:30:00+é9";
        for wrong in wrong.split('|') {
            assert_eq!(parse(wrong, None), None, "{wrong}");
        }
    }

    #[test]
    fn the_order_of_day_and_month_is_that_of_all_rows_or_of_none() {
        let seconds = Some((TimeForm::Date, 1_775_557_800.0));
        for (rows, expected, text) in [
            (
                &["04/07/2026 10:30:00 AM", "04/06/2026 1:00:00 PM"][..],
                Some(false),
                "04/07/2026 10:30:00 AM",
            ),
            (&["07/04/2026 10:30:00", "13/04/2026 10:30:00"], Some(true), "07/04/2026 10:30:00"),
            (&["4/7/2026 10:30:00", "4/13/2026 10:30:00"], Some(false), "4/7/2026 10:30:00"),
        ] {
            let found = day_first(rows.iter().copied());
            assert_eq!((found, parse(text, found)), (expected, seconds), "{rows:?}");
        }
        assert_eq!(day_first(["07/04/2026 10:30:00"].into_iter()), None);
        assert_eq!(parse("13/13/2026 10:30:00", Some(true)), None);
    }

    #[test]
    fn times_of_day_go_on_after_midnight() {
        let days = |times_s: &[f64]| -> Vec<f64> {
            let mut midnights = Midnights::default();
            times_s
                .iter()
                .map(|time_s| (midnights.take(TimeForm::Clock, *time_s) - time_s) / 86_400.0)
                .collect()
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
