//! A forecaster in a separate process, driven by `tools/peers/network.py` over stdin:
//! `check PATH` writes the forecasts of all rows as little-endian f32; `time BATCH SECONDS` prints
//! the ns that each of many calls took, as a JSON array.
#![forbid(unsafe_code)]

mod input;
mod nalgebra;
mod ours;

use std::fs;
use std::hint::black_box;
use std::io::{BufRead as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::{Parser, ValueEnum};

/// Runs one forecaster on rows of features.
#[derive(Debug, Parser)]
struct Arguments {
    #[arg(value_enum)]
    peer: Peer,
    /// The model file.
    #[arg(long)]
    model: PathBuf,
    /// Weights and biases of each layer, the normalisation folded into the first and last.
    #[arg(long)]
    layers: PathBuf,
    /// Rows of features, little-endian f32.
    #[arg(long)]
    rows: PathBuf,
    /// Threads; more than one only for joulebus.
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Peer {
    Joulebus,
    Nalgebra,
}

/// One call on a batch of fixed rows.
type Call = Box<dyn FnMut()>;

/// A forecaster: forecasts in watt, and a call to be timed on the first rows.
trait Forecaster {
    fn forecast(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Vec<f32>>;
    fn call(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Call>;
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    if arguments.threads > 1 && !matches!(arguments.peer, Peer::Joulebus) {
        bail!("only joulebus is measured on several threads here");
    }
    let rows = input::rows(&arguments.rows)?;
    let mut forecaster: Box<dyn Forecaster> = match arguments.peer {
        Peer::Joulebus => Box::new(ours::Ours::load(&arguments.model, arguments.threads)?),
        Peer::Nalgebra => Box::new(nalgebra::Nalgebra::load(&input::layers(&arguments.layers)?)),
    };
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["check", path] => {
                let forecasts_w = forecaster.forecast(&rows)?;
                let bytes = forecasts_w.iter().flat_map(|power_w| power_w.to_le_bytes());
                write(Path::new(path), &bytes.collect::<Vec<u8>>())?;
                println!("done");
            }
            ["time", batch, seconds] => {
                let batch: usize = batch.parse()?;
                let batch = rows.get(..batch).context("more rows than there are")?;
                let times_ns = time(&mut forecaster.call(batch)?, seconds.parse()?);
                println!("{}", serde_json::to_string(&times_ns)?);
            }
            _ => bail!("not understood: {line}"),
        }
        std::io::stdout().flush()?;
    }
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

/// ns of each repetition divided by its calls: as many calls as make it 100 µs long.
fn time(call: &mut Call, seconds: f64) -> Vec<f64> {
    let mut calls = 1;
    loop {
        let start = Instant::now();
        (0..calls).for_each(|_| call());
        if start.elapsed() >= Duration::from_micros(100) {
            break;
        }
        calls *= 2;
    }
    let (begin, mut times_ns) = (Instant::now(), Vec::new());
    while times_ns.len() < 3 || begin.elapsed().as_secs_f64() < seconds {
        let start = Instant::now();
        (0..calls).for_each(|_| black_box(&mut *call)());
        times_ns.push(start.elapsed().as_nanos() as f64 / f64::from(calls));
    }
    times_ns
}
