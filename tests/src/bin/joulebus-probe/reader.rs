//! Readers that report everything they read.

use std::sync::atomic::Ordering;

use joulebus_bus::{Bus, FrameBuf, PeerWatch, Reader, clock};
use joulebus_config::Config;
use joulebus_tests::{FrameRead, ReaderLine, is_whole};
use joulebus_wire::{Budgets, Channel, Diagnostics, Forecasts};

use crate::{Done, print_line, stop_with_stdin};

const POLL_INTERVAL_NS: u64 = 20_000_000;

pub(crate) fn plan(config: &Config) -> Done {
    let stop = stop_with_stdin();
    let limits = config.limits();
    let bus = Bus::join(&config.domain()?, "planner")?;
    let mut waiter = bus.planner_waiter(&limits)?;
    let mut ports = Ports {
        forecasts: bus.reader(&limits)?,
        diagnostics: bus.reader(&limits)?,
        budgets: bus.reader(&limits)?,
    };
    print_line(&ReaderLine::Ready)?;
    let mut worker: Option<(u32, PeerWatch)> = None;
    while !stop.load(Ordering::Relaxed) {
        let until_ns = clock::monotonic_ns() + POLL_INTERVAL_NS;
        let watched = worker.as_ref().map(|(_, watch)| watch);
        let woken = waiter.wait_until(Some(until_ns), watched)?;
        let now_ns = clock::monotonic_ns();
        // The next call may succeed; a planner must not give up at the first error.
        let newest = match ports.print_frames() {
            Ok(newest) => newest,
            Err(error) => {
                print_line(&ReaderLine::Failed(error.to_string()))?;
                None
            }
        };
        if woken.ended {
            print_line(&ReaderLine::Ended)?;
        }
        if woken.peer_gone
            && let Some((pid, _)) = worker.take()
        {
            print_line(&ReaderLine::Gone { pid, at_ns: now_ns })?;
            continue;
        }
        let known = worker.as_ref().map(|(pid, _)| *pid);
        if let Some(pid) = newest.filter(|pid| Some(*pid) != known) {
            worker = PeerWatch::open(pid).map(|watch| (pid, watch));
        }
    }
    Ok(())
}

struct Ports {
    forecasts: Reader<Forecasts>,
    diagnostics: Reader<Diagnostics>,
    budgets: Reader<Budgets>,
}

impl Ports {
    /// Reports all available frames; returns the pid of the worker that sent the newest frame.
    fn print_frames(&mut self) -> Result<Option<u32>, Box<dyn std::error::Error>> {
        let newest = print_all(&mut self.forecasts, ReaderLine::Forecasts)?;
        print_all(&mut self.diagnostics, ReaderLine::Diagnostics)?;
        print_all(&mut self.budgets, ReaderLine::Budgets)?;
        Ok(newest.map(|header| header.pid))
    }
}

/// Reports all available frames of a channel; returns the header of the newest.
fn print_all<C: Channel>(
    reader: &mut Reader<C>,
    line: fn(FrameRead<C>) -> ReaderLine,
) -> Result<Option<C::Header>, Box<dyn std::error::Error>> {
    let mut newest = None;
    while let Some(frame) = reader.take_next()? {
        newest = Some(*frame.header());
        let read = FrameRead::new(frame.header(), frame.payload(), clock::monotonic_ns());
        print_line(&line(read))?;
    }
    Ok(newest)
}

/// Reads samples beside the worker and reports whether they are intact.
pub(crate) fn record(config: &Config) -> Done {
    let stop = stop_with_stdin();
    let limits = config.limits();
    let bus = Bus::join(&config.domain()?, "recorder")?;
    let mut waiter = bus.arrivals_waiter(&limits)?;
    let mut samples = bus.sample_reader(&limits)?;
    let mut frame = FrameBuf::new(limits.capacity);
    print_line(&ReaderLine::Ready)?;
    while !stop.load(Ordering::Relaxed) {
        waiter.wait_until(Some(clock::monotonic_ns() + POLL_INTERVAL_NS), None)?;
        loop {
            match samples.take(&mut frame) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    print_line(&ReaderLine::Failed(error.to_string()))?;
                    break;
                }
            }
            let torn = frame.samples().iter().filter(|sample| !is_whole(sample)).count();
            print_line(&ReaderLine::Samples {
                pid: frame.header().pid,
                samples: frame.samples().len(),
                torn: torn + frame.truncated(),
            })?;
        }
    }
    Ok(())
}
