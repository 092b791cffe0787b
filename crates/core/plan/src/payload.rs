//! Questions and replies as payloads in shared memory and in recordings.

use joulebus_energy::{Outside, Quantity};
use joulebus_wire::{
    Acknowledgement, Alarm, AnswerHeader, AnswerRow, InvalidReason, MAX_ANSWER_WORDS,
    MAX_NAME_BYTES, MAX_QUERY_CANDIDATES, MAX_QUERY_ROBOTS, MAX_QUERY_VALUES, QueryHeader,
    QueryKind, QueryRefusal, ROW_WORDS, SCHEMA_VERSION, Statement, answer_flag, answer_parts,
    query_flag,
};

use crate::answer::{Answer, Caveats, Doubts, Left, Limits, Range, Unknown, Verdict};
use crate::error::{QuestionError, Refused};
use crate::path::{Path, Point};
use crate::question::{Plan, Question, Reply, Row};

/// Words that state what of a row lies outside the training data.
const REASON_WORDS: usize = 3;
/// Values of a point of a path.
const POINT_VALUES: usize = 3;

impl Question {
    /// Encodes it as a header and values, for the fleet whose name has this hash
    /// ([`joulebus_wire::fnv1a`]).
    ///
    /// # Errors
    /// More robots, candidates or values than a message holds.
    pub fn encode(&self, fleet: u64) -> Result<(QueryHeader, Vec<f64>), Refused> {
        let ids = self.plan.robots();
        let mut values: Vec<f64> = ids.iter().copied().map(f64::from).collect();
        let mut header = QueryHeader {
            schema: SCHEMA_VERSION,
            fleet,
            robots: count(ids.len()),
            coverage: self.coverage,
            flags: flag(self.power, query_flag::POWER),
            ..QueryHeader::default()
        };
        match &self.plan {
            Plan::WhatIf { candidates, period_s, v_mps, omega_radps, .. } => {
                let columns = v_mps.iter().zip(omega_radps);
                values.extend(columns.flat_map(|(v, omega)| [f64::from(*v), f64::from(*omega)]));
                let steps = v_mps.len().checked_div(*candidates).unwrap_or(0);
                header.kind = QueryKind::WhatIf.code();
                (header.candidates, header.steps) = (count(*candidates), count(steps));
                header.period_s = *period_s;
            }
            Plan::Idle { duration_s, .. } => {
                header.kind = QueryKind::Idle.code();
                header.candidates = count(self.moments);
                header.duration_s = *duration_s;
            }
            Plan::Follow { path, back_to, .. } => {
                let points = path.points.iter().zip(&path.speed_mps);
                values.extend(points.flat_map(|(at, speed_mps)| [at.x_m, at.y_m, *speed_mps]));
                let columns = [
                    (&path.dwell_s, query_flag::DWELL),
                    (&path.load_w, query_flag::LOAD),
                    (&path.time_s, query_flag::TIMES),
                ];
                for (column, given) in columns {
                    header.flags |= flag(!column.is_empty(), given);
                    values.extend(column);
                }
                header.flags |= flag(path.tolerance_m.is_some(), query_flag::TOLERANCE);
                header.tolerance_m = path.tolerance_m.unwrap_or(0.0);
                header.kind = QueryKind::Follow.code();
                header.candidates = count(self.moments);
                header.steps = count(path.points.len());
                header.flags |= flag(back_to.is_some(), query_flag::RETURN)
                    | flag(path.heading_rad.is_some(), query_flag::HEADING);
                let back_to = back_to.unwrap_or(Point::new(0.0, 0.0));
                (header.return_x_m, header.return_y_m) = (back_to.x_m, back_to.y_m);
                header.heading_rad = path.heading_rad.unwrap_or(0.0);
            }
        }
        expected_values(&header, values.len())?;
        Ok((header, values))
    }

