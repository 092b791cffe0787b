//! Reading all queued frames.

use std::path::Path;

use joulebus_bus::{Bus, Domain, Limits, OpenError, WorkerLock};
use joulebus_wire::{
    Channel, Flow, ForEachChannel, Forecast, ForecastHeader, Forecasts, each_channel,
};

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
        let header = ForecastHeader { tick: ticks, ..ForecastHeader::default() };
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

#[test]
fn planners_and_views_leave_the_places_of_worker_recorders_links_and_operators() {
    struct Filling<'a> {
        domain: &'a Domain,
        limits: Limits,
    }
    impl ForEachChannel for Filling<'_> {
        fn channel<C: Channel>(&mut self) {
            let (Self { domain, limits }, name) = (&*self, C::SERVICE.name());
            let open = limits.open_places(C::FLOW);
            let join = |name: &str| Bus::join(domain, name).unwrap();
            let (own, view, other) = (join("worker"), join("watch"), join("page"));
            let mut views = Vec::new();
            for place in 0..open {
                let bus = if place % 2 == 0 { &view } else { &other };
                views.push(bus.reader::<C>(limits).unwrap());
            }
            let pid = std::process::id();
            match view.reader::<C>(limits).unwrap_err() {
                OpenError::Places { service, allowed, holders } => {
                    assert_eq!((service, allowed), (name, open));
                    assert_eq!(holders, format!("page (pid {pid}), watch (pid {pid})"));
                }
                error => panic!("{name}: {error}"),
            }
            // All that the product itself may have at once: even two recorders and a link.
            let (recorder, link) = (join("recorder"), join("link"));
            let mut owns: Vec<_> =
                [&recorder, &recorder, &link].map(|bus| bus.reader::<C>(limits)).into();
            if matches!(C::FLOW, Flow::Planners { .. }) {
                owns.extend([&own, &own].map(|bus| bus.reader::<C>(limits)));
            } else if C::FLOW == Flow::Sources {
                owns.push(own.reader::<C>(limits));
            }
            for reader in &owns {
                reader.as_ref().unwrap_or_else(|error| panic!("{name}: {error}"));
            }
            // A place that is given up is taken by the next.
            views.pop();
            assert!(other.reader::<C>(limits).is_ok(), "{name}");
        }
    }
    let root = format!("/dev/shm/joulebus-places-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let limits = Limits { max_planners: 3, ..Limits::default() };
    let mut filling = Filling { domain: &domain, limits };
    each_channel(&mut filling);
    // And those who are woken.
    let join = |name: &str| Bus::join(&domain, name).unwrap();
    let (view, link) = (join("watch"), join("link"));
    let open = limits.open_places(Forecasts::FLOW);
    let waiters: Vec<_> = (0..open).map(|_| view.planner_waiter(&limits).unwrap()).collect();
    let refused = view.planner_waiter(&limits).unwrap_err();
    assert!(matches!(refused, OpenError::Places { .. }), "{refused}");
    let woken = link.planner_waiter(&limits).unwrap();
    drop((waiters, woken));
    // And operators, however many ask.
    let asking = limits.open_query_clients();
    let clients: Vec<_> = (0..asking).map(|_| view.query_client(&limits).unwrap()).collect();
    match view.query_client(&limits).unwrap_err() {
        OpenError::Places { allowed, holders, .. } => {
            assert_eq!(allowed, asking);
            assert!(holders.starts_with("watch (pid "), "{holders}");
        }
        error => panic!("{error}"),
    }
    let (page, verb) = (join("page"), join("acknowledge"));
    let operators = [page.query_client(&limits).unwrap(), verb.query_client(&limits).unwrap()];
    drop((clients, operators, view, link, page, verb));
    assert!(!Path::new(&root).exists());
}
