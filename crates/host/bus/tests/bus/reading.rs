//! Reading all queued frames.

use std::path::Path;

use joulebus_bus::{Bus, Domain, Frame, Limits, OpenError, WorkerLock, Writer, clock};
use joulebus_wire::{
    Channel, Flow, ForEachChannel, Forecast, ForecastHeader, Forecasts, QueryHeader, each_channel,
};

/// Ticks after which memory that was given back has been written to: 33 were seen.
const TICKS: u64 = 40;

/// A domain, and the lock and the bus of its worker.
fn served(name: &str) -> (Domain, WorkerLock, Bus) {
    let root = format!("/dev/shm/joulebus-{name}-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let lock = WorkerLock::acquire(&domain).unwrap();
    let bus = Bus::join(&domain, "worker").unwrap();
    (domain, lock, bus)
}

/// Sends frames of which each byte of a number differs from tick to tick.
fn tick(writer: &mut Writer<Forecasts>, ticks: u64) {
    for _ in 0..ticks {
        let now = clock::monotonic_ns();
        let header = ForecastHeader { tick: now, sent_ns: now, ..ForecastHeader::default() };
        writer
            .send(header, 16, |robot| Forecast {
                robot: robot as u32,
                power_w: f32::from_bits(now as u32),
                ..Forecast::default()
            })
            .unwrap();
    }
}

fn bytes(frame: &Frame<'_, Forecasts>) -> Vec<u8> {
    [bytemuck::bytes_of(frame.header()), bytemuck::cast_slice(frame.payload())].concat()
}

#[test]
fn a_writer_that_is_faster_than_its_reader_does_not_keep_it_for_ever() {
    let limits = Limits::default();
    let (domain, lock, bus) = served("reading");
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
    assert!(!domain.root().exists());
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

#[test]
fn a_kept_frame_keeps_its_bytes_and_its_place_after_its_reader_and_its_bus() {
    let limits = Limits { max_planners: 1, ..Limits::default() };
    let (domain, lock, bus) = served("kept");
    let mut writer = bus.writer::<Forecasts>(&limits).unwrap();
    let others = Bus::join(&domain, "others").unwrap();
    let free = limits.open_places(Forecasts::FLOW) - 1;
    let readers: Vec<_> = (0..free).map(|_| others.reader::<Forecasts>(&limits).unwrap()).collect();
    let planner = Bus::join(&domain, "planner").unwrap();
    let mut reader = planner.reader::<Forecasts>(&limits).unwrap();
    tick(&mut writer, 1);
    assert!(reader.hold_latest(|_, _, _| true).unwrap());
    let kept = reader.take_held().unwrap();
    let before = bytes(&kept);
    drop((reader, planner));
    for _ in 0..TICKS {
        tick(&mut writer, 1);
        assert!(bytes(&kept) == before, "it was overwritten");
    }
    // The worker's end leaves it, too.
    drop((writer, bus, lock));
    assert!(bytes(&kept) == before, "it was overwritten");
    let refused = others.reader::<Forecasts>(&limits).unwrap_err();
    assert!(refused.to_string().contains("planner (pid "), "{refused}");
    drop(kept);
    assert!(others.reader::<Forecasts>(&limits).is_ok());
    drop((readers, others));
    assert!(!domain.root().exists());
}

#[test]
fn a_question_keeps_its_bytes_and_the_port_for_questions_after_its_server() {
    let limits = Limits::default();
    let (domain, lock, bus) = served("question");
    let mut server = bus.query_server(&limits).unwrap();
    let planner = Bus::join(&domain, "planner").unwrap();
    let mut client = planner.query_client(&limits).unwrap();
    client.send(QueryHeader::default(), &[1.0; 50]).unwrap();
    let question = server.receive().unwrap().unwrap();
    drop(server);
    for number in 0..TICKS {
        // Full, as soon as two wait that nobody takes.
        let _ = client.send(QueryHeader::default(), &[number as f64; 50]);
        assert_eq!((question.values(), question.header().number), (&[1.0; 50][..], 1));
    }
    let refused = bus.query_server(&limits).unwrap_err();
    assert!(matches!(refused, OpenError::Port { .. }), "{refused}");
    drop(question);
    assert!(bus.query_server(&limits).is_ok());
    drop((client, planner, bus, lock));
    assert!(!domain.root().exists());
}
