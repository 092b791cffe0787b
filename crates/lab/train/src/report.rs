//! Report of a training run.

use std::fmt;
use std::path::Path;
use std::time::Duration;

use joulebus_dataset::split::SplitSummary;
use serde::Serialize;

use super::energy::FEWEST_RECORDINGS;
use super::{Findings, Trained};

/// Report of a training run. `Display` is text.
#[derive(Debug, Clone, Serialize)]
pub struct TrainReport {
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    model: String,
    /// Hash of the model's contents.
    model_hash: String,
    source: String,
    training_data: String,
    seed: u64,
    epochs: usize,
    /// Epoch of the model.
    best_epoch: Option<u32>,
    duration_s: f64,
    findings: Findings,
    #[serde(skip_serializing_if = "Option::is_none")]
    split: Option<SplitSummary>,
    scores: HeldOut,
    /// Commands for the model.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub next: Vec<String>,
}

/// Scores on rows that were used for no decision.
#[derive(Debug, Clone, Serialize)]
struct HeldOut {
    rows: u64,
    mae_w: f32,
    r2: f32,
    persistence_mae_w: f32,
    persistence_r2: f32,
}

impl TrainReport {
    /// The report of a training that took this long. `path` is the model file, if it was written.
    pub fn new(
        path: Option<&Path>,
        trained: &Trained,
        duration: Duration,
        split: Option<SplitSummary>,
    ) -> Self {
        let network = &trained.network;
        let card = network.card();
        let best = trained.epochs.iter().rev().find(|epoch| epoch.best);
        Self {
            file: path.map(|path| path.display().to_string()),
            model: card.name.clone(),
            model_hash: format!("{:016x}", network.hash()),
            source: card.source.clone(),
            training_data: card.training_data.clone(),
            seed: card.seed,
            epochs: trained.epochs.len(),
            best_epoch: best.map(|epoch| epoch.number),
            duration_s: duration.as_secs_f64(),
            findings: trained.findings.clone(),
            split,
            scores: HeldOut {
                rows: card.scores.rows,
                mae_w: card.scores.network_mae_w,
                r2: card.scores.network_r2,
                persistence_mae_w: card.scores.persistence_mae_w,
                persistence_r2: card.scores.persistence_r2,
            },
            next: Vec::new(),
        }
    }
}

impl fmt::Display for TrainReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            file, model, model_hash, source, training_data, epochs, duration_s, scores, ..
        } = self;
        if let Some(file) = file {
            write!(out, "{file}: ")?;
        }
        writeln!(out, "{model}, from {source}, hash {model_hash}")?;
        writeln!(out, "{training_data}")?;
        if let Some(split) = &self.split {
            write_split(out, split)?;
        }
        write_findings(out, &self.findings)?;
        let best = self.best_epoch.unwrap_or(0);
        writeln!(out, "{epochs} epochs in {duration_s:.1} s, the best was {best}")?;
        writeln!(
            out,
            "held out, {} rows: MAE {:.4} W, R² {:.4}; persistence: MAE {:.4} W, R² {:.4}",
            scores.rows, scores.mae_w, scores.r2, scores.persistence_mae_w, scores.persistence_r2
        )?;
        if !self.next.is_empty() {
            writeln!(out, "next:")?;
        }
        for command in &self.next {
            writeln!(out, "  {command}")?;
        }
        Ok(())
    }
}

fn write_split(out: &mut fmt::Formatter<'_>, split: &SplitSummary) -> fmt::Result {
    writeln!(out, "split {}", split.name)?;
    let parts = [&split.training, &split.validation, &split.held_out];
    let names = ["training", "validation", "held out"];
    for ((name, units), rows) in names.iter().zip(parts).zip(split.rows) {
        match units.as_slice() {
            [] => writeln!(out, "  {name}: {rows} rows")?,
            [one] => writeln!(out, "  {name}: {rows} rows of {one}")?,
            [first, .., last] => {
                let count = units.len();
                writeln!(out, "  {name}: {rows} rows of {count}, {first} to {last}")?;
            }
        }
    }
    if split.pause_rows > 0 {
        writeln!(out, "  in no part, next to the cuts: {} rows", split.pause_rows)?;
    }
    Ok(())
}

fn write_findings(out: &mut fmt::Formatter<'_>, findings: &Findings) -> fmt::Result {
    let [training, validation, held_out] = findings.unusable_rows;
    if training + validation + held_out > 0 {
        writeln!(
            out,
            "omitted for a missing or infinite number: {training} rows of training, {validation} \
             of validation, {held_out} of those held out"
        )?;
    }
    let known = findings.held_out_trained_on;
    if known > 0 {
        writeln!(
            out,
            "{known} held-out rows were also trained on, as in copies of recordings, also scaled, \
             reversed or thinned ones: not scored"
        )?;
    }
    let untold = findings.held_out_untold;
    if untold > 0 {
        writeln!(
            out,
            "{untold} held-out rows cannot be told from training rows: their pieces are too short, \
             or change too rarely"
        )?;
    }
    let known = findings.validation_trained_on;
    if known > 0 {
        writeln!(
            out,
            "{known} validation rows were also trained on, as in copies of recordings: training \
             may have stopped too late"
        )?;
    }
    if !findings.constant_features.is_empty() {
        let names = findings.constant_features.join(", ");
        writeln!(out, "constant in training, so nothing is learned from it: {names}")?;
    }
    if findings.few_rows {
        let rows = findings.training_rows;
        writeln!(out, "only {rows} training rows: the model may be overfitted")?;
    }
    if findings.few_recordings {
        let recordings = findings.recordings;
        writeln!(
            out,
            "only {recordings} of at least {FEWEST_RECORDINGS} recordings: the intervals of plans are wide, because \
             parts of one recording do not show how much another day differs. Record more"
        )?;
    }
    Ok(())
}
