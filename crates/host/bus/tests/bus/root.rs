//! Roots that are not private and fleets that do not fit are refused.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;
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
        assert!(error.to_string().contains("chmod 700"), "{error}");
        assert!(WorkerLock::acquire(&root.domain()).is_err());
    }
}

/// What iceoryx2 leaves if a process opens a port while the root is removed.
fn make_again(domain: &Domain) {
    let node = domain.directory().join("nodes/12");
    fs::create_dir_all(&node).unwrap();
    for directory in [domain.root(), &domain.directory()] {
        fs::set_permissions(directory, fs::Permissions::from_mode(0o750)).unwrap();
    }
    fs::write(node.join(format!("{}34.port_tag", domain.shm_prefix())), "").unwrap();
}

#[test]
fn directories_that_iceoryx2_has_made_again_are_used_and_removed() {
    let root = Root::new();
    let domain = root.domain();
    make_again(&domain);
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
    assert_eq!(joulebus_bus::sweep(&domain).unwrap().files, 1);
    assert!(!root.0.exists());

    // Beside the directory of another fleet, removed in the same way.
    make_again(&domain);
    let other = Domain::new("other", &root.0, "jbt_").unwrap();
    make_again(&other);
    for domain in [domain, other] {
        drop(Bus::join(&domain, "test").unwrap());
    }
    assert!(!root.0.exists());
}

#[test]
fn directories_with_anything_that_iceoryx2_does_not_make_for_the_fleet_stay_as_they_are() {
    let another = format!("nodes/{}34.port_tag", "jbt_00000000_");
    let fleets = [("test/mine", false), ("test/nodes/mine", false), (&*another, true)];
    for (file, below) in fleets {
        let root = Root::new();
        make_again(&root.domain());
        let above = if below { root.domain().directory() } else { root.0.clone() };
        fs::write(above.join(file), "").unwrap();
        let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
        assert!(matches!(error, RootError::Mode { found: 0o750, .. }), "{file}: {error}");
        fs::set_permissions(&root.0, fs::Permissions::from_mode(0o700)).unwrap();
        let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
        assert!(matches!(error, RootError::Unmarked { .. }), "{file}: {error}");
    }
    // A root with anything else keeps its mode.
    let root = Root::new();
    make_again(&root.domain());
    fs::write(root.0.join("mine"), "").unwrap();
    let error = joulebus_bus::prepare_domain(&root.domain()).unwrap_err();
    assert!(matches!(error, RootError::Mode { found: 0o750, .. }), "{error}");
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
