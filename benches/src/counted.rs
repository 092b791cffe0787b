//! Work whose instructions callgrind counts (`tools/instructions.py`): figures that are valid on a
//! busy machine.

use std::hint::black_box;

use clap::ValueEnum;
use joulebus_predictor::Network;

use crate::callgrind::collected;
use crate::{input, kernel, rollout, tick};

/// The work to count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Counted {
    /// One call of the kernel.
    Kernel,
    /// Ingest of one tick's samples.
    Take,
    /// One tick's forecasts.
    Forecast,
    /// One tick's scores, ledgers, diagnostics and budgets.
    Account,
    /// The same, with outlooks.
    Outlooks,
    /// One call with candidates of 50 steps for one robot.
    Rollout,
}

/// Arguments of a count.
#[derive(Debug, Clone, clap::Parser)]
pub(crate) struct Count {
    /// The work to count.
    #[arg(value_enum)]
    what: Counted,
    /// Robots, or candidates of a rollout.
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    size: u32,
    /// The kernel, by name [default: the fastest supported].
    #[arg(long)]
    kernel: Option<String>,
}

impl Count {
    /// Runs the work once, after a warm-up. Returns the kernel's name and the number of forecasts.
    ///
    /// # Errors
    /// The kernel is not supported here.
    pub(crate) fn run(&self) -> anyhow::Result<(String, usize)> {
        let (_, network) = input::network(None)?;
        let kernel = kernel::fastest(self.kernel.as_deref())?;
        let network = kernel::on(&network, kernel)?;
        let size = self.size as usize;
        let forecasts = match self.what {
            Counted::Kernel => of_kernel(&network, size),
            Counted::Take => tick::count(&network, size, (tick::Part::Take, false))?,
            Counted::Forecast => tick::count(&network, size, (tick::Part::Forecast, false))?,
            Counted::Account => tick::count(&network, size, (tick::Part::Account, false))?,
            Counted::Outlooks => tick::count(&network, size, (tick::Part::Account, true))?,
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
