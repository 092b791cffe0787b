//! The shipped files load, explain every key, and agree with the table of keys.

use std::fs;
use std::path::{Path, PathBuf};

use joulebus_config::{
    Checkpoint, Config, ConfigError, Demo, File, KEYS, ModelSource, builtin_model, builtin_models,
    builtin_platforms, explain, explanations, fleet_file, keys,
};
use joulebus_predictor::{FeatureSet, Network};
use joulebus_settings::{AlarmSettings, Intake, IntervalSettings, Policy};
use joulebus_testkit::{assert_contains, assert_page_contains};

fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs")
}

fn shipped(name: &str) -> String {
    fs::read_to_string(configs().join(name)).expect("a shipped file")
}

fn load(name: &str) -> Result<Config, ConfigError> {
    Config::load(configs().join(name))
}

/// Comments and keys of a file as one line of words, comment signs removed.
fn words(text: &str) -> String {
    let lines = text.lines().map(|line| line.trim_start_matches(['#', ' ']));
    let words: Vec<&str> = lines.flat_map(str::split_whitespace).collect();
    words.join(" ")
}

#[test]
fn shipped_fleets_load_without_a_warning() {
    for (name, robots) in [("fleet.toml", 100), ("mixed.toml", 232)] {
        let config = load(name).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(config.warnings(), [], "{name}");
        config.settings().check().unwrap();
        let listed: u32 = config
            .settings()
            .platforms
            .iter()
            .flat_map(|platform| &platform.robots)
            .map(|range| range.end() - range.start() + 1)
            .sum();
        assert_eq!(listed, robots, "{name}");
        assert_eq!(config.models().len(), config.settings().platforms.len());
    }
}

/// Inserts the keys that the shipped fleet lacks, each with its comment and default after the key
/// before it.
fn add_missing_keys() {
    let mut text = shipped("fleet.toml");
    let generated = fleet_file("", &[]);
    let sections = |text: &str| -> Vec<String> { text.split("\n[").map(str::to_owned).collect() };
    let mut before = String::new();
    for key in KEYS.iter().filter(|key| key.file == File::Fleet) {
        let line = format!("\n{} = ", key.name());
        let section = format!("{}]", key.path.split('.').next().unwrap_or_default());
        let parts = sections(&text);
        let Some(at) = parts.iter().position(|part| part.starts_with(&section)) else { continue };
        if !parts[at].contains(&line) && !parts[at].contains(&format!("\n# {}", line.trim_start()))
        {
            let own = sections(&generated).into_iter().find(|part| part.starts_with(&section));
            let own = own.expect("a section of the generated file");
            let block = own.split("\n\n").find(|block| block.contains(&line));
            let block =
                block.unwrap_or_else(|| panic!("{}: add it by hand, it has no default", key.path));
            let found = parts[at].find(&before);
            let found = found.or_else(|| parts[at].find(&format!("\n# {}", before.trim_start())));
            let end = found.map_or(section.len(), |from| {
                parts[at][from + 1..].find('\n').map_or(parts[at].len(), |to| from + 1 + to)
            });
            let mut parts = parts;
            parts[at].insert_str(end, &format!("\n\n{}", block.trim()));
            text = parts.join("\n[");
        }
        before = line;
    }
    fs::write(configs().join("fleet.toml"), text).expect("the shipped file can be written");
}

/// With `JOULEBUS_WRITE=1` it adds missing keys to the fleet's file first.
#[test]
fn every_key_is_annotated_in_the_shipped_files() {
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        add_missing_keys();
    }
    let fleet = words(&shipped("fleet.toml"));
    for key in KEYS {
        // Purpose, unit, range and default, from the table, directly before the key.
        let comment = words(&format!("{} {}", key.doc, key.facts()));
        let texts = match key.file {
            File::Platform => builtin_platforms()
                .map(|name| words(&shipped(&format!("platforms/{name}.toml"))))
                .collect(),
            _ => vec![fleet.clone()],
        };
        for text in texts {
            let (_, after) = text
                .split_once(&comment)
                .unwrap_or_else(|| panic!("{}: no comment {comment:?}", key.path));
            let next = KEYS
                .iter()
                .filter_map(|other| Some((after.find(&format!("{} = ", other.name()))?, other)))
                .min_by_key(|(position, other)| (*position, other.name() != key.name()));
            let (_, next) = next.unwrap_or_else(|| panic!("{}: comment without key", key.path));
            assert_eq!(next.name(), key.name());
        }
    }
}

