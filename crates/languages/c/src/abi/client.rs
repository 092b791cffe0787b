//! Questions answered by the worker, for programs that do not compute.

use std::ffi::c_char;
use std::time::Duration;

use joulebus_planner::{ClientError, Config, PlanClient};
use joulebus_wire::{Statement, sample_flag};

use crate::abi::types::{joulebus_answers, joulebus_client, joulebus_error, joulebus_question};
use crate::failure::{Failure, entry};
use crate::handles::{self, kind};
use crate::memory::{out, read, text};
use crate::question::{self, AnswerMemory};
use crate::version;

kind!(PlanClient, joulebus_client, "client", 5);

/// Joins the fleet of a config file as a program that asks. Loads no models. The worker need not
/// run yet.
///
/// @param header      JOULEBUS_HEADER.
/// @param config_path The fleet's config file.
/// @param name        1 to 128 bytes, shown to operators.
/// @param client      The new handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_client_open(
    header: *const c_char,
    config_path: *const c_char,
    name: *const c_char,
    client: *mut *mut joulebus_client,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (header, config_path, name, mut client) = unsafe {
            (
                text("header", header)?,
                text("config_path", config_path)?,
                text("name", name)?,
                out("client", client)?,
            )
        };
        version::check(header)?;
        let connect = |text: String| Failure::new(joulebus_error::Connect, text);
        let config = Config::load(config_path).map_err(|error| connect(error.to_string()))?;
        let opened = PlanClient::with_config(&config, name);
        client.set(handles::open(opened.map_err(|error| connect(error.to_string()))?)?);
        Ok(())
    })
}

/// Asks the worker, and waits for its answer. If the worker ends meanwhile, this returns at once. A
/// question has at most JOULEBUS_MAX_QUERY_ROBOTS robots, JOULEBUS_MAX_QUERY_CANDIDATES candidates
/// and JOULEBUS_MAX_QUERY_VALUES values.
///
/// @param question   What is asked.
/// @param timeout_ns Time to wait, ns. Later the worker does not answer any more.
/// @param answers    Memory for the answers. Filled with what they are of. Powers that do not fit
///                   into a frame are left out: power_count is 0 then.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_client_ask(
    client: *mut joulebus_client,
    question: *const joulebus_question,
    timeout_ns: u64,
    answers: *mut joulebus_answers,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h, of the structs and of what they point to.
        let (asked, mut to, places, mut answers) = unsafe {
            let raw = read("question", question)?;
            let to = read("answers", answers.cast_const())?;
            // A copy: what is written may lie anywhere.
            let asked = question::read(&raw, !to.power_w.is_null())?;
            (asked, to, AnswerMemory::new(&to, &raw)?, out("answers", answers)?)
        };
        let timeout = Duration::from_nanos(timeout_ns);
        let found = handles::with(client, |client: &mut PlanClient| {
            client.ask(&asked, timeout).map_err(unanswered)
        })?;
        (to.row_count, to.power_count) = places.fill(&found.reply)?;
        (to.tick, to.age_ns, to.took_ns) = (found.tick, found.age_ns, found.took_ns);
        answers.set(to);
        Ok(())
    })
}

/// States a robot's battery in the name of a person, as `joulebus battery` does. Returns when the
/// worker has taken it: its next tick counts from there.
///
/// @param statement  JOULEBUS_SAMPLE_SOC, JOULEBUS_SAMPLE_FULL or JOULEBUS_SAMPLE_SWAPPED: it was
///                   measured, it is full, or it was exchanged.
/// @param soc        The state of charge that was measured, 0 to 1.
/// @param by         Who states it, shown to operators and in captures.
/// @param timeout_ns Time to wait, ns.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_client_state_battery(
    client: *mut joulebus_client,
    robot: u32,
    statement: u32,
    soc: f32,
    by: *const c_char,
    timeout_ns: u64,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promise, in joulebus.h.
        let by = unsafe { text("by", by) }?;
        let statement = match statement {
            sample_flag::SOC => Statement::Charge(soc),
            sample_flag::FULL => Statement::Full,
            sample_flag::SWAPPED => Statement::Exchanged,
            other => {
                return Err(Failure::argument(format!(
                    "statement is {other:#x}, allowed are JOULEBUS_SAMPLE_SOC, _FULL and _SWAPPED"
                )));
            }
        };
        let timeout = Duration::from_nanos(timeout_ns);
        handles::with(client, |client: &mut PlanClient| {
            client.state_battery(robot, statement, by, timeout).map_err(unanswered)
        })
    })
}

/// Leaves the fleet. NULL is closed already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_client_close(client: *mut joulebus_client) -> joulebus_error {
    entry(|| handles::close::<PlanClient>(client))
}

fn unanswered(error: ClientError) -> Failure {
    let code = match error {
        ClientError::Refused(_) => joulebus_error::Question,
        _ => joulebus_error::Unanswered,
    };
    Failure::new(code, error)
}
