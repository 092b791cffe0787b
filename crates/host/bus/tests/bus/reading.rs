//! Reading all queued frames.

use std::path::Path;

use joulebus_bus::{Bus, Domain, Limits, WorkerLock};
use joulebus_wire::{Forecast, ForecastHeader, Forecasts};

#[test]
fn a_writer_that_is_faster_than_its_reader_does_not_keep_it_for_ever() {
    let root = format!("/dev/shm/joulebus-reading-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let limits = Limits::default();
    let lock = WorkerLock::acquire(&domain).unwrap();
    let bus = Bus::join(&domain, "worker").unwrap();
    let mut writer = bus.writer::<Forecasts>(&limits).unwrap();
    let mut reader = bus.reader::<Forecasts>(&limits).unwrap();
    let mut ticks = 0;
    let mut send = || {
        ticks += 1;
        let header = ForecastHeader {
            tick: ticks,
            ..ForecastHeader::default()
        };
        writer.send(header, 1, |_| Forecast::default()).unwrap();
    };
    send();
    let mut read = Vec::new();
    reader
        .take_all(|header, _| {
            read.push(header.tick);
            // With each frame that is read two more arrive.
            send();
            send();
        })
        .unwrap();
    assert!(read.len() < 100 && read.is_sorted(), "{read:?}");
    drop((writer, reader, bus, lock));
    assert!(!Path::new(&root).exists());
}
