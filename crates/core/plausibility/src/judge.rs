//! The judgement of one robot, sample by sample.

use crate::battery::{AGREE, CurrentMonitor};
use crate::clock::{RATE_HZ, STATED_RATE_HZ, Times};
use crate::column::Column;
use crate::finding::{Finding, Kind, Remedy, Severity};
use crate::hold::Hold;
use crate::observation::Observation;
use crate::quantity::{Quantity, number};
use crate::saturation::{saturated, wraps};
use crate::sentinel::{Reserved, dropped, outlier, sentinel, silent};
use crate::sign::{Sign, negative_voltage};
use crate::sizes::Sizes;
use crate::unit::Magnitudes;
use Quantity::{Current, Power, Voltage};

/// Values before a column that never changes is one.
const MIN_CONSTANT: u64 = 100;
/// Values before zeros, and values that never came, count.
const MIN_ROWS: u64 = 20;
/// Observations before what never came counts.
const MIN_MISSING: u64 = 50;
/// Share of values outside their range that makes the whole column wrong.
const MOSTLY: f64 = 0.5;
/// Values before they count in a recording of which nothing more will come.
const FEW_ROWS: u64 = 3;
/// Shares of rows in which power differs from voltage times current: to be told, and to stop.
const SOME_MISMATCHES: f64 = 0.05;
const MAX_MISMATCHES: f64 = 0.5;
/// Readings that alternate between two sources: their number, their share of all changes, and the
/// mean change as a share of the usual reading.
const MIN_RETURNS: u64 = 50;
const MOST_RETURN: f64 = 0.8;
const MIN_CHANGE: f64 = 0.05;
/// Time between two recordings that are judged together, s.
const APART_S: f64 = 1.0;
const DRIVES_MPS: f64 = 0.1;

/// Properties of a source that are known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Known {
    ranges: [Option<(f64, f64)>; 6],
    unstated: [bool; 6],
    expected: [bool; 6],
    whole: bool,
    turned: bool,
    time: TimeUnit,
}

/// The origin of the unit of times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TimeUnit {
    /// A clock: they are texts, or those of this host.
    #[default]
    Certain,
    /// A name, which may be wrong.
    Named,
    /// Nothing.
    Unstated,
}

impl Known {
    /// Values of a quantity lie between two numbers, ends included, in SI units.
    #[must_use]
    pub const fn within(mut self, quantity: Quantity, least: f64, greatest: f64) -> Self {
        self.ranges[quantity as usize] = Some((least, greatest));
        self
    }

    /// The source does not state the unit of a quantity, which is read as a thousandth of SI.
    #[must_use]
    pub const fn unstated(mut self, quantity: Quantity) -> Self {
        self.unstated[quantity as usize] = true;
        self
    }

    /// The source states the unit of a quantity.
    #[must_use]
    pub const fn stated(mut self, quantity: Quantity) -> Self {
        self.unstated[quantity as usize] = false;
        self
    }

    /// Sets the origin of the unit of times.
    #[must_use]
    pub const fn timed(mut self, time: TimeUnit) -> Self {
        self.time = time;
        self
    }

    /// Nothing more will come after what is taken, so that a few values have to do.
    #[must_use]
    pub const fn whole(mut self) -> Self {
        self.whole = true;
        self
    }

    /// The sign of the current was turned after it was recorded: numbers that stand for no reading
    /// are judged, and shown, as recorded.
    #[must_use]
    pub const fn turned(mut self, turned: bool) -> Self {
        self.turned = turned;
        self
    }

    pub(crate) const fn is_turned(&self) -> bool {
        self.turned
    }

    /// A current as it was recorded, and the other way round.
    const fn recorded(&self, current_a: f64) -> f64 {
        if self.turned { -current_a } else { current_a }
    }

    const fn least(&self, rows: u64) -> u64 {
        if self.whole { FEW_ROWS } else { rows }
    }

    /// The source names a quantity, so that it should come.
    #[must_use]
    pub const fn expects(mut self, quantity: Quantity) -> Self {
        self.expected[quantity as usize] = true;
        self
    }
}

