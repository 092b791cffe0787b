//! Simulated candidates with clocks of their own, a store with its clock, and a network that
//! delays, loses and partitions.

use proptest::prelude::*;

use super::store::Store;
use super::*;

const TTL_NS: u64 = 3_000_000_000;
const STEP_NS: u64 = 10_000_000;
/// By how much a clock is fast or slow at most: the slew of `chrony` by default, and the crystal.
const MAX_PPM: i64 = 83_433;
/// Timeout of a call, as the link's client has it.
const CALL_NS: u64 = 400_000_000;

/// Conditions of a candidate for a span of time.
#[derive(Debug, Clone, Copy)]
struct Weather {
    /// Minimum and maximum delay of requests and replies.
    delay_ns: (u64, u64),
    is_cut: bool,
    /// The process is paused.
    is_paused: bool,
    /// The link is killed and starts again.
    restarts: bool,
}

#[derive(Debug)]
struct Host {
    name: String,
    candidate: Candidate,
    /// Start of its own clock, and how much faster than true time it runs, ppm.
    begun_ns: u64,
    ppm: i64,
    /// The call in flight: what, when it was made by the own clock, the true times of arrival at
    /// the store and back, and the reply.
    under_way: Option<(Call, u64, u64, u64, Option<Reply>)>,
    /// Calls that were given up, and when they arrive at the store.
    given_up: Vec<(Call, u64)>,
    terms: Vec<u64>,
    highest_term: u64,
}

impl Host {
    fn clock(&self, true_ns: u64) -> u64 {
        let fast = i128::from(true_ns) * i128::from(self.ppm) / 1_000_000;
        (i128::from(true_ns) + fast) as u64 + self.begun_ns
    }

    fn step(&mut self, store: &mut Store, store_ns: u64, true_ns: u64, weather: Weather) {
        if let Some((call, _, arrives_ns, _, reply)) = &mut self.under_way
            && reply.is_none()
            && true_ns >= *arrives_ns
            && !weather.is_cut
        {
            *reply = Some(store.answer(&self.name, call, store_ns, TTL_NS));
        }
        if !weather.is_cut {
            for (call, _) in self.given_up.extract_if(.., |(_, arrives_ns)| true_ns >= *arrives_ns)
            {
                store.answer(&self.name, &call, store_ns, TTL_NS);
            }
        }
        if weather.is_paused {
            return;
        }
        let now_ns = self.clock(true_ns);
        if weather.restarts {
            // The permit's file keeps the right across a restart.
            let leader_lease = self.candidate.leader_lease(now_ns);
            let rank = self.candidate.rank as usize;
            self.candidate = Candidate::new(&self.name, rank, TTL_NS, leader_lease);
            self.candidate.observe_term(self.highest_term);
            self.give_up();
        }
        if let Some((call, asked_ns, _, back_ns, reply)) = self.under_way.clone() {
            let is_late = now_ns.saturating_sub(asked_ns) > CALL_NS;
            let reply = reply.filter(|_| true_ns >= back_ns && !weather.is_cut);
            match reply {
                Some(reply) => self.candidate.answered(&call, reply, (asked_ns, now_ns)),
                None if is_late => {
                    self.candidate.answered(&call, Reply::Failed, (asked_ns, now_ns));
                }
                None => return,
            }
            self.give_up();
        }
        if let Next::Call(call) = self.candidate.next(now_ns) {
            let arrives_ns = true_ns + weather.delay_ns.0;
            let back_ns = arrives_ns + weather.delay_ns.1;
            self.under_way = Some((call, now_ns, arrives_ns, back_ns, None));
        }
    }

    fn give_up(&mut self) {
        let call = self.under_way.take();
        let unanswered = call.filter(|(.., reply)| reply.is_none());
        self.given_up.extend(unanswered.map(|(call, _, arrives_ns, ..)| (call, arrives_ns)));
    }

    fn observe_term(&mut self, term: u64) {
        self.highest_term = term;
        self.candidate.observe_term(term);
    }

    fn leader_lease(&mut self, true_ns: u64) -> Option<LeaderLease> {
        let leader_lease = self.candidate.leader_lease(self.clock(true_ns))?;
        if self.terms.last() != Some(&leader_lease.term) {
            self.terms.push(leader_lease.term);
        }
        Some(leader_lease)
    }
}

