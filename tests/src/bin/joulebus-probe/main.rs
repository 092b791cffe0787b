//! Source, controller, planner and recorder for the tests: accesses shared memory in this process
//! and reports in JSON lines.
#![forbid(unsafe_code)]

mod asker;
mod consumer;
mod controller;
mod reader;
mod source;

use std::error::Error;
use std::io::Write as _;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use joulebus_config::Config;
use serde::Serialize;

type Done = Result<(), Box<dyn Error>>;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::logging::start(1, joulebus_program::logging::LogFormat::Text);
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[&str]) -> Done {
    match *arguments {
        ["source", name, config] => source::run(&Config::load(config)?, name),
        ["controller", name, first, robots, rate_hz, config] => controller::run(
            &Config::load(config)?,
            name,
            first.parse()?,
            robots.parse()?,
            rate_hz.parse()?,
        ),
        ["planner", config] => reader::plan(&Config::load(config)?),
        ["consumer", config] => consumer::run(&Config::load(config)?),
        ["recorder", config] => reader::record(&Config::load(config)?),
        ["asker", "flood", config] => asker::flood(&Config::load(config)?, false),
        ["asker", "heavy", config] => asker::flood(&Config::load(config)?, true),
        ["asker", "crowd", config] => asker::crowd(&Config::load(config)?),
        ["asker", "calm", count, config] => asker::calm(&Config::load(config)?, count.parse()?),
        ["asker", "far", count, config] => asker::far(&Config::load(config)?, count.parse()?),
        ["asker", "late", config] => asker::late(&Config::load(config)?),
        ["asker", "bits", count, config] => asker::bits(&Config::load(config)?, count.parse()?),
        ["asker", "hostile", config] => asker::hostile(&Config::load(config)?),
        _ => Err(format!("unknown arguments: {arguments:?}").into()),
    }
}

/// Writes a line. A closed stdout ends the program.
fn print_line(line: &impl Serialize) -> Done {
    let mut text = serde_json::to_string(line)?;
    text.push('\n');
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}

/// Set at the end of stdin: the test has finished or is gone.
fn stop_with_stdin() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    std::thread::spawn(move || {
        for line in std::io::stdin().lines() {
            if line.is_err() {
                break;
            }
        }
        asked.store(true, Ordering::Relaxed);
    });
    stop
}
