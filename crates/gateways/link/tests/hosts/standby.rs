//! Failover: when the leader's host dies, another host's worker continues, and two never
//! lead at once.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_connect::standby::{SavedState, StandbyFiles};
use joulebus_testkit::{Child, certificates, eventually, free_port};
use rustix::process::Signal;
use serde_json::Value;

use crate::certificates::tls;
use crate::etcd::Etcd;
use crate::host::{Host, free_address};
use crate::namespaces::Wires;
use crate::planner::{Frame, Reader};

/// Time to live of the lease, s. It is longer than a link or etcd may go without a processor on a
/// busy machine: a lease that ends in that time would start a term that the tests do not expect.
/// Together with a takeover and one second it is shorter than the ten seconds for which a standby
/// worker keeps samples.
const TTL_S: u64 = 4;
/// The default, for which the times of takeovers are stated.
pub(crate) const DEFAULT_TTL_S: u64 = 3;
/// Time to live where terms may start at any time: cuts and pauses of some seconds must end leases.
const SHORT_TTL_S: u64 = 2;
/// Maximum time from the end of the lease until another host leads, beside the time for which its
/// processes have no processor.
const TAKEOVER_NS: u64 = 3_000_000_000;
/// Maximum time that a ledger may lose at a takeover, s.
const MAX_LOST_S: f64 = 1.1;
const SECOND_NS: u64 = 1_000_000_000;
pub(crate) const ROBOTS: u32 = 4;
/// Interval between two samples of a robot, s.
const PERIOD_S: f64 = 1.0 / 30.0;
const NAMES: [&str; 2] = ["base-1", "base-2"];

/// Two hosts with a candidate each, and a host with robots and planners.
pub(crate) struct Scene {
    pub(crate) bases: [Host; 2],
    pub(crate) field: Host,
    /// Addresses on which the links of the candidates listen.
    addresses: [String; 2],
    /// Security settings of the three links' files.
    security: [String; 3],
    pub(crate) lease: String,
    pub(crate) wires: Option<Arc<Wires>>,
}

impl Scene {
    /// A scene on this host, without an etcd.
    fn new() -> Self {
        Self::with([Host::new(), Host::new()], Host::new(), [0, 1].map(|_| free_address()))
    }

    /// A scene on this host with an etcd.
    pub(crate) fn with_lease() -> Option<(Self, Etcd)> {
        let port = free_port();
        let etcd = Etcd::start("127.0.0.1", port, copy)?;
        let mut scene = Self::new();
        scene.leased(&etcd, TTL_S, "");
        Some((scene, etcd))
    }

    /// Four hosts with a cable each: two candidates, the robots, and etcd.
    pub(crate) fn wired(ttl_s: u64) -> Option<(Self, Etcd)> {
        let wires = Arc::new(Wires::new(4)?);
        let store = Arc::clone(&wires);
        let etcd = Etcd::start(&Wires::address(3), 2379, move |command| store.within(3, command))?;
        let addresses = [0, 1].map(|at| format!("tcp/{}:7447", Wires::address(at)));
        let mut scene = Self::with([wires.host(0), wires.host(1)], wires.host(2), addresses);
        scene.leased(&etcd, ttl_s, "");
        scene.wires = Some(wires);
        Some((scene, etcd))
    }

    pub(crate) fn with(bases: [Host; 2], field: Host, addresses: [String; 2]) -> Self {
        Self {
            bases,
            field,
            addresses,
            security: std::array::from_fn(|_| "unencrypted = true".to_owned()),
            lease: format!("[lease]\nendpoints = [\"http://127.0.0.1:{}\"]\n", free_port()),
            wires: None,
        }
    }

    fn leased(&mut self, etcd: &Etcd, ttl_s: u64, more: &str) {
        let endpoint = etcd.endpoint();
        self.lease = format!("[lease]\nendpoints = [\"{endpoint}\"]\nttl_s = {ttl_s}\n{more}");
    }

