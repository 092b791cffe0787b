//! `joulebus man`.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context as _;
use joulebus_files::WholeFolder;
use joulebus_program::exit::Outcome;
use joulebus_program::file::write;
use joulebus_program::installed::find_program;

/// Columns of a page, from which man indents.
const COLUMNS: &str = "72";

/// Write the manual pages of all verbs into a folder
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus man ~/.local/share/man/man1\n  \
    joulebus man /tmp/pages && man /tmp/pages/joulebus-run.1\n\n\
    The pages say what --help says.")]
pub(crate) struct Args {
    /// The folder, which is created if it does not exist
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Writes the manual pages of `program`. A verb whose program is not there has none.
pub(crate) fn run(args: &Args, program: &clap::Command) -> anyhow::Result<Outcome> {
    let failed = || format!("cannot write the pages into {}", args.folder.display());
    let joulebus = env::current_exe().context("cannot find the program's own file")?;
    let mut whole = WholeFolder::begin(&args.folder).with_context(failed)?;
    let mut keep = |name: &str, help: Option<String>| -> anyhow::Result<()> {
        let Some(help) = help else { return Ok(()) };
        let path = whole.path(format!("{name}.1")).with_context(failed)?;
        write(&path, page(name, &help).as_bytes())
    };
    if let Ok(lab) = find_program("joulebus-lab") {
        keep("joulebus-lab", help(&lab, &[])?)?;
    }
    let mut verbs = vec![(Vec::new(), program)];
    while let Some((words, verb)) = verbs.pop() {
        let name: Vec<&str> = ["joulebus"].iter().chain(&words).copied().collect();
        keep(&name.join("-"), help(&joulebus, &words)?)?;
        for below in verb.get_subcommands().filter(|below| !below.is_hide_set()) {
            verbs.push(([&words[..], &[below.get_name()]].concat(), below));
        }
    }
    whole.keep().with_context(failed)?;
    Ok(Outcome::Done)
}

/// What `--help` says of a verb. `None` if its program is not there.
fn help(program: &Path, verb: &[&str]) -> anyhow::Result<Option<String>> {
    let mut command = Command::new(program);
    command.args(verb).arg("--help").env("COLUMNS", COLUMNS);
    // Of a terminal, clap would take the width.
    command.stdin(Stdio::null());
    let shown = command.output().with_context(|| format!("cannot start {}", program.display()))?;
    let text = String::from_utf8(shown.stdout).context("a help is no text")?;
    Ok(shown.status.success().then_some(text))
}

/// A manual page of a help: its headings, its prose, and its lists as they are.
fn page(name: &str, help: &str) -> String {
    let (about, rest) = help.split_once("\n\n").unwrap_or((help, ""));
    let (title, version) = (name.to_uppercase(), env!("CARGO_PKG_VERSION"));
    let mut page = format!(".TH {title} 1 \"\" \"joulebus {version}\"\n.SH NAME\n");
    page += &format!("{} \\- {}\n", escaped(name), escaped(&about.replace('\n', " ")));
    // Whether the section is prose, and its lines are joined.
    let (mut is_prose, mut is_filled) = (false, true);
    let lines: Vec<&str> = rest.lines().collect();
    for (at, line) in lines.iter().enumerate() {
        let heads_list = lines.get(at + 1).is_some_and(|next| next.starts_with("  "));
        let heading = line.strip_suffix(':').filter(|title| title.split(' ').count() < 5);
        if let Some(usage) = line.strip_prefix("Usage: ") {
            page += &format!(".SH SYNOPSIS\n.nf\n{}\n", escaped(usage));
            (is_prose, is_filled) = (false, false);
        } else if let Some(title) = heading.filter(|title| !title.starts_with(' ')) {
            page += &format!(".SH {}\n.nf\n", escaped(&title.to_uppercase()));
            (is_prose, is_filled) = (false, false);
        } else if line.is_empty() {
            page += if is_filled { ".PP\n" } else { "\n" };
        } else if line.starts_with(' ') {
            page += if is_filled { ".nf\n" } else { "" };
            is_filled = false;
            page += &format!("{}\n", escaped(line));
        } else if !is_prose && heads_list {
            page += &format!(".SS {}\n.nf\n", escaped(line));
            is_filled = false;
        } else {
            if !is_prose {
                page += ".SH DESCRIPTION\n";
            }
            page += if is_filled { "" } else { ".fi\n" };
            (is_prose, is_filled) = (true, true);
            page += &format!("{}\n", escaped(line));
        }
    }
    page
}

/// A text without requests of roff.
fn escaped(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-");
    match text.starts_with(['.', '\'']) {
        true => format!("\\&{text}"),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_the_sections_prose_and_lists_of_the_help() {
        let help = "Do it\nwell\n\nUsage: joulebus do [A]\n\nOptions:\n  -a, --all\n          .all \\\n\n\
                    Examples:\n  joulebus do\n\nIt is\ndone.\n\n    1,2\n\nEnd.\n";
        let expected = ".TH JOULEBUS-DO 1 \"\" \"joulebus VERSION\"\n.SH NAME\n\
            joulebus\\-do \\- Do it well\n.SH SYNOPSIS\n.nf\njoulebus do [A]\n\n\
            .SH OPTIONS\n.nf\n  \\-a, \\-\\-all\n          .all \\e\n\n\
            .SH EXAMPLES\n.nf\n  joulebus do\n\n\
            .SH DESCRIPTION\n.fi\nIt is\ndone.\n.PP\n.nf\n    1,2\n\n.fi\nEnd.\n";
        let expected = expected.replace("VERSION", env!("CARGO_PKG_VERSION"));
        assert_eq!(page("joulebus-do", help), expected);
    }
}
