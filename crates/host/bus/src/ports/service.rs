//! Opens services: the first process creates a service, with limits that all others must share.
#![allow(unsafe_code)] // iceoryx2 believes what it is given as sizes of a frame's types.

use std::fmt::Debug;
use std::time::Duration;

use iceoryx2::prelude::{EventId, MessagingPattern, SemanticString, ServiceName};
use iceoryx2::service::Service as _;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue, AttributeVerifier};
use iceoryx2::service::builder::event::{EventCreateError, EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::builder::request_response::{
    RequestResponseCreateError, RequestResponseOpenError, RequestResponseOpenOrCreateError,
};
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::PortFactory as PortFactoryOfAny;
use iceoryx2::service::port_factory::event::PortFactory as EventFactory;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::port_factory::request_response::PortFactory as RequestResponseFactory;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use joulebus_wire::{AnswerHeader, Channel, Flow, QueryHeader, Service, WakeEvent, service_name};

use crate::cleanup::dead_nodes::remove_dead_nodes;
use crate::cleanup::incomplete::{Abandoned, holders, remove_incomplete};
use crate::cleanup::objects::named;
use crate::ipc::Ipc;
use crate::liveness::presence::RequiredFiles;
use crate::membership::Membership;
use crate::os::fork::ForkSection;
use crate::preflight::{PORT_BYTES, check_left};
use crate::reserved::take_shortage;
use crate::{Bus, CapacityError, FilesRemoved, Limits, SweepReport, clock};
use joulebus_settings::ACTIVE_QUERIES;

/// The attribute of a service with its limits.
const LIMITS_KEY: &[u8] = b"joulebus.limits";
/// Timeout of retries of opening a service, ns.
const OPEN_TIMEOUT_NS: u64 = 4_000_000_000;
const OPEN_RETRY_AFTER: Duration = Duration::from_millis(20);

/// The factory of a channel's ports: its types are stated when it is opened. Types that the
/// compiler knows would be a copy of iceoryx2's ports for each channel, in each crate that has one.
pub(super) type Factory = PortFactory<Ipc, [CustomPayloadMarker], CustomHeaderMarker>;

/// What the ports of a channel are opened with.
pub(super) struct FrameTypes {
    pub(super) service: Service,
    pub(super) flow: Flow,
    header: TypeDetail,
    row: TypeDetail,
}

impl FrameTypes {
    pub(super) fn of<C: Channel>() -> Self {
        Self {
            service: C::SERVICE,
            flow: C::FLOW,
            header: TypeDetail::new::<C::Header>(TypeVariant::FixedSize),
            row: TypeDetail::new::<C::Row>(TypeVariant::Dynamic),
        }
    }

    /// Bytes of a header, and of a row.
    pub(super) fn sizes(&self) -> (usize, usize) {
        (self.header.size(), self.row.size())
    }
}

pub(super) fn open(bus: &Bus, limits: &Limits, types: &FrameTypes) -> Result<Factory, OpenError> {
    let (service, shape) = (types.service, limits.shape(types.flow));
    bus.member.presence.look()?;
    // Forget an earlier attempt's.
    let _ = take_shortage();
    let name = name(bus, service)?;
    let open = || {
        let builder = bus.node.service_builder(&name).publish_subscribe::<[CustomPayloadMarker]>();
        let builder = builder.user_header::<CustomHeaderMarker>();
        // SAFETY: only `FrameTypes::of` makes these. So sizes and alignments are those of the types
        // with which `channel.rs` reads and writes the frames of the ports.
        let builder = unsafe {
            builder
                .__internal_set_payload_type_details(&types.row)
                .__internal_set_user_header_type_details(&types.header)
        };
        builder
            .max_publishers(shape.publishers)
            .max_subscribers(shape.subscribers)
            .max_nodes(limits.nodes())
            .subscriber_max_buffer_size(shape.buffer)
            .subscriber_max_borrowed_samples(shape.borrowed)
            .history_size(shape.history)
            .enable_safe_overflow(true)
            .open_or_create_with_attributes(&verifier(limits))
    };
    retry(bus, &name, open, is_transient).map_err(|reason| {
        let differs = matches!(
            reason,
            PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
                PublishSubscribeOpenError::IncompatibleAttributes
            )
        );
        let pattern = MessagingPattern::PublishSubscribe;
        refused(bus, service, limits, pattern, differs, reason)
    })
}

pub(super) fn open_event(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    (listeners, notifiers): (usize, usize),
) -> Result<EventFactory<Ipc>, OpenError> {
    bus.member.presence.look()?;
    // Forget an earlier attempt's.
    let _ = take_shortage();
    let name = name(bus, service)?;
    let open = || {
        bus.node
            .service_builder(&name)
            .event()
            .max_listeners(listeners)
            .max_notifiers(notifiers)
            .max_nodes(limits.nodes())
            .event_id_max_value(WakeEvent::Unreachable.id())
            .notifier_dead_event(EventId::new(WakeEvent::Died.id()))
            .open_or_create_with_attributes(&verifier(limits))
    };
    retry(bus, &name, open, is_transient_event).map_err(|reason| {
        let differs = matches!(
            reason,
            EventOpenOrCreateError::EventOpenError(EventOpenError::IncompatibleAttributes)
        );
        let pattern = MessagingPattern::Event;
        refused(bus, service, limits, pattern, differs, reason)
    })
}

