//! The judgement of one robot, sample by sample.

use crate::battery::{AGREE, CurrentMonitor};
use crate::clock::{RATE_HZ, STATED_RATE_HZ, Times};
use crate::column::Column;
use crate::finding::{Finding, Kind, Remedy, Severity};
use crate::hold::Hold;
use crate::observation::Observation;
use crate::quantity::{Quantity, number};
use crate::saturation::{saturated, wraps};
use crate::sentinel::{Reserved, dropped, sentinel, silent};
use crate::sign::{Sign, negative_voltage};
use crate::sizes::Sizes;
use crate::unit::Magnitudes;

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
/// Speed at which a robot drives, m/s.
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
    /// Observations of a robot that drives.
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
            columns: [const { Column::new() }; 6],
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
        let of_current =
            |one: Option<Quantity>| matches!(one, Some(Quantity::Power | Quantity::Current));
        // Neither has it a unit. While it comes, it may turn out that nobody measures it.
        let makes_power = self.makes_power();
        let is_undecided = makes_power || self.is_undecided();
        let mut found = if is_undecided { Vec::new() } else { self.signs() };
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
            let reserved = self.reserved().filter(|_| quantity == Quantity::Current);
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

    fn signs(&self) -> Vec<Finding> {
        let mut found = Vec::new();
        if let Some(wrong) = self.sign.power(self.known.whole) {
            let (readings, of, why) = (wrong.readings, wrong.of, wrong.why);
            found.push(Finding {
                kind: Kind::Sign,
                quantity: Some(Quantity::Power),
                severity: wrong.severity,
                readings,
                found: format!("power is negative in {readings} of {of} readings {why}"),
                allowed: "power is positive while the battery discharges".to_owned(),
                remedy: Remedy::Turn,
            });
        } else if let Some((readings, of)) = self.sign.current() {
            found.push(Finding {
                kind: Kind::Sign,
                quantity: Some(Quantity::Current),
                severity: Severity::Warning,
                readings,
                found: format!(
                    "the current has another sign than power in {readings} of {of} readings"
                ),
                allowed: "both are positive while the battery discharges".to_owned(),
                remedy: Remedy::Turn,
            });
        }
        if found.is_empty()
            && let Some(readings) = self.sign.changes()
        {
            found.push(Finding {
                kind: Kind::Sign,
                quantity: Some(Quantity::Power),
                severity: Severity::Error,
                readings,
                found: format!(
                    "the sign of power changes: in {readings} negative readings the voltage falls while it grows"
                ),
                allowed: "power is positive while the battery discharges".to_owned(),
                remedy: Remedy::Split,
            });
        }
        if found.is_empty()
            && let Some((drawn, fed, size_w)) = self.sign.mirrored()
        {
            found.push(Finding {
                kind: Kind::Sign,
                quantity: Some(Quantity::Power),
                severity: Severity::Error,
                readings: fed,
                found: format!(
                    "at the same commands power is negative in {fed} readings and positive in \
                     {drawn}, with the same size, such as {}: its sign is not reliable",
                    Quantity::Power.shown(size_w)
                ),
                allowed: "power is positive while the battery discharges".to_owned(),
                remedy: Remedy::Sensor,
            });
        }
        found
    }

    /// Readings of two sources in turn: nearly each leads back to the one before the last.
    fn sources(&self, found: &[Finding]) -> Option<Finding> {
        let mut measured = [Quantity::Current, Quantity::Power, Quantity::Voltage].into_iter();
        measured.find_map(|quantity| {
            let column = &self.columns[quantity as usize];
            let moves = &column.moves;
            let usual = column.sizes.usual()?;
            let alternates = moves.returns >= MIN_RETURNS
                && moves.back >= MOST_RETURN * moves.all
                && moves.all >= MIN_CHANGE * usual * column.count as f64;
            let is_explained = found.iter().any(|one| one.quantity == Some(quantity));
            (alternates && !is_explained).then(|| Finding {
                kind: Kind::Sources,
                quantity: Some(quantity),
                severity: Severity::Error,
                readings: moves.returns,
                found: format!(
                    "{} alternates between two levels in {} of {} readings: those of two sources",
                    quantity.name(),
                    moves.returns,
                    column.count
                ),
                allowed: "a recording has one source".to_owned(),
                remedy: Remedy::Apart,
            })
        })
    }

    /// A number that means that there is no reading, as its file has it.
    fn sentinels(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let mut found = sentinels(quantity, column)?;
        let is_turned = matches!(quantity, Quantity::Power | Quantity::Current);
        if let (Remedy::Missing { written, .. }, true) = (&mut found.remedy, is_turned) {
            *written = self.known.recorded(*written);
        }
        Some(found)
    }

    fn voltage_sign(&self) -> Option<Finding> {
        let readings = negative_voltage(&self.columns[Quantity::Voltage as usize])?;
        Some(Finding {
            kind: Kind::Sign,
            quantity: Some(Quantity::Voltage),
            severity: Severity::Error,
            readings,
            found: format!("the voltage is negative in {readings} readings"),
            allowed: "batteries have a positive voltage".to_owned(),
            remedy: Remedy::Sensor,
        })
    }

    /// The number among currents that drivers write where they measure none.
    fn reserved(&self) -> Option<Finding> {
        let (readings, recorded_a) = self.reserved.found()?;
        let of = self.columns[Quantity::Current as usize].count;
        Some(Finding {
            kind: Kind::Sentinel,
            quantity: Some(Quantity::Current),
            severity: Severity::Error,
            readings,
            found: format!(
                "current is exactly {} in {readings} of {of} readings, which drivers write where \
                 they measure none",
                Quantity::Current.shown(recorded_a)
            ),
            allowed: "a missing reading is empty or NaN".to_owned(),
            remedy: Remedy::Unmeasured(self.known.recorded(recorded_a)),
        })
    }

    /// Power that is not voltage times current, where no unit, and no full register or number for a
    /// missing value in as many readings, explains it.
    fn mismatch(&self, found: &[Finding]) -> Option<Finding> {
        let of = |quantity: Quantity| &self.columns[quantity as usize];
        let explains = |one: &Finding| match one.kind {
            Kind::Unit => true,
            Kind::Saturation | Kind::Sentinel => one.readings >= self.mismatches,
            _ => false,
        };
        let is_explained = found.iter().any(explains)
            || [Quantity::Power, Quantity::Voltage, Quantity::Current]
                .into_iter()
                .any(|one| of(one).is_zero());
        let share = self.mismatches as f64 / self.products as f64;
        let is_most = share > MAX_MISMATCHES;
        let is_some = share > SOME_MISMATCHES && self.mismatches >= MIN_ROWS;
        if is_explained || self.products < self.known.least(MIN_ROWS) || !(is_most || is_some) {
            return None;
        }
        let usually = match is_most {
            true => format!(
                ": usually {} times it",
                number(self.ratios.usual().unwrap_or(f64::INFINITY))
            ),
            false => String::new(),
        };
        Some(Finding {
            kind: Kind::Mismatch,
            quantity: Some(Quantity::Power),
            severity: if is_most { Severity::Error } else { Severity::Warning },
            readings: self.mismatches,
            found: format!(
                "power is not voltage times current in {} of {} readings{usually}",
                self.mismatches, self.products
            ),
            allowed: "they agree within 10 %".to_owned(),
            remedy: Remedy::Agree,
        })
    }

    fn clock(&self) -> Vec<Finding> {
        let times = &self.times;
        let finding = |kind, severity, readings, found, allowed: String, remedy| Finding {
            kind,
            quantity: None,
            severity,
            readings,
            found,
            allowed,
            remedy,
        };
        let mut found = Vec::new();
        // A robot that reports once a minute has a name for its unit, or texts.
        let (least_hz, greatest_hz) = match self.known.time {
            TimeUnit::Certain => STATED_RATE_HZ,
            TimeUnit::Named => (RATE_HZ.0, STATED_RATE_HZ.1),
            TimeUnit::Unstated => RATE_HZ,
        };
        let rate_hz = times.rate_hz().filter(|_| times.rows >= self.known.least(MIN_ROWS));
        if let Some(rate_hz) = rate_hz.filter(|rate_hz| !(least_hz..=greatest_hz).contains(rate_hz))
        {
            let what = format!("{} rows a second: is the time in seconds?", number(rate_hz));
            let allowed = format!("allowed are {least_hz} to {greatest_hz}");
            let may_be =
                self.known.time == TimeUnit::Named && (STATED_RATE_HZ.0..1.0).contains(&rate_hz);
            let severity = if may_be { Severity::Warning } else { Severity::Error };
            let kind = Kind::Unit;
            found.push(finding(
                kind,
                severity,
                times.rows,
                what,
                allowed,
                Remedy::Seconds(match rate_hz {
                    ..1e-7 => "ns",
                    ..1e-4 => "us",
                    ..1.0 => "ms",
                    ..2e4 => "min",
                    ..5e5 => "h",
                    _ => "d",
                }),
            ));
        }
        let lost = times.repeated + times.backward;
        let allowed = "every row is later than the one before".to_owned();
        if times.loses_many() {
            let why = match (times.has_whole_seconds(), times.backward > times.repeated) {
                (true, _) => ": the times have whole seconds",
                (false, true) => ": the clock was set back, or two recordings are mixed",
                (false, false) => ": the clock stands still",
            };
            let what =
                format!("{lost} of {} rows are not later than those before{why}", times.rows);
            let (kind, severity) = (Kind::Clock, Severity::Error);
            found.push(finding(kind, severity, lost, what, allowed, Remedy::Clock));
        } else if times.back_s > 1.0 {
            let what = format!("the time goes back by up to {} s", number(times.back_s));
            let (kind, severity) = (Kind::Clock, Severity::Warning);
            found.push(finding(kind, severity, times.backward, what, allowed, Remedy::Clock));
        }
        found
    }

    fn holds(&self) -> Option<Finding> {
        let held = self.hold.too_long()?;
        Some(Finding {
            kind: Kind::Hold,
            quantity: Some(Quantity::V),
            severity: Severity::Warning,
            readings: held.rows,
            found: format!(
                "a command of {} m/s and {} rad/s applies unchanged for {} s, and nothing moves",
                number(held.v_mps),
                number(held.omega_radps),
                number(held.held_s)
            ),
            allowed: "a command ends with its controller, or the robot is stuck".to_owned(),
            remedy: Remedy::Expire,
        })
    }

    fn missing(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let is_missing = self.known.expected[quantity as usize]
            && column.count == 0
            && self.times.rows >= MIN_MISSING;
        is_missing.then(|| Finding {
            kind: Kind::NeverCame,
            quantity: Some(quantity),
            severity: Severity::Warning,
            readings: self.times.rows,
            found: format!("{} never came in {} observations", quantity.name(), self.times.rows),
            allowed: "what the source names has values".to_owned(),
            remedy: Remedy::Name,
        })
    }

    fn range(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        let (least, greatest) = self.known.ranges[quantity as usize]?;
        if column.outside == 0 {
            return None;
        }
        let share = column.outside as f64 / column.count as f64;
        let is_wrong = share > MOSTLY && column.count >= self.known.least(MIN_ROWS);
        Some(Finding {
            kind: Kind::Range,
            quantity: Some(quantity),
            severity: if is_wrong { Severity::Error } else { Severity::Warning },
            readings: column.outside,
            found: format!(
                "{} of {} values of {} are out of range: {} to {}",
                column.outside,
                column.count,
                quantity.name(),
                number(column.least),
                quantity.shown(column.greatest)
            ),
            allowed: format!("allowed are {} to {}", number(least), quantity.shown(greatest)),
            remedy: Remedy::Limits,
        })
    }

    /// True if the current is no measurement. A robot at rest that does not say so may show a
    /// constant one, until it drives.
    fn is_unmeasured(&self) -> bool {
        let current = &self.columns[Quantity::Current as usize];
        let is_constant = self.known.whole && self.monitor.is_constant();
        !current.is_zero() && (is_constant || self.monitor.is_unmeasured())
    }

    /// True if the current is no measurement, and power is made of it.
    fn makes_power(&self) -> bool {
        let is_product = self.products >= self.known.least(MIN_ROWS) && self.mismatches == 0;
        is_product && self.is_unmeasured()
    }

    /// True if power is made of a current that may turn out to be no measurement.
    fn is_undecided(&self) -> bool {
        let is_product = self.products > 0 && self.mismatches == 0;
        let current = &self.columns[Quantity::Current as usize];
        !self.known.whole && is_product && !current.is_zero() && self.monitor.is_undecided()
    }

    /// A current that never changes while the voltage does.
    fn unmeasured(&self, column: &Column) -> Finding {
        Finding {
            kind: Kind::Constant,
            quantity: Some(Quantity::Current),
            severity: if self.makes_power() { Severity::Error } else { Severity::Warning },
            readings: column.count,
            found: format!(
                "the current is {} in each of {} readings, while the voltage changes: it is not \
                 measured",
                Quantity::Current.shown(self.known.recorded(column.first)),
                column.count
            ),
            allowed: "a current changes with what the robot does".to_owned(),
            remedy: Remedy::Unmeasured(column.first),
        }
    }

    fn constant(&self, quantity: Quantity, column: &Column) -> Option<Finding> {
        if quantity == Quantity::Current && self.is_unmeasured() {
            return Some(self.unmeasured(column));
        }
        let power = &self.columns[Quantity::Power as usize];
        let is_measured =
            matches!(quantity, Quantity::Power | Quantity::Voltage | Quantity::Current);
        if !is_measured || column.varies {
            return None;
        }
        // A current of 0 explains a power of 0, and the other way round.
        let (severity, least) = match (quantity, column.is_zero()) {
            (Quantity::Power, true) => (Severity::Error, MIN_ROWS),
            (Quantity::Power, false) => (Severity::Warning, MIN_CONSTANT),
            (_, true) if power.is_zero() => return None,
            (_, true) => (Severity::Warning, MIN_ROWS),
            _ => return None,
        };
        (column.count >= least).then(|| Finding {
            kind: Kind::Constant,
            quantity: Some(quantity),
            severity,
            readings: column.count,
            found: format!(
                "{} is {} in each of {} readings",
                quantity.name(),
                quantity.shown(column.first),
                column.count
            ),
            allowed: "readings of a working monitor differ".to_owned(),
            remedy: Remedy::Sensor,
        })
    }
}