fn hosts(count: usize, ppm: &[i64]) -> Vec<Host> {
    (0..count)
        .map(|at| Host {
            name: format!("host-{at}"),
            candidate: Candidate::new(&format!("host-{at}"), at, TTL_NS, None),
            begun_ns: at as u64 * 7_000_000_000_000,
            ppm: ppm[at],
            under_way: None,
            given_up: Vec::new(),
            terms: Vec::new(),
            highest_term: 0,
        })
        .collect()
}

fn weather() -> impl Strategy<Value = Weather> {
    let delay =
        || prop_oneof![4 => 0u64..20_000_000, 2 => 0u64..500_000_000, 1 => 0u64..5_000_000_000];
    (
        delay(),
        delay(),
        prop::bool::weighted(0.2),
        prop::bool::weighted(0.1),
        prop::bool::weighted(0.02),
    )
        .prop_map(|(to, back, is_cut, is_paused, restarts)| Weather {
            delay_ns: (to, back),
            is_cut,
            is_paused,
            restarts,
        })
}

const CALM: Weather =
    Weather { delay_ns: (1_000_000, 1_000_000), is_cut: false, is_paused: false, restarts: false };

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Each span takes 700 ms.
    #[test]
    fn at_no_time_do_two_have_the_right_and_terms_only_grow_and_calm_brings_one_back(
        spans in prop::collection::vec(prop::collection::vec(weather(), 3), 5..60),
        ppm in prop::collection::vec(-MAX_PPM..=MAX_PPM, 4),
        forgets in prop::option::weighted(0.2, 0usize..60),
    ) {
        let mut hosts = hosts(3, &ppm);
        let mut store = Store::default();
        let (mut greatest, mut forgetting) = (0, false);
        let calm = vec![vec![CALM; 3]; 25];
        let all: Vec<_> = spans.iter().chain(&calm).collect();
        let mut true_ns = 1_000_000_000;
        for (number, span) in all.into_iter().enumerate() {
            forgetting |= forgets == Some(number);
            for at in 0..70 {
                true_ns += STEP_NS;
                let fast = i128::from(true_ns) * i128::from(ppm[3]) / 1_000_000;
                let store_ns = (i128::from(true_ns) + fast) as u64;
                store.expire(store_ns);
                if forgetting && store.holder.is_none() {
                    // The store loses its data after the lease has run out. Candidates that have
                    // led know their terms.
                    forgetting = false;
                    (store.term, store.term_revision) = (0, 0);
                    hosts.iter_mut().for_each(|host| host.observe_term(greatest));
                }
                let mut leading = Vec::new();
                for (host, weather) in hosts.iter_mut().zip(span) {
                    let weather = Weather {
                        restarts: weather.restarts && at == 0,
                        ..*weather
                    };
                    host.step(&mut store, store_ns, true_ns, weather);
                    // A paused process sends nothing, but would continue with the right that it
                    // had.
                    leading.extend(host.leader_lease(true_ns).map(|leader_lease| leader_lease.term));
                }
                prop_assert!(leading.len() <= 1, "{leading:?} at {true_ns}");
                for term in leading {
                    prop_assert!(term >= greatest, "term {term} after {greatest}");
                    greatest = term;
                }
            }
        }
        // After 17 s of calm one candidate leads.
        let serving = hosts.iter_mut().filter_map(|host| host.leader_lease(true_ns)).count();
        prop_assert_eq!(serving, 1);
        let mut terms: Vec<u64> = hosts.iter().flat_map(|host| host.terms.clone()).collect();
        let before = terms.len();
        terms.sort_unstable();
        terms.dedup();
        prop_assert_eq!(terms.len(), before, "no term is given twice");
    }
}

/// A host's worker, and its permit's file.
#[derive(Debug, Default)]
struct Worker {
    hangs: bool,
    permit: Option<LeaderLease>,
    /// When it last sent or was permitted to, by the clock of its host, and whether it has sent
    /// since.
    active_ns: u64,
    has_sent: bool,
}

