//! The verbs and options of a program, for the completions and manual pages of `joulebus`.
//!
//! Each program parses its own arguments and shows its own help. `joulebus` asks it for the names
//! ([`answer`]). So options stand only beside their verb, and no file repeats them.

use std::path::Path;
use std::process::{self, ExitCode, Stdio};

use anyhow::Context as _;
use clap::builder::PossibleValuesParser;
use clap::{Arg, ArgAction, Command, ValueHint};
use serde::{Deserialize, Serialize};

use crate::exit;
use crate::output::text;

/// The only argument of a process that is asked for its verbs.
const REQUEST: &str = "--describe-verbs";

/// A verb with its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verb {
    name: String,
    about: String,
    options: Vec<Described>,
    verbs: Vec<Verb>,
}

/// An option, or an argument with a position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Described {
    id: String,
    short: Option<char>,
    long: Option<String>,
    help: String,
    /// The values that it may have. Empty: any, or none.
    possible: Vec<String>,
    takes_value: bool,
    is_path: bool,
    is_last: bool,
}

/// Prints the verbs if this process was started for that, and returns its exit code.
pub fn answer(verbs: impl FnOnce() -> Vec<Command>) -> Option<ExitCode> {
    let mut arguments = std::env::args_os().skip(1);
    if arguments.next()? != REQUEST || arguments.next().is_some() {
        return None;
    }
    let verbs: Vec<Verb> = verbs().iter().map(Verb::new).collect();
    let told = serde_json::to_string(&verbs).context("the verbs are plain data");
    Some(exit::code(told.and_then(|told| text(&told)).map(|()| exit::Outcome::Done)))
}

/// The verbs of another program of this release.
///
/// # Errors
/// It cannot be started, or is of another release.
pub fn ask(program: &Path) -> anyhow::Result<Vec<Verb>> {
    let failed = || format!("cannot ask {} for its verbs", program.display());
    let mut asked = process::Command::new(program);
    let asked = asked.arg(REQUEST).stdin(Stdio::null()).output().with_context(failed)?;
    let verbs = serde_json::from_slice(&asked.stdout).ok().filter(|_| asked.status.success());
    verbs.with_context(|| format!("{} is of another release: build it again", program.display()))
}

impl Verb {
    fn new(command: &Command) -> Self {
        let shown = command.get_subcommands().filter(|verb| !verb.is_hide_set());
        let options = command.get_arguments().filter(|option| !option.is_hide_set());
        Self {
            name: command.get_name().to_owned(),
            about: command.get_about().map(ToString::to_string).unwrap_or_default(),
            options: options.map(Described::new).collect(),
            verbs: shown.map(Self::new).collect(),
        }
    }

    /// The verb as a command that clap completes. It does not parse as the program does.
    fn command(&'static self) -> Command {
        Command::new(self.name.as_str())
            .about(self.about.as_str())
            .args(self.options.iter().map(Described::arg))
            .subcommands(self.verbs.iter().map(Self::command))
    }

    /// Replaces the verbs of `command` that are other programs' by those described.
    #[must_use]
    pub fn complete(verbs: &'static [Self], command: Command) -> Command {
        command.mut_subcommands(|own| match verbs.iter().find(|verb| verb.name == own.get_name()) {
            Some(described) if own.has_subcommands() => Self::complete(&described.verbs, own),
            Some(described) => described.command(),
            None => own,
        })
    }
}

impl Described {
    fn new(option: &Arg) -> Self {
        let possible = option.get_possible_values();
        Self {
            id: option.get_id().to_string(),
            short: option.get_short(),
            long: option.get_long().map(str::to_owned),
            help: option.get_help().map(ToString::to_string).unwrap_or_default(),
            possible: possible.iter().map(|value| value.get_name().to_owned()).collect(),
            takes_value: option.get_action().takes_values(),
            is_path: option.get_value_hint() == ValueHint::AnyPath,
            is_last: option.is_last_set(),
        }
    }

    fn arg(&'static self) -> Arg {
        let mut arg = Arg::new(self.id.as_str()).help(self.help.as_str()).last(self.is_last);
        arg = match (self.short, &self.long) {
            (Some(short), Some(long)) => arg.short(short).long(long.as_str()),
            (Some(short), None) => arg.short(short),
            (None, Some(long)) => arg.long(long.as_str()),
            (None, None) => arg,
        };
        if !self.takes_value {
            return arg.action(ArgAction::SetTrue);
        }
        if !self.possible.is_empty() {
            let values = self.possible.iter().map(String::as_str);
            arg = arg.value_parser(PossibleValuesParser::new(values));
        }
        let hint = if self.is_path { ValueHint::AnyPath } else { ValueHint::Unknown };
        arg.value_hint(hint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[derive(Debug, clap::Parser)]
    #[command(name = "verb", about = "Do something")]
    struct Everything {
        /// A flag
        #[arg(short, long)]
        all: bool,
        /// One of
        #[arg(long, value_parser = ["x", "y"], default_value = "x")]
        one_of: String,
        /// Hidden
        #[arg(long, hide = true)]
        hidden: bool,
        /// Paths
        #[arg(required = true)]
        paths: Vec<std::path::PathBuf>,
        /// After --
        #[arg(last = true)]
        rest: Vec<std::ffi::OsString>,
    }

    #[test]
    fn what_a_program_tells_has_its_shown_options_with_their_values() {
        let told = serde_json::to_string(&[Verb::new(&Everything::command())]).unwrap();
        let verbs: Vec<Verb> = serde_json::from_str(&told).unwrap();
        let mut command = Vec::leak(verbs)[0].command();
        command.build();
        assert_eq!(command.get_about().map(ToString::to_string).as_deref(), Some("Do something"));
        let find = |id: &str| command.get_arguments().find(|option| option.get_id() == id);
        assert!(find("hidden").is_none());
        let all = find("all").unwrap();
        assert_eq!((all.get_short(), all.get_long()), (Some('a'), Some("all")));
        assert!(!all.get_action().takes_values());
        let values = find("one_of").unwrap().get_possible_values();
        let names: Vec<&str> = values.iter().map(|value| value.get_name()).collect();
        assert_eq!(names, ["x", "y"]);
        assert_eq!(find("paths").unwrap().get_value_hint(), ValueHint::AnyPath);
        assert!(find("rest").unwrap().is_last_set());
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
