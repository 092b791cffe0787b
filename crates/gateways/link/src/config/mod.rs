//! The link's file, checked strictly: which frames this host sends and receives, and over which
//! network.
//!
//! Every problem is reported with its line.

mod check;
mod lease;
mod network;
mod shards;

use std::path::Path;
use std::sync::Arc;

use joulebus_config::{CheckedFile, Config, ConfigError, File, Section};
use joulebus_wire::fnv1a;

use crate::config::check::Check;
use crate::protocol::carried::Carried;
use crate::protocol::message::FleetId;
use crate::protocol::selection::Selection;
use crate::protocol::shards::Shards;

pub(crate) use lease::LeaseSettings;
pub(crate) use network::{Mode, NetworkSettings, TlsSettings};

/// The checked settings of a link.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) name: String,
    pub(crate) network: NetworkSettings,
    /// The shards of the fleet, if it is split over several workers.
    pub(crate) shards: Option<Arc<Shards>>,
    pub(crate) side: Side,
    /// Set if this host's worker is one of several candidates for its shard.
    pub(crate) standby: Option<Standby>,
}

/// A candidate for a shard. One of the candidates leads at a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Standby {
    /// The shard's name.
    pub(crate) shard: String,
    /// Position in the shard's list of candidates.
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
    /// No worker.
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
    /// Names of each shard's links. A fleet without shards has one list of one name.
    pub(crate) workers: Vec<Vec<String>>,
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
    pub(crate) fn fleet(&self, config: &Config) -> FleetId {
        FleetId {
            name: fnv1a(config.fleet().bytes()),
            shards: self.shards.as_deref().map_or(0, Shards::digest),
        }
    }

    /// True if the robot belongs to the worker of this link.
    pub(crate) fn has_robot(&self, robot: u32) -> bool {
        let shards = self.shards.as_deref();
        shards.is_none_or(|shards| shards.of_robot(robot) == shards.of_worker(&self.name))
    }
}

