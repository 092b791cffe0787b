//! From sample due to forecast readable, between real processes, beside two raw iceoryx2 hops of
//! the same frames paced the same way, and the bare kernel, all in one run.
//!
//! `cargo bench -p joulebus-benches --bench latency -- --seconds 20 --json bench-results/latency.json`

mod kernel;
mod raw;
mod through;

use std::io::Write;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use anyhow::{Context, bail};
use clap::{Parser, Subcommand};
use joulebus_benches::{Machine, Spread, line};
use joulebus_predictor::{Model, Network};
use serde::Serialize;

/// Latency through the broker.
#[derive(Debug, Parser)]
struct Arguments {
    /// Robots, several sizes.
    #[arg(long, value_delimiter = ',', default_value = "1,20,100,1000,10000")]
    robots: Vec<usize>,
    /// Seconds for each size and each of the three measurements.
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

/// The processes of one measurement; the benchmark starts itself in these roles.
#[derive(Debug, Clone, Subcommand)]
enum Role {
    /// The predictor-worker.
    #[command(hide = true)]
    Worker { config: PathBuf },
    /// A planner that measures.
    #[command(hide = true)]
    Planner { config: PathBuf, frames: u64 },
    /// Takes frames and sends forecasts of the same size on, computing nothing.
    #[command(hide = true)]
    Relay { root: PathBuf, robots: usize },
    /// Takes what the relay sends, and measures.
    #[command(hide = true)]
    Sink {
        root: PathBuf,
        robots: usize,
        frames: u64,
    },
}

/// Figures of one fleet size.
#[derive(Debug, Serialize)]
struct Row {
    robots: usize,
    /// From the frame's intended time to the forecast readable.
    end_to_end_us: Spread,
    /// From the frame's sending to the forecast readable: the broker's share.
    sent_to_readable_us: Spread,
    /// From the frame's intended time to its sending: the source's own share.
    source_us: Spread,
    /// From the frame's sending to the worker's taking.
    one_way_us: Spread,
    /// From the tick's start to the last forecast written.
    compute_us: Spread,
    /// The whole tick, diagnostics and budgets included.
    tick_us: Spread,
    /// Two raw iceoryx2 hops of frames of the same sizes.
    raw_two_hops_us: Spread,
    /// The kernel alone after the same sleep.
    kernel_us: Spread,
    /// Median end to end over (median of two hops + median of the kernel).
    ratio_p50: f64,
    /// The same of the 99th percentiles.
    ratio_p99: f64,
    /// Memory of the worker that is its own.
    worker_bytes: u64,
    missed: u64,
}

#[derive(Debug, Serialize)]
struct Report {
    machine: Machine,
    input: String,
    rows: Vec<Row>,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    match &arguments.role {
        None => measure(&arguments),
        Some(Role::Worker { config }) => through::worker(config),
        Some(Role::Planner { config, frames }) => through::planner(config, *frames),
        Some(Role::Relay { root, robots }) => raw::relay(root, *robots),
        Some(Role::Sink {
            root,
            robots,
            frames,
        }) => raw::sink(root, *robots, *frames),
    }
}

fn measure(arguments: &Arguments) -> anyhow::Result<()> {
    let model = model()?;
    let machine = Machine::here(match &model {
        Model::Network(network) => format!("{:?}", network.kernel()),
        Model::Persistence(_) => "none".to_owned(),
    });
    let input = format!(
        "{} frames a second for {} s a size, built-in GTernal model, policy on_frame",
        arguments.rate_hz, arguments.seconds
    );
    println!("{machine:#?}\n{input}; µs: p50, p99, p99.9, max");
    let frames = arguments.rate_hz * arguments.seconds;
    let mut rows = Vec::new();
    for robots in &arguments.robots {
        let row = row(&model, *robots, arguments.rate_hz, frames)?;
        print(&row);
        rows.push(row);
    }
    if let Some(path) = &arguments.json {
        write(
            path,
            &Report {
                machine,
                input,
                rows,
            },
        )?;
    }
    Ok(())
}

fn row(model: &Model, robots: usize, rate_hz: u64, frames: u64) -> anyhow::Result<Row> {
    let through = through::measure(robots, rate_hz, frames)?;
    let raw = raw::measure(robots, rate_hz, frames)?;
    let kernel = kernel::measure(model, robots, rate_hz, frames.min(5 * rate_hz));
    Ok(Row {
        robots,
        ratio_p50: through.end_to_end_us.p50_us / (raw.p50_us + kernel.p50_us),
        ratio_p99: through.end_to_end_us.p99_us / (raw.p99_us + kernel.p99_us),
        end_to_end_us: through.end_to_end_us,
        sent_to_readable_us: through.sent_to_readable_us,
        source_us: through.source_us,
        one_way_us: through.one_way_us,
        compute_us: through.compute_us,
        tick_us: through.tick_us,
        raw_two_hops_us: raw,
        kernel_us: kernel,
        worker_bytes: through.worker_bytes,
        missed: through.missed,
    })
}

fn print(row: &Row) {
    println!("\n{} robots ({} frames missed)", row.robots, row.missed);
    for (name, spread) in [
        ("sample due → forecast readable", &row.end_to_end_us),
        ("  the source wakes and writes", &row.source_us),
        (
            "  sample sent → forecast readable",
            &row.sent_to_readable_us,
        ),
        ("    sample sent → taken by the worker", &row.one_way_us),
        ("    compute", &row.compute_us),
        ("whole tick", &row.tick_us),
        ("two raw hops of the same frames", &row.raw_two_hops_us),
        ("bare kernel after the same sleep", &row.kernel_us),
    ] {
        println!("{name:<36}{}", line(spread));
    }
    println!(
        "end to end / (raw + kernel): p50 {:.2}, p99 {:.2}",
        row.ratio_p50, row.ratio_p99
    );
    let each = row.worker_bytes as f64 / row.robots as f64;
    println!(
        "memory of the worker's own: {} kB, {each:.0} bytes a robot",
        row.worker_bytes / 1024
    );
}

fn write(path: &PathBuf, report: &Report) -> anyhow::Result<()> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let mut file = std::fs::File::create(path).with_context(|| path.display().to_string())?;
    serde_json::to_writer_pretty(&mut file, report)?;
    writeln!(file)?;
    println!("\nwritten to {}", path.display());
    Ok(())
}

fn model() -> anyhow::Result<Model> {
    let (_, bytes) = joulebus_config::builtin_model("gternal-sim").context("no built-in model")?;
    Ok(Model::Network(Network::from_safetensors(bytes)?))
}

/// Starts this program in another role; its output is a line of JSON.
fn start(role: &[String]) -> anyhow::Result<Child> {
    let child = Command::new(std::env::current_exe()?)
        .args(role)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    Ok(child)
}

/// Waits for a child's line of JSON.
fn finish<T: serde::de::DeserializeOwned>(child: Child) -> anyhow::Result<T> {
    let output = child.wait_with_output()?;
    if !output.status.success() {
        bail!("a process of the measurement ended with {}", output.status);
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}