    pub(crate) fn base_file(&self, at: usize) -> String {
        let (name, lease, security) = (NAMES[at], &self.lease, &self.security[at]);
        let (own, other) = (&self.addresses[at], &self.addresses[1 - at]);
        format!(
            "name = \"{name}\"\nworkers = {NAMES:?}\n[network]\nlisten = [\"{own}\"]\nconnect = [\"{other}\"]\n\
             {security}\n[worker]\n[[worker.take]]\nfrom = \"field\"\n{lease}"
        )
    }

    pub(crate) fn base_link(&self, at: usize) -> Child {
        self.bases[at].link(&self.base_file(at))
    }

    /// Starts both candidates' links, and waits until the first worker leads. The second link
    /// starts once it does, because it would take the lease after some 0.6 s.
    pub(crate) fn base_links(&self, workers: &mut [Child; 2]) -> [Child; 2] {
        let first = self.base_link(0);
        workers[0].wait_for_line("ready:");
        [first, self.base_link(1)]
    }

    /// Waits until a standby host has a state of the leader that was taken after this call.
    pub(crate) fn state_crosses_to(&self, at: usize) {
        let now_ns = clock::monotonic_ns();
        eventually("a state has crossed", || self.has_state(at, now_ns));
    }

    /// True if a standby host has a state of the leader that was taken after `after_ns`.
    pub(crate) fn has_state(&self, at: usize, after_ns: u64) -> bool {
        let replica = StandbyFiles::new(&Config::load(self.bases[at].config()).unwrap()).replica;
        SavedState::read(&replica)
            .is_ok_and(|saved| saved.is_some_and(|state| state.taken_ns > after_ns))
    }

    /// Starts a worker, and waits until it stands by.
    pub(crate) fn worker(&self, at: usize) -> Child {
        let words = ["run", "--standby", "--format", "json"];
        let mut worker = Child::spawn(NAMES[at], self.bases[at].joulebus(&words));
        worker.wait_for_line("standing by:");
        worker
    }

    pub(crate) fn field_link(&self) -> Child {
        let (addresses, security) = (&self.addresses, &self.security[2]);
        self.field.link(&format!(
            "name = \"field\"\nworkers = {NAMES:?}\n[network]\nconnect = {addresses:?}\n{security}\n\
             [samples]\n[follow]\n"
        ))
    }

    pub(crate) fn robots(&self) -> Child {
        self.field.robots(&["--format", "json", "--robots", &ROBOTS.to_string()])
    }

    /// The host's permit, as `doctor` shows it.
    fn permit(&self, at: usize) -> String {
        let words = ["doctor", "--format", "json"];
        let shown = Child::spawn("doctor", self.bases[at].joulebus(&words)).wait().json();
        let checks = shown["checks"].as_array().unwrap();
        let permit = checks.iter().find(|check| check["name"] == "permit").unwrap();
        permit["found"].as_str().unwrap().to_owned()
    }

    pub(crate) fn set_cable(&self, host: usize, is_whole: bool) {
        self.wires.as_ref().unwrap().set(host, is_whole);
    }

    fn assert_nothing_is_left(&self) {
        for host in self.bases.iter().chain([&self.field]) {
            assert_eq!(host.stale_files(), Vec::<std::path::PathBuf>::new());
        }
    }
}

pub(crate) fn copy(command: &std::process::Command) -> std::process::Command {
    let mut copied = std::process::Command::new(command.get_program());
    copied.args(command.get_args());
    copied
}

/// True if all robots have a forecast of a sample that was taken after `after_ns`.
pub(crate) fn is_fresh(frame: &Frame, after_ns: u64) -> bool {
    let fresh = frame.rows.iter().filter(|row| row.has_power && row.stamp_ns > after_ns);
    let robots: BTreeSet<u32> = fresh.map(|row| row.robot).collect();
    robots == (0..ROBOTS).collect()
}

/// Reads on until all robots have a forecast of a sample taken after `after_ns`.
pub(crate) fn fresh_after(planner: &mut Reader, after_ns: u64) -> Frame {
    loop {
        let frame = planner.frame();
        if is_fresh(&frame, after_ns) {
            return frame;
        }
    }
}

pub(crate) fn fresh(planner: &mut Reader) -> Frame {
    fresh_after(planner, clock::monotonic_ns())
}

