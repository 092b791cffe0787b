//! Shared memory whose pages are allocated before the first write.
//!
//! iceoryx2 sizes an object, and its pages are allocated at the first write. In a full file system
//! that write, or even a read, raises SIGBUS in the process that executes it (#624). Here all pages
//! are allocated before the first access, so lack of memory is an error in the creating process.
//! Layout and names are those of iceoryx2 0.10.0: its own programs and packages of other languages
//! open these objects, and vice versa.
#![allow(unsafe_code)] // Memory is initialised before others can open it.

use std::cell::Cell;
use std::fmt;
use std::fs;
use std::io::ErrorKind;
use std::mem::MaybeUninit;
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use iceoryx2_bb_elementary::bump_allocator::BumpAllocator;
use iceoryx2_bb_elementary::package_version::PackageVersion;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use iceoryx2_bb_posix::access_mode::AccessMode;
use iceoryx2_bb_posix::file_descriptor::{FileDescriptorBased, FileDescriptorManagement};
use iceoryx2_bb_posix::permission::Permission;
use iceoryx2_bb_posix::shared_memory::{
    CreationMode, SharedMemory, SharedMemoryBuilder, SharedMemoryCreationError,
};
use iceoryx2_bb_system_types::file_name::FileName;
use iceoryx2_bb_system_types::path::Path;
use iceoryx2_cal::dynamic_storage::posix_shared_memory::{self as posix, Configuration};
use iceoryx2_cal::dynamic_storage::{
    DynamicStorage, DynamicStorageBuilder, DynamicStorageCreateError, DynamicStorageOpenError,
    DynamicStorageOpenOrCreateError,
};
use iceoryx2_cal::named_concept::{
    NamedConcept, NamedConceptBuilder, NamedConceptConfiguration, NamedConceptDoesExistError,
    NamedConceptListError, NamedConceptMgmt, NamedConceptPathHintRemoveError,
    NamedConceptRemoveError,
};

use crate::CapacityError;
use crate::os::memory::{SHM_DIR, reserve};
use crate::preflight::check_memory;

/// Polling interval for an object without a length.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

thread_local! {
    /// Shortage of this thread's last failed attempt.
    static SHORTAGE: Cell<Option<CapacityError>> = const { Cell::new(None) };
}

/// Takes the shortage of memory for which this thread could not create an object since the last
/// call. The errors of iceoryx2 do not state it.
pub(crate) fn take_shortage() -> Option<CapacityError> {
    SHORTAGE.take()
}

/// Marks types that iceoryx2 may place in shared memory.
pub(crate) trait Shareable: Send + Sync + fmt::Debug + ZeroCopySend {}
impl<T: Send + Sync + fmt::Debug + ZeroCopySend> Shareable for T {}

/// An object in shared memory with a `T`, and memory that belongs to it.
#[derive(Debug)]
pub(crate) struct Reserved<T: Shareable>(posix::Storage<T>);

/// Head of an object.
#[repr(C)]
struct Content<T> {
    /// Version of iceoryx2. 0 until the rest is initialised.
    version: AtomicU64,
    value: MaybeUninit<T>,
}

/// Writes the value, and allocates its memory.
type Initialize<'b, T> = Box<dyn FnMut(&mut MaybeUninit<T>, &mut BumpAllocator) -> bool + 'b>;

/// Opens or creates a [`Reserved`].
pub(crate) struct Builder<'b, T: Shareable> {
    name: FileName,
    config: Configuration<T>,
    supplementary_size: usize,
    has_ownership: bool,
    timeout: Duration,
    initialize: Initialize<'b, T>,
}

impl<T: Shareable> fmt::Debug for Builder<'_, T> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Builder")
            .field("name", &self.name)
            .field("supplementary_size", &self.supplementary_size)
            .finish_non_exhaustive()
    }
}