fn saturation(quantity: Quantity, column: &Column) -> Option<Finding> {
    let is_measured = matches!(quantity, Quantity::Power | Quantity::Voltage | Quantity::Current);
    let finding = |readings, found| Finding {
        kind: Kind::Saturation,
        quantity: Some(quantity),
        severity: Severity::Warning,
        readings,
        found,
        allowed: "readings stay below the end of the monitor's range".to_owned(),
        remedy: Remedy::Sensor,
    };
    if !is_measured {
        return None;
    }
    if let Some((readings, value, is_full)) = saturated(column) {
        let (name, value) = (quantity.name(), quantity.shown(value));
        let what = match is_full {
            true => {
                format!("{name} is {value}, a full register of 16 bits, in {readings} readings")
            }
            false => {
                format!("{name} ends at exactly {value}, and stays there in {readings} readings")
            }
        };
        return Some(finding(readings, what));
    }
    let (dips, size) = wraps(column)?;
    let (name, size) = (quantity.name(), quantity.shown(size));
    let what =
        format!("{name} wraps: it steps {dips} times or more by {size}, a register of its monitor");
    // Readings beyond it are wrong by the whole register.
    Some(Finding { severity: Severity::Error, ..finding(dips, what) })
}

/// Numbers that mean that there is no reading.
fn sentinels(quantity: Quantity, column: &Column) -> Option<Finding> {
    let finding = |severity, readings, found, (written, value)| Finding {
        kind: Kind::Sentinel,
        quantity: Some(quantity),
        severity,
        readings,
        found,
        allowed: "a missing reading is empty or NaN".to_owned(),
        remedy: Remedy::Missing { written, value },
    };
    if matches!(quantity, Quantity::V | Quantity::Omega) {
        return None;
    }
    let (name, of) = (quantity.name(), column.count);
    if let Some(found) = sentinel(column) {
        let value = quantity.shown(found.value);
        let count = found.count;
        let what =
            format!("{name} is exactly {value} in {count} of {of} readings, far from all others");
        let numbers = (found.written, found.value);
        return Some(finding(Severity::Error, count, what, numbers));
    }
    if let Some((count, single)) =
        silent(column).filter(|_| quantity != Quantity::Voltage && quantity != Quantity::Soc)
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
        return Some(finding(Severity::Warning, count, what, (0.0, 0.0)));
    }
    let (count, single) = dropped(column).filter(|_| quantity == Quantity::Voltage)?;
    let severity = if single { Severity::Error } else { Severity::Warning };
    let what = format!("{name} is exactly 0 V in {count} of {of} readings: no battery has that");
    Some(finding(severity, count, what, (0.0, 0.0)))
}
