//! The columns of a text, by its header and first rows, and what a row says.

use std::path::Path;

use csv::ByteRecord;
use joulebus_plausibility::moment::{self, TimeForm};
use joulebus_plausibility::{Field, PowerOf, Said, charging_of_text};

use super::error::{Fault, TrialError};
use super::names::{ColumnMap, Found, Quantity, Term, accepted, is_bare, unit_factor};
use super::numbers::{Numbers, is_missing, with_unit};
use super::table::{Cell, Column, SourceColumn, Table, Tables, check_value};
use super::times::{TimeColumns, Times};

enum Expression {
    Position(usize),
    /// The same, where each value has its own unit behind it.
    WithUnit(usize),
    Constant(f64),
    Sum(Vec<Term>),
}

/// A column of the table: where its value is, and the factor to the unit of the layout.
struct Wanted {
    column: Column,
    source: Expression,
    factor: f64,
    name: String,
}

pub(super) struct Row {
    robot: String,
    time: f64,
    values: [f64; Column::ALL.len()],
    on_charger: bool,
}

/// Position of each column of the table in a row.
pub(super) struct Layout {
    fields: usize,
    /// True if the header ends with a separator.
    ends_empty: bool,
    robot: Option<usize>,
    robot_name: Option<String>,
    time: TimeColumns,
    pub(super) time_name: String,
    pub(super) day_first: Option<bool>,
    columns: Vec<Wanted>,
    /// Columns with the velocities across those of the table.
    across: Vec<(Field, Wanted)>,
    /// Position of what says whether the battery charges, and whether numbers in it are those of
    /// ROS's `power_supply_status`.
    charging: Option<(usize, bool)>,
    by_product: bool,
    missing: Vec<f64>,
    /// The map as it applies to this file.
    map: ColumnMap,
    sources: Vec<SourceColumn>,
    pub(super) ignored_columns: Vec<String>,
    apart: Option<String>,
}

/// A header that has not what a trial needs: whether it lacks the time, and power, if it is that.
pub(super) struct Lacking {
    pub(super) error: TrialError,
    pub(super) lacks: Option<[bool; 2]>,
}

impl From<TrialError> for Lacking {
    fn from(error: TrialError) -> Self {
        Self { error, lacks: None }
    }
}

fn begun(names: &[String]) -> String {
    names.join(", ").chars().take(400).collect()
}

/// Fields of the columns of which [`Said`] decides.
const SAID: [(Column, Field); 8] = [
    (Column::V, Field::V),
    (Column::Omega, Field::Omega),
    (Column::VMeasured, Field::VMeasured),
    (Column::OmegaMeasured, Field::OmegaMeasured),
    (Column::Power, Field::Power),
    (Column::Voltage, Field::Voltage),
    (Column::Current, Field::Current),
    (Column::Soc, Field::Soc),
];

/// What a row of a table in mV, mA and mW says of these values.
pub(super) fn said(values: &[f64; Column::ALL.len()], by_product: bool) -> Said {
    let mut said = Said { product_units: 1e3, ..Said::default() };
    said.product_of = by_product.then_some(PowerOf::Battery);
    for (column, field) in SAID {
        said.set(field, values[column as usize]);
    }
    said
}

/// The values of a row, from what is known.
pub(super) fn mapped(values: &mut [f64; Column::ALL.len()], said: Said) {
    // What is not finite was refused, and a charge out of range is judged.
    let seen = said.map(|_, _| {}).seen;
    for (column, value) in [
        (Column::V, seen.v_mps),
        (Column::Omega, seen.omega_radps),
        (Column::VMeasured, seen.v_measured_mps),
        (Column::OmegaMeasured, seen.omega_measured_radps),
        (Column::Power, seen.power_w),
        (Column::Voltage, seen.voltage_v),
        (Column::Current, seen.current_a),
        (Column::Soc, seen.soc),
    ] {
        values[column as usize] = value;
    }
}

