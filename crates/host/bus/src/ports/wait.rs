//! Events: sending them, and waiting for them with `poll` and nanosecond deadlines, without
//! allocation.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;

use iceoryx2::port::listener::{Listener, ListenerCreateError};
use iceoryx2::port::notifier::{Notifier, NotifierCreateError};
use iceoryx2::prelude::{CallbackProgression, EventId, FileDescriptorBased};
use iceoryx2::service::port_factory::PortFactory as _;
use joulebus_wire::{Service, WakeEvent};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::places::{OpenPlaces, Places};
use super::service::{self, OpenError, need, open_event};
use crate::ipc::Ipc;
use crate::liveness::guarded::Guarded;
use crate::membership::Membership;
use crate::os::watchers::Watchers;
use crate::{Bus, FilesRemoved, Limits, PeerWatch, clock};

/// Maximum duration of a sleep. A notification that races with the emptying of the listener can
/// leave its descriptor not readable although events are pending, and a signal may arrive just
/// before the sleep: this bounds both.
pub(super) const MAX_SLEEP_NS: u64 = 100_000_000;

/// Sends a service's event.
#[derive(Debug)]
pub struct Waker {
    notifier: Guarded<Notifier<Ipc>>,
    // Dropped after the port.
    _member: Rc<Membership>,
}

impl Waker {
    pub(super) fn open(
        bus: &Bus,
        service: Service,
        limits: &Limits,
        ports: (usize, usize),
    ) -> Result<Self, OpenError> {
        let factory = open_event(bus, service, limits, ports)?;
        let create = || {
            factory
                .notifier_builder()
                .default_event_id(EventId::new(WakeEvent::Frame.id()))
                .create()
        };
        let is_full =
            |error: &_| matches!(error, NotifierCreateError::ExceedsMaxSupportedNotifiers);
        let notifier = service::create(bus, create, is_full)
            .map_err(|reason| OpenError::port(service, reason))?;
        Ok(Self {
            notifier: Guarded::new(notifier, need(&bus.member, &factory, None)),
            _member: Rc::clone(&bus.member),
        })
    }

    /// Wakes all waiters. About 1 µs for each that sleeps. Allocates only if waiters have joined or
    /// left. Returns the number of waiters notified.
    ///
    /// # Errors
    /// [`WaitError::Notify`].
    pub fn wake(&self, event: WakeEvent) -> Result<usize, WaitError> {
        self.notifier
            .notify_with_custom_event_id(EventId::new(event.id()))
            .map_err(|reason| WaitError::Notify { reason: reason.to_string() })
    }

    /// Wakes the waiter of this id ([`Waiter::id`]), if there is one.
    pub(super) fn wake_one(&self, waiter: u128, event: WakeEvent) -> Result<(), WaitError> {
        let mut woken = Ok(());
        self.notifier.for_each_listener(|one, listener| {
            if listener.listener_id.value() != waiter {
                return CallbackProgression::Continue;
            }
            woken = one.notify_with_custom_event_id(EventId::new(event.id()));
            CallbackProgression::Stop
        });
        woken.map_err(|reason| WaitError::Notify { reason: reason.to_string() })
    }
}

/// Reason that [`Waiter::wait_until`] returned. Nothing set: at the deadline, or after 100 ms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Woken {
    /// A frame can be read.
    pub frame: bool,
    /// A process of the other side was found dead.
    pub died: bool,
    /// A process of the other side has shut down.
    pub ended: bool,
    /// The other side is on another host, and nothing comes from there.
    pub unreachable: bool,
    /// The watched process is gone.
    pub peer_gone: bool,
    /// A signal arrived.
    pub interrupted: bool,
}

