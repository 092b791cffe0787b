//! The kernel alone: ns per robot by batch size, and its share of the processor's peak.

use std::hint::black_box;
use std::time::Instant;

use crate::arguments::BenchOptions;
use anyhow::{Context as _, bail};
use joulebus_predictor::{Features, INPUTS, Kernel, Model, Network};

use crate::peak::Isa;
use crate::report::{quantile, robots};
use crate::rounds::{Run, calls, interleave};
use crate::{Report, input};

/// Rounds of the benchmarks that interleave measurements.
pub(crate) const ROUNDS: usize = 1_000;
/// Batches measured by default.
const BATCHES: [usize; 7] = [1, 7, 20, 100, 1_000, 10_000, 100_000];
/// Maximum batch size of a kernel without vector instructions, which would take seconds per call.
const MAX_SLOW: usize = 1_000;

/// Measures each kernel on each batch, interleaved with the peak.
///
/// # Errors
/// A requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let network = input::network()?;
    let mut report = Report::new("kernel")
        .with_input("model", format!("builtin:{}", input::MODEL))
        .with_input("seed", input::SEED)
        .with_input("rounds", options.rounds(ROUNDS))
        .with_input("dispatched", name(network.kernel()));
    let batches = options.sizes(&BATCHES);
    let mut cases = Vec::new();
    for kernel in kernels(options.kernel.as_deref())? {
        let network = on(&network, kernel)?;
        for (columns, batch) in layouts(kernel, &batches) {
            cases.push(Case::new(&network, columns, batch));
        }
    }
    let sum = input::multiply_adds(&network);
    alone(&mut report, &mut cases, sum, options);
    report.notes = vec![
        format!(
            "A robot takes {sum} multiply-adds. Shares are of the peak measured in the same rounds."
        ),
        "Hot: the same rows in every repetition. A kernel without vector instructions computes fused \
         multiply-adds in software. Past 1,000 robots it is left out."
            .to_owned(),
    ];
    Ok(report)
}

/// The network on the requested kernel or the fastest, and a report that states both.
pub(crate) fn chosen(benchmark: &str, options: &BenchOptions) -> anyhow::Result<(Network, Report)> {
    let kernel = kernels(options.kernel.as_deref())?.pop().context("no kernel")?;
    let report = Report::new(benchmark)
        .with_input("model", format!("builtin:{}", input::MODEL))
        .with_input("kernel", name(kernel))
        .with_input("seed", input::SEED)
        .with_input("rounds", options.rounds(ROUNDS));
    Ok((on(&input::network()?, kernel)?, report))
}

/// A kernel by name, or all that this processor supports, slowest first.
fn kernels(name_wanted: Option<&str>) -> anyhow::Result<Vec<Kernel>> {
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

fn name(kernel: Kernel) -> String {
    format!("{kernel:?}").to_lowercase()
}

/// The network on a kernel.
fn on(network: &Network, kernel: Kernel) -> anyhow::Result<Network> {
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

/// Whether the input is in columns, as in the tick, or in rows, and batches to measure.
fn layouts(kernel: Kernel, batches: &[usize]) -> Vec<(bool, usize)> {
    let slow = isa(kernel).is_none() && kernel != Kernel::best();
    let worth = |columns: bool, batch: usize| !slow || !columns && batch <= MAX_SLOW;
    let each = |columns| batches.iter().map(move |batch| (columns, *batch));
    let all = [false, true].into_iter().flat_map(each);
    all.filter(|(columns, batch)| worth(*columns, *batch)).collect()
}

/// One kernel on one batch.
struct Case {
    model: Model,
    kernel: Kernel,
    rows: Vec<Features>,
    /// One for each feature, if they are the input.
    columns: Option<Vec<Vec<f32>>>,
    forecasts_w: Vec<f32>,
    calls: usize,
}

impl Case {
    fn new(network: &Network, in_columns: bool, batch: usize) -> Self {
        let rows = input::rows(network, input::SEED, batch);
        let column = |feature| rows.iter().map(|row| row[feature]).collect();
        let columns = in_columns.then(|| (0..INPUTS).map(column).collect());
        let mut case = Self {
            model: Model::Network(network.clone()),
            kernel: network.kernel(),
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
        name(self.kernel) + if self.columns.is_some() { "_columns" } else { "" }
    }

    fn call(&mut self) {
        let forecasts_w = black_box(&mut self.forecasts_w);
        if let Some(columns) = &self.columns {
            let columns = std::array::from_fn(|feature| columns[feature].as_slice());
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
    let peak = |isa: &Isa| -> Run<'_> {
        let isa = *isa;
        Box::new(move || isa.peak_gmac_per_s().unwrap_or(f64::NAN))
    };
    let mut runs: Vec<Run<'_>> = isas.iter().map(peak).collect();
    runs.extend(cases.iter_mut().map(|case| Box::new(|| case.run()) as Run<'_>));
    let measured = interleave(runs, options.rounds(ROUNDS), options.each());
    let (peaks, measured) = measured.split_at(isas.len());
    for (isa, peaks) in isas.iter().zip(peaks) {
        let title = format!("{isa:?}_peak_gmac_per_s").to_lowercase();
        report.more(&title, "1 thread", "GMAC/s", peaks);
    }
    for ((kernel, case, _), all_ns) in about.iter().zip(measured) {
        report.less(&format!("{kernel}_ns_per_robot"), case, "ns", all_ns);
    }
    for ((kernel, case, isa), all_ns) in about.iter().zip(measured) {
        let Some(place) = isas.iter().position(|other| Some(*other) == *isa) else { continue };
        let peak = quantile(&peaks[place], 0.5);
        let of_peak: Vec<f64> = all_ns.iter().map(|ns| sum / ns / peak).collect();
        report.more(&format!("{kernel}_share_of_peak"), case, "1", &of_peak);
    }
}