/// A robot's ledger up to a sample, J and s.
#[derive(Debug, Clone, Copy)]
struct Account {
    stamp_s: f64,
    drawn_j: f64,
    metered_s: f64,
    unmetered_s: f64,
}

impl Account {
    /// Reads an account. `None` while its budget is missing.
    fn new(robot: &Value) -> Option<Self> {
        Some(Self {
            stamp_s: robot["stamp_ns"].as_f64()? * 1e-9,
            drawn_j: robot["drawn_j"].as_f64()?,
            metered_s: robot["metered_s"].as_f64()?,
            unmetered_s: robot["unmetered_s"].as_f64()?,
        })
    }
}

/// A host's ledgers of all robots.
fn accounts(host: &Host) -> Vec<Account> {
    let mut accounts = Vec::new();
    eventually("the accounts of all robots", || {
        let report = host.watched().unwrap_or_default();
        let robots = report["robots"].as_array().into_iter().flatten();
        accounts = robots.filter_map(Account::new).collect();
        accounts.len() == ROBOTS as usize
    });
    accounts
}

/// Upper bound of the unmetered time that is due to processes that had no processor, s: robots that
/// skipped ticks, links and workers that lost samples. Ends the robots. The time between two
/// consecutive samples is metered.
fn unsampled_s(robots: &mut Child, planner: Reader) -> f64 {
    let skipped = robots.end().json()["ticks_skipped"].as_f64().unwrap();
    let frames = planner.all_frames();
    let dropped: BTreeMap<u64, u64> =
        frames.iter().map(|frame| (frame.epoch, frame.dropped)).collect();
    let dropped = dropped.values().sum::<u64>() as f64 / f64::from(ROBOTS);
    // From the sample before each missing one to the sample after it.
    2.0 * (skipped + dropped) * PERIOD_S
}

/// For how long each thread of some processes was ready to run and had no processor, ns.
pub(crate) struct Unscheduled {
    pids: Vec<u32>,
    before_ns: BTreeMap<PathBuf, u64>,
}

impl Unscheduled {
    pub(crate) fn of(pids: Vec<u32>) -> Self {
        let before_ns = Self::now_ns(&pids);
        Self { pids, before_ns }
    }

    fn now_ns(pids: &[u32]) -> BTreeMap<PathBuf, u64> {
        let threads = pids.iter().flat_map(|pid| fs::read_dir(format!("/proc/{pid}/task")));
        let waited = threads.flatten().flatten().filter_map(|thread| {
            let counts = fs::read_to_string(thread.path().join("schedstat")).ok()?;
            Some((thread.path(), counts.split(' ').nth(1)?.parse().ok()?))
        });
        waited.collect()
    }

    /// The sum over all threads since the begin.
    pub(crate) fn since_ns(&self) -> u64 {
        let before_ns = |at| self.before_ns.get(at).copied().unwrap_or(0);
        // A new thread may have the number of one that has ended.
        Self::now_ns(&self.pids).iter().map(|(at, ns)| ns.saturating_sub(before_ns(at))).sum()
    }
}

/// Asserts that a takeover took no longer than promised, on processes that are scheduled.
fn assert_in_time(took_ns: u64, unscheduled: &Unscheduled) {
    let most_ns = TTL_S * SECOND_NS + TAKEOVER_NS + unscheduled.since_ns();
    assert!(took_ns < most_ns, "{took_ns}: {most_ns}");
}

/// Asserts that the accounts of now continue those of before: at most [`MAX_LOST_S`] beside the
/// time without samples is unmetered.
fn assert_continues((before, now): &(Vec<Account>, Vec<Account>), gaps_s: f64) {
    assert_eq!((before.len(), now.len()), (ROBOTS as usize, ROBOTS as usize));
    for (before, now) in before.iter().zip(now) {
        let both = format!("{before:?}, {now:?}");
        assert!(now.drawn_j > before.drawn_j, "{both}");
        assert!(now.metered_s > before.metered_s, "{both}");
        let unmetered_s = now.unmetered_s - before.unmetered_s;
        let most_s = MAX_LOST_S + gaps_s;
        assert!((0.0..most_s).contains(&unmetered_s), "{both}: {most_s}");
        let time_s = now.metered_s - before.metered_s + unmetered_s;
        // By the stamps of the samples, because a reported sample may be a second earlier or later.
        let between_s = now.stamp_s - before.stamp_s;
        let allowed_s = between_s - 1.0..=between_s + 1.0;
        assert!(allowed_s.contains(&time_s), "{both}: {allowed_s:?}");
    }
}

