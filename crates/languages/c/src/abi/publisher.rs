//! A source of samples.

use std::ffi::c_char;

use ::joulebus_publisher::{Config, PublishError, Publisher, RobotState, Sent, clock};
use joulebus_wire::Sample;

use crate::abi::types::{
    joulebus_error, joulebus_not_taken, joulebus_publisher, joulebus_publisher_counts,
    joulebus_robot_state, joulebus_sent,
};
use crate::failure::{Failure, entry};
use crate::handles::{self, kind};
use crate::memory::{array, out, text};
use crate::version;

kind!(Publisher, joulebus_publisher, "publisher", 1);

/// Joins the fleet of a config file as a source of samples. The worker need not run.
///
/// @param header      JOULEBUS_HEADER.
/// @param config_path The fleet's config file.
/// @param source_name 1 to 128 bytes that tell the sources of a fleet apart and stay the same over
///                    restarts.
/// @param publisher   The new handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_publisher_open(
    header: *const c_char,
    config_path: *const c_char,
    source_name: *const c_char,
    publisher: *mut *mut joulebus_publisher,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (header, config_path, source_name, mut publisher) = unsafe {
            (
                text("header", header)?,
                text("config_path", config_path)?,
                text("source_name", source_name)?,
                out("publisher", publisher)?,
            )
        };
        version::check(header)?;
        let connect = |text: String| Failure::new(joulebus_error::Connect, text);
        let config = Config::load(config_path).map_err(|error| connect(error.to_string()))?;
        let port = Publisher::with_config(&config, source_name);
        publisher.set(handles::open(port.map_err(|error| connect(error.to_string()))?)?);
        Ok(())
    })
}

/// Sends one frame: each robot at most once, numbered and stamped with the current time. Never
/// blocks. When the worker is too slow, the oldest frame is overwritten, and the worker counts it.
/// Values are sent unchecked: what is not finite or beyond the platform's limits is refused by the
/// worker, counted by reason.
///
/// @param robots      The robots' states. NULL if count is 0.
/// @param count       How many.
/// @param intended_ns When the frame was due, monotonic ns: latencies are measured from there. 0:
///                    now.
/// @param sent        The frame that was sent. NULL if it is not wanted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_publisher_publish(
    publisher: *mut joulebus_publisher,
    robots: *const joulebus_robot_state,
    count: usize,
    intended_ns: u64,
    sent: *mut joulebus_sent,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let robots = unsafe { array("robots", robots, count) }?;
        check(robots)?;
        publish(publisher, sent, |publisher| {
            publisher.publish_intended(due(intended_ns), robots.iter().map(RobotState::from))
        })
    })
}

/// Same as joulebus_publisher_publish, for samples with the caller's own numbers and stamps: for
/// recordings and simulations. Do not mix both for the same robot: seq and stamp_ns of each must
/// increase strictly.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_publisher_publish_samples(
    publisher: *mut joulebus_publisher,
    samples: *const Sample,
    count: usize,
    intended_ns: u64,
    sent: *mut joulebus_sent,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let samples = unsafe { array("samples", samples, count) }?;
        publish(publisher, sent, |publisher| publisher.publish_samples(due(intended_ns), samples))
    })
}

/// Reads the publisher's counts.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_publisher_get_counts(
    publisher: *mut joulebus_publisher,
    counts: *mut joulebus_publisher_counts,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut counts = unsafe { out("counts", counts) }?;
        let of = |publisher: &mut Publisher| {
            Ok(joulebus_publisher_counts {
                frames_sent: publisher.frames_sent(),
                samples_sent: publisher.samples_sent(),
                capacity: publisher.capacity(),
                degraded: publisher.degraded(),
                source_id: publisher.source_id(),
                source_epoch: publisher.source_epoch(),
            })
        };
        counts.set(handles::with(publisher, of)?);
        Ok(())
    })
}

/// Reads which samples of this run the worker refuses, and why: another source has the robots, a
/// newer process of the same name has taken over, a value is out of range. The worker tells it
/// twice a second in a file, which this reads: call it now and then. Without a worker on this host
/// nothing is known.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_publisher_get_not_taken(
    publisher: *mut joulebus_publisher,
    not_taken: *mut joulebus_not_taken,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut not_taken = unsafe { out("not_taken", not_taken) }?;
        let all = handles::with(publisher, |publisher: &mut Publisher| Ok(publisher.refusals()))?;
        let mut told = joulebus_not_taken { count: 0, reason: 0, robot: 0, text: [0; 320] };
        if let Some(refused) = all.iter().find(|refused| refused.is_recent()) {
            (told.count, told.robot) = (refused.count, refused.robot);
            told.reason = refused.reason as u32 + 1;
            let last = told.text.len() - 1;
            // Of ASCII, so no letter is cut.
            for (to, from) in told.text[..last].iter_mut().zip(refused.to_string().bytes()) {
                *to = from.cast_signed() as c_char;
            }
        }
        not_taken.set(told);
        Ok(())
    })
}

/// Leaves the fleet. A worker that has not noticed this source yet takes none of its frames. NULL
/// is closed already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_publisher_close(publisher: *mut joulebus_publisher) -> joulebus_error {
    entry(|| handles::close::<Publisher>(publisher))
}

fn publish(
    publisher: *mut joulebus_publisher,
    sent: *mut joulebus_sent,
    send: impl FnOnce(&mut Publisher) -> Result<Sent, PublishError>,
) -> Result<(), Failure> {
    // SAFETY: the caller's promises, in joulebus.h.
    let sent = (!sent.is_null()).then(|| unsafe { out("sent", sent) });
    let sent = sent.transpose()?;
    let refused = |error: PublishError| {
        let is_final = matches!(&error, PublishError::Send(reason) if reason.is_final());
        let code = if is_final { joulebus_error::Connect } else { joulebus_error::Publish };
        Failure::new(code, error)
    };
    let done: Sent = handles::with(publisher, |publisher| send(publisher).map_err(refused))?;
    if let Some(mut sent) = sent {
        sent.set(joulebus_sent {
            readers: done.readers,
            samples: done.samples,
            frame_seq: done.frame_seq,
            woken: done.not_woken.is_none().into(),
            refused: done.refused.try_into().unwrap_or(u32::MAX),
        });
    }
    Ok(())
}

fn due(intended_ns: u64) -> u64 {
    match intended_ns {
        0 => clock::monotonic_ns(),
        due_ns => due_ns,
    }
}

fn check(robots: &[joulebus_robot_state]) -> Result<(), Failure> {
    match robots.iter().find(|robot| !robot.is_known()) {
        None => Ok(()),
        Some(robot) => Err(Failure::argument(format!(
            "flags of robot {} are {:#x}: allowed are bits of {:#x}, and 0 in what is reserved",
            robot.robot,
            robot.flags,
            joulebus_robot_state::FLAGS
        ))),
    }
}
