//! Programs that use iceoryx2 for themselves, beside a fleet and in processes of it.

use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{FileName, FilePath, Path as BusPath, SemanticString, ipc};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use joulebus_bus::{Bus, Domain, WorkerLock, inspect, sweep};
use joulebus_testkit::eventually;
use joulebus_wire::{Channel, ForEachChannel, Payload, each_channel, service_name};

use crate::harness::{Place, limits, must};

/// The part of a process that knows nothing of fleets: its node has iceoryx2's global
/// configuration, set from a file of its own.
pub(crate) struct Host {
    publisher: Publisher<ipc::Service, u64, ()>,
    subscriber: Subscriber<ipc::Service, u64, ()>,
    _node: Node<ipc::Service>,
}

impl Host {
    pub(crate) fn start(domain: &Domain) -> Result<Self, Box<dyn Error>> {
        let file = file(domain);
        let file = FilePath::new(file.as_os_str().as_encoded_bytes())?;
        let wanted = Config::from_file(&file)?;
        if *Config::setup_global_config_from_file(&file)? != wanted {
            return Err("another configuration is in force".into());
        }
        let node = NodeBuilder::new().create::<ipc::Service>()?;
        let service = node.service_builder(&"numbers".try_into()?);
        let service = service.publish_subscribe::<u64>().open_or_create()?;
        Ok(Self {
            subscriber: service.subscriber_builder().create()?,
            publisher: service.publisher_builder().create()?,
            _node: node,
        })
    }

    pub(crate) fn publish(&self, number: u64) -> Result<(), Box<dyn Error>> {
        self.publisher.send_copy(number)?;
        Ok(())
    }

    pub(crate) fn received(&self) -> Result<Vec<u64>, Box<dyn Error>> {
        let mut received = Vec::new();
        while let Some(sample) = self.subscriber.receive()? {
            received.push(*sample);
        }
        Ok(received)
    }
}

/// The hosts' configuration file, beside the fleet's root.
fn file(domain: &Domain) -> PathBuf {
    domain.root().with_extension("host").join("iceoryx2.toml")
}

/// The hosts' domain; removed when dropped.
struct HostPlace {
    root: PathBuf,
    prefix: String,
}

impl HostPlace {
    fn new(place: &Place) -> Self {
        let file = file(&place.domain);
        let root = file.parent().unwrap().to_owned();
        let name = root.file_stem().unwrap().to_str().unwrap();
        let prefix = format!("jbhost_{name}_");
        fs::create_dir(&root).unwrap();
        let text = format!("[global]\nprefix = \"{prefix}\"\nroot-path = \"{}\"\n", root.display());
        fs::write(&file, text).unwrap();
        Self { root, prefix }
    }

    fn objects(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir("/dev/shm").unwrap().flatten();
        let paths = entries.map(|entry| entry.path());
        let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
        paths.filter(|path| name(path).starts_with(&self.prefix)).collect()
    }
}

impl Drop for HostPlace {
    fn drop(&mut self) {
        for object in self.objects() {
            let _ = fs::remove_file(object);
        }
        let _ = fs::remove_dir_all(&self.root);
    }
}

/// The directories of the domain's nodes.
fn nodes(place: &Place) -> BTreeSet<PathBuf> {
    let entries = fs::read_dir(place.domain.directory().join("nodes")).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.filter(|path| path.is_dir()).collect()
}

#[test]
fn a_process_sets_its_own_global_configuration_after_it_has_joined_and_cleaned_up() {
    let place = Place::new();
    let _host = HostPlace::new(&place);
    let mut member = place.joined("source");
    let before = nodes(&place);
    let worker = place.joined("worker");
    // iceoryx2 would take its global configuration to clean up a node without details.
    member.stop();
    worker.kill();
    for node in nodes(&place).difference(&before) {
        let details = fs::read_dir(node).unwrap().map(|entry| entry.unwrap().path());
        let mut details = details.filter(|path| path.extension().unwrap() == "details");
        fs::remove_file(details.next().unwrap()).unwrap();
    }
    member.resume();
    eventually("the dead node is removed", || nodes(&place) == before);
    must(&mut member, "host");
    must(&mut member, "publish 7");
    assert_eq!(must(&mut member, "received"), "[7]");
    must(&mut member, "send 1");
}

