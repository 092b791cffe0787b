//! joulebus.

use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::{Context as _, ensure};
use joulebus_predictor::{FEATURES, FeatureSet, Features, Network};

use crate::{Call, Forecaster};

pub(crate) struct Ours {
    network: Network,
    threads: usize,
}

impl Ours {
    pub(crate) fn load(model: &Path, threads: usize) -> anyhow::Result<Self> {
        let bytes = fs::read(model).with_context(|| model.display().to_string())?;
        let network = Network::from_safetensors(&bytes)?;
        ensure!(network.feature_set() == FeatureSet::Full, "a network of all features");
        Ok(Self { network, threads })
    }
}

impl Forecaster for Ours {
    fn forecast(&mut self, rows: &[[f32; FEATURES]]) -> anyhow::Result<Vec<f32>> {
        let mut part = Part::new(&self.network, rows);
        part.call();
        Ok(part.forecasts_w)
    }

    fn call(&mut self, rows: &[[f32; FEATURES]]) -> anyhow::Result<Call> {
        let mut parts = rows.chunks(rows.len().div_ceil(self.threads));
        let mut own = Part::new(&self.network, parts.next().unwrap_or_default());
        let pool: Vec<Hand> =
            parts.map(|rows| Hand::hire(Part::new(&self.network, rows))).collect();
        Ok(Box::new(move || {
            pool.iter().for_each(Hand::begin);
            own.call();
            pool.iter().for_each(Hand::end);
        }))
    }
}

struct Part {
    network: Network,
    rows: Vec<Features>,
    forecasts_w: Vec<f32>,
}

impl Part {
    fn new(network: &Network, rows: &[[f32; FEATURES]]) -> Self {
        // Features that the network does not read are NaN.
        let wide = |row: &[f32; FEATURES]| -> Features {
            std::array::from_fn(|feature| row.get(feature).copied().unwrap_or(f32::NAN))
        };
        Self {
            network: network.clone(),
            forecasts_w: vec![0.0; rows.len()],
            rows: rows.iter().map(wide).collect(),
        }
    }

    fn call(&mut self) {
        self.network.predict(black_box(&self.rows), black_box(&mut self.forecasts_w));
    }
}

/// A spinning thread that waits for its next work, and ends with its owner.
struct Hand {
    asked: Arc<AtomicUsize>,
    done: Arc<AtomicUsize>,
}

impl Hand {
    fn hire(mut part: Part) -> Self {
        let (asked, done) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let hand = Self { asked: Arc::clone(&asked), done: Arc::clone(&done) };
        thread::spawn(move || {
            for turn in 1.. {
                while asked.load(Ordering::Acquire) < turn {
                    std::hint::spin_loop();
                }
                if asked.load(Ordering::Acquire) == usize::MAX {
                    return;
                }
                part.call();
                done.store(turn, Ordering::Release);
            }
        });
        hand
    }

    fn begin(&self) {
        self.asked.fetch_add(1, Ordering::AcqRel);
    }

    fn end(&self) {
        let asked = self.asked.load(Ordering::Acquire);
        while self.done.load(Ordering::Acquire) < asked {
            std::hint::spin_loop();
        }
    }
}

impl Drop for Hand {
    fn drop(&mut self) {
        self.asked.store(usize::MAX, Ordering::Release);
    }
}
