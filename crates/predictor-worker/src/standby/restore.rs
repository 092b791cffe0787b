//! The state that a worker begins with when it gets the permit.

use std::path::Path;

use joulebus_connect::standby::{SavedState, StandbyFiles};
use joulebus_fleet::{Fleet, FleetState};

/// The source of a worker's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RestoredState {
    /// Term of the worker that had it.
    pub(crate) term: u64,
    pub(crate) taken_ns: u64,
}

fn states(files: &StandbyFiles) -> [&Path; 2] {
    [&files.replica, &files.keyframe]
}

/// Term of the newest state that the files have, and when it was taken.
pub(crate) fn newest(files: &StandbyFiles) -> Option<(u64, u64)> {
    let read = states(files).into_iter().map(SavedState::read);
    // Damage is logged when the state is restored.
    read.filter_map(|read| Some(read.ok()??.order())).max()
}

/// Restores the newest state of the files: this host's own earlier one, or that of a worker
/// elsewhere. If one cannot be used, that is logged and the other one is taken. `None` if neither
/// is usable or newer than the one `before`. The fleet is then unchanged.
pub(crate) fn restore(
    fleet: &mut Fleet,
    files: &StandbyFiles,
    before: Option<(u64, u64)>,
) -> Option<RestoredState> {
    let mut found: Vec<(SavedState, &Path)> = Vec::new();
    for path in states(files) {
        match SavedState::read(path) {
            Ok(state) => {
                let newer = state.filter(|state| Some(state.order()) > before);
                found.extend(newer.map(|state| (state, path)));
            }
            Err(error) => tracing::error!("{error}"),
        }
    }
    found.sort_by_key(|(state, _)| std::cmp::Reverse(state.order()));
    for (saved, path) in found {
        let (term, offset_ns) = (saved.term, saved.offset_ns);
        let decoded = FleetState::decode(&saved.bytes);
        let restored = decoded.and_then(|state| fleet.restore_state(&state.shifted(offset_ns)));
        match restored {
            Ok(()) => {
                let taken_ns = saved.taken_ns;
                return Some(RestoredState { term, taken_ns });
            }
            Err(error) => tracing::error!(?path, term, "the state of a worker is refused: {error}"),
        }
    }
    None
}
