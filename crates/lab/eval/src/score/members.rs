//! The forecasts that are scored, and the members that they combine.

use joulebus_predictor::{FeatureSet, Features, Linear, Model, Network};

use super::{Contents, Subject};
use crate::evaluate::Forecast;

/// Rows that a network forecasts at a time.
const BATCH_ROWS: usize = 4_096;

/// A member of an online forecast, beside persistence (the last reading).
#[derive(Clone, Copy)]
pub(super) enum Member<'a> {
    /// The network alone.
    Network(&'a Network),
    /// The autoregression of its file.
    Autoregression(&'a Linear),
}

impl<'a> Member<'a> {
    /// The members of each model that learns online, with its index.
    pub(super) fn of(subject: Subject<'a>) -> Vec<(usize, Self)> {
        let mut members = Vec::new();
        for (at, model) in subject.models.iter().enumerate() {
            let (Model::Network(network), Forecast::Online) = (model, subject.forecast(model))
            else {
                continue;
            };
            members.push((at, Self::Network(network)));
            let powers = |linear: &&Linear| linear.feature_set == FeatureSet::PowerOnly;
            let linear = model.linear().filter(powers);
            members.extend(linear.map(|linear| (at, Self::Autoregression(linear))));
        }
        members
    }

    pub(super) const fn name(&self) -> &'static str {
        match self {
            Self::Network(_) => "network",
            Self::Autoregression(_) => "autoregression",
        }
    }

    /// Its forecast of each row, W. NaN if a feature is missing.
    pub(super) fn forecasts_w(&self, contents: &Contents) -> Vec<f32> {
        let rows = &contents.rows.rows;
        match self {
            Self::Network(network) => {
                let mut forecasts_w = vec![0.0; rows.len()];
                let mut inputs: Vec<Features> = Vec::with_capacity(BATCH_ROWS);
                let batches = rows.chunks(BATCH_ROWS);
                for (rows, forecasts_w) in batches.zip(forecasts_w.chunks_mut(BATCH_ROWS)) {
                    inputs.clear();
                    inputs.extend(rows.iter().map(|row| row.features));
                    network.predict(&inputs, forecasts_w);
                }
                forecasts_w
            }
            Self::Autoregression(linear) => {
                let each = rows.iter().map(|row| linear.predict(&row.features));
                each.collect()
            }
        }
    }
}

impl Subject<'_> {
    /// The origin of the forecast that is scored.
    pub(super) fn forecast(&self, model: &Model) -> Forecast {
        // A platform taken from a recording learns online.
        let online = self.platform.is_none_or(|platform| platform.online);
        Forecast::new(model, online)
    }
}