/// Asserts that frames in the order of sending never return to an earlier run: workers do not
/// alternate.
fn assert_one_sent_at_a_time(planners: Vec<Reader>) {
    let mut sent = Vec::new();
    for (at, planner) in planners.into_iter().enumerate() {
        let frames = planner.all_frames();
        sent.extend(frames.iter().map(|frame| (frame.sent_ns, at, frame.epoch)));
    }
    sent.sort_unstable();
    let mut turns: Vec<(usize, u64)> = sent.iter().map(|(_, at, epoch)| (*at, *epoch)).collect();
    turns.dedup();
    let distinct: BTreeSet<&(usize, u64)> = turns.iter().collect();
    assert_eq!(distinct.len(), turns.len(), "{turns:?}");
    assert!(!turns.is_empty());
}

/// Waits until the worker logs that its permit has run out, and ends.
fn assert_gave_way(worker: &mut Child, term: u64) {
    let ended = worker.wait();
    assert_eq!(ended.code(), Some(1), "{ended:?}");
    let why = format!("the permit to serve in term {term} has ended");
    assert!(ended.errors().contains(&why), "{ended:?}");
}

#[test]
fn when_the_host_that_serves_dies_another_goes_on_within_its_bound_with_warm_windows_and_whole_ledgers()
 {
    let Some((scene, etcd)) = Scene::with_lease() else {
        return;
    };
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let mut links = scene.base_links(&mut workers);
    let mut field = scene.field_link();
    let mut robots = scene.robots();
    let mut planner = scene.field.planner();
    fresh(&mut planner);
    // The other candidate has the leader's state.
    scene.state_crosses_to(1);
    fresh(&mut planner);
    let before = accounts(&scene.field);
    let chain = [links[1].pid(), workers[1].pid(), field.pid(), etcd.pid(), planner.pid()];
    let unscheduled = Unscheduled::of(chain.into());
    let killed_ns = clock::monotonic_ns();
    links[0].kill();
    workers[0].kill();
    let frame = fresh_after(&mut planner, killed_ns);
    let took_ns = frame.read_ns - killed_ns;
    println!("figure: takeover, lease {TTL_S} s: {:.2} s after the kill", took_ns as f64 * 1e-9);
    assert_in_time(took_ns, &unscheduled);
    workers[1].wait_for_line("ready:");
    fresh(&mut planner);
    let over = (before, accounts(&scene.field));
    // The first host returns as a standby.
    let mut first = scene.worker(0);
    let mut link = scene.base_link(0);
    std::thread::sleep(Duration::from_secs(TTL_S + 1));
    fresh(&mut planner);
    assert_continues(&over, unsampled_s(&mut robots, planner));
    let first = first.end();
    assert_eq!((first.code(), &first.json()["ticks"]), (Some(0), &Value::from(0)), "{first:?}");
    assert!(!first.errors().contains("ready:"), "{first:?}");
    let report = field.end().json();
    let served: Vec<u64> = report["taken"]
        .as_array()
        .unwrap()
        .iter()
        .map(|taken| taken["frames"].as_u64().unwrap())
        .collect();
    assert!(served.iter().all(|frames| *frames > 0), "{report}");
    link.end();
    links[1].end();
    workers[1].end();
    scene.assert_nothing_is_left();
}