impl Worker {
    /// Tells the candidate of its host whether it can lead. A worker that does not hang ends with
    /// its permit, and is started again.
    fn step(&mut self, host: &mut Host, true_ns: u64) {
        let now_ns = host.clock(true_ns);
        let lease = host.candidate.leader_lease(now_ns);
        let is_begun = lease.map(|lease| lease.term) != self.permit.map(|permit| permit.term);
        if !self.hangs || (lease.is_some() && is_begun) {
            (self.active_ns, self.has_sent) = (now_ns, !self.hangs);
        }
        if lease.is_some() || !self.hangs {
            self.permit = lease;
        }
        let worker = LocalWorker {
            away_ns: Some(0),
            term: lease.map_or(0, |lease| lease.term),
            idle_ns: now_ns - self.active_ns,
            has_sent: self.has_sent,
            has_outlived_permit: self.permit.is_some() && lease.is_none(),
        };
        host.candidate.is_able(worker.defect().is_none());
        host.candidate.is_idle(worker.is_idle(IdleTimeouts::new(TTL_NS, 33_333_333)));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Each span takes 700 ms. Links restart, and the store is out of reach, in between.
    #[test]
    fn a_host_whose_worker_hangs_loses_the_lease_once_and_leads_again_only_with_another_worker(
        spans in prop::collection::vec(prop::collection::vec(weather(), 2), 10..60),
        hangs_at in 0usize..10,
    ) {
        let mut hosts = hosts(2, &[0; 2]);
        let mut workers = [Worker::default(), Worker::default()];
        let mut store = Store::default();
        let (mut true_ns, mut terms) = (1_000_000_000, Vec::new());
        let calm = vec![vec![CALM; 2]; 30];
        for (number, span) in spans.iter().chain(&calm).enumerate() {
            workers[0].hangs |= number == hangs_at;
            for at in 0..70 {
                true_ns += STEP_NS;
                store.expire(true_ns);
                for ((host, worker), weather) in hosts.iter_mut().zip(&mut workers).zip(span) {
                    let restarts = weather.restarts && at == 0;
                    worker.step(host, true_ns);
                    host.step(&mut store, true_ns, true_ns, Weather { restarts, ..*weather });
                }
                let lease = hosts[0].leader_lease(true_ns).filter(|_| workers[0].hangs);
                terms.extend(lease.map(|lease| lease.term));
                terms.dedup();
                prop_assert!(terms.len() <= 1, "{terms:?} at {true_ns}");
            }
        }
        prop_assert!(hosts[1].leader_lease(true_ns).is_some(), "after 21 s of calm");
        // Another worker removes what is left of the permit.
        workers[0] = Worker::default();
        let weather = [CALM, CUT];
        for _ in 0..700 {
            true_ns += STEP_NS;
            store.expire(true_ns);
            for ((host, worker), weather) in hosts.iter_mut().zip(&mut workers).zip(weather) {
                worker.step(host, true_ns);
                host.step(&mut store, true_ns, true_ns, weather);
            }
        }
        prop_assert!(hosts[0].leader_lease(true_ns).is_some());
    }

    /// The candidates poll at any instants, and their calls take a while.
    #[test]
    fn a_free_lease_is_taken_by_the_first_of_the_list_that_is_able_whoever_sees_it_first(
        first_able in 0usize..3,
        later_ns in prop::collection::vec(0u64..1_000_000_000, 3),
        delay_ns in 0u64..25_000_000,
        ttl_s in 2u64..=60,
    ) {
        let ttl_ns = ttl_s * 1_000_000_000;
        let mut hosts = hosts(4, &[0; 4]);
        for (at, host) in hosts.iter_mut().enumerate() {
            host.candidate = Candidate::new(&host.name, at, ttl_ns, None);
            host.candidate.is_able(at >= first_able);
        }
        // Another candidate leads, and is cut off.
        let lease = 1_000;
        let holder = Holder { name: "host-9".to_owned(), term: 1, lease };
        let mut store = Store::default();
        (store.holder, store.term) = (Some(holder), 1);
        store.leases.insert(lease, 3_000_000_000);
        let weather = Weather { delay_ns: (delay_ns, delay_ns), ..CALM };
        let mut true_ns = 1_000_000_000;
        while hosts.iter_mut().all(|host| host.leader_lease(true_ns).is_none()) {
            true_ns += STEP_NS;
            store.expire(true_ns);
            for (host, later_ns) in hosts.iter_mut().zip(later_ns.iter().chain([&0])) {
                if true_ns >= 1_000_000_000 + later_ns {
                    host.step(&mut store, true_ns, true_ns, weather);
                }
            }
            prop_assert!(true_ns < 20_000_000_000);
        }
        prop_assert!(hosts[first_able].leader_lease(true_ns).is_some(), "{store:?}");
    }
}

/// Runs all hosts under their conditions until the condition holds. Returns how long it took.
fn run(
    hosts: &mut [Host],
    store: &mut Store,
    true_ns: &mut u64,
    weather: &[Weather],
    mut until: impl FnMut(&mut [Host], u64) -> bool,
) -> u64 {
    let begun_ns = *true_ns;
    while !until(hosts, *true_ns) {
        *true_ns += STEP_NS;
        for (host, weather) in hosts.iter_mut().zip(weather) {
            host.step(store, *true_ns, *true_ns, *weather);
        }
        assert!(*true_ns - begun_ns < 60_000_000_000, "{store:?} {hosts:?}");
    }
    *true_ns - begun_ns
}

const CUT: Weather = Weather { is_cut: true, ..CALM };

#[test]
fn the_first_of_the_list_begins_and_when_it_is_gone_the_next_serves_within_a_second_of_the_leases_end()
 {
    let (mut hosts, mut store, mut true_ns) = (hosts(3, &[0; 3]), Store::default(), 1_000_000_000);
    let serves =
        |at: usize| move |hosts: &mut [Host], ns: u64| hosts[at].leader_lease(ns).is_some();
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 3], serves(0));
    assert_eq!(hosts[0].terms, [1]);
    // A candidate that is cut off stops before the store gives its lease away.
    let weather = [CUT, CALM, CALM];
    let silent = |hosts: &mut [Host], ns: u64| hosts[0].leader_lease(ns).is_none();
    let silent_ns = run(&mut hosts, &mut store, &mut true_ns, &weather, silent);
    assert!(silent_ns <= TTL_NS, "{silent_ns}");
    let free = run(&mut hosts, &mut store, &mut true_ns, &weather, |hosts, ns| {
        hosts[1..].iter().all(|host| host.candidate.holder().is_none())
            || hosts[1].leader_lease(ns).is_some()
    });
    let after_ns = run(&mut hosts, &mut store, &mut true_ns, &weather, serves(1));
    assert!(after_ns < 1_000_000_000, "{free} {after_ns}");
    assert_eq!(hosts[1].terms, [2]);
    // The candidate that returns is a standby.
    for _ in 0..500 {
        true_ns += STEP_NS;
        for host in &mut hosts {
            host.step(&mut store, true_ns, true_ns, CALM);
        }
    }
    let leader_lease: Vec<bool> =
        hosts.iter_mut().map(|host| host.leader_lease(true_ns).is_some()).collect();
    assert_eq!(leader_lease, [false, true, false]);
}

