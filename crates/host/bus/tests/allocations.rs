//! After warm-up the thread that uses the ports does not allocate, except for one allocation per
//! loan in iceoryx2.

use std::path::Path;

use joulebus_bus::{Bus, Domain, FrameBuf, Limits, WorkerLock, clock};
use joulebus_testkit::counting;
use joulebus_testkit::counting::allocations;
use joulebus_wire::{Forecast, ForecastHeader, Forecasts, Sample, SampleHeader, WakeEvent};

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;

#[test]
fn only_loans_allocate_and_once_each() {
    let root = format!("/dev/shm/joulebus-allocations-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let limits = Limits { capacity: 100, ..Limits::default() };
    let _lock = WorkerLock::acquire(&domain).unwrap();
    let bus = Bus::join(&domain, "test").unwrap();
    let mut source = bus.sample_writer(&limits, 100).unwrap();
    let mut samples = bus.sample_reader(&limits).unwrap();
    let mut arrivals = bus.arrivals_waiter(&limits).unwrap();
    let mut forecasts = bus.writer::<Forecasts>(&limits).unwrap();
    let mut planner = bus.reader::<Forecasts>(&limits).unwrap();
    let waker = bus.planner_waker(&limits).unwrap();
    let mut wake = bus.planner_waiter(&limits).unwrap();
    let mut frame = FrameBuf::new(100);

    for round in 0..200_u64 {
        let header = SampleHeader::default();
        let sent = allocations(|| {
            source.send(header, 100, |i| Sample::new(i as u32, round, 1)).unwrap();
        });
        let waited = allocations(|| {
            assert!(arrivals.wait_until(None, None).unwrap().frame);
            let soon_ns = clock::monotonic_ns() + 100_000;
            assert!(arrivals.wait_until(Some(soon_ns), None).unwrap().is_nothing());
        });
        let taken = allocations(|| {
            assert!(samples.take(&mut frame).unwrap());
            assert!(!samples.take(&mut frame).unwrap());
        });
        let answered = allocations(|| {
            let mut loan = forecasts.loan(100).unwrap();
            *loan.header_mut() = ForecastHeader::default();
            loan.payload_mut().fill(Forecast::default());
            assert_eq!(loan.send().unwrap(), 1);
            waker.wake(WakeEvent::Frame).unwrap();
        });
        let read = allocations(|| {
            assert!(wake.wait_until(None, None).unwrap().frame);
            assert_eq!(planner.take_latest().unwrap().unwrap().payload().len(), 100);
            assert!(planner.take_latest().unwrap().is_none());
        });
        if round >= 10 {
            assert_eq!([sent, waited, taken, answered, read], [1, 0, 0, 1, 0], "round {round}");
        }
    }
}
