//! Names of columns in a CSV: the published layout's, usual spellings in several units, and those
//! that the caller maps.

use std::fmt;
use std::str::FromStr;

use super::limits::{InMemory, MAX_ROWS};
use super::table::{CHARGING_NAME, Column, ROBOT_NAMES, TIME_NAMES, Table};

/// The quantity of a file's column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// The robot's name.
    Robot,
    /// The time of a row.
    Time,
    /// One of the columns of a trial.
    Column(Column),
    /// A number that stands for no value, in any column.
    Missing,
}

#[derive(Clone, Copy)]
struct Spelling {
    quantity: Quantity,
    /// Its name in [`ColumnMap`] and in messages.
    name: &'static str,
    /// The names of the published layout, which take precedence.
    layout: &'static str,
    /// Other names, in lower case, without the unit.
    others: &'static str,
    /// Units with the factor to the layout's unit. The first one applies to a mapped column without
    /// a unit in its name, "" to a name without a unit.
    units: &'static str,
}

const fn of(column: Column) -> Quantity {
    Quantity::Column(column)
}

/// Every quantity: its name, those of the layout, others, and units. The units of voltage, current
/// and power have to be in the name, except where the layout's names have none.
const NAMES: &str = "\
robot|robot_id|robot robot_name|=1
time|timestamp_s timestamp|time t stamp timestamp elapsed datetime date_time time_stamp\
    |s=1 sec=1 seconds=1 ms=1e-3 us=1e-6 ns=1e-9 min=60 h=3600 d=86400 =1
power|power_mW|power p pwr electrical_power|W=1e3 mW=1 kW=1e6 uW=1e-3
v|v_cmd_mps v_cmd|v vx linear_velocity v_linear cmd_v linear_x cmd_vel_linear_x\
    |mps=1 m_s=1 mmps=1e-3 mm_s=1e-3 cmps=1e-2 cm_s=1e-2 \
    km_h=0.2777777777777778 kmh=0.2777777777777778 =1
omega|omega_cmd_radps omega_cmd\
    |omega w wz w_cmd angular_velocity omega_z cmd_omega angular_z cmd_vel_angular_z yaw_rate\
    |radps=1 rad_s=1 degps=0.017453292519943295 deg_s=0.017453292519943295 =1
voltage|voltage_mV voltage|voltage battery_voltage bus_voltage|V=1e3 mV=1 uV=1e-3 cV=10
current|current_mA current|current battery_current bus_current|A=1e3 mA=1 uA=1e-3 cA=10
v_meas|v_meas_mps v_meas|v_measured measured_v odom_v\
    |mps=1 m_s=1 mmps=1e-3 mm_s=1e-3 cmps=1e-2 cm_s=1e-2 \
    km_h=0.2777777777777778 kmh=0.2777777777777778 =1
omega_meas|omega_meas_radps omega_meas|omega_measured measured_omega odom_omega\
    |radps=1 rad_s=1 degps=0.017453292519943295 deg_s=0.017453292519943295 =1
soc|soc|soc state_of_charge battery_soc|percent=0.01 pct=0.01 share=1 =1
x|x_m x|pos_x position_x|m=1 =1
y|y_m y|pos_y position_y|m=1 =1
theta|theta_rad theta|heading yaw|rad=1 =1
phase|phase||=1";

fn spellings() -> impl Iterator<Item = Spelling> {
    NAMES.lines().map(|line| {
        let mut parts = line.split('|').map(str::trim);
        let mut next = || parts.next().unwrap_or_default();
        let (name, layout, others, units) = (next(), next(), next(), next());
        let is_of = |column: &Column| Some(column.name()) == layout.split(' ').next();
        let quantity = match Column::ALL.into_iter().find(is_of) {
            Some(column) => of(column),
            None if name == "robot" => Quantity::Robot,
            None => Quantity::Time,
        };
        Spelling { quantity, name, layout, others, units }
    })
}

fn spelling(quantity: Quantity) -> Spelling {
    let found = spellings().find(|spelling| spelling.quantity == quantity);
    // A test checks that every quantity is in the table.
    found.unwrap_or(Spelling { quantity, name: "", layout: "", others: "", units: "" })
}

impl Spelling {
    fn has_layout(self, name: &str) -> bool {
        self.layout.split(' ').any(|own| own == name)
    }

