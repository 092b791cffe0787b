//! Every unsafe block on small inputs, for Miri (command: CONTRIBUTING.md): uninitialised
//! scratch, unaligned loads, tails of every length, parts of rollouts.

use joulebus_predictor::{
    FeatureSet, Features, INPUTS, Kernel, Model, Network, ReadingAge, RolloutStart, Rollouts,
    Tiling,
};
#[allow(dead_code)] // Each test file uses a part.
use joulebus_testkit_fleets::random::{Noise, network, row};

/// Batch sizes that reach each tile and each tail of each kernel: all up to the widest tile and its
/// tails, and longer ones. Under Miri only for the kernels of its target.
fn batches(kernel: Kernel) -> Vec<usize> {
    match kernel {
        Kernel::Scalar if cfg!(miri) => vec![5],
        _ if cfg!(miri) => vec![19],
        _ => (0..=70).chain([127, 128, 129, 1_000]).collect(),
    }
}

fn networks(seed: u64, set: FeatureSet) -> impl Iterator<Item = Network> {
    let all = Kernel::ALL.into_iter();
    all.filter_map(move |kernel| network(seed, set).with_kernel(kernel))
}

fn expected(network: &Network, rows: &[Features]) -> Vec<u32> {
    let bits = |row| network.predict_reference_f32(row).to_bits();
    rows.iter().map(bits).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn rows_of_every_length_and_alignment_give_the_reference_bits_and_write_nothing_else() {
    let mut noise = Noise(41);
    for network in FeatureSet::ALL.into_iter().flat_map(|set| networks(42, set)) {
        for count in batches(network.kernel()) {
            let rows: Vec<Features> = (0..count + 1).map(|_| row(&mut noise)).collect();
            let expected = expected(&network, &rows[1..]);
            for tiling in [Tiling::ByInput, Tiling::BatchMajor, Tiling::OutputMajor] {
                let mut out_w = vec![-1.0; count + 2];
                let network = network.clone().with_tiling(tiling);
                network.predict(&rows[1..], &mut out_w[1..=count]);
                assert_eq!(bits(&out_w[1..=count]), expected, "{tiling:?} {count}");
                assert_eq!((out_w[0], out_w[count + 1]), (-1.0, -1.0));
            }
        }
    }
}

#[test]
fn columns_of_every_length_and_alignment_give_the_reference_bits() {
    let mut noise = Noise(43);
    for set in FeatureSet::ALL {
        for network in networks(44, set) {
            for count in batches(network.kernel()) {
                let rows: Vec<Features> = (0..count).map(|_| row(&mut noise)).collect();
                // Column f starts f + 1 elements into its allocation, and ends with it.
                let columns: [Vec<f32>; INPUTS] = std::array::from_fn(|feature| {
                    let values = rows.iter().map(|row| row[feature]);
                    vec![-1.0; feature + 1].into_iter().chain(values).collect()
                });
                let columns = std::array::from_fn(|feature| match set.range().contains(&feature) {
                    true => &columns[feature][feature + 1..],
                    false => &[][..],
                });
                let expected = expected(&network, &rows);
                let mut out_w = vec![-1.0; count];
                let model = Model::Network(network.clone());
                model.predict_columns(columns, &mut out_w).unwrap();
                assert_eq!(bits(&out_w), expected, "{set:?} {count}");
            }
        }
    }
}

#[test]
fn parts_of_rollouts_write_exactly_their_own_elements() {
    let mut noise = Noise(45);
    let (candidates, steps) = (if cfg!(miri) { 6 } else { 50 }, if cfg!(miri) { 1 } else { 2 });
    let starts = [RolloutStart { command: None, lag_w: [0.5; 5], reading_age: known() }];
    let [v_mps, omega_radps] = [(); 2]
        .map(|()| -> Vec<f32> { (0..candidates * steps).map(|_| noise.next_f32()).collect() });
    let rollouts = Rollouts {
        starts: &starts,
        candidates,
        steps,
        step_s: 0.1,
        v_mps: &v_mps,
        omega_radps: &omega_radps,
    };
    for set in [FeatureSet::Full, FeatureSet::Freshness] {
        run_parts(set, &rollouts);
    }
}

fn known() -> ReadingAge {
    let mut reading_age = ReadingAge::UNKNOWN;
    [true, false, false, true].into_iter().for_each(|new| reading_age.read(new));
    reading_age
}

fn run_parts(set: FeatureSet, rollouts: &Rollouts<'_>) {
    let (candidates, steps) = (rollouts.candidates, rollouts.steps);
    let mut seen: Option<Vec<u32>> = None;
    for network in networks(46, set) {
        let model = Model::Network(network);
        let count = candidates - 1;
        let mut energy_j = vec![-1.0; count];
        let mut power_w = vec![-1.0; count * steps];
        let run = model.rollout(rollouts, 1..candidates, &mut energy_j, Some(&mut power_w));
        run.expect("the shapes fit");
        energy_j.extend(power_w);
        assert!(energy_j.iter().all(|value| *value != -1.0));
        let found = bits(&energy_j);
        assert_eq!(*seen.get_or_insert_with(|| found.clone()), found);
    }
}
