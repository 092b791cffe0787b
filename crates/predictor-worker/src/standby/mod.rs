//! A worker that serves only with a permit: of several candidates on several hosts, one leads.
//!
//! The permit comes from outside: from the link of this host, or from whoever writes its file.
//! Worker and link communicate through the files of [`joulebus_connect::standby`].

pub(crate) mod backlog;
pub(crate) mod follow;
pub(crate) mod restore;
pub(crate) mod watch;

pub use watch::PermitOver;
