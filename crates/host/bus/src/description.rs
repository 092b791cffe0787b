//! Descriptions of services that are not removed under who makes one.
//!
//! A service's description has the service's name, and iceoryx2 removes descriptions by name
//! (#1578, #897, #21). A cleanup reads one, and when it has removed the rest of that service the
//! name may be that of a service made anew. A cleanup may also find the description of a service
//! whose ports are just being made, and take the service for a corrupt one. Here a creator has the
//! description locked ([`Claim`]) until the service has its list of ports. A description is removed
//! under that lock alone, and only if there is no such list. So a cleanup may be as slow as it
//! likes and take place beside any other, and nobody waits for one. Files and layout are those of
//! iceoryx2 0.10.0.
#![allow(unsafe_code)] // The traits of iceoryx2 have functions that are unsafe to call.

use std::path::PathBuf;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::sleep;
use std::time::Duration;

use iceoryx2::prelude::SemanticString as _;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_system_types::file_name::FileName;
use iceoryx2_bb_system_types::path::Path;
use iceoryx2_cal::named_concept::{
    NamedConcept, NamedConceptBuilder, NamedConceptConfiguration as _, NamedConceptDoesExistError,
    NamedConceptListError, NamedConceptMgmt, NamedConceptPathHintRemoveError,
    NamedConceptRemoveError,
};
use iceoryx2_cal::static_storage::file::{self, Configuration, StorageView};
use iceoryx2_cal::static_storage::{
    StaticStorage, StaticStorageBuilder, StaticStorageCreateError, StaticStorageLocked,
    StaticStorageOpenError, StaticStorageReadError, StaticStorageUnlockError, StaticStorageView,
};

use crate::cleanup::claim::Claim;
use crate::cleanup::incomplete::has_ports;

const SUFFIX: &[u8] = b".service";
/// A claim is held for microseconds, unless its holder is stopped or makes the service.
const CLAIM_RETRY_AFTER: Duration = Duration::from_millis(1);
const MAX_TRIES: u32 = 50;

/// A description of a service. Also of a node, its ports and services, whose names are unique.
#[derive(Debug)]
pub(crate) struct Description {
    file: file::Storage,
    config: Configuration,
    is_owner: AtomicBool,
    /// While the service is being made.
    claim: Mutex<Option<Claim>>,
}

fn path_of(name: &FileName, config: &Configuration) -> PathBuf {
    PathBuf::from(config.path_for(name).to_string())
}

fn is_of_service(config: &Configuration) -> bool {
    config.get_suffix().as_bytes() == SUFFIX
}

/// Tries for a while. `None` if there is no file, or another process makes the service.
fn claim(path: &std::path::Path) -> Option<Claim> {
    for _ in 0..MAX_TRIES {
        let claim = Claim::take(path.to_owned());
        if claim.is_some() || !path.exists() {
            return claim;
        }
        sleep(CLAIM_RETRY_AFTER);
    }
    None
}

impl Description {
    fn claim(&self) -> Option<Claim> {
        let mut claim = self.claim.lock().unwrap_or_else(PoisonError::into_inner);
        claim.take()
    }
}

impl Drop for Description {
    fn drop(&mut self) {
        drop(self.claim());
        if self.is_owner.load(Ordering::Relaxed) {
            // SAFETY: this value owns the file. That of another service is not removed.
            let _ = unsafe { Self::remove_cfg(self.file.name(), &self.config) };
        }
    }
}

impl NamedConcept for Description {
    fn name(&self) -> &FileName {
        self.file.name()
    }
}

impl NamedConceptMgmt for Description {
    type Configuration = Configuration;

    /// Keeps the description of a service that has a list of ports, or is being made.
    unsafe fn remove_cfg(
        name: &FileName,
        config: &Configuration,
    ) -> Result<bool, NamedConceptRemoveError> {
        if !is_of_service(config) {
            // SAFETY: the caller promises that no process uses the file.
            return unsafe { file::Storage::remove_cfg(name, config) };
        }
        let path = path_of(name, config);
        let Some(claim) = claim(&path) else {
            return Ok(false);
        };
        let (prefix, text) = (config.get_prefix().to_string(), claim.text());
        Ok(!has_ports(&prefix, &text) && claim.remove())
    }

    fn does_exist_cfg(
        name: &FileName,
        config: &Configuration,
    ) -> Result<bool, NamedConceptDoesExistError> {
        file::Storage::does_exist_cfg(name, config)
    }

