//! Scheduling of the tick's threads: CPUs, real-time priority, locked memory. All of it is
//! optional, and most of it requires privileges.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::num::NonZeroU64;

use joulebus_settings::Scheduling;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getpriority_process, getrlimit, setpriority_process};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity};

/// Applies all that is asked to the calling thread, which is the tick's own, and to the process.
/// Threads started earlier are not affected. Returns the refused requests, if none is required.
///
/// # Errors
/// The first refused request, if it is required.
pub fn schedule_process(asked: &Scheduling) -> Result<Vec<SchedulingError>, SchedulingError> {
    let memory = if asked.lock_memory { lock_memory() } else { Ok(()) };
    let mut refused: Vec<SchedulingError> =
        [memory].into_iter().chain(requests(asked, 0)).filter_map(Result::err).collect();
    if asked.required && !refused.is_empty() {
        return Err(refused.swap_remove(0));
    }
    Ok(refused)
}

/// Applies the requested CPU and priority to the calling thread, number `place` of the tick's
/// threads, 0 being the tick's own. No CPU is requested beyond the end of [`Scheduling::cpus`].
///
/// # Errors
/// The first refused request. The CPU is requested first.
pub fn schedule_thread(asked: &Scheduling, place: usize) -> Result<(), SchedulingError> {
    let [cpu, priority] = requests(asked, place);
    cpu.and(priority)
}

/// Requests that would be refused now: CPUs and priority are tested on short-lived threads,
/// memory is judged by the privileges. Has no effect on the caller.
///
/// # Errors
/// A thread could not be started.
pub fn try_scheduling(asked: &Scheduling) -> io::Result<Vec<SchedulingError>> {
    let mut refused = Vec::new();
    if asked.lock_memory && !Rights::of_this_process().allow_locking() {
        refused.extend(lock_memory().err());
    }
    for place in 0..asked.cpus.len().max(1) {
        let tried = std::thread::scope(|scope| {
            std::thread::Builder::new()
                .spawn_scoped(scope, || requests(asked, place))
                .map(std::thread::ScopedJoinHandle::join)
        })?;
        let Ok([cpu, priority]) = tried else {
            return Err(io::Error::other("the test thread panicked"));
        };
        refused.extend(cpu.err());
        // The result is the same for all threads.
        refused.extend(priority.err().filter(|_| place == 0));
    }
    Ok(refused)
}

fn requests(asked: &Scheduling, place: usize) -> [Result<(), SchedulingError>; 2] {
    let cpu = asked.cpus.get(place).map_or(Ok(()), |cpu| stay_on(*cpu));
    let priority = match asked.priority {
        0 => Ok(()),
        priority => take_priority(priority),
    };
    [cpu, priority]
}

/// Privileges of this process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rights {
    /// CPUs it may use.
    pub cpus: Vec<usize>,
    /// Maximum real-time priority of its limit (`RLIMIT_RTPRIO`). `None`: unlimited.
    pub priority_limit: Option<u64>,
    /// True if it may request any priority (`CAP_SYS_NICE`).
    pub may_take_any_priority: bool,
    /// Memory it may lock (`RLIMIT_MEMLOCK`), bytes. `None`: unlimited.
    pub memory_limit: Option<u64>,
    /// True if it may lock any memory (`CAP_IPC_LOCK`).
    pub may_lock_any_memory: bool,
}

impl Rights {
    /// Privileges of the calling thread.
    #[must_use]
    pub fn of_this_process() -> Self {
        let held = capabilities(None).map_or(CapabilitySet::empty(), |sets| sets.effective);
        Self {
            cpus: allowed_cpus(),
            priority_limit: getrlimit(Resource::Rtprio).current,
            may_take_any_priority: held.contains(CapabilitySet::SYS_NICE),
            memory_limit: getrlimit(Resource::Memlock).current,
            may_lock_any_memory: held.contains(CapabilitySet::IPC_LOCK),
        }
    }

    /// True if the limits allow `priority`. A container may still refuse it.
    #[must_use]
    pub fn allow_priority(&self, priority: u8) -> bool {
        self.may_take_any_priority
            || self.priority_limit.is_none_or(|limit| u64::from(priority) <= limit)
    }

    /// True if all memory may be locked, including future mappings: a finite limit is not
    /// sufficient, because beyond it every new mapping would fail.
    pub const fn allow_locking(&self) -> bool {
        self.may_lock_any_memory || self.memory_limit.is_none()
    }
}

/// A refused request.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SchedulingError {
    /// The CPU does not exist or is not allowed for this process.
    #[error(
        "the tick's thread cannot stay on CPU {cpu} ({source}): this process may use {allowed:?}. \
         Change `worker.cpus`, or the cpuset or `taskset` that the worker was started with"
    )]
    Cpu { cpu: usize, allowed: Vec<usize>, source: io::Error },
    /// Real-time priority was refused.
    #[error(
        "SCHED_FIFO priority {priority} was refused ({source}): RLIMIT_RTPRIO is {limit}, \
         CAP_SYS_NICE is {capability}. {remedy}, or set `worker.priority = 0`"
    )]
    Priority {
        priority: u8,
        limit: String,
        capability: &'static str,
        remedy: String,
        source: io::Error,
    },
    /// Memory cannot be locked.
    #[error(
        "memory was not locked ({reason}): RLIMIT_MEMLOCK is {limit} and must be unlimited, \
         CAP_IPC_LOCK is {capability}. Write `LimitMEMLOCK=infinity` into the service, or `USER - \
         memlock unlimited` into /etc/security/limits.conf, or set `worker.memory = \"unlocked\"`"
    )]
    Memory {
        limit: String,
        capability: &'static str,
        /// The error of the system, or the reason for not requesting it.
        reason: String,
    },
}