impl Woken {
    /// True if nothing is set.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// Waits for a service's events.
#[derive(Debug)]
pub struct Waiter {
    pub(super) watchers: Watchers,
    listener: Guarded<Listener<Ipc>>,
    // Dropped after the port.
    member: Rc<Membership>,
}

impl Waiter {
    pub(super) fn open(
        bus: &Bus,
        service: Service,
        limits: &Limits,
        ports: (usize, usize),
        open: Option<OpenPlaces>,
    ) -> Result<Self, OpenError> {
        let factory = open_event(bus, service, limits, ports)?;
        let nodes = || {
            let mut nodes = Vec::new();
            factory.dynamic_config().list_listeners(|listener| {
                nodes.push(listener.node_id);
                CallbackProgression::Continue
            });
            nodes
        };
        let places = Places { bus, service, open, nodes };
        let listener = places.create(
            || factory.listener_builder().create(),
            ListenerCreateError::ExceedsMaxSupportedListeners,
        )?;
        let need = need(&bus.member, &factory, Some(listener.id().value()));
        Ok(Self {
            watchers: Watchers::default(),
            listener: Guarded::new(listener, need),
            member: Rc::clone(&bus.member),
        })
    }

    /// Sleeps until woken, until `deadline_ns` (monotonic), until `peer` is gone, or until a signal
    /// arrives. At most 100 ms. Earlier events are found immediately. Does not allocate.
    ///
    /// # Errors
    /// [`WaitError::Removed`] if this process must end, [`WaitError::Listen`] if the listener is
    /// broken, [`WaitError::Poll`] if `poll` fails.
    pub fn wait_until(
        &mut self,
        deadline_ns: Option<u64>,
        peer: Option<&PeerWatch>,
    ) -> Result<Woken, WaitError> {
        self.member.presence.check()?;
        let mut woken = self.drain()?;
        if !woken.is_nothing() {
            woken.peer_gone = peer.is_some_and(PeerWatch::is_gone);
            return Ok(woken);
        }
        let sleep_ns = deadline_ns.map_or(MAX_SLEEP_NS, |deadline| {
            deadline.saturating_sub(clock::monotonic_ns()).min(MAX_SLEEP_NS)
        });
        let timeout = Timespec { tv_sec: 0, tv_nsec: sleep_ns.cast_signed() as _ };
        let mine = self.as_fd();
        let watched = peer.map_or(mine, PeerWatch::as_fd);
        let mut polled = [
            PollFd::from_borrowed_fd(mine, PollFlags::IN),
            PollFd::from_borrowed_fd(watched, PollFlags::IN),
        ];
        let used = if peer.is_some() { 2 } else { 1 };
        let interrupted = match poll(&mut polled[..used], Some(&timeout)) {
            Ok(_) => false,
            Err(Errno::INTR) => true,
            Err(error) => return Err(WaitError::Poll(error.into())),
        };
        let peer_gone = used == 2 && !polled[1].revents().is_empty();
        Ok(Woken { peer_gone, interrupted, ..self.drain()? })
    }

    /// Id by which a [`Waker`] finds it.
    pub(super) fn id(&self) -> u128 {
        self.listener.id().value()
    }

    /// Reads all pending events, so that the descriptor is no longer readable.
    fn drain(&self) -> Result<Woken, WaitError> {
        let mut woken = Woken::default();
        loop {
            let taken = self.listener.try_wait(|event| match event.id.as_value() {
                id if id == WakeEvent::Died.id() => woken.died = true,
                id if id == WakeEvent::Ended.id() => woken.ended = true,
                id if id == WakeEvent::Unreachable.id() => woken.unreachable = true,
                _ => woken.frame = true,
            });
            match taken {
                Ok(0) => return Ok(woken),
                Ok(_) => {}
                Err(reason) => {
                    return Err(WaitError::Listen { reason: reason.to_string() });
                }
            }
        }
    }
}

impl AsFd for Waiter {
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the descriptor is open as long as the listener lives, and the borrow ends with
        // that of `self`. It is neither closed nor kept.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }
}

impl Drop for Waiter {
    fn drop(&mut self) {
        self.watchers.remove(self.as_fd());
    }
}

/// Reason that waiting or waking failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum WaitError {
    /// Files of this process were removed.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// iceoryx2 could not notify.
    #[error("cannot wake the others: {reason}")]
    Notify { reason: String },
    /// iceoryx2 could not read the listener.
    #[error("cannot read what woke us: {reason}. Join again")]
    Listen { reason: String },
    /// `poll` failed.
    #[error("cannot wait: {0}")]
    Poll(io::Error),
}