/// `JOULEBUS_WRITE=1 cargo test -p joulebus-config --test all shipped` writes the page.
#[test]
fn the_page_about_keys_has_every_key() {
    let head = "| key | meaning | unit | allowed | default |\n|---|---|---|---|---|\n";
    let mut tables: Vec<(&str, String)> = Vec::new();
    for key in KEYS {
        let section = key.path.rsplit_once('.').map_or("", |(section, _)| section);
        if tables.last().is_none_or(|(last, _)| *last != section) {
            tables.push((section, head.to_owned()));
        }
        let cell = |text: &str| text.replace('|', "\\|").replace('<', "\\<");
        let (name, doc, default) = (key.name(), cell(key.doc), cell(&key.default_words()));
        let default = default.strip_prefix("default ").unwrap_or(&default);
        let default = default.strip_prefix("default: ").unwrap_or(default);
        let row =
            format!("| `{name}` | {doc} | {} | {} | {default} |\n", key.unit, cell(&key.range()));
        tables.last_mut().expect("a table").1 += &row;
    }
    let tables: Vec<String> = tables.into_iter().map(|(_, table)| table).collect();
    assert_page_contains("docs/reference/config.md", &tables);
}

#[test]
fn defaults_in_the_table_equal_those_of_missing_keys() {
    let least = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"platforms/gternal.toml\"\n\
                 robots = [\"0-99\"]\n";
    let defaults = Config::parse(least, &configs()).unwrap_or_else(|error| panic!("{error}"));
    let shipped = load("fleet.toml").unwrap();
    assert_eq!(defaults.settings(), shipped.settings());
    assert_eq!(defaults.settings().intake, Intake::default());
    assert_eq!(defaults.settings().interval, IntervalSettings::default());
    assert_eq!(defaults.settings().alarms, AlarmSettings::default());
    assert_eq!(defaults.policy(), shipped.policy());
    assert_eq!(defaults.models(), shipped.models());
    assert_eq!(defaults.root(), shipped.root());
    assert_eq!(defaults.prefix(), shipped.prefix());
    assert_eq!(defaults.checkpoint(), &Checkpoint::Auto);
    assert_eq!(defaults.tick_period_ns(), 33_333_333);
    assert_eq!(defaults.policy(), Policy::OnFrame { deadline_ns: 10_000_000 });
    // Each default also as text: `config show` writes them from the values.
    for key in KEYS.iter().filter(|key| key.file == File::Fleet) {
        let Some(default) = explanations(Some(key.path)).unwrap().remove(0).default else {
            continue;
        };
        let number = default.parse::<f64>();
        let shown = defaults
            .to_toml()
            .lines()
            .find_map(|line| line.strip_prefix(&format!("{} = ", key.name())))
            .unwrap_or_else(|| panic!("{} is not shown", key.path));
        let (shown, place) = shown.rsplit_once(" # ").unwrap();
        if key.path != "domain.root" {
            match number {
                Ok(number) => assert_eq!(shown.parse::<f64>(), Ok(number), "{}", key.path),
                Err(_) => assert_eq!(shown, format!("{default:?}"), "{}", key.path),
            }
        }
        assert_eq!(place, "default", "{}", key.path);
    }
}

#[test]
fn the_effective_config_is_the_same_config() {
    for name in ["fleet.toml", "mixed.toml"] {
        let config = load(name).unwrap();
        // Parsed from another directory, because it must not depend on its location.
        let again = Config::parse(config.to_toml(), Path::new("/"))
            .unwrap_or_else(|error| panic!("{name}: {error}\n{}", config.to_toml()));
        assert_eq!(again.settings(), config.settings());
        assert_eq!(again.policy(), config.policy());
        assert_eq!(again.models().len(), config.models().len());
        assert_eq!(again.fleet(), config.fleet());
        assert_eq!(again.root(), config.root());
        assert_eq!(again.prefix(), config.prefix());
        assert_eq!(again.buffer_frames(), config.buffer_frames());
        assert_eq!(again.max_planners(), config.max_planners());
        assert_eq!(again.checkpoint_every_ns(), config.checkpoint_every_ns());
        assert_eq!(again.tick_period_ns(), config.tick_period_ns());
        assert_eq!(again.scheduling(), config.scheduling());
    }
}

