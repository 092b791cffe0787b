//! The kernel alone: ns per robot by batch size, and its share of the processor's peak.

use std::hint::black_box;
use std::time::Instant;

use crate::arguments::BenchOptions;
use anyhow::{Context as _, bail};
use joulebus_predictor::{Features, INPUTS, Kernel, Model, Network, Tiling};

use crate::figure::robots;
use crate::peak::Isa;
use crate::rounds::{Measurement, calls, interleave};
use crate::{Distribution, Figure, Report, input, threads};

/// Batches measured by default.
pub(crate) const BATCHES: [usize; 7] = [1, 7, 20, 100, 1_000, 10_000, 100_000];
/// Minimum batch size that is also measured on several threads.
const WORTH_SHARING: usize = 1_000;
/// Maximum batch size of a kernel without vector instructions, which would take seconds per call.
const MAX_SLOW: usize = 1_000;

/// Measures each kernel on each batch, interleaved with the peak.
///
/// # Errors
/// The model cannot be read, or a requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (model, network) = input::network(options.model.as_deref())?;
    let kernels = kernels(options.kernel.as_deref())?;
    let batches = options.sizes(&BATCHES);
    let mut report = Report::new("kernel")
        .with_input("model", model)
        .with_input("seed", options.seed)
        .with_input("repetitions", options.repetitions())
        .with_input("dispatched", name(network.kernel()));
    let mut cases = Vec::new();
    for kernel in &kernels {
        let network = on(&network, *kernel)?;
        for (layout, batch) in layouts(*kernel, &batches) {
            cases.push(Case::new(&network, layout, batch, options.seed));
        }
    }
    let sum = input::multiply_adds(&network);
    alone(&mut report, &mut cases, sum, options);
    if options.threads > 1 {
        for batch in batches.iter().filter(|batch| **batch >= WORTH_SHARING) {
            let kernel = *kernels.last().context("no kernel")?;
            shared(&mut report, &on(&network, kernel)?, *batch, options);
        }
    }
    report.notes = vec![
        format!(
            "A robot takes {sum} multiply-adds. Shares are of the peak measured in the same round."
        ),
        "Hot: the same rows in every repetition. A kernel without vector instructions computes fused \
         multiply-adds in software. Past 1,000 robots it is left out."
            .to_owned(),
    ];
    Ok(report)
}

/// A kernel by name, or all that this processor supports, slowest first.
pub(crate) fn kernels(name_wanted: Option<&str>) -> anyhow::Result<Vec<Kernel>> {
    let available = Kernel::ALL.into_iter().filter(|kernel| kernel.is_available());
    let available: Vec<Kernel> = available.collect();
    let Some(wanted) = name_wanted else {
        return Ok(available);
    };
    let found = available.iter().find(|kernel| name(**kernel) == wanted);
    match found {
        Some(kernel) => Ok(vec![*kernel]),
        None => {
            let names: Vec<String> = available.iter().map(|kernel| name(*kernel)).collect();
            bail!("no kernel {wanted:?} here, there are {}", names.join(", "))
        }
    }
}

pub(crate) fn name(kernel: Kernel) -> String {
    format!("{kernel:?}").to_lowercase()
}

/// A kernel by name, or the fastest that this processor supports.
pub(crate) fn fastest(name_wanted: Option<&str>) -> anyhow::Result<Kernel> {
    let kernels = kernels(name_wanted)?;
    kernels.last().copied().context("no kernel")
}

/// The network on a kernel.
pub(crate) fn on(network: &Network, kernel: Kernel) -> anyhow::Result<Network> {
    let on = network.clone().with_kernel(kernel);
    on.with_context(|| format!("this processor cannot run the kernel {}", name(kernel)))
}

/// The instruction set whose peak is the reference of a kernel. `None` for the scalar one.
fn isa(kernel: Kernel) -> Option<Isa> {
    match name(kernel).as_str() {
        "avx512" => Some(Isa::Avx512),
        "avx2" => Some(Isa::Avx2),
        "neon" => Some(Isa::Neon),
        _ => None,
    }
}

/// Input layout and tiling of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// One row per robot.
    Rows,
    /// One column per feature, as in the tick.
    Columns,
    /// Rows, batch-major: needs the transposition that columns avoid.
    RowsBatchMajor,
}

/// Layouts and batches to measure.
fn layouts(kernel: Kernel, batches: &[usize]) -> Vec<(Layout, usize)> {
    let slow = isa(kernel).is_none() && kernel != Kernel::best();
    let worth = |layout: Layout, batch: usize| match layout {
        Layout::Rows => !slow || batch <= MAX_SLOW,
        Layout::Columns | Layout::RowsBatchMajor => !slow,
    };
    [Layout::Rows, Layout::Columns, Layout::RowsBatchMajor]
        .into_iter()
        .flat_map(|layout| batches.iter().map(move |batch| (layout, *batch)))
        .filter(|(layout, batch)| worth(*layout, *batch))
        .collect()
}

