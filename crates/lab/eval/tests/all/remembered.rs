//! What each number is worth that a platform remembers of its robots: figures on recordings of
//! floors that the model has not seen.

use joulebus_dataset::rows::{Dataset, Row, RowOrigin, trial_rows};
use joulebus_dataset::trial::Trial;
use joulebus_energy::{
    Calibration, Commands, EnergyModel, EnergySample, EnergyState, Memory, PlatformErrors,
};
use joulebus_predictor::FeatureSet;
use joulebus_testkit::recordings;
use joulebus_train::energy_model;
use joulebus_wire::sample_flag;
use rayon::prelude::*;

/// Robots that run one after the other, each for this time, s.
const ROBOTS: u32 = 32;
const TRACE_S: f32 = 1800.0;
/// Robots of a small fleet: the first ones.
const SMALL: u32 = 8;
/// Horizons of plans, s.
const PLANS_S: [f32; 2] = [1.0, 10.0];

/// The samples of a recording.
fn steps(trial: &Trial) -> Vec<EnergySample> {
    let longest_s = 1.5e-9 * trial.period_ns() as f32;
    let (samples, mut before_ns) = (trial.to_samples(0, 1_000_000_000), None::<u64>);
    let step = |sample: &joulebus_wire::Sample| {
        let elapsed_s = before_ns.map_or(f32::NAN, |ns| (sample.stamp_ns - ns) as f32 * 1e-9);
        before_ns = Some(sample.stamp_ns);
        let known = sample.has(sample_flag::V | sample_flag::OMEGA);
        EnergySample {
            power_w: if sample.has(sample_flag::POWER) { sample.power_w } else { f32::NAN },
            elapsed_s: if elapsed_s <= longest_s { elapsed_s } else { f32::NAN },
            v_mps: if known { sample.v_mps } else { f32::NAN },
            omega_radps: if known { sample.omega_radps } else { f32::NAN },
        }
    };
    samples.iter().map(step).collect()
}

/// Recordings in random order, as one robot's half hour each.
fn traces(runs: &[Vec<EnergySample>], factor: f32) -> Vec<Vec<EnergySample>> {
    let mut state = 1u64;
    let mut next = |below: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    (0..ROBOTS)
        .map(|_| {
            let (mut trace, mut time_s) = (Vec::new(), 0.0);
            while time_s < TRACE_S {
                let run = &runs[next(runs.len())];
                time_s += run.iter().map(|step| step.elapsed_s.max(0.0)).sum::<f32>();
                trace.extend(
                    run.iter().map(|step| EnergySample { power_w: factor * step.power_w, ..*step }),
                );
            }
            trace
        })
        .collect()
}

fn mean_w(trace: &[EnergySample]) -> f64 {
    let known = trace.iter().filter(|step| step.elapsed_s > 0.0 && step.power_w.is_finite());
    let (energy_j, time_s) = known.fold((0.0, 0.0), |(energy_j, time_s), step| {
        let elapsed_s = f64::from(step.elapsed_s);
        (energy_j + elapsed_s * f64::from(step.power_w), time_s + elapsed_s)
    });
    energy_j / time_s
}

#[derive(Default)]
struct Scores {
    /// Relative errors of the lasting power in the first minute, of the first robots and the others,
    /// and after ten minutes.
    errors: [Vec<f64>; 3],
    /// Of the first minute: means inside the bounds, and all.
    inside: [f64; 2],
    /// Of plans at each horizon: absolute errors, energies, interval scores, inside, number.
    plans: [[f64; 5]; PLANS_S.len()],
}