    fn list_cfg(config: &Configuration) -> Result<Vec<FileName>, NamedConceptListError> {
        file::Storage::list_cfg(config)
    }

    fn remove_path_hint(value: &Path) -> Result<(), NamedConceptPathHintRemoveError> {
        file::Storage::remove_path_hint(value)
    }
}

impl StaticStorage for Description {
    type Builder = Builder;
    type Locked = Unwritten;
    type View = StorageView;

    fn view(&self) -> &StorageView {
        self.file.view()
    }

    /// The service is complete.
    fn release_ownership(&self) {
        self.is_owner.store(false, Ordering::Relaxed);
        drop(self.claim());
    }

    fn acquire_ownership(&self) {
        self.is_owner.store(true, Ordering::Relaxed);
    }
}

impl StaticStorageView for Description {
    fn len(&self) -> u64 {
        self.file.len()
    }

    fn is_empty(&self) -> bool {
        self.file.is_empty()
    }

    fn read(&self, content: &mut [u8]) -> Result<(), StaticStorageReadError> {
        self.file.read(content)
    }
}

impl Abandonable for Description {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller promises a valid value that is not used afterwards.
        unsafe { file::Storage::abandon_in_place(NonNull::from(&mut this.as_mut().file)) };
    }
}

/// Opens or creates a [`Description`].
#[derive(Debug)]
pub(crate) struct Builder {
    name: FileName,
    config: Configuration,
    is_owner: bool,
}

impl Builder {
    fn file(&self) -> file::Builder {
        let builder = <file::Builder as NamedConceptBuilder<file::Storage>>::new(&self.name);
        let builder = builder.config(&self.config);
        builder.has_ownership(false)
    }
}

impl NamedConceptBuilder<Description> for Builder {
    fn new(name: &FileName) -> Self {
        Self { name: *name, config: Configuration::default(), is_owner: true }
    }

    fn config(mut self, config: &Configuration) -> Self {
        self.config = config.clone();
        self
    }
}

impl StaticStorageBuilder<Description> for Builder {
    fn has_ownership(mut self, value: bool) -> Self {
        self.is_owner = value;
        self
    }

    fn create_locked(self) -> Result<Unwritten, StaticStorageCreateError> {
        let file = self.file().create_locked()?;
        let path = path_of(&self.name, &self.config);
        let claim = if is_of_service(&self.config) {
            // Not there if this process was stopped here and the file removed: to be made again.
            let claim = claim(&path).ok_or(StaticStorageCreateError::Interrupt)?;
            Some(claim)
        } else {
            None
        };
        Ok(Unwritten { file, builder: self, claim })
    }

    fn open(self, timeout: Duration) -> Result<Description, StaticStorageOpenError> {
        let file = self.file().open(timeout)?;
        Ok(Description {
            file,
            config: self.config,
            is_owner: AtomicBool::new(self.is_owner),
            claim: Mutex::new(None),
        })
    }
}

/// A description that its creator has not written yet.
#[derive(Debug)]
pub(crate) struct Unwritten {
    file: file::Locked,
    builder: Builder,
    claim: Option<Claim>,
}

impl NamedConcept for Unwritten {
    fn name(&self) -> &FileName {
        self.file.name()
    }
}

impl StaticStorageLocked<Description> for Unwritten {
    /// Writes the contents. A failed write leaves an incomplete file, which is removed as such.
    fn unlock(self, contents: &[u8]) -> Result<Description, StaticStorageUnlockError> {
        let file = self.file.unlock(contents)?;
        // Replaced meanwhile if this process was stopped before it claimed the file.
        let is_other = |claim: &Claim| claim.text().as_bytes() != contents;
        if self.claim.as_ref().is_some_and(is_other) {
            return Err(StaticStorageUnlockError::Interrupt);
        }
        Ok(Description {
            file,
            config: self.builder.config,
            is_owner: AtomicBool::new(self.builder.is_owner),
            claim: Mutex::new(self.claim),
        })
    }
}

impl Abandonable for Unwritten {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller promises a valid value that is not used afterwards.
        unsafe { file::Locked::abandon_in_place(NonNull::from(&mut this.as_mut().file)) };
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::time::SystemTime;

    use iceoryx2::config::Config;
    use iceoryx2::node::{Node, NodeBuilder};
    use iceoryx2::prelude::{MessagingPattern, PortFactory as _, ServiceName, SignalHandlingMode};
    use iceoryx2::service::Service as _;
    use iceoryx2::service::internal::ServiceInternal as _;
    use iceoryx2::service::port_factory::event::PortFactory;

