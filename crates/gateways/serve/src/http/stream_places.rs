//! Places of streams: how many there are, and how many one client may have.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::ApiError;
use super::listen::Peer;

/// Maximum number of streams.
const MAX_STREAMS: usize = 128;
/// Maximum number of streams of one address or user, so that none takes all.
const MAX_PER_CLIENT: usize = 64;

/// The streams that are open, by who reads them.
#[derive(Debug, Default)]
pub(super) struct StreamPlaces {
    open: Mutex<HashMap<Peer, usize>>,
}

/// The slot of a stream, released when dropped.
#[derive(Debug)]
pub(super) struct StreamPlace {
    places: Arc<StreamPlaces>,
    peer: Peer,
}

impl StreamPlaces {
    /// A place for one more stream.
    ///
    /// # Errors
    /// There are as many as may be, of all or of `peer`.
    pub(super) fn enter(self: &Arc<Self>, peer: Peer) -> Result<StreamPlace, ApiError> {
        let mut open = self.lock();
        let of_one = open.get(&peer).copied().unwrap_or(0);
        let (found, whose) = if of_one >= MAX_PER_CLIENT {
            (of_one, " of one address or user")
        } else {
            (open.values().sum(), "")
        };
        if of_one >= MAX_PER_CLIENT || found >= MAX_STREAMS {
            let text = format!("{found} streams{whose} are open: close one, or ask later");
            return Err(ApiError::busy(text));
        }
        *open.entry(peer).or_default() += 1;
        Ok(StreamPlace { places: Arc::clone(self), peer })
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Peer, usize>> {
        // Nothing panics while the lock is held.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for StreamPlace {
    fn drop(&mut self) {
        let mut open = self.places.lock();
        if let Some(count) = open.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.peer);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_client_has_all_places_and_all_are_given_back() {
        let places = Arc::<StreamPlaces>::default();
        let [one, other, user] = [
            Peer::Address([127, 0, 0, 1].into()),
            Peer::Address([10, 0, 0, 1].into()),
            Peer::User(0),
        ];
        let of = |peer| -> Vec<StreamPlace> {
            (0..200).filter_map(|_| places.enter(peer).ok()).collect()
        };
        let ones = of(one);
        assert_eq!(ones.len(), 64);
        let refused = places.enter(one).unwrap_err();
        assert!(refused.text.contains("64 streams of one"), "{refused:?}");
        let others = of(other);
        assert_eq!(others.len(), 64);
        let refused = places.enter(user).unwrap_err();
        assert!(refused.text.contains("128 streams are"), "{refused:?}");
        drop(ones);
        assert_eq!(of(user).len(), 64);
        drop(others);
        assert!(places.lock().is_empty());
    }
}
