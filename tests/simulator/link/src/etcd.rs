//! The lease store, as one simulated host reaches it.

use std::cell::RefCell;
use std::sync::{Arc, Mutex, PoisonError};

use joulebus_simulated_host::{self as host, time};

use crate::config::LeaseSettings;
use crate::protocol::lease::{Call, Reply};
use crate::store::Store;

/// Maximum time that a call takes each way, ns. Meanwhile the whole host stands still.
const MAX_DELAY_NS: usize = 3_000_000;

/// The store of all hosts of a simulation.
#[derive(Debug, Clone, Default)]
pub struct SharedStore(Arc<Mutex<Store>>);

impl SharedStore {
    /// The link that holds the lease.
    pub fn holder(&self) -> Option<String> {
        let store = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        store.holder.as_ref().map(|holder| holder.name.clone())
    }
}

/// Behaviour of the store towards this host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// The store answers, but one reply in so many is lost.
    Lossy(usize),
    /// The store does not answer, although every other call arrives.
    Silent,
    Cut,
}

thread_local! {
    static STORE: RefCell<Option<(SharedStore, Access)>> = const { RefCell::new(None) };
}

/// From now on this host reaches the store so.
pub fn reach(store: &SharedStore, access: Access) {
    STORE.set(Some((store.clone(), access)));
}

pub(crate) struct Etcd {
    own: String,
    ttl_ns: u64,
}

impl Etcd {
    #[allow(clippy::unnecessary_wraps, reason = "as in the real client")]
    pub(crate) fn new(settings: &LeaseSettings, (_, own): (&str, &str)) -> anyhow::Result<Self> {
        let ttl_ns = u64::from(settings.ttl_s) * 1_000_000_000;
        Ok(Self { own: own.to_owned(), ttl_ns })
    }

    pub(crate) fn call(&mut self, call: &Call) -> Reply {
        host::operation();
        let Some((store, access)) = STORE.with_borrow(Clone::clone) else {
            return Reply::Failed;
        };
        if host::is_dead() {
            return Reply::Failed;
        }
        time::pass(host::below(MAX_DELAY_NS) as u64);
        if access == Access::Cut || (access == Access::Silent && host::once_in(2)) {
            return Reply::Failed;
        }
        let reply = {
            let mut store = store.0.lock().unwrap_or_else(PoisonError::into_inner);
            store.answer(&self.own, call, time::now_ns(), self.ttl_ns)
        };
        time::pass(host::below(MAX_DELAY_NS) as u64);
        // The caller may die before it knows the reply.
        host::operation();
        match access {
            Access::Lossy(times) if !host::once_in(times) => reply,
            _ => Reply::Failed,
        }
    }
}
