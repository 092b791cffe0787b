//! The link's file, checked strictly: which frames this host sends and receives, and over which
//! network.
//!
//! Every problem is reported with its line.

mod check;
mod lease;
mod network;

use std::path::Path;

use joulebus_config::{CheckedFile, Config, ConfigError, File, Section};
use joulebus_wire::fnv1a;

use crate::config::check::Check;
use crate::protocol::carried::Carried;
use crate::protocol::message::FleetId;
use crate::protocol::selection::Selection;

pub(crate) use lease::LeaseSettings;
pub(crate) use network::{Mode, NetworkSettings, TlsSettings};

/// The checked settings of a link.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) name: String,
    pub(crate) network: NetworkSettings,
    pub(crate) side: Side,
    /// Set if this host's worker is one of several candidates.
    pub(crate) standby: Option<Standby>,
}

/// A host's worker that is one of several candidates. One of them leads at a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Standby {
    /// Position in the list of candidates.
    pub(crate) rank: usize,
    /// Links of the other candidates.
    pub(crate) others: Vec<String>,
    /// The lease that elects the leader.
    pub(crate) lease: LeaseSettings,
}

/// Role of the link on this host.
#[derive(Debug, Clone)]
pub(crate) enum Side {
    /// A worker, with the hosts whose samples it takes.
    Worker(Vec<Take>),
    Other {
        /// Links of the workers that get the samples published here.
        samples: Option<Vec<String>>,
        follow: Option<Follow>,
    },
}

/// A host whose samples are taken.
#[derive(Debug, Clone)]
pub(crate) struct Take {
    pub(crate) from: String,
    pub(crate) robots: Selection,
}

/// Which workers' outputs to follow.
#[derive(Debug, Clone)]
pub(crate) struct Follow {
    /// Names of the links of the worker and its standbys.
    pub(crate) workers: Vec<String>,
    pub(crate) selection: Selection,
}

impl Settings {
    /// Reads and checks a link's file for the fleet of `config`.
    ///
    /// # Errors
    /// [`ConfigError`] with all problems, if the file cannot be read or is refused.
    pub(crate) fn load(path: &Path, config: &Config) -> Result<Self, ConfigError> {
        let file = CheckedFile::load(path, File::Link)?;
        let mut check = Check { problems: file.problems.clone() };
        match check.settings(&file.root(), config) {
            Some(settings) if check.problems.is_empty() => Ok(settings),
            _ => Err(ConfigError::Refused(check.problems)),
        }
    }
}

impl Settings {
    /// The fleet's identity in messages.
    pub(crate) fn fleet(config: &Config) -> FleetId {
        FleetId(fnv1a(config.fleet().bytes()))
    }
}

impl Check {
    fn settings(&mut self, file: &Section<'_>, config: &Config) -> Option<Settings> {
        let name = file.text("name");
        let network = self.network(file);
        let workers = self.candidates(file);
        let name = name?.to_string();
        let is_candidate = workers.contains(&name);
        let sides = ["worker", "samples", "follow"].map(|side| file.section(side));
        let side = match sides {
            [Some(worker), None, None] => {
                if !workers.is_empty() && !is_candidate {
                    let what = format!("= {name:?} is not in `workers`");
                    self.add(file.problem("name", what, "Name it in `workers`, on every host"));
                }
                Side::Worker(self.takes(&worker, &name, config))
            }
            [None, samples, follow] if samples.is_some() || follow.is_some() => {
                if is_candidate {
                    let what = format!("= {name:?} is in `workers`");
                    let remedy = "A worker's host has [worker]. Give this link another name";
                    self.add(file.problem("name", what, remedy));
                }
                let of = (name.as_str(), workers.as_slice());
                let samples = samples.map(|section| self.workers(&section, "to", of));
                let follow = follow.map(|section| self.follow(&section, of, config));
                Side::Other { samples, follow }
            }
            _ => {
                let what = "says nothing of this host, or both".to_owned();
                let remedy =
                    "Either [worker], beside `joulebus run`, or [samples], [follow] or both";
                self.add(file.problem("", what, remedy));
                return None;
            }
        };
        let is_worker = matches!(side, Side::Worker(_));
        let standby = self.standby(file, (&name, &workers, is_worker));
        Some(Settings { name, network: network?, side, standby })
    }

