//! Scheduling of the tick's threads: processors, real-time priority, locked memory. All of it is
//! optional, and most of it needs privileges.
#![allow(unsafe_code)]

use std::fs;
use std::io;
use std::num::NonZeroU64;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity};

/// What the threads of the tick ask of the system. The default asks for nothing.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scheduling {
    /// Processors, one for each thread, the tick's own first. Empty: wherever the system puts them.
    pub cpus: Vec<usize>,
    /// Real-time priority (`SCHED_FIFO`), 1 to 99; 0: an ordinary thread.
    pub priority: u8,
    /// Whether all memory of the process is to stay in memory (`mlockall`).
    pub lock_memory: bool,
    /// Whether a request that the system refuses stops the start; else it is a warning.
    pub required: bool,
}

impl Scheduling {
    /// Whether it asks for nothing.
    #[must_use]
    pub fn is_nothing(&self) -> bool {
        self.cpus.is_empty() && self.priority == 0 && !self.lock_memory
    }

    /// Asks for all of it, for the calling thread, which is the tick's own, and for the process.
    /// Threads started earlier are unaffected. Returns what was refused, if none of it is required.
    ///
    /// # Errors
    /// What was refused first, if it is required.
    pub fn apply(&self) -> Result<Vec<SchedulingError>, SchedulingError> {
        let memory = if self.lock_memory {
            lock_memory()
        } else {
            Ok(())
        };
        let mut refused: Vec<SchedulingError> = [memory]
            .into_iter()
            .chain(self.requests(0))
            .filter_map(Result::err)
            .collect();
        if self.required && !refused.is_empty() {
            return Err(refused.swap_remove(0));
        }
        Ok(refused)
    }

    /// Asks for the calling thread only: processor and priority of the thread at `place`, 0 being
    /// the tick's own. Past the end of [`Scheduling::cpus`] no processor is asked for.
    ///
    /// # Errors
    /// What was refused, processor first.
    pub fn apply_to_thread(&self, place: usize) -> Result<(), SchedulingError> {
        let [cpu, priority] = self.requests(place);
        cpu.and(priority)
    }

    /// What would be refused now: processors and priority are tried on threads that end at once, memory
    /// is judged by the privileges. Changes nothing for the caller.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn try_out(&self) -> io::Result<Vec<SchedulingError>> {
        let mut refused = Vec::new();
        if self.lock_memory && !Rights::of_this_process().allow_locking() {
            refused.extend(lock_memory().err());
        }
        for place in 0..self.cpus.len().max(1) {
            let tried = std::thread::scope(|scope| {
                std::thread::Builder::new()
                    .spawn_scoped(scope, || self.requests(place))
                    .map(std::thread::ScopedJoinHandle::join)
            })?;
            let Ok([cpu, priority]) = tried else {
                return Err(io::Error::other("the thread that tried panicked"));
            };
            refused.extend(cpu.err());
            // The same for all of them.
            refused.extend(priority.err().filter(|_| place == 0));
        }
        Ok(refused)
    }

    fn requests(&self, place: usize) -> [Result<(), SchedulingError>; 2] {
        let cpu = self.cpus.get(place).map_or(Ok(()), |cpu| stay_on(*cpu));
        let priority = match self.priority {
            0 => Ok(()),
            priority => take_priority(priority),
        };
        [cpu, priority]
    }
}

/// What this process may ask for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rights {
    /// Processors that it may use.
    pub cpus: Vec<usize>,
    /// Greatest real-time priority that its limit allows (`RLIMIT_RTPRIO`); `None`: any.
    pub priority_limit: Option<u64>,
    /// Whether it may take any priority (`CAP_SYS_NICE`).
    pub may_take_any_priority: bool,
    /// Memory that it may lock (`RLIMIT_MEMLOCK`), bytes; `None`: any.
    pub memory_limit: Option<u64>,
    /// Whether it may lock any memory (`CAP_IPC_LOCK`).
    pub may_lock_any_memory: bool,
}

impl Rights {
    /// Those of the calling thread.
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

    /// Whether `priority` is within the rights. A container may refuse it still.
    #[must_use]
    pub fn allow_priority(&self, priority: u8) -> bool {
        self.may_take_any_priority
            || self
                .priority_limit
                .is_none_or(|limit| u64::from(priority) <= limit)
    }

    /// Whether all memory may be locked, that of the future included: a finite limit is not enough,
    /// for past it every new mapping would fail.
    #[must_use]
    pub const fn allow_locking(&self) -> bool {
        self.may_lock_any_memory || self.memory_limit.is_none()
    }
}

