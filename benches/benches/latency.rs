//! From sample due to forecast readable, beside two raw iceoryx2 hops of the same frames and the bare
//! kernel, all in one run. The measurement is `joulebus_benches::latency`.
//!
//! `cargo bench -p joulebus-benches --bench latency -- --seconds 20 --json bench-results/latency.json`
#![forbid(unsafe_code)]

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Parser;
use joulebus_benches::Machine;
use joulebus_benches::latency::{self, Launcher, Options, Report, Role};
use joulebus_predictor::{Model, Network};
use serde::Serialize;

/// Latency through the broker.
#[derive(Debug, Parser)]
struct Arguments {
    /// Robots, several sizes.
    #[arg(long, value_delimiter = ',', default_value = "1,20,100,1000,10000")]
    robots: Vec<usize>,
    /// Seconds for each size.
    #[arg(long, default_value_t = 10)]
    seconds: u64,
    /// Frames a second.
    #[arg(long, default_value_t = 30)]
    rate_hz: u64,
    /// Where to write the figures as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
    #[command(subcommand)]
    role: Option<Role>,
}

#[derive(Debug, Serialize)]
struct Measured<'a> {
    machine: &'a Machine,
    #[serde(flatten)]
    report: &'a Report,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    if let Some(role) = &arguments.role {
        return latency::play(role);
    }
    let machine = Machine::here(kernel()?);
    let report = latency::run(&Options {
        robots: arguments.robots,
        seconds: arguments.seconds,
        rate_hz: arguments.rate_hz,
        launcher: Launcher::this(&[])?,
    })?;
    println!("{machine:#?}\n{report}");
    if let Some(path) = &arguments.json {
        write(
            path,
            &Measured {
                machine: &machine,
                report: &report,
            },
        )?;
    }
    Ok(())
}

/// The kernel that the built-in model is dispatched to.
fn kernel() -> anyhow::Result<String> {
    let (_, bytes) = joulebus_config::builtin_model("gternal-sim").context("no built-in model")?;
    Ok(match Model::Network(Network::from_safetensors(bytes)?) {
        Model::Network(network) => format!("{:?}", network.kernel()),
        Model::Persistence(_) => "none".to_owned(),
    })
}

fn write(path: &Path, measured: &Measured<'_>) -> anyhow::Result<()> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let mut file = std::fs::File::create(path).with_context(|| path.display().to_string())?;
    serde_json::to_writer_pretty(&mut file, measured)?;
    writeln!(file)?;
    println!("\nwritten to {}", path.display());
    Ok(())
}
