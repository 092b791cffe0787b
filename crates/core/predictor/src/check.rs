//! Checks of a network's parameters and card.

use crate::card::{ModelCard, Scores, TrainedBlocks, TrainingRange};
use crate::error::ModelError;
use crate::features::{FEATURE_NAMES, FeatureSet};
use crate::file;
use crate::kernel::fold;
use crate::linear::Linear;
use crate::parameters::{Normalisation, Parameters, layer_sizes};

pub(crate) fn check_parameters(parameters: &Parameters) -> Result<(), ModelError> {
    let sizes = layer_sizes(parameters.feature_set);
    for (number, (layer, (inputs, outputs))) in parameters.layers.iter().zip(sizes).enumerate() {
        check_values(&file::weight_name(number), &layer.weights, inputs * outputs)?;
        check_values(&file::bias_name(number), &layer.bias, outputs)?;
    }
    let Normalisation { feature_mean, feature_std, power_mean_w, power_std_w } =
        parameters.normalisation;
    for i in parameters.feature_set.range() {
        if !feature_mean[i].is_finite() {
            let field = format!("feature_mean of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(field, &feature_mean[i], "finite numbers"));
        }
        let std_fine =
            feature_std[i] == 0.0 || (feature_std[i] > 0.0 && feature_std[i].recip().is_finite());
        if !(std_fine && feature_std[i].is_finite()) {
            let field = format!("feature_std of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(field, &feature_std[i], "0, or 1e-38 to 3e38"));
        }
    }
    if !power_mean_w.is_finite() {
        return Err(ModelError::field("power_mean_w", &power_mean_w, "finite numbers"));
    }
    let power_std_fine = power_std_w > 0.0 && power_std_w.is_finite();
    if !power_std_fine {
        return Err(ModelError::field("power_std_w", &power_std_w, "finite and > 0"));
    }
    check_folded(parameters)
}

/// The folded parameters, used by the kernels, must be finite too.
fn check_folded(parameters: &Parameters) -> Result<(), ModelError> {
    let names = ["first", "second", "third", "last"];
    for (name, layer) in names.into_iter().zip(fold(parameters)) {
        let mut values = layer.weights.iter().chain(&layer.bias);
        if let Some(value) = values.find(|value| !value.is_finite()) {
            let field = format!("scale folded into the {name} layer");
            return Err(ModelError::field(field, value, "finite numbers"));
        }
    }
    Ok(())
}

fn check_values(tensor: &str, values: &[f32], expected: usize) -> Result<(), ModelError> {
    if values.len() != expected {
        return Err(ModelError::Shape {
            tensor: tensor.to_owned(),
            found: format!("{} values", values.len()),
            allowed: format!("{expected} values"),
        });
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => {
            Err(ModelError::NotFinite { tensor: tensor.to_owned(), index, value: values[index] })
        }
        None => Ok(()),
    }
}

fn check_linear(linear: Option<&Linear>, feature_set: FeatureSet) -> Result<(), ModelError> {
    let Some(linear) = linear else {
        return Ok(());
    };
    let allowed = Linear::feature_set_beside(feature_set);
    if ![allowed, FeatureSet::PowerOnly].contains(&linear.feature_set) {
        return Err(ModelError::field(
            "feature set of linear_weights",
            linear.feature_set.name(),
            allowed.name(),
        ));
    }
    linear.check()
}

pub(crate) fn check_card(card: &ModelCard, feature_set: FeatureSet) -> Result<(), ModelError> {
    card.residual.check()?;
    if let Some(energy) = &card.energy {
        energy.check()?;
    }
    let TrainingRange { feature_set: range_set, min, max, .. } = card.training_range;
    if range_set != feature_set {
        let allowed = feature_set.name();
        return Err(ModelError::field("feature set of training_range", range_set.name(), allowed));
    }
    for i in feature_set.range() {
        let ordered = min[i].is_finite() && max[i].is_finite() && min[i] <= max[i];
        if !ordered {
            let field = format!("training range of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(
                field,
                &format!("{} to {}", min[i], max[i]),
                "ascending",
            ));
        }
    }
    check_linear(card.linear.as_ref(), feature_set)?;
    let blocks = card.trained_rows.iter().flat_map(|trained| &trained.blocks);
    for TrainedBlocks { rows, hashes } in blocks {
        if *rows == 0 || !hashes.is_sorted() {
            let found = format!("{} hashes of {rows} rows", hashes.len());
            let allowed = "hashes in ascending order of 1 row or more";
            return Err(ModelError::field("trained_blocks", &found, allowed));
        }
    }
    let Scores { network_r2, network_mae_w, persistence_r2, persistence_mae_w, .. } = card.scores;
    for (field, value) in [
        ("score_network_r2", network_r2),
        ("score_network_mae_w", network_mae_w),
        ("score_persistence_r2", persistence_r2),
        ("score_persistence_mae_w", persistence_mae_w),
    ] {
        if !value.is_finite() {
            return Err(ModelError::field(field, &value, "finite numbers"));
        }
    }
    Ok(())
}
