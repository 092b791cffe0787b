//! Verbs that are separate programs: `joulebus VERB` executes `joulebus-VERB`, or `joulebus-lab`
//! for the offline verbs. They parse their own arguments and show their own help.

use std::env;
use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::process::Command;

use anyhow::Context as _;
use joulebus_program::described::{self, Verb};
use joulebus_program::exit::Outcome;
use joulebus_program::installed::find_program;
use joulebus_program::output::log_line;

/// The programs that are a verb each.
const PROGRAMS: [&str; 4] = ["serve", "bridge", "link", "bench"];
/// The verbs of `joulebus-lab`.
const OF_LAB: [&str; 8] =
    ["import", "data", "train", "analyze", "eval", "report", "model", "mission"];
/// Its verbs below those of `joulebus`.
const BELOW: [[&str; 2]; 2] = [["publish", "trial"], ["config", "init"]];

/// Arguments that another program parses.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Args {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    words: Vec<OsString>,
}

/// The verbs of other programs, which tell them. Programs that are not there are named on stderr.
pub(crate) fn verbs() -> &'static [Verb] {
    let mut verbs = Vec::new();
    for program in PROGRAMS.into_iter().chain(["lab"]) {
        let name = format!("joulebus-{program}");
        match find_program(&name).and_then(|program| described::ask(&program)) {
            Ok(told) => verbs.extend(told),
            Err(error) => log_line(&format!("without the options of {name}: {error:#}")),
        }
    }
    Vec::leak(verbs)
}

/// The help of a verb of another program, if `joulebus help` asks for it: that program shows it.
pub(crate) fn help(joulebus: &clap::Command) -> Option<anyhow::Result<Outcome>> {
    let is_verb = |word: &OsString| word == "help" || joulebus.find_subcommand(word).is_some();
    let words = env::args_os().skip(1).skip_while(|word| !is_verb(word));
    let mut words: Vec<OsString> = words.collect();
    // `help config init`, and `config help init`.
    let has_below = |word: &OsString| BELOW.iter().any(|[first, _]| word == first);
    let at = usize::from(words.first().is_some_and(has_below));
    words.get(at).filter(|word| *word == "help")?;
    words.remove(at);
    let is = |at: usize, name: &str| words.get(at).is_some_and(|word: &OsString| word == name);
    let of_lab = OF_LAB.iter().any(|name| is(0, name))
        || BELOW.iter().any(|[first, second]| is(0, first) && is(1, second));
    let own = PROGRAMS.into_iter().find(|name| is(0, name));
    let (verb, program) = match own {
        Some(verb) => (words.remove(0), format!("joulebus-{verb}")),
        None if of_lab => (words[0].clone(), "joulebus-lab".to_owned()),
        None => return None,
    };
    words.push("--help".into());
    Some(execute(&verb.to_string_lossy(), &program, words))
}

/// Executes the program of `verb`, with the same arguments, replacing this process. So signals and
/// the exit code need no forwarding. Returns only on failure.
///
/// # Errors
/// There is no such program, or it cannot be started.
pub(crate) fn run(verb: &str) -> anyhow::Result<Outcome> {
    let arguments = without(verb, env::args_os().skip(1));
    execute(verb, &format!("joulebus-{verb}"), arguments)
}

/// Executes `joulebus-lab`, which has the verb under the same name, as [`run`] does.
pub(crate) fn run_lab(verb: &str) -> anyhow::Result<Outcome> {
    execute(verb, "joulebus-lab", env::args_os().skip(1).collect())
}

fn execute(verb: &str, program: &str, arguments: Vec<OsString>) -> anyhow::Result<Outcome> {
    let program = find_program(program)
        .with_context(|| format!("`joulebus {verb}` is a separate program"))?;
    let error = Command::new(&program).args(arguments).exec();
    Err(error).with_context(|| format!("cannot start {}", program.display()))
}

/// The arguments without the verb, the first word equal to its name: only global options precede
/// it, and none of them takes a verb's name as its value.
fn without(verb: &str, arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.collect();
    if let Some(place) = arguments.iter().position(|argument| argument == verb) {
        arguments.remove(place);
    }
    arguments
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_verb_is_removed() {
        let words = ["-v", "--format", "json", "report", "report", "--out", "x"];
        let left = without("report", words.iter().map(OsString::from));
        assert_eq!(left, ["-v", "--format", "json", "report", "--out", "x"]);
    }
}