/// The service of questions.
pub(super) type QueryFactory = RequestResponseFactory<Ipc, [f64], QueryHeader, [u64], AnswerHeader>;

pub(super) fn open_queries(bus: &Bus, limits: &Limits) -> Result<QueryFactory, OpenError> {
    bus.member.presence.look()?;
    // Forget an earlier attempt's.
    let _ = take_shortage();
    let name = name(bus, Service::ASK)?;
    let open = || {
        bus.node
            .service_builder(&name)
            .request_response::<[f64], [u64]>()
            .request_user_header::<QueryHeader>()
            .response_user_header::<AnswerHeader>()
            .max_servers(1)
            .max_clients(limits.query_clients())
            .max_nodes(limits.nodes())
            .max_active_requests_per_client(ACTIVE_QUERIES)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(false)
            .open_or_create_with_attributes(&verifier(limits))
    };
    retry(bus, &name, open, is_transient_query).map_err(|reason| {
        let differs = matches!(
            reason,
            RequestResponseOpenOrCreateError::RequestResponseOpenError(
                RequestResponseOpenError::IncompatibleAttributes
            )
        );
        let pattern = MessagingPattern::RequestResponse;
        refused(bus, Service::ASK, limits, pattern, differs, reason)
    })
}

/// Opens a service. Errors caused by a process killed while it created or left the service are
/// transient: cleaning up and retrying resolves them. iceoryx2 retries some of them (#1578).
fn retry<S, E: Debug>(
    bus: &Bus,
    name: &ServiceName,
    open: impl Fn() -> Result<S, E>,
    is_transient: impl Fn(&E) -> bool,
) -> Result<S, E> {
    let limit_ns = clock::monotonic_ns() + OPEN_TIMEOUT_NS;
    let mut abandoned = Abandoned::default();
    loop {
        // A child has what a thread has locked, and keeps it locked if this process is killed.
        let section = ForkSection::enter();
        let error = match open() {
            Err(error) if is_transient(&error) => error,
            result => return result,
        };
        let is_full = check_left(PORT_BYTES).is_err();
        if is_full || clock::monotonic_ns() > limit_ns {
            let pids = holders(bus.domain());
            if !pids.is_empty() {
                tracing::warn!(
                    ?pids,
                    "these processes take long to make or remove a service. Are they stopped?"
                );
            }
            return Err(error);
        }
        let mut report = SweepReport::default();
        remove_dead_nodes(&bus.member.config, &mut report);
        report.incomplete = remove_incomplete(bus.domain()).unwrap_or(0)
            + abandoned.remove(bus.domain(), name.as_str());
        drop(section);
        tracing::info!(service = name.as_str(), ?error, ?report, "opening a service again");
        std::thread::sleep(OPEN_RETRY_AFTER);
    }
}

/// Creates a port. Ports of killed processes take places until members, once a second, remove their
/// nodes. If no place is left that is done at once, as long as there are such nodes.
pub(super) fn create<P, E>(
    bus: &Bus,
    port: impl Fn() -> Result<P, E>,
    is_full: impl Fn(&E) -> bool,
) -> Result<P, E> {
    let limit_ns = clock::monotonic_ns() + OPEN_TIMEOUT_NS;
    // A port that fails may be the last of its service.
    let port = || {
        let _section = ForkSection::enter();
        port()
    };
    loop {
        match port() {
            Err(error) if is_full(&error) => {}
            result => return result,
        }
        let mut report = SweepReport::default();
        let is_any_dead = remove_dead_nodes(&bus.member.config, &mut report);
        if !is_any_dead || clock::monotonic_ns() > limit_ns {
            // Another member may have removed them meanwhile.
            return port();
        }
        std::thread::sleep(OPEN_RETRY_AFTER);
    }
}

const fn is_transient(error: &PublishSubscribeOpenOrCreateError) -> bool {
    use PublishSubscribeCreateError as Create;
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Error;
    matches!(
        error,
        Error::SystemInFlux
            | Error::PublishSubscribeOpenError(
                Open::HangsInCreation
                    | Open::IsMarkedForDestruction
                    | Open::DoesNotExist
                    | Open::ServiceInCorruptedState
                    | Open::ExceedsMaxNumberOfNodes
                    | Open::Interrupt
            )
            | Error::PublishSubscribeCreateError(
                Create::HangsInCreation
                    | Create::IsBeingCreatedByAnotherInstance
                    | Create::AlreadyExists
                    | Create::ServiceInCorruptedState
                    | Create::Interrupt
            )
    )
}

