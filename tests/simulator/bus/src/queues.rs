//! The contents of shared memory: queues of readers, and waiters.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

use joulebus_simulated_host::{self as host, memory::outside};
use joulebus_wire::{Channel, Service};

use crate::Woken;

#[derive(Debug)]
pub(crate) struct Sent<C: Channel> {
    pub(crate) header: C::Header,
    pub(crate) payload: Vec<C::Row>,
    pub(crate) port: u128,
}

impl<C: Channel> Sent<C> {
    pub(crate) const fn user_header(&self) -> &C::Header {
        &self.header
    }

    pub(crate) fn payload(&self) -> &[C::Row] {
        &self.payload
    }

    /// The port that sent it.
    pub(crate) const fn writer(&self) -> u128 {
        self.port
    }
}

/// Frames of one writer that a reader has not taken.
#[derive(Debug)]
pub(crate) struct Connection<C: Channel> {
    pub(crate) port: u128,
    pub(crate) frames: VecDeque<Rc<Sent<C>>>,
}

#[derive(Debug)]
pub(crate) struct Queue<C: Channel> {
    pub(crate) connections: Vec<Connection<C>>,
    pub(crate) buffer: usize,
    pub(crate) failed: u64,
}

/// A reader that is open.
pub(crate) struct Listed {
    pub(crate) number: u64,
    pub(crate) pid: u32,
    pub(crate) queue: Rc<dyn Any>,
}

/// Somebody who waits for an event.
#[derive(Debug)]
pub(crate) struct Waiting {
    pub(crate) number: u64,
    pub(crate) pid: u32,
    /// Thread of the process, as of the host.
    pub(crate) thread: u64,
    pub(crate) woken: Cell<Woken>,
}

#[derive(Default)]
pub(crate) struct State {
    pub(crate) readers: Vec<Listed>,
    pub(crate) writers: Vec<(u128, u32)>,
    pub(crate) waiting: Vec<Rc<Waiting>>,
}

thread_local! {
    /// By the name of the service.
    static STATES: RefCell<BTreeMap<&'static str, State>> = RefCell::default();
}

pub(crate) fn with<T>(service: Service, work: impl FnOnce(&mut State) -> T) -> T {
    outside(|| STATES.with_borrow_mut(|states| work(states.entry(service.name()).or_default())))
}

/// Begins with empty queues.
pub(crate) fn begin() {
    STATES.with_borrow_mut(|states| *states = Default::default());
}

pub(crate) fn remove_process(pid: u32) {
    let removed = STATES.with_borrow_mut(|states| {
        let mut removed = Vec::new();
        for state in states.values_mut() {
            state.writers.retain(|(_, of)| *of != pid);
            state.waiting.retain(|waiting| waiting.pid != pid);
            let (gone, left) = std::mem::take(&mut state.readers)
                .into_iter()
                .partition::<Vec<_>, _>(|reader| reader.pid == pid);
            state.readers = left;
            removed.extend(gone);
        }
        removed
    });
    drop(removed);
}

/// Number of open ports of processes.
pub(crate) fn ports(is_counted: impl Fn(u32) -> bool) -> usize {
    STATES.with_borrow(|states| {
        let pids = states.values().flat_map(|state| {
            let readers = state.readers.iter().map(|reader| reader.pid);
            let writers = state.writers.iter().map(|(_, pid)| *pid);
            readers.chain(writers).chain(state.waiting.iter().map(|waiting| waiting.pid))
        });
        pids.filter(|pid| is_counted(*pid)).count()
    })
}

/// A port id as iceoryx2's: words of 32 bits, the third is the process.
pub(crate) fn port_id(pid: u32) -> u128 {
    let number = host::number();
    let words = [(number >> 32) as u32, number as u32, pid, 0];
    let mut bytes = [0; 16];
    for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_ne_bytes());
    }
    u128::from_ne_bytes(bytes)
}