    /// The links of the worker and its standbys, if there are several.
    fn candidates(&mut self, file: &Section<'_>) -> Vec<String> {
        let workers = file.texts("workers");
        for (at, name) in workers.iter().enumerate() {
            if workers[..at].iter().any(|other| **other == **name) {
                self.add(name.problem("stands twice", "Name each link once"));
            }
        }
        workers.iter().map(|name| name.to_string()).collect()
    }

    /// Checks whether the worker of the link `name` is one of several candidates.
    fn standby(
        &mut self,
        file: &Section<'_>,
        (name, workers, is_worker): (&str, &[String], bool),
    ) -> Option<Standby> {
        let section = file.section("lease");
        let lease = section.as_ref().and_then(|lease| self.lease(lease, file));
        match &section {
            Some(lease) if !is_worker || workers.is_empty() => {
                let what = "decides nothing here".to_owned();
                let remedy = "It needs [worker], and this link and another in `workers`. Else leave the section out";
                self.add(lease.problem("", what, remedy));
                return None;
            }
            None if is_worker && !workers.is_empty() => {
                let what = format!("is missing, and there are {} `workers`", workers.len());
                let remedy = "Write the section: a lease in etcd decides which of them serves";
                self.add(file.problem("lease", what, remedy));
            }
            _ => {}
        }
        Some(Standby {
            rank: workers.iter().position(|worker| worker == name)?,
            others: workers.iter().filter(|worker| *worker != name).cloned().collect(),
            lease: lease?,
        })
    }

    /// The hosts whose samples the worker of the link `name` takes.
    fn takes(&mut self, worker: &Section<'_>, name: &str, config: &Config) -> Vec<Take> {
        let mut takes: Vec<Take> = Vec::new();
        for take in worker.list("take") {
            let Some(from) = take.text("from") else { continue };
            if *from == *name || takes.iter().any(|other| other.from == *from) {
                self.add(from.problem("is this link, or named twice", "Name each host once"));
            }
            let robots = self.robots(&take, config);
            takes.push(Take { from: from.to_string(), robots });
        }
        takes
    }

    /// The links of the worker and its standbys: those of `workers`, else the one that `key` names.
    fn workers(
        &mut self,
        section: &Section<'_>,
        key: &str,
        (name, workers): (&str, &[String]),
    ) -> Vec<String> {
        match section.text(key) {
            Some(text) if !workers.is_empty() => {
                self.add(text.problem("beside `workers`", "Leave it out: `workers` has the links"));
            }
            Some(text) => {
                if *text == *name {
                    self.add(text.problem("is this link itself", "Name the worker's link"));
                }
                return vec![text.to_string()];
            }
            None if workers.is_empty() && !section.has(key) => {
                let remedy = "Name the worker's link, or with standbys all of them in `workers`";
                self.add(section.problem(key, "is missing".to_owned(), remedy));
            }
            None => {}
        }
        workers.to_vec()
    }