#[test]
fn services_of_other_programs_live_through_starts_kills_cleanups_and_the_end_of_a_fleet() {
    let place = Place::new();
    let hosts = HostPlace::new(&place);
    let mut inside = place.joined("source");
    let mut beside = place.member();
    must(&mut inside, "host");
    must(&mut beside, "host");
    let mut number = 0;
    let mut exchange = |inside: &mut _, beside: &mut _| {
        number += 1;
        must(inside, &format!("publish {number}"));
        for host in [&mut *inside, &mut *beside] {
            assert_eq!(must(host, "received"), format!("[{number}]"));
        }
        must(beside, &format!("publish {}", number + 1_000));
        for host in [&mut *inside, &mut *beside] {
            assert_eq!(must(host, "received"), format!("[{}]", number + 1_000));
        }
    };
    exchange(&mut inside, &mut beside);
    for role in ["worker", "planner", "source"] {
        place.joined(role).kill();
        exchange(&mut inside, &mut beside);
    }
    assert!(!sweep(&place.domain).unwrap().cold);
    exchange(&mut inside, &mut beside);
    let mut worker = place.joined("worker");
    eventually("what the killed ones had is removed", || {
        inspect(&place.domain).unwrap().nodes.len() == 2
    });
    must(&mut inside, "send 2");
    assert_eq!(must(&mut worker, "take"), "0:2");
    worker.finish();
    // The last member leaves, and a sweep finds nothing.
    must(&mut inside, "leave");
    assert!(sweep(&place.domain).unwrap().is_clean());
    place.assert_nothing_left();
    exchange(&mut inside, &mut beside);
    inside.finish();
    beside.finish();
    let left = hosts.objects();
    assert!(left.len() <= 1, "as without a fleet, one object: {left:?}");
}

#[test]
fn what_another_program_made_for_every_user_becomes_private() {
    let place = Place::new();
    let open_to_others = || {
        let objects = place.objects().into_iter();
        let modes = objects.map(|object| fs::metadata(object).unwrap().permissions().mode());
        modes.filter(|mode| mode & 0o077 != 0).count()
    };
    joulebus_bus::prepare_domain(&place.domain).unwrap();
    let mut config = Config::default();
    config.global.prefix = FileName::new(place.domain.shm_prefix().as_bytes()).unwrap();
    let root = place.domain.directory();
    let root = BusPath::new(root.as_os_str().as_encoded_bytes()).unwrap();
    config.global.set_root_path(&root);
    let other = NodeBuilder::new().config(&config);
    let other = other.create::<ipc::Service>().unwrap();
    assert_eq!(open_to_others(), 1);
    let member = place.joined("source");
    assert_eq!(open_to_others(), 0);
    member.finish();
    drop(other);
    sweep(&place.domain).unwrap();
}

#[test]
fn one_process_reads_two_fleets_and_cleans_up_in_both() {
    let places = [Place::new(), Place::new()];
    let buses = places.each_ref().map(|place| Bus::join(&place.domain, "planner").unwrap());
    let mut readers =
        buses.each_ref().map(|bus| bus.reader::<joulebus_wire::Forecasts>(&limits()).unwrap());
    for round in 1..=2 {
        let mut workers = places.each_ref().map(|place| place.joined("worker"));
        for (ticks, worker) in workers.iter_mut().enumerate() {
            must(worker, &format!("tick {}", ticks + round));
        }
        for (ticks, reader) in readers.iter_mut().enumerate() {
            let frame = reader.take_latest().unwrap().unwrap();
            assert_eq!(frame.header().tick, (ticks + round) as u64);
        }
        for worker in workers {
            worker.kill();
        }
        // Both cleanup threads may look at the same instant, and iceoryx2 lets one at a time.
        for (place, bus) in places.iter().zip(&buses) {
            eventually("the dead worker's node is removed", || nodes(place).len() == 1);
            eventually("it is counted", || bus.housekeeping().dead_nodes == round as u64);
            assert_eq!(bus.housekeeping().failed_nodes, 0);
        }
    }
    drop((readers, buses));
}

