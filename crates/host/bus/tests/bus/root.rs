//! Roots that are not private and fleets that do not fit are refused.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::{
    Bus, CapacityError, Domain, Limits, Ports, RootError, WorkerLock, check_capacity,
};

static PLACES: AtomicU32 = AtomicU32::new(0);

struct Root(PathBuf);

impl Root {
    fn new() -> Self {
        let number = PLACES.fetch_add(1, Ordering::Relaxed);
        let name = format!("/dev/shm/joulebus-root-{}-{number}", std::process::id());
        Self(name.into())
    }

    fn domain(&self) -> Domain {
        Domain::new("test", &self.0, "jbt_").unwrap()
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_root_accessible_to_others_is_refused_with_its_mode() {
    for mode in [0o755, 0o710, 0o701, 0o1777] {
        let root = Root::new();
        fs::create_dir(&root.0).unwrap();
        fs::set_permissions(&root.0, fs::Permissions::from_mode(mode)).unwrap();
        let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
        assert!(matches!(error, RootError::Mode { found, .. } if found == mode), "{error}");
        // Of /tmp or /run others would be shut out.
        let text = error.to_string();
        assert!(
            text.contains("another `root`, or, if joulebus alone uses it, run `chmod 700"),
            "{text}"
        );
        assert!(WorkerLock::acquire(&root.domain()).is_err());
    }
}

/// What iceoryx2 leaves if a process opens a port while the root is removed: the tag of a port, and
/// the socket of its event.
fn make_again(domain: &Domain) {
    let (node, prefix) = (domain.directory().join("nodes/12"), domain.shm_prefix());
    fs::create_dir_all(&node).unwrap();
    for directory in [domain.root(), &domain.directory()] {
        set_mode(directory, 0o750);
    }
    fs::write(node.join(format!("{prefix}34.port_tag")), "").unwrap();
    drop(UnixListener::bind(domain.directory().join(format!("{prefix}34.event"))).unwrap());
}

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

fn mode(path: &Path) -> u32 {
    fs::symlink_metadata(path).unwrap().permissions().mode() & 0o7777
}

#[test]
fn directories_that_iceoryx2_has_made_again_are_used_and_removed() {
    let root = Root::new();
    let domain = root.domain();
    make_again(&domain);
    // Nothing is wrong that the next start does not mend.
    let found = joulebus_bus::inspect(&domain).unwrap();
    assert!(found.root_error.is_none(), "{:?}", found.root_error);
    assert_eq!(found.root.unwrap().mode, 0o750);
    // As a worker does.
    let lock = WorkerLock::acquire(&domain).unwrap();
    drop(Bus::join(&domain, "test").unwrap());
    drop(lock);
    assert!(!domain.directory().exists());
    assert_eq!(joulebus_bus::sweep(&domain).unwrap().files, 0);
    assert!(!root.0.exists());

    make_again(&domain);
    let changed = joulebus_bus::restrict_domain(&domain).unwrap();
    assert_eq!(changed, [(root.0.clone(), 0o750), (domain.directory(), 0o750)]);
    assert_eq!(joulebus_bus::sweep(&domain).unwrap().files, 2);
    assert!(!root.0.exists());

    // Ended before it had made a file.
    fs::create_dir_all(domain.directory().join("services")).unwrap();
    set_mode(&root.0, 0o750);
    drop(Bus::join(&domain, "test").unwrap());
    assert!(!root.0.exists());

    // A fleet in the same root, of which nothing is there, and the one that is.
    make_again(&domain);
    let other = Domain::new("other", &root.0, "jbt_").unwrap();
    for domain in [other, domain] {
        drop(Bus::join(&domain, "test").unwrap());
        assert!(!domain.directory().exists());
    }
    assert!(!root.0.exists());
}

#[test]
fn all_of_many_processes_that_start_at_once_use_what_iceoryx2_has_made_again() {
    for _ in 0..20 {
        let root = Root::new();
        make_again(&root.domain());
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| drop(joulebus_bus::prepare_domain(&root.domain()).unwrap()));
            }
        });
        let marker = fs::read_to_string(root.domain().members_file()).unwrap();
        assert!(marker.contains("fleet test\n"), "{marker}");
    }
}

