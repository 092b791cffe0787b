//! The preflight check: whether shared memory and file descriptors are sufficient, before anything
//! is created.

use std::io;

use joulebus_wire::{
    AnswerHeader, Channel, Flow, ForEachChannel, Forecasts, MAX_ANSWER_WORDS, MAX_QUERY_VALUES,
    QueryHeader, Samples, each_channel,
};
use rustix::process::{Resource, getrlimit};

use crate::Limits;
use crate::os::memory::SHM_DIR;
use joulebus_settings::ACTIVE_QUERIES;

/// Header and padding of a frame in iceoryx2, upper bound.
const FRAME_OVERHEAD: usize = 128;
/// Bookkeeping of a publisher per segment: allocator and headers, upper bound.
const SEGMENT_OVERHEAD: usize = 16 * 1024;
/// One connection between two ports: two index queues and the list of used chunks.
const CONNECTION_BYTES: usize = 16 * 1024;
/// Services, nodes, events and what rounding to pages costs, per process.
pub(crate) const PROCESS_BYTES: usize = 192 * 1024;
/// Files in shared memory that a process makes at most until it has all of its ports.
const START_FILES: u64 = 128;
/// A service's description and lists of ports, and the files of a port.
pub(crate) const PORT_BYTES: usize = 64 * 1024;
/// Descriptors of a process before it connects to anybody: node, locks, fifteen services.
const BASE_DESCRIPTORS: u64 = 96;
/// File descriptors that opening a node, service or port takes, upper bound.
const PORT_DESCRIPTORS: u64 = 16;
/// File descriptors of one connection, data and bookkeeping.
const CONNECTION_DESCRIPTORS: u64 = 4;

/// Address space that the threads of a process take beside its ports, bytes, with a margin: glibc
/// reserves 64 MiB for the heap of each, and a process of which one is refused crawls or aborts.
const THREADS_BYTES: u64 = 512 << 20;
/// Stack that a thread needs to open ports, bytes, with a margin. The development build takes most.
const STACK_BYTES: u64 = 512 * 1024;

/// Number of processes of each kind that will create their ports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ports {
    /// Processes that publish samples.
    pub sources: usize,
    /// Workers.
    pub workers: usize,
    /// Planners.
    pub planners: usize,
}

/// Required and available capacity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct CapacityReport {
    /// Upper bound of the shared memory of the ports, bytes.
    pub needed_bytes: u64,
    /// Free in `/dev/shm`, bytes.
    pub free_bytes: u64,
    /// Size of `/dev/shm`, bytes.
    pub total_bytes: u64,
    /// File descriptors required by the worker, the process with the most connections.
    pub descriptors_needed: u64,
    /// Limit of open file descriptors of this process.
    pub descriptors_limit: u64,
    /// Open file descriptors of this process.
    pub descriptors_used: u64,
}

/// Checks that the ports of `ports` fit, before any of them is created: writing to shared memory
/// that does not fit raises SIGBUS instead of an error.
///
/// # Errors
/// [`CapacityError`] with the required and the available capacity.
pub fn check_capacity(limits: &Limits, ports: Ports) -> Result<CapacityReport, CapacityError> {
    let report = CapacityReport {
        needed_bytes: needed_bytes(limits, ports),
        descriptors_needed: descriptors(limits),
        ..measure()?
    };
    if report.needed_bytes > report.free_bytes {
        return Err(CapacityError::Memory { needed: report.needed_bytes, free: report.free_bytes });
    }
    let descriptors = report.descriptors_needed + report.descriptors_used;
    if descriptors > report.descriptors_limit {
        return Err(CapacityError::Descriptors {
            needed: descriptors,
            used: report.descriptors_used,
            limit: report.descriptors_limit,
        });
    }
    check_address_space(report.needed_bytes.saturating_add(THREADS_BYTES))?;
    Ok(report)
}

/// Checks that address space is left for what a process of the fleet does. [`Bus::join`] checks it
/// too. A program that starts threads before it joins checks it first: the error of a thread that
/// finds no room for its stack does not name the limit.
///
/// # Errors
/// [`CapacityError::AddressSpace`] with the limit.
///
/// [`Bus::join`]: crate::Bus::join
pub fn check_threads() -> Result<(), CapacityError> {
    check_address_space(THREADS_BYTES)
}

/// Checks that the stack may be as large as ports need: a stack that is too small ends a process
/// without a word of the cause.
///
/// # Errors
/// [`CapacityError::Stack`] with the limit.
pub fn check_stack() -> Result<(), CapacityError> {
    match getrlimit(Resource::Stack).current {
        Some(limit) if limit < STACK_BYTES => {
            Err(CapacityError::Stack { limit, needed: STACK_BYTES })
        }
        _ => Ok(()),
    }
}

