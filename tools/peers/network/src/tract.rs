//! tract: the ONNX file, optimised for each batch.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use tract_onnx::prelude::*;

use crate::{Call, Forecaster};

pub(crate) struct Tract {
    onnx: PathBuf,
}

impl Tract {
    pub(crate) fn load(onnx: &Path) -> Self {
        Self { onnx: onnx.to_owned() }
    }

    fn plan(&self, batch: usize) -> anyhow::Result<Arc<TypedRunnableModel>> {
        let fact = InferenceFact::dt_shape(f32::datum_type(), tvec!(batch, 11));
        tract_onnx::onnx()
            .model_for_path(&self.onnx)?
            .with_input_fact(0, fact)?
            .into_optimized()?
            .into_runnable()
            .context("tract cannot run the network")
    }
}

fn tensor(rows: &[[f32; 11]]) -> anyhow::Result<Tensor> {
    let shaped = tract_ndarray::Array2::from_shape_vec((rows.len(), 11), rows.concat())?;
    Ok(shaped.into())
}

impl Forecaster for Tract {
    fn forecast(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Vec<f32>> {
        let output = self.plan(rows.len())?.run(tvec!(tensor(rows)?.into()))?;
        let forecasts_w = output[0].to_plain_array_view::<f32>()?;
        Ok(forecasts_w.iter().copied().collect())
    }

    fn call(&mut self, rows: &[[f32; 11]]) -> anyhow::Result<Call> {
        let mut state = self.plan(rows.len())?.spawn()?;
        let input: TValue = tensor(rows)?.into_tvalue();
        Ok(Box::new(move || {
            let output = state.run(tvec!(input.clone()));
            std::hint::black_box(output.expect("it ran before"));
        }))
    }
}