/// Its bytes are those of a counter that begins at `from`.
fn counted<P: Payload>(from: u8) -> P {
    let mut payload = P::default();
    for (at, byte) in bytemuck::bytes_of_mut(&mut payload).iter_mut().enumerate() {
        *byte = from.wrapping_add(at as u8);
    }
    payload
}

fn bytes<C: Channel>(header: &C::Header, rows: &[C::Row]) -> (Vec<u8>, Vec<u8>) {
    (bytemuck::bytes_of(header).to_vec(), bytemuck::cast_slice(rows).to_vec())
}

#[test]
fn iceoryx2_with_the_types_of_a_channel_reads_and_writes_its_frames() {
    struct Typed<'a> {
        bus: &'a Bus,
        node: &'a Node<ipc::Service>,
    }
    impl ForEachChannel for Typed<'_> {
        fn channel<C: Channel>(&mut self) {
            let mut writer = self.bus.writer::<C>(&limits()).unwrap();
            let mut reader = self.bus.reader::<C>(&limits()).unwrap();
            let name = service_name(self.bus.domain().fleet(), C::SERVICE);
            let service = self.node.service_builder(&name.as_str().try_into().unwrap());
            let service = service.publish_subscribe::<[C::Row]>().user_header::<C::Header>();
            let service = service.open().unwrap();
            let types = service.static_config().message_type_details();
            assert_eq!(types.payload, TypeDetail::new::<C::Row>(TypeVariant::Dynamic), "{name}");
            let header = TypeDetail::new::<C::Header>(TypeVariant::FixedSize);
            assert_eq!(types.user_header, header, "{name}");
            let subscriber = service.subscriber_builder().create().unwrap();
            let (header, rows) = (counted(1), [counted(2), counted(3), counted(4)]);
            let sent = bytes::<C>(&header, &rows);
            assert_eq!(writer.send(header, 3, |at| rows[at]).unwrap(), 2, "{name}");
            let frame = subscriber.receive().unwrap().unwrap();
            assert_eq!(bytes::<C>(frame.user_header(), frame.payload()), sent, "{name}");
            let frame = reader.take_next().unwrap().unwrap();
            assert_eq!(bytes::<C>(frame.header(), frame.payload()), sent, "{name}");
            drop((frame, writer));
            let publisher = service.publisher_builder().initial_max_slice_len(3).create().unwrap();
            let mut loan = publisher.loan_slice(2).unwrap();
            *loan.user_header_mut() = header;
            loan.payload_mut().copy_from_slice(&rows[1..]);
            loan.send().unwrap();
            let frame = reader.take_next().unwrap().unwrap();
            let sent = bytes::<C>(&header, &rows[1..]);
            assert_eq!(bytes::<C>(frame.header(), frame.payload()), sent, "{name}");
        }
    }
    let place = Place::new();
    let _lock = WorkerLock::acquire(&place.domain).unwrap();
    let bus = Bus::join(&place.domain, "worker").unwrap();
    let file = place.domain.directory().join("iceoryx2.toml");
    let file = FilePath::new(file.as_os_str().as_encoded_bytes()).unwrap();
    let config = Config::from_file(&file).unwrap();
    let node = NodeBuilder::new().config(&config).create::<ipc::Service>().unwrap();
    each_channel(&mut Typed { bus: &bus, node: &node });
    drop(node);
}