    /// Decodes an untrusted header and values.
    ///
    /// # Errors
    /// [`Refused`], with the reason. Values that the robots' platforms do not allow are found when
    /// the question is answered.
    pub fn decode(header: &QueryHeader, values: &[f64], fleet: u64) -> Result<Self, Refused> {
        check(header, fleet)?;
        let ids = expected_values(header, values.len())?;
        let (ids, values) = values.split_at(ids);
        let robots = ids.iter().map(|id| robot(*id)).collect::<Result<Vec<u32>, _>>()?;
        Ok(Self {
            plan: plan(header, robots, values)?,
            coverage: header.coverage,
            power: header.flags & query_flag::POWER != 0,
            moments: match kind(header)? {
                QueryKind::Idle | QueryKind::Follow => header.candidates as usize,
                QueryKind::WhatIf | QueryKind::Acknowledge | QueryKind::Battery => 0,
            },
        })
    }
}

/// Encodes that the person `by` acknowledges an alarm, also as the robot's new normal, for the
/// fleet whose name has this hash.
///
/// # Errors
/// [`Acknowledgement::new`] states which names are allowed, and [`Alarm::is_of_level`] which alarms
/// can be the new normal.
pub fn encode_acknowledgement(
    robot: u32,
    alarm: Alarm,
    by: &str,
    new_normal: bool,
    fleet: u64,
) -> Result<(QueryHeader, Vec<f64>), Refused> {
    check_new_normal(alarm, new_normal)?;
    let (mut header, values) =
        stated(QueryKind::Acknowledge, &[robot.into(), alarm.code().into()], by, fleet)?;
    header.flags = flag(new_normal, query_flag::NEW_NORMAL);
    Ok((header, values))
}

/// Encodes what the person `by` states of a robot's battery, for the fleet whose name has this
/// hash.
///
/// # Errors
/// [`Acknowledgement::new`] states which names are allowed, and [`Statement`] which charge is.
pub fn encode_statement(
    robot: u32,
    statement: Statement,
    by: &str,
    fleet: u64,
) -> Result<(QueryHeader, Vec<f64>), Refused> {
    let (code, value) = statement.encode();
    battery_statement(code.into(), value.into())?;
    stated(QueryKind::Battery, &[robot.into(), code.into(), value.into()], by, fleet)
}

/// A question that is none: values, and then the characters of a person's name.
fn stated(
    kind: QueryKind,
    values: &[f64],
    by: &str,
    fleet: u64,
) -> Result<(QueryHeader, Vec<f64>), Refused> {
    if Acknowledgement::new(0, Alarm::NoData, 0, by).is_none() {
        return Err(no_name(by));
    }
    let name = by.chars().map(|letter| f64::from(u32::from(letter)));
    let mut values = values.to_vec();
    let before = values.len();
    values.extend(name);
    let header = QueryHeader {
        schema: SCHEMA_VERSION,
        fleet,
        kind: kind.code(),
        robots: 1,
        steps: count(values.len() - before),
        ..QueryHeader::default()
    };
    Ok((header, values))
}

/// Decodes an untrusted header and values as the acknowledgement of an alarm, taken at `at_ns`.
///
/// # Errors
/// [`Refused`], with the reason. Whether the alarm is raised is found later.
pub fn decode_acknowledgement(
    header: &QueryHeader,
    values: &[f64],
    fleet: u64,
    at_ns: u64,
) -> Result<Acknowledgement, Refused> {
    check(header, fleet)?;
    expected_values(header, values.len())?;
    let (id, code) = (robot(values[0])?, values[1]);
    let is_code = |alarm: &Alarm| f64::from(alarm.code()) == code;
    let alarm = Alarm::ALL.into_iter().find(is_code).ok_or_else(|| {
        let text = format!("{code} is no code of an alarm of a robot");
        Refused::new(QueryRefusal::Question, text)
    })?;
    check_new_normal(alarm, header.flags & query_flag::NEW_NORMAL != 0)?;
    let name = name(&values[2..]);
    Acknowledgement::new(id, alarm, at_ns, &name).ok_or_else(|| no_name(&name))
}

