//! The options of verbs that are separate programs, as data.
//!
//! A program writes a description of its options ([`check`]). `joulebus` shows them in its help,
//! completions and manual pages without that program's code, even if the program is not built. The
//! options themselves stand only beside the verb.

use std::path::Path;

use clap::builder::{PossibleValue, PossibleValuesParser, ValueRange};
use clap::{Arg, ArgAction, ArgGroup, Command, ValueHint, value_parser};
use serde::{Deserialize, Serialize};

/// A verb with its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Verb {
    name: String,
    #[serde(default, skip_serializing_if = "is_default")]
    about: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    long_about: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    after_help: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    options: Vec<Described>,
    #[serde(default, skip_serializing_if = "is_default")]
    required_groups: Vec<Group>,
    #[serde(default, skip_serializing_if = "is_default")]
    verbs: Vec<Verb>,
}

/// An option, or an argument with a position.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Described {
    id: String,
    #[serde(default, skip_serializing_if = "is_default")]
    short: Option<char>,
    #[serde(default, skip_serializing_if = "is_default")]
    long: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    help: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    long_help: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    value_names: Vec<String>,
    /// Minimum and maximum number of values. `None`: one.
    #[serde(default, skip_serializing_if = "is_default")]
    values: Option<(usize, Option<usize>)>,
    #[serde(default, skip_serializing_if = "is_default")]
    delimiter: Option<char>,
    #[serde(default, skip_serializing_if = "is_default")]
    defaults: Vec<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    possible: Vec<Possible>,
    #[serde(default, skip_serializing_if = "is_default")]
    conflicts: Vec<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    is_flag: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    is_path: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    repeats: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    required: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    hidden: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    hides_default: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    require_equals: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    last: bool,
}

/// A value that an option may have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Possible {
    name: String,
    #[serde(default, skip_serializing_if = "is_default")]
    help: Option<String>,
}

/// Options of which one is required.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    id: String,
    options: Vec<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    multiple: bool,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Verb {
    /// Describes a verb, or a whole program.
    #[must_use]
    pub fn new(command: &Command) -> Self {
        let text = |text: Option<&clap::builder::StyledStr>| text.map(ToString::to_string);
        let groups = command.get_groups().filter(|group| group.is_required_set());
        let shown = command.get_subcommands().filter(|verb| !verb.is_hide_set());
        Self {
            name: command.get_name().to_owned(),
            about: text(command.get_about()),
            long_about: text(command.get_long_about()),
            after_help: text(command.get_after_help()),
            options: command
                .get_arguments()
                .map(|option| Described::new(command, option))
                .collect(),
            required_groups: groups.map(Group::new).collect(),
            verbs: shown.map(Self::new).collect(),
        }
    }

    /// The verb as a parser that accepts everything that the program may accept: values are texts,
    /// and the program checks dependencies between options.
    #[must_use]
    pub fn command(&'static self) -> Command {
        let mut command = Command::new(self.name.as_str())
            .args(self.options.iter().map(Described::arg))
            .groups(self.required_groups.iter().map(Group::group))
            .subcommands(self.verbs.iter().map(Self::command));
        let is_required = self.options.iter().any(|option| option.required);
        if !self.verbs.is_empty() && is_required {
            command = command.args_conflicts_with_subcommands(true).subcommand_negates_reqs(true);
        } else if !self.verbs.is_empty() {
            command = command.subcommand_required(true).arg_required_else_help(true);
        }
        if let Some(about) = &self.about {
            command = command.about(about.as_str());
        }
        if let Some(about) = &self.long_about {
            command = command.long_about(about.as_str());
        }
        if let Some(help) = &self.after_help {
            command = command.after_help(help.as_str());
        }
        command
    }

    /// Replaces verbs of `command` that have no options of their own by those described.
    #[must_use]
    pub fn complete(verbs: &'static [Self], command: Command) -> Command {
        command.mut_subcommands(|own| {
            let Some(described) = verbs.iter().find(|verb| verb.name == own.get_name()) else {
                return own;
            };
            match own.has_subcommands() {
                true => Self::complete(&described.verbs, own),
                false => described.command(),
            }
        })
    }
}