impl Layout {
    /// Finds the columns that a trial needs. `sample`: the first rows.
    pub(super) fn find(
        path: &Path,
        header: &ByteRecord,
        sample: &[ByteRecord],
        map: &ColumnMap,
    ) -> Result<Self, Lacking> {
        let names = header
            .iter()
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect::<Vec<_>>();
        if !names.is_empty() && names.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(Lacking::from(TrialError::new(
                path,
                Fault::NoHeader,
                format!(
                    "the first line has no names, but {}. Put a line with the names of the columns \
                     in front, such as timestamp_s,voltage_V,current_A (`ros2 topic echo --csv` \
                     writes none)",
                    begun(&names)
                ),
            )));
        }
        let map = map.of_file(&names);
        let pairs = map.time_pairs(&names);
        let absent = map.named().filter(|(quantity, name)| {
            let is_pair = *quantity == Quantity::Time && !pairs.is_empty();
            let is_there = names.iter().any(|found| found == name);
            !is_pair && !is_there && map.sum(*quantity, &names).is_none()
        });
        let absent: Vec<String> =
            absent.map(|(quantity, name)| format!("{quantity}={name}")).collect();
        let lacking = |missing: String, lacks| {
            let what = format!("no column for {missing}, found {}", begun(&names));
            let error = TrialError::new(path, Fault::MissingColumns, what);
            Lacking { error, lacks: Some(lacks) }
        };
        if !absent.is_empty() {
            return Err(lacking(format!("mapped: {}", absent.join(", ")), [true; 2]));
        }
        let twice = |first: usize, second: usize| {
            let what = format!(
                "columns {} and {} are synonyms. Keep one, or name it with --map",
                names[first], names[second]
            );
            TrialError::new(path, Fault::DuplicateColumn, what)
        };
        let mut used = vec![false; names.len()];
        let mut find = |quantity| match map.positions(quantity, &names).as_slice() {
            [] => Ok(None),
            [one] => {
                used[one.position] = true;
                Ok(Some(*one))
            }
            [first, second, ..] => Err(twice(first.position, second.position)),
        };
        let robot = find(Quantity::Robot)?.map(|found| found.position);
        let (mut columns, mut sources, mut across) = (Vec::new(), Vec::new(), Vec::new());
        let mut also_used = Vec::new();
        for column in Column::ALL {
            let quantity = Quantity::Column(column);
            let constant = map.constant(quantity);
            let constant =
                constant.and_then(|(text, factor)| Some((text, text.parse().ok()?, factor)));
            let found = find(quantity)?;
            let has_units = |position: &usize| is_with_units(sample, *position, column);
            let bare = || {
                let mut bare = (0..names.len()).filter(|at| is_bare(column, &names[*at]));
                bare.next().filter(|_| bare.next().is_none() && !map.maps(quantity))
            };
            let (source, factor, name, states_unit) = match (constant, map.sum(quantity, &names)) {
                (Some((text, value, factor)), _) => {
                    (Expression::Constant(value), factor, text.to_owned(), true)
                }
                (None, Some((terms, factor, text))) => (Expression::Sum(terms), factor, text, true),
                (None, None) => {
                    let unstated = found.filter(|one| !one.states_unit).map(|one| one.position);
                    let by_unit = unstated.or(if found.is_none() { bare() } else { None });
                    match (by_unit.filter(has_units), found) {
                        (Some(position), _) => {
                            (Expression::WithUnit(position), 1.0, names[position].clone(), true)
                        }
                        (None, Some(found)) => {
                            let name = names[found.position].clone();
                            let position = Expression::Position(found.position);
                            (position, found.factor, name, found.states_unit)
                        }
                        (None, None) => continue,
                    }
                }
            };
            let positions: Vec<usize> = match &source {
                Expression::Position(position) | Expression::WithUnit(position) => vec![*position],
                Expression::Constant(_) => Vec::new(),
                Expression::Sum(terms) => {
                    terms.iter().flat_map(|term| term.factors.clone()).collect()
                }
            };
            let of_across = match column {
                Column::V => Some(Field::Vy),
                Column::VMeasured => Some(Field::VyMeasured),
                _ => None,
            };
            if let (Some(field), [position]) = (of_across, &*positions)
                && let Some(at) = across_of(&names, *position)
            {
                let source = match source {
                    Expression::WithUnit(_) => Expression::WithUnit(at),
                    _ => Expression::Position(at),
                };
                across.push((field, Wanted { column, source, factor, name: names[at].clone() }));
                also_used.push(at);
            }
            also_used.extend(positions);
            columns.push(Wanted { column, source, factor, name: name.clone() });
            sources.push(SourceColumn { column, name, states_unit, is_mapped: map.maps(quantity) });
        }
        for position in also_used {
            used[position] = true;
        }
        let charging = charging_column(&names);
        let in_pairs = |position: usize| {
            let mut pairs = pairs.iter();
            pairs.any(|(seconds, nanoseconds, _)| [*seconds, *nanoseconds].contains(&position))
        };
        let alone = map.positions(Quantity::Time, &names);
        let alone: Vec<Found> =
            alone.into_iter().filter(|found| !in_pairs(found.position)).collect();
        let texts = |position: usize| {
            sample.iter().filter_map(move |row| std::str::from_utf8(row.get(position)?).ok())
        };
        let (time, time_name) = match (alone.as_slice(), pairs.as_slice()) {
            ([one], _) => {
                let name = names[one.position].clone();
                (Some(time_column(*one, &names, sample, &map)), name)
            }
            ([], [(seconds, nanoseconds, _)]) => {
                (Some(TimeColumns::Pair(*seconds, *nanoseconds)), names[*seconds].clone())
            }
            ([], []) => {
                let index = index_with_times(&names, sample);
                (index.map(TimeColumns::One), "the first column".to_owned())
            }
            ([first, second, ..], _) => {
                return Err(twice(first.position, second.position).into());
            }
            ([], [(first, ..), (second, ..), ..]) => return Err(twice(*first, *second).into()),
        };
        let mut day_first = None;
        match &time {
            Some(TimeColumns::One(Found { position, .. }) | TimeColumns::Split(position)) => {
                used[*position] = true;
                day_first = moment::day_first(texts(*position));
            }
            Some(TimeColumns::Pair(first, second) | TimeColumns::Dated(first, second)) => {
                (used[*first], used[*second]) = (true, true);
                day_first = moment::day_first(texts(*first));
            }
            None => {}
        }
        if let Some((position, _)) = charging {
            used[position] = true;
        }
        let has = |wanted| columns.iter().any(|one: &Wanted| one.column == wanted);
        // `v` beside `i`, and nothing else that shows that the robot moves, or what its voltage is.
        let speed = sources.iter().find(|one| one.column == Column::V && !one.is_mapped);
        if let Some(speed) = speed.filter(|one| one.name.eq_ignore_ascii_case("v"))
            && !has(Column::Voltage)
            && !has(Column::Omega)
        {
            let current = sources.iter().find(|one| one.column == Column::Current);
            let current = current.map(|one| one.name.as_str());
            let is_i = |name: &&String| {
                let name = name.to_lowercase();
                name == "i" || name.starts_with("i_") || name.starts_with("current")
            };
            let current = current.or(names.iter().find(is_i).map(String::as_str));
            if let Some(beside) = current {
                let column = &speed.name;
                let what = format!(
                    "column {column} beside {beside} can be a speed or a voltage. Name it: \
                     --map v_mps={column}, or --map voltage_V={column}"
                );
                return Err(TrialError::new(path, Fault::SpeedOrVoltage, what).into());
            }
        }
        let by_product = !has(Column::Power) && has(Column::Voltage) && has(Column::Current);
        let lack = [time.is_none(), !has(Column::Power) && !by_product];
        let Some(time) = time.filter(|_| !lack[1]) else {
            let power = accepted(Quantity::Column(Column::Power));
            let power = format!("{power}, or voltage and current");
            let missing = [accepted(Quantity::Time), power].into_iter().zip(lack);
            let missing: Vec<String> =
                missing.filter_map(|(name, is_missing)| is_missing.then_some(name)).collect();
            return Err(lacking(missing.join(" and "), lack));
        };
        // An index that a program wrote in front of the table is no column that anybody misses.
        let is_index = |at: usize, name: &str| name.is_empty() || (at == 0 && name == "Unnamed: 0");
        let ignored: Vec<usize> =
            (0..names.len()).filter(|at| !used[*at] && !is_index(*at, &names[*at])).collect();
        let apart = ignored.iter().find(|at| robot.is_none() && alternates(sample, **at));
        let is_split = matches!(time, TimeColumns::Split(_));
        Ok(Self {
            fields: names.len() + usize::from(is_split),
            ends_empty: names.last().is_some_and(String::is_empty),
            robot,
            robot_name: map.constant(Quantity::Robot).map(|(name, _)| name.to_owned()),
            time,
            time_name,
            day_first,
            columns,
            across,
            charging,
            by_product,
            missing: map.missing(),
            map,
            sources,
            apart: apart.map(|at| names[*at].clone()),
            ignored_columns: ignored.iter().map(|at| names[*at].clone()).collect(),
        })
    }

    /// True if the robot's name is the first field.
    pub(super) fn begins_with_robot(&self) -> bool {
        self.robot == Some(0)
    }

    /// What a row says, or why it is none.
    pub(super) fn row(
        &self,
        cell: Cell<'_>,
        record: &ByteRecord,
        numbers: &mut Numbers,
        times: &mut Times,
    ) -> Result<Row, TrialError> {
        let fields = match record.len() {
            // A separator at the end of the rows or of the header alone.
            found if found == self.fields + 1 && record.iter().next_back() == Some(b"") => {
                self.fields
            }
            found if found + 1 == self.fields && self.ends_empty => self.fields,
            found => found,
        };
        if fields != self.fields {
            let what = format!("found {fields} fields, the header has {}", self.fields);
            return Err(TrialError::new(cell.path, Fault::FieldCount, what).in_row(cell.row));
        }
        let field = |position: usize| {
            let is_behind = matches!(self.time, TimeColumns::Split(time) if position > time);
            record.get(position + usize::from(is_behind)).unwrap_or_default()
        };
        let mut values = [f64::NAN; Column::ALL.len()];
        let mut soc_unit = 1.0;
        for wanted in &self.columns {
            let (value, factor) = self.value(cell, wanted, field, numbers)?;
            let is_soc = wanted.column == Column::Soc;
            check_value(cell, &wanted.name, wanted.column, wanted.column.si(value * factor))?;
            values[wanted.column as usize] = if is_soc { value } else { value * factor };
            if is_soc {
                soc_unit = factor;
            }
        }
        let mut said = Said { soc_unit, ..said(&values, self.by_product) };
        for (across, wanted) in &self.across {
            let (value, factor) = self.value(cell, wanted, field, numbers)?;
            check_value(cell, &wanted.name, wanted.column, value * factor)?;
            said.set(*across, value * factor);
        }
        let time = times.take(cell, (self.time, &self.time_name), record, numbers)?;
        let robot = match (&self.robot_name, self.robot) {
            (Some(name), _) => name.clone(),
            (None, Some(position)) => robot_name(field(position)),
            (None, None) => String::new(),
        };
        if self.by_product {
            let of = |column: Column| values[column as usize];
            let power_mw = of(Column::Voltage) * of(Column::Current) / 1e3;
            let power = Column::Power;
            check_value(cell, power.name(), power, power.si(power_mw))?;
        }
        mapped(&mut values, said);
        let charging = self.charging.and_then(|(position, is_status)| {
            charging_of_text(std::str::from_utf8(field(position)).ok()?, is_status)
        });
        // Whether the meter is the battery's or the robot's is not known.
        let on_charger = charging == Some(true);
        if on_charger {
            values[Column::Power as usize] = f64::NAN;
        }
        Ok(Row { robot, time, values, on_charger })
    }

    /// A value as its field has it, and the factor to the unit of the layout.
    fn value<'r>(
        &self,
        cell: Cell<'_>,
        wanted: &Wanted,
        field: impl Fn(usize) -> &'r [u8],
        numbers: &mut Numbers,
    ) -> Result<(f64, f64), TrialError> {
        let Wanted { column, source, factor, name } = wanted;
        let mut read = |position: usize, has_unit: bool| {
            let text = field(position);
            let parsed = numbers.parse(text).map(|number| (number, *factor));
            let parsed = match parsed {
                Ok((number, _)) if has_unit && !number.is_nan() => {
                    Err("a number with its unit, as in the other rows")
                }
                Err(allowed) => with_unit(text)
                    .and_then(|(bare, unit)| Some((bare, unit_factor(*column, unit)?)))
                    // `96%` is that, whatever the name of the column is.
                    .filter(|(_, of_unit)| {
                        has_unit || *column == Column::Soc || *of_unit == factor.abs()
                    })
                    .ok_or(allowed)
                    .and_then(|(bare, of_unit)| {
                        Ok((numbers.parse(bare)?, of_unit * factor.signum()))
                    }),
                parsed => parsed,
            };
            let (number, factor) = parsed.map_err(|allowed| {
                let found = String::from_utf8_lossy(text);
                cell.refuse(name, found.chars().take(60).collect::<String>(), allowed)
            })?;
            let is_unknown = self.missing.contains(&number);
            Ok((if is_unknown { f64::NAN } else { number }, factor))
        };
        match source {
            Expression::Constant(value) => Ok((*value, *factor)),
            Expression::Position(position) => read(*position, false),
            Expression::WithUnit(position) => read(*position, true),
            Expression::Sum(terms) => {
                let mut sum = 0.0;
                for Term { sign, factors } in terms {
                    let mut product = *sign;
                    for position in factors {
                        product *= read(*position, false)?.0;
                    }
                    sum += product;
                }
                Ok((sum, *factor))
            }
        }
    }

    pub(super) fn push(
        &self,
        cell: Cell<'_>,
        row: &Row,
        tables: &mut Tables,
    ) -> Result<(), TrialError> {
        let table = tables.of(cell, &row.robot)?;
        table.push_any_time(cell, row.time)?;
        if row.on_charger {
            table.on_charger.push(cell.row as u32);
        }
        let read = self.columns.iter().map(|wanted| wanted.column);
        for column in read.chain(self.by_product.then_some(Column::Power)) {
            table.push_checked(column, row.values[column as usize]);
        }
        Ok(())
    }

    /// Adds what tables state of their text.
    pub(super) fn finish(&self, tables: &mut [Table], times: &Times, understood: &mut Vec<String>) {
        for table in tables.iter_mut() {
            let joined = table.join_sparse(self.by_product);
            let turned = table.oldest_first().then(|| {
                "its rows are newest first: they are read from the last to the first".to_owned()
            });
            for note in joined.into_iter().chain(turned) {
                if !understood.contains(&note) {
                    understood.push(note);
                }
            }
            table.sources.clone_from(&self.sources);
            table.apart.clone_from(&self.apart);
            let is_number = times.form == Some(TimeForm::Number);
            table.time_name = is_number.then(|| self.time_name.clone());
            table.states_time_unit = match &self.time {
                TimeColumns::One(found) => found.states_unit || times.is_epoch,
                _ => true,
            };
        }
        self.map.turn_as_configured(tables);
    }
}