impl<T: Shareable> Builder<'_, T> {
    /// iceoryx2 waits forever for an object without a length (#1771, #364), and opens it every
    /// millisecond: other processes do not remove what is open.
    fn open_existing(&self, access: AccessMode) -> Result<Reserved<T>, DynamicStorageOpenError> {
        let file = self.config.path_for(&self.name).file_name().to_string();
        let (path, begin) = (std::path::Path::new(SHM_DIR).join(file), Instant::now());
        while fs::symlink_metadata(&path).is_ok_and(|found| found.len() == 0) {
            if begin.elapsed() >= self.timeout {
                return Err(DynamicStorageOpenError::InitializationNotYetFinalized);
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        posix::Builder::new(&self.name)
            .config(&self.config)
            .timeout(self.timeout.saturating_sub(begin.elapsed()))
            .open(access)
            .map(Reserved)
    }

    fn create_reserved(&mut self) -> Result<Reserved<T>, DynamicStorageCreateError> {
        let mut memory = self.allocate()?;
        self.fill(&memory)?;
        memory
            .set_permission(Permission::OWNER_READ_WRITE)
            .map_err(|_| DynamicStorageCreateError::InternalError)?;
        let opened = self
            .open_existing(AccessMode::ReadWrite)
            .map_err(|_| DynamicStorageCreateError::InternalError)?;
        // Until here dropping `memory` removes the object.
        memory.release_ownership();
        if self.has_ownership {
            opened.acquire_ownership();
        }
        Ok(opened)
    }

    /// An object that others do not open yet, with all of its pages.
    fn allocate(&self) -> Result<SharedMemory, DynamicStorageCreateError> {
        let size = size_of::<Content<T>>() + self.supplementary_size;
        // An attempt would fill the file system for others meanwhile.
        check_memory(size).map_err(shortage)?;
        let memory = SharedMemoryBuilder::new(&self.config.path_for(&self.name).file_name())
            .creation_mode(CreationMode::CreateExclusive)
            .size(size)
            .permission(Permission::OWNER_WRITE)
            .zero_memory(false)
            .has_ownership(true)
            .create()
            .map_err(|error| match error {
                SharedMemoryCreationError::AlreadyExist => DynamicStorageCreateError::AlreadyExists,
                SharedMemoryCreationError::InsufficientPermissions => {
                    DynamicStorageCreateError::InsufficientPermissions
                }
                _ => {
                    SHORTAGE.set(check_memory(size).err());
                    DynamicStorageCreateError::InternalError
                }
            })?;
        // SAFETY: the descriptor is open while the memory is mapped, which outlives the call.
        let file = unsafe { BorrowedFd::borrow_raw(memory.file_descriptor().native_handle()) };
        let reserved = reserve(file, memory.size() as u64);
        reserved.map_err(|error| {
            // A refusal for another reason, such as a quota, must not be reported as lack of space.
            let full = check_memory(size).err().filter(|_| error.kind() == ErrorKind::StorageFull);
            shortage(full.unwrap_or(CapacityError::Reserve { bytes: size as u64, error }))
        })?;
        Ok(memory)
    }

    fn fill(&mut self, memory: &SharedMemory) -> Result<(), DynamicStorageCreateError> {
        let mut start: NonNull<Content<T>> = memory.base_address().cast();
        let rest = memory.size() - size_of::<Content<T>>();
        // SAFETY: the object is at least as long as its content, so this is one past that at most.
        let behind = unsafe { start.add(1) }.cast();
        // SAFETY: the object is mapped for writing, page-aligned, and long enough. Zeros, as the
        // system hands them out, are a value of both fields. No other process opens it before its
        // permissions show that it is complete, so the reference is the only one.
        let content = unsafe { start.as_mut() };
        let mut allocator = BumpAllocator::new(behind, rest);
        if !(self.initialize)(&mut content.value, &mut allocator) {
            return Err(DynamicStorageCreateError::InitializationFailed);
        }
        let version = PackageVersion::get().to_u64();
        content.version.store(version, Ordering::SeqCst);
        Ok(())
    }
}

fn shortage(what: CapacityError) -> DynamicStorageCreateError {
    SHORTAGE.set(Some(what));
    DynamicStorageCreateError::InternalError
}

impl<T: Shareable> NamedConceptBuilder<Reserved<T>> for Builder<'_, T> {
    fn new(name: &FileName) -> Self {
        Self {
            name: *name,
            config: Configuration::default(),
            supplementary_size: 0,
            has_ownership: true,
            timeout: Duration::ZERO,
            initialize: Box::new(|_, _| false),
        }
    }

    fn config(mut self, config: &Configuration<T>) -> Self {
        self.config = config.clone();
        self
    }
}