#[test]
fn a_link_that_starts_again_goes_on_with_its_lease_and_one_that_learns_a_later_term_gives_way() {
    let (mut hosts, mut store, mut true_ns) = (hosts(2, &[0; 2]), Store::default(), 1_000_000_000);
    let serves =
        |at: usize| move |hosts: &mut [Host], ns: u64| hosts[at].leader_lease(ns).is_some();
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    let again = Weather { restarts: true, ..CALM };
    true_ns += STEP_NS;
    hosts[0].step(&mut store, true_ns, true_ns, again);
    let took_ns = run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    assert!(took_ns < TTL_NS / 2, "{took_ns}");
    assert_eq!(hosts[0].terms, [1], "the same term");
    // Candidates exchange the highest terms that they know of.
    hosts.iter_mut().for_each(|host| host.observe_term(5));
    assert!(hosts[0].leader_lease(true_ns).is_none());
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], |hosts, ns| {
        hosts
            .iter_mut()
            .any(|host| host.leader_lease(ns).is_some_and(|leader_lease| leader_lease.term > 1))
    });
    let terms: Vec<u64> = hosts.iter().flat_map(|host| host.terms.clone()).collect();
    assert!(terms.contains(&6), "{terms:?}");
}

#[test]
fn a_candidate_whose_worker_is_gone_leaves_the_lease_and_takes_none_until_it_is_back() {
    let (mut hosts, mut store, mut true_ns) = (hosts(2, &[0; 2]), Store::default(), 1_000_000_000);
    let serves =
        |at: usize| move |hosts: &mut [Host], ns: u64| hosts[at].leader_lease(ns).is_some();
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    hosts[0].candidate.is_able(false);
    let took_ns = run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(1));
    // Its lease is free with the permit's end. The next in the list polls, and waits for the first.
    let free_ns = TTL_NS - TTL_NS / DRIFT_DIVISOR;
    assert!(took_ns < free_ns + TTL_NS / LOOKS + TTL_NS / LOOKS + ACQUISITION_NS, "{took_ns}");
    hosts[1].candidate.is_able(false);
    for _ in 0..1_500 {
        true_ns += STEP_NS;
        hosts.iter_mut().for_each(|host| host.step(&mut store, true_ns, true_ns, CALM));
    }
    assert!(hosts.iter_mut().all(|host| host.leader_lease(true_ns).is_none()));
    hosts[0].candidate.is_able(true);
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    assert_eq!(hosts[0].terms, [1, 3]);
}