impl Described {
    fn new(command: &Command, option: &Arg) -> Self {
        let text = |text: Option<&clap::builder::StyledStr>| text.map(ToString::to_string);
        let is_flag = !option.get_action().takes_values();
        let values = option.get_num_args().map(|range| {
            let most = range.max_values();
            (range.min_values(), (most < usize::MAX).then_some(most))
        });
        let conflicts = command.get_arg_conflicts_with(option);
        Self {
            id: option.get_id().to_string(),
            short: option.get_short(),
            long: option.get_long().map(str::to_owned),
            help: text(option.get_help()),
            long_help: text(option.get_long_help()),
            value_names: option
                .get_value_names()
                .unwrap_or_default()
                .iter()
                .map(ToString::to_string)
                .collect(),
            values,
            delimiter: option.get_value_delimiter(),
            defaults: option
                .get_default_values()
                .iter()
                .filter(|_| !is_flag)
                .map(|value| value.display().to_string())
                .collect(),
            possible: option
                .get_possible_values()
                .iter()
                .map(|value| Possible {
                    name: value.get_name().to_owned(),
                    help: text(value.get_help()),
                })
                .collect(),
            conflicts: conflicts.iter().map(|other| other.get_id().to_string()).collect(),
            is_flag,
            is_path: option.get_value_hint() == ValueHint::AnyPath,
            repeats: matches!(option.get_action(), ArgAction::Append | ArgAction::Count),
            required: option.is_required_set(),
            hidden: option.is_hide_set(),
            hides_default: option.is_hide_default_value_set(),
            require_equals: option.is_require_equals_set(),
            last: option.is_last_set(),
        }
    }

    fn arg(&'static self) -> Arg {
        let mut arg = Arg::new(self.id.as_str())
            .action(match (self.is_flag, self.repeats) {
                (true, true) => ArgAction::Count,
                (true, false) => ArgAction::SetTrue,
                (false, true) => ArgAction::Append,
                (false, false) => ArgAction::Set,
            })
            .conflicts_with_all(self.conflicts.iter().map(String::as_str))
            .required(self.required)
            .hide(self.hidden)
            .hide_default_value(self.hides_default)
            .require_equals(self.require_equals)
            .last(self.last);
        if let Some(short) = self.short {
            arg = arg.short(short);
        }
        if let Some(long) = &self.long {
            arg = arg.long(long.as_str());
        }
        if let Some(help) = &self.help {
            arg = arg.help(help.as_str());
        }
        if let Some(help) = &self.long_help {
            arg = arg.long_help(help.as_str());
        }
        if self.is_flag {
            return arg;
        }
        if !self.value_names.is_empty() {
            arg = arg.value_names(self.value_names.iter().map(String::as_str));
        }
        if let Some((least, most)) = self.values {
            arg = arg.num_args(match most {
                Some(most) => ValueRange::new(least..=most),
                None => ValueRange::new(least..),
            });
        }
        if let Some(delimiter) = self.delimiter {
            arg = arg.value_delimiter(delimiter);
        }
        if !self.possible.is_empty() {
            let values = self.possible.iter().map(|value| {
                let shown = PossibleValue::new(value.name.as_str());
                match &value.help {
                    Some(help) => shown.help(help.as_str()),
                    None => shown,
                }
            });
            arg = arg.value_parser(PossibleValuesParser::new(values));
        } else if self.is_path {
            arg = arg.value_parser(value_parser!(std::path::PathBuf));
        } else {
            arg = arg.value_parser(value_parser!(std::ffi::OsString));
        }
        arg.default_values(self.defaults.iter().map(String::as_str))
    }
}

impl Group {
    fn new(group: &ArgGroup) -> Self {
        Self {
            id: group.get_id().to_string(),
            options: group.get_args().map(ToString::to_string).collect(),
            multiple: group.clone().is_multiple(),
        }
    }

    fn group(&'static self) -> ArgGroup {
        ArgGroup::new(self.id.as_str())
            .args(self.options.iter().map(String::as_str))
            .required(true)
            .multiple(self.multiple)
    }
}

/// For a program's tests: checks that `joulebus` shows the program's options. `joulebus` has the
/// description in `file`, below `crates/cli/verbs`, written again with `JOULEBUS_WRITE=1`. Without
/// that folder beside the program's crate, only the program itself is checked.
///
/// # Panics
/// The description is another one, or help made of it differs from the program's own.
pub fn check(file: &Path, verbs: &[Command]) {
    let described: Vec<Verb> = verbs.iter().map(Verb::new).collect();
    let text = serde_json::to_string(&described).expect("it is plain data");
    // A line for each verb, option and value. Quotes within texts have backslashes.
    let text = ["{\"name\":", "{\"id\":"]
        .iter()
        .fold(text, |text, begin| text.replace(begin, &format!("\n{begin}")))
        + "\n";
    let again: Vec<Verb> = serde_json::from_str(&text).expect("it was just written");
    assert_eq!(again, described);
    for (verb, own) in Vec::leak(again).iter().zip(verbs) {
        // All versions are equal. The program's version is added where it is shown.
        let mut own = own.clone().version(clap::builder::Resettable::Reset);
        compare(&mut verb.command(), &mut own, "");
    }
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        std::fs::write(file, &text).expect("the description can be written");
    }
    if file.parent().is_some_and(Path::is_dir) {
        let kept = std::fs::read_to_string(file).unwrap_or_default();
        let shown = file.display();
        assert!(kept == text, "{shown} is stale: run this test again with JOULEBUS_WRITE=1");
    }
}

