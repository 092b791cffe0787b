//! Checks of the fleet's models, shared memory and members.

use std::path::Path;
use std::time::Duration;

use joulebus_bus::{
    CapacityError, Domain, Inspection, NodeInfo, Ports, RemovedFiles, RootError, check_capacity,
    clock,
};
use joulebus_config::Config;
use joulebus_connect::standby::{Permit, StandbyFiles};
use joulebus_consumer::{Event, Subscriber};
use joulebus_models::load_models;
use rustix::fs::{Access, access, statfs};

use super::{Check, Status};

const SHARED_MEMORY: &str = "/dev/shm";
/// Magic number of tmpfs.
const TMPFS: u64 = 0x0102_1994;
/// Timeout for a frame from another host.
const FRAME_TIMEOUT: Duration = Duration::from_secs(3);
const FIX: &str = "run `joulebus doctor --fix`";

/// Checks that the models can be loaded.
pub(super) fn models(config: &Config) -> Check {
    match load_models(config) {
        Ok(models) => {
            let platforms = config.settings().platforms.iter().zip(&models);
            let names: Vec<String> = platforms
                .map(|(platform, model)| {
                    format!("{} by {} ({:016x})", platform.name, model.name(), model.hash())
                })
                .collect();
            Check::ok("models", names.join(", "))
        }
        Err(error) => {
            let remedy = "name another `model` in the platform's file";
            Check::new("models", Status::Fail, error.to_string(), remedy)
        }
    }
}

/// Checks that memory and descriptors suffice for a worker, a source and a planner, or for the
/// fleet's further processes if a worker already runs.
pub(super) fn memory(config: &Config, inspection: &Inspection) -> Check {
    let limits = config.limits();
    let ports = |sources, planners| Ports {
        sources,
        workers: usize::from(inspection.worker.is_none()),
        planners,
    };
    let capacity = match check_capacity(&limits, ports(1, 1)) {
        Ok(capacity) => capacity,
        Err(error) => {
            let name = match error {
                CapacityError::Descriptors { .. } => "descriptors",
                _ => "shared memory",
            };
            return Check::new(name, Status::Fail, error.to_string(), "");
        }
    };
    let mebi = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let found = format!(
        "one more source and planner need {:.1} MiB, {:.1} MiB of {:.1} MiB are free. They need {} \
            file descriptors, {} of {} are used",
        mebi(capacity.needed_bytes),
        mebi(capacity.free_bytes),
        mebi(capacity.total_bytes),
        capacity.descriptors_needed,
        capacity.descriptors_used,
        capacity.descriptors_limit,
    );
    match check_capacity(&limits, ports(limits.max_sources, limits.max_planners)) {
        Err(CapacityError::Memory { needed, free }) => {
            let what = format!(
                "with all {} sources and {} planners it would be {:.1} MiB of {:.1} MiB",
                limits.max_sources,
                limits.max_planners,
                mebi(needed),
                mebi(free)
            );
            let remedy =
                "lower `capacity`, `max_sources` or `max_planners`, if they are not needed";
            Check::new("shared memory", Status::Warn, format!("{found}; {what}"), remedy)
        }
        _ => Check::ok("shared memory", found),
    }
}

/// Checks that shared memory can be created.
pub(super) fn memory_rights() -> Check {
    match access(SHARED_MEMORY, Access::WRITE_OK | Access::EXEC_OK) {
        Ok(()) => Check::ok("rights", format!("{SHARED_MEMORY} can be written")),
        Err(error) => {
            let remedy = format!("mount a tmpfs there that this user may write: {SHARED_MEMORY}");
            let found = format!("{SHARED_MEMORY} cannot be written: {error}");
            Check::new("rights", Status::Fail, found, remedy)
        }
    }
}