/// Two candidates, of which the first leads. From `begin_ns` its worker sends nothing for
/// `pause_ns`. Returns when the second leads, from the begin, in five times the time to live.
fn after_a_pause(begin_ns: u64, pause_ns: u64) -> Option<u64> {
    let (mut hosts, mut store, mut true_ns) = (hosts(2, &[0; 2]), Store::default(), 1_000_000_000);
    let serves =
        |at: usize| move |hosts: &mut [Host], ns: u64| hosts[at].leader_lease(ns).is_some();
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    let mut workers = [Worker::default(), Worker::default()];
    let begin_ns = true_ns + begin_ns;
    while true_ns < begin_ns + 5 * TTL_NS {
        true_ns += STEP_NS;
        store.expire(true_ns);
        workers[0].hangs = (begin_ns..begin_ns.saturating_add(pause_ns)).contains(&true_ns);
        for (host, worker) in hosts.iter_mut().zip(&mut workers) {
            worker.step(host, true_ns);
            host.step(&mut store, true_ns, true_ns, CALM);
        }
        if hosts[1].leader_lease(true_ns).is_some() {
            return Some(true_ns - begin_ns);
        }
    }
    assert!(hosts[0].leader_lease(true_ns).is_some(), "{hosts:?}");
    None
}

/// At any instant between two renewals.
#[test]
fn a_worker_that_hangs_is_replaced_within_two_leases_and_one_that_pauses_for_less_than_one_leads_on()
 {
    for begin_ns in (2 * TTL_NS..3 * TTL_NS).step_by(130_000_000) {
        let took_ns = after_a_pause(begin_ns, u64::MAX);
        assert!(took_ns.is_some_and(|took_ns| took_ns < 2 * TTL_NS), "{begin_ns} {took_ns:?}");
        for pause_ns in [TTL_NS / 2, TTL_NS * 3 / 4, TTL_NS] {
            assert_eq!(after_a_pause(begin_ns, pause_ns), None, "{begin_ns} {pause_ns}");
        }
    }
}

#[test]
fn while_the_store_is_away_the_holder_is_silent_from_its_leases_end_and_then_all_goes_on() {
    let (mut hosts, mut store, mut true_ns) = (hosts(2, &[0; 2]), Store::default(), 1_000_000_000);
    let serves =
        |at: usize| move |hosts: &mut [Host], ns: u64| hosts[at].leader_lease(ns).is_some();
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], serves(0));
    let silent = |hosts: &mut [Host], ns: u64| hosts[0].leader_lease(ns).is_none();
    let took_ns = run(&mut hosts, &mut store, &mut true_ns, &[CUT; 2], silent);
    assert!((TTL_NS / 2..=TTL_NS).contains(&took_ns), "{took_ns}");
    for _ in 0..1_000 {
        true_ns += STEP_NS;
        hosts.iter_mut().for_each(|host| host.step(&mut store, true_ns, true_ns, CUT));
        assert!(hosts.iter_mut().all(|host| host.leader_lease(true_ns).is_none()));
    }
    let anybody =
        |hosts: &mut [Host], ns: u64| hosts.iter_mut().any(|host| host.leader_lease(ns).is_some());
    run(&mut hosts, &mut store, &mut true_ns, &[CALM; 2], anybody);
}

