//! Judges the signs of power and current while the battery discharges.
//!
//! A robot that brakes or drives downhill feeds energy back, one on a charger takes it from there,
//! and one that stands still still consumes. So readings are counted apart by motion, and where
//! motion decides nothing, the battery does: its voltage falls while it delivers more, its charge
//! falls while it delivers at all.

use crate::column::Column;
use crate::finding::Severity;
use crate::observation::Observation;

/// Readings of a state of motion before they count.
pub(crate) const MIN_READINGS: u64 = 20;
/// Readings of driving that distinguish it from standing on a charger.
const FEW_READINGS: u64 = 3;
/// Time that shows more than braking, s.
pub(crate) const MIN_DRIVE_S: f64 = 3.0;
/// Share of negative readings that contradicts driving.
const NEGATIVE: f64 = 0.9;
/// Speeds from which a robot moves, m/s and rad/s.
const MOVES_MPS: f64 = 0.02;
const MOVES_RADPS: f64 = 0.1;
/// Change of the charge that shows its direction.
const SOC_CHANGE: f64 = 0.005;
/// Correlation of the changes of voltage and current that shows a resistance.
const RESISTANCE: f64 = 0.3;
/// The same where the resistance itself counts.
const CLEAR_RESISTANCE: f64 = 0.5;
/// Pairs of changes before the correlation counts.
const MIN_PAIRS: u64 = 50;
/// Changes of the sign by a driver or a firmware: a robot that feeds energy back has more.
const MAX_FLIPS: u64 = 4;
/// Readings of each sign at one command, and of all negative ones, that show that signs are mixed.
const MIN_MIRRORED: u64 = 5;
const MIN_ALL_MIRRORED: u64 = 10;
/// Relative difference of their means, and spread of each.
const MIRRORED: f64 = 0.1;
const NARROW: f64 = 0.3;
/// Commands that are kept apart, and the size of one, m/s and rad/s.
const COMMANDS: usize = 32;
const COMMAND_MPS: f64 = 0.05;
const COMMAND_RADPS: f64 = 0.1;
/// Rise of the voltage while charging, in standard deviations around its trend, and as a share.
const RISE_STD: f64 = 2.0;
const RISE_SHARE: f64 = 1e-3;

#[derive(Debug, Clone, Copy, Default)]
struct Signs {
    positive: u64,
    negative: u64,
}

impl Signs {
    fn take(&mut self, value: f64) {
        self.positive += u64::from(value > 0.0);
        self.negative += u64::from(value < 0.0);
    }

    const fn count(self) -> u64 {
        self.positive + self.negative
    }

    fn negative_share(self) -> f64 {
        self.negative as f64 / self.count().max(1) as f64
    }

    fn is_negative(self) -> bool {
        self.count() >= MIN_READINGS && self.negative_share() >= NEGATIVE
    }
}

/// A line through pairs, by running sums.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    count: u64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Line {
    fn take(&mut self, x: f64, y: f64) {
        if !(x.is_finite() && y.is_finite()) {
            return;
        }
        self.count += 1;
        let count = self.count as f64;
        let (dx, dy) = (x - self.x, y - self.y);
        self.x += dx / count;
        self.y += dy / count;
        self.xx += dx * (x - self.x);
        self.yy += dy * (y - self.y);
        self.xy += dx * (y - self.y);
    }

    fn correlation(&self) -> f64 {
        self.xy / (self.xx * self.yy).sqrt()
    }

    /// Slope, and the standard deviation of y around the line.
    fn slope(&self) -> (f64, f64) {
        let slope = self.xy / self.xx;
        let around = (self.yy - slope * self.xy).max(0.0) / self.count.max(1) as f64;
        (slope, around.sqrt())
    }
}

/// Readings of one sign at one command.
#[derive(Debug, Clone, Copy, Default)]
struct Side {
    count: u64,
    sum: f64,
    squares: f64,
}

impl Side {
    /// The mean, if the readings are close to each other.
    fn mean(&self) -> Option<f64> {
        let count = self.count as f64;
        let mean = self.sum / count;
        let variance = (self.squares / count - mean * mean).max(0.0);
        (self.count >= MIN_MIRRORED && variance.sqrt() <= NARROW * mean).then_some(mean)
    }
}

/// Power at the same commands, positive and negative.
#[derive(Debug, Clone, Copy)]
struct Mirror([(Option<[i32; 2]>, [Side; 2]); COMMANDS]);

impl Default for Mirror {
    fn default() -> Self {
        Self([(None, [Side::default(); 2]); COMMANDS])
    }
}