pub(super) fn root(domain: &Domain, inspection: &Inspection) -> Check {
    let name = "root";
    if let Some(error) = &inspection.root_error {
        // Only the rights of joulebus's own directories are mended.
        let remedy = match error {
            RootError::Mode { .. } => {
                "`joulebus doctor --fix` corrects the mode of a directory that joulebus made"
            }
            _ => "",
        };
        return Check::new(name, Status::Fail, error.to_string(), remedy);
    }
    let slow = "keep `root` on a tmpfs, below /dev/shm or /run/user: on a disk starts are slower and \
                stale files more likely";
    let Some(root) = &inspection.root else {
        return missing_root(domain.root(), slow);
    };
    let found = format!(
        "{}: owner uid {}, mode {:04o}, filesystem {:#x}",
        root.path.display(),
        root.owner,
        root.mode,
        root.filesystem
    );
    if root.mode & 0o077 != 0 {
        let remedy = "iceoryx2 made it again after it was removed. The next process that starts \
                      makes it private, and so does `joulebus doctor --fix`";
        Check::new(name, Status::Warn, found, remedy)
    } else if root.in_memory {
        Check::ok(name, found)
    } else {
        Check::new(name, Status::Warn, found, slow)
    }
}

/// Checks that the parent directory allows its creation.
fn missing_root(root: &Path, slow: &str) -> Check {
    let name = "root";
    let above = root.parent().unwrap_or(Path::new("/"));
    let found = format!("{} will be created", root.display());
    if let Err(error) = access(above, Access::WRITE_OK | Access::EXEC_OK) {
        let found = format!("{} cannot be created: {}: {error}", root.display(), above.display());
        let remedy = "set another `root`, or create the directory above it";
        return Check::new(name, Status::Fail, found, remedy);
    }
    #[allow(clippy::unnecessary_cast, reason = "the width depends on the platform")]
    let on_tmpfs = statfs(above).is_ok_and(|found| found.f_type as u64 == TMPFS);
    if on_tmpfs {
        Check::ok(name, found)
    } else {
        Check::new(name, Status::Warn, format!("{found}, not on a tmpfs"), slow)
    }
}

/// The worker, or, where a link holds its place, what comes from the worker of another host.
pub(super) fn worker(config: &Config, inspection: &Inspection) -> Check {
    if let Some(link) = inspection.worker.filter(|owner| owner.is_link()) {
        return linked(config, link.pid.unwrap_or_default());
    }
    match inspection.worker.map(|owner| owner.pid) {
        Some(Some(pid)) => Check::ok("worker", format!("runs, pid {pid}")),
        Some(None) => Check::ok("worker", "runs, in another container or unseen from here"),
        None => Check::ok(
            "worker",
            "none runs (`joulebus run` starts one, `joulebus status` lists the fleets of all users)",
        ),
    }
}

/// Checks a host without a worker: the link that stands in for it.
fn linked(config: &Config, pid: u32) -> Check {
    let name = "worker";
    let place = format!("on another host: link, pid {pid}");
    let received = Subscriber::with_config(config, "doctor").map(|mut subscriber| {
        loop {
            match subscriber.wait_next(FRAME_TIMEOUT) {
                Ok(Event::Frame(frame)) => {
                    let (robots, tick) = (frame.robots().len(), frame.header().tick);
                    let age_ms = frame.age_ns() as f64 * 1e-6;
                    break Ok(format!(
                        "{place}, hears forecasts of {robots} robots, tick {tick}, {age_ms:.1} ms old"
                    ));
                }
                Ok(Event::Interrupted) => {}
                Ok(_) => break Err(format!("{place}, hears nothing")),
                Err(error) => break Err(format!("{place}: {error}")),
            }
        }
    });
    match received {
        Ok(Ok(found)) => Check::ok(name, found),
        Ok(Err(found)) => {
            let remedy = "before a robot's first sample no forecasts come. Otherwise see the link's \
                log, and run `joulebus link FILE --check` on both hosts. A link that only sends \
                samples hears nothing";
            Check::new(name, Status::Warn, found, remedy)
        }
        Err(error) => Check::new(name, Status::Warn, format!("{place}: {error}"), ""),
    }
}

