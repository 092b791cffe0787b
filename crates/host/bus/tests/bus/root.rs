//! Roots that are not private and fleets that do not fit are refused.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::{CapacityError, Domain, Limits, Ports, RootError, WorkerLock, check_capacity};

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