    use super::*;
    use crate::Domain;
    use crate::cleanup::incomplete::{Abandoned, remove_incomplete};
    use crate::cleanup::objects::{named, objects};
    use crate::iceoryx_config::config_for;
    use crate::ipc::Ipc;

    const NAME: &str = "described";

    fn domain(name: &str) -> (Domain, Config) {
        let root = std::env::temp_dir().join(format!("joulebus-{name}-{}", std::process::id()));
        let domain = Domain::new(name, &root, "jbdes_").unwrap();
        fs::create_dir_all(domain.directory()).unwrap();
        let config = config_for(&domain).unwrap();
        (domain, config)
    }

    fn node(config: &Config) -> Node<Ipc> {
        let builder = NodeBuilder::new().config(config);
        let builder = builder.signal_handling_mode(SignalHandlingMode::Disabled);
        builder.create::<Ipc>().unwrap()
    }

    fn service(node: &Node<Ipc>) -> PortFactory<Ipc> {
        let name = ServiceName::new(NAME).unwrap();
        node.service_builder(&name).event().open_or_create().unwrap()
    }

    fn end(domain: &Domain) {
        for object in objects(domain).unwrap() {
            fs::remove_file(object.path).unwrap();
        }
        fs::remove_dir_all(domain.root()).unwrap();
    }

    #[test]
    fn a_slow_cleanup_removes_what_it_read_and_not_the_service_made_since() {
        let (domain, config) = domain("slow");
        let node = node(&config);
        let first = service(&node);
        let name = ServiceName::new(NAME).unwrap();
        let read = Ipc::details(&name, &config, MessagingPattern::Event);
        let read = read.unwrap().unwrap().static_details;
        drop(first);
        assert!(named(&domain, "", &[".service"]).is_empty());
        let again = service(&node);
        // SAFETY: nobody uses the service that was read.
        unsafe { Ipc::__internal_remove_service(&read, &config) }.unwrap();
        assert_eq!(named(&domain, "", &[".service"]).len(), 1);
        assert_eq!(again.unique_service_id(), service(&node).unique_service_id());
        drop((again, node));
        assert!(named(&domain, "", &[".service"]).is_empty());
        end(&domain);
    }

    #[test]
    fn a_service_that_is_being_made_is_kept_however_slow_and_what_a_killed_creator_left_is_not() {
        let (domain, config) = domain("making");
        let node = node(&config);
        let complete = service(&node);
        let path = named(&domain, "", &[".service"]).pop().unwrap();
        let text = fs::read(&path).unwrap();
        let hash = *complete.service_hash();
        drop(complete);
        let name: FileName = FileName::new(hash.as_str().as_bytes()).unwrap();
        let [prefix, suffix] = [domain.shm_prefix().as_bytes(), SUFFIX];
        let storage = Configuration::default()
            .prefix(&FileName::new(prefix).unwrap())
            .suffix(&FileName::new(suffix).unwrap())
            .path_hint(&Path::new(path.parent().unwrap().as_os_str().as_encoded_bytes()).unwrap());
        let begin = || Builder::new(&name).config(&storage).create_locked().unwrap();
        let old = || {
            let file = File::open(&path).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        };

        let creating = begin();
        old();
        assert_eq!(remove_incomplete(&domain).unwrap(), 0);
        let creating = creating.unlock(&text).unwrap();
        old();
        let mut abandoned = Abandoned::default();
        let mut clean = || {
            // SAFETY: that of a service in use is kept.
            let by_name = unsafe { Description::remove_cfg(&name, &storage) }.unwrap();
            Ipc::__internal_remove_node_from_service(node.id(), &hash, &config).unwrap();
            let before = abandoned.remove(&domain, NAME);
            sleep(Duration::from_millis(300));
            by_name || before + abandoned.remove(&domain, NAME) > 0
        };
        assert!(!clean());
        assert!(path.exists());
        // As the kernel does for a killed one.
        drop(creating.claim());
        creating.release_ownership();
        assert!(clean());
        assert!(!path.exists());

        // A leaving process removes its own, not another's that is being made.
        let another = begin();
        creating.acquire_ownership();
        drop(creating);
        assert!(path.exists());
        another.unlock(&text).unwrap();
        assert!(!path.exists(), "a creator that failed leaves nothing");
        drop(node);
        end(&domain);
    }
}
