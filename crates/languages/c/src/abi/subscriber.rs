//! A reader of forecasts, diagnostics, budgets and outlooks, in place.

use std::ffi::c_char;
use std::os::fd::AsRawFd;
use std::ptr;
use std::time::Duration;

use joulebus_consumer::{
    Budgets, Config, Diagnostics, End, Event, Feed, Forecasts, Frame, KeptForecasts, Outlooks,
    ReadError, Subscriber, WorkerState,
};
use joulebus_wire::{Channel, Forecast};

use crate::abi::types::{
    joulebus_budgets, joulebus_diagnostics, joulebus_end, joulebus_error, joulebus_event,
    joulebus_event_kind, joulebus_forecasts, joulebus_frame, joulebus_outlooks,
    joulebus_subscriber, joulebus_subscriber_status, joulebus_worker,
};
use crate::failure::{Failure, entry};
use crate::handles::{self, kind};
use crate::memory::{out, text};
use crate::version;

/// A subscriber and what it has opened.
pub(crate) struct Ports {
    subscriber: Subscriber,
    diagnostics: Option<Feed<Diagnostics>>,
    budgets: Option<Feed<Budgets>>,
    outlooks: Option<Feed<Outlooks>>,
}

kind!(Ports, joulebus_subscriber, "subscriber", 2);
kind!(KeptForecasts, joulebus_frame, "frame", 3);

const NO_FRAME: joulebus_forecasts = joulebus_forecasts {
    header: ptr::null(),
    robots: ptr::null(),
    count: 0,
    ticks_missed: 0,
    restarted: 0,
};

/// Joins the fleet of a config file as a subscriber. The worker need not run.
///
/// @param header      JOULEBUS_HEADER.
/// @param config_path The fleet's config file.
/// @param name        1 to 128 bytes, shown to operators. Need not be unique.
/// @param subscriber  The new handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_open(
    header: *const c_char,
    config_path: *const c_char,
    name: *const c_char,
    subscriber: *mut *mut joulebus_subscriber,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (header, config_path, name, mut subscriber) = unsafe {
            (
                text("header", header)?,
                text("config_path", config_path)?,
                text("name", name)?,
                out("subscriber", subscriber)?,
            )
        };
        version::check(header)?;
        let connect = |text: String| Failure::new(joulebus_error::Connect, text);
        let config = Config::load(config_path).map_err(|error| connect(error.to_string()))?;
        let ports = Subscriber::with_config(&config, name);
        let ports = Ports {
            subscriber: ports.map_err(|error| connect(error.to_string()))?,
            diagnostics: None,
            budgets: None,
            outlooks: None,
        };
        subscriber.set(handles::open(ports)?);
        Ok(())
    })
}

/// Waits for a frame that was not returned before, the worker's end, a frame that is too old, or a
/// signal. Of several frames it returns the newest. Skipped ones are counted. Frames stay where
/// they are in shared memory: the event's pointers are valid until the next call of
/// joulebus_subscriber_wait, joulebus_subscriber_latest or joulebus_subscriber_close with this
/// subscriber.
///
/// @param timeout_ns Time to wait, ns. UINT64_MAX for ever, 0 not at all.
/// @param event      What happened.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_wait(
    subscriber: *mut joulebus_subscriber,
    timeout_ns: u64,
    event: *mut joulebus_event,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut event = unsafe { out("event", event) }?;
        let found = handles::with(subscriber, |ports: &mut Ports| {
            let found = ports.subscriber.wait_next(Duration::from_nanos(timeout_ns));
            found.map(event_of).map_err(|error| read_failed(&error))
        })?;
        event.set(found);
        Ok(())
    })
}

/// A descriptor that is readable when joulebus_subscriber_wait is likely to have something to
/// return, for event loops: a frame has arrived, or the worker's process has exited. When it is
/// readable, call joulebus_subscriber_wait with a time of 0 until it returns
/// JOULEBUS_EVENT_KIND_TIMED_OUT. Call it as well where it has not been readable for
/// look_within_ns, since it tells nothing of a worker that is silent, and may miss a frame that
/// arrives while an earlier one is read. It belongs to the subscriber, and must not be closed.
///
/// @param descriptor     To be polled for reading only.
/// @param look_within_ns Longest time to wait for it from now on, ns. At most 100 ms.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_readiness(
    subscriber: *mut joulebus_subscriber,
    descriptor: *mut i32,
    look_within_ns: *mut u64,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (mut descriptor, mut look_within_ns) =
            unsafe { (out("descriptor", descriptor)?, out("look_within_ns", look_within_ns)?) };
        let found = handles::with(subscriber, |ports: &mut Ports| {
            let readiness = ports.subscriber.readiness().map_err(not_opened)?;
            // The subscriber keeps it open.
            Ok((readiness.as_raw_fd(), ports.subscriber.look_within()))
        })?;
        descriptor.set(found.0);
        look_within_ns.set(found.1.as_nanos() as u64);
        Ok(())
    })
}