/// The state of this host and process, with nothing required.
pub(crate) fn measure() -> Result<CapacityReport, CapacityError> {
    let (free_bytes, total_bytes) = shared_memory()?;
    Ok(CapacityReport {
        needed_bytes: 0,
        free_bytes,
        total_bytes,
        descriptors_needed: 0,
        descriptors_limit: descriptors_limit(),
        descriptors_used: descriptors_used().map_err(CapacityError::Measure)?,
    })
}

fn descriptors_limit() -> u64 {
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

/// Fails if none is left.
fn descriptors_used() -> io::Result<u64> {
    let used = std::fs::read_dir("/proc/self/fd")?.count();
    // Includes the directory being read.
    Ok(used.saturating_sub(1) as u64)
}

/// Free bytes and total bytes of `/dev/shm`.
pub(crate) fn shared_memory() -> Result<(u64, u64), CapacityError> {
    let shm = rustix::fs::statvfs(SHM_DIR).map_err(|error| CapacityError::Measure(error.into()))?;
    Ok((shm.f_bavail.saturating_mul(shm.f_frsize), shm.f_blocks.saturating_mul(shm.f_frsize)))
}

/// Checks that a node, service or port would have the file descriptors and `needed` bytes of shared
/// memory: iceoryx2's errors do not name the lack of one of them (#624).
pub(crate) fn check_left(needed: usize) -> Result<(), CapacityError> {
    check_memory(needed)?;
    let limit = descriptors_limit();
    let used = descriptors_used().unwrap_or(limit);
    let needed = used.saturating_add(PORT_DESCRIPTORS);
    if needed > limit {
        return Err(CapacityError::Descriptors { needed, used, limit });
    }
    Ok(())
}

/// Checks that a file of `needed` bytes in shared memory could be created and mapped.
pub(crate) fn check_memory(needed: usize) -> Result<(), CapacityError> {
    let (needed, (free, _)) = (needed as u64, shared_memory()?);
    if needed > free {
        return Err(CapacityError::Memory { needed, free });
    }
    check_files(1)?;
    check_file_size(needed)?;
    check_address_space(needed)
}

fn check_file_size(needed: u64) -> Result<(), CapacityError> {
    match getrlimit(Resource::Fsize).current {
        Some(limit) if needed > limit => Err(CapacityError::FileSize { needed, limit }),
        _ => Ok(()),
    }
}

fn check_address_space(needed: u64) -> Result<(), CapacityError> {
    let Some(limit) = getrlimit(Resource::As).current else { return Ok(()) };
    let used = address_space().unwrap_or(0);
    if used.saturating_add(needed) > limit {
        return Err(CapacityError::AddressSpace { needed, used, limit });
    }
    Ok(())
}

/// Checks that a process could join. Of one that could not, what it made is removed again: what is
/// left then does not show what was lacking.
pub(crate) fn check_start() -> Result<(), CapacityError> {
    check_memory(PROCESS_BYTES)?;
    check_files(START_FILES)
}

fn check_files(needed: u64) -> Result<(), CapacityError> {
    let shm = rustix::fs::statvfs(SHM_DIR).map_err(|error| CapacityError::Measure(error.into()))?;
    let (free, files) = (shm.f_favail, shm.f_files);
    // A file system without a limit states 0 of 0.
    if files > 0 && free < needed {
        return Err(CapacityError::Files { needed, free, files });
    }
    Ok(())
}

/// Bytes of address space that this process has mapped.
fn address_space() -> Option<u64> {
    let pages: u64 =
        std::fs::read_to_string("/proc/self/statm").ok()?.split(' ').next()?.parse().ok()?;
    Some(pages.saturating_mul(rustix::param::page_size() as u64))
}

/// Bytes of the memory that one publisher writes its frames to: a header and up to `max_len` rows.
pub(crate) fn segment_bytes(
    limits: &Limits,
    flow: Flow,
    (header, row): (usize, usize),
    max_len: usize,
) -> u64 {
    let frame = FRAME_OVERHEAD + header + row * max_len;
    (limits.shape(flow).frames() * frame + SEGMENT_OVERHEAD) as u64
}

/// Bytes of the memory that the port for answers writes to, as iceoryx2 counts them: for each
/// question in a queue or a client's hands, one response buffered, borrowed and loaned.
pub(crate) const fn server_bytes(clients: usize) -> u64 {
    let frame = FRAME_OVERHEAD + size_of::<AnswerHeader>() + 8 * MAX_ANSWER_WORDS;
    (clients * 2 * ACTIVE_QUERIES * 3 * frame + SEGMENT_OVERHEAD) as u64
}

/// Bytes of the memory that a client writes its questions to.
pub(crate) const fn client_bytes() -> u64 {
    let frame = FRAME_OVERHEAD + size_of::<QueryHeader>() + 8 * MAX_QUERY_VALUES;
    ((2 * ACTIVE_QUERIES + 1) * frame + SEGMENT_OVERHEAD) as u64
}

/// Sums over the ports of all channels.
struct Sums<'a> {
    limits: &'a Limits,
    /// Bytes of a source's segments, and of a worker's.
    bytes: (u64, u64),
    /// Channels that planners read.
    read: usize,
}