/// The permit of a worker that stands by. Nothing where no link of several workers' hosts runs.
pub(super) fn permit(config: &Config) -> Option<Check> {
    let name = "permit";
    let now_ns = clock::boot_ns();
    match Permit::read(&StandbyFiles::new(config).permit) {
        Ok(permit) => permit.map(|Permit { term, until_ns, .. }| {
            let found = match until_ns.checked_sub(now_ns) {
                Some(left_ns) if left_ns > 0 => {
                    format!("to serve in term {term}, {:.1} s more", left_ns as f64 * 1e-9)
                }
                _ => format!("that of term {term} has ended: another host may serve"),
            };
            Check::ok(name, found)
        }),
        Err(error) => Some(Check::new(name, Status::Fail, error.to_string(), "")),
    }
}

/// The processes of the fleet.
pub(super) fn nodes(inspection: &Inspection) -> Check {
    let name = "processes";
    let list = |alive| -> Vec<String> {
        let nodes = inspection.nodes.iter();
        nodes.filter(|node| node.alive == alive).map(node_name).collect()
    };
    let (alive, dead, unknown) = (list(Some(true)), list(Some(false)), list(None));
    let found = if alive.is_empty() {
        "none is alive".to_owned()
    } else {
        format!("{} alive: {}", alive.len(), alive.join(", "))
    };
    if !dead.is_empty() {
        let found = format!("{found}; {} dead: {}", dead.len(), dead.join(", "));
        let remedy = format!("{FIX}. A live process of the fleet does it within a second");
        Check::new(name, Status::Warn, found, remedy)
    } else if !unknown.is_empty() {
        let found = format!("{found}; {} unknown", unknown.len());
        Check::new(name, Status::Warn, found, FIX)
    } else {
        Check::ok(name, found)
    }
}

fn node_name(node: &NodeInfo) -> String {
    let name = if node.name.is_empty() { "?" } else { &node.name };
    match node.pid {
        Some(pid) => format!("{name} (pid {pid})"),
        None => name.to_owned(),
    }
}

/// Checks that the files that living processes use are still where others look for them.
pub(super) fn removed_files(removed: &[RemovedFiles]) -> Check {
    let name = "removed files";
    let processes = removed.iter().map(|removed| {
        let (pid, first, more) = (removed.pid, removed.first.display(), removed.count - 1);
        match more {
            0 => format!("pid {pid}: {first}"),
            more => format!("pid {pid}: {first} and {more} more"),
        }
    });
    let processes: Vec<String> = processes.collect();
    if processes.is_empty() {
        return Check::ok(name, "none in use");
    }
    let found = format!(
        "processes that start now cannot reach {} running ones, whose files were removed: {}",
        processes.len(),
        processes.join("; ")
    );
    let remedy = "end these processes and start them again. If it happened when a user logged out, \
        set `RemoveIPC=no` in logind.conf, or enable lingering (docs/how-to/removeipc.md)";
    Check::new(name, Status::Fail, found, remedy)
}

/// Objects in shared memory that no process of ours uses any more.
pub(super) fn stale_files(inspection: &Inspection) -> Check {
    let name = "stale files";
    if let Some(first) = inspection.foreign.first() {
        let (count, first) = (inspection.foreign.len(), first.display());
        let found = format!("{count} objects of another user under our names, one is {first}");
        let remedy = "have their owner remove them, or set another `root` or `prefix`";
        return Check::new(name, Status::Fail, found, remedy);
    }
    if let Some(first) = inspection.incomplete.first() {
        let (count, first) = (inspection.incomplete.len(), first.display());
        let found = format!("{count} incomplete objects, one is {first}: opening one hangs");
        return Check::new(name, Status::Fail, found, FIX);
    }
    let alive = inspection.nodes.iter().any(|node| node.alive != Some(false));
    let (objects, bytes) = (inspection.objects, inspection.object_bytes);
    let found = format!("{objects} objects in shared memory, {bytes} bytes");
    if objects > 0 && !alive {
        let found = format!("{found}, and no process is alive to use them");
        return Check::new(name, Status::Warn, found, FIX);
    }
    Check::ok(name, if objects == 0 { "none".to_owned() } else { format!("none; {found} in use") })
}
