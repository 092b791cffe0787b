//! Repairs of `--fix`: directory modes, and files of dead processes.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::Path;

use anyhow::Context as _;
use joulebus_bus::{Domain, sweep};

/// Mends, and says what was done.
pub(super) fn mend(domain: &Domain) -> anyhow::Result<Vec<String>> {
    let mut mended = Vec::new();
    for directory in [domain.root(), &domain.directory()] {
        mended.extend(close_to_others(directory)?);
    }
    let swept = sweep(domain).context("cannot remove stale files")?;
    for (count, what) in [
        (swept.dead_nodes, "nodes of dead processes removed"),
        (swept.incomplete, "incomplete objects removed"),
        (
            swept.objects,
            "objects of dead processes removed from shared memory",
        ),
        (swept.files, "files of dead processes removed"),
    ] {
        if count > 0 {
            mended.push(format!("{count} {what}"));
        }
    }
    Ok(mended)
}

/// Takes other users' rights away, if the directory is ours.
fn close_to_others(directory: &Path) -> anyhow::Result<Option<String>> {
    let Ok(found) = fs::symlink_metadata(directory) else {
        return Ok(None);
    };
    let is_ours = found.is_dir() && found.uid() == rustix::process::geteuid().as_raw();
    let mode = found.mode() & 0o7777;
    if !is_ours || mode & 0o077 == 0 {
        return Ok(None);
    }
    fs::set_permissions(directory, fs::Permissions::from_mode(0o700))
        .with_context(|| format!("cannot change the mode of {}", directory.display()))?;
    let name = directory.display();
    Ok(Some(format!("{name}: mode {mode:04o} changed to 0700")))
}