    fn has_other(self, name: &str) -> bool {
        !name.is_empty() && self.others.split(' ').any(|other| other == name)
    }

    /// Units in lower case, their factors, and the units as they are shown.
    fn units(self) -> impl Iterator<Item = (String, f64, &'static str)> {
        self.units.split(' ').map(|text| {
            let (unit, factor) = text.split_once('=').unwrap_or_default();
            // A test reads the table.
            (unit.to_lowercase(), factor.parse().unwrap_or(f64::NAN), unit)
        })
    }

    /// The factor of a name other than exactly the layout's, and whether the name has the unit.
    fn factor(self, name: &str) -> Option<(f64, bool)> {
        // V and W alone are units more often than velocities.
        if name.chars().count() == 1 && name.chars().any(char::is_uppercase) {
            return None;
        }
        let name = plain(name);
        self.units().find_map(|(unit, factor, _)| {
            let bare = match unit.is_empty() {
                true => name.as_str(),
                false => name.strip_suffix(unit.as_str())?.strip_suffix('_')?,
            };
            let is_name = self.has_other(bare) || self.has_layout(bare);
            is_name.then_some((factor, !unit.is_empty()))
        })
    }

    /// The factor of a mapped column, by the unit at the end of its name, and whether that has one.
    fn mapped_factor(self, name: &str) -> (f64, bool) {
        let name = plain(name);
        let by_unit = self.units().find(|(unit, ..)| {
            let rest = name.strip_suffix(unit.as_str());
            !unit.is_empty() && rest.is_some_and(|rest| rest.ends_with('_'))
        });
        let is_stated = by_unit.is_some();
        let factor = by_unit.or(self.units().next());
        (factor.map_or(1.0, |(_, factor, _)| factor), is_stated)
    }
}

/// The last parts of names that follow a topic or a message, as PlotJuggler writes them
/// (`/robot/cmd_vel/linear/x`), with the factor of ROS's unit to the layout's. Measured velocities
/// come first: odometry has them in the same fields.
const FIELDS: [(&str, Quantity, f64); 9] = [
    ("twist_twist_linear_x", of(Column::VMeasured), 1.0),
    ("twist_twist_angular_z", of(Column::OmegaMeasured), 1.0),
    ("linear_x", of(Column::V), 1.0),
    ("angular_z", of(Column::Omega), 1.0),
    ("voltage", of(Column::Voltage), 1e3),
    ("current", of(Column::Current), 1e3),
    ("percentage", of(Column::Soc), 1.0),
    ("pose_pose_position_x", of(Column::X), 1.0),
    ("pose_pose_position_y", of(Column::Y), 1.0),
];

/// The quantity of a field of a message, named by its path.
fn field(name: &str) -> Option<(Quantity, f64)> {
    let plain = plain(name);
    let is_end = |end: &str| {
        let before = name.len().checked_sub(end.len());
        let before = before.and_then(|at| name.get(..at));
        let is_after =
            before.is_some_and(|before| before.is_empty() || before.ends_with(['/', '.']));
        plain.ends_with(end) && is_after && name.contains(['/', '.'])
    };
    let found = FIELDS.iter().find(|(end, ..)| is_end(end));
    found.map(|(_, quantity, factor)| (*quantity, *factor))
}

/// A name in lower case. Brackets, dots, slashes, spaces and hyphens count as an underscore.
fn plain(name: &str) -> String {
    let mut plain = String::with_capacity(name.len());
    for letter in name.chars() {
        match letter {
            // A unit in brackets. In front of a name it is rostopic's.
            '%' if plain.ends_with('_') => plain.push_str("percent"),
            ' ' | '[' | ']' | '(' | ')' | '/' | '.' | '-' | '_' | '%' | '#' | ',' => {
                if !plain.ends_with('_') && !plain.is_empty() {
                    plain.push('_');
                }
            }
            'µ' | 'μ' => plain.push('u'),
            'ω' => plain.push_str("omega"),
            letter => plain.extend(letter.to_lowercase()),
        }
    }
    plain.trim_end_matches('_').to_owned()
}

/// One column of a file under a name of its own: `power=battery_W`, or with the unit of a name
/// that states none, `power_mW=p1`.
#[derive(Debug, Clone, PartialEq)]
pub struct MappedColumn {
    text: String,
    quantity: Quantity,
    /// The name in the file, or the value of every row.
    name: String,
    is_constant: bool,
    /// Factor to the unit of the layout, negative for a column with the other sign.
    factor: f64,
    /// True if the caller, or the name, states the unit.
    states_unit: bool,
}

