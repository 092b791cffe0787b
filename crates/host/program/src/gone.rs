//! Verbs, options and values that are gone, and what takes their place.

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Foxglove without a server of joulebus.
const FOXGLOVE: &str =
    "captures open in Foxglove, and the ROS 2 bridge publishes: docs/how-to/foxglove.md";

const PARTS: &str = "one `joulebus eval` runs the recordings on all processors. It gives the same \
                     report, and --format json is for programs";

const HORIZONS: &str = "`joulebus eval --energy` scores the energy of the next 1 to 300 s";

/// How a network's features were computed, which its author states.
const STATED: &str =
    "it is stated when the network is converted, by joulebus.models.convert of the Python package";

/// Messages of captures and of other MCAP files, without a verb of joulebus.
const CAT: &str = "`mcap cat FILE --json` prints the messages of captures and of other MCAP files, and \
                   `joulebus.read` of Python reads captures";
/// Formats that only `cat` had.
const ROWS: &str =
    "the verb `cat`, which had it, went too. Use --format json, or `mcap cat FILE --json`";

/// Two runs of `joulebus bench`.
const COMPARE: &str =
    "`python3 tools/figures.py --compare BEFORE.json AFTER.json` compares two files of --json";

/// The program of a verb.
const PROGRAM: &str = "joulebus";

/// A recording's interpretation.
const MAPPING: &str = "a file of --mapping states it. `joulebus import --help` shows one";
/// Ids of recordings.
const IDS: &str =
    "PATH@ID gives the ids from ID on, and PATH@PLATFORM those of a platform: recordings/@100";
/// Lines that are no rows.
const WHOLE: &str = "`joulebus data convert FILE --whole-rows --out WHOLE.csv` writes the rows, which every verb reads";
/// Threads of a training.
const THREADS: &str =
    "a training takes the processors that it may use: `taskset -c 0-3 joulebus train …`";
/// Columns of a network's recordings.
const CONVERTED: &str =
    "`joulebus data convert --map … --current …` writes recordings that need no such option";
/// Settings of scores that nobody changed.
const SCORES: &str = "intervals are at 95 %, of blocks of rows or whole trials. joulebus.lab of the \
                      Python package has the settings";