impl ForEachChannel for Sums<'_> {
    fn channel<C: Channel>(&mut self) {
        let sizes = (size_of::<C::Header>(), size_of::<C::Row>());
        let bytes = segment_bytes(self.limits, C::FLOW, sizes, self.limits.rows(C::ROWS));
        match C::FLOW {
            Flow::Sources => self.bytes.0 += bytes,
            Flow::Planners { .. } | Flow::Recorders { .. } => self.bytes.1 += bytes,
        }
        self.read += usize::from(matches!(C::FLOW, Flow::Planners { .. }));
    }
}

impl<'a> Sums<'a> {
    fn new(limits: &'a Limits) -> Self {
        let mut sums = Self { limits, bytes: (0, 0), read: 0 };
        each_channel(&mut sums);
        sums
    }
}

fn needed_bytes(limits: &Limits, ports: Ports) -> u64 {
    let Sums { bytes: (of_source, of_worker), read, .. } = Sums::new(limits);
    let of_worker = of_worker + server_bytes(limits.query_clients());
    let connections = ports.workers * (ports.sources + read * ports.planners);
    let processes = ports.sources + ports.workers + ports.planners;
    let small = connections * CONNECTION_BYTES + processes * PROCESS_BYTES;
    ports.sources as u64 * of_source + ports.workers as u64 * of_worker + small as u64
}

fn descriptors(limits: &Limits) -> u64 {
    // One more for the channels that recorders alone read.
    let read = Sums::new(limits).read + 1;
    let connections =
        limits.shape(Samples::FLOW).publishers + read * limits.shape(Forecasts::FLOW).subscribers;
    BASE_DESCRIPTORS + CONNECTION_DESCRIPTORS * connections as u64
}

/// Reason that the ports would not fit.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum CapacityError {
    /// Too little shared memory.
    #[error(
        "shared memory: {needed} bytes needed, {free} free in {SHM_DIR}. Lower `capacity` or \
         `max_planners`, enlarge it (`mount -o remount,size=… {SHM_DIR}`, in a container \
         `--shm-size`), or remove stale files with `joulebus doctor --fix`"
    )]
    Memory { needed: u64, free: u64 },
    /// Too few file descriptors.
    #[error(
        "file descriptors: {needed} needed ({used} of them in use), {limit} allowed. Raise the \
         limit (`ulimit -n {needed}`)"
    )]
    Descriptors { needed: u64, used: u64, limit: u64 },
    /// Too few files can be created in shared memory, although bytes are free.
    #[error(
        "shared memory: {needed} files needed, {free} of the {files} that {SHM_DIR} may hold are \
         free. Remove some (stale ones with `joulebus doctor --fix`), or allow more (`mount -o \
         remount,nr_inodes=… {SHM_DIR}`)"
    )]
    Files { needed: u64, free: u64, files: u64 },
    /// The process may not map more memory.
    #[error(
        "address space: {needed} bytes more needed, {used} used, {limit} allowed. Raise the limit \
         (`ulimit -v {}`)",
        needed.saturating_add(*used).div_ceil(1024)
    )]
    AddressSpace { needed: u64, used: u64, limit: u64 },
    /// The process may not write files of that size.
    #[error(
        "shared memory: a file of {needed} bytes is needed, {limit} allowed. Raise the limit of \
         sizes of files (`ulimit -f {}`)",
        needed.div_ceil(1024)
    )]
    FileSize { needed: u64, limit: u64 },
    /// The stack may not grow as far as is needed.
    #[error(
        "stack: {needed} bytes needed, {limit} allowed. Raise the limit (`ulimit -s {}`)",
        needed / 1024
    )]
    Stack { needed: u64, limit: u64 },
    /// The system refuses to allocate shared memory for another reason than its size.
    #[error("shared memory: {bytes} bytes in {SHM_DIR} cannot be allocated: {error}")]
    Reserve { bytes: u64, error: io::Error },
    /// Free shared memory or file descriptors could not be read.
    #[error("cannot read how much shared memory or how many file descriptors are free: {0}")]
    Measure(io::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with sums that name each channel, of the ten channels that there are.
    #[test]
    fn every_channel_and_its_readers_count() {
        for (capacity, max_planners, [sources, workers, planners], bytes, open_files) in [
            (64, 8, [1, 1, 1], 16_194_352, 556),
            (1_000, 32, [4, 1, 9], 166_621_872, 1_228),
            (10_000, 60, [0, 2, 3], 4_208_414_112, 2_012),
        ] {
            let limits = Limits { capacity, max_planners, ..Limits::default() };
            let found = needed_bytes(&limits, Ports { sources, workers, planners });
            assert_eq!((found, descriptors(&limits)), (bytes, open_files), "{capacity}");
        }
    }
}