/// Binds the calling thread, and threads it starts from now on, to one CPU.
fn stay_on(cpu: usize) -> Result<(), SchedulingError> {
    let refused = |source| SchedulingError::Cpu { cpu, allowed: allowed_cpus(), source };
    if cpu >= CpuSet::MAX_CPU {
        return Err(refused(io::ErrorKind::InvalidInput.into()));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    sched_setaffinity(None, &set).map_err(|error| refused(error.into()))
}

/// Sets a real-time priority for the calling thread. Threads it starts are scheduled normally.
fn take_priority(priority: u8) -> Result<(), SchedulingError> {
    let parameters = libc::sched_param { sched_priority: priority.into() };
    // The raw system call: the function of that name does nothing in some C libraries.
    // SAFETY: the pointer is to a `sched_param` that lives through the call. The kernel only reads
    // it. 0 is the calling thread.
    let outcome = unsafe {
        libc::syscall(
            libc::SYS_sched_setscheduler,
            0,
            libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK,
            &raw const parameters,
        )
    };
    if outcome == 0 {
        return Ok(());
    }
    let source = io::Error::last_os_error();
    let rights = Rights::of_this_process();
    let remedy = if rights.allow_priority(priority) {
        "The limits would allow it, so ask whoever runs the container or the cgroup for real-time \
         time"
            .to_owned()
    } else {
        format!(
            "Write `LimitRTPRIO={priority}` into the service, or `USER - rtprio {priority}` into \
             /etc/security/limits.conf, or give the program the capability (`setcap \
             cap_sys_nice+ep`)"
        )
    };
    Err(SchedulingError::Priority {
        priority,
        limit: limit_words(rights.priority_limit, 1, ""),
        capability: held(rights.may_take_any_priority),
        remedy,
        source,
    })
}

/// Locks all memory of the process, including future mappings, and touches it.
fn lock_memory() -> Result<(), SchedulingError> {
    let rights = Rights::of_this_process();
    let refused = |reason: String| SchedulingError::Memory {
        limit: limit_words(rights.memory_limit, 1024, " kB"),
        capability: held(rights.may_lock_any_memory),
        reason,
    };
    if !rights.allow_locking() {
        return Err(refused(
            "not requested: beyond a finite limit every new mapping fails".to_owned(),
        ));
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        .map_err(|error| refused(io::Error::from(error).to_string()))
}

/// Sets the timer slack of the calling thread to the minimum: the kernel otherwise delays the end
/// of sleeps by up to 50 µs to save power. For the worker.
///
/// # Errors
/// The system refuses. The timer slack is unchanged.
pub fn set_timer_slack() -> io::Result<()> {
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).map_err(Into::into)
}

/// Sets the calling thread's nice value, 0 to 19, also of threads that it starts. Above 0 the
/// worker and its sources run first where all want the same processor. A thread that yields more
/// already, as under `nice`, stays as it is. A refusal is only logged.
pub fn yield_to_the_worker(nice: u8) {
    let nice = i32::from(nice);
    // On Linux this is a property of threads: of the calling one.
    let yields = getpriority_process(None).is_ok_and(|own| own >= nice);
    if !yields && let Err(error) = setpriority_process(None, nice) {
        tracing::warn!(%error, "this thread competes with the worker for processors");
    }
}

fn allowed_cpus() -> Vec<usize> {
    let Ok(set) = sched_getaffinity(None) else {
        return Vec::new();
    };
    (0..CpuSet::MAX_CPU).filter(|cpu| set.is_set(*cpu)).collect()
}

fn limit_words(limit: Option<u64>, unit: u64, name: &str) -> String {
    limit.map_or_else(|| "unlimited".to_owned(), |limit| format!("{}{name}", limit / unit))
}

const fn held(capability: bool) -> &'static str {
    if capability { "there" } else { "missing" }
}

/// Page faults of the calling thread since its start: minor ones (a page in memory had to be
/// mapped) and major ones (it had to be read from disk).
///
/// # Errors
/// `/proc` cannot be read.
pub fn page_faults() -> io::Result<(u64, u64)> {
    let text = fs::read_to_string("/proc/thread-self/stat")?;
    // The second field is the thread's name in parentheses, which may contain any character.
    let fields = text.rsplit(')').next().unwrap_or_default();
    let mut counts = fields.split_ascii_whitespace().skip(7).step_by(2);
    let mut next = || counts.next()?.parse().ok();
    let faults = (next(), next());
    match faults {
        (Some(minor), Some(major)) => Ok((minor, major)),
        _ => Err(io::ErrorKind::InvalidData.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_yields_more_and_never_less() {
        // A thread's own property, so the others of this process keep theirs.
        let values = std::thread::spawn(|| {
            [12, 5, 14].map(|nice| {
                yield_to_the_worker(nice);
                getpriority_process(None).unwrap()
            })
        });
        let before = getpriority_process(None).unwrap();
        assert_eq!(values.join().unwrap(), [12, 12, 14].map(|nice| nice.max(before)));
        assert_eq!(getpriority_process(None).unwrap(), before);
    }
}
