//! The program `joulebus-rosbag`: a bag of rosbag2 in an SQLite file as MCAP.
#![forbid(unsafe_code)]

mod arguments;
mod bag;
mod convert;

use std::fs::File;
use std::io;
use std::os::fd::AsFd as _;
use std::path::Path;
use std::process::ExitCode;

use crate::arguments::RosbagArguments;
use anyhow::{Context as _, bail};
use clap::Parser as _;
use joulebus_capture_format::RosFile;
use joulebus_program::exit::{self, Outcome};
use joulebus_program::exit_with_parent;
use joulebus_program::output::log_line;

use bag::Bag;
use convert::LeftOut;

fn main() -> ExitCode {
    match RosbagArguments::try_parse() {
        Ok(args) => exit::code(run(&args)),
        Err(refused) => exit::refused(&refused),
    }
}

fn run(args: &RosbagArguments) -> anyhow::Result<Outcome> {
    if args.exit_with_stdin {
        exit_with_parent::end_with_stdin()?;
    }
    let bag = Bag::open(&args.bag)?;
    let left_out = if args.out == Path::new("-") {
        convert::convert(&bag, RosFile::in_file(standard_output()?)?)?
    } else {
        let written = joulebus_files::create(&args.out, |file| -> anyhow::Result<_> {
            Ok(convert::convert(&bag, RosFile::in_file(file.try_clone()?)?)?)
        });
        written.with_context(|| args.out.display().to_string())?
    };
    for (LeftOut { what, why }, count) in &left_out {
        log_line(&format!("{count} {what} left out: {why}"));
    }
    Ok(Outcome::unless_lost(!left_out.is_empty()))
}

/// Standard output, whose beginning is written last.
fn standard_output() -> anyhow::Result<File> {
    let own = io::stdout().as_fd().try_clone_to_owned();
    let file = File::from(own.context("cannot use standard output")?);
    let found = file.metadata().context("cannot use standard output")?;
    if !found.is_file() || found.len() > 0 {
        bail!(
            "standard output is no empty file: redirect it into a new one, or name one with --out"
        );
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use crate::arguments::RosbagArguments;

    #[test]
    fn the_main_program_shows_these_options() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../cli/verbs/rosbag.json");
        joulebus_program::described::check(file.as_ref(), &[RosbagArguments::command()]);
    }
}
