//! The network on arrays. Unlike handles of shared memory, a predictor may be used by any thread.

use std::ffi::c_char;
use std::ptr;
use std::sync::{Arc, PoisonError, RwLock};

use ::joulebus_predictor::{
    FEATURES, Features, INPUTS, LAGS, Model, ReadingAge, RolloutStart, Rollouts,
};
use joulebus_bus::{ForkSection, process_id};

use crate::abi::types::{joulebus_error, joulebus_predictor, joulebus_rollout};
use crate::failure::{Failure, entry};
use crate::memory::{array, array_mut, check_apart, out, product, read, text};
use crate::{model, version};

/// The model of a program that names none.
const DEFAULT: &str = "builtin:gternal-sim";
/// Marks the number of a predictor: no code of a [`crate::handles::Kind`] begins so.
const MARK: usize = 0xf << 60;
/// Above the place: the process that opened it, whose ids have at most 22 bits.
const PID_SHIFT: u32 = 32;
/// Rows that are widened at once, on the stack.
const ROWS: usize = 64;

/// A place is used once: what is closed is never another one.
type Predictors = Vec<Option<Arc<Model>>>;

/// All predictors of the process.
static OPEN: RwLock<Predictors> = RwLock::new(Vec::new());

/// Reads [`OPEN`]. A fork waits meanwhile: the child would find it locked for ever.
fn read_all<R>(read: impl FnOnce(&Predictors) -> R) -> R {
    let _section = ForkSection::enter();
    // A panic leaves the list as it was.
    read(&OPEN.read().unwrap_or_else(PoisonError::into_inner))
}

/// Same as [`read_all`], to change it.
fn change_all<R>(change: impl FnOnce(&mut Predictors) -> R) -> R {
    let _section = ForkSection::enter();
    change(&mut OPEN.write().unwrap_or_else(PoisonError::into_inner))
}

/// Opens a model file of joulebus (.safetensors), or a built-in model (builtin:NAME).
///
/// @param header    JOULEBUS_HEADER.
/// @param model     Its path or name. NULL: builtin:gternal-sim.
/// @param predictor The new handle. Any thread may use it, also several at once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_predictor_open(
    header: *const c_char,
    model: *const c_char,
    predictor: *mut *mut joulebus_predictor,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (header, name, mut predictor) = unsafe {
            let name = if model.is_null() { DEFAULT } else { text("model", model)? };
            (text("header", header)?, name, out("predictor", predictor)?)
        };
        version::check(header)?;
        let opened = Arc::new(model::open(name)?);
        let place = change_all(|all| {
            all.push(Some(opened));
            all.len() - 1
        });
        predictor.set(ptr::without_provenance_mut(of_process() | place));
        Ok(())
    })
}

/// Forecasts of rows of features, W. Bits are those of every other way to compute them. A NaN in a
/// row makes that row's forecast NaN and changes no other.
///
/// @param features rows * width values: v, omega, their derivatives, their magnitudes, the last
///                 five readings, newest first (m, rad, s, W). Of width 13 also the age of the
///                 newest reading in steps, and 1 where the next is due, else 0.
/// @param rows     Robots.
/// @param width    11 or 13. 13 is not copied.
/// @param power_w  Memory for rows forecasts.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_predictor_predict(
    predictor: *mut joulebus_predictor,
    features: *const f32,
    rows: usize,
    width: usize,
    power_w: *mut f32,
) -> joulebus_error {
    entry(|| {
        let model = model(predictor)?;
        check_width(&model, width)?;
        let values = product("features", &[rows, width])?;
        check_apart(("features", features, values), ("power_w", power_w.cast_const(), rows))?;
        // SAFETY: the caller's promises, in joulebus.h. Both lie apart.
        let (features, power_w) =
            unsafe { (array("features", features, values)?, array_mut("power_w", power_w, rows)?) };
        if width == INPUTS {
            model.predict(features.as_chunks().0, power_w);
            return Ok(());
        }
        let mut widened = [[f32::NAN; INPUTS]; ROWS];
        let parts = features.chunks(ROWS * width);
        for (part, power_w) in parts.zip(power_w.chunks_mut(ROWS)) {
            let rows = part.chunks_exact(width);
            for (to, row) in widened.iter_mut().zip(rows) {
                to[..width].copy_from_slice(row);
            }
            let widened: &[Features] = &widened[..power_w.len()];
            model.predict(widened, power_w);
        }
        Ok(())
    })
}