/// Decodes an untrusted header and values as what a person states of a robot's battery: the robot,
/// the statement, and by whom.
///
/// # Errors
/// [`Refused`], with the reason. Whether the robot has a battery is found later.
pub fn decode_statement(
    header: &QueryHeader,
    values: &[f64],
    fleet: u64,
) -> Result<(u32, Statement, String), Refused> {
    check(header, fleet)?;
    expected_values(header, values.len())?;
    let (id, name) = (robot(values[0])?, name(&values[3..]));
    let statement = battery_statement(values[1], values[2])?;
    if Acknowledgement::new(id, Alarm::NoData, 0, &name).is_none() {
        return Err(no_name(&name));
    }
    Ok((id, statement, name))
}

fn battery_statement(code: f64, value: f64) -> Result<Statement, Refused> {
    let decoded = Statement::decode(code as u32, value as f32);
    let known = decoded.filter(|known| known.is_of_battery() && f64::from(code as u32) == code);
    known.ok_or_else(|| {
        let text = match code == 1.0 {
            true => format!("a state of charge of {value}: allowed are 0 to 1"),
            false => format!(
                "{code} is no statement of a battery, allowed: 1 with a state of charge, 2 full, \
                 3 exchanged"
            ),
        };
        Refused::new(QueryRefusal::Question, text)
    })
}