#[test]
fn the_demo_needs_only_its_own_file() {
    for robots in [1, 20, 100_000] {
        let demo = Demo {
            fleet: "demo-7".to_owned(),
            root: PathBuf::from("/dev/shm/joulebus-demo-7"),
            prefix: "jbd7_".to_owned(),
            robots,
        };
        let config = Config::parse(&demo.toml(), Path::new("/nowhere"))
            .unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(config.fleet(), demo.fleet);
        assert_eq!(config.root(), demo.root);
        assert_eq!(config.prefix(), demo.prefix);
        assert_eq!(config.settings().capacity, robots);
        let ids = 0..=robots - 1;
        assert_eq!(config.settings().platforms[0].robots, [ids]);
        assert_eq!(config.warnings(), []);
        assert!(demo.toml().contains("Private directory"), "comments stay");
    }
}

#[test]
fn the_root_is_the_users_own() {
    let config = load("fleet.toml").unwrap();
    let uid = rustix::process::geteuid().as_raw();
    assert_eq!(config.root(), Path::new(&format!("/dev/shm/joulebus-{uid}")));
}

#[test]
fn built_in_models_can_be_loaded_by_name() {
    assert_eq!(builtin_models().count(), 7);
    for name in builtin_models() {
        let (_, bytes) = builtin_model(name).unwrap();
        let network = Network::from_safetensors(bytes).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(network.card().name, name);
        let expected = match name {
            "gternal-sim-power" | "rover" => FeatureSet::PowerOnly,
            "gternal-sim-freshness" => FeatureSet::Freshness,
            _ => FeatureSet::Full,
        };
        assert_eq!(network.feature_set(), expected, "{name}");
        assert!(network.card().period_s().is_some(), "{name} does not state its period");
    }
    let (name, bytes) = builtin_model("gternal-sim").unwrap();
    let shipped = load("fleet.toml").unwrap();
    assert_eq!(shipped.models(), [ModelSource::Builtin(name, bytes)]);
}

#[test]
fn a_path_is_relative_to_the_file_that_names_it() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::create_dir_all(at("kinds")).unwrap();
    fs::create_dir_all(at("weights")).unwrap();
    fs::write(at("weights/own.safetensors"), b"not parsed").unwrap();
    let platform = shipped("platforms/rover.toml")
        .replace("\"builtin:rover\"\n", "\"../weights/own.safetensors\"\n");
    fs::write(at("kinds/own.toml"), platform).unwrap();
    fs::write(
        at("own-fleet.toml"),
        "[fleet]\nname = \"own\"\n[ledger]\ncheckpoint = \"ledger.bin\"\n\
         [[platform]]\nfile = \"kinds/own.toml\"\nrobots = [3]\nname = \"renamed\"\n",
    )
    .unwrap();
    let config = Config::load(at("own-fleet.toml")).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(config.checkpoint(), &Checkpoint::File(at("ledger.bin")));
    assert_eq!(config.settings().platforms[0].name, "renamed", "the fleet's file overrides");
    let ModelSource::File(model) = &config.models()[0] else {
        panic!("{:?}", config.models());
    };
    assert_eq!(fs::read(model).unwrap(), b"not parsed");

    // The same from memory, where no other file is read.
    let fleet = fs::read_to_string(at("own-fleet.toml")).unwrap();
    let platform = fs::read_to_string(at("kinds/own.toml")).unwrap();
    let platform = platform.replace("../weights", "/weights");
    let held =
        [("kinds/own.toml", platform.as_bytes()), ("/weights/own.safetensors", &b"held"[..])];
    let held = Config::parse_attached(&fleet, &held).unwrap();
    assert_eq!(held.settings(), config.settings());
    let ModelSource::Attached(_, bytes) = &held.models()[0] else {
        panic!("{:?}", held.models());
    };
    assert_eq!(&**bytes, b"held");
    for (path, key) in [("kinds/own.toml", "platform.model"), ("elsewhere.toml", "platform.file")] {
        let part = [(path, platform.as_bytes())];
        let refused = Config::parse_attached(&fleet, &part).unwrap_err();
        assert_eq!(refused.problems()[0].key, key);
        assert!(refused.to_string().contains("is not attached"), "{refused}");
    }

    fs::remove_file(at("weights/own.safetensors")).unwrap();
    let refused = Config::load(at("own-fleet.toml")).unwrap_err();
    let [problem] = refused.problems() else {
        panic!("{refused}");
    };
    assert!(problem.file.ends_with("kinds/own.toml"), "{problem}");
    assert!(problem.what.contains("no such file"), "{problem}");
}

