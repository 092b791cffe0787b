//! Verbs that are separate programs: `joulebus VERB` executes `joulebus-VERB`, or `joulebus-lab`
//! for the offline verbs. Tests compare `verbs/*.json` with those programs' options.

use std::env;
use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::process::Command;

use anyhow::Context as _;
use joulebus_program::described::Verb;
use joulebus_program::exit::Outcome;
use joulebus_program::installed::find_program;

/// Descriptions of the verbs of all other programs.
const DESCRIBED: [&str; 5] = [
    include_str!("../verbs/lab.json"),
    include_str!("../verbs/serve.json"),
    include_str!("../verbs/bridge.json"),
    include_str!("../verbs/link.json"),
    include_str!("../verbs/bench.json"),
];

/// The verbs of other programs.
pub(crate) fn verbs() -> &'static [Verb] {
    let verbs: Vec<Verb> = DESCRIBED.iter().flat_map(|text| described(text)).collect();
    Vec::leak(verbs)
}

/// The program `joulebus-lab`, whose verbs are shown as those of `joulebus`.
pub(crate) fn lab() -> clap::Command {
    clap::Command::new("joulebus-lab")
        .version(env!("CARGO_PKG_VERSION"))
        .about("The verbs of joulebus that work on recordings and models (joulebus VERB runs them)")
        .after_help(
            "Examples:\n  joulebus eval recordings/ --model my.safetensors\n  joulebus help eval",
        )
}

fn described(text: &str) -> Vec<Verb> {
    // A test reads each of them.
    serde_json::from_str(text).expect("the description of a verb is valid")
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

    #[test]
    fn every_description_is_valid() {
        assert!(verbs().len() >= DESCRIBED.len());
    }
}
