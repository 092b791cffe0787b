//! The default location of a fleet's ledger.

use std::ffi::OsString;
use std::path::PathBuf;

use joulebus_config::{Checkpoint, Config};
use joulebus_files::disk;
use joulebus_wire::fnv1a;

/// The file in which a worker of this user saves the fleet's ledger, if it saves it.
pub(crate) fn ledger_path(config: &Config) -> Option<PathBuf> {
    match config.checkpoint() {
        Checkpoint::File(path) => Some(path.clone()),
        Checkpoint::Auto => {
            let directory = state_directory(|name| std::env::var_os(name)).ok()?;
            Some(directory.join(file_name(config)))
        }
        Checkpoint::Off => None,
    }
}

/// The file of the fleet's ledger. Warns if batteries will not survive the worker.
pub(crate) fn checkpoint_path(config: &Config) -> Option<PathBuf> {
    let batteries = config.settings().has_batteries();
    let why = match config.checkpoint() {
        Checkpoint::File(path) => return Some(path.clone()),
        Checkpoint::Auto if batteries => match state_directory(|name| std::env::var_os(name)) {
            Ok(directory) => {
                let path = directory.join(file_name(config));
                tracing::info!(?path, "the ledger and the batteries are saved");
                return Some(path);
            }
            Err(why) => why,
        },
        Checkpoint::Auto | Checkpoint::Off => String::new(),
    };
    if batteries {
        let why = if why.is_empty() { why } else { format!(": {why}") };
        tracing::warn!(
            "batteries are not saved{why}. A restarted worker takes each for `initial_soc` full. \
                Set `ledger.checkpoint` to a file to save them"
        );
    }
    None
}

/// systemd's directory for the service, or the user's for programs' state, which is made, else why
/// there is none. Relative paths are ignored, as the XDG specification demands.
fn state_directory(variable: impl Fn(&str) -> Option<OsString>) -> Result<PathBuf, String> {
    const PLACES: [(&str, &str); 3] = [
        ("STATE_DIRECTORY", ""),
        ("XDG_STATE_HOME", "joulebus"),
        ("HOME", ".local/state/joulebus"),
    ];
    for (name, below) in PLACES {
        // systemd lists several directories with colons between them.
        let first = variable(name).and_then(|value| std::env::split_paths(&value).next());
        let Some(base) = first.filter(|base| base.is_absolute()) else {
            continue;
        };
        let directory = base.join(below);
        // A user's home is not made: root could, for users that have none.
        let there = if name == "HOME" { base.metadata().map(|_| ()) } else { Ok(()) };
        let made = there.and_then(|()| disk::create_dir_all(&directory));
        return made.map(|()| directory).map_err(|error| format!("${name} is {base:?}: {error}"));
    }
    Err("none of $STATE_DIRECTORY, $XDG_STATE_HOME and $HOME names a directory".to_owned())
}

/// Fleets of one name in different domains are different fleets.
fn file_name(config: &Config) -> String {
    let domain = format!("{}/{}", config.root().display(), config.prefix());
    format!("{}-{:016x}.json", config.fleet(), fnv1a(domain.bytes()))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_directory_is_systemds_then_xdgs_then_the_users() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["home", "state", "service"] {
            fs::create_dir(place(name)).unwrap();
        }
        let of = |set: &[(&str, OsString)]| {
            let value = |name: &str| {
                let found = set.iter().find(|(known, _)| *known == name);
                found.map(|(_, value)| value.clone())
            };
            state_directory(value)
        };
        let home = ("HOME", place("home").into_os_string());
        let xdg = ("XDG_STATE_HOME", place("state").into_os_string());
        let mut listed = place("service").into_os_string();
        listed.push(":/var/lib/other");
        let systemd = ("STATE_DIRECTORY", listed);
        let none = |name: &'static str| (name, OsString::new());
        let in_home = place("home/.local/state/joulebus");
        for (set, expected) in [
            (vec![home.clone(), xdg.clone(), systemd], place("service")),
            (vec![home.clone(), xdg], place("state/joulebus")),
            (vec![home.clone(), none("XDG_STATE_HOME")], in_home.clone()),
            (vec![home.clone(), ("XDG_STATE_HOME", "here".into())], in_home.clone()),
            (vec![home], in_home),
        ] {
            assert_eq!(of(&set), Ok(expected.clone()), "{set:?}");
            assert!(expected.is_dir(), "{set:?}");
        }
        for set in [vec![none("HOME")], vec![]] {
            assert!(of(&set).unwrap_err().contains("$HOME"), "{set:?}");
        }
        // A home that is no directory, or that nobody has made, is named and left alone.
        fs::write(place("file"), "").unwrap();
        for (name, reason) in [("file", "Not a directory"), ("absent", "No such file")] {
            let why = of(&[("HOME", place(name).into_os_string())]).unwrap_err();
            assert!(why.contains(name) && why.contains(reason), "{why}");
        }
        assert!(!place("absent").exists());
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