#[test]
fn explanations_cover_keys_sections_and_everything() {
    assert_eq!(explanations(None).unwrap().len(), keys().count());
    assert_eq!(explanations(Some("tick")).unwrap().len(), 3);
    let text = explain(Some("tick.deadline_ms")).unwrap();
    assert_contains(&text, ["tick.deadline_ms", "ms; 0.1 to 10000; default 10"]);
    assert!(explain(Some("stale_after_s")).is_ok(), "as written in a platform's file");
    let unknown = explain(Some("tick.deadlin_ms")).unwrap_err();
    assert_contains(&unknown, ["`tick.deadline_ms`"]);
}

#[test]
fn a_root_invalid_for_shared_memory_is_refused_with_its_line() {
    let demo = |root: &str| Demo {
        fleet: "demo".to_owned(),
        root: PathBuf::from(root),
        prefix: "jb_".to_owned(),
        robots: 1,
    };
    for root in ["/dev/shm/a b", "/dev/shm/0123456789-0123456789-0123456789-0123456789"] {
        let text = demo(root).toml();
        let line = 1 + text.lines().position(|line| line.starts_with("root =")).unwrap();
        let error = Config::parse(&text, Path::new("/nowhere")).unwrap_err();
        let problem = &error.problems()[0];
        assert_eq!((problem.key.as_str(), problem.line), ("domain.root", Some(line)), "{error}");
    }
}

#[test]
fn the_robots_of_the_shipped_fleet_and_of_the_demo_have_the_battery_of_their_makers() {
    let root = PathBuf::from("/dev/shm/joulebus-demo-7");
    let demo = Demo { fleet: "demo".to_owned(), root, prefix: "jb_".to_owned(), robots: 2 };
    let config = Config::parse(&demo.toml(), Path::new("/nowhere")).unwrap();
    for config in [config, load("fleet.toml").unwrap()] {
        let battery = config.settings().platforms[0].battery.unwrap();
        assert_eq!(battery.capacity_j, 3.7 * 2.5 * 3600.0);
    }
}

#[test]
fn a_bundle_names_its_own_models_and_no_ledger() {
    let text = "[fleet]\nname = \"lab\"\n[ledger]\ncheckpoint = \"/tmp/led'\\n\\\"ger\"\n\
                [[platform]]\nfile = \"builtin:rover\"\nrobots = [1]\n\
                model = \"persistence\"\nresidual_std_w = 5.3\n\
                [[platform]]\nfile = \"builtin:gternal\"\nrobots = [3]\n";
    let config = Config::parse(text, Path::new("/")).unwrap_or_else(|error| panic!("{error}"));
    let again = Config::parse(config.to_toml(), Path::new("/")).unwrap();
    assert_eq!(again.checkpoint(), config.checkpoint());
    let bundle = config.bundle().unwrap();
    let [(path, bytes)] = bundle.files.as_slice() else {
        panic!("{} files", bundle.files.len());
    };
    assert_eq!(bytes, builtin_model("gternal-sim").unwrap().1);
    assert!(bundle.toml.contains("\ncheckpoint = \"\"\n"));
    assert!(bundle.toml.contains(&format!("\nmodel = \"{path}\"\n")));
    assert!(bundle.toml.contains("\nmodel = \"persistence\" # "));
}