/// Verifies a host's recording, and returns the number of runs of the worker in it. On a busy machine
/// a recorder may lose messages, which it reports, and then the verification does not pass.
fn verified_runs(host: &Host, file: &Path, mut recorder: Child) -> u64 {
    let recorded = recorder.end();
    let words = ["replay", "--verify", "--format", "json", file.to_str().unwrap()];
    let verified = Child::spawn("verify", host.bare_joulebus(&words)).wait();
    let report = verified.json();
    let is_whole = recorded.code() == Some(0);
    assert!(is_whole || recorded.code() == Some(3), "{recorded:?}");
    assert_eq!(report["differences"], 0, "{report:#}");
    if is_whole {
        assert_eq!(
            (verified.code(), &report["verdict"]),
            (Some(0), &"verified".into()),
            "{report:#}"
        );
    }
    for run in report["coverage"].as_array().unwrap() {
        let forecasts = &run["channels"]["forecasts"];
        assert!(forecasts["compared"].as_u64() > Some(10), "{report:#}");
    }
    report["runs"].as_u64().unwrap()
}

#[test]
fn recordings_of_both_hosts_are_verified_across_kills_and_takeovers() {
    let Some((scene, _etcd)) = Scene::with_lease() else {
        return;
    };
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let mut links = scene.base_links(&mut workers);
    let folder = tempfile::tempdir().unwrap();
    let files = NAMES.map(|name| folder.path().join(format!("{name}.mcap")));
    let [first, second] = [0, 1].map(|at: usize| {
        let words = ["record", "--format", "json", "-o", files[at].to_str().unwrap()];
        let mut recorder = Child::spawn("record", scene.bases[at].joulebus(&words));
        recorder.wait_for_line("recording lab into");
        recorder
    });
    let _field = scene.field_link();
    let _robots = scene.robots();
    let mut planner = scene.field.planner();
    fresh(&mut planner);
    // The first host leads, then the second, then the first again with the state of the second.
    for leader in [0, 1] {
        scene.state_crosses_to(1 - leader);
        links[leader].kill();
        workers[leader].kill();
        let killed_ns = clock::monotonic_ns();
        fresh_after(&mut planner, killed_ns);
        workers[1 - leader].wait_for_line("ready:");
        workers[leader] = scene.worker(leader);
        links[leader] = scene.base_link(leader);
    }
    fresh(&mut planner);
    // Longer than two keyframes are apart.
    std::thread::sleep(Duration::from_secs(6));
    planner.leave();
    assert_eq!(verified_runs(&scene.bases[0], &files[0], first), 2);
    assert_eq!(verified_runs(&scene.bases[1], &files[1], second), 1);
}

#[test]
fn a_worker_that_is_cut_off_with_its_planners_is_silent_before_another_sends_and_serves_again_when_that_one_is_stopped()
 {
    let Some((scene, etcd)) = Scene::wired(TTL_S) else {
        return;
    };
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let links = scene.base_links(&mut workers);
    let field = scene.field_link();
    let mut robots = scene.robots();
    let mut planner = scene.field.planner();
    let mut beside = vec![scene.bases[0].planner(), scene.bases[1].planner()];
    fresh(&mut planner);
    // The planner on that host must have read a frame to be notified of the worker's end.
    fresh(&mut beside[0]);
    scene.state_crosses_to(1);
    let before = accounts(&scene.field);
    let chain = [links[1].pid(), workers[1].pid(), field.pid(), etcd.pid(), planner.pid()];
    let unscheduled = Unscheduled::of(chain.into());
    scene.set_cable(0, false);
    // Frames sent before the cut belong to the host that is cut off.
    let cut_ns = clock::monotonic_ns();
    assert_eq!(beside[0].gone(), "Ended");
    assert_gave_way(&mut workers[0], 1);
    let took_ns = fresh_after(&mut planner, cut_ns).read_ns - cut_ns;
    println!("figure: takeover, lease {TTL_S} s: {:.2} s after the cut", took_ns as f64 * 1e-9);
    assert_in_time(took_ns, &unscheduled);
    fresh(&mut planner);
    let cut_off = (before, accounts(&scene.field));
    // The first host returns while another leads: it stands by and follows.
    workers[0] = scene.worker(0);
    scene.set_cable(0, true);
    std::thread::sleep(Duration::from_secs(TTL_S + 1));
    scene.state_crosses_to(0);
    let before = accounts(&scene.field);
    workers[1].end();
    workers[0].wait_for_line("ready:");
    fresh(&mut planner);
    let stopped = (before, accounts(&scene.field));
    assert!(fresh(&mut beside[0]).epoch > 0);
    let gaps_s = unsampled_s(&mut robots, planner);
    for over in [cut_off, stopped] {
        assert_continues(&over, gaps_s);
    }
    assert_one_sent_at_a_time(beside);
}