/// Judges the observations of one robot in bounded memory.
#[derive(Debug, Clone)]
pub struct Judge {
    known: Known,
    times: Times,
    columns: [Column; 6],
    ratios: Sizes,
    /// Power over current where no voltage is known, V.
    implied: Sizes,
    driving: Sizes,
    driven: u64,
    sign: Sign,
    hold: Hold,
    monitor: CurrentMonitor,
    reserved: Reserved,
    /// Rows with power, voltage and current, and those where they differ.
    products: u64,
    mismatches: u64,
    /// Added to the times of the recording, s. None at its beginning.
    shift_s: Option<f64>,
}

impl Judge {
    /// With nothing seen.
    #[must_use]
    pub fn new(known: Known) -> Self {
        Self {
            known,
            times: Times::new(),
            columns: std::array::from_fn(|_| Column::new()),
            ratios: Sizes::new(),
            implied: Sizes::new(),
            driving: Sizes::new(),
            driven: 0,
            sign: Sign::default(),
            hold: Hold::default(),
            monitor: CurrentMonitor::default(),
            reserved: Reserved::new(),
            products: 0,
            mismatches: 0,
            shift_s: Some(0.0),
        }
    }

    /// Takes the next observation, in the order in which they came.
    pub fn take(&mut self, seen: &Observation) {
        let latest_s = self.times.latest_s;
        let shift_s = *self.shift_s.get_or_insert(latest_s + APART_S - seen.time_s);
        let seen = &Observation { time_s: seen.time_s + shift_s, ..*seen };
        self.times.take(seen.time_s);
        for quantity in Quantity::ALL {
            let place = quantity as usize;
            self.columns[place].take(seen.value(quantity), self.known.ranges[place]);
        }
        let product_w = seen.voltage_v * seen.current_a;
        let away_w = (seen.power_w.abs() - product_w.abs()).abs();
        self.products += u64::from(away_w.is_finite());
        let (share, least_w) = AGREE;
        self.mismatches += u64::from(away_w > least_w.max(share * product_w.abs()));
        self.ratios.add(seen.power_w / product_w);
        if seen.voltage_v.is_nan() {
            self.implied.add(seen.power_w / seen.current_a);
        }
        if seen.v_mps.abs() >= DRIVES_MPS || seen.v_measured_mps.abs() >= DRIVES_MPS {
            self.driving.add(seen.power_w);
            self.driven += 1;
        }
        self.sign.take(seen);
        self.hold.take(seen);
        self.monitor.take(seen);
        self.reserved.take(self.known.recorded(seen.current_a));
    }

    /// Begins another recording of the same robot, or of one like it.
    pub fn begin(&mut self) {
        self.shift_s = (self.times.rows == 0).then_some(0.0);
        self.columns.iter_mut().for_each(Column::begin);
        self.sign.begin();
    }

    /// Observations taken.
    #[must_use]
    pub const fn observations(&self) -> u64 {
        self.times.rows
    }

