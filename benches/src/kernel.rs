//! The kernel alone: ns a robot by batch, and its share of what the processor can do.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context as _, bail};
use joulebus_predictor::{Kernel, Network};

use crate::figure::robots;
use crate::options::Options;
use crate::peak::Isa;
use crate::rounds::{Turn, calls, take_turns};
use crate::{Distribution, Figure, Report, input, threads};

/// Batches measured by default.
pub(crate) const BATCHES: [usize; 7] = [1, 7, 20, 100, 1_000, 10_000, 100_000];
/// Batches below it are not worth a second thread.
const WORTH_SHARING: usize = 1_000;
/// Robots past which a kernel without vector instructions takes seconds a call.
const MOST_BASELINE: usize = 1_000;

/// Measures each kernel on each batch, and the peak, in turns.
///
/// # Errors
/// The model cannot be read, or a kernel that was asked for does not exist here.
pub(crate) fn measure(options: &Options) -> anyhow::Result<Report> {
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
        for batch in &batches {
            if *kernel == Kernel::Baseline && Kernel::best() != *kernel && *batch > MOST_BASELINE {
                continue;
            }
            cases.push(Case::new(&network, *kernel, *batch, options.seed));
        }
    }
    alone(&mut report, &mut cases, options);
    if options.threads > 1 {
        for batch in batches.iter().filter(|batch| **batch >= WORTH_SHARING) {
            let kernel = *kernels.last().context("no kernel")?;
            shared(&mut report, &on(&network, kernel)?, *batch, options);
        }
    }
    let sum = input::multiply_adds(&network);
    report.notes = vec![
        format!(
            "A robot takes {sum} multiply-adds; shares are of the peak measured in the same round."
        ),
        "Hot: the same rows again and again. `baseline` computes fused multiply-adds in software \
         where the target's baseline has none; past 1,000 robots it is left out."
            .to_owned(),
    ];
    Ok(report)
}

/// A kernel by name, or all that this processor has, slowest first.
pub(crate) fn kernels(name_wanted: Option<&str>) -> anyhow::Result<Vec<Kernel>> {
    let available = Kernel::ALL
        .into_iter()
        .filter(|kernel| kernel.is_available());
    let available: Vec<Kernel> = available.collect();
    let Some(wanted) = name_wanted else {
        return Ok(available);
    };
    let found = available.iter().find(|kernel| name(**kernel) == wanted);
    match found {
        Some(kernel) => Ok(vec![*kernel]),
        None => {
            let names: Vec<String> = available.iter().map(|kernel| name(*kernel)).collect();
            bail!("no kernel {wanted:?} here; there are {}", names.join(", "))
        }
    }
}

pub(crate) fn name(kernel: Kernel) -> String {
    format!("{kernel:?}").to_lowercase()
}

/// The network on a kernel.
pub(crate) fn on(network: &Network, kernel: Kernel) -> anyhow::Result<Network> {
    let on = network.clone().with_kernel(kernel);
    on.with_context(|| format!("this processor cannot run the kernel {}", name(kernel)))
}

fn isa(kernel: Kernel) -> Option<Isa> {
    match kernel {
        Kernel::Avx512 => Some(Isa::Avx512),
        Kernel::Avx2 => Some(Isa::Avx2),
        Kernel::Baseline if cfg!(target_arch = "aarch64") => Some(Isa::Neon),
        Kernel::Baseline => None,
    }
}

/// One kernel on one batch.
struct Case {
    network: Network,
    kernel: Kernel,
    batch: usize,
    rows: Vec<joulebus_predictor::Features>,
    forecasts_w: Vec<f32>,
    calls: usize,
}

impl Case {
    fn new(network: &Network, kernel: Kernel, batch: usize, seed: u64) -> Self {
        let mut case = Self {
            rows: input::rows(network, seed, batch),
            forecasts_w: vec![0.0; batch],
            network: network.clone(),
            kernel,
            batch,
            calls: 1,
        };
        case.calls = calls(|| case.call());
        case
    }

    fn call(&mut self) {
        self.network
            .predict(black_box(&self.rows), black_box(&mut self.forecasts_w));
    }

