//! A worker that serves with a permit only: of several that can serve the same robots, on several hosts, one does.
//!
//! Who may is decided elsewhere: the link of this host, or whoever writes the permit. Worker and link leave each other
//! the files of [`joulebus_standby`].

pub(crate) mod backlog;
pub(crate) mod follow;
pub(crate) mod restore;
pub(crate) mod watch;

pub use watch::PermitOver;
