//! Makes the models that ship:
//! `cargo run --release -p joulebus-lab --example train_gternal_sim -- configs/models`.

use joulebus_lab::train::train_sim;
use joulebus_predictor::FeatureSet;
use std::error::Error;
use std::path::PathBuf;

const SEED: u64 = 7;

fn main() -> Result<(), Box<dyn Error>> {
    let folder: PathBuf = std::env::args_os()
        .nth(1)
        .unwrap_or("configs/models".into())
        .into();
    for feature_set in [FeatureSet::Full, FeatureSet::PowerOnly] {
        let trained = train_sim(SEED, feature_set, |epoch| {
            println!(
                "epoch {:3}: training {:.5}, validation {:.5}{}",
                epoch.number,
                epoch.training_loss,
                epoch.validation_loss,
                if epoch.best { " *" } else { "" }
            );
        })?;
        let card = trained.network.card();
        let path = folder.join(format!("{}.safetensors", card.name));
        std::fs::write(&path, trained.network.to_safetensors()?)?;
        println!("{}: {:?}, {:?}", path.display(), card.scores, card.residual);
    }
    Ok(())
}