#[test]
fn a_lease_of_no_time_or_no_number_is_asked_for_again_and_not_at_once_and_none_lasts_for_ever() {
    for (lease, ttl_ns) in [(0, TTL_NS), (7, 0), (7, 1), (7, 10_000_000)] {
        let mut candidate = Candidate::new("a", 0, TTL_NS, None);
        candidate.answered(&Call::Look, Reply::StoreView(StoreView::default()), (0, 1));
        let now_ns = candidate.look_ns;
        candidate.free_since_ns = Some(0);
        assert_eq!(candidate.next(now_ns), Next::Call(Call::Grant));
        candidate.answered(&Call::Grant, Reply::Granted { lease, ttl_ns }, (now_ns, now_ns));
        assert_eq!(
            candidate.next(now_ns),
            Next::Wait(now_ns + POLL_INTERVAL_NS.0),
            "{lease} {ttl_ns}"
        );
    }
    let leader_lease = LeaderLease { term: 3, until_ns: 1_000, lease: 7 };
    let mut candidate = Candidate::new("a", 0, TTL_NS, Some(leader_lease));
    for ttl_ns in [MAX_TTL_NS + 1, u64::MAX / 2, u64::MAX] {
        candidate.answered(&Call::Renew { lease: 7 }, Reply::Renewed { ttl_ns }, (10, 20));
        let until_ns = candidate.leader_lease(30).unwrap().until_ns;
        assert!(until_ns <= 10 + MAX_TTL_NS, "{ttl_ns}: {until_ns}");
        assert!(candidate.renew_ns <= 20 + MAX_TTL_NS / RENEWALS);
    }
}

#[test]
fn after_the_last_term_nobody_serves_since_two_would_in_one() {
    for (stored, highest_term) in [(u64::MAX, 0), (0, u64::MAX)] {
        let mut candidate = Candidate::new("a", 0, TTL_NS, None);
        candidate.observe_term(highest_term);
        let view = StoreView { term: stored, ..StoreView::default() };
        let mut now_ns = 0;
        for _ in 0..50 {
            now_ns += POLL_INTERVAL_NS.1;
            assert_eq!(candidate.next(now_ns), Next::Call(Call::Look));
            candidate.answered(&Call::Look, Reply::StoreView(view.clone()), (now_ns, now_ns));
        }
    }
}

#[test]
fn a_lease_that_the_store_no_longer_knows_is_followed_by_another() {
    let mut candidate = Candidate::new("base", 0, TTL_NS, None);
    candidate.is_able(true);
    let mut store = Store::default();
    let mut now_ns = 0;
    let mut calls = Vec::new();
    let mut is_forgotten = false;
    for _ in 0..200 {
        now_ns += STEP_NS;
        if let Next::Call(call) = candidate.next(now_ns) {
            // An operator revokes the lease between its grant and its use.
            if matches!(call, Call::Acquire { .. }) && !is_forgotten {
                is_forgotten = true;
                store.leases.clear();
            }
            let of_lease = match &call {
                Call::Acquire { lease, .. } | Call::Renew { lease } => Some(*lease),
                Call::Grant | Call::Look | Call::Release { .. } => None,
            };
            let reply = match of_lease {
                Some(lease) if !store.leases.contains_key(&lease) => Reply::Gone,
                _ => store.answer("base", &call, now_ns, TTL_NS),
            };
            candidate.answered(&call, reply, (now_ns, now_ns));
            calls.push(call);
        }
        if candidate.leader_lease(now_ns).is_some() {
            break;
        }
    }
    let grants = calls.iter().filter(|call| **call == Call::Grant).count();
    assert_eq!(grants, 2, "{calls:?}");
    assert!(candidate.leader_lease(now_ns).is_some(), "{calls:?}");
}
