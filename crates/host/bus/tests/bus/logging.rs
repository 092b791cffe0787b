//! Messages of iceoryx2 as events of `tracing`.

use std::error::Error;
use std::fmt;
use std::sync::{Arc, Mutex};

use iceoryx2::config::Config;
use iceoryx2::prelude::{FilePath, LogLevel, SemanticString, set_log_level};
use joulebus_bus::trace_iceoryx2;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

use crate::harness::{Place, must};

/// Keeps the text of every event.
#[derive(Default, Clone)]
struct Events(Arc<Mutex<String>>);

impl Visit for Events {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        *self.0.lock().unwrap() += &format!("{field}={value:?} ");
    }
}

impl Subscriber for Events {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "iceoryx2"
    }

    fn event(&self, event: &Event<'_>) {
        *self.0.lock().unwrap() += &format!("{} ", event.metadata().level());
        event.record(&mut self.clone());
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}

/// The log of asking iceoryx2 for a file that does not exist.
pub(crate) fn log() -> Result<String, Box<dyn Error>> {
    let events = Events::default();
    tracing::subscriber::set_global_default(events.clone())?;
    if !trace_iceoryx2() || trace_iceoryx2() {
        return Err("the first logger stays".into());
    }
    set_log_level(LogLevel::Debug);
    let missing = FilePath::new(b"/dev/shm/joulebus-nowhere/iceoryx2.toml")?;
    assert!(Config::from_file(&missing).is_err());
    let text = events.0.lock().unwrap().clone();
    Ok(text.replace('\n', " "))
}

#[test]
fn messages_of_iceoryx2_reach_the_log_of_a_program_that_asks_for_them() {
    let place = Place::new();
    let mut member = place.member();
    let events = must(&mut member, "log");
    assert!(events.starts_with("DEBUG "), "{events}");
    assert!(events.contains("joulebus-nowhere") && events.contains("origin="));
}
