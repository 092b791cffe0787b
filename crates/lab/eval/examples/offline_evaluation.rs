//! Offline evaluation: recorded trials through the live tick, with the same bits.
//!
//! Arguments: recordings as .npy, CSV or CSV.gz. By default two simulated trials.

use std::path::Path;

use joulebus_config::Config;
use joulebus_dataset::trial::Trial;
use joulebus_eval::evaluate::evaluate;
use joulebus_models::load_models;

const CONFIG: &str = r#"
[fleet]
name = "offline"
[[platform]]
file = "builtin:gternal"
robots = ["0-99"]
"#;

fn main() -> anyhow::Result<()> {
    let mut trials = std::env::args().skip(1).map(Trial::read).collect::<Result<Vec<_>, _>>()?;
    if trials.is_empty() {
        trials = vec![joulebus_sim::protocol::trial(1, 7)?, joulebus_sim::protocol::trial(5, 7)?];
    }
    // A robot's id determines its platform, and so its model.
    let trials: Vec<(u32, Trial)> = (0..).zip(trials).collect();
    let config = Config::parse(CONFIG, Path::new("."))?;
    let models = load_models(&config)?;
    let evaluation = evaluate(config.settings(), &models, &trials)?;
    for robot in &evaluation.robots {
        println!(
            "{}: {} readings, R² {:.3}, MAE {:.3} W (persistence {:.3} W), coverage {:.2}",
            robot.path.display(),
            robot.scores.count,
            robot.scores.r2(),
            robot.scores.mae_w(),
            robot.scores.persistence_mae_w(),
            robot.coverage,
        );
    }
    Ok(())
}