impl Check {
    fn settings(&mut self, file: &Section<'_>, config: &Config) -> Option<Settings> {
        let name = file.text("name");
        let network = self.network(file);
        let shards = file.text("shards").map(|path| self.shards(&path, config));
        let has_shards = shards.is_some();
        let shards = shards.flatten().map(Arc::new);
        let name = name?.to_string();
        let standby = self.standby(file, (&name, shards.as_deref()));
        let sides = ["worker", "samples", "follow"].map(|side| file.section(side));
        let side = match sides {
            [Some(worker), None, None] => {
                if let Some(shards) = &shards
                    && shards.of_worker(&name).is_none()
                {
                    let what = format!("= {name:?} is in `workers` of no shard");
                    self.add(file.problem("name", what, "Name it in `shard.workers`"));
                }
                Side::Worker(self.takes(&worker, &name, config))
            }
            [None, samples, follow] if samples.is_some() || follow.is_some() => {
                let all = shards.as_deref().map(Shards::all).unwrap_or_default();
                if let Some(shard) = all.iter().find(|shard| shard.workers.contains(&name)) {
                    let what = format!("= {name:?} is in `workers` of the shard {}", shard.name);
                    let remedy = "A worker's host has [worker]. Give this link another name";
                    self.add(file.problem("name", what, remedy));
                }
                let of = (name.as_str(), shards.as_deref(), has_shards);
                let samples = samples.map(|section| self.workers(&section, "to", of).concat());
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
        Some(Settings { name, network: network?, shards, side, standby })
    }

    /// Checks whether the worker of the link `name` is one of several candidates.
    fn standby(
        &mut self,
        file: &Section<'_>,
        (name, shards): (&str, Option<&Shards>),
    ) -> Option<Standby> {
        let section = file.section("lease");
        let lease = section.as_ref().and_then(|lease| self.lease(lease, file));
        let shard = shards.and_then(|shards| Some(&shards.all()[shards.of_worker(name)?]));
        let Some(shard) = shard.filter(|shard| shard.workers.len() > 1) else {
            if let Some(lease) = section {
                let what = "decides nothing here".to_owned();
                let remedy = "Name this link and another in `workers` of one shard, or leave the section out";
                self.add(lease.problem("", what, remedy));
            }
            return None;
        };
        if section.is_none() {
            let what =
                format!("is missing, and shard {} has {} workers", shard.name, shard.workers.len());
            let remedy = "Write the section: a lease in etcd decides which of them serves";
            self.add(file.problem("lease", what, remedy));
        }
        Some(Standby {
            shard: shard.name.clone(),
            rank: shard.workers.iter().position(|worker| worker == name)?,
            others: shard.workers.iter().filter(|worker| *worker != name).cloned().collect(),
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

    /// The links of each shard's workers, or the one that `key` names in a fleet without shards.
    fn workers(
        &mut self,
        section: &Section<'_>,
        key: &str,
        (name, shards, has_shards): (&str, Option<&Shards>, bool),
    ) -> Vec<Vec<String>> {
        match section.text(key) {
            Some(text) if !has_shards => {
                if *text == *name {
                    self.add(text.problem("is this link itself", "Name the worker's link"));
                }
                vec![vec![text.to_string()]]
            }
            Some(text) => {
                let remedy = "Leave it out: the shards have their workers";
                self.add(text.problem("beside a file of shards", remedy));
                Vec::new()
            }
            None if !has_shards => {
                if !section.has(key) {
                    let remedy = "Name the worker's link, or the fleet's file of `shards`";
                    self.add(section.problem(key, "is missing".to_owned(), remedy));
                }
                Vec::new()
            }
            None => {
                let all = shards.map(Shards::all).unwrap_or_default();
                all.iter().map(|shard| shard.workers.clone()).collect()
            }
        }
    }

    fn follow(
        &mut self,
        section: &Section<'_>,
        of: (&str, Option<&Shards>, bool),
        config: &Config,
    ) -> Follow {
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
        let wants_ticks = services & Carried::TICKS.bit() != 0;
        if workers.len() > 1 && wants_ticks {
            let what = format!("has \"ticks\" of {} workers", workers.len());
            let remedy = "Leave it out: a journal is of one worker";
            self.add(section.problem("services", what, remedy));
        }
        let ranges = self.robots(section, config).ranges().to_vec();
        let every = section.integer("every").unwrap_or(1);
        Follow { workers, selection: Selection::new(services, every, ranges) }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

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

    #[test]
    fn good_files_are_taken() {
        let settings = load(WORKER).unwrap();
        let Side::Worker(takes) = settings.side else {
            panic!("a worker's");
        };
        assert_eq!((settings.name.as_str(), takes[0].from.as_str()), ("base", "edge"));
        assert_eq!(takes[0].robots.ranges(), [(0, 4), (7, 7)]);
        assert_eq!(settings.network.realtime_within_ns, None);
        let kept = WORKER.replace("[worker]\n", "[clock]\nrealtime_within_s = 0.00005\n[worker]\n");
        let within_ns = load(&kept).unwrap().network.realtime_within_ns;
        assert_eq!(within_ns, Some(50_000));
        let settings = load(OTHER).unwrap();
        let Side::Other { samples, follow } = settings.side else {
            panic!("another host's");
        };
        let follow = follow.unwrap();
        assert_eq!(samples.unwrap(), ["base"]);
        assert_eq!(follow.workers, [["base"]]);
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
            (
                WORKER,
                "[worker]",
                "[clock]\nrealtime_within_s = nan\n[worker]",
                5,
                "0.000001 to 0.01",
            ),
            (WORKER, "[worker]", "[clock]\nrealtime_within_s = 1\n[worker]", 5, "0.000001 to 0.01"),
            (WORKER, "[worker]", "[clock]\n[worker]", 4, "realtime_within_s"),
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
            let text = base.replacen(from, to, 1);
            assert_ne!(text, base, "{from}");
            let refused = load(&text).expect_err(to);
            let shown = refused.to_string();
            assert!(shown.contains(expected), "{to}: {shown}");
            let lines: Vec<_> =
                refused.problems().iter().filter_map(|problem| problem.line).collect();
            assert!(lines.contains(&line), "{to}: {lines:?} {shown}");
        }
    }

    const SHARDS: &str = "[[shard]]\nname = \"a\"\nworkers = [\"base\", \"spare\"]\nrobots = [\"0-4\"]\n\
        [[shard]]\nname = \"b\"\nworkers = [\"south\"]\nrobots = [\"5-9\"]\n";
    const DESK: &str = "name = \"desk\"\nshards = \"shards.toml\"\n[network]\n\
        connect = [\"tcp/127.0.0.1:7447\"]\n[samples]\n[follow]\n";

    /// Loads a link's file with a file of shards beside it.
    fn load_with(shards: &str, text: &str) -> Result<Settings, ConfigError> {
        let config = Config::parse(FLEET, Path::new(".")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("shards.toml"), shards).unwrap();
        let path = folder.path().join("link.toml");
        fs::write(&path, text).unwrap();
        Settings::load(&path, &config)
    }

    #[test]
    fn links_of_a_fleet_with_shards_follow_all_workers_and_give_samples_to_all() {
        let settings = load_with(SHARDS, DESK).unwrap();
        let Side::Other { samples, follow } = &settings.side else {
            panic!("another host's");
        };
        let links = ["base", "spare", "south"];
        assert_eq!(samples.as_deref().unwrap(), links);
        let follow = follow.as_ref().unwrap();
        assert_eq!(follow.workers.concat(), links);
        assert_eq!(follow.workers.len(), 2);
        let worker = WORKER.replacen('\n', "\nshards = \"shards.toml\"\n", 1);
        let settings = load_with(SHARDS, &worker).unwrap();
        assert!(settings.has_robot(4) && !settings.has_robot(5));
        let hashed = SHARDS.replace("robots", "# robots");
        let (one, other) = (
            load_with(&hashed, &worker).unwrap(),
            load_with(&hashed, &worker.replacen("base", "south", 1)).unwrap(),
        );
        assert!((0..10).all(|robot| one.has_robot(robot) != other.has_robot(robot)));
    }

    #[test]
    fn what_is_wrong_with_shards_is_named_with_its_line() {
        let worker = WORKER.replacen('\n', "\nshards = \"shards.toml\"\n", 1);
        for (text, from, to, line, expected) in [
            (DESK, "\"a\"", "\"b\"", 6, "twice"),
            (DESK, "\"south\"", "\"spare\"", 7, "twice"),
            (DESK, "\"5-9\"", "\"4-9\"", 4, "robot 4 in two"),
            (DESK, "\"5-9\"", "\"6-9\"", 4, "not have robot 5"),
            (DESK, "robots = [\"5-9\"]", "", 4, "1 of 2"),
            (DESK, "[\"base\", \"spare\"]", "[]", 3, "has 0 entries"),
            (DESK, "\"5-9\"", "\"9-5\"", 4, "9-5"),
            (DESK, "name = \"b\"", "names = \"b\"", 6, "nearest key is `shard.name`"),
            (DESK, "\"south\"", "\"desk\"", 1, "of the shard b"),
            (&worker, "\"base\"", "\"west\"", 1, "no shard"),
        ] {
            let shards = SHARDS.replacen(from, to, 1);
            assert_ne!(shards, SHARDS, "{from}");
            let refused = load_with(&shards, text).expect_err(to);
            let shown = refused.to_string();
            assert!(shown.contains(expected), "{to}: {shown}");
            let lines: Vec<_> =
                refused.problems().iter().filter_map(|problem| problem.line).collect();
            assert!(lines.contains(&line), "{to}: {lines:?} {shown}");
        }
        for (from, to, expected) in [
            ("[follow]", "[follow]\nworker = \"base\"", "Leave it out"),
            ("[follow]", "[follow]\nservices = [\"ticks\"]", "of one worker"),
            ("shards = ", "# shards = ", "file of `shards`"),
            ("shards.toml", "none.toml", "cannot be read"),
        ] {
            let text = DESK.replace(from, to);
            let shown = load_with(SHARDS, &text).expect_err(expected).to_string();
            assert!(shown.contains(expected), "{expected}: {shown}");
        }
    }

    const CANDIDATE: &str = "name = \"spare\"\nshards = \"shards.toml\"\n[network]\n\
        listen = [\"tcp/127.0.0.1:7447\"]\n[worker]\n";

    #[test]
    fn one_of_several_workers_of_a_shard_knows_the_others_and_its_place() {
        let lease =
            "[lease]\nendpoints = [\"http://127.0.0.1:2379\", \"https://etcd.example:1\"]\n";
        let settings = load_with(SHARDS, &format!("{CANDIDATE}{lease}")).unwrap();
        let Standby { shard, rank, others, lease } = settings.standby.unwrap();
        assert_eq!((shard.as_str(), rank, others), ("a", 1, vec!["base".to_owned()]));
        assert_eq!((lease.endpoints.len(), lease.ttl_s), (2, 3));
        let refused = load_with(SHARDS, CANDIDATE).unwrap_err().to_string();
        assert!(refused.contains("a lease in etcd decides"), "{refused}");
        assert_eq!((lease.prefix.as_str(), lease.user), ("joulebus/", None));
        // The only candidate of its shard.
        let south = CANDIDATE.replace("spare", "south");
        assert_eq!(load_with(SHARDS, &south).unwrap().standby, None);
    }

    #[test]
    fn a_lease_that_cannot_be_had_is_refused_with_its_remedy() {
        let refused = |name: &str, lease: &str, expected: &str| {
            let text = format!("{}[lease]\n{lease}", CANDIDATE.replace("spare", name));
            let shown = load_with(SHARDS, &text).expect_err(expected).to_string();
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
            refused("spare", &format!("endpoints = [{members}]\n"), expected);
        }
        let endpoint = "endpoints = [\"http://127.0.0.1:2379\"]\n";
        refused("south", endpoint, "decides nothing here");
        for (line, expected) in [
            ("ttl_s = 1", "2 to 60"),
            ("ttl_s = 61", "2 to 60"),
            ("prefix = \"a b\"", "letters, digits"),
            ("user = \"root\"", "lease.password"),
            ("key = \"none.key\"", "lease.certificate"),
            ("ca = \"none.pem\"", "cannot be read"),
            ("leash = 1", "leash"),
        ] {
            refused("spare", &format!("{endpoint}{line}\n"), expected);
        }
    }

    #[test]
    fn the_shipped_examples_are_taken_with_and_without_shards() {
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
            if name.ends_with("shards.toml") {
                continue;
            }
            if name == "standby.toml" {
                let shards = "standby-shards.toml";
                write(shards, &fs::read_to_string(examples.join(shards)).unwrap());
            }
            files += 1;
            let settings = Settings::load(&path, &config);
            let settings = settings.unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(settings.standby.is_some(), name == "standby.toml", "{name}");
            if settings.shards.is_some() {
                continue;
            }
            // With shards, no section names a worker.
            let split = text.replacen("\n[network]", "\nshards = \"shards.toml\"\n[network]", 1);
            let split = split.replace("to = \"base\"", "").replace("worker = \"base\"", "");
            write("shards.toml", &fs::read_to_string(examples.join("shards.toml")).unwrap());
            Settings::load(&write(&name, &split), &config)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
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
