//! Questions and answers between C and `joulebus-plan`.

use joulebus_plan::{Path, Plan, Point, Question, Reply};
use joulebus_wire::{AnswerRow, QueryKind, query_flag};

use crate::abi::types::{joulebus_answers, joulebus_question};
use crate::failure::Failure;
use crate::memory::{array, array_mut, check_apart, product};

/// Flags that a C program may set in a question.
const FLAGS: u32 = query_flag::RETURN | query_flag::HEADING | query_flag::TOLERANCE;

/// A question.
///
/// # Safety
/// The pointers that its kind names point to as many elements as its counts state.
#[allow(unsafe_code, reason = "memory of the caller")]
pub(crate) unsafe fn read(from: &joulebus_question, power: bool) -> Result<Question, Failure> {
    let found = from.flags;
    if found & !FLAGS != 0 {
        return Err(Failure::argument(format!(
            "flags of a question are {found:#x}: allowed are JOULEBUS_QUERY_RETURN, _HEADING and _TOLERANCE"
        )));
    }
    // SAFETY: the caller's promise.
    let robots = unsafe { array("robots", from.robots, from.robot_count) }?;
    let plan = match QueryKind::decode(from.kind) {
        // SAFETY: as above.
        Some(QueryKind::WhatIf) => unsafe { what_if(from, robots) }?,
        Some(QueryKind::Idle) => {
            Plan::Idle { robots: robots.to_vec(), duration_s: from.duration_s }
        }
        Some(QueryKind::Follow) => {
            // SAFETY: as above.
            unsafe { follow(from, robots) }?
        }
        Some(QueryKind::Acknowledge | QueryKind::Battery) | None => {
            return Err(Failure::argument(format!(
                "kind of a question is {}, allowed are JOULEBUS_QUERY_KIND_WHAT_IF, _IDLE and _FOLLOW",
                from.kind
            )));
        }
    };
    let moments = match plan {
        Plan::WhatIf { .. } => 0,
        _ => from.candidates,
    };
    Ok(Question { plan, coverage: from.coverage, power, moments })
}

#[allow(unsafe_code, reason = "memory of the caller")]
unsafe fn what_if(from: &joulebus_question, robots: &[u32]) -> Result<Plan, Failure> {
    let [robot] = *robots else {
        return Err(Failure::argument(format!(
            "{} robots in a question about candidates, allowed is one",
            robots.len()
        )));
    };
    let commands = product("commands", &[from.candidates, from.steps])?;
    // SAFETY: the caller's promise.
    let (v_mps, omega_radps) = unsafe {
        (array("v_mps", from.v_mps, commands)?, array("omega_radps", from.omega_radps, commands)?)
    };
    Ok(Plan::WhatIf {
        robot,
        candidates: from.candidates,
        period_s: from.period_s,
        v_mps: v_mps.to_vec(),
        omega_radps: omega_radps.to_vec(),
    })
}

#[allow(unsafe_code, reason = "memory of the caller")]
unsafe fn follow(from: &joulebus_question, robots: &[u32]) -> Result<Plan, Failure> {
    let has = |flag| from.flags & flag != 0;
    let column = |name, values: *const f64| {
        let count = if values.is_null() { 0 } else { from.points };
        // SAFETY: the caller's promise.
        unsafe { array(name, values, count) }.map(<[f64]>::to_vec)
    };
    // SAFETY: as above.
    let path = unsafe { array("path", from.path, from.points) }?;
    let path = Path {
        points: path.iter().map(|at| Point::new(at.x_m, at.y_m)).collect(),
        speed_mps: path.iter().map(|at| at.speed_mps).collect(),
        heading_rad: has(query_flag::HEADING).then_some(from.heading_rad),
        dwell_s: column("dwell_s", from.dwell_s)?,
        load_w: column("load_w", from.load_w)?,
        time_s: column("time_s", from.time_s)?,
        tolerance_m: has(query_flag::TOLERANCE).then_some(from.tolerance_m),
    };
    let back_to = has(query_flag::RETURN).then_some(Point::new(from.return_x_m, from.return_y_m));
    Ok(Plan::Follow { robots: robots.to_vec(), path, back_to })
}

pub(crate) struct AnswerMemory<'a> {
    rows: &'a mut [AnswerRow],
    power_w: &'a mut [f32],
}

impl<'a> AnswerMemory<'a> {
    /// Refuses fewer places for rows than a question has answers.
    ///
    /// # Safety
    /// The pointers of `of` point to as many elements as its capacities state.
    #[allow(unsafe_code, reason = "memory of the caller")]
    pub(crate) unsafe fn new(
        of: &joulebus_answers,
        question: &joulebus_question,
    ) -> Result<Self, Failure> {
        let needed = match QueryKind::decode(question.kind) {
            Some(QueryKind::WhatIf) => question.candidates,
            _ if question.robot_count == 1 => question.candidates.saturating_add(1),
            _ => question.robot_count,
        };
        if of.row_capacity < needed {
            return Err(Failure::argument(format!(
                "place for {} answers (row_capacity): {needed} are needed",
                of.row_capacity
            )));
        }
        let powers = if of.power_w.is_null() { 0 } else { of.power_capacity };
        let rows = ("rows", of.rows.cast_const(), of.row_capacity);
        check_apart(rows, ("power_w", of.power_w.cast_const(), powers))?;
        // SAFETY: the caller's promise. Both are apart.
        let (rows, power_w) = unsafe {
            (
                array_mut("rows", of.rows, of.row_capacity)?,
                array_mut("power_w", of.power_w, powers)?,
            )
        };
        Ok(Self { rows, power_w })
    }

    /// Writes a reply, and returns the numbers of rows and of powers.
    pub(crate) fn fill(self, reply: &Reply) -> Result<(usize, usize), Failure> {
        let (found, allowed) = (reply.rows.len() + reply.along.len(), self.rows.len());
        if found > allowed {
            return Err(Failure::argument(format!(
                "{found} answers: there is place for {allowed}"
            )));
        }
        for (to, row) in self.rows.iter_mut().zip(reply.rows.iter().chain(&reply.along)) {
            *to = row.encode();
        }
        let powers = reply.power_w.len();
        if let Some(to) = self.power_w.get_mut(..powers) {
            to.copy_from_slice(&reply.power_w);
        }
        Ok((found, powers))
    }
}
