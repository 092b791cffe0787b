//! Costs of plans, computed in this process.

use std::ffi::c_char;
use std::time::Duration;

use joulebus_plan::answering::Work;
use joulebus_plan::{Answer, Candidates, MAX_STEPS, QuestionError, Row};
use joulebus_planner::{Config, Planner, ViewError};
use joulebus_wire::AnswerRow;

use crate::abi::subscriber::read_failed;
use crate::abi::types::{
    joulebus_answers, joulebus_error, joulebus_platform, joulebus_question, joulebus_questions,
};
use crate::failure::{Failure, entry};
use crate::handles::{self, kind};
use crate::memory::{array, array_mut, check_apart, out, product, read, text};
use crate::question::{self, AnswerMemory};
use crate::version;

/// A planner that asks, and memory of its calls.
pub(crate) struct Questions {
    planner: Planner,
    answers: Vec<Answer>,
}

kind!(Questions, joulebus_questions, "planner of questions", 4);

/// Joins the fleet of a config file as a planner that asks, and loads the models that the config
/// names. The worker writes what plans start from while there is one: keep it for as long as there
/// are questions.
///
/// @param header      JOULEBUS_HEADER.
/// @param config_path The fleet's config file, the worker's.
/// @param name        1 to 128 bytes, shown to operators.
/// @param questions   The new handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_questions_open(
    header: *const c_char,
    config_path: *const c_char,
    name: *const c_char,
    questions: *mut *mut joulebus_questions,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (header, config_path, name, mut questions) = unsafe {
            (
                text("header", header)?,
                text("config_path", config_path)?,
                text("name", name)?,
                out("questions", questions)?,
            )
        };
        version::check(header)?;
        let connect = |text: String| Failure::new(joulebus_error::Connect, text);
        let config = Config::load(config_path).map_err(|error| connect(error.to_string()))?;
        let planner = Planner::with_config(&config, name);
        let opened = Questions {
            planner: planner.map_err(|error| connect(error.to_string()))?,
            answers: Vec::new(),
        };
        questions.set(handles::open(opened)?);
        Ok(())
    })
}

/// Waits until the newest frame is at most two ticks old, and returns its tick and its age. After
/// the time, those of the frame that there is.
///
/// @param timeout_ns Time to wait, ns.
/// @param tick       Tick of the newest frame.
/// @param age_ns     Its age, ns.
/// @return JOULEBUS_ERROR_NO_FRAME if nothing has arrived.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_questions_wait(
    questions: *mut joulebus_questions,
    timeout_ns: u64,
    tick: *mut u64,
    age_ns: *mut u64,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (mut tick, mut age_ns) = unsafe { (out("tick", tick)?, out("age_ns", age_ns)?) };
        let timeout = Duration::from_nanos(timeout_ns);
        let seen = handles::with(questions, |asker: &mut Questions| {
            let view = asker.planner.wait(timeout).map_err(not_seen)?;
            Ok((view.tick(), view.age_ns()))
        })?;
        tick.set(seen.0);
        age_ns.set(seen.1);
        Ok(())
    })
}

/// The platform of a robot, as the config describes it. Of one that belongs to none,
/// JOULEBUS_ERROR_QUESTION.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_questions_platform(
    questions: *mut joulebus_questions,
    robot: u32,
    platform: *mut joulebus_platform,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut platform = unsafe { out("platform", platform) }?;
        let found =
            handles::with(questions, |asker: &mut Questions| platform_of(&asker.planner, robot))?;
        platform.set(found);
        Ok(())
    })
}

/// The energy of each of several sequences of commands of one robot, and whether it makes them, as
/// of the newest frame. Allocates nothing after the first call with so many candidates.
///
/// @param candidates  Number of sequences.
/// @param steps       Steps of each, at most 1,000,000.
/// @param period_s    Time that each command is in force, s.
/// @param v_mps       candidates * steps linear velocities, m/s, candidate by candidate.
/// @param omega_radps As many angular velocities, rad/s.
/// @param coverage    Coverage of the intervals, 0.5 to 0.999.
/// @param answers     Memory for candidates answers.
/// @param power_w     Memory for candidates * steps powers, W, candidate by candidate. NULL if they
///                    are not wanted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_questions_what_if(
    questions: *mut joulebus_questions,
    robot: u32,
    candidates: usize,
    steps: usize,
    period_s: f32,
    v_mps: *const f32,
    omega_radps: *const f32,
    coverage: f32,
    answers: *mut AnswerRow,
    power_w: *mut f32,
) -> joulebus_error {
    entry(|| {
        let commands = product("commands", &[candidates, steps])?;
        let powers = if power_w.is_null() { 0 } else { commands };
        let rows = ("answers", answers.cast_const(), candidates);
        let traces = ("power_w", power_w.cast_const(), powers);
        check_apart(rows, traces)?;
        for column in [("v_mps", v_mps, commands), ("omega_radps", omega_radps, commands)] {
            check_apart(column, rows)?;
            check_apart(column, traces)?;
        }
        // SAFETY: the caller's promises, in joulebus.h. What is written lies apart from all else.
        let (v_mps, omega_radps, rows, power_w) = unsafe {
            (
                array("v_mps", v_mps, commands)?,
                array("omega_radps", omega_radps, commands)?,
                array_mut("answers", answers, candidates)?,
                array_mut("power_w", power_w, powers)?,
            )
        };
        let plans = Candidates::new(candidates, period_s, v_mps, omega_radps).map_err(refused)?;
        handles::with(questions, |asker: &mut Questions| {
            asker.what_if(robot, &plans, coverage, rows, power_w)
        })
    })
}