/// Most words of a column that tells sources apart, rows before they count, and the share of rows
/// in which the word changes.
const MAX_SOURCES: usize = 8;
const MIN_ALTERNATING: usize = 20;
const MOST_ALTERNATE: f64 = 0.8;

/// True for a column of few words or ids by which rows alternate.
pub(super) fn alternates(sample: &[ByteRecord], position: usize) -> bool {
    let words: Vec<&[u8]> = sample.iter().filter_map(|row| row.get(position)).collect();
    let is_id = |word: &&[u8]| {
        !is_missing(word) && !word.contains(&b'.') && !word.contains(&b',') && !word.contains(&b':')
    };
    let mut kinds = words.clone();
    kinds.sort_unstable();
    kinds.dedup();
    let changes = words.windows(2).filter(|pair| pair[0] != pair[1]).count();
    words.len() >= MIN_ALTERNATING
        && words.iter().all(is_id)
        && (2..=MAX_SOURCES).contains(&kinds.len())
        && changes as f64 >= MOST_ALTERNATE * words.len() as f64
}

/// The column with the part across that of a velocity along: `vy_mmps` beside `vx_mmps`.
fn across_of(names: &[String], along: usize) -> Option<usize> {
    let name = &names[along];
    name.rmatch_indices(['x', 'X']).find_map(|(at, letter)| {
        let letter = if letter == "x" { "y" } else { "Y" };
        let across = [&name[..at], letter, &name[at + 1..]].concat();
        names.iter().position(|other| *other == across)
    })
}

