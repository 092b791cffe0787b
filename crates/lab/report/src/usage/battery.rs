//! How long a battery lasts at the powers of recordings.

use joulebus_settings::Platform;

use super::steps::{MANY_RUNS, MIN_STEPS, Run, Step, Sums, range, significant, spanned};
use crate::document::{Cell, Column, Table};

/// Parts of a single run, whose powers give a range.
const PARTS: usize = 10;

/// A battery, full.
#[derive(Debug, Clone, Copy)]
pub(super) struct Battery {
    capacity_wh: f64,
    /// Share that is kept in reserve. 0 if the capacity was given without one.
    reserve: f64,
}

impl Battery {
    /// The capacity that is given, else the platform's.
    pub(super) fn new(given_wh: Option<f64>, platform: Option<&Platform>) -> Option<Self> {
        let configured = platform.and_then(|platform| platform.battery);
        let reserve = configured.map_or(0.0, |battery| battery.reserve);
        let configured_wh = configured.map(|battery| battery.capacity_j / 3600.0);
        let capacity_wh = given_wh.or(configured_wh)?;
        (capacity_wh > 0.0 && capacity_wh.is_finite()).then_some(Self { capacity_wh, reserve })
    }

    fn usable_wh(&self) -> f64 {
        self.capacity_wh * (1.0 - self.reserve)
    }

    /// Hours at a power. NaN if the power empties no battery.
    fn hours(&self, power_w: f64) -> f64 {
        if power_w > 0.0 { self.usable_wh() / power_w } else { f64::NAN }
    }
}

fn sums(runs: &[Run]) -> Sums {
    Sums::of(runs.iter().flat_map(|run| &run.steps))
}

/// Known mean powers of the runs, or of the tenths of a single one, W.
fn stretches_w(runs: &[Run]) -> (Vec<f64>, &'static str) {
    let long = |steps: &[Step]| {
        let is_enough = steps.len() >= MIN_STEPS;
        if is_enough { Sums::of(steps).mean_w() } else { f64::NAN }
    };
    let known = |power_w: &f64| power_w.is_finite();
    let powers_w: Vec<f64> = runs.iter().map(|run| long(&run.steps)).filter(known).collect();
    if powers_w.len() != 1 {
        return (powers_w, "run");
    }
    let longest = runs.iter().max_by_key(|run| run.steps.len());
    let steps = longest.map_or(&[] as &[Step], |run| &run.steps);
    let parts = steps.chunks(steps.len().div_ceil(PARTS).max(1));
    (parts.map(long).filter(known).collect(), "tenth of the run")
}

/// One sentence or a few.
pub(super) fn lasts(battery: Option<Battery>, runs: &[Run]) -> String {
    let Some(battery) = battery else {
        return "How long a battery lasts is not known: state its capacity with --battery-wh, \
                or name a platform whose file has a [battery]."
            .to_owned();
    };
    let sums = sums(runs);
    let hours = battery.hours(sums.mean_w());
    let from = match battery.reserve {
        reserve if reserve > 0.0 => format!(" down to a reserve of {:.0} %", 100.0 * reserve),
        _ => String::new(),
    };
    let capacity = significant(battery.capacity_wh).shown();
    if hours.is_nan() {
        return format!(
            "How long a battery of {capacity} Wh lasts is not known: no power is recorded that \
             empties it."
        );
    }
    let (stretches_w, of) = stretches_w(runs);
    let [least_w, greatest_w] = range(&stretches_w);
    let ends = [battery.hours(greatest_w), battery.hours(least_w)];
    let which = match stretches_w.len() {
        ..MANY_RUNS => "at the power of the hungriest and the thriftiest",
        _ => "for nine of ten runs, at the power of each",
    };
    let honest = match ends {
        [low, high] if low.is_nan() || high.is_nan() => {
            "By how much that varies is not known: there are too few readings.".to_owned()
        }
        ends => format!("It is {} h {which} {of}.", spanned(ends)),
    };
    format!(
        "A battery of {capacity} Wh lasts {} h{from}, at the mean power of {} W. {honest} It \
         holds for work like that recorded, which is {}, and for a battery that still has \
         that capacity.",
        significant(hours).shown(),
        significant(sums.mean_w()).shown(),
        spoken(sums.time_s)
    )
}

/// A time with the unit that fits.
fn spoken(time_s: f64) -> String {
    let (time, unit) = match time_s {
        _ if time_s < 120.0 => (time_s, "s"),
        _ if time_s < 7_200.0 => (time_s / 60.0, "min"),
        _ => (time_s / 3_600.0, "h"),
    };
    format!("{} {unit}", significant(time).shown())
}

/// The same as numbers. `None` without a capacity.
pub(super) fn table(battery: Battery, runs: &[Run]) -> Table {
    let sums = sums(runs);
    let (stretches_w, of) = stretches_w(runs);
    let [least_w, greatest_w] = range(&stretches_w);
    // From many runs on, these are ends of a range and no longer runs.
    let [hungriest, thriftiest] = match stretches_w.len() {
        ..MANY_RUNS => ["hungriest", "thriftiest"].map(|which| format!("the {which} {of}")),
        _ => ["upper", "lower"].map(|end| format!("the {end} end of 90 % of the runs")),
    };
    let wh_per_m = sums.wh_per_m();
    let row = |what: String, power_w: f64, distance_m: f64| {
        let hours = battery.hours(power_w);
        vec![Cell::Words(what), significant(power_w), significant(hours), significant(distance_m)]
    };
    let rows = vec![
        row("all together".to_owned(), sums.mean_w(), battery.usable_wh() / wh_per_m),
        row(hungriest, greatest_w, f64::NAN),
        row(thriftiest, least_w, f64::NAN),
    ];
    Table {
        id: "table-battery".to_owned(),
        caption: format!(
            "How long {} Wh last, the usable part of the battery. A dash: not known.",
            significant(battery.usable_wh()).shown()
        ),
        columns: vec![
            Column::new("at", "at the power of"),
            Column::new("mean_w", "mean power (W)"),
            Column::new("lasts_h", "lasts (h)"),
            Column::new("distance_m", "distance (m)"),
        ],
        rows,
        folded: false,
    }
}
