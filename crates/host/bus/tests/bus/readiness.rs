//! Descriptors for event loops, when a child made by `fork` has copies of what they watch.

use std::os::fd::{AsFd as _, BorrowedFd};
use std::path::Path;
use std::process::Command;

use joulebus_bus::{Bus, Domain, Limits, PeerWatch, Readiness};
use joulebus_wire::WakeEvent;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// True if a descriptor can be read within `within_s`.
fn is_readable(descriptor: BorrowedFd<'_>, within_s: i64) -> bool {
    let mut polled = [PollFd::from_borrowed_fd(descriptor, PollFlags::IN)];
    let timeout = Timespec { tv_sec: within_s, tv_nsec: 0 };
    poll(&mut polled, Some(&timeout)).unwrap() > 0
}

#[test]
fn what_is_watched_no_longer_is_not_reported_although_a_copy_of_its_descriptor_is_open() {
    let mut process = Command::new("sleep").arg("1000").spawn().unwrap();
    let watch = PeerWatch::open(process.id()).unwrap();
    let readiness = Readiness::new().unwrap();
    readiness.watch(&watch).unwrap();
    // As a child made by `fork` has one.
    let copy = watch.as_fd().try_clone_to_owned().unwrap();
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(is_readable(readiness.as_fd(), 60));
    drop(watch);
    assert!(!is_readable(readiness.as_fd(), 0));
    drop(copy);

    let root = format!("/dev/shm/joulebus-ready-{}", std::process::id());
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let (bus, limits) = (Bus::join(&domain, "test").unwrap(), Limits::default());
    let (waker, waiter) =
        (bus.planner_waker(&limits).unwrap(), bus.planner_waiter(&limits).unwrap());
    let readiness = Readiness::of(&waiter).unwrap();
    let copy = waiter.as_fd().try_clone_to_owned().unwrap();
    waker.wake(WakeEvent::Frame).unwrap();
    assert!(is_readable(readiness.as_fd(), 60));
    drop(waiter);
    assert!(!is_readable(readiness.as_fd(), 0));
    drop((copy, waker, bus));
    assert!(!Path::new(&root).exists());
}