/// Reason that a mapping is invalid: it has no name on one of its sides, or its quantity is unknown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct MapError(String);

impl FromStr for MappedColumn {
    type Err = MapError;

    fn from_str(text: &str) -> Result<Self, MapError> {
        let form = || {
            MapError(format!(
                "{text:?} is no mapping. Examples: power=battery_W, power_mW=p1, and voltage_V:=3.0 \
                 for what every row has"
            ))
        };
        let sides = text.split_once('=').map(|(left, right)| (left.trim(), right.trim()));
        let (quantity, name) =
            sides.filter(|(a, b)| !a.is_empty() && !b.is_empty()).ok_or_else(form)?;
        let (quantity, is_constant) = match quantity.strip_suffix(':') {
            Some(quantity) => (quantity.trim_end(), true),
            None => (quantity, false),
        };
        // A minus turns the sign.
        let (name, sign) = match name.strip_prefix('-') {
            Some(name) if !name.is_empty() => (name, -1.0),
            _ => (name, 1.0),
        };
        let wanted = plain(quantity);
        if wanted == "missing" {
            let is_number = name.parse::<f64>().is_ok_and(f64::is_finite);
            return match is_constant && is_number {
                true => Ok(Self {
                    text: text.to_owned(),
                    quantity: Quantity::Missing,
                    name: name.to_owned(),
                    is_constant,
                    factor: sign,
                    states_unit: true,
                }),
                false => Err(form()),
            };
        }
        for spelling in spellings() {
            let (factor, states_unit) = if wanted == spelling.name {
                spelling.mapped_factor(name)
            } else {
                let unit =
                    wanted.strip_prefix(spelling.name).and_then(|rest| rest.strip_prefix('_'));
                match spelling.units().find(|(name, ..)| Some(name.as_str()) == unit) {
                    Some((_, factor, _)) => (factor, true),
                    None => continue,
                }
            };
            let is_value = match spelling.quantity {
                Quantity::Robot => true,
                Quantity::Time | Quantity::Missing => false,
                Quantity::Column(_) => name.parse::<f64>().is_ok_and(f64::is_finite),
            };
            if is_constant && !is_value {
                return Err(form());
            }
            return Ok(Self {
                text: text.to_owned(),
                quantity: spelling.quantity,
                name: name.to_owned(),
                is_constant,
                factor: sign * factor,
                states_unit,
            });
        }
        let allowed: Vec<&str> = spellings().map(|one| one.name).collect();
        Err(MapError(format!(
            "{quantity:?} is no quantity, allowed: {}, missing, each with a unit if it is not in the \
             column's name. An energy (Wh) or a charge (Ah) is not read: give power, or voltage and \
             current",
            allowed.join(", ")
        )))
    }
}

impl MappedColumn {
    pub(super) const fn names_unit(&self) -> bool {
        self.states_unit
    }
}

impl fmt::Display for MappedColumn {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.text)
    }
}

/// Rules for reading a recording: the columns that the caller names, and the sign of its current.
/// The other columns are found by their spelling.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColumnMap {
    columns: Vec<MappedColumn>,
    /// True if the columns are those of a config.
    is_configured: bool,
    turned: bool,
    turned_as_configured: bool,
    whole_rows: bool,
    part_rows: Option<usize>,
}

impl From<Vec<MappedColumn>> for ColumnMap {
    fn from(columns: Vec<MappedColumn>) -> Self {
        Self { columns, ..Self::default() }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    pub(super) position: usize,
    /// Factor to the unit of the layout.
    pub(super) factor: f64,
    /// True if the name or the caller states the unit.
    pub(super) states_unit: bool,
}

impl ColumnMap {
    /// For recordings whose current is negative while the battery discharges, in any format.
    #[must_use]
    pub fn discharge_negative(self, turned: bool) -> Self {
        Self { turned, ..self }
    }

    pub(super) fn with(mut self, columns: Vec<MappedColumn>) -> Self {
        self.columns.extend(columns);
        self
    }

    /// Takes the columns from a platform's config. A file that has none of them is read without.
    #[must_use]
    pub fn configured(self, columns: Vec<MappedColumn>) -> Self {
        Self { columns, is_configured: true, ..self }
    }