/// The verb of options, the argument of values, or the program of a verb, with the words that are
/// gone and what takes their place.
const GONE: &[(&str, &str, &str)] = &[
    (PROGRAM, "cat", CAT),
    (
        PROGRAM,
        "export",
        "in Python, joulebus.read, read_frames and read_trials give tables, which pandas and Polars \
         write as Parquet: docs/how-to/python-lab.md",
    ),
    (
        PROGRAM,
        "calibrate",
        "alarms.level_alarms_per_robot_h chooses the limit of levels by a rate, and `joulebus alarms \
         CAPTURE` counts what healthy robots raised: docs/how-to/alarms.md",
    ),
    ("FORMAT", "ndjson csv", ROWS),
    ("serve", "--foxglove --host --port --allow-origin --per-robot", FOXGLOVE),
    (
        "serve",
        "--proxy",
        "a reverse proxy limits its clients, who are one to the server: docs/how-to/open-the-page.md",
    ),
    ("eval", "--partition --merge --out", PARTS),
    ("eval", "--horizons", HORIZONS),
    ("model compare", "--horizons", HORIZONS),
    ("eval", "--origins-every --confidence --block-rows", SCORES),
    ("model compare", "--origins-every --confidence --block-rows", "a comparison is at 95 %"),
    ("model compare", "--energy", "`joulebus eval --energy` scores the energy of a model"),
    ("import", "--battery --command --odometry --robot-name --robot-id --time --burst", MAPPING),
    ("import", "--first-robot", MAPPING),
    ("data info", "--columns --short", "one recording has its ranges, and several have totals"),
    ("data check", "--places", "--format json has ten places of each finding"),
    ("eval", "--platform --first-robot", IDS),
    ("model compare", "--platform --first-robot", IDS),
    ("publish trial", "--platform --first-robot", IDS),
    ("publish sim", "--platform", "--first-robot ID names a robot of the platform"),
    ("data info", "--whole-rows", WHOLE),
    ("data check", "--whole-rows", "each line that is no row is named, and the rest is checked"),
    ("train trials", "--whole-rows", WHOLE),
    ("analyze", "--whole-rows", WHOLE),
    ("eval", "--whole-rows", WHOLE),
    ("report", "--whole-rows", WHOLE),
    ("model compare", "--whole-rows", WHOLE),
    ("publish trial", "--whole-rows", WHOLE),
    ("config init", "--whole-rows", WHOLE),
    ("model import", "--map --current --whole-rows", CONVERTED),
    ("model import", "--name", "a model has the name of its file"),
    ("train sim", "--threads", THREADS),
    ("train trials", "--threads", THREADS),
    ("train trials", "--name", "a model has the name of its file, or that of the recipe"),
    ("serve", "--webhook-ca", "`ca = \"FILE\"` of a receiver in the file of --webhooks names it"),
    ("replay", "--delay", "start the planners first: they wait for the first frame"),
    ("ask", "--dock", "--return X,Y returns to the dock at this point"),
    ("analyze", "--native", "the native series are always shown. --resample adds a grid"),
    ("analyze", "--window", "the models read five readings, as the network does"),
    ("analyze", "--each", "--format json has the autocorrelation of each trial"),
    (
        "mission",
        "--first-seed --dragging",
        "seeds begin at 1, and a brush drags in a tenth of robots",
    ),
    (
        "report",
        "--published",
        "the paper's recordings were never published. --simulated shows its numbers",
    ),
    ("report", "--train", "--fit names the recordings that baselines are fitted on"),
    ("model export", "--python", "--out FILE.py writes a Python module"),
    (
        "mission",
        "--picture",
        "--format json has the outcome of each mission, and the Python package draws what you like",
    ),
    (
        "link",
        "--take-over",
        "end the worker that leads, and the lease goes to the next: docs/how-to/standby.md",
    ),
    ("train trials", "--rows", "`rows()` of a trial of the Python package has them as arrays"),
    ("model import", "--convention --normalisation --activation --part", STATED),
    ("model info", "--activation --part", STATED),
    ("bench", "--compare --fail-above", COMPARE),
    (
        "bench",
        "--repetitions --rate-hz --seed --model --threads",
        "all runs have the same input, so that figures compare. --seconds and --robots shorten them",
    ),
    (
        "bench",
        "--worker-cpus --worker-priority --worker-locked",
        "`taskset` and `chrt` before the command schedule its processes",
    ),
    ("bench", "--fleet", "--learning measures the tick of forecasts that learn"),
    (
        "KIND",
        "npy",
        "--out FILE.npz writes the same arrays into one archive, which numpy.load reads",
    ),
    (
        "KIND",
        "shards",
        "a fleet has one worker, and a large one is split into several: docs/how-to/several-fleets.md",
    ),
    (
        "BENCHMARK",
        "wait",
        "docs/decisions/shared-memory-processes.md states how the worker waits, and `bench latency` measures it",
    ),
];

