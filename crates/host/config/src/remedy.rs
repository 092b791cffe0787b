//! Suggestions: nearest keys, and numbers converted from other units.

use crate::key::{File, Key, ValueKind};
use crate::table::keys;

/// Units by quantity, with their size in the first unit of the group.
const UNITS: &[(&str, &[(&str, f64)])] = &[
    (
        "time",
        &[
            ("s", 1.0),
            ("ms", 1e-3),
            ("us", 1e-6),
            ("µs", 1e-6),
            ("ns", 1e-9),
            ("min", 60.0),
            ("h", 3600.0),
        ],
    ),
    ("rate", &[("hz", 1.0), ("khz", 1e3)]),
    ("power", &[("w", 1.0), ("mw", 1e-3), ("kw", 1e3)]),
    ("energy", &[("wh", 1.0), ("mwh", 1e-3), ("kwh", 1e3), ("j", 1.0 / 3600.0), ("kj", 1.0 / 3.6)]),
    ("speed", &[("m/s", 1.0), ("mps", 1.0), ("mm/s", 1e-3), ("cm/s", 1e-2), ("km/h", 1.0 / 3.6)]),
    (
        "turn rate",
        &[
            ("rad/s", 1.0),
            ("radps", 1.0),
            ("deg/s", std::f64::consts::PI / 180.0),
            ("degps", std::f64::consts::PI / 180.0),
        ],
    ),
    ("share", &[("share", 1.0), ("%", 0.01), ("percent", 0.01)]),
];

/// The quantity of a unit, and its size.
fn unit(name: &str) -> Option<(&'static str, f64)> {
    let name = name.trim().to_lowercase();
    UNITS.iter().find_map(|(what, units)| {
        let (_, size) = units.iter().find(|(unit, _)| *unit == name)?;
        Some((*what, *size))
    })
}

/// `value` converted from unit `from` to unit `to`. Times and rates are converted to each other's
/// reciprocal.
fn convert(value: f64, from: &str, to: &str) -> Option<f64> {
    let (from_what, from_size) = unit(from)?;
    let (to_what, to_size) = unit(to)?;
    let plain = value * from_size;
    let converted = match (from_what, to_what) {
        (same, other) if same == other => plain / to_size,
        ("time", "rate") | ("rate", "time") if plain != 0.0 => 1.0 / plain / to_size,
        _ => return None,
    };
    // Rounded to nine digits, to hide rounding errors of the conversion.
    converted.is_finite().then(|| format!("{converted:.9e}").parse().ok()).flatten()
}

fn within(key: &Key, value: f64) -> bool {
    match key.kind {
        ValueKind::Integer { min, max } => {
            value.fract() == 0.0 && min as f64 <= value && value <= max as f64
        }
        ValueKind::Number { min, max } => min <= value && value <= max,
        _ => false,
    }
}

/// A text such as `33ms` in place of a number: the number to write instead.
pub(crate) fn number_in_text(key: &Key, text: &str) -> Option<String> {
    let text = text.trim();
    let end = text
        .find(|letter: char| !(letter.is_ascii_digit() || matches!(letter, '.' | '-' | '+')))
        .unwrap_or(text.len());
    let (number, suffix) = text.split_at(end);
    let value: f64 = number.parse().ok()?;
    let suffix = suffix.trim();
    if suffix.is_empty() {
        return within(key, value).then(|| format!("Write {value} without quotes"));
    }
    let converted = convert(value, suffix, key.unit)?;
    if !within(key, converted) {
        return None;
    }
    Some(format!(
        "{text} is {converted} {unit}: write {converted}, without quotes. The unit is always \
         {unit}",
        unit = key.unit
    ))
}

/// A number out of range that would be in range in another unit.
pub(crate) fn other_unit(key: &Key, value: f64) -> Option<String> {
    let candidates: &[&str] = match key.unit {
        "s" => &["ms", "Hz", "us", "ns"],
        "ms" => &["s", "us", "ns", "Hz"],
        "Hz" => &["s", "ms"],
        "W" => &["mW", "kW"],
        "Wh" => &["mWh", "J"],
        "m/s" => &["mm/s"],
        "rad/s" => &["deg/s"],
        "share" => &["%"],
        _ => &[],
    };
    candidates.iter().find_map(|from| {
        let converted =
            convert(value, from, key.unit).filter(|converted| within(key, *converted))?;
        Some(format!("If {value} was meant in {from}, write {converted}: the unit is {}", key.unit))
    })
}

