//! What was removed.

/// What was removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct SweepReport {
    /// Nodes of dead processes that iceoryx2 removed.
    pub dead_nodes: u64,
    /// Nodes of dead processes that could not be removed; they go with the last member.
    pub failed_nodes: u64,
    /// Incomplete objects, services and nodes.
    pub incomplete: u64,
    /// Objects in shared memory removed because no member was alive.
    pub objects: u64,
    /// Bytes that they took.
    pub bytes: u64,
    /// Other files removed because no member was alive.
    pub files: u64,
    /// Whether no member was alive, so that everything of the domain was removed.
    pub cold: bool,
}

impl SweepReport {
    /// Whether nothing stale was found.
    #[must_use]
    pub const fn is_clean(&self) -> bool {
        self.dead_nodes == 0
            && self.failed_nodes == 0
            && self.incomplete == 0
            && self.objects == 0
            && self.files == 0
    }
}
