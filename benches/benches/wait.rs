//! How late a wait ends, by the way its deadline is given: `joulebus_benches::wait`.
//!
//! `cargo bench -p joulebus-benches --bench wait -- --waits 1000 --length-ms 33`
#![forbid(unsafe_code)]

use clap::Parser;
use joulebus_benches::wait::{self, Options};
use joulebus_bus::Scheduling;

/// How late a wait for a deadline ends.
#[derive(Debug, Parser)]
struct Arguments {
    /// Waits of each way.
    #[arg(long, default_value_t = 300)]
    waits: u64,
    /// Length of a wait.
    #[arg(long, default_value_t = 33.0)]
    length_ms: f64,
    /// SimdLevel to stay on.
    #[arg(long)]
    cpu: Option<usize>,
    /// Real-time priority; 0: none.
    #[arg(long, default_value_t = 0)]
    priority: u8,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let report = wait::run(&Options {
        waits: arguments.waits,
        length_ns: (arguments.length_ms * 1e6) as u64,
        scheduling: Scheduling {
            cpus: arguments.cpu.into_iter().collect(),
            priority: arguments.priority,
            required: true,
            ..Scheduling::default()
        },
    })?;
    print!("{report}");
    Ok(())
}