/// Answers a question as of the newest frame.
///
/// @param question What is asked.
/// @param answers  Memory for the answers. Filled with what they are of.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_questions_ask(
    questions: *mut joulebus_questions,
    question: *const joulebus_question,
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
        handles::with(questions, |asker: &mut Questions| {
            let view = asker.planner.view().map_err(not_seen)?;
            let view = view.ok_or_else(nothing)?;
            (to.tick, to.age_ns, to.took_ns) = (view.tick(), view.age_ns(), 0);
            let find = |robot| view.rows(robot);
            let mut work = Work::begin(asked, find, MAX_STEPS).map_err(refused)?;
            while !work.step(asker.planner.fleet()).map_err(refused)? {}
            (to.row_count, to.power_count) = places.fill(&work.finish())?;
            Ok(())
        })?;
        answers.set(to);
        Ok(())
    })
}

/// Leaves the fleet. NULL is closed already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_questions_close(questions: *mut joulebus_questions) -> joulebus_error {
    entry(|| handles::close::<Questions>(questions))
}

impl Questions {
    fn what_if(
        &mut self,
        robot: u32,
        plans: &Candidates<'_>,
        coverage: f32,
        rows: &mut [AnswerRow],
        power_w: &mut [f32],
    ) -> Result<(), Failure> {
        let view = self.planner.view().map_err(not_seen)?;
        let view = view.ok_or_else(nothing)?;
        let found = view.robot(robot);
        let found = found.ok_or_else(|| refused(QuestionError::UnknownRobot { robot }))?;
        self.answers.clear();
        self.answers.try_reserve(plans.count()).map_err(Failure::argument)?;
        self.answers.resize(plans.count(), Answer::UNKNOWN);
        found.what_if_into(plans, coverage, &mut self.answers).map_err(refused)?;
        for (row, answer) in rows.iter_mut().zip(&self.answers) {
            *row = Row::new(robot, *answer).encode();
        }
        if !power_w.is_empty() {
            found.power_w(plans, power_w).map_err(refused)?;
        }
        Ok(())
    }
}

fn platform_of(planner: &Planner, robot: u32) -> Result<joulebus_platform, Failure> {
    let platforms = planner.fleet().platforms().iter();
    let mut settings = platforms.map(|platform| &platform.settings);
    let its = settings.find(|of| of.robots.iter().any(|ids| ids.contains(&robot)));
    let of = its.ok_or_else(|| {
        let text = format!("robot {robot} belongs to no platform: name it in `robots` of one");
        Failure::new(joulebus_error::Question, text)
    })?;
    Ok(joulebus_platform {
        period_s: of.period_ns as f32 * 1e-9,
        v_max_mps: of.v_max_mps,
        omega_max_radps: of.omega_max_radps,
        power_min_w: of.power_min_w,
        power_max_w: of.power_max_w,
        reserved: 0,
        capacity_j: of.battery.as_ref().map_or(f64::NAN, |battery| battery.capacity_j),
    })
}

pub(crate) fn refused(error: impl Into<QuestionError>) -> Failure {
    Failure::new(joulebus_error::Question, error.into())
}

fn not_seen(error: ViewError) -> Failure {
    match error {
        ViewError::Read(error) => read_failed(&error),
        ViewError::Nothing { .. } => Failure::new(joulebus_error::NoFrame, error),
        ViewError::Interrupted => Failure::new(joulebus_error::Interrupted, error),
        // The worker's settings or models are others.
        error => Failure::new(joulebus_error::Connect, error),
    }
}

fn nothing() -> Failure {
    not_seen(ViewError::Nothing { waited_s: 0.0 })
}