    /// Takes the sign of the current from a platform's config. Captures and archives, which
    /// joulebus wrote, are never turned by it.
    #[must_use]
    pub fn configured_discharge_negative(self, turned_as_configured: bool) -> Self {
        Self { turned_as_configured, ..self }
    }

    /// Leaves out lines of a CSV that are no whole rows, instead of refusing the file.
    #[must_use]
    pub fn whole_rows(self, whole_rows: bool) -> Self {
        Self { whole_rows, ..self }
    }

    /// Reads files with more rows in parts, where they are read in parts ([`Table::each`]). By
    /// default, [`MAX_ROWS`](super::MAX_ROWS).
    #[must_use]
    pub fn in_parts_of(self, rows: usize) -> Self {
        Self { part_rows: Some(rows), ..self }
    }

    /// Rows in memory where a file is read in parts.
    pub(super) fn in_parts(&self) -> InMemory {
        InMemory::parts(self.part_rows.unwrap_or(MAX_ROWS))
    }

    pub(super) const fn leaves_out(&self) -> bool {
        self.whole_rows
    }

    /// Turns the sign of a table's current if the caller states that it is negative while the
    /// battery discharges. A config is for files that joulebus did not write.
    pub fn apply_sign(&self, table: &mut Table) {
        if self.turns() {
            table.turn();
        }
    }

    /// True if the current is negative while the battery discharges.
    pub(super) const fn turns(&self) -> bool {
        self.turned
    }

    /// Turns the tables of a file that joulebus did not write, if a config states it.
    pub(super) fn turn_as_configured(&self, tables: &mut [Table]) {
        if self.turned_as_configured {
            tables.iter_mut().for_each(Table::turn);
        }
    }

    /// The map for a file with these columns: of another layout than the config's it names none.
    pub(super) fn of_file(&self, names: &[String]) -> Self {
        let has_pairs = !self.time_pairs(names).is_empty();
        let is_there = |(quantity, name): (Quantity, &str)| {
            (quantity == Quantity::Time && has_pairs) || names.iter().any(|found| found == name)
        };
        let mut own = self.clone();
        // `joulebus data convert` has turned it, if it was to be turned.
        own.turned_as_configured &= !is_converted(names);
        if self.is_configured && self.named().next().is_some() && !self.named().any(is_there) {
            own.columns.clear();
            own.turned_as_configured = false;
        }
        own
    }

    /// True if the caller names the column of a quantity.
    pub(super) fn maps(&self, quantity: Quantity) -> bool {
        self.columns.iter().any(|column| column.quantity == quantity)
    }

    /// The mapped columns: `(quantity, name in the file)`.
    pub(super) fn named(&self) -> impl Iterator<Item = (Quantity, &str)> {
        let columns = self.columns.iter().filter(|column| !column.is_constant);
        columns.map(|column| (column.quantity, column.name.as_str()))
    }

    /// The value that a quantity has in every row, with the factor to the layout's unit.
    pub(super) fn constant(&self, quantity: Quantity) -> Option<(&str, f64)> {
        let found =
            self.columns.iter().find(|column| column.is_constant && column.quantity == quantity);
        found.map(|column| (column.name.as_str(), column.factor))
    }

    /// The sum of columns and products that a quantity is mapped to, if no column has that name,
    /// with the factor to the layout's unit, and its text.
    pub(super) fn sum(
        &self,
        quantity: Quantity,
        names: &[String],
    ) -> Option<(Vec<Term>, f64, String)> {
        let found = |column: &&MappedColumn| {
            column.quantity == quantity
                && !column.is_constant
                && matches!(quantity, Quantity::Column(_))
                && !names.contains(&column.name)
        };
        let column = self.columns.iter().find(found)?;
        let terms = terms(&column.name, column.factor < 0.0, names)?;
        Some((terms, column.factor.abs(), column.name.clone()))
    }

    pub(super) fn missing(&self) -> Vec<f64> {
        let columns = self.columns.iter().filter(|column| column.quantity == Quantity::Missing);
        let numbers =
            columns.filter_map(|column| Some(column.factor * column.name.parse::<f64>().ok()?));
        numbers.collect()
    }

