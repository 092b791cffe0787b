//! Model import: converts weights of another program to a model for the worker. The parser executes
//! no code in the file. `cargo run -p joulebus-examples --example model_import`

use anyhow::Context;
use joulebus_model_files::{Checkpoint, Origin, to_arrays};
use joulebus_predictor::Network;
use joulebus_sim::protocol;

fn main() -> anyhow::Result<()> {
    let checkpoint = Checkpoint::from_arrays(&arrays_of_another_program()?)?;
    // The network is found by the shapes of its arrays, the normalisation by its names.
    let found = checkpoint.find(None, None)?;
    for layer in &found.layers {
        println!("found {}", layer.weight_path);
    }

    // Files do not state how features were computed: the convention that forecasts recordings best
    // is chosen.
    let recordings = [protocol::trial(1, 7)?, protocol::trial(5, 7)?];
    let origin = Origin { name: "imported", file: "arrays", sha256: "" };
    let choice = found.choose(&recordings, None, &origin)?;
    println!("convention {}: R² {:.3}", choice.convention, choice.ranking[0].r2);

    let model_file = choice.network().to_safetensors()?;
    println!("a model file of {} bytes", model_file.len());
    Ok(())
}

/// Each array's name, and its `.npy` file.
type Arrays = Vec<(String, Vec<u8>)>;

/// Weights and statistics as plain NumPy arrays, as another program may have saved them.
fn arrays_of_another_program() -> anyhow::Result<Arrays> {
    let (_, bytes) = joulebus_config::builtin_model("gternal-sim").context("no such model")?;
    let mut arrays = to_arrays(&Network::from_safetensors(bytes)?)?;
    // Without the arrays of our own format, it is a foreign file.
    arrays.retain(|(name, _)| {
        name.starts_with("layers.")
            || name.ends_with("mean")
            || name.ends_with("std")
            || name.ends_with("_w")
    });
    Ok(arrays)
}
