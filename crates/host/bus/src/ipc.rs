//! iceoryx2's communication between processes, with shared memory that is [`Reserved`].

use std::fmt::Debug;

use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use iceoryx2_bb_lock_free::mpmc::counting_bit_set::RelocatableCountingBitSet;
use iceoryx2_cal::event::trigger::State;
use iceoryx2_cal::event::trigger::unix_datagram_socket::GenericUnixDatagramSocketTrigger;
use iceoryx2_cal::resizable_shared_memory::dynamic::DynamicMemory;
use iceoryx2_cal::shared_memory::common::details::{AllocatorDetails, Memory};
use iceoryx2_cal::shm_allocator::bump_allocator::BumpAllocator;
use iceoryx2_cal::shm_allocator::pool_allocator::PoolAllocator;
use iceoryx2_cal::zero_copy_connection::common::details::{Connection, SharedManagementData};

use crate::description::Description;
use crate::reserved::Reserved;

/// Interoperates with [`ipc::Service`]. Differs from it only in the creation of objects, and in the
/// removal of descriptions.
#[derive(Debug, Clone)]
pub(crate) struct Ipc;

type Segment<A> = Memory<A, Reserved<AllocatorDetails<A>>>;
type Usual = ipc::Service;

impl Service for Ipc {
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Reserved<T>;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Reserved<T>;
    type BlackboardMgmt<T: Debug + Send + Sync + ZeroCopySend + 'static> = Reserved<T>;
    type SharedMemory = Segment<PoolAllocator>;
    type ResizableSharedMemory = DynamicMemory<PoolAllocator, Segment<PoolAllocator>>;
    type BlackboardPayload = Segment<BumpAllocator>;
    type Connection = Connection<Reserved<SharedManagementData>>;
    type Event = GenericUnixDatagramSocketTrigger<
        RelocatableCountingBitSet,
        Reserved<State<RelocatableCountingBitSet, ()>>,
    >;

    type StaticStorage = Description;
    type ConfigSerializer = <Usual as Service>::ConfigSerializer;
    type Bag = <Usual as Service>::Bag;
    type ServiceNameHasher = <Usual as Service>::ServiceNameHasher;
    type Monitoring = <Usual as Service>::Monitoring;
    type Reactor = <Usual as Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> =
        <Usual as Service>::ArcThreadSafetyPolicy<T>;
    type UniqueId = <Usual as Service>::UniqueId;
}

impl ServiceInternal<Self> for Ipc {}
