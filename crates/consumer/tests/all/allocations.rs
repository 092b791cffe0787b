//! After warm-up neither a source nor a planner allocates anything of its own: iceoryx2 allocates
//! once per frame sent.

use std::time::Duration;

use joulebus_bus::{Bus, WorkerLock, clock};
use joulebus_consumer::{Config, Event, Subscriber};
use joulebus_publisher::{Publisher, RobotState};
use joulebus_testkit::TestFleet;
use joulebus_testkit::counting::allocations;
use joulebus_wire::{
    Budget, BudgetHeader, Budgets, Forecast, ForecastHeader, Forecasts, SCHEMA_VERSION, WakeEvent,
};

#[test]
fn only_loans_allocate_and_only_once() {
    let fleet = TestFleet::new();
    let config = Config::load(fleet.config()).unwrap();
    let limits = config.limits();
    let mut publisher = Publisher::connect(fleet.config(), "source").unwrap();
    let mut planner = Subscriber::connect(fleet.config()).unwrap();
    let mut budgets = planner.budgets().unwrap();
    let lock = WorkerLock::acquire(&config.domain().unwrap()).unwrap();
    let bus = Bus::join(&config.domain().unwrap(), "worker").unwrap();
    // A reader, whose buffer overflows repeatedly.
    let samples = bus.sample_reader(&limits).unwrap();
    let mut forecasts = bus.writer::<Forecasts>(&limits).unwrap();
    let mut budget_writer = bus.writer::<Budgets>(&limits).unwrap();
    let waker = bus.planner_waker(&limits).unwrap();

    for round in 1..200_u64 {
        let published = allocations(|| {
            let robots = (0..64).map(|robot| RobotState::new(robot).reading(3.0));
            publisher.publish(robots).unwrap();
        });
        let header = ForecastHeader {
            schema: SCHEMA_VERSION,
            pid: std::process::id(),
            worker_epoch: 1,
            tick: round,
            // Never stale, however long this process waits for a processor.
            period_ns: 3_600_000_000_000,
            sent_ns: clock::monotonic_ns(),
            ..ForecastHeader::default()
        };
        // The robots change positions every tick: the table of positions is rebuilt.
        let row = |i| Forecast { robot: ((i as u64 + round) % 64) as u32, ..Forecast::default() };
        forecasts.send(header, 64, row).unwrap();
        let header =
            BudgetHeader { schema: SCHEMA_VERSION, tick: round, ..BudgetHeader::default() };
        budget_writer.send(header, 64, |_| Budget::default()).unwrap();
        waker.wake(WakeEvent::Frame).unwrap();
        let read = allocations(|| {
            let budgets = budgets.latest().unwrap().unwrap();
            assert!(budgets.robot(0).is_some());
            let Event::Frame(frame) = planner.wait_next(Duration::from_secs(60)).unwrap() else {
                panic!("no frame");
            };
            assert_eq!(frame.robot(17).unwrap().robot, 17);
        });
        let waited = allocations(|| {
            let event = planner.wait_next(Duration::from_micros(100)).unwrap();
            assert!(matches!(event, Event::TimedOut));
            assert!(planner.latest().unwrap().is_some());
        });
        if round > 10 {
            assert_eq!([published, read, waited], [1, 0, 0], "round {round}");
        }
    }
    drop((publisher, planner, budgets));
    drop((samples, forecasts, budget_writer, waker, bus));
    drop(lock);
}
