//! The lease store as tests and the simulator have it.

use std::collections::BTreeMap;

use crate::protocol::lease::{Call, Holder, Reply, StoreView};

/// A store like etcd. A lease ends by the store's clock when its time has passed, or somewhat
/// later.
#[derive(Debug, Default)]
pub(crate) struct Store {
    pub(crate) leases: BTreeMap<u64, u64>,
    pub(crate) holder: Option<Holder>,
    pub(crate) term: u64,
    pub(crate) term_revision: u64,
    revision: u64,
    next_lease: u64,
}

impl Store {
    pub(crate) fn expire(&mut self, now_ns: u64) {
        self.leases.retain(|_, until_ns| now_ns < *until_ns);
        let leases = &self.leases;
        self.holder = self.holder.take().filter(|holder| leases.contains_key(&holder.lease));
    }

    pub(crate) fn answer(&mut self, name: &str, call: &Call, now_ns: u64, ttl_ns: u64) -> Reply {
        self.expire(now_ns);
        match call {
            Call::Grant => {
                self.next_lease += 1;
                self.leases.insert(self.next_lease, now_ns + ttl_ns);
                Reply::Granted { lease: self.next_lease, ttl_ns }
            }
            Call::Look => Reply::StoreView(StoreView {
                holder: self.holder.clone(),
                term: self.term,
                term_revision: self.term_revision,
            }),
            Call::Acquire { lease, term, term_revision } => {
                let is_free = self.holder.is_none() && self.term_revision == *term_revision;
                // etcd answers with an error if the lease has ended.
                if !self.leases.contains_key(lease) {
                    return Reply::Failed;
                }
                if is_free {
                    self.revision += 1;
                    (self.term, self.term_revision) = (*term, self.revision);
                    self.holder =
                        Some(Holder { name: name.to_owned(), term: *term, lease: *lease });
                }
                Reply::Acquired(is_free)
            }
            Call::Release { lease } => {
                self.leases.remove(lease);
                self.expire(now_ns);
                Reply::Gone
            }
            Call::Renew { lease } => match self.leases.get_mut(lease) {
                Some(until_ns) => {
                    *until_ns = (*until_ns).max(now_ns + ttl_ns);
                    Reply::Renewed { ttl_ns }
                }
                None => Reply::Renewed { ttl_ns: 0 },
            },
        }
    }
}
