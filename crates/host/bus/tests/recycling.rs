//! Planners and sources join and leave during a worker's life, and leave nothing behind: no
//! descriptor, no object in shared memory, no file. `JOULEBUS_LIVES=50000` for a long run. Alone in
//! its process, whose descriptors it counts.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use joulebus_bus::{Bus, Domain, FrameBuf, Limits, WorkerLock};
use joulebus_wire::{Forecast, ForecastHeader, Forecasts, Sample, SampleHeader};

/// Default number of planners and sources in turn; many times the limits of the services.
const LIVES: u64 = 400;

fn files(directory: &Path) -> usize {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => files(&entry.path()),
            _ => 1,
        })
        .sum()
}

/// Descriptors of this process, objects in shared memory, and files of the domain.
fn held(domain: &Domain) -> (usize, usize, usize) {
    let objects = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    let objects = objects.filter(|entry| {
        let name = entry.file_name();
        name.to_string_lossy().starts_with(domain.shm_prefix())
    });
    let descriptors = fs::read_dir("/proc/self/fd").into_iter().flatten();
    (descriptors.count(), objects.count(), files(&domain.directory()))
}

/// [`held`] without what is open for a moment only.
fn least(domain: &Domain) -> (usize, usize, usize) {
    let several = (0..50).map(|_| {
        std::thread::sleep(Duration::from_millis(1));
        held(domain)
    });
    several.min().unwrap()
}

#[test]
fn planners_and_sources_that_leave_give_back_every_descriptor_object_and_file() {
    let root = format!("/dev/shm/joulebus-recycling-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let limits = Limits { capacity: 4, max_sources: 2, max_planners: 2, ..Limits::default() };
    let lives: u64 = std::env::var("JOULEBUS_LIVES").map_or(LIVES, |text| text.parse().unwrap());
    let lock = WorkerLock::acquire(&domain).unwrap();
    let bus = Bus::join(&domain, "worker").unwrap();
    let mut forecasts = bus.writer::<Forecasts>(&limits).unwrap();
    let mut samples = bus.sample_reader(&limits).unwrap();
    let mut frame = FrameBuf::new(4);
    let mut before = None;
    for life in 0..lives {
        let member = Bus::join(&domain, "guest").unwrap();
        let mut planner = member.reader::<Forecasts>(&limits).unwrap();
        let mut source = member.sample_writer(&limits, 4).unwrap();
        let header = ForecastHeader { tick: life, ..ForecastHeader::default() };
        forecasts.send(header, 4, |_| Forecast::default()).unwrap();
        let tick = planner.take_latest().unwrap().map(|frame| frame.header().tick);
        assert_eq!(tick, Some(life));
        source.send(SampleHeader::default(), 4, |_| Sample::new(1, life, 1)).unwrap();
        assert!(samples.take(&mut frame).unwrap(), "life {life}");
        assert_eq!(frame.samples()[0].seq, life);
        drop((planner, source, member));
        // Connections to removed ports are closed by the next send.
        forecasts.send(header, 4, |_| Forecast::default()).unwrap();
        assert!(!samples.take(&mut frame).unwrap());
        if life > 2 * (limits.max_sources + limits.max_planners) as u64 {
            let before = *before.get_or_insert_with(|| least(&domain));
            // The thread that looks for removed files opens directories for a moment.
            let give_up = Instant::now() + Duration::from_secs(60);
            loop {
                let now = held(&domain);
                if now == before {
                    break;
                }
                assert!(Instant::now() < give_up, "life {life}: {before:?} {now:?}");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
    drop((forecasts, samples, bus, lock));
    assert!(!Path::new(&root).exists());
}
