//! What persons state of batteries, beside a worker whose part the test plays.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use joulebus_config::Config;
use joulebus_plan_server::{PlanServer, Statements};
use joulebus_planner::PlanClient;
use joulebus_predictor_worker::Worker;
use joulebus_wire::Statement;

const PATIENCE: Duration = Duration::from_secs(180);

#[test]
fn a_statement_is_confirmed_once_a_tick_has_taken_it_and_refused_if_the_worker_ends_before() {
    let root = PathBuf::from(format!("/dev/shm/joulebus-test-stated-{}", std::process::id()));
    let text = format!(
        "[fleet]\nname = \"stated\"\ncapacity = 2\n\
         [domain]\nroot = \"{}\"\nprefix = \"t_\"\n\
         [ledger]\ncheckpoint = \"\"\n\
         [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-1\"]\n",
        root.display()
    );
    let config = Config::parse(&text, &root.join("nowhere")).unwrap();
    let (stated, statements, taken) = Statements::channel();
    let server = PlanServer::start(&config, Some(stated)).unwrap();
    let worker = Worker::open(&config).unwrap();
    server.serve();
    server.wait_until_open();
    let is_answered = AtomicBool::new(false);
    let state = |statement| {
        let mut client = PlanClient::with_config(&config, "person").unwrap();
        let answer = client.state_battery(1, statement, "ann", PATIENCE);
        is_answered.store(true, Ordering::Release);
        answer.map_err(|error| error.to_string())
    };
    std::thread::scope(|scope| {
        let first = scope.spawn(|| state(Statement::Full));
        assert_eq!(statements.recv_timeout(PATIENCE).unwrap(), (1, Statement::Full));
        // Several periods of a tick.
        std::thread::sleep(Duration::from_millis(200));
        assert!(!is_answered.load(Ordering::Acquire), "no tick has taken it");
        taken.fetch_add(1, Ordering::Release);
        assert_eq!(first.join().unwrap(), Ok(()));
        let [second, third] = [Statement::Exchanged, Statement::Charge(0.5)].map(|statement| {
            let asked = scope.spawn(move || state(statement));
            assert_eq!(statements.recv_timeout(PATIENCE).unwrap(), (1, statement));
            asked
        });
        // The last tick takes one of them.
        taken.fetch_add(1, Ordering::Release);
        let report = server.finish();
        assert_eq!(second.join().unwrap(), Ok(()));
        let refused = third.join().unwrap().unwrap_err();
        assert!(refused.contains("the worker ends: state it again"), "{refused}");
        assert_eq!((report.answered, report.refused.get("Ending")), (2, Some(&1)), "{report:?}");
    });
    let _ = worker.finish();
    let _ = std::fs::remove_dir(&root);
    assert!(!root.exists(), "stale files: {root:?}");
}