    fn follow(&mut self, section: &Section<'_>, of: (&str, &[String]), config: &Config) -> Follow {
        let workers = self.workers(section, "worker", of);
        let mut services = Carried::FORECASTS.bit();
        for word in section.texts("services") {
            match Carried::ALL.iter().find(|service| *service.name == *word) {
                Some(service) => services |= service.bit(),
                None => self.add(word.problem("does not cross a link", "Leave it out")),
            }
        }
        if !section.has("services") {
            let usual = Carried::ALL.iter().filter(|service| service.is_replaced());
            services = usual.fold(services, |all, service| all | service.bit());
        }
        let ranges = self.robots(section, config).ranges().to_vec();
        let every = section.integer("every").unwrap_or(1);
        Follow { workers, selection: Selection::new(services, every, ranges) }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use joulebus_testkit::assert_contains;

    use super::*;

    const FLEET: &str = "[fleet]\nname = \"lab\"\ncapacity = 20\n\
        [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n";
    const WORKER: &str = "name = \"base\"\n[network]\nlisten = [\"tcp/127.0.0.1:7447\"]\n\
        [worker]\n[[worker.take]]\nfrom = \"edge\"\nrobots = [\"0-4\", 7]\n";
    const OTHER: &str = "name = \"edge\"\n[network]\nconnect = [\"tcp/127.0.0.1:7447\"]\n\
        [samples]\nto = \"base\"\n[follow]\nworker = \"base\"\n";

    fn load(text: &str) -> Result<Settings, ConfigError> {
        let config = Config::parse(FLEET, Path::new(".")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("link.toml");
        fs::write(&path, text).unwrap();
        Settings::load(&path, &config)
    }

    /// A change of a good file is refused, with the words and a problem in the line.
    fn assert_refused(good: &str, (from, to): (&str, &str), line: usize, expected: &str) {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from}");
        let refused = load(&text).expect_err(to);
        assert_contains(&refused, [expected]);
        let mut lines = refused.problems().iter().filter_map(|problem| problem.line);
        assert!(lines.any(|found| found == line), "{to}: {refused}");
    }

    #[test]
    fn good_files_are_taken() {
        let settings = load(WORKER).unwrap();
        let Side::Worker(takes) = settings.side else {
            panic!("a worker's");
        };
        assert_eq!((settings.name.as_str(), takes[0].from.as_str()), ("base", "edge"));
        assert_eq!(takes[0].robots.ranges(), [(0, 4), (7, 7)]);
        let settings = load(OTHER).unwrap();
        let Side::Other { samples, follow } = settings.side else {
            panic!("another host's");
        };
        let follow = follow.unwrap();
        assert_eq!(samples.unwrap(), ["base"]);
        assert_eq!(follow.workers, ["base"]);
        assert!(
            follow.selection.wants(Carried::FORECASTS) && !follow.selection.wants(Carried::TICKS)
        );
    }

    #[test]
    fn each_service_that_the_key_allows_is_followed_beside_the_forecasts() {
        let key = joulebus_config::keys().find(|key| key.path == "follow.services").unwrap();
        let joulebus_config::ValueKind::Words(words) = key.kind else {
            panic!("{key:?}");
        };
        for word in words {
            let settings = load(&format!("{OTHER}services = [{word:?}]\n")).unwrap();
            let Side::Other { follow: Some(follow), .. } = settings.side else {
                panic!("another host's");
            };
            let wanted = Carried::ALL.iter().filter(|service| follow.selection.wants(**service));
            let wanted: Vec<&str> = wanted.map(|service| service.name).collect();
            assert_eq!(wanted, ["forecasts", word]);
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (base, from, to, line, expected) in [
            (WORKER, "name = \"base\"", "name = \"ba/se\"", 1, "letters"),
            (WORKER, "name = \"base\"", "name = \"\"", 1, "1 to 64"),
            (WORKER, "listen", "listens", 3, "nearest key is `network.listen`"),
            (WORKER, "tcp/127.0.0.1:7447", "udp/127.0.0.1:7447", 3, "tcp/"),
            (WORKER, "tcp/127.0.0.1:7447", "tcp/127.0.0.1", 3, "port"),
            (WORKER, "tcp/127.0.0.1:7447", "tcp/10.0.0.1:7447", 3, "unencrypted"),
            (WORKER, "tcp/127.0.0.1:7447", "tls/10.0.0.1:7447", 3, "[network.tls]"),
            (WORKER, "\"edge\"", "\"base\"", 6, "this link"),
            (WORKER, "7]", "12]", 7, "no platform"),
            (WORKER, "\"0-4\"", "\"4-0\"", 7, "4-0"),
            (WORKER, "[\"0-4\", 7]", "[]", 7, "1 to 64"),
            (OTHER, "to = \"base\"", "to = \"edge\"", 5, "itself"),
            (WORKER, "[worker]", "[clock]\nrealtime_within_s = 0.001\n[worker]", 4, "round trips"),
            (OTHER, "worker = \"base\"", "worker = \"base\"\nevery = 0", 8, "1 to 3600"),
            (
                OTHER,
                "worker = \"base\"",
                "worker = \"base\"\nservices = [\"samples\"]",
                8,
                "nearest word is",
            ),
            (OTHER, "connect = [\"tcp/127.0.0.1:7447\"]", "mode = \"client\"", 2, "router"),
        ] {
            assert_refused(base, (from, to), line, expected);
        }
    }

    const WORKERS: &str = "workers = [\"base\", \"spare\"]\n";
    const DESK: &str = "name = \"desk\"\nworkers = [\"base\", \"spare\"]\n[network]\n\
        connect = [\"tcp/127.0.0.1:7447\"]\n[samples]\n[follow]\n";
    const CANDIDATE: &str = "name = \"spare\"\nworkers = [\"base\", \"spare\"]\n[network]\n\
        listen = [\"tcp/127.0.0.1:7447\"]\n[worker]\n";
    const LEASE: &str =
        "[lease]\nendpoints = [\"http://127.0.0.1:2379\", \"https://etcd.example:1\"]\n";

    #[test]
    fn with_standbys_a_link_follows_all_workers_and_gives_samples_to_all() {
        let Side::Other { samples, follow } = load(DESK).unwrap().side else {
            panic!("another host's");
        };
        assert_eq!(samples.unwrap(), ["base", "spare"]);
        assert_eq!(follow.unwrap().workers, ["base", "spare"]);
    }

    #[test]
    fn one_of_several_workers_knows_the_others_and_its_place() {
        let settings = load(&format!("{CANDIDATE}{LEASE}")).unwrap();
        let Standby { rank, others, lease } = settings.standby.unwrap();
        assert_eq!((rank, others), (1, vec!["base".to_owned()]));
        assert_eq!((lease.endpoints.len(), lease.ttl_s), (2, 3));
        assert_eq!((lease.prefix.as_str(), lease.user), ("joulebus/", None));
        assert_eq!(load(WORKER).unwrap().standby, None);
    }

    #[test]
    fn what_is_wrong_with_several_workers_is_named_with_its_line() {
        let candidate = format!("{CANDIDATE}{LEASE}");
        for (text, from, to, line, expected) in [
            (DESK, "\"spare\"]", "\"base\"]", 2, "twice"),
            (DESK, ", \"spare\"", "", 2, "list of 2 to 4"),
            (DESK, "\"spare\"]", "\"desk\"]", 1, "is in `workers`"),
            (DESK, "[samples]", "[samples]\nto = \"base\"", 6, "Leave it out"),
            (DESK, "[follow]", "[follow]\nworker = \"base\"", 7, "Leave it out"),
            (DESK, WORKERS, "", 4, "with standbys all of them"),
            (DESK, "[follow]\n", &format!("[follow]\n{LEASE}"), 7, "decides nothing here"),
            (&candidate, "\"spare\"]", "\"west\"]", 1, "not in `workers`"),
            (&candidate, WORKERS, "", 5, "decides nothing here"),
            (&candidate, LEASE, "", 1, "a lease in etcd decides"),
        ] {
            assert_refused(text, (from, to), line, expected);
        }
    }

    /// Files of releases in which a fleet could be split over several workers.
    #[test]
    fn a_file_that_names_shards_is_refused_with_the_way() {
        for text in [
            WORKER.replacen('\n', "\nshards = \"shards.toml\"\n", 1),
            format!("{WORKER}[[shard]]\nname = \"a\"\nworkers = [\"base\"]\nrobots = [1]\n"),
        ] {
            let shown = load(&text).unwrap_err().to_string();
            assert!(shown.contains("docs/how-to/several-fleets.md"), "{shown}");
            assert!(!shown.contains("nearest"), "{shown}");
        }
    }

    #[test]
    fn a_lease_that_cannot_be_had_is_refused_with_its_remedy() {
        let refused = |lease: &str, expected: &str| {
            let shown =
                load(&format!("{CANDIDATE}[lease]\n{lease}")).expect_err(expected).to_string();
            assert!(shown.contains(expected), "{expected}: {shown}");
        };
        for (members, expected) in [
            ("", "list of 1 to 16"),
            ("\"127.0.0.1:2379\"", "https://host:port"),
            ("\"http://127.0.0.1\"", "https://host:port"),
            ("\"http://127.0.0.1:1/v3\"", "https://host:port"),
            ("\"ftp://127.0.0.1:1\"", "https://host:port"),
            ("\"http://10.0.0.1:2379\"", "Use https"),
        ] {
            refused(&format!("endpoints = [{members}]\n"), expected);
        }
        let endpoint = "endpoints = [\"http://127.0.0.1:2379\"]\n";
        for (line, expected) in [
            ("ttl_s = 1", "2 to 60"),
            ("ttl_s = 61", "2 to 60"),
            ("prefix = \"a b\"", "letters, digits"),
            ("user = \"root\"", "lease.password"),
            ("key = \"none.key\"", "lease.certificate"),
            ("ca = \"none.pem\"", "cannot be read"),
            ("leash = 1", "leash"),
        ] {
            refused(&format!("{endpoint}{line}\n"), expected);
        }
    }

    #[test]
    fn the_shipped_examples_are_taken() {
        let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs/links");
        // A published crate has no examples beside it.
        if !examples.is_dir() {
            return;
        }
        let fleet = FLEET.replace("20", "1000").replace("0-9", "0-999");
        let config = Config::parse(&fleet, Path::new(".")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600))
                .unwrap();
            path
        };
        write("fleet-ca.pem", "");
        for host in ["base", "edge-1", "desk"] {
            write(&format!("{host}.pem"), "");
            write(&format!("{host}.key"), "");
        }
        let mut files = 0;
        for entry in fs::read_dir(&examples).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            let text = fs::read_to_string(&path).unwrap();
            let path = write(&name, &text);
            files += 1;
            let settings = Settings::load(&path, &config);
            let settings = settings.unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(settings.standby.is_some(), name == "standby.toml", "{name}");
        }
        assert!(files >= 4, "{files}");
    }

    #[test]
    fn what_is_quoted_of_a_file_has_bounds() {
        let long = "é".repeat(100_000);
        for (text, expected) in [
            (OTHER.replace("edge", &long), "1 to 64 letters"),
            (OTHER.replace("tcp/127.0.0.1:7447", &long), "with a port"),
            (format!("{OTHER}\"{long}\" = 1\n"), "no similar key"),
            (format!("{OTHER}robots = [\"{long}\"]\n"), "has the entry"),
            (
                format!("{WORKER}{}", "[[worker.take]]\nfrom = \"?\"\n".repeat(250)),
                "more than 100 problems",
            ),
        ] {
            let error = load(&text).unwrap_err();
            let shown = error.to_string();
            assert!(shown.contains(expected), "{expected}: {shown}");
            assert!(error.problems().len() <= 101, "{expected}");
            let mut problems = error.problems().iter();
            assert!(problems.all(|problem| problem.what.chars().count() <= 401), "{shown}");
        }
    }

    #[test]
    fn a_file_of_no_host_or_of_two_is_refused() {
        for text in [
            "",
            "name = \"a\"\n[network]\nlisten = [\"tcp/127.0.0.1:1\"]\n",
            &format!("{OTHER}[worker]\n"),
            &WORKER.replace("listen = [\"tcp/127.0.0.1:7447\"]\n", ""),
        ] {
            assert!(!load(text).unwrap_err().problems().is_empty(), "{text}");
        }
    }
}