/// One kernel on one batch.
struct Case {
    model: Model,
    kernel: Kernel,
    layout: Layout,
    rows: Vec<Features>,
    columns: Vec<Vec<f32>>,
    forecasts_w: Vec<f32>,
    calls: usize,
}

impl Case {
    fn new(network: &Network, layout: Layout, batch: usize, seed: u64) -> Self {
        let rows = input::rows(network, seed, batch);
        let column = |feature| rows.iter().map(|row| row[feature]).collect();
        let columns = (0..INPUTS).map(column).collect();
        let kernel = network.kernel();
        let network = network.clone();
        let tiled = match layout {
            Layout::RowsBatchMajor => network.with_tiling(Tiling::BatchMajor),
            Layout::Rows | Layout::Columns => network,
        };
        let mut case = Self {
            model: Model::Network(tiled),
            kernel,
            layout,
            rows,
            columns,
            forecasts_w: vec![0.0; batch],
            calls: 1,
        };
        case.calls = calls(|| case.call());
        case
    }

    fn batch(&self) -> usize {
        self.forecasts_w.len()
    }

    fn name(&self) -> String {
        let kernel = name(self.kernel);
        match self.layout {
            Layout::Rows => kernel,
            Layout::Columns => format!("{kernel}_columns"),
            Layout::RowsBatchMajor => format!("{kernel}_rows_batch_major"),
        }
    }

    fn call(&mut self) {
        let forecasts_w = black_box(&mut self.forecasts_w);
        if self.layout == Layout::Columns {
            let columns = std::array::from_fn(|feature| self.columns[feature].as_slice());
            let predicted = self.model.predict_columns(black_box(columns), forecasts_w);
            predicted.expect("columns of the batch's length");
        } else {
            self.model.predict(black_box(&self.rows), forecasts_w);
        }
    }

    /// One repetition: ns per robot.
    fn run(&mut self) -> f64 {
        let start = Instant::now();
        for _ in 0..self.calls {
            self.call();
        }
        start.elapsed().as_nanos() as f64 / (self.calls * self.batch()) as f64
    }
}

fn alone(report: &mut Report, cases: &mut [Case], sum: usize, options: &BenchOptions) {
    let sum = sum as f64;
    let mut isas: Vec<Isa> = Vec::new();
    for isa in cases.iter().filter_map(|case| isa(case.kernel)) {
        if !isas.contains(&isa) {
            isas.push(isa);
        }
    }
    let about: Vec<(String, String, Option<Isa>)> =
        cases.iter().map(|case| (case.name(), robots(case.batch()), isa(case.kernel))).collect();
    let mut measurements: Vec<Measurement<'_>> = isas
        .iter()
        .map(|isa| Measurement::new(|| isa.peak_gmac_per_s().unwrap_or(f64::NAN)))
        .chain(cases.iter_mut().map(|case| Measurement::new(|| case.run())))
        .collect();
    interleave(&mut measurements, options.repetitions(), options.each());
    let (peaks, measurements) = measurements.split_at(isas.len());
    let mut shares = Vec::new();
    for (isa, measurement) in isas.iter().zip(peaks) {
        let title = format!("{isa:?}_peak_gmac_per_s").to_lowercase();
        report.push(Figure::more, &title, "1 thread", "GMAC/s", measurement.values());
    }
    for ((kernel, case, isa), measurement) in about.iter().zip(measurements) {
        let title = format!("{kernel}_ns_per_robot");
        report.push(Figure::less, &title, case, "ns", measurement.values());
        let place = isas.iter().position(|other| Some(*other) == *isa);
        let peak = place.and_then(|place| Distribution::new(peaks[place].values()));
        let Some(peak) = peak else { continue };
        let of_peak = |ns: &f64| sum / ns / peak.p50;
        let values: Vec<f64> = measurement.values().iter().map(of_peak).collect();
        shares.push((format!("{kernel}_share_of_peak"), case, values));
    }
    for (title, case, values) in shares {
        report.push(Figure::more, &title, case, "1", &values);
    }
}

/// One pinned thread and several on the same batch, interleaved.
fn shared(report: &mut Report, network: &Network, batch: usize, options: &BenchOptions) {
    let new = |batch| Case::new(network, Layout::Rows, batch, options.seed);
    let each = batch.div_ceil(options.threads);
    let part = |place: usize| ((place + 1) * each).min(batch) - (place * each).min(batch);
    let mut parts: Vec<Case> = (0..options.threads).map(|place| new(part(place))).collect();
    let pinned = threads::compare(&mut [new(batch)], &mut parts, Case::call, options);
    let (kernel, case) = (name(network.kernel()), robots(batch));
    for (threads, all_us) in [(1, &pinned.one_us), (options.threads, &pinned.several_us)] {
        let per_robot: Vec<f64> = all_us.iter().map(|us| us * 1e3 / batch as f64).collect();
        let title = format!("{kernel}_pinned_{threads}_ns_per_robot");
        report.push(Figure::less, &title, &case, "ns", &per_robot);
    }
    let title = format!("{kernel}_pinned_{}_over_1_speed_up", options.threads);
    report.push(Figure::more, &title, &case, "1", &pinned.speed_up);
}
