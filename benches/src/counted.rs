//! Work for callgrind to count instruction by instruction (`tools/instructions.py`): figures that hold
//! on a busy machine.

use std::hint::black_box;

use anyhow::Context as _;
use clap::ValueEnum;
use joulebus_predictor::Network;

use crate::callgrind::collected;
use crate::{input, kernel, rollout, tick};

/// What is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Counted {
    /// One call of the kernel.
    Kernel,
    /// Samples of one tick taken.
    Take,
    /// One tick's forecasts.
    Forecast,
    /// One tick's accounts, diagnostics and budgets.
    Account,
    /// One call with candidates of 50 steps of one robot.
    Rollout,
}

/// One piece of work.
#[derive(Debug, Clone, clap::Parser)]
pub(crate) struct Count {
    /// What is counted.
    #[arg(value_enum)]
    what: Counted,
    /// Robots, or candidates of a rollout.
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    size: u32,
    /// The kernel, by name [default: the fastest here].
    #[arg(long)]
    kernel: Option<String>,
}

impl Count {
    /// Does the work once, after it has been warmed up; returns the kernel's name and how many
    /// forecasts that made.
    ///
    /// # Errors
    /// No such kernel here.
    pub(crate) fn run(&self) -> anyhow::Result<(String, usize)> {
        let (_, network) = input::network(None)?;
        let kernel = *kernel::kernels(self.kernel.as_deref())?
            .last()
            .context("no kernel")?;
        let network = kernel::on(&network, kernel)?;
        let size = self.size as usize;
        let forecasts = match self.what {
            Counted::Kernel => of_kernel(&network, size),
            Counted::Take => tick::count(&network, size, tick::Part::Take)?,
            Counted::Forecast => tick::count(&network, size, tick::Part::Forecast)?,
            Counted::Account => tick::count(&network, size, tick::Part::Account)?,
            Counted::Rollout => rollout::count(&network, size),
        };
        Ok((kernel::name(kernel), forecasts))
    }
}

fn of_kernel(network: &Network, robots: usize) -> usize {
    let rows = input::rows(network, 7, robots);
    let mut forecasts_w = vec![0.0; robots];
    let mut call = || network.predict(black_box(&rows), black_box(&mut forecasts_w));
    call();
    collected(&mut call);
    robots
}