/// True if the values of a column have units behind them.
fn is_with_units(sample: &[ByteRecord], position: usize, column: Column) -> bool {
    let mut known =
        sample.iter().filter_map(|row| row.get(position)).filter(|text| !is_missing(text));
    let has_unit =
        |text: &[u8]| with_unit(text).is_some_and(|(_, unit)| unit_factor(column, unit).is_some());
    known.next().is_some_and(has_unit) && known.all(has_unit)
}

/// How the time is read whose column was found: with the date of another one, or with the fraction
/// behind its comma.
fn time_column(
    found: Found,
    names: &[String],
    sample: &[ByteRecord],
    map: &ColumnMap,
) -> TimeColumns {
    let text = |row: &ByteRecord, at: usize| {
        row.get(at).and_then(|field| std::str::from_utf8(field).ok()).unwrap_or_default().to_owned()
    };
    let Some(first) = sample.first() else {
        return TimeColumns::One(found);
    };
    let position = found.position;
    let form = |text: &str| moment::parse(text, None).map(|(form, _)| form);
    if form(&text(first, position)) == Some(TimeForm::Clock) {
        let is_free = |at: usize| at != position && !map.named().any(|(_, name)| name == names[at]);
        let dates = |at: &usize| {
            let day_first = moment::day_first(
                sample.iter().filter_map(|row| std::str::from_utf8(row.get(*at)?).ok()),
            );
            is_free(*at) && sample.iter().all(|row| moment::is_date(&text(row, *at), day_first))
        };
        return match (0..names.len()).find(dates) {
            Some(date) => TimeColumns::Dated(date, position),
            None => TimeColumns::One(found),
        };
    }
    let is_split = |row: &ByteRecord| {
        let fraction = text(row, position + 1);
        let is_fraction = matches!(fraction.len(), 3 | 6 | 9);
        row.len() == names.len() + 1
            && is_fraction
            && fraction.bytes().all(|byte| byte.is_ascii_digit())
            && form(&text(row, position)) == Some(TimeForm::Date)
    };
    match sample.iter().all(is_split) {
        true => TimeColumns::Split(position),
        false => TimeColumns::One(found),
    }
}