/// Energy and power of command sequences, in open loop: the network is fed with its own forecasts.
///
/// @param rollout  The commands, and what each robot starts from.
/// @param energy_j Memory for robots * candidates energies, J.
/// @param power_w  Memory for robots * candidates * steps powers, W, in the order of the commands.
///                 NULL if they are not wanted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_predictor_rollout(
    predictor: *mut joulebus_predictor,
    rollout: *const joulebus_rollout,
    energy_j: *mut f32,
    power_w: *mut f32,
) -> joulebus_error {
    entry(|| {
        let model = model(predictor)?;
        if model.needs_freshness() {
            let text = "the network reads the age of readings, which a rollout is not told. Train \
                one without: `joulebus train … --features full`";
            return Err(Failure::new(joulebus_error::Model, text));
        }
        // SAFETY: the caller's promises, in joulebus.h.
        let of = unsafe { read("rollout", rollout) }?;
        let lanes = product("energy_j", &[of.robots, of.candidates])?;
        let commands = product("commands", &[lanes, of.steps])?;
        let readings = product("readings_w", &[of.robots, LAGS])?;
        let traced = if power_w.is_null() { 0 } else { commands };
        let energies = ("energy_j", energy_j.cast_const(), lanes);
        check_apart(energies, ("power_w", power_w.cast_const(), traced))?;
        // SAFETY: as above. Results are written when nothing of the caller is read any more.
        let (v_mps, omega_radps, starts) = unsafe {
            (
                array("v_mps", of.v_mps, commands)?,
                array("omega_radps", of.omega_radps, commands)?,
                starts(&of, array("readings_w", of.readings_w, readings)?)?,
            )
        };
        let (v_mps, omega_radps) =
            (transposed(v_mps, lanes, of.steps), transposed(omega_radps, lanes, of.steps));
        let rollouts = Rollouts {
            starts: &starts,
            candidates: of.candidates,
            steps: of.steps,
            step_s: of.step_s,
            v_mps: &v_mps,
            omega_radps: &omega_radps,
        };
        let (mut energies, mut powers) = (zeros(lanes)?, zeros(traced)?);
        let powers_w = (!power_w.is_null()).then_some(powers.as_mut_slice());
        model.rollout(&rollouts, 0..lanes, &mut energies, powers_w).map_err(Failure::argument)?;
        // SAFETY: as above.
        let (energy_j, power_w) = unsafe {
            (array_mut("energy_j", energy_j, lanes)?, array_mut("power_w", power_w, traced)?)
        };
        energy_j.copy_from_slice(&energies);
        power_w.copy_from_slice(&transposed(&powers, of.steps, lanes));
        Ok(())
    })
}

/// A number that is equal for equal models, on every machine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_predictor_hash(
    predictor: *mut joulebus_predictor,
    hash: *mut u64,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut hash = unsafe { out("hash", hash) }?;
        hash.set(model(predictor)?.hash());
        Ok(())
    })
}

/// Closes a predictor, by any thread. Calls that use it meanwhile are finished. NULL is closed
/// already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_predictor_close(predictor: *mut joulebus_predictor) -> joulebus_error {
    entry(|| {
        if predictor.is_null() {
            return Ok(());
        }
        let place = place(predictor)?;
        let closed = change_all(|all| all.get_mut(place).and_then(Option::take));
        closed.map(drop).ok_or_else(not_open)
    })
}

/// The model. Kept for as long as the call takes.
fn model(predictor: *mut joulebus_predictor) -> Result<Arc<Model>, Failure> {
    let place = place(predictor)?;
    read_all(|all| all.get(place)?.clone()).ok_or_else(not_open)
}

fn place(predictor: *mut joulebus_predictor) -> Result<usize, Failure> {
    if predictor.is_null() {
        return Err(Failure::argument(
            "the predictor is NULL: open one, and look at what opening returned",
        ));
    }
    let number = predictor.addr();
    if number & MARK != MARK {
        let text = format!("{number:#x} is not a predictor");
        return Err(Failure::new(joulebus_error::Handle, text));
    }
    let place = number & ((1 << PID_SHIFT) - 1);
    if number - place != of_process() {
        let (found, allowed) = (process_id(), (number & !MARK) >> PID_SHIFT);
        let text = format!(
            "a predictor used in process {found}, which was forked from {allowed}: open another one after a fork"
        );
        return Err(Failure::new(joulebus_error::Process, text));
    }
    Ok(place)
}

/// The upper bits of all predictors' numbers in this process.
fn of_process() -> usize {
    MARK | (process_id() as usize) << PID_SHIFT
}

fn not_open() -> Failure {
    let text = "the predictor is closed. Open a new one";
    Failure::new(joulebus_error::Handle, text)
}

fn check_width(model: &Model, width: usize) -> Result<(), Failure> {
    let needed = model.feature_set().end();
    if (width == FEATURES || width == INPUTS) && width >= needed {
        return Ok(());
    }
    let allowed = if needed > FEATURES {
        "13: the network reads the age of the newest reading"
    } else {
        "11, and 13 with the age of the newest reading"
    };
    Err(Failure::argument(format!("width is {width}, allowed is {allowed}")))
}

/// The start of each robot's rollout.
///
/// # Safety
/// If `of.before` is not null, two numbers for each robot lie there.
unsafe fn starts(of: &joulebus_rollout, readings_w: &[f32]) -> Result<Vec<RolloutStart>, Failure> {
    let before = if of.before.is_null() {
        &[][..]
    } else {
        // SAFETY: the caller's promise.
        unsafe { array("before", of.before, product("before", &[of.robots, 2])?) }?
    };
    let (readings_w, _) = readings_w.as_chunks::<LAGS>();
    let (before, _) = before.as_chunks::<2>();
    let start = |(robot, lag_w): (usize, &[f32; LAGS])| RolloutStart {
        command: before.get(robot).map(|[v_mps, omega_radps]| (*v_mps, *omega_radps)),
        lag_w: *lag_w,
        reading_age: ReadingAge::UNKNOWN,
    };
    Ok(readings_w.iter().enumerate().map(start).collect())
}

/// Memory for results. So many that there is no memory are an error, not the program's end.
fn zeros(count: usize) -> Result<Vec<f32>, Failure> {
    let mut zeros = Vec::new();
    zeros.try_reserve_exact(count).map_err(|error| {
        Failure::argument(format!("{count} results do not fit into memory: {error}"))
    })?;
    zeros.resize(count, 0.0);
    Ok(zeros)
}

/// `to[column * rows + row] = from[row * columns + column]`.
fn transposed(from: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let column = |column: usize| (0..rows).map(move |row| from[row * columns + column]);
    match from {
        [] => Vec::new(),
        _ => (0..columns).flat_map(column).collect(),
    }
}
