//! The options of `joulebus mission`.

/// Simulate missions under several charging policies, to see what energy forecasts are worth
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus mission                                   100 seeds, an hour each, some minutes on \
    two cores\n  \
    joulebus mission --seeds 8 --hours 0.25            a quick look\n  \
    joulebus mission --battery-wh 0.25                 larger batteries\n  \
    joulebus mission --tune --seeds 4 --hours 0.25     what the policies' settings were chosen from\n\n\
    Twenty simulated robots with small batteries and varied parts do tasks, which arrive at \
    random. Three chargers take one robot each. Every policy gets the same tasks, robots, \
    dispatcher and account of its batteries, and faces the same seeds. Settings were chosen on \
    seeds from 1001 on (--tune). Intervals are at 95 %, by bootstrap over seeds, paired where \
    policies are compared. Same seed, same bits. docs/measured/mission.md has results.")]
pub(crate) struct Args {
    /// Number of missions of each policy
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub(super) seeds: u64,
    /// Simulated time of a mission, h (0.01 to 24)
    #[arg(long, value_name = "H", default_value_t = 1.0, value_parser = hours)]
    pub(super) hours: f64,
    /// Capacity of a battery, Wh (0.05 to 10)
    #[arg(long, value_name = "WH", default_value_t = 0.15, value_parser = battery)]
    pub(super) battery_wh: f64,
    /// Try many settings of each policy on other seeds, instead of comparing the chosen ones
    #[arg(long)]
    pub(super) tune: bool,
    /// Also a policy that knows the true energies: what perfect forecasts would be worth
    #[arg(long)]
    pub(super) oracle: bool,
}

fn within(text: &str, lo: f64, hi: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if lo <= number && number <= hi { Ok(number) } else { Err(format!("allowed is {lo} to {hi}")) }
}

fn hours(text: &str) -> Result<f64, String> {
    within(text, 0.01, 24.0)
}

fn battery(text: &str) -> Result<f64, String> {
    within(text, 0.05, 10.0)
}