/// The column that says whether the battery charges, and whether it is a `power_supply_status`.
fn charging_column(names: &[String]) -> Option<(usize, bool)> {
    let words = |name: &str| {
        let words = name.split(|letter: char| !letter.is_alphanumeric());
        words.filter(|word| !word.is_empty()).map(str::to_lowercase).collect::<Vec<_>>()
    };
    let is_last = |name: &str, last: &str| {
        let name = format!("_{}", words(name).join("_"));
        name.ends_with(&format!("_{last}"))
    };
    let status = names.iter().position(|name| is_last(name, "power_supply_status"));
    let says = |name: &String| is_last(name, "charging") || is_last(name, "on_charger");
    let is_status = status.map(|position| (position, true));
    is_status.or_else(|| names.iter().position(says).map(|position| (position, false)))
}

/// A robot's name. A whole number that a program wrote with a fraction is the number.
fn robot_name(field: &[u8]) -> String {
    if is_missing(field) {
        return String::new();
    }
    let name = String::from_utf8_lossy(field);
    let whole = name.split_once('.').filter(|(whole, fraction)| {
        let digits =
            |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        digits(whole) && fraction.bytes().all(|byte| byte == b'0')
    });
    whole.map_or(&*name, |(whole, _)| whole).to_owned()
}

/// A first column without a name that has times as text: pandas' index.
fn index_with_times(names: &[String], sample: &[ByteRecord]) -> Option<Found> {
    let is_index = matches!(names.first()?.as_str(), "" | "Unnamed: 0" | "index");
    let first = std::str::from_utf8(sample.first()?.get(0)?).ok()?;
    let found = Found { position: 0, factor: 1.0, states_unit: true };
    (is_index && moment::parse(first, None).is_some()).then_some(found)
}