/// Suffixes of key names that state a unit.
const SUFFIXES: &[(&str, &str)] = &[
    ("_s", "s"),
    ("_ms", "ms"),
    ("_us", "us"),
    ("_ns", "ns"),
    ("_hz", "Hz"),
    ("_w", "W"),
    ("_mw", "mW"),
    ("_kw", "kW"),
    ("_wh", "Wh"),
    ("_kwh", "kWh"),
    ("_j", "J"),
    ("_mps", "m/s"),
    ("_radps", "rad/s"),
    ("_degps", "deg/s"),
];

fn split_unit(name: &str) -> (&str, Option<&'static str>) {
    SUFFIXES
        .iter()
        .find_map(|(suffix, unit)| Some((name.strip_suffix(suffix)?, Some(*unit))))
        .unwrap_or((name, None))
}

/// Maximum length of a path that is compared with keys, bytes, because the work grows with the
/// length.
const MAX_PATH_BYTES: usize = 100;

/// The keys that a file may set, or all keys without a file, each with a path of its own.
fn allowed(file: Option<File>) -> impl Iterator<Item = (String, &'static Key)> {
    let keys = keys().filter(move |key| file.is_none_or(|file| file.allows(key)));
    keys.flat_map(|key| key.paths().into_iter().map(move |path| (path, key)))
}

/// The key of `file` nearest to `path`, with its path, if one is similar.
fn nearest(file: Option<File>, path: &str) -> Option<(String, &'static Key)> {
    if path.len() > MAX_PATH_BYTES {
        return None;
    }
    let wanted = path.to_lowercase();
    allowed(file)
        .map(|(path, key)| (likeness(&path, key, &wanted), path, key))
        .filter(|(likeness, ..)| *likeness >= 0.5)
        .max_by(|(one, ..), (other, ..)| one.total_cmp(other))
        .map(|(_, path, key)| (path, key))
}

/// Similarity of the key's path to another, about 0 to 1.
fn likeness(path: &str, key: &Key, wanted: &str) -> f64 {
    let alike = strsim::normalized_damerau_levenshtein;
    let (section, name) = wanted.rsplit_once('.').unwrap_or(("", wanted));
    let key_section = path.rsplit_once('.').map_or("", |(section, _)| section);
    let sorted = |name: &str| {
        let mut words: Vec<&str> = name.split('_').collect();
        words.sort_unstable();
        words.join("_")
    };
    let whole = alike(path, wanted);
    // The right name with reordered words or another unit counts as very similar.
    let best = alike(key.name(), name)
        .max(0.95 * alike(&sorted(key.name()), &sorted(name)))
        .max(0.95 * alike(split_unit(key.name()).0, split_unit(name).0))
        .max(0.94 * alike(&sorted(split_unit(key.name()).0), &sorted(split_unit(name).0)))
        .max(0.9 * whole);
    // The section, then the whole path, decide between similar names.
    let same_section = if section == key_section { 0.05 } else { 0.0 };
    best + same_section + 0.01 * whole
}

/// The replacement of bodies for single receivers.
const ONE_BODY: &str = "It went: each request has one body, whose `text` Slack and Mattermost show. For another form, run curl by `joulebus alarms --on-alarm` (docs/how-to/webhook.md)";

/// The replacement of realtime clocks that are kept together.
const ROUND_TRIPS: &str = "Remove the section: round trips alone compare the clocks of two hosts (docs/explanation/links.md)";

/// The replacement of names, units and signs of what a bridge writes.
const OWN_NAMES: &str = "Remove it: a document has all values of its topic by their names, in units of the SI. Node-RED, Telegraf or topic_tools make another form of it";

/// The replacement of shards.
const SEVERAL_FLEETS: &str = "It went: a fleet has one worker. Split a fleet that is too large into several (docs/how-to/several-fleets.md). For a standby write `workers = [\"base\", \"base-2\"]` into every link's file, with the names of both links (docs/how-to/standby.md)";

/// The replacement of the sums behind BiasHigh and BiasLow.
const NO_SUMS: &str = "Remove it: LevelHigh and LevelLow find loads, by `alarms.level_limit`";

/// Keys, sections and words of earlier versions, with their replacements.
const REPLACED: &[(&str, &str)] = &[
    (
        "platform.adapt",
        "Remove it: `platform.forecast` = \"online\", the default, learns an offset and a gain per robot",
    ),
    ("platform.forecast = mixture", "\"online\", the default, replaces it"),
    ("shards", SEVERAL_FLEETS),
    ("shard", SEVERAL_FLEETS),
    ("webhook.format", ONE_BODY),
    ("webhook.template", ONE_BODY),
    (
        "webhook.repeat_s",
        "It went: Prometheus repeats alerts to Alertmanager, by the rules in configs/prometheus (docs/how-to/webhook.md)",
    ),
    ("clock", ROUND_TRIPS),
    ("mqtt.write.fields", OWN_NAMES),
    ("ros2.write.unit", OWN_NAMES),
    ("ros2.write.negate", OWN_NAMES),
    (
        "mqtt.vizier",
        "It went: a program of yours asks the Robotarium's vizier, and publishes what it answers (docs/reference/bridge-file.md)",
    ),
    (
        "mqtt.vda5050.pass_on",
        "Remove it: a [[mqtt.write]] with `what` = \"outlook\" has the same values, on a topic of their own",
    ),
];