/// The refusal of arguments of which clap did not know one that is gone.
pub(crate) fn instead(arguments: &clap::Error) -> Option<String> {
    let text = |kind| match arguments.get(kind) {
        Some(ContextValue::String(text)) => text.clone(),
        Some(other) => other.to_string(),
        None => String::new(),
    };
    let is_of: &dyn Fn(&str) -> bool = match arguments.kind() {
        ErrorKind::UnknownArgument => {
            &|verb| text(ContextKind::Usage).contains(&format!("joulebus {verb} "))
        }
        // `<BENCHMARK>`, or `--format <FORMAT>`.
        ErrorKind::InvalidValue => &|argument| {
            let invalid = text(ContextKind::InvalidArg);
            let name = invalid.rsplit(['<', '[']).next().unwrap_or_default();
            name.trim_end_matches(['>', ']']) == argument
        },
        // A verb of a verb has that one's name in its usage.
        ErrorKind::InvalidSubcommand => &|program| {
            let usage = text(ContextKind::Usage);
            let of_program = [" [", " <"].map(|next| format!("{PROGRAM}{next}"));
            program == PROGRAM && of_program.iter().any(|of| usage.contains(of))
        },
        _ => return None,
    };
    let unknown = match arguments.kind() {
        ErrorKind::UnknownArgument => text(ContextKind::InvalidArg),
        ErrorKind::InvalidSubcommand => text(ContextKind::InvalidSubcommand),
        _ => text(ContextKind::InvalidValue),
    };
    let mut gone = GONE.iter().filter(|(of, ..)| is_of(of));
    let (.., instead) = gone.find(|(_, words, _)| words.split(' ').any(|word| word == unknown))?;
    Some(format!("{unknown} went: {instead}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(verb: &'static str, words: &[&str]) -> Option<String> {
        let format = clap::Arg::new("format").long("format").value_name("FORMAT");
        let format = format.value_parser(["text", "json"]);
        let known = clap::Arg::new("http").long("http").action(clap::ArgAction::SetTrue);
        let chosen = clap::Arg::new("benchmark").value_name("BENCHMARK").value_parser(["kernel"]);
        let kind = clap::Arg::new("kind").long("kind").value_name("KIND").value_parser(["fleet"]);
        let verb_of = clap::Command::new(verb).args([known, chosen, format, kind]);
        let program = clap::Command::new("joulebus").subcommand(verb_of);
        let words = ["joulebus"].iter().chain(words);
        let refused = program.try_get_matches_from(words);
        instead(&refused.expect_err("the word is unknown"))
    }

    fn refused_verb(words: &[&str]) -> Option<String> {
        let model = clap::Command::new("model").subcommand(clap::Command::new("info"));
        let quiet = clap::Arg::new("quiet").long("quiet").action(clap::ArgAction::SetTrue);
        let program = clap::Command::new(PROGRAM).subcommand_required(true).arg(quiet);
        let words = [&[PROGRAM], words].concat();
        let refused = program.subcommand(model).try_get_matches_from(words);
        instead(&refused.expect_err("the verb is unknown"))
    }

    #[test]
    fn what_is_gone_is_refused_by_name_with_what_takes_its_place() {
        let each = GONE.iter().flat_map(|(of, words, instead)| {
            words.split(' ').map(move |word| (*of, word, *instead))
        });
        for (of, word, instead) in each {
            let expected = Some(format!("{word} went: {instead}"));
            if of == PROGRAM {
                assert_eq!(refused_verb(&[word]), expected);
                assert_eq!(refused_verb(&[word, "run.mcap", "--to", "parquet", "x"]), expected);
                assert_eq!(refused_verb(&["model", word]), None, "of a verb");
            } else if word.starts_with("--") {
                assert_eq!(refused(of, &[of, word]), expected);
                assert_eq!(refused(of, &[of, &format!("{word}=1")]), expected);
                assert_eq!(refused("new", &["new", word]), None, "of another verb");
            } else if of == "FORMAT" {
                assert_eq!(refused("info", &["info", "--format", word]), expected);
            } else if of == "KIND" {
                assert_eq!(refused("schema", &["schema", "--kind", word]), expected);
            } else {
                assert_eq!(refused("bench", &["bench", word]), expected);
            }
        }
        assert_eq!(refused("serve", &["serve", "--colour"]), None);
        assert_eq!(refused("bench", &["bench", "abacus"]), None);
        assert_eq!(refused_verb(&["exports"]), None);
        assert_eq!(refused("bench", &["bench", "--format", "xml"]), None);
    }
}
