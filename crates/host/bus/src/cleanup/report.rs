//! Report of a cleanup.

/// Files and nodes that a cleanup removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct SweepReport {
    /// Nodes of dead processes that iceoryx2 removed.
    pub dead_nodes: u64,
    /// Nodes of dead processes that could not be removed. The last member to leave removes them.
    pub failed_nodes: u64,
    /// Incomplete objects, services and nodes.
    pub incomplete: u64,
    /// Objects in shared memory removed because no member was alive.
    pub objects: u64,
    /// Size of these objects, bytes.
    pub bytes: u64,
    /// Other files removed because no member was alive.
    pub files: u64,
    /// True if no member was alive, so that all files of the domain were removed.
    pub cold: bool,
}

impl SweepReport {
    /// True if no stale files were found.
    pub const fn is_clean(&self) -> bool {
        self.dead_nodes == 0
            && self.failed_nodes == 0
            && self.incomplete == 0
            && self.objects == 0
            && self.files == 0
    }
}