const fn is_transient_event(error: &EventOpenOrCreateError) -> bool {
    use EventCreateError as Create;
    use EventOpenError as Open;
    use EventOpenOrCreateError as Error;
    matches!(
        error,
        Error::SystemInFlux
            | Error::EventOpenError(
                Open::HangsInCreation
                    | Open::IsMarkedForDestruction
                    | Open::DoesNotExist
                    | Open::ServiceInCorruptedState
                    | Open::ExceedsMaxNumberOfNodes
                    | Open::Interrupt
            )
            | Error::EventCreateError(
                Create::IsBeingCreatedByAnotherInstance
                    | Create::AlreadyExists
                    | Create::ServiceInCorruptedState
                    | Create::Interrupt
            )
    )
}

const fn is_transient_query(error: &RequestResponseOpenOrCreateError) -> bool {
    use RequestResponseCreateError as Create;
    use RequestResponseOpenError as Open;
    use RequestResponseOpenOrCreateError as Error;
    matches!(
        error,
        Error::SystemInFlux
            | Error::RequestResponseOpenError(
                Open::HangsInCreation
                    | Open::IsMarkedForDestruction
                    | Open::DoesNotExist
                    | Open::ServiceInCorruptedState
                    | Open::ExceedsMaxNumberOfNodes
                    | Open::Interrupt
            )
            | Error::RequestResponseCreateError(
                Create::HangsInCreation
                    | Create::IsBeingCreatedByAnotherInstance
                    | Create::AlreadyExists
                    | Create::ServiceInCorruptedState
                    | Create::Interrupt
            )
    )
}

/// Returns an error if an object could not be created for lack of memory since the last call.
pub(super) fn check_shortage() -> Result<(), CapacityError> {
    take_shortage().map_or(Ok(()), Err)
}

/// Files that other processes need of a service that this process has open, and of its own port
/// there, if any.
pub(super) fn need(
    member: &Membership,
    factory: &impl PortFactoryOfAny,
    port: Option<u128>,
) -> RequiredFiles {
    let domain = &member.domain;
    let mut paths = named(domain, factory.service_hash().as_str(), &[".service"]);
    let service = factory.unique_service_id().value().to_string();
    paths.extend(named(domain, &service, &[".dynamic"]));
    if let Some(port) = port {
        let suffixes = [".data", ".event", ".event_mgmt"];
        paths.extend(named(domain, &port.to_string(), &suffixes));
    }
    member.presence.need(paths)
}

fn name(bus: &Bus, service: Service) -> Result<ServiceName, OpenError> {
    ServiceName::new(&service_name(bus.domain().fleet(), service))
        .map_err(|reason| OpenError::port(service, reason))
}

fn verifier(limits: &Limits) -> AttributeVerifier {
    let key = AttributeKey::new(LIMITS_KEY);
    let value = AttributeValue::new(limits.describe().as_bytes());
    let (Ok(key), Ok(value)) = (key, value) else {
        // Never: the key is constant, and five numbers of at most 20 digits are shorter than 256
        // bytes.
        return AttributeVerifier::new();
    };
    // One attribute always fits.
    AttributeVerifier::new().require(&key, &value).unwrap_or_default()
}

fn refused(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    pattern: MessagingPattern,
    differs: bool,
    reason: impl Debug,
) -> OpenError {
    if differs
        && let Ok(name) = name(bus, service)
        && let Ok(Some(details)) = Ipc::details(&name, &bus.member.config, pattern)
        && let Ok(key) = AttributeKey::new(LIMITS_KEY)
        && let Some(found) = details.static_details.attributes().key_value(&key, 0)
    {
        return OpenError::Limits {
            service: service.name(),
            found: found.to_string(),
            wanted: limits.describe(),
        };
    }
    OpenError::port(service, format_args!("{reason:?}"))
}

/// Reason that a port could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum OpenError {
    /// Another process of the fleet uses other limits.
    #[error(
        "service {service:?} runs with limits {found}, wanted are {wanted}. Use one config for \
         all processes of a fleet, and restart those with the old one"
    )]
    Limits { service: &'static str, found: String, wanted: String },
    /// A length of frame of 0, or beyond the capacity.
    #[error("frames of up to {found} samples: allowed are 1 to {allowed}, the fleet's capacity")]
    Length { found: usize, allowed: usize },
    /// Too little shared memory.
    #[error(transparent)]
    Capacity(#[from] CapacityError),
    /// Files of this process were removed: iceoryx2 would recreate them for this process only.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// All places that are not reserved are taken.
    #[error(
        "service {service:?}: all {allowed} ports that are not reserved are taken, by {holders}. \
         End one of them. A greater `readers.max_planners`, set for all processes of the fleet, gives \
         planners more ports"
    )]
    Places { service: &'static str, allowed: usize, holders: String },
    /// iceoryx2 refused.
    #[error(
        "service {service:?}: {reason}. Are all processes of the same version, and are there more \
         than the limits allow? `joulebus doctor` lists them"
    )]
    Port { service: &'static str, reason: String },
}

impl OpenError {
    pub(super) fn port(service: Service, reason: impl std::fmt::Display) -> Self {
        match check_shortage().and_then(|()| check_left(PORT_BYTES)) {
            Err(full) => Self::Capacity(full),
            Ok(()) => Self::Port { service: service.name(), reason: reason.to_string() },
        }
    }
}