#[test]
fn etcd_is_reached_with_certificates_of_its_authority_and_with_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    if !certificates(&own, 30, &["etcd", "base-1"]) {
        return;
    }
    certificates(&other, 30, &["base-1"]);
    let with = Some(own.clone());
    let Some(etcd) = Etcd::start_with("127.0.0.1", free_port(), copy, with) else {
        return;
    };
    for (ca, certificate, is_let_in) in
        [(&own, &own, true), (&own, &other, false), (&other, &own, false)]
    {
        let mut scene = Scene::new();
        let path = |folder: &Path, name: &str| folder.join(name).display().to_string();
        let more = format!(
            "ca = {:?}\ncertificate = {:?}\nkey = {:?}\n",
            path(ca, "fleet-ca.pem"),
            path(certificate, "base-1.pem"),
            path(certificate, "base-1.key")
        );
        scene.leased(&etcd, TTL_S, &more);
        let mut worker = scene.worker(0);
        let mut link = scene.base_link(0);
        if is_let_in {
            worker.wait_for_line("ready:");
        } else {
            // The message may come before the link logs that it is open.
            eventually("it is logged", || link.errors().contains("etcd does not answer"));
        }
        link.end();
        let worker = worker.end();
        assert_eq!(worker.errors().contains("ready:"), is_let_in, "{worker:?}");
    }
}

#[test]
fn states_and_terms_are_taken_under_the_name_in_the_certificate_alone() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base-1", "base-2", "field", "desk"]) {
        return;
    }
    let Some((mut scene, etcd)) = Scene::with_lease() else {
        return;
    };
    for address in &mut scene.addresses {
        *address = address.replacen("tcp", "tls", 1);
    }
    scene.security = ["base-1", "base-2", "field"].map(|name| tls(folder.path(), name));
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let mut links = scene.base_links(&mut workers);
    let _field = scene.field_link();
    let _robots = scene.robots();
    // The candidates receive states and terms from each other.
    for at in [0, 1] {
        scene.state_crosses_to(1 - at);
        workers[at].kill();
        workers[1 - at].wait_for_line("ready:");
        workers[at] = scene.worker(at);
    }
    scene.state_crosses_to(1);
    links[1].end();
    // Another store lets the other candidate lead, in a far greater term.
    scene.lease.push_str("prefix = \"other/\"\n");
    let [key, term] = ["other/lab/term", "100"].map(|text| BASE64.encode(text));
    etcd.post("kv/put", &format!("{{\"key\": \"{key}\", \"value\": \"{term}\"}}"));
    // A planners' host that uses its name changes nothing. The candidate itself does.
    scene.security[1] = tls(folder.path(), "desk");
    links[1] = scene.base_link(1);
    workers[1].wait_for_line("ready:");
    std::thread::sleep(Duration::from_secs(3));
    assert!(workers[0].is_running(), "{}", workers[0].errors());
    assert!(scene.permit(0).starts_with("to serve in term 3, "), "{}", scene.permit(0));
    links[1].end();
    scene.security[1] = tls(folder.path(), "base-2");
    links[1] = scene.base_link(1);
    assert_gave_way(&mut workers[0], 3);
}

#[test]
fn while_no_robot_sends_the_one_that_serves_goes_on_also_with_a_link_that_starts_again() {
    let Some((scene, _etcd)) = Scene::with_lease() else {
        return;
    };
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let mut links = scene.base_links(&mut workers);
    std::thread::sleep(Duration::from_secs(12));
    // A link that starts again goes on with the permit.
    links[0].kill();
    links[0] = scene.base_link(0);
    std::thread::sleep(Duration::from_secs(TTL_S + 1));
    assert!(scene.permit(0).starts_with("to serve in term 1, "), "{}", scene.permit(0));
    let [first, second] = &mut workers;
    assert!(first.is_running(), "{}", first.errors());
    assert!(!second.errors().contains("ready:"), "{}", second.errors());
}