fn play(model: &EnergyModel, traces: &[Vec<EnergySample>], ablate: fn(&mut Memory)) -> Scores {
    let lasting = model.lasting().unwrap();
    let (mut calibration, mut scores) = (Calibration::new(model), Scores::default());
    for (robot, trace) in (0u32..).zip(traces) {
        let true_w = mean_w(trace);
        let platform = |calibration: &Calibration| {
            let mut platform: PlatformErrors = *calibration.platform();
            ablate(&mut platform.memory);
            platform
        };
        let mut state = EnergyState::among(robot, &platform(&calibration));
        let (mut time_s, mut due_s) = (0.0, 1.0);
        for (row, step) in trace.iter().enumerate() {
            let errors = state.observe_among(model, &platform(&calibration), step);
            calibration.add(&errors.counted(robot));
            let platform = platform(&calibration);
            state.bounds = platform.plans;
            time_s += step.elapsed_s.max(0.0);
            if time_s < due_s {
                continue;
            }
            due_s = time_s + if time_s < 60.0 { 1.0 } else { 10.0 };
            let metered = (state.metered.energy_j[3], state.metered.time_s[3]);
            let power = lasting.of(metered, &platform);
            let error = (f64::from(power.mean_w) / true_w - 1.0).abs();
            if time_s < 60.0 {
                scores.errors[usize::from(robot >= SMALL)].push(error);
                let [lo_w, hi_w] = power.range_w(TRACE_S).map(f64::from);
                scores.inside[0] += f64::from(u8::from((lo_w..=hi_w).contains(&true_w)));
                scores.inside[1] += 1.0;
            } else if time_s > 600.0 {
                scores.errors[2].push(error);
            }
            for (sums, horizon_s) in scores.plans.iter_mut().zip(PLANS_S) {
                let mut ahead_s = 0.0;
                let ahead = trace[row + 1..].iter().take_while(|step| {
                    let more =
                        ahead_s < horizon_s && step.elapsed_s > 0.0 && step.power_w.is_finite();
                    ahead_s += step.elapsed_s;
                    more
                });
                let count = ahead.count();
                let next = &trace[row + 1..row + 1 + count];
                let duration_s: f32 = next.iter().map(|step| step.elapsed_s).sum();
                if duration_s < 0.95 * horizon_s {
                    continue;
                }
                let commands = &trace[row..row + count];
                let (v_mps, omega_radps): (Vec<f32>, Vec<f32>) =
                    commands.iter().map(|step| (step.v_mps, step.omega_radps)).unzip();
                let period_s = duration_s / count as f32;
                let plan = Commands { period_s, v_mps: &v_mps, omega_radps: &omega_radps };
                let forecast = model.forecast(&state, plan);
                let measured_j: f64 =
                    next.iter().map(|step| f64::from(step.power_w * step.elapsed_s)).sum();
                sums[0] += (f64::from(forecast.energy_j) - measured_j).abs();
                sums[1] += measured_j.abs();
                let ends = forecast.quantile_j(0.05).zip(forecast.quantile_j(0.95));
                if let Some((lo_j, hi_j)) = ends.map(|(lo, hi)| (f64::from(lo), f64::from(hi))) {
                    let missed_j = (lo_j - measured_j).max(measured_j - hi_j).max(0.0);
                    sums[2] += hi_j - lo_j + 20.0 * missed_j;
                    sums[3] += f64::from(u8::from(missed_j == 0.0));
                    sums[4] += 1.0;
                }
            }
        }
    }
    scores
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn fitted(trials: &[&Trial], feature_set: FeatureSet) -> EnergyModel {
    let part = |last: bool| -> Vec<Row> {
        let each = trials.iter().enumerate().filter(|(place, _)| (place % 7 == 6) == last);
        each.flat_map(|(place, trial)| {
            let origin = RowOrigin::recording(place);
            trial_rows(trial).rows.into_iter().map(move |row| row.of(origin))
        })
        .collect()
    };
    let dataset = Dataset {
        training: part(false),
        held_out: Vec::new(),
        validation: part(true),
        description: "recordings".to_owned(),
        period_s: trials[0].period_ns() as f32 * 1e-9,
    };
    energy_model(&dataset, feature_set).unwrap()
}

/// The groups of recordings that are left out in turn: the beginnings of their names.
pub(crate) const SETS: [(&str, FeatureSet, &[&str]); 3] = [
    (
        "robotino",
        FeatureSet::Full,
        &[
            "one_surface_type_brown",
            "one_surface_type_gray",
            "one_surface_type_green",
            "one_surface_type_table",
            "wheel_load",
        ],
    ),
    ("borealtc_husky", FeatureSet::Full, &["ASPHALT", "FLOORING", "ICE", "MIXED", "SANDY", "SNOW"]),
    ("ase_rover", FeatureSet::PowerOnly, &["baseline", "final"]),
];

type Change = fn(&mut Memory);

const NUMBERS: [(&str, Change); 4] = [
    ("all", |_| ()),
    ("without the mean", |memory| memory.power = 1.0),
    ("without the trust", |memory| memory.command_trust = 1.0),
    ("none", |memory| *memory = Memory::TRAINED),
];

#[test]
#[ignore = "prints figures for minutes: CONTRIBUTING.md has the command"]
fn figures() {
    println!(
        "| recordings | memory | first minute: robots 1 to 8 · others · inside | later | plans 1 s · 10 s | scores | inside |"
    );
    for (folder, feature_set, words) in SETS {
        let Some(paths) = recordings::trials(folder) else { return };
        let named = |word: &str| -> Vec<usize> {
            let is = |path: &std::path::Path| {
                path.file_name().unwrap().to_string_lossy().starts_with(word)
            };
            (0..paths.len()).filter(|place| is(&paths[*place])).collect()
        };
        let trials: Vec<Trial> = paths.par_iter().map(|path| Trial::read(path).unwrap()).collect();
        let mut cases: Vec<(String, Vec<usize>, f32)> =
            words.iter().map(|word| ((*word).to_owned(), named(word), 1.0)).collect();
        let half: Vec<usize> = (0..trials.len()).filter(|place| place % 2 == 0).collect();
        cases.push((format!("{folder}, halves"), half.clone(), 1.0));
        cases.push((format!("{folder}, halves × 1.4"), half, 1.4));
        let lines: Vec<String> = cases
            .par_iter()
            .flat_map(|(name, out, factor)| {
                let (trials, out) = (&trials, &out);
                let others: Vec<&Trial> = (0..trials.len()).filter(|place| !out.contains(place)).map(|place| &trials[place]).collect();
                let model = fitted(&others, feature_set);
                let runs: Vec<Vec<EnergySample>> = out.iter().map(|place| steps(&trials[*place])).collect();
                let traces = traces(&runs, *factor);
                let line = |(number, ablate): &(&str, Change)| {
                    let mut scores = play(&model, &traces, *ablate);
                    let [first, others, later] = scores.errors.each_mut().map(|errors| median(errors));
                    let plans = scores.plans.map(|sums| sums[0] / sums[1]);
                    let interval = scores.plans.map(|sums| sums[2] / sums[1]);
                    let inside = scores.plans.map(|sums| sums[3] / sums[4]);
                    format!(
                        "| {name} | {number} | {first:.3} · {others:.3} · {:.2} | {later:.3} | {:.4} · {:.4} | {:.3} · {:.3} | {:.3} · {:.3} |",
                        scores.inside[0] / scores.inside[1], plans[0], plans[1], interval[0], interval[1], inside[0], inside[1]
                    )
                };
                NUMBERS.iter().map(line).collect::<Vec<_>>()
            })
            .collect();
        println!("{}", lines.join("\n"));
    }
}
