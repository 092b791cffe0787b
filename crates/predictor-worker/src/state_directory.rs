//! The default location of a fleet's ledger.

use std::ffi::OsString;
use std::path::PathBuf;

use joulebus_config::{Checkpoint, Config};
use joulebus_wire::fnv1a;

/// The file of the fleet's ledger. Warns if batteries will not survive the worker.
pub(crate) fn checkpoint_path(config: &Config) -> Option<PathBuf> {
    let batteries = config.settings().has_batteries();
    let path = match config.checkpoint() {
        Checkpoint::File(path) => return Some(path.clone()),
        Checkpoint::Auto if !batteries => return None,
        Checkpoint::Auto => state_directory(|name| std::env::var_os(name))
            .map(|directory| directory.join(file_name(config))),
        Checkpoint::Off => None,
    };
    match &path {
        Some(path) => tracing::info!(?path, "the ledger and the batteries are saved"),
        None if batteries => tracing::warn!(
            "batteries are not saved: a restarted worker takes each for `initial_soc` full; set \
             `ledger.checkpoint`{}",
            match config.checkpoint() {
                Checkpoint::Auto => " to a file, or $HOME",
                _ => "",
            }
        ),
        None => {}
    }
    path
}

/// systemd's directory for the service, or the user's for programs' state; `None` if the
/// environment names none. Relative paths are ignored, as the XDG specification demands.
fn state_directory(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let absolute = |name: &str| {
        let value = variable(name)?;
        // systemd lists several directories with colons between them.
        let first = std::env::split_paths(&value).next()?;
        first.is_absolute().then_some(first)
    };
    absolute("STATE_DIRECTORY")
        .or_else(|| Some(absolute("XDG_STATE_HOME")?.join("joulebus")))
        .or_else(|| Some(absolute("HOME")?.join(".local/state/joulebus")))
}

/// Fleets of one name in different domains are different fleets.
fn file_name(config: &Config) -> String {
    let domain = format!("{}/{}", config.root().display(), config.prefix());
    format!("{}-{:016x}.json", config.fleet(), fnv1a(domain.bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_directory_is_systemds_then_xdgs_then_the_users() {
        let of = |set: &[(&str, &str)]| {
            let value = |name: &str| {
                let found = set.iter().find(|(known, _)| *known == name);
                found.map(|(_, value)| OsString::from(*value))
            };
            state_directory(value)
        };
        let (home, xdg) = (("HOME", "/home/ada"), ("XDG_STATE_HOME", "/state"));
        let systemd = ("STATE_DIRECTORY", "/var/lib/joulebus:/var/lib/other");
        for (set, expected) in [
            (&[home, xdg, systemd][..], Some("/var/lib/joulebus")),
            (&[home, xdg], Some("/state/joulebus")),
            (&[home, ("XDG_STATE_HOME", "")], Some("/home/ada/.local/state/joulebus")),
            (&[home, ("XDG_STATE_HOME", "here")], Some("/home/ada/.local/state/joulebus")),
            (&[home], Some("/home/ada/.local/state/joulebus")),
            (&[("HOME", "")], None),
            (&[], None),
        ] {
            assert_eq!(of(set), expected.map(PathBuf::from), "{set:?}");
        }
    }

    #[test]
    fn only_fleets_with_a_battery_are_saved_by_default_each_in_a_file_of_its_own() {
        let config = |root: &str, battery: &str, checkpoint: &str| {
            let text = format!(
                "[fleet]\nname = \"lab\"\n[domain]\nroot = \"{root}\"\n{checkpoint}\n\
                 [[platform]]\nfile = \"builtin:rover\"\nrobots = [1]\n{battery}"
            );
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("fleet.toml");
            std::fs::write(&path, text).unwrap();
            Config::load(&path).unwrap()
        };
        let battery = "[platform.battery]\ncapacity_wh = 10\ninitial_soc_lo = 0.9\n";
        let off = "[ledger]\ncheckpoint = \"\"";
        assert_eq!(checkpoint_path(&config("/dev/shm/a", "", "")), None);
        assert_eq!(checkpoint_path(&config("/dev/shm/a", battery, off)), None);
        let named = "[ledger]\ncheckpoint = \"/tmp/its.json\"";
        let path = checkpoint_path(&config("/dev/shm/a", "", named));
        assert_eq!(path, Some(PathBuf::from("/tmp/its.json")));
        let [one, two] = ["/dev/shm/a", "/dev/shm/b"].map(|root| config(root, battery, ""));
        assert_ne!(file_name(&one), file_name(&two));
        let name = file_name(&one);
        assert!(name.starts_with("lab-") && name.ends_with(".json"), "{name}");
    }
}