#[test]
fn a_worker_without_standby_is_reported_and_not_followed_elsewhere() {
    let scene = Scene::new();
    let _worker = scene.bases[0].worker();
    let link = scene.base_link(0);
    let mut field = scene.field_link();
    let _robots = scene.robots();
    // The message may come before the link logs that it is open.
    eventually("it is logged", || link.errors().contains("start it with --standby"));
    let report = field.end().json();
    let frames = report["taken"].as_array().unwrap().iter().map(|taken| &taken["frames"]);
    assert!(frames.clone().all(|frames| *frames == 0), "{report}");
}

#[test]
fn etcd_with_users_and_passwords_is_logged_into_and_a_wrong_password_is_reported() {
    let port = free_port();
    let Some(etcd) = Etcd::start("127.0.0.1", port, copy) else {
        return;
    };
    for (verb, body) in [
        ("auth/user/add", r#"{"name": "root", "password": "for-the-test"}"#),
        ("auth/role/add", r#"{"name": "root"}"#),
        ("auth/user/grant", r#"{"user": "root", "role": "root"}"#),
        ("auth/enable", "{}"),
    ] {
        etcd.post(verb, body);
    }
    let folder = tempfile::tempdir().unwrap();
    let password = folder.path().join("password");
    for text in ["for-the-test\n", "another\n"] {
        fs::write(&password, text).unwrap();
        fs::set_permissions(&password, fs::Permissions::from_mode(0o600)).unwrap();
        let mut scene = Scene::new();
        scene.leased(&etcd, TTL_S, &format!("user = \"root\"\npassword = {password:?}\n"));
        let mut worker = scene.worker(0);
        let mut link = scene.base_link(0);
        if text.starts_with("for") {
            worker.wait_for_line("ready:");
        } else {
            eventually("it is logged", || link.errors().contains("authentication failed"));
        }
        link.end();
        worker.end();
        scene.assert_nothing_is_left();
    }
}

fn hang(process: &mut Child, time: Duration, what: &'static str) -> &'static str {
    process.signal(Signal::STOP);
    std::thread::sleep(time);
    process.signal(Signal::CONT);
    what
}

/// Number of faults in the gate. The variable allows more.
const FAULTS: usize = 6;
const MORE: &str = "JOULEBUS_LINK_FAULTS";

/// A pseudo-random sequence that is the same in every run.
pub(crate) struct Chance(pub(crate) u64);

impl Chance {
    pub(crate) fn below(&mut self, most: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % most
    }

    pub(crate) fn while_s(&mut self, most_ms: u64) -> Duration {
        Duration::from_millis(50 + self.below(most_ms))
    }
}

/// The two hosts under a supervisor that restarts what has ended, and the faults.
struct Supervised {
    scene: Scene,
    etcd: Etcd,
    workers: [Child; 2],
    links: [Child; 2],
    field: Child,
    /// Number of workers that ended because their permit had run out.
    gave_way: u64,
}

impl Supervised {
    fn fault(&mut self, chance: &mut Chance) -> &'static str {
        let at = usize::from(chance.below(2) == 1);
        let short = chance.while_s(900);
        let long = chance.while_s(4_000);
        match chance.below(10) {
            0 => self.cut(at, short, "a short cut of a worker's host"),
            1 => self.cut(at, long, "a cut of a worker's host"),
            2 => self.cut(2, long, "a cut of the robots' host"),
            3 => self.cut(3, long, "a cut of etcd's host"),
            4 => {
                self.workers[at].kill();
                "a worker killed"
            }
            5 => {
                self.links[at].kill();
                std::thread::sleep(short);
                "a worker's link killed"
            }
            6 => {
                for process in [&mut self.workers[at], &mut self.links[at]] {
                    process.signal(Signal::STOP);
                }
                std::thread::sleep(long);
                for process in [&mut self.links[at], &mut self.workers[at]] {
                    process.signal(Signal::CONT);
                }
                "a worker's host stopped"
            }
            7 => hang(&mut self.workers[at], long, "a worker alone stopped"),
            8 => hang(&mut self.links[at], long, "a worker's link alone stopped"),
            _ => {
                self.etcd.kill();
                std::thread::sleep(short);
                self.etcd.again();
                "etcd killed"
            }
        }
    }

    fn cut(&self, host: usize, time: Duration, what: &'static str) -> &'static str {
        self.scene.set_cable(host, false);
        std::thread::sleep(time);
        self.scene.set_cable(host, true);
        what
    }

    /// Restarts what has ended.
    fn supervise(&mut self) {
        for at in 0..2 {
            if !self.workers[at].is_running() {
                let ended = self.workers[at].wait();
                let killed = ended.signal().is_some();
                assert!(killed || ended.code() == Some(1), "{ended:?}");
                self.gave_way += u64::from(!killed);
                assert!(killed || ended.errors().contains("the permit to serve"), "{ended:?}");
                self.workers[at] = self.scene.worker(at);
            }
            if !self.links[at].is_running() {
                let ended = self.links[at].wait();
                assert!(ended.signal().is_some(), "{ended:?}");
                self.links[at] = self.scene.base_link(at);
            }
        }
    }

    /// Reads until the fleet is served again.
    fn settles(&mut self, planner: &mut Reader, last: &mut (u64, u64), fault: &str) {
        // A fault's effect may come late, for instance the end of the permit of a host that was cut
        // off.
        for _ in 0..2 {
            let now_ns = clock::monotonic_ns();
            loop {
                self.supervise();
                let Some(frame) = planner.frame_within(Duration::from_millis(200)) else {
                    continue;
                };
                let place = (frame.epoch, frame.tick);
                assert!(place > *last, "after {fault}: {last:?}, then {place:?}");
                assert!(frame.sent_ns <= frame.read_ns, "after {fault}: from the future");
                *last = place;
                if is_fresh(&frame, now_ns) {
                    break;
                }
            }
            std::thread::sleep(Duration::from_millis(300));
        }
    }
}

#[test]
fn through_cuts_kills_and_stops_no_two_workers_send_and_no_account_loses_what_it_had() {
    let Some((scene, etcd)) = Scene::wired(SHORT_TTL_S) else {
        return;
    };
    let workers = [0, 1].map(|at| scene.worker(at));
    let links = [0, 1].map(|at| scene.base_link(at));
    let field = scene.field_link();
    let mut all = Supervised { scene, etcd, workers, links, field, gave_way: 0 };
    let _robots = all.scene.robots();
    let mut planner = all.scene.field.planner();
    let beside = vec![all.scene.bases[0].planner(), all.scene.bases[1].planner()];
    let (mut chance, mut last) = (Chance(11), (0, 0));
    let faults = std::env::var(MORE).map_or(FAULTS, |count| count.parse().unwrap());
    all.settles(&mut planner, &mut last, "the start");
    let (mut before, mut lost_s) = (accounts(&all.scene.field), 0.0_f64);
    for at in 0..faults {
        let fault = all.fault(&mut chance);
        all.settles(&mut planner, &mut last, fault);
        let now = accounts(&all.scene.field);
        for (before, now) in before.iter().zip(&now) {
            let lost = [
                before.metered_s + before.unmetered_s - now.metered_s - now.unmetered_s,
                before.metered_s - now.metered_s,
            ];
            lost_s = lost.into_iter().fold(lost_s, f64::max);
            assert!(lost_s < MAX_LOST_S, "after {fault}: {before:?}, {now:?}");
        }
        before = now;
        if faults > FAULTS {
            println!("figure: {} of {faults}: {fault}", at + 1);
        }
    }
    let gave_way = all.gave_way;
    println!(
        "figure: {faults} faults, {gave_way} workers gave way, at most {lost_s:.2} s of an account went back"
    );
    planner.leave();
    assert_one_sent_at_a_time(beside);
    all.field.end();
}
