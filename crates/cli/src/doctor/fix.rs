//! Repairs of `--fix`: directory modes, and files of dead processes.

use anyhow::Context as _;
use joulebus_bus::{Domain, restrict_domain, sweep};

/// Mends, and reports what was done. Directories that joulebus did not make are left as they are.
pub(super) fn fix(domain: &Domain) -> anyhow::Result<Vec<String>> {
    let closed = restrict_domain(domain).context("cannot take other users' rights away")?;
    let closed = closed.into_iter();
    let mut mended: Vec<String> = closed
        .map(|(path, mode)| format!("{}: mode {mode:04o} changed to 0700", path.display()))
        .collect();
    let swept = sweep(domain).context("cannot remove stale files")?;
    for (count, what) in [
        (swept.dead_nodes, "nodes of dead processes removed"),
        (swept.incomplete, "incomplete objects removed"),
        (swept.objects, "objects of dead processes removed from shared memory"),
        (swept.files, "files of dead processes removed"),
    ] {
        if count > 0 {
            mended.push(format!("{count} {what}"));
        }
    }
    Ok(mended)
}