impl<'b, T: Shareable> DynamicStorageBuilder<'b, T, Reserved<T>> for Builder<'b, T> {
    fn has_ownership(mut self, value: bool) -> Self {
        self.has_ownership = value;
        self
    }

    /// Objects used only by members of a fleet are private to the user.
    fn enable_global_access(self, _value: bool) -> Self {
        self
    }

    fn supplementary_size(mut self, value: usize) -> Self {
        self.supplementary_size = value;
        self
    }

    fn timeout(mut self, value: Duration) -> Self {
        self.timeout = value;
        self
    }

    fn initializer<F: FnMut(&mut MaybeUninit<T>, &mut BumpAllocator) -> bool + 'b>(
        mut self,
        value: F,
    ) -> Self {
        self.initialize = Box::new(value);
        self
    }

    fn create(mut self) -> Result<Reserved<T>, DynamicStorageCreateError> {
        self.create_reserved()
    }

    fn open(self, access: AccessMode) -> Result<Reserved<T>, DynamicStorageOpenError> {
        self.open_existing(access)
    }

    fn open_or_create(mut self) -> Result<Reserved<T>, DynamicStorageOpenOrCreateError> {
        loop {
            match self.open_existing(AccessMode::ReadWrite) {
                Err(DynamicStorageOpenError::DoesNotExist) => {}
                opened => return Ok(opened?),
            }
            match self.create_reserved() {
                Err(DynamicStorageCreateError::AlreadyExists) => {}
                created => return Ok(created?),
            }
        }
    }
}

impl<T: Shareable> DynamicStorage<T> for Reserved<T> {
    type Builder<'b> = Builder<'b, T>;

    fn does_support_persistency() -> bool {
        posix::Storage::<T>::does_support_persistency()
    }

    fn has_ownership(&self) -> bool {
        self.0.has_ownership()
    }

    fn release_ownership(&self) {
        self.0.release_ownership();
    }

    fn acquire_ownership(&self) {
        self.0.acquire_ownership();
    }

    fn get(&self) -> &T {
        self.0.get()
    }

    unsafe fn __internal_set_type_name_in_config(config: &mut Configuration<T>, type_name: &str) {
        // SAFETY: the caller promises what the function asks for.
        unsafe { posix::Storage::<T>::__internal_set_type_name_in_config(config, type_name) }
    }
}

impl<T: Shareable> NamedConcept for Reserved<T> {
    fn name(&self) -> &FileName {
        self.0.name()
    }
}

impl<T: Shareable> NamedConceptMgmt for Reserved<T> {
    type Configuration = Configuration<T>;

    unsafe fn remove_cfg(
        name: &FileName,
        config: &Configuration<T>,
    ) -> Result<bool, NamedConceptRemoveError> {
        // SAFETY: the caller promises that no process uses the object.
        unsafe { posix::Storage::<T>::remove_cfg(name, config) }
    }

    fn does_exist_cfg(
        name: &FileName,
        config: &Configuration<T>,
    ) -> Result<bool, NamedConceptDoesExistError> {
        posix::Storage::<T>::does_exist_cfg(name, config)
    }

    fn list_cfg(config: &Configuration<T>) -> Result<Vec<FileName>, NamedConceptListError> {
        posix::Storage::<T>::list_cfg(config)
    }

    fn remove_path_hint(value: &Path) -> Result<(), NamedConceptPathHintRemoveError> {
        posix::Storage::<T>::remove_path_hint(value)
    }
}

impl<T: Shareable> Abandonable for Reserved<T> {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller promises a valid value that is not used afterwards.
        unsafe { posix::Storage::abandon_in_place(NonNull::from(&mut this.as_mut().0)) };
    }
}