    /// The implausible findings so far: errors first, each in the order of [`Kind`].
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        // A current that nobody measures has no sign, and neither has the power made of it.
        let of_current = |one: Option<Quantity>| matches!(one, Some(Power | Current));
        // Neither has it a unit. While it comes, it may turn out that nobody measures it.
        let makes_power = self.makes_power();
        let is_undecided = makes_power || self.is_undecided();
        let mut found: Vec<Finding> =
            (!is_undecided).then(|| self.signs()).flatten().into_iter().collect();
        found.extend(self.voltage_sign());
        let magnitudes = Magnitudes {
            columns: &self.columns,
            ratios: &self.ratios,
            implied: &self.implied,
            driving: &self.driving,
            driven: self.driven,
            resistance_ohm: self.sign.resistance_ohm(),
            unstated: &self.known.unstated,
            enough: self.known.least(MIN_ROWS),
        };
        let units = magnitudes.judge().into_iter();
        found.extend(units.filter(|one| !(is_undecided && of_current(one.quantity))));
        found.extend(self.rate());
        found.extend(self.clock());
        found.extend(self.holds());
        for quantity in Quantity::ALL {
            let column = &self.columns[quantity as usize];
            found.extend(self.missing(quantity, column));
            if makes_power && of_current(Some(quantity)) {
                found.extend(self.constant(quantity, column));
                continue;
            }
            // Values in another unit or with the other sign are out of range as well.
            let reserved = self.reserved().filter(|_| quantity == Current);
            let sentinel = reserved.or_else(|| self.sentinels(quantity, column));
            let is_read = sentinel.is_none();
            found.extend(sentinel);
            let is_explained = found.iter().any(|one| one.quantity == Some(quantity));
            if !is_explained {
                found.extend(self.range(quantity, column));
            }
            // Steps to such a number and back are no wraps.
            found.extend(saturation(quantity, column).filter(|_| is_read));
            found.extend(self.constant(quantity, column));
        }
        found.extend(self.mismatch(&found));
        found.extend(self.sources(&found));
        found.sort_by_key(|finding| (finding.severity, finding.kind, finding.quantity));
        found
    }

    /// The signs of power and current: the first that is wrong.
    fn signs(&self) -> Option<Finding> {
        const ALLOWED: &str = "power is positive while the battery discharges";
        if let Some(wrong) = self.sign.power(self.known.whole) {
            let (readings, of, why) = (wrong.readings, wrong.of, wrong.why);
            let what = format!("power is negative in {readings} of {of} readings {why}");
            let of = (Kind::Sign, wrong.severity);
            return Some(Finding::new(of, Power, readings, Remedy::Turn, what, ALLOWED));
        }
        if let Some((readings, of)) = self.sign.current() {
            let what =
                format!("the current has another sign than power in {readings} of {of} readings");
            let allowed = "both are positive while the battery discharges";
            let of = (Kind::Sign, Severity::Warning);
            return Some(Finding::new(of, Current, readings, Remedy::Turn, what, allowed));
        }
        let of = (Kind::Sign, Severity::Error);
        if let Some(readings) = self.sign.changes() {
            let what = format!(
                "the sign of power changes: in {readings} negative readings the voltage falls while \
                 it grows"
            );
            return Some(Finding::new(of, Power, readings, Remedy::Split, what, ALLOWED));
        }
        let (drawn, fed, size_w) = self.sign.mirrored()?;
        let what = format!(
            "at the same commands power is negative in {fed} readings and positive in {drawn}, with \
             the same size, such as {}: its sign is not reliable",
            Power.shown(size_w)
        );
        Some(Finding::new(of, Power, fed, Remedy::Sensor, what, ALLOWED))
    }

    /// Readings of two sources in turn: nearly each leads back to the one before the last.
    fn sources(&self, found: &[Finding]) -> Option<Finding> {
        [Current, Power, Voltage].into_iter().find_map(|quantity| {
            let column = &self.columns[quantity as usize];
            let moves = &column.moves;
            let usual = column.sizes.usual()?;
            let alternates = moves.returns >= MIN_RETURNS
                && moves.back >= MOST_RETURN * moves.all
                && moves.all >= MIN_CHANGE * usual * column.count as f64;
            let is_explained = found.iter().any(|one| one.quantity == Some(quantity));
            (alternates && !is_explained).then(|| {
                let (name, returns, of) = (quantity.name(), moves.returns, column.count);
                let what = format!(
                    "{name} alternates between two levels in {returns} of {of} readings: those of \
                     two sources"
                );
                let of = (Kind::Sources, Severity::Error);
                let allowed = "a recording has one source";
                Finding::new(of, quantity, returns, Remedy::Apart, what, allowed)
            })
        })
    }

    /// A number that means that there is no reading, as its file has it.
    fn sentinels(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let mut found = sentinels(quantity, column)?;
        if let (Remedy::Missing { written, .. }, Power | Current) = (&mut found.remedy, quantity) {
            *written = self.known.recorded(*written);
        }
        Some(found)
    }

    fn voltage_sign(&self) -> Option<Finding> {
        let readings = negative_voltage(&self.columns[Voltage as usize])?;
        let what = format!("the voltage is negative in {readings} readings");
        let allowed = "batteries have a positive voltage";
        let of = (Kind::Sign, Severity::Error);
        Some(Finding::new(of, Voltage, readings, Remedy::Sensor, what, allowed))
    }

    /// The number among currents that drivers write where they measure none.
    fn reserved(&self) -> Option<Finding> {
        let (readings, recorded_a) = self.reserved.found()?;
        let what = format!(
            "current is exactly {} in {readings} of {} readings, which drivers write where they \
             measure none",
            Current.shown(recorded_a),
            self.columns[Current as usize].count
        );
        let remedy = Remedy::Unmeasured(self.known.recorded(recorded_a));
        let of = (Kind::Sentinel, Severity::Error);
        Some(Finding::new(of, Current, readings, remedy, what, MISSING))
    }

    /// Power that is not voltage times current, where no unit, and no full register or number for a
    /// missing value in as many readings, explains it.
    fn mismatch(&self, found: &[Finding]) -> Option<Finding> {
        let explains = |one: &Finding| match one.kind {
            Kind::Unit => true,
            Kind::Saturation | Kind::Sentinel => one.readings >= self.mismatches,
            _ => false,
        };
        let is_zero = |one: Quantity| self.columns[one as usize].is_zero();
        let is_explained =
            found.iter().any(explains) || [Power, Voltage, Current].into_iter().any(is_zero);
        let share = self.mismatches as f64 / self.products as f64;
        let is_most = share > MAX_MISMATCHES;
        let is_some = share > SOME_MISMATCHES && self.mismatches >= MIN_ROWS;
        if is_explained || self.products < self.known.least(MIN_ROWS) || !(is_most || is_some) {
            return None;
        }
        let (severity, usually) = match is_most {
            true => {
                let times = number(self.ratios.usual().unwrap_or(f64::INFINITY));
                (Severity::Error, format!(": usually {times} times it"))
            }
            false => (Severity::Warning, String::new()),
        };
        let what = format!(
            "power is not voltage times current in {} of {} readings{usually}",
            self.mismatches, self.products
        );
        let (of, readings) = ((Kind::Mismatch, severity), self.mismatches);
        Some(Finding::new(of, Power, readings, Remedy::Agree, what, "they agree within 10 %"))
    }

    fn rate(&self) -> Option<Finding> {
        let times = &self.times;
        // A robot that reports once a minute has a name for its unit, or texts.
        let (least_hz, greatest_hz) = match self.known.time {
            TimeUnit::Certain => STATED_RATE_HZ,
            TimeUnit::Named => (RATE_HZ.0, STATED_RATE_HZ.1),
            TimeUnit::Unstated => RATE_HZ,
        };
        let rate_hz = times.rate_hz().filter(|_| times.rows >= self.known.least(MIN_ROWS))?;
        if (least_hz..=greatest_hz).contains(&rate_hz) {
            return None;
        }
        let may_be =
            self.known.time == TimeUnit::Named && (STATED_RATE_HZ.0..1.0).contains(&rate_hz);
        let (unit, unit_s) = match rate_hz {
            ..1e-7 => ("ns", 1e-9),
            ..1e-4 => ("us", 1e-6),
            ..1.0 => ("ms", 1e-3),
            ..2e4 => ("min", 60.0),
            ..5e5 => ("h", 3.6e3),
            _ => ("d", 86_400.0),
        };
        let what = format!("{} rows a second: is the time in seconds?", number(rate_hz));
        let allowed = format!("allowed are {least_hz} to {greatest_hz}");
        let of = (Kind::Unit, if may_be { Severity::Warning } else { Severity::Error });
        Some(Finding::new(of, None, times.rows, Remedy::Seconds(unit, unit_s), what, allowed))
    }

    fn clock(&self) -> Option<Finding> {
        let times = &self.times;
        let lost = times.repeated + times.backward;
        let (severity, readings, what) = if times.loses_many() {
            let why = match (times.has_whole_seconds(), times.backward > times.repeated) {
                (true, _) => ": the times have whole seconds",
                (false, true) => ": the clock was set back, or two recordings are mixed",
                (false, false) => ": the clock stands still",
            };
            let of = times.rows;
            let what = format!("{lost} of {of} rows are not later than those before{why}");
            (Severity::Error, lost, what)
        } else if times.back_s > 1.0 {
            let what = format!("the time goes back by up to {} s", number(times.back_s));
            (Severity::Warning, times.backward, what)
        } else {
            return None;
        };
        let allowed = "every row is later than the one before";
        let of = (Kind::Clock, severity);
        Some(Finding::new(of, None, readings, Remedy::Clock, what, allowed))
    }

    fn holds(&self) -> Option<Finding> {
        let held = self.hold.too_long()?;
        let what = format!(
            "a command of {} m/s and {} rad/s applies unchanged for {} s, and nothing moves",
            number(held.v_mps),
            number(held.omega_radps),
            number(held.held_s)
        );
        let allowed = "a command ends with its controller, or the robot is stuck";
        let of = (Kind::Hold, Severity::Warning);
        Some(Finding::new(of, Quantity::V, held.rows, Remedy::Expire, what, allowed))
    }

    fn missing(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let rows = self.times.rows;
        let is_missing =
            self.known.expected[quantity as usize] && column.count == 0 && rows >= MIN_MISSING;
        is_missing.then(|| {
            let what = format!("{} never came in {rows} observations", quantity.name());
            let allowed = "what the source names has values";
            let of = (Kind::NeverCame, Severity::Warning);
            Finding::new(of, quantity, rows, Remedy::Name, what, allowed)
        })
    }

    fn range(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let (least, greatest) = self.known.ranges[quantity as usize]?;
        let Column { outside, count, .. } = *column;
        if outside == 0 {
            return None;
        }
        let is_wrong =
            outside as f64 > MOSTLY * count as f64 && count >= self.known.least(MIN_ROWS);
        let what = format!(
            "{outside} of {count} values of {} are out of range: {} to {}",
            quantity.name(),
            number(column.least),
            quantity.shown(column.greatest)
        );
        let allowed = format!("allowed are {} to {}", number(least), quantity.shown(greatest));
        let of = (Kind::Range, if is_wrong { Severity::Error } else { Severity::Warning });
        Some(Finding::new(of, quantity, outside, Remedy::Limits, what, allowed))
    }

    /// True if the current is no measurement. A robot at rest that does not say so may show a
    /// constant one, until it drives.
    fn is_unmeasured(&self) -> bool {
        let is_constant = self.known.whole && self.monitor.is_constant();
        !self.columns[Current as usize].is_zero() && (is_constant || self.monitor.is_unmeasured())
    }

    /// True if the current is no measurement, and power is made of it.
    fn makes_power(&self) -> bool {
        let is_product = self.products >= self.known.least(MIN_ROWS) && self.mismatches == 0;
        is_product && self.is_unmeasured()
    }

    /// True if power is made of a current that may turn out to be no measurement.
    fn is_undecided(&self) -> bool {
        let is_product = self.products > 0 && self.mismatches == 0;
        let is_zero = self.columns[Current as usize].is_zero();
        !self.known.whole && is_product && !is_zero && self.monitor.is_undecided()
    }

    fn constant(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let (name, value) = (quantity.name(), column.first);
        if quantity == Current && self.is_unmeasured() {
            // A current that never changes while the voltage does.
            let what = format!(
                "the current is {} in each of {} readings, while the voltage changes: it is not \
                 measured",
                Current.shown(self.known.recorded(value)),
                column.count
            );
            let allowed = "a current changes with what the robot does";
            let severity = if self.makes_power() { Severity::Error } else { Severity::Warning };
            let (of, remedy) = ((Kind::Constant, severity), Remedy::Unmeasured(value));
            return Some(Finding::new(of, Current, column.count, remedy, what, allowed));
        }
        // A current of 0 explains a power of 0, and the other way round.
        let (severity, least) = match (quantity, column.is_zero()) {
            _ if column.varies => return None,
            (Power, true) => (Severity::Error, MIN_ROWS),
            (Power, false) => (Severity::Warning, MIN_CONSTANT),
            (Voltage | Current, true) if !self.columns[Power as usize].is_zero() => {
                (Severity::Warning, MIN_ROWS)
            }
            _ => return None,
        };
        (column.count >= least).then(|| {
            let (value, count) = (quantity.shown(value), column.count);
            let what = format!("{name} is {value} in each of {count} readings");
            let allowed = "readings of a working monitor differ";
            let of = (Kind::Constant, severity);
            Finding::new(of, quantity, count, Remedy::Sensor, what, allowed)
        })
    }
}

