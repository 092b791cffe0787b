//! The zenoh session and what is declared in it. Another session can replace it, and then has the
//! same declarations.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;

use crate::contact::Contact;
use crate::protocol::carried::Kind;

/// Pause before the next attempt to open a session.
const RETRY_OPEN_NS: u64 = 1_000_000_000;

/// What a subscription receives.
type Deliver = Arc<dyn Fn(&Sample) + Send + Sync>;

/// The key of a subscription.
#[derive(Debug, Clone)]
pub(crate) enum Declared {
    Messages(String),
    /// The links that are present, and the loss of them.
    Presence(String),
}

/// An open session of zenoh. Its members are dropped in this order.
struct Open {
    _subscriptions: Vec<Subscriber<()>>,
    _token: LivelinessToken,
    zenoh: zenoh::Session,
}

#[derive(Default)]
struct State {
    open: Option<Open>,
    declared: Vec<(Declared, Deliver)>,
    contacts: BTreeMap<(Kind, String), Arc<Contact>>,
    retry_ns: u64,
}

pub(crate) struct Session {
    /// The configuration of sessions that replace the first one.
    config: zenoh::Config,
    /// Key of the token that announces this link.
    token: String,
    /// Number of the session, from 1.
    number: AtomicU64,
    state: Mutex<State>,
}

impl fmt::Debug for Session {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { token, number, .. } = self;
        let mut shown = out.debug_struct("Session");
        shown.field("token", token).field("number", number).finish_non_exhaustive()
    }
}

impl Session {
    /// Opens the first session. `again` is the configuration of all others.
    pub(crate) fn open(
        config: zenoh::Config,
        again: zenoh::Config,
        token: String,
    ) -> zenoh::Result<Self> {
        let open = Open::new(config, &token, &[])?;
        let state = Mutex::new(State { open: Some(open), ..State::default() });
        Ok(Self { config: again, token, number: AtomicU64::new(1), state })
    }

    /// Number of the session. Publishers of an earlier one send nothing any more.
    pub(crate) fn number(&self) -> u64 {
        self.number.load(Ordering::Acquire)
    }

    /// What is known of a stream from the link `from`.
    pub(crate) fn contact(&self, kind: Kind, from: &str) -> Arc<Contact> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(state.contacts.entry((kind, from.to_owned())).or_default())
    }

    /// Subscribes `deliver` in this session and all later ones.
    pub(crate) fn declare(&self, declared: Declared, deliver: Deliver) -> zenoh::Result<()> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = &mut state.open {
            let subscription = subscribed(&open.zenoh, &declared, &deliver)?;
            open._subscriptions.push(subscription);
        }
        state.declared.push((declared, deliver));
        Ok(())
    }

    /// The publisher of a key, and the number of its session. `None` while no session is open.
    /// Never blocks: a session may be being opened.
    pub(crate) fn publisher(&self, key: &str) -> zenoh::Result<Option<(u64, Publisher<'static>)>> {
        let Ok(state) = self.state.try_lock() else {
            return Ok(None);
        };
        let Some(open) = &state.open else {
            return Ok(None);
        };
        let publisher = open
            .zenoh
            .declare_publisher(key.to_owned())
            .congestion_control(CongestionControl::Drop)
            .express(true)
            .wait()?;
        Ok(Some((self.number(), publisher)))
    }

    /// Name of a link whose stream has stopped, although it is present.
    pub(crate) fn is_split(&self, now_ns: u64) -> Option<String> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut contacts = state.contacts.iter();
        let split = contacts.find(|(_, contact)| contact.is_split(now_ns));
        split.map(|((_, from), _)| from.clone())
    }

    /// Ends the session. Peers learn of it, unless they are out of reach.
    pub(crate) fn close(&self, now_ns: u64) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = state.open.take()
            && let Err(error) = open.zenoh.close().wait()
        {
            tracing::debug!(%error, "the session was not closed");
        }
        state.contacts.values().for_each(|contact| contact.ends(now_ns));
    }

    /// Opens another session if none is open.
    pub(crate) fn open_if_closed(&self, now_ns: u64) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.open.is_some() || now_ns < state.retry_ns {
            return;
        }
        match Open::new(self.config.clone(), &self.token, &state.declared) {
            Ok(open) => {
                state.open = Some(open);
                self.number.fetch_add(1, Ordering::AcqRel);
            }
            Err(error) => {
                tracing::warn!("the network cannot be opened again: {error}");
                state.retry_ns = now_ns.saturating_add(RETRY_OPEN_NS);
            }
        }
    }
}

impl Open {
    fn new(
        config: zenoh::Config,
        token: &str,
        declared: &[(Declared, Deliver)],
    ) -> zenoh::Result<Self> {
        let zenoh = zenoh::open(config).wait()?;
        let token = zenoh.liveliness().declare_token(token.to_owned()).wait()?;
        let subscriptions = declared.iter().map(|(key, deliver)| subscribed(&zenoh, key, deliver));
        Ok(Self { _subscriptions: subscriptions.collect::<Result<_, _>>()?, _token: token, zenoh })
    }
}

fn subscribed(
    zenoh: &zenoh::Session,
    declared: &Declared,
    deliver: &Deliver,
) -> zenoh::Result<Subscriber<()>> {
    let deliver = Arc::clone(deliver);
    let callback = move |sample: Sample| deliver(&sample);
    match declared {
        Declared::Messages(key) => zenoh.declare_subscriber(key.clone()).callback(callback).wait(),
        Declared::Presence(key) => {
            // Links that were present before count too.
            let liveliness = zenoh.liveliness();
            liveliness.declare_subscriber(key.clone()).history(true).callback(callback).wait()
        }
    }
}