/// Panics unless both show the same, and so do their verbs.
fn compare(made: &mut Command, own: &mut Command, within: &str) {
    let name = format!("{within} {}", own.get_name());
    made.build();
    own.build();
    let shown = |command: &mut Command| {
        let helps = [command.render_help(), command.render_long_help()];
        helps.map(|help| help.to_string())
    };
    assert_eq!(shown(made), shown(own), "{name}");
    let others = own.get_subcommands_mut().filter(|verb| !verb.is_hide_set());
    for (made, own) in made.get_subcommands_mut().zip(others) {
        compare(made, own, &name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    /// Every form of an option.
    #[derive(Debug, clap::Parser)]
    #[command(name = "verb", after_help = "Examples:\n  \"joulebus\" verb", group = ArgGroup::new("one").required(true).args(["a", "b"]))]
    struct Everything {
        /// A flag
        #[arg(short, long)]
        a: bool,
        /// Repeated values
        ///
        /// And what they are.
        #[arg(long, value_name = "X,…", value_delimiter = ',', conflicts_with = "a")]
        b: Vec<String>,
        /// Optional
        #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "1")]
        c: Option<u8>,
        /// One of
        #[arg(long, value_parser = ["x", "y"], default_value = "x", hide_default_value = true)]
        d: String,
        /// Hidden
        #[arg(long, hide = true)]
        e: bool,
        /// With a default
        #[arg(long, default_value_t = 0.25)]
        f: f64,
        /// Two
        #[arg(long, num_args = 2, value_names = ["FORMAT", "DIR"])]
        g: Vec<String>,
        /// Paths
        #[arg(required = true)]
        paths: Vec<std::path::PathBuf>,
        /// After --
        #[arg(last = true)]
        rest: Vec<std::ffi::OsString>,
    }

    #[test]
    fn what_is_described_shows_the_same_help_and_accepts_what_the_program_does() {
        check_shown(Everything::command());
        let verbs: &'static [Verb] = Vec::leak(vec![Verb::new(&Everything::command())]);
        for (words, accepted) in [
            (vec!["p", "-a", "--c", "--d", "y"], true),
            (vec!["p", "q", "--b", "1,2", "--g", "a", "b", "--", "-x"], true),
            (vec!["-a"], false),
            (vec!["p"], false),
            (vec!["p", "-a", "--b", "1"], false),
            (vec!["p", "-a", "--d", "z"], false),
            (vec!["p", "-a", "--h"], false),
        ] {
            let words = || ["verb"].into_iter().chain(words.iter().copied());
            let own = Everything::command().try_get_matches_from(words()).is_ok();
            let made = verbs[0].command().try_get_matches_from(words()).is_ok();
            assert_eq!(
                (own, made),
                (accepted, accepted),
                "{words:?}",
                words = words().collect::<Vec<_>>()
            );
        }
    }

    fn check_shown(mut command: Command) {
        let verbs = Vec::leak(vec![Verb::new(&command)]);
        compare(&mut verbs[0].command(), &mut command, "");
    }

    #[test]
    fn only_verbs_without_verbs_are_replaced() {
        let lab = Command::new("lab")
            .subcommand(Command::new("publish").subcommand(Command::new("trial").about("Play")));
        let own = Command::new("joulebus").subcommand(
            Command::new("publish")
                .about("Own")
                .subcommand(Command::new("sim").about("Simulate"))
                .subcommand(Command::new("trial")),
        );
        let verbs = Box::leak(Box::new(Verb::new(&lab)));
        let whole = Verb::complete(&verbs.verbs, own);
        let publish = whole.find_subcommand("publish").unwrap();
        let about = |verb: &Command| verb.get_about().map(ToString::to_string);
        assert_eq!(about(publish).as_deref(), Some("Own"));
        let shown: Vec<_> = publish.get_subcommands().filter_map(about).collect();
        assert_eq!(shown, ["Simulate", "Play"]);
    }
}