/// The newest frame, without waiting, whether or not it was returned before. Its header is NULL
/// until the first has arrived. Pointers are valid as of joulebus_subscriber_wait.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_latest(
    subscriber: *mut joulebus_subscriber,
    frame: *mut joulebus_forecasts,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut frame = unsafe { out("frame", frame) }?;
        let found = handles::with(subscriber, |ports: &mut Ports| {
            let found = ports.subscriber.latest().map_err(|error| read_failed(&error))?;
            Ok(found.as_ref().map_or(NO_FRAME, forecasts))
        })?;
        frame.set(found);
        Ok(())
    })
}

/// One robot of the frame that was returned last, in constant time while no robots join or leave.
/// NULL if it is not in the frame, or the frame was taken. Valid as of joulebus_subscriber_wait.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_robot(
    subscriber: *mut joulebus_subscriber,
    robot: u32,
    row: *mut *const Forecast,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut row = unsafe { out("row", row) }?;
        let found = handles::with(subscriber, |ports: &mut Ports| {
            let current = ports.subscriber.current();
            let found = current.as_ref().and_then(|frame| frame.robot(robot));
            Ok(found.map_or(ptr::null(), ptr::from_ref))
        })?;
        row.set(found);
        Ok(())
    })
}

/// Takes the frame that was returned last out of the subscriber, to keep it: there is no current
/// frame then until a newer one arrives. Its pointers stay valid, and its rows as they are, until
/// joulebus_frame_close, also after the subscriber is closed and the worker has ended. Two may be
/// kept. With more, reading is an error until one is closed. A closed subscriber keeps its place
/// (readers.max_planners) until its frames are closed. Without a frame, JOULEBUS_ERROR_NO_FRAME.
///
/// @param frame The new handle.
/// @param view  The frame that is kept. NULL if it is not wanted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_take_current(
    subscriber: *mut joulebus_subscriber,
    frame: *mut *mut joulebus_frame,
    view: *mut joulebus_forecasts,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let (mut frame, view) = unsafe {
            let view = (!view.is_null()).then(|| out("view", view));
            (out("frame", frame)?, view.transpose()?)
        };
        let kept = handles::with(subscriber, |ports: &mut Ports| {
            let seen = ports.subscriber.current().as_ref().map(forecasts);
            Ok(seen.zip(ports.subscriber.take_current()))
        })?;
        let (seen, kept) = kept.ok_or_else(|| {
            let text = "no frame to take: none has arrived, or it is taken already";
            Failure::new(joulebus_error::NoFrame, text)
        })?;
        frame.set(handles::open(kept)?);
        if let Some(mut view) = view {
            view.set(seen);
        }
        Ok(())
    })
}

/// Gives a kept frame back. NULL is closed already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_frame_close(frame: *mut joulebus_frame) -> joulebus_error {
    entry(|| handles::close::<KeptForecasts>(frame))
}

/// The fleet's newest diagnostics, without waiting. The first call opens them: frames sent from
/// then on are read. The header is NULL until the first has arrived. Valid until the next call of
/// this function, or joulebus_subscriber_close.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_diagnostics(
    subscriber: *mut joulebus_subscriber,
    frame: *mut joulebus_diagnostics,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut frame = unsafe { out("frame", frame) }?;
        let (header, robots, count) =
            newest(subscriber, |ports| (&ports.subscriber, &mut ports.diagnostics))?;
        frame.set(joulebus_diagnostics { header, robots, count });
        Ok(())
    })
}

/// The fleet's newest budgets, without waiting. The first call opens them: frames sent before are
/// read as soon as the worker sends again. The header is NULL until the first has arrived. Valid
/// until the next call of this function, or joulebus_subscriber_close.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_budgets(
    subscriber: *mut joulebus_subscriber,
    frame: *mut joulebus_budgets,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut frame = unsafe { out("frame", frame) }?;
        let (header, robots, count) =
            newest(subscriber, |ports| (&ports.subscriber, &mut ports.budgets))?;
        frame.set(joulebus_budgets { header, robots, count });
        Ok(())
    })
}

/// The fleet's newest outlooks, without waiting: the energy that each robot will draw if it goes on
/// as it does. The first call opens them, and the worker computes them from the next tick on, until
/// joulebus_subscriber_close. The header is NULL until the first has arrived. Valid until the next
/// call of this function, or joulebus_subscriber_close.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_outlooks(
    subscriber: *mut joulebus_subscriber,
    frame: *mut joulebus_outlooks,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut frame = unsafe { out("frame", frame) }?;
        let (header, robots, count) =
            newest(subscriber, |ports| (&ports.subscriber, &mut ports.outlooks))?;
        frame.set(joulebus_outlooks { header, robots, count });
        Ok(())
    })
}