impl Mirror {
    fn take(&mut self, seen: &Observation) {
        let steps = [seen.v_mps / COMMAND_MPS, seen.omega_radps / COMMAND_RADPS];
        let size = seen.power_w.abs();
        if moves(seen) != Some(true) || !(size > 0.0 && size.is_finite()) {
            return;
        }
        // An unknown one is 0.
        let command = steps.map(|step| step.round() as i32);
        let place =
            command[0].wrapping_mul(31).wrapping_add(command[1]).rem_euclid(COMMANDS as i32);
        let (key, sides) = &mut self.0[place as usize];
        if *key.get_or_insert(command) == command {
            let side = &mut sides[usize::from(seen.power_w < 0.0)];
            side.count += 1;
            side.sum += size;
            side.squares += size * size;
        }
    }

    /// Positive and negative readings at commands of which both have the same size, and that size.
    fn found(&self) -> Option<(u64, u64, f64)> {
        let mut all = (0, 0, 0.0);
        for (_, [positive, negative]) in &self.0 {
            let (Some(drawn), Some(fed)) = (positive.mean(), negative.mean()) else {
                continue;
            };
            if (drawn - fed).abs() <= MIRRORED * drawn.max(fed) {
                all.0 += positive.count;
                all.1 += negative.count;
                all.2 = drawn.max(all.2);
            }
        }
        (all.0.min(all.1) >= MIN_ALL_MIRRORED).then_some(all)
    }
}

/// Evidence of one robot about the signs of its power and current.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sign {
    moving: Signs,
    still: Signs,
    unknown: Signs,
    /// Current negative where power is positive, and the other way round.
    current_against_power: u64,
    currents: u64,
    /// Changes of voltage over changes of current.
    resistance: Line,
    /// The same where current is positive, and where it is negative.
    resistances: [Line; 2],
    flips: u64,
    trend: Line,
    began: bool,
    first_s: f64,
    last_s: f64,
    before: Option<(f64, f64)>,
    soc: Option<(f64, f64)>,
    mirror: Mirror,
}

pub(crate) struct WrongSign {
    pub(crate) severity: Severity,
    pub(crate) readings: u64,
    pub(crate) of: u64,
    pub(crate) why: &'static str,
}

/// True if the robot moves, measured or else commanded. `None` if neither is known.
pub(crate) fn moves(seen: &Observation) -> Option<bool> {
    let of = |v_mps: f64, omega_radps: f64| {
        let known = !v_mps.is_nan() || !omega_radps.is_nan();
        known.then_some(v_mps.abs() > MOVES_MPS || omega_radps.abs() > MOVES_RADPS)
    };
    of(seen.v_measured_mps, seen.omega_measured_radps).or(of(seen.v_mps, seen.omega_radps))
}

impl Sign {
    pub(crate) fn take(&mut self, seen: &Observation) {
        if let Some(soc) = Some(seen.soc).filter(|soc| soc.is_finite()) {
            let first = self.soc.map_or(soc, |(first, _)| first);
            self.soc = Some((first, soc));
        }
        if !self.began {
            (self.began, self.first_s) = (true, seen.time_s);
        }
        self.last_s = seen.time_s;
        // Relative to the first time: squares of Unix seconds lose the rest.
        self.trend.take(seen.time_s - self.first_s, seen.voltage_v);
        let load = if seen.current_a.is_finite() { seen.current_a } else { seen.power_w };
        if let Some((voltage_v, before)) = self.before
            && load != before
        {
            self.resistance.take(load - before, seen.voltage_v - voltage_v);
            self.flips += u64::from(load * before < 0.0);
            if load * before > 0.0 {
                let of = &mut self.resistances[usize::from(load < 0.0)];
                of.take(load - before, seen.voltage_v - voltage_v);
            }
        }
        self.before =
            (seen.voltage_v.is_finite() && load.is_finite()).then_some((seen.voltage_v, load));
        if seen.charging == Some(true) {
            return;
        }
        let signs = match moves(seen) {
            Some(true) => &mut self.moving,
            Some(false) => &mut self.still,
            None => &mut self.unknown,
        };
        signs.take(seen.power_w);
        self.mirror.take(seen);
        let product = seen.power_w * seen.current_a;
        self.currents += u64::from(product != 0.0 && product.is_finite());
        self.current_against_power += u64::from(product < 0.0);
    }

