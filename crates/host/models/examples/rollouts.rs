//! Rollouts: the energy of command sequences. A model is fed with its own forecasts for two
//! seconds.

use anyhow::Context;
use joulebus_predictor::{LAGS, Model, Network, ReadingAge, RolloutStart, Rollouts};

fn main() -> anyhow::Result<()> {
    let (name, bytes) = joulebus_config::builtin_model("gternal-sim").context("no such model")?;
    let model = Model::Network(Network::from_safetensors(bytes)?);

    // One robot that drives at 0.1 m/s, and three candidates for it: slower, faster, on the spot.
    let start = RolloutStart {
        command: Some((0.1, 0.0)),
        lag_w: [3.7; LAGS],
        reading_age: ReadingAge::UNKNOWN,
    };
    // A network does not extrapolate: started outside its training range, a rollout may diverge.
    // Feature 6 is the newest reading.
    if let Some(range) = model.training_range() {
        println!("{name} was trained on {:.2} to {:.2} W", range.min[6], range.max[6]);
    }
    let candidates = [(0.05, 0.0), (0.15, 0.0), (0.0, 3.0)];
    let steps = 60;
    // Commands are stored step by step: those of all candidates at step 0, then of all at step 1.
    let v_mps = candidates.map(|(v_mps, _)| v_mps).repeat(steps);
    let omega_radps = candidates.map(|(_, omega_radps)| omega_radps).repeat(steps);
    let rollouts = Rollouts {
        starts: &[start],
        candidates: candidates.len(),
        steps,
        step_s: 1.0 / 30.0,
        v_mps: &v_mps,
        omega_radps: &omega_radps,
    };
    let mut energy_j = [0.0; 3];
    model.rollout(&rollouts, 0..rollouts.lanes(), &mut energy_j, None)?;
    for ((v_mps, omega_radps), energy_j) in candidates.iter().zip(energy_j) {
        println!("{v_mps:.2} m/s, {omega_radps:.1} rad/s: {energy_j:.2} J in 2 s");
    }
    Ok(())
}