/// Keys without an effect any more. Captures of earlier versions have them.
const RETIRED: [&str; 3] =
    ["alarms.cusum_slack", "alarms.cusum_limit", "platform.alarms.cusum_limit"];

/// The remedy for a key that has no effect any more.
pub(crate) fn retired(path: &str) -> Option<&'static str> {
    RETIRED.contains(&path).then_some(NO_SUMS)
}

/// Words of keys that joulebus does not have, and what it asks for instead.
const NEVER: &[(&[&str], &str)] = &[
    (
        &["mass", "weight", "payload", "wheel", "wheels", "friction", "inertia", "motor", "kg"],
        "joulebus asks for no mechanics: it learns them from power readings. Of a data sheet it takes `power_min_w`, `power_max_w`, `v_max_mps`, `omega_max_radps` and `battery.capacity_wh`. `joulebus config init --power LOW-HIGH` writes them",
    ),
    (
        &["ah", "mah", "volt", "volts"],
        "A battery is stated by its energy, `battery.capacity_wh`: Ah times the nominal voltage",
    ),
];

/// Words of other vocabularies, as joulebus's keys have them.
const WORDS: &[(&str, &str)] =
    &[("period", "rate"), ("speed", "v"), ("velocity", "v"), ("turn", "omega"), ("yaw", "omega")];

/// A word of a key, as joulebus's keys have it.
fn own_word(word: &str) -> &str {
    WORDS.iter().find(|(other, _)| *other == word).map_or(word, |(_, own)| own)
}

/// The replacement of a key.
fn replaced_key(path: &str) -> Option<&'static str> {
    let (_, by) = REPLACED.iter().find(|(old, _)| *old == path)?;
    Some(by)
}

/// The replacement of a word that a key once allowed.
pub(crate) fn replaced_word(key: &Key, word: &str) -> Option<&'static str> {
    replaced_key(&format!("{} = {word}", key.path))
}

/// The remedy for an unknown key.
pub(crate) fn unknown_key(file: Option<File>, path: &str, value: Option<f64>) -> String {
    if let Some(by) = replaced_key(path) {
        return by.to_owned();
    }
    let name = path.rsplit('.').next().unwrap_or(path).to_lowercase();
    let is_ours =
        |word: &str| allowed(file).any(|(_, key)| key.name().split('_').any(|own| own == word));
    let has = |words: &[&str]| name.split('_').any(|word| words.contains(&word) && !is_ours(word));
    let of_robot = matches!(file, None | Some(File::Fleet | File::Platform));
    if let Some((_, instead)) = NEVER.iter().find(|(words, _)| of_robot && has(words)) {
        return (*instead).to_owned();
    }
    let words = path.split_inclusive(['.', '_']).map(|word| {
        let plain = word.trim_end_matches(['.', '_']);
        format!("{}{}", own_word(plain), &word[plain.len()..])
    });
    let path = &words.collect::<String>();
    let Some((nearest, key)) = nearest(file, path) else {
        return "There is no similar key: remove it, or see `config explain`".to_owned();
    };
    let mut advice = format!("The nearest key is `{nearest}`");
    let name = path.rsplit('.').next().unwrap_or(path);
    let (stem, given) = split_unit(name);
    let (key_stem, _) = split_unit(key.name());
    if let (Some(given), Some(value), true) = (given, value, stem == key_stem)
        && let Some(converted) = convert(value, given, key.unit)
    {
        advice += &format!(", in {}: {value} {given} is {converted} {}", key.unit, key.unit);
    } else if name == key.name() {
        advice += ": move it there";
    }
    advice + &format!(" ({})", key.facts())
}

/// The remedy for an unknown section.
pub(crate) fn unknown_section(file: File, path: &str) -> String {
    if let Some(by) = replaced_key(path) {
        return by.to_owned();
    }
    let alike = |section: &String| strsim::normalized_damerau_levenshtein(section, path);
    let nearest = allowed(Some(file))
        .filter_map(|(path, _)| Some(path.rsplit_once('.')?.0.to_owned()))
        .filter(|_| path.len() <= MAX_PATH_BYTES)
        .max_by(|one, other| alike(one).total_cmp(&alike(other)))
        .filter(|section| alike(section) >= 0.5);
    match nearest {
        Some(section) => format!("The nearest section is `{section}`"),
        None => unknown_key(Some(file), path, None),
    }
}