fn saturation(quantity: Quantity, column: &Column) -> Option<Finding> {
    if !matches!(quantity, Power | Voltage | Current) {
        return None;
    }
    let name = quantity.name();
    let (severity, readings, what) = if let Some((readings, value, is_full)) = saturated(column) {
        let value = quantity.shown(value);
        let what = match is_full {
            true => {
                format!("{name} is {value}, a full register of 16 bits, in {readings} readings")
            }
            false => {
                format!("{name} ends at exactly {value}, and stays there in {readings} readings")
            }
        };
        (Severity::Warning, readings, what)
    } else {
        let (dips, size) = wraps(column)?;
        let size = quantity.shown(size);
        let what = format!(
            "{name} wraps: it steps {dips} times or more by {size}, a register of its monitor"
        );
        // Readings beyond it are wrong by the whole register.
        (Severity::Error, dips, what)
    };
    let allowed = "readings stay below the end of the monitor's range";
    let of = (Kind::Saturation, severity);
    Some(Finding::new(of, quantity, readings, Remedy::Sensor, what, allowed))
}

const MISSING: &str = "a missing reading is empty or NaN";

/// Numbers that mean that there is no reading.
fn sentinels(quantity: Quantity, column: &Column) -> Option<Finding> {
    if matches!(quantity, Quantity::V | Quantity::Omega) {
        return None;
    }
    let (name, of) = (quantity.name(), column.count);
    let is_dropped = |single| if single { Severity::Error } else { Severity::Warning };
    let (severity, count, what, (written, value)) = if let Some(found) = sentinel(column) {
        let (value, count) = (quantity.shown(found.value), found.count);
        let what =
            format!("{name} is exactly {value} in {count} of {of} readings, far from all others");
        (Severity::Error, count, what, (found.written, found.value))
    } else if let Some((count, single)) =
        silent(column).filter(|_| matches!(quantity, Power | Current))
    {
        let what = match single {
            true => {
                let usual = quantity.shown(column.sizes.usual().unwrap_or_default());
                format!("between those of usually {usual}")
            }
            false => format!(
                "and no other is below {}: the monitor has a dead band, or was off",
                quantity.shown(column.above_least)
            ),
        };
        let what = format!("{name} is exactly 0 in {count} of {of} readings {what}");
        (Severity::Warning, count, what, (0.0, 0.0))
    } else if let Some((count, value)) =
        outlier(column).filter(|_| matches!(quantity, Power | Current) && column.outside == 0)
    {
        let what = format!(
            "{name} is {} in {count} of {of} readings, far from all others",
            quantity.shown(value)
        );
        (Severity::Warning, count, what, (value, value))
    } else {
        let (count, single) = dropped(column).filter(|_| quantity == Voltage)?;
        let what =
            format!("{name} is exactly 0 V in {count} of {of} readings: no battery has that");
        (is_dropped(single), count, what, (0.0, 0.0))
    };
    let remedy = Remedy::Missing { written, value };
    Some(Finding::new((Kind::Sentinel, severity), quantity, count, remedy, what, MISSING))
}
