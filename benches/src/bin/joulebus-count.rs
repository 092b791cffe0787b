//! Work for callgrind: see `tools/instructions.py`. Prints the kernel and how many forecasts were made.
#![forbid(unsafe_code)]

use clap::Parser as _;
use joulebus_benches::Count;

fn main() -> anyhow::Result<()> {
    let (kernel, forecasts) = Count::parse().run()?;
    println!("{kernel} {forecasts}");
    Ok(())
}