fn name(values: &[f64]) -> String {
    let letters = values.iter().map(|value| value_as_char(*value));
    letters.map(|found| found.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

/// Refuses an alarm that does not compare a robot with its own level.
fn check_new_normal(alarm: Alarm, new_normal: bool) -> Result<(), Refused> {
    if new_normal && !alarm.is_of_level() {
        let of_level = Alarm::ALL.into_iter().filter(|alarm| alarm.is_of_level());
        let allowed: Vec<&str> = of_level.map(Alarm::name).collect();
        let text = format!(
            "{} cannot be the new normal, allowed: {}. Acknowledge it without that",
            alarm.name(),
            allowed.join(", ")
        );
        return Err(Refused::new(QueryRefusal::Question, text));
    }
    Ok(())
}

fn value_as_char(value: f64) -> Option<char> {
    let code = value as u32;
    char::from_u32(code).filter(|_| f64::from(code) == value)
}

fn no_name(found: &str) -> Refused {
    let text = format!(
        "{found:?} is no name: allowed are 1 to {MAX_NAME_BYTES} bytes without control characters"
    );
    Refused::new(QueryRefusal::Question, text)
}

/// Checks what a header is written for.
fn check(header: &QueryHeader, fleet: u64) -> Result<(), Refused> {
    if header.schema != SCHEMA_VERSION {
        let (found, allowed) = (header.schema, SCHEMA_VERSION);
        let text = format!("payloads of version {found}: this worker reads {allowed}");
        return Err(Refused::new(QueryRefusal::Schema, text));
    }
    if header.fleet != fleet {
        let text = format!(
            "asked of the fleet whose name has hash {:016x}: this one has {fleet:016x}",
            header.fleet
        );
        return Err(Refused::new(QueryRefusal::Fleet, text));
    }
    Ok(())
}

fn plan(header: &QueryHeader, robots: Vec<u32>, values: &[f64]) -> Result<Plan, Refused> {
    let has = |flag| header.flags & flag != 0;
    Ok(match kind(header)? {
        QueryKind::WhatIf => Plan::WhatIf {
            robot: robots[0],
            candidates: header.candidates as usize,
            period_s: header.period_s,
            v_mps: values.iter().step_by(2).map(|v| *v as f32).collect(),
            omega_radps: values.iter().skip(1).step_by(2).map(|omega| *omega as f32).collect(),
        },
        QueryKind::Idle => Plan::Idle { robots, duration_s: header.duration_s },
        QueryKind::Follow => {
            let (points, mut columns) =
                values.split_at((POINT_VALUES * header.steps as usize).min(values.len()));
            let mut column = |given| {
                let length = if has(given) { header.steps as usize } else { 0 };
                let (column, others) = columns.split_at(length.min(columns.len()));
                columns = others;
                column.to_vec()
            };
            let points = points.chunks_exact(POINT_VALUES);
            Plan::Follow {
                robots,
                path: Path {
                    points: points.clone().map(|at| Point::new(at[0], at[1])).collect(),
                    speed_mps: points.map(|at| at[2]).collect(),
                    heading_rad: has(query_flag::HEADING).then_some(header.heading_rad),
                    dwell_s: column(query_flag::DWELL),
                    load_w: column(query_flag::LOAD),
                    time_s: column(query_flag::TIMES),
                    tolerance_m: has(query_flag::TOLERANCE).then_some(header.tolerance_m),
                },
                back_to: has(query_flag::RETURN)
                    .then_some(Point::new(header.return_x_m, header.return_y_m)),
            }
        }
        QueryKind::Acknowledge | QueryKind::Battery => {
            let text = "a person's statement is no question about a plan".to_owned();
            return Err(Refused::new(QueryRefusal::Kind, text));
        }
    })
}

fn kind(header: &QueryHeader) -> Result<QueryKind, Refused> {
    let allowed = |kind: &QueryKind| match kind {
        QueryKind::Acknowledge => query_flag::NEW_NORMAL,
        QueryKind::Battery => 0,
        QueryKind::WhatIf | QueryKind::Idle => query_flag::ALL & !query_flag::OF_PATH,
        QueryKind::Follow => query_flag::ALL,
    };
    let known = QueryKind::decode(header.kind).filter(|kind| header.flags & !allowed(kind) == 0);
    known.ok_or_else(|| {
        let (kind, flags) = (header.kind, header.flags);
        let text = format!("kind {kind}, flags {flags:#x}: one of them is unknown");
        Refused::new(QueryRefusal::Kind, text)
    })
}

/// Checks counts and length. Returns the number of ids among the values.
fn expected_values(header: &QueryHeader, found: usize) -> Result<usize, Refused> {
    let kind = kind(header)?;
    let counts = [header.robots, header.candidates, header.steps].map(|count| count as usize);
    let [robots, candidates, steps] = counts;
    let max_robots = match kind {
        QueryKind::WhatIf | QueryKind::Acknowledge | QueryKind::Battery => 1,
        QueryKind::Idle | QueryKind::Follow => MAX_QUERY_ROBOTS,
    };
    for (name, found, allowed) in [
        ("robots", robots, max_robots),
        ("candidates", candidates, MAX_QUERY_CANDIDATES),
        ("steps or points", steps, MAX_QUERY_VALUES),
        ("values", found, MAX_QUERY_VALUES),
    ] {
        if found > allowed {
            let text = format!(
                "{found} {name}: the worker answers at most {allowed}. Ask in your own process \
                    instead"
            );
            return Err(Refused::new(QueryRefusal::TooLarge, text));
        }
    }
    let values = match kind {
        QueryKind::WhatIf => 2 * candidates * steps,
        QueryKind::Idle => 0,
        QueryKind::Follow => {
            let columns = [query_flag::DWELL, query_flag::LOAD, query_flag::TIMES];
            let given = columns.iter().filter(|given| header.flags & **given != 0).count();
            (POINT_VALUES + given) * steps
        }
        QueryKind::Acknowledge => 1 + steps,
        QueryKind::Battery => 2 + steps,
    };
    let expected = robots + values;
    if robots == 0 || found != expected {
        let text = format!(
            "{found} values: {expected} follow from {robots} robots, {candidates} candidates and {steps} \
             steps or points, and at least one robot is needed"
        );
        return Err(Refused::new(QueryRefusal::Length, text));
    }
    Ok(robots)
}

fn robot(id: f64) -> Result<u32, Refused> {
    let robot = id as u32;
    if f64::from(robot) == id {
        return Ok(robot);
    }
    let text = format!("{id} is no id of a robot");
    Err(Refused::new(QueryRefusal::UnknownRobot, text))
}

const fn flag(is_set: bool, flag: u32) -> u32 {
    if is_set { flag } else { 0 }
}

const fn row_flag(is_set: bool, flag: u16) -> u16 {
    if is_set { flag } else { 0 }
}

/// A count too large for its field is too large for the worker.
fn count(found: usize) -> u32 {
    u32::try_from(found).unwrap_or(u32::MAX)
}

impl Reply {
    /// Appends the rows, those along the plan, and powers to the words of an answer, and sets their
    /// counts. Powers that do not fit are left out. What lies outside the training data follows, some
    /// words for each row, if any row has it.
    pub fn encode(&self, header: &mut AnswerHeader, words: &mut Vec<u64>) {
        let rows: Vec<AnswerRow> = self.rows.iter().chain(&self.along).map(Row::encode).collect();
        header.rows = count(rows.len());
        words.extend_from_slice(bytemuck::cast_slice(&rows));
        let has_reasons = self.rows.iter().chain(&self.along).any(|row| {
            row.answer.caveats.outside.is_some() || !row.answer.caveats.limits.is_empty()
        });
        let reasons = if has_reasons { REASON_WORDS * rows.len() } else { 0 };
        let used = words.len() + reasons;
        let fits = used + self.power_w.len().div_ceil(2) <= MAX_ANSWER_WORDS;
        let power_w = if fits { &*self.power_w } else { &[] };
        header.powers = count(power_w.len());
        for pair in power_w.chunks(2) {
            let pair = [pair[0], pair.get(1).copied().unwrap_or(0.0)];
            words.push(bytemuck::cast(pair));
        }
        if has_reasons && used <= MAX_ANSWER_WORDS {
            let all = self.rows.iter().chain(&self.along);
            words.extend(all.flat_map(|row| reason_words(&row.answer.caveats)));
        }
    }

    /// Decodes the answer to a question with this number of moments.
    ///
    /// # Errors
    /// [`Refused`]: the worker did not answer, or the answer is of a newer version.
    pub fn decode(header: &AnswerHeader, words: &[u64], moments: usize) -> Result<Self, Refused> {
        if header.schema != SCHEMA_VERSION {
            let (found, allowed) = (header.schema, SCHEMA_VERSION);
            let text = format!("an answer of version {found}: this program reads {allowed}");
            return Err(Refused::new(QueryRefusal::Schema, text));
        }
        let (rows, power_w, text) = answer_parts(header, words);
        if header.refusal != 0 {
            let reason = QueryRefusal::decode(header.refusal).unwrap_or(QueryRefusal::Kind);
            return Err(Refused::new(reason, text.to_owned()));
        }
        let rows = rows.iter().map(Row::decode).collect::<Option<Vec<Row>>>();
        let mut rows = rows.ok_or_else(|| {
            let text = "an answer with a verdict of a newer version".to_owned();
            Refused::new(QueryRefusal::Schema, text)
        })?;
        let before = rows.len() * ROW_WORDS + power_w.len().div_ceil(2);
        let is_along = moments > 0 && rows.len() == 1 + moments;
        let mut along = if is_along { rows.split_off(1) } else { Vec::new() };
        let (reasons, _) = words.get(before..).unwrap_or_default().as_chunks::<REASON_WORDS>();
        // A worker of an earlier version tells none, or none of the parts.
        if reasons.len() >= rows.len() {
            for (row, reason) in rows.iter_mut().chain(&mut along).zip(reasons) {
                set_reason(&mut row.answer.caveats, reason);
            }
        }
        Ok(Self { rows, along, power_w: power_w.to_vec() })
    }
}

/// Code of the quantity (0 without) and bits of the limits, value and known range, speed.
fn reason_words(caveats: &Caveats) -> [u64; REASON_WORDS] {
    let outside = caveats.outside;
    let quantity = outside.and_then(|of| Quantity::ALL.iter().position(|one| *one == of.quantity));
    let code = quantity.map_or(0, |place| count(place + 1));
    let [lowest, highest] = outside.map_or([0.0; 2], |outside| outside.known);
    let value = outside.map_or(0.0, |outside| outside.value);
    let speed_mps = outside.and_then(|outside| outside.inside_at_mps).unwrap_or(f32::NAN);
    [
        bytemuck::cast([code, caveats.limits.bits()]),
        bytemuck::cast([value, lowest]),
        bytemuck::cast([highest, speed_mps]),
    ]
}

/// Reads [`reason_words`].
fn set_reason(caveats: &mut Caveats, words: &[u64; REASON_WORDS]) {
    let [code, limits]: [u32; 2] = bytemuck::cast(words[0]);
    let [value, lowest]: [f32; 2] = bytemuck::cast(words[1]);
    let [highest, speed_mps]: [f32; 2] = bytemuck::cast(words[2]);
    let place = (code as usize).checked_sub(1);
    caveats.limits = Limits::from_bits(limits);
    caveats.outside = place.and_then(|place| Quantity::ALL.get(place)).map(|quantity| Outside {
        quantity: *quantity,
        value,
        known: [lowest, highest],
        inside_at_mps: (speed_mps > 0.0).then_some(speed_mps),
    });
}

impl Refused {
    /// Appends the text to the words of an answer, and sets reason and length.
    pub fn encode(&self, header: &mut AnswerHeader, words: &mut Vec<u64>) {
        let most = 8 * MAX_ANSWER_WORDS;
        let text = self.text.get(..self.text.len().min(most)).unwrap_or_default();
        header.refusal = self.reason.code();
        header.text_bytes = count(text.len());
        let chunks = text.as_bytes().chunks(8);
        words.extend(chunks.map(|bytes| {
            let mut word = [0; 8];
            word[..bytes.len()].copy_from_slice(bytes);
            u64::from_ne_bytes(word)
        }));
    }
}

impl From<&QuestionError> for Refused {
    fn from(error: &QuestionError) -> Self {
        let reason = match error {
            QuestionError::UnknownRobot { .. } => QueryRefusal::UnknownRobot,
            QuestionError::Ask(_) => QueryRefusal::Question,
        };
        Self::new(reason, error.to_string())
    }
}

impl Row {
    /// The row in an answer's words, and in the memory of other languages.
    #[must_use]
    pub fn encode(&self) -> AnswerRow {
        let Answer {
            duration_s,
            energy,
            left,
            probability,
            margin_j,
            verdict,
            limiting_leg,
            caveats,
        } = self.answer;
        let (verdict, unknown, detail, age_ns) = verdict_codes(verdict);
        let unknown_detail = if has_detail(unknown) { detail } else { caveats.late_s };
        let flags = row_flag(energy.is_some(), answer_flag::ENERGY)
            | row_flag(left.is_some(), answer_flag::LEFT)
            | row_flag(probability.is_some(), answer_flag::PROBABILITY)
            | row_flag(margin_j.is_some(), answer_flag::MARGIN)
            | row_flag(limiting_leg.is_some(), answer_flag::LIMITING_LEG)
            | row_flag(self.turn_back_s.is_some(), answer_flag::TURN_BACK)
            | row_flag(caveats.beyond_horizon, answer_flag::BEYOND_HORIZON)
            | row_flag(caveats.no_reading, answer_flag::NO_READING)
            | row_flag(caveats.state_outside_training, answer_flag::OUTSIDE_TRAINING)
            | row_flag(!caveats.limits.is_empty(), answer_flag::MODEL_LIMIT)
            | caveats.alarms.row_flags();
        let nan = f32::NAN;
        AnswerRow {
            robot: self.robot,
            flags,
            verdict,
            unknown,
            unknown_detail,
            age_ns,
            duration_s,
            mean_j: energy.map_or(nan, |energy| energy.mean_j),
            lo_j: energy.map_or(nan, |energy| energy.lo_j),
            hi_j: energy.map_or(nan, |energy| energy.hi_j),
            left_j: left.map_or(nan, |left| left.mean_j),
            left_lo_j: left.map_or(nan, |left| left.lo_j),
            probability: probability.unwrap_or(nan),
            margin_j: margin_j.unwrap_or(nan),
            turn_back_s: self.turn_back_s.unwrap_or(nan),
            limiting_leg: limiting_leg.map_or(0, count),
            outside_training: count(caveats.steps_outside_training),
        }
    }

    /// `None` if the verdict is of a newer version.
    fn decode(row: &AnswerRow) -> Option<Self> {
        let known = |flag, value: f32| (row.flags & flag != 0).then_some(value);
        let has = |flag| row.flags & flag != 0;
        Some(Self {
            robot: row.robot,
            turn_back_s: known(answer_flag::TURN_BACK, row.turn_back_s),
            answer: Answer {
                duration_s: row.duration_s,
                energy: has(answer_flag::ENERGY).then_some(Range {
                    mean_j: row.mean_j,
                    lo_j: row.lo_j,
                    hi_j: row.hi_j,
                }),
                left: has(answer_flag::LEFT)
                    .then_some(Left { mean_j: row.left_j, lo_j: row.left_lo_j }),
                probability: known(answer_flag::PROBABILITY, row.probability),
                margin_j: known(answer_flag::MARGIN, row.margin_j),
                verdict: verdict_of(row)?,
                limiting_leg: has(answer_flag::LIMITING_LEG).then_some(row.limiting_leg as usize),
                caveats: Caveats {
                    steps_outside_training: row.outside_training as usize,
                    beyond_horizon: has(answer_flag::BEYOND_HORIZON),
                    no_reading: has(answer_flag::NO_READING),
                    state_outside_training: has(answer_flag::OUTSIDE_TRAINING),
                    late_s: if has_detail(row.unknown) { 0 } else { row.unknown_detail },
                    alarms: Doubts::from_row(row.flags),
                    ..Caveats::default()
                },
            },
        })
    }
}

/// True if the reason of an unknown verdict has a detail: invalid and warm-up.
const fn has_detail(unknown: u16) -> bool {
    matches!(unknown, 2 | 3)
}

/// Verdict, reason, detail and age.
const fn verdict_codes(verdict: Verdict) -> (u16, u16, u16, u64) {
    let unknown = match verdict {
        Verdict::Yes => return (1, 0, 0, 0),
        Verdict::Tight => return (2, 0, 0, 0),
        Verdict::No => return (3, 0, 0, 0),
        Verdict::Unknown(unknown) => unknown,
    };
    match unknown {
        Unknown::Stale { age_ns } => (4, 1, 0, age_ns),
        Unknown::Invalid { reason } => (4, 2, reason.code(), 0),
        Unknown::Warmup { have } => (4, 3, have, 0),
        Unknown::Unreadable => (4, 4, 0, 0),
        Unknown::NoLevel => (4, 5, 0, 0),
        Unknown::NoBattery => (4, 6, 0, 0),
        Unknown::BatteryUnknown => (4, 7, 0, 0),
        Unknown::NoBudget => (4, 8, 0, 0),
    }
}

fn verdict_of(row: &AnswerRow) -> Option<Verdict> {
    Some(match (row.verdict, row.unknown) {
        (1, _) => Verdict::Yes,
        (2, _) => Verdict::Tight,
        (3, _) => Verdict::No,
        (4, 1) => Verdict::Unknown(Unknown::Stale { age_ns: row.age_ns }),
        (4, 2) => {
            Verdict::Unknown(Unknown::Invalid { reason: InvalidReason::decode(row.unknown_detail) })
        }
        (4, 3) => Verdict::Unknown(Unknown::Warmup { have: row.unknown_detail }),
        (4, 4) => Verdict::Unknown(Unknown::Unreadable),
        (4, 5) => Verdict::Unknown(Unknown::NoLevel),
        (4, 6) => Verdict::Unknown(Unknown::NoBattery),
        (4, 7) => Verdict::Unknown(Unknown::BatteryUnknown),
        (4, 8) => Verdict::Unknown(Unknown::NoBudget),
        _ => return None,
    })
}