    /// One repetition: ns a robot.
    fn run(&mut self) -> f64 {
        let start = Instant::now();
        for _ in 0..self.calls {
            self.call();
        }
        start.elapsed().as_nanos() as f64 / (self.calls * self.batch) as f64
    }
}

fn alone(report: &mut Report, cases: &mut [Case], options: &Options) {
    let sum = cases
        .first()
        .map_or(0, |case| input::multiply_adds(&case.network)) as f64;
    let mut isas: Vec<Isa> = Vec::new();
    for isa in cases.iter().filter_map(|case| isa(case.kernel)) {
        if !isas.contains(&isa) {
            isas.push(isa);
        }
    }
    let about: Vec<(String, String, Option<Isa>)> = cases
        .iter()
        .map(|case| (name(case.kernel), robots(case.batch), isa(case.kernel)))
        .collect();
    let mut turns: Vec<Turn<'_>> = isas
        .iter()
        .map(|isa| Turn::new(|| isa.peak_gmac_per_s().unwrap_or(f64::NAN)))
        .chain(cases.iter_mut().map(|case| Turn::new(|| case.run())))
        .collect();
    take_turns(&mut turns, options.repetitions(), options.each());
    let (peaks, turns) = turns.split_at(isas.len());
    let mut shares = Vec::new();
    for (isa, turn) in isas.iter().zip(peaks) {
        let title = format!("{isa:?}_peak_gmac_per_s").to_lowercase();
        report.push(Figure::more, &title, "1 thread", "GMAC/s", turn.values());
    }
    for ((kernel, case, isa), turn) in about.iter().zip(turns) {
        let title = format!("{kernel}_ns_per_robot");
        report.push(Figure::less, &title, case, "ns", turn.values());
        let place = isas.iter().position(|other| Some(*other) == *isa);
        let peak = place.and_then(|place| Distribution::of(peaks[place].values()));
        let Some(peak) = peak else { continue };
        let of_peak = |ns: &f64| sum / ns / peak.p50;
        let values: Vec<f64> = turn.values().iter().map(of_peak).collect();
        shares.push((format!("{kernel}_share_of_peak"), case, values));
    }
    for (title, case, values) in shares {
        report.push(Figure::more, &title, case, "1", &values);
    }
}

/// One thread and several pinned ones on the same batch, in turns.
fn shared(report: &mut Report, network: &Network, batch: usize, options: &Options) {
    let threads = options.threads;
    let part = batch.div_ceil(threads);
    let mut parts: Vec<Case> = (0..threads)
        .map(|place| {
            let len = part.min(batch - (place * part).min(batch));
            Case::new(network, network.kernel(), len.max(1), options.seed)
        })
        .collect();
    let mut whole = Case::new(network, network.kernel(), batch, options.seed);
    let (mut one, mut several, mut speed_up) = (Vec::new(), Vec::new(), Vec::new());
    let blocks = options.repetitions().clamp(1, 20);
    let each = options.each().as_nanos() as f64 / blocks as f64;
    let repetitions = (each / (whole.run() * batch as f64)).clamp(1.0, 100.0) as usize;
    for _ in 0..blocks {
        let alone_ns = threads::side_by_side(&mut [Box::new(|| whole.call())], repetitions);
        let works = parts.iter_mut();
        let mut works: Vec<Box<dyn FnMut() + Send + '_>> = works
            .map(|case| Box::new(|| case.call()) as Box<dyn FnMut() + Send + '_>)
            .collect();
        let shared_ns = threads::side_by_side(&mut works, repetitions);
        let per_robot = |ns: &f64| ns / batch as f64;
        one.extend(alone_ns.iter().map(per_robot));
        several.extend(shared_ns.iter().map(per_robot));
        let median = |values: &[f64]| Distribution::of(values).map_or(f64::NAN, |all| all.p50);
        speed_up.push(median(&alone_ns) / median(&shared_ns));
    }
    let (kernel, case) = (name(network.kernel()), robots(batch));
    let pinned = |count| format!("{kernel}_{count}_pinned_ns_per_robot");
    report.push(Figure::less, &pinned(1), &case, "ns", &one);
    report.push(Figure::less, &pinned(threads), &case, "ns", &several);
    let title = format!("{kernel}_{threads}_over_1_pinned_speed_up");
    report.push(Figure::more, &title, &case, "1", &speed_up);
}