    /// The two columns of a time in seconds and nanoseconds, and what is in front of their names.
    /// If the time is mapped, the one of that name, else all.
    pub(super) fn time_pairs(&self, names: &[String]) -> Vec<(usize, usize, String)> {
        let mapped = self.named().find(|(of, _)| *of == Quantity::Time);
        let mapped = mapped.map(|(_, name)| plain(name));
        let plains: Vec<String> = names.iter().map(|name| plain(name)).collect();
        let pair = |(at, name): (usize, &String)| {
            let bare = NANOSECONDS.iter().find_map(|end| name.strip_suffix(end))?;
            let seconds = plains.iter().position(|other| {
                let same = other.strip_prefix(bare);
                same.is_some_and(|end| matches!(end, "sec" | "secs" | "seconds"))
            })?;
            Some((seconds, at, bare.trim_end_matches('_').to_owned()))
        };
        let pairs = plains.iter().enumerate().filter_map(pair);
        pairs.filter(|(.., name)| mapped.as_ref().is_none_or(|mapped| mapped == name)).collect()
    }

    /// Positions of a quantity among a file's columns, with the factor to the layout's unit: mapped
    /// columns, else the layout's names, else other spellings, else fields of messages. A file
    /// should have at most one.
    pub(super) fn positions(&self, quantity: Quantity, names: &[String]) -> Vec<Found> {
        let taken = |name: &str| self.named().any(|(_, mapped)| mapped == name);
        let each = || names.iter().enumerate();
        if self.maps(quantity) {
            let mapped = self
                .columns
                .iter()
                .filter(|column| column.quantity == quantity && !column.is_constant);
            let found = mapped.flat_map(|column| {
                let same = each().filter(|(_, name)| **name == column.name);
                same.map(|(position, _)| Found {
                    position,
                    factor: column.factor,
                    states_unit: column.states_unit || quantity != Quantity::Time,
                })
            });
            return found.collect();
        }
        let spelling = spelling(quantity);
        let among = |found: &dyn Fn(&str) -> Option<(f64, bool)>| -> Vec<Found> {
            each()
                .filter(|(_, name)| !taken(name))
                .filter_map(|(position, name)| {
                    found(name).map(|(factor, states_unit)| Found { position, factor, states_unit })
                })
                .collect()
        };
        let layout = among(&|name| {
            let is_first = spelling.layout.split(' ').next() == Some(name);
            spelling.has_layout(name).then_some((1.0, is_first))
        });
        if !layout.is_empty() {
            return layout;
        }
        let spelled = among(&|name| {
            let (factor, has_unit) = spelling.factor(name)?;
            Some((factor, has_unit || quantity != Quantity::Time))
        });
        if !spelled.is_empty() {
            return spelled;
        }
        among(&|name| {
            let (found, factor) = field(name)?;
            (found == quantity).then_some((factor, true))
        })
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Term {
    pub(super) sign: f64,
    pub(super) factors: Vec<usize>,
}

/// The sum `a+b*c-d` of columns, if all of them are there. `is_negative`: a minus stands in front.
fn terms(text: &str, is_negative: bool, names: &[String]) -> Option<Vec<Term>> {
    let mut terms = Vec::new();
    let mut rest = text;
    let mut sign = if is_negative { -1.0 } else { 1.0 };
    loop {
        let mut factors = Vec::new();
        loop {
            // The longest name: one may have a sign in it.
            let fits = |name: &&String| {
                let behind = rest.strip_prefix(name.as_str());
                behind.is_some_and(|end| {
                    end.is_empty() || end.trim_start().starts_with(['+', '-', '*'])
                })
            };
            let named = names.iter().filter(|name| !name.is_empty()).filter(fits);
            let name = named.max_by_key(|name| name.len())?;
            factors.push(names.iter().position(|other| other == name)?);
            rest = rest[name.len()..].trim_start();
            match rest.strip_prefix('*') {
                Some(behind) => rest = behind.trim_start(),
                None => break,
            }
        }
        terms.push(Term { sign, factors });
        let Some(letter) = rest.chars().next() else {
            return Some(terms);
        };
        sign = if letter == '-' { -1.0 } else { 1.0 };
        rest = rest[1..].trim_start();
    }
}

/// Ends of the name of a column with the nanoseconds of a time.
const NANOSECONDS: [&str; 4] = ["nanosec", "nanosecs", "nsecs", "nsec"];

/// True if a header is that of a table which joulebus writes.
fn is_converted(names: &[String]) -> bool {
    let first = [ROBOT_NAMES[0], TIME_NAMES[0]].into_iter();
    let last = [CHARGING_NAME];
    let mut own = first.chain(Column::ALL.map(Column::name)).chain(last);
    names.first().is_some_and(|name| name == ROBOT_NAMES[0])
        && names.iter().all(|name| own.any(|one| one == name))
}

/// The factor to the layout's unit of a unit behind a number.
pub(super) fn unit_factor(column: Column, unit: &str) -> Option<f64> {
    let unit = if unit == "%" { "percent" } else { &unit.to_lowercase() };
    let mut units = spelling(of(column)).units().filter(|(name, ..)| !name.is_empty());
    units.find(|(name, ..)| name == unit).map(|(_, factor, _)| factor)
}

/// True for a usual name of a column that states no unit.
pub(super) fn is_bare(column: Column, name: &str) -> bool {
    spelling(of(column)).has_other(&plain(name))
}

/// The option for a column that looks like a command, if its quantity is not read already: words of
/// its name, in lower case.
pub(crate) fn command_option(name: &str, reads_v: bool, reads_omega: bool) -> Option<String> {
    const TURNS: [&str; 7] = ["ang", "omega", "yaw", "rot", "turn", "theta_dot", "wz"];
    const DRIVES: [&str; 5] = ["vel", "speed", "linear", "lin_", "vx"];
    const MEASURED: [&str; 10] =
        ["meas", "actual", "odom", "wheel", "wind", "fan", "rpm", "acc", "imu", "gyro"];
    let plain = plain(name).replace("level", "");
    let name_is = |words: &[&str]| words.iter().any(|word| plain.contains(word));
    let (quantity, is_read) = match (name_is(&TURNS), name_is(&DRIVES)) {
        _ if name_is(&MEASURED) => return None,
        (true, true) => (Column::Omega, reads_omega),
        (false, true) => (Column::V, reads_v),
        _ => return None,
    };
    let spelling = spelling(of(quantity));
    // The unit of the name applies, if it has one.
    let quantity = match (spelling.mapped_factor(name).1, spelling.units().next()) {
        (false, Some((.., unit))) => format!("{}_{unit}", spelling.name),
        _ => spelling.name.to_owned(),
    };
    (!is_read).then(|| format!("--map '{quantity}={name}'"))
}

/// Accepted names of a quantity, for messages.
pub(super) fn accepted(quantity: Quantity) -> String {
    let spelling = spelling(quantity);
    let unit = spelling.units().next().map_or("", |(.., shown)| shown);
    let mut names: Vec<String> = spelling.layout.split(' ').map(str::to_owned).collect();
    if let (Some(other), false) = (spelling.others.split(' ').next(), unit.is_empty()) {
        names.push(format!("{other}_{unit}"));
    }
    format!("{} ({}, …)", spelling.name, names.join(", "))
}

/// The table of accepted names, one line for each quantity.
pub fn column_names() -> String {
    let mut table = String::new();
    for spelling in spellings() {
        let Spelling { name, layout, others, .. } = spelling;
        let units: Vec<&str> = spelling.units().map(|(.., shown)| shown).collect();
        let listed: Vec<&str> = units.iter().copied().filter(|unit| !unit.is_empty()).collect();
        let mut line = format!("  {name:10} {layout}");
        if !others.is_empty() {
            line.push_str(&format!("; {others}"));
        }
        if !listed.is_empty() {
            let bare = units.len() > listed.len();
            let with = if bare { ", also with" } else { ", with" };
            line.push_str(&format!("{with} _{}", listed.join(" _")));
        }
        table.push_str(&line);
        table.push('\n');
    }
    table
}

impl fmt::Display for Quantity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Missing => "missing",
            quantity => spelling(*quantity).name,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_its_spellings_and_the_layout_its_names() {
        for column in Column::ALL {
            let spelling = spelling(of(column));
            assert!(spelling.units().all(|(_, factor, _)| factor > 0.0));
            assert_eq!(spelling.quantity, of(column));
            assert!(spelling.has_layout(column.name()));
        }
    }

    #[test]
    fn usual_spellings_are_found_with_their_units() {
        let map = ColumnMap::default();
        for (name, quantity, factor) in [
            ("time", Quantity::Time, 1.0),
            ("t_ms", Quantity::Time, 1e-3),
            ("Timestamp [ns]", Quantity::Time, 1e-9),
            ("power_W", of(Column::Power), 1e3),
            ("Power (mW)", of(Column::Power), 1.0),
            ("P_w", of(Column::Power), 1e3),
            ("v", of(Column::V), 1.0),
            ("linear.x", of(Column::V), 1.0),
            ("omega_rad/s", of(Column::Omega), 1.0),
            ("v_cmd (m/s)", of(Column::V), 1.0),
            ("V_CMD", of(Column::V), 1.0),
            ("v [km/h]", of(Column::V), 1.0 / 3.6),
            ("v_meas [cm/s]", of(Column::VMeasured), 1e-2),
            ("omega_cmd [rad/s]", of(Column::Omega), 1.0),
            ("omega_cmd (deg/s)", of(Column::Omega), std::f64::consts::PI / 180.0),
            ("x [m]", of(Column::X), 1.0),
            ("yaw_rate", of(Column::Omega), 1.0),
            ("battery_voltage_V", of(Column::Voltage), 1e3),
            ("Current(uA)", of(Column::Current), 1e-3),
            ("power_uW", of(Column::Power), 1e-3),
            ("__time", Quantity::Time, 1.0),
            ("%time", Quantity::Time, 1.0),
            ("/r1/battery_state/voltage", of(Column::Voltage), 1e3),
            ("battery.percentage", of(Column::Soc), 1.0),
            ("/r1/cmd_vel/twist/linear/x", of(Column::V), 1.0),
            ("/r1/odom/twist/twist/linear/x", of(Column::VMeasured), 1.0),
            ("current_A", of(Column::Current), 1e3),
        ] {
            let found = map.positions(quantity, &[name.to_owned()]);
            let found: Vec<_> = found.iter().map(|one| (one.position, one.factor)).collect();
            assert_eq!(found, [(0, factor)], "{name}");
        }
        // A remedy keeps the unit of the name.
        let option = command_option("Speed (km/h)", false, false);
        assert_eq!(option.as_deref(), Some("--map 'v=Speed (km/h)'"));
        // Measured, not commanded.
        let odometry = ["/odom/twist/twist/angular/z".to_owned()];
        assert!(map.positions(of(Column::Omega), &odometry).is_empty());
        // Neither watt nor milliwatt: not guessed.
        assert!(map.positions(of(Column::Power), &["power".to_owned()]).is_empty());
    }

    #[test]
    fn mapped_columns_take_precedence_and_state_their_unit() {
        for (mapping, factor) in [
            ("power=load_W", 1e3),
            ("power=load", 1e3),
            ("power_mW=load", 1.0),
            ("power_mW=load_W", 1.0),
            ("power=-load_W", -1e3),
            ("power_mW=-load_W", -1.0),
        ] {
            let mapped: MappedColumn = mapping.parse().expect(mapping);
            let name = mapped.name.clone();
            let map = ColumnMap::from(vec![mapped]);
            let names = ["power_mW".to_owned(), name];
            let found = map.positions(of(Column::Power), &names);
            let found: Vec<_> = found.iter().map(|one| (one.position, one.factor)).collect();
            assert_eq!(found, [(1, factor)], "{mapping}");
        }
        // The units that remedies name.
        for (mapping, factor) in [
            ("soc=charge", 0.01),
            ("soc_share=charge", 1.0),
            ("v_mmps=a", 1e-3),
            ("v_cmps=a", 1e-2),
            ("v=a_mmps", 1e-3),
            ("v=Speed (km/h)", 1.0 / 3.6),
            ("omega_degps=a", std::f64::consts::PI / 180.0),
        ] {
            let mapped: MappedColumn = mapping.parse().expect(mapping);
            assert_eq!(mapped.factor, factor, "{mapping}");
        }
        let constant: MappedColumn = "voltage_V:=3.0".parse().expect("a constant");
        let map = ColumnMap::from(vec![constant]);
        assert_eq!(map.constant(of(Column::Voltage)), Some(("3.0", 1e3)));
        assert!(map.positions(of(Column::Voltage), &["voltage_mV".to_owned()]).is_empty());
        for wrong in [
            "power",
            "=a",
            "power=",
            "speed=a",
            "power_hp=a",
            "voltage_V:=3,0",
            "time:=1",
            "energy_mWh=a",
        ] {
            assert!(wrong.parse::<MappedColumn>().is_err(), "{wrong}");
        }
    }
}