#[test]
fn directories_with_anything_that_iceoryx2_does_not_make_for_the_fleet_stay_as_they_are() {
    let another = "test/nodes/jbt_00000000_34.port_tag";
    for file in ["mine", "test/mine", "test/nodes/mine", "test/nodes/12/mine", another] {
        let root = Root::new();
        let domain = root.domain();
        make_again(&domain);
        fs::write(root.0.join(file), "").unwrap();
        let error = joulebus_bus::prepare_domain(&domain).unwrap_err();
        assert!(matches!(error, RootError::Mode { found: 0o750, .. }), "{file}: {error}");
        let found = joulebus_bus::inspect(&domain).unwrap();
        assert!(matches!(found.root_error, Some(RootError::Mode { .. })), "{file}");
        assert_eq!((mode(&root.0), mode(&domain.directory())), (0o750, 0o750), "{file}");
        assert!(!domain.members_file().exists(), "{file}");
        if file != "mine" {
            set_mode(&root.0, 0o700);
            let error = joulebus_bus::prepare_domain(&domain).unwrap_err();
            assert!(matches!(error, RootError::Unmarked { .. }), "{file}: {error}");
        }
    }
    // Others could have written into them.
    for directory in ["", "test", "test/nodes", "test/nodes/12"] {
        let root = Root::new();
        make_again(&root.domain());
        set_mode(&root.0.join(directory), 0o770);
        let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
        assert!(matches!(error, RootError::Mode { .. }), "{directory}: {error}");
        assert!(!root.domain().members_file().exists(), "{directory}");
    }
    // A directory elsewhere, through a link.
    let (root, elsewhere) = (Root::new(), Root::new());
    make_again(&root.domain());
    fs::rename(&root.0, &elsewhere.0).unwrap();
    symlink(&elsewhere.0, &root.0).unwrap();
    let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
    assert!(matches!(error, RootError::Symlink { .. }), "{error}");
    assert_eq!(mode(&elsewhere.0.join("test")), 0o750);
}

#[test]
fn a_symbolic_link_and_a_file_are_refused() {
    let root = Root::new();
    symlink("/dev/shm", &root.0).unwrap();
    assert!(matches!(joulebus_bus::prepare_domain(&root.domain()), Err(RootError::Symlink { .. })));
    fs::remove_file(&root.0).unwrap();
    fs::write(&root.0, "").unwrap();
    assert!(matches!(
        joulebus_bus::prepare_domain(&root.domain()),
        Err(RootError::NotADirectory { .. })
    ));
}

#[test]
fn a_fleet_below_a_private_root_must_be_private_too() {
    let root = Root::new();
    fs::create_dir(&root.0).unwrap();
    fs::set_permissions(&root.0, fs::Permissions::from_mode(0o700)).unwrap();
    symlink("/tmp", root.0.join("test")).unwrap();
    assert!(matches!(joulebus_bus::prepare_domain(&root.domain()), Err(RootError::Symlink { .. })));
}

#[test]
fn a_fleet_that_does_not_fit_is_refused_with_bytes_needed_and_free() {
    let ports = Ports { sources: 1_024, workers: 1, planners: 256 };
    let huge = Limits {
        capacity: 1_000_000,
        max_sources: 1_024,
        max_planners: 256,
        sample_frames: 256,
        forecast_frames: 64,
    };
    let refused = check_capacity(&huge.checked().unwrap(), ports).unwrap_err();
    assert!(refused.to_string().contains("in a container `--shm-size`"), "{refused}");
    let CapacityError::Memory { needed, free } = refused else {
        panic!("terabytes cannot fit: {refused}");
    };
    assert!(needed > free && needed > 1 << 40, "{needed} {free}");

    let one = Ports { sources: 1, workers: 1, planners: 1 };
    let small = check_capacity(&Limits::default(), one).unwrap();
    let ten_times = Limits { capacity: 10_000, ..Limits::default() };
    let big = check_capacity(&ten_times, one).unwrap();
    assert!(small.needed_bytes < big.needed_bytes / 5);
    assert!(small.descriptors_used > 2 && small.descriptors_used < small.descriptors_limit);
}