/// The worker as seen by the last call that read, and what was counted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn joulebus_subscriber_get_status(
    subscriber: *mut joulebus_subscriber,
    status: *mut joulebus_subscriber_status,
) -> joulebus_error {
    entry(|| {
        // SAFETY: the caller's promises, in joulebus.h.
        let mut status = unsafe { out("status", status) }?;
        status.set(handles::with(subscriber, |ports: &mut Ports| Ok(seen(&ports.subscriber)))?);
        Ok(())
    })
}

/// Leaves the fleet, unless frames are kept: these stay as they are, and the process a member in
/// the subscriber's place, until they are closed. NULL is closed already.
#[unsafe(no_mangle)]
pub extern "C" fn joulebus_subscriber_close(
    subscriber: *mut joulebus_subscriber,
) -> joulebus_error {
    entry(|| handles::close::<Ports>(subscriber))
}

fn event_of(event: Event<'_>) -> joulebus_event {
    let nothing = joulebus_event {
        kind: joulebus_event_kind::TimedOut,
        end: joulebus_end::None,
        age_ns: 0,
        frame: NO_FRAME,
    };
    match event {
        Event::Frame(frame) => {
            joulebus_event { kind: joulebus_event_kind::Frame, frame: forecasts(&frame), ..nothing }
        }
        Event::Gone(end) => {
            joulebus_event { kind: joulebus_event_kind::Gone, end: ended(end), ..nothing }
        }
        Event::Stale { age_ns } => {
            joulebus_event { kind: joulebus_event_kind::Stale, age_ns, ..nothing }
        }
        Event::Interrupted => joulebus_event { kind: joulebus_event_kind::Interrupted, ..nothing },
        _ => nothing,
    }
}

fn forecasts(frame: &Frame<'_, Forecasts>) -> joulebus_forecasts {
    let arrival = frame.arrival();
    joulebus_forecasts {
        header: frame.header(),
        robots: frame.robots().as_ptr(),
        count: frame.robots().len(),
        ticks_missed: arrival.ticks_missed,
        restarted: arrival.restarted.into(),
    }
}

/// The newest frame of a channel, which the first call opens.
fn newest<C: Channel>(
    subscriber: *mut joulebus_subscriber,
    of: fn(&mut Ports) -> (&Subscriber, &mut Option<Feed<C>>),
) -> Result<(*const C::Header, *const C::Row, usize), Failure> {
    handles::with(subscriber, |ports: &mut Ports| {
        let (subscriber, feed) = of(ports);
        let feed = match feed {
            Some(feed) => feed,
            none => none.insert(subscriber.feed().map_err(not_opened)?),
        };
        let found = feed.latest().map_err(|error| read_failed(&error))?;
        Ok(parts(found))
    })
}

fn parts<C: Channel>(frame: Option<Frame<'_, C>>) -> (*const C::Header, *const C::Row, usize) {
    frame.map_or((ptr::null(), ptr::null(), 0), |frame| {
        let robots = frame.robots();
        (ptr::from_ref(frame.header()), robots.as_ptr(), robots.len())
    })
}

fn ended(end: End) -> joulebus_end {
    match end {
        End::Ended => joulebus_end::Ended,
        End::Exited => joulebus_end::Exited,
        End::Unreachable => joulebus_end::Unreachable,
        _ => joulebus_end::FoundDead,
    }
}

fn seen(subscriber: &Subscriber) -> joulebus_subscriber_status {
    let (worker, end) = match subscriber.worker() {
        WorkerState::Waiting => (joulebus_worker::Waiting, joulebus_end::None),
        WorkerState::Alive => (joulebus_worker::Alive, joulebus_end::None),
        WorkerState::Gone(end) => (joulebus_worker::Gone, ended(end)),
        _ => (joulebus_worker::Stale, joulebus_end::None),
    };
    let counts = subscriber.counts();
    joulebus_subscriber_status {
        worker,
        end,
        frames: counts.frames,
        gaps: counts.gaps,
        ticks_missed: counts.ticks_missed,
        workers: counts.workers,
        degraded: subscriber.degraded(),
        foreign: subscriber.foreign(),
    }
}

fn not_opened(error: impl ToString) -> Failure {
    Failure::new(joulebus_error::Connect, error)
}

pub(crate) fn read_failed(error: &ReadError) -> Failure {
    let text = match error {
        ReadError::Schema { .. } => format!("{error}. {}", version::remedy()),
        _ => error.to_string(),
    };
    Failure::new(joulebus_error::Read, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_of_another_version_is_refused_with_both_and_what_to_install() {
        let refused = read_failed(&ReadError::Schema { found: 3 });
        assert_eq!(refused.code, joulebus_error::Read);
        for part in [
            "schema version 3",
            "allowed is 4",
            concat!("This library is joulebus ", env!("CARGO_PKG_VERSION")),
            "which release to install",
        ] {
            assert!(refused.text.contains(part), "{}", refused.text);
        }
    }
}
