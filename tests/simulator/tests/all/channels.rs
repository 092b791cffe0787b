//! A channel that joulebus does not have, on the simulated host.

use std::path::Path;

use joulebus_testkit_fleets::channels::{Signal, SignalHeader, Signals};
use joulebus_wire::SCHEMA_VERSION;
use simulated_bus::{self as bus, Bus, Domain, Limits, WorkerLock, Writer};
use simulated_host as host;

/// Does `work` as process `pid`.
fn of<T>(pid: u32, work: impl FnOnce() -> T) -> T {
    host::enter(pid, host::USUAL_COST_NS);
    let done = work();
    let _ = host::leave();
    done
}

fn send(writer: &mut Writer<Signals>, tick: u64) -> usize {
    let header = SignalHeader { schema: SCHEMA_VERSION, tick, ..SignalHeader::default() };
    let row = |robot: usize| Signal { robot: robot as u32, ..Signal::default() };
    writer.send(header, 2, row).unwrap()
}

#[test]
fn frames_of_any_channel_reach_readers_and_only_those_of_the_worker_are_read() {
    let (worker, reader, stranger) = (11, 12, 13);
    host::begin(1, 1_000_000_000);
    bus::begin();
    for pid in [worker, reader, stranger] {
        host::begin_life(pid);
    }
    let domain = Domain::new("test", Path::new("/dev/shm/test"), "jbt_").unwrap();
    let limits = Limits::default();
    let open = |pid| {
        of(pid, || {
            let bus = Bus::join(&domain, "member").unwrap();
            bus.writer::<Signals>(&limits).unwrap()
        })
    };
    let _lock = of(worker, || WorkerLock::acquire(&domain).unwrap());
    let (mut ours, mut foreign) = (open(worker), open(stranger));
    // The newest is kept for later readers.
    assert_eq!(of(worker, || send(&mut ours, 1)), 0);
    let mut found = of(reader, || {
        let bus = Bus::join(&domain, "reader").unwrap();
        bus.reader::<Signals>(&limits).unwrap()
    });
    of(worker, || ours.update());
    assert_eq!(of(stranger, || send(&mut foreign, 7)), 1);
    assert_eq!(of(worker, || send(&mut ours, 2)), 1);
    let mut ticks = Vec::new();
    of(reader, || {
        let each = |header: &SignalHeader, rows: &[Signal]| {
            assert_eq!(rows.len(), 2);
            ticks.push(header.tick);
        };
        found.take_all(each).unwrap();
    });
    assert_eq!(ticks, [1, 2]);
    assert_eq!(found.foreign(), 1);
}