/// What the system refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SchedulingError {
    /// The processor is not there, or not for this process.
    #[error(
        "the tick's thread cannot stay on CPU {cpu} ({source}): this process may use {allowed:?}; \
         change `worker.cpus`, or the cpuset or `taskset` that the worker was started with"
    )]
    Cpu {
        /// The processor asked for.
        cpu: usize,
        /// Those that the process may use.
        allowed: Vec<usize>,
        /// What the system said.
        source: io::Error,
    },
    /// No real-time priority.
    #[error(
        "SCHED_FIFO priority {priority} was refused ({source}): RLIMIT_RTPRIO is {limit}, \
         CAP_SYS_NICE is {capability}; {remedy}, or set `worker.priority = 0`"
    )]
    Priority {
        /// The priority asked for.
        priority: u8,
        /// The limit, in words.
        limit: String,
        /// Whether the capability is there, in words.
        capability: &'static str,
        /// What to do.
        remedy: String,
        /// What the system said.
        source: io::Error,
    },
    /// Memory cannot be locked.
    #[error(
        "memory was not locked ({reason}): RLIMIT_MEMLOCK is {limit} and must be unlimited, \
         CAP_IPC_LOCK is {capability}; write `LimitMEMLOCK=infinity` into the service, or `USER - \
         memlock unlimited` into /etc/security/limits.conf, or set `worker.memory = \"unlocked\"`"
    )]
    Memory {
        /// The limit, in words.
        limit: String,
        /// Whether the capability is there, in words.
        capability: &'static str,
        /// What the system said, or why it was not asked.
        reason: String,
    },
}

/// Keeps the calling thread, and threads that it starts from now on, on one processor.
fn stay_on(cpu: usize) -> Result<(), SchedulingError> {
    let refused = |source| SchedulingError::Cpu {
        cpu,
        allowed: allowed_cpus(),
        source,
    };
    if cpu >= CpuSet::MAX_CPU {
        return Err(refused(io::ErrorKind::InvalidInput.into()));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    sched_setaffinity(None, &set).map_err(|error| refused(error.into()))
}

/// Gives the calling thread a real-time priority; threads that it starts are ordinary ones.
fn take_priority(priority: u8) -> Result<(), SchedulingError> {
    let parameters = libc::sched_param {
        sched_priority: priority.into(),
    };
    // The call itself: the function of that name does nothing in some C libraries.
    // SAFETY: the pointer is to a `sched_param` that lives through the call; the system only reads
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
        "the limits would allow it, so ask whoever runs the container or the cgroup for real-time \
         time"
            .to_owned()
    } else {
        format!(
            "write `LimitRTPRIO={priority}` into the service, or `USER - rtprio {priority}` into \
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

/// Keeps all memory of the process in memory, that of the future included, and touches it.
fn lock_memory() -> Result<(), SchedulingError> {
    let rights = Rights::of_this_process();
    let refused = |reason: String| SchedulingError::Memory {
        limit: limit_words(rights.memory_limit, 1024, " kB"),
        capability: held(rights.may_lock_any_memory),
        reason,
    };
    if !rights.allow_locking() {
        return Err(refused(
            "not asked for: past a finite limit every new mapping fails".to_owned(),
        ));
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        .map_err(|error| refused(io::Error::from(error).to_string()))
}

/// Lets the sleeps of the calling thread end on time: the kernel otherwise delays them by up to
/// 50 µs to save power. For the worker.
///
/// # Errors
/// When the system refuses; then sleeps stay as they were.
pub fn set_timer_slack() -> io::Result<()> {
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).map_err(Into::into)
}

fn allowed_cpus() -> Vec<usize> {
    let Ok(set) = sched_getaffinity(None) else {
        return Vec::new();
    };
    (0..CpuSet::MAX_CPU)
        .filter(|cpu| set.is_set(*cpu))
        .collect()
}

fn limit_words(limit: Option<u64>, unit: u64, name: &str) -> String {
    limit.map_or_else(
        || "unlimited".to_owned(),
        |limit| format!("{}{name}", limit / unit),
    )
}

const fn held(capability: bool) -> &'static str {
    if capability { "there" } else { "missing" }
}

/// Page faults of the calling thread since it began: minor ones (a page that was in memory had to be
/// mapped) and major ones (it had to be read from disk).
///
/// # Errors
/// `/proc` cannot be read.
pub fn page_faults() -> io::Result<(u64, u64)> {
    let text = fs::read_to_string("/proc/thread-self/stat")?;
    // The second field is the thread's name, in brackets, and may hold anything.
    let fields = text.rsplit(')').next().unwrap_or_default();
    let mut counts = fields.split_ascii_whitespace().skip(7).step_by(2);
    let mut next = || counts.next()?.parse().ok();
    let faults = (next(), next());
    match faults {
        (Some(minor), Some(major)) => Ok((minor, major)),
        _ => Err(io::ErrorKind::InvalidData.into()),
    }
}