    /// Judges power. `whole`: nothing more will come, so that a few readings count.
    pub(crate) fn power(&self, whole: bool) -> Option<WrongSign> {
        let wrong = |severity, signs: Signs, why| {
            Some(WrongSign { severity, readings: signs.negative, of: signs.count(), why })
        };
        let all = [self.moving, self.still, self.unknown];
        let positive: u64 = all.iter().map(|signs| signs.positive).sum();
        let is_short = self.last_s - self.first_s < MIN_DRIVE_S
            || all.iter().map(|signs| signs.count()).sum::<u64>() < MIN_READINGS;
        let driven = if self.moving.negative > 0 { self.moving } else { self.unknown };
        if whole
            && is_short
            && positive == 0
            && driven.negative >= FEW_READINGS
            && self.charges() != Some(true)
        {
            return wrong(Severity::Error, driven, "of a short recording");
        }
        if self.moving.count() >= MIN_READINGS {
            // Electronics never feed back: a robot that consumes at rest is one that drives
            // downhill.
            let consumes_at_rest =
                self.still.count() >= MIN_READINGS && self.still.negative_share() < 0.5;
            // A short stretch may be all braking.
            let is_long = self.last_s - self.first_s >= MIN_DRIVE_S;
            let feeds_back = self.charges() == Some(true);
            if self.moving.is_negative() && is_long && !consumes_at_rest && !feeds_back {
                return wrong(Severity::Error, self.moving, "while the robot drives");
            }
            return None;
        }
        // Even little motion distinguishes a charger from the other sign.
        let drives = self.moving.count() >= FEW_READINGS && self.moving.positive == 0;
        let (signs, severity) = match self.still.is_negative() {
            true if drives => (self.still, Severity::Error),
            true => (self.still, Severity::Warning),
            false => (self.unknown, Severity::Error),
        };
        if !signs.is_negative() {
            return None;
        }
        match self.discharges() {
            Some(true) => wrong(Severity::Error, signs, "while the battery discharges"),
            Some(false) => None,
            None if severity == Severity::Error => {
                wrong(severity, signs, "and nothing shows that it is on a charger")
            }
            None => wrong(severity, signs, "while the robot stands, and nothing shows a charger"),
        }
    }

    /// The current, where power has the other sign: readings, out of so many.
    pub(crate) fn current(&self) -> Option<(u64, u64)> {
        let share = self.current_against_power as f64 / self.currents.max(1) as f64;
        let is_turned = self.currents >= MIN_READINGS && share >= NEGATIVE;
        is_turned.then_some((self.current_against_power, self.currents))
    }

    /// Change of the voltage for each ampere, Ω, if it is clear and currents are known.
    pub(crate) fn resistance_ohm(&self) -> Option<f64> {
        let correlation = self.resistance.correlation().abs();
        let is_clear = self.resistance.count >= MIN_PAIRS && correlation >= CLEAR_RESISTANCE;
        (is_clear && self.currents > 0).then(|| self.resistance.slope().0.abs())
    }

    /// Begins another recording, which may be of another battery.
    pub(crate) fn begin(&mut self) {
        (self.before, self.soc, self.trend) = (None, None, Line::default());
    }

    /// Number of negative readings, if the sign changes within the recording. Delivering more then
    /// lowers the voltage with one sign, and raises it with the other.
    pub(crate) fn changes(&self) -> Option<u64> {
        let clear = self.resistances.map(|line| {
            let correlation = line.correlation();
            let is_clear = line.count >= MIN_PAIRS && correlation.abs() >= RESISTANCE;
            is_clear.then_some(correlation < 0.0)
        });
        let negative = self.moving.negative + self.still.negative + self.unknown.negative;
        let is_rare = self.flips <= MAX_FLIPS;
        (is_rare && clear == [Some(true), Some(false)]).then_some(negative)
    }

    /// Positive and negative readings of one size at the same commands, and that size, W.
    pub(crate) fn mirrored(&self) -> Option<(u64, u64, f64)> {
        self.mirror.found()
    }

    /// True if negative readings are of a battery that takes energy: by its charge, or by its
    /// resistance, which shows the sign of the current.
    fn charges(&self) -> Option<bool> {
        if let Some((first, last)) = self.soc
            && (last - first).abs() > SOC_CHANGE
        {
            return Some(last > first);
        }
        let correlation = self.resistance.correlation();
        let is_clear = self.resistance.count >= MIN_PAIRS && correlation.abs() >= RESISTANCE;
        // Delivering more lowers the voltage: with the right sign they go apart.
        is_clear.then_some(correlation < 0.0)
    }

    /// True if negative readings are of a battery that discharges.
    fn discharges(&self) -> Option<bool> {
        if let Some(charges) = self.charges() {
            return Some(!charges);
        }
        let (slope, std) = self.trend.slope();
        let change_v = slope * (self.last_s - self.first_s);
        let is_clear = self.trend.count >= MIN_READINGS
            && change_v.abs() > RISE_STD * std
            && change_v.abs() > RISE_SHARE * self.trend.y.abs();
        is_clear.then_some(change_v < 0.0)
    }
}

/// Voltages below 0, which no sign explains.
pub(crate) fn negative_voltage(column: &Column) -> Option<u64> {
    let share = column.negative as f64 / column.count.max(1) as f64;
    (column.count >= MIN_READINGS && share >= NEGATIVE).then_some(column.negative)
}
