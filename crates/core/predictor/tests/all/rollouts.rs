//! Rollouts and columns give the bits of rows, and refuse mismatched shapes.

use joulebus_predictor::{
    FeatureSet, INPUTS, Kernel, LAGS, LengthError, Model, Network, Persistence, ReadingAge,
    ResidualStats, RolloutError, RolloutStart, Rollouts, features,
};
#[allow(dead_code)] // Each test file uses a part.
use joulebus_testkit_fleets::random::{Noise, network};
use proptest::prelude::*;

const SETS: [FeatureSet; 4] = FeatureSet::ALL;

fn persistence() -> Model {
    let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
    Model::Persistence(Persistence::new(residual).expect("valid"))
}

fn on_every_kernel(network: &Network) -> Vec<Model> {
    Kernel::ALL
        .into_iter()
        .filter_map(|kernel| network.clone().with_kernel(kernel))
        .map(Model::Network)
        .collect()
}

fn models(seed: u64) -> Vec<Model> {
    let mut models = vec![persistence()];
    for set in SETS {
        models.extend(on_every_kernel(&network(seed, set)));
    }
    models
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn a_column_of_another_length_is_refused_and_nothing_is_written() {
    let four = [1.0; 4];
    let mut columns = [&four[..]; INPUTS];
    columns[7] = &four[..3];
    let mut forecasts_w = [-1.0; 4];
    for model in models(20) {
        let error = model.predict_columns(columns, &mut forecasts_w);
        let text = error.unwrap_err().to_string();
        assert_eq!(text, "power_lag2_w has 3 values, allowed: 4");
        assert_eq!(forecasts_w, [-1.0; 4]);
    }
}

/// The reading age of a robot with a monitor of any rate, at any time. One in eight is unknown.
fn reading_age(noise: &mut Noise) -> ReadingAge {
    let mut reading_age = ReadingAge::UNKNOWN;
    if noise.next_u64().is_multiple_of(8) {
        return reading_age;
    }
    let interval = 1 + noise.next_u64() % 6;
    for sample in 0..=interval + noise.next_u64() % 8 {
        reading_age.read(sample % interval == 0);
    }
    reading_age
}

/// The inputs of a rollout, owned.
#[derive(Debug)]
struct Scene {
    starts: Vec<RolloutStart>,
    candidates: usize,
    steps: usize,
    v_mps: Vec<f32>,
    omega_radps: Vec<f32>,
}

impl Scene {
    fn random(noise: &mut Noise, robots: usize, candidates: usize, steps: usize) -> Scene {
        let count = robots * candidates * steps;
        Scene {
            starts: (0..robots)
                .map(|robot| RolloutStart {
                    command: (robot % 3 != 2).then(|| (noise.next_f32(), noise.next_f32())),
                    lag_w: std::array::from_fn(|_| noise.next_f32()),
                    reading_age: reading_age(noise),
                })
                .collect(),
            candidates,
            steps,
            v_mps: (0..count).map(|_| noise.next_f32()).collect(),
            omega_radps: (0..count).map(|_| noise.next_f32()).collect(),
        }
    }

    fn rollouts(&self) -> Rollouts<'_> {
        Rollouts {
            starts: &self.starts,
            candidates: self.candidates,
            steps: self.steps,
            step_s: 1.0 / 30.0,
            v_mps: &self.v_mps,
            omega_radps: &self.omega_radps,
        }
    }

    fn lanes(&self) -> usize {
        self.starts.len() * self.candidates
    }
}

/// Energy of each lane and its forecasts, by `predict` and `features` alone, one lane at a time.
fn by_hand(model: &Model, scene: &Scene) -> (Vec<f32>, Vec<f32>) {
    let lanes = scene.lanes();
    let step_s = scene.rollouts().step_s;
    let mut power_w = vec![0.0; lanes * scene.steps];
    let mut energy_j = vec![0.0; lanes];
    for lane in 0..lanes {
        let start = scene.starts[lane / scene.candidates];
        let (mut window_w, mut before) = (start.lag_w.to_vec(), start.command);
        let mut reading_age = start.reading_age;
        let mut total = 0.0f64;
        for step in 0..scene.steps {
            let (v, omega) =
                (scene.v_mps[step * lanes + lane], scene.omega_radps[step * lanes + lane]);
            let lag_w: [f32; LAGS] = std::array::from_fn(|lag| window_w[lag]);
            let mut row = features(v, omega, before.map(|(v, w)| (v, w, step_s)), &lag_w);
            reading_age.fill(&mut row);
            let mut forecast_w = [0.0];
            model.predict(&[row], &mut forecast_w);
            power_w[step * lanes + lane] = forecast_w[0];
            total += f64::from(forecast_w[0]);
            let range = model.training_range();
            let fed_back_w = range.map_or(forecast_w[0], |range| range.fed_back_w(forecast_w[0]));
            window_w.insert(0, fed_back_w);
            before = Some((v, omega));
            reading_age.pass(1);
        }
        energy_j[lane] = (total * f64::from(step_s)) as f32;
    }
    (energy_j, power_w)
}

/// Equal bits, or both NaN: the payload of a NaN energy is not guaranteed.
fn same(found: &[f32], expected: &[f32]) -> bool {
    found.len() == expected.len()
        && found
            .iter()
            .zip(expected)
            .all(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()))
}

fn run(model: &Model, scene: &Scene) -> (Vec<f32>, Vec<f32>) {
    let mut energy_j = vec![-1.0; scene.lanes()];
    let mut power_w = vec![-1.0; scene.lanes() * scene.steps];
    model
        .rollout(&scene.rollouts(), 0..scene.lanes(), &mut energy_j, Some(&mut power_w))
        .expect("the shapes match");
    (energy_j, power_w)
}

#[test]
fn a_network_that_amplifies_its_own_forecasts_stays_bounded() {
    for set in SETS {
        let random = network(31, set);
        let mut parameters = random.parameters().clone();
        for weight in &mut parameters.layers[3].weights {
            *weight *= 100.0;
        }
        let amplifies = Network::new(parameters, random.card().clone()).expect("finite weights");
        let scene = Scene::random(&mut Noise(32), 2, 20, 1_000);
        for model in on_every_kernel(&amplifies) {
            let (energy_j, power_w) = run(&model, &scene);
            assert!(energy_j.iter().all(|energy_j| energy_j.is_finite()));
            let largest =
                power_w.iter().fold(0.0f32, |largest, power_w| largest.max(power_w.abs()));
            // Fed with its own forecasts as they are, it leaves the numbers within some ten steps.
            assert!((10.0..1e5).contains(&largest), "{set:?}: {largest} W");
        }
    }
}

#[test]
fn rollouts_of_every_shape_give_the_bits_of_stepping_by_hand() {
    let mut noise = Noise(22);
    let shapes = [
        (1, 1, 1),
        (1, 7, 6),
        (3, 5, 12),
        (2, 16, 3),
        (1, 33, 4),
        (7, 11, 8),
        (1, 129, 7),
        (4, 0, 3),
        (0, 4, 3),
        (2, 2, 0),
    ];
    for model in models(23) {
        for (robots, candidates, steps) in shapes {
            let scene = Scene::random(&mut noise, robots, candidates, steps);
            let expected = by_hand(&model, &scene);
            let found = run(&model, &scene);
            let shape = (robots, candidates, steps);
            assert!(same(&found.0, &expected.0), "energy {shape:?}");
            assert!(same(&found.1, &expected.1), "power {shape:?}");
        }
    }
}

#[test]
fn parts_of_the_lanes_give_the_bits_of_the_whole() {
    let scene = Scene::random(&mut Noise(24), 5, 17, 4);
    for model in models(25) {
        let (whole_j, whole_w) = run(&model, &scene);
        for (first, last) in [(0, 1), (3, 40), (16, 85), (84, 85), (50, 50)] {
            let count = last - first;
            let mut energy_j = vec![-1.0; count];
            let mut power_w = vec![-1.0; count * scene.steps];
            let rollouts = scene.rollouts();
            model
                .rollout(&rollouts, first..last, &mut energy_j, Some(&mut power_w))
                .expect("the shapes fit");
            assert_eq!(bits(&energy_j), bits(&whole_j[first..last]));
            for step in 0..scene.steps {
                let start = step * scene.lanes();
                assert_eq!(
                    bits(&power_w[step * count..][..count]),
                    bits(&whole_w[start + first..start + last])
                );
            }
            energy_j.fill(-1.0);
            model.rollout(&rollouts, first..last, &mut energy_j, None).expect("the shapes fit");
            assert_eq!(bits(&energy_j), bits(&whole_j[first..last]), "without a trace");
        }
    }
}

#[test]
fn mismatched_shapes_are_refused_with_numbers() {
    let scene = Scene::random(&mut Noise(26), 2, 3, 4);
    let model = persistence();
    let whole = scene.rollouts();
    let run = |rollouts: &Rollouts<'_>, lanes, energy: usize, power: Option<usize>| {
        let mut energy_j = vec![0.0; energy];
        let mut power_w = power.map(|count| vec![0.0; count]);
        model.rollout(rollouts, lanes, &mut energy_j, power_w.as_deref_mut())
    };
    assert_eq!(run(&whole, 0..6, 6, Some(24)), Ok(()));
    let length =
        |column, found, allowed| Err(RolloutError::Length(LengthError { column, found, allowed }));
    assert_eq!(run(&whole, 0..6, 5, None), length("energy_j", 5, 6));
    assert_eq!(run(&whole, 0..5, 5, Some(24)), length("power_w", 24, 20));
    let short = Rollouts { omega_radps: &scene.omega_radps[1..], ..whole };
    assert_eq!(run(&short, 0..6, 6, None), length("omega_radps", 23, 24));
    let short = Rollouts { v_mps: &[], ..whole };
    assert_eq!(run(&short, 0..6, 6, None), length("v_mps", 0, 24));
    let backwards = std::ops::Range { start: 4, end: 3 };
    for lanes in [0..7, backwards, 7..7] {
        let expected = RolloutError::Lanes { start: lanes.start, end: lanes.end, allowed: 6 };
        assert_eq!(run(&whole, lanes, 0, None), Err(expected));
    }
    for step_s in [0.0, -0.1, f32::INFINITY, f32::NAN] {
        let found = run(&Rollouts { step_s, ..whole }, 0..6, 6, None);
        assert!(matches!(found, Err(RolloutError::Step { .. })), "{step_s}");
    }
    let huge = Rollouts { candidates: usize::MAX, steps: usize::MAX, ..whole };
    assert!(run(&huge, 0..6, 6, None).is_err());
}

fn value() -> impl Strategy<Value = f32> {
    prop_oneof![
        12 => -3.0f32..3.0,
        1 => any::<u32>().prop_map(f32::from_bits),
        1 => prop::sample::select(vec![
            f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e-45, -0.0, 1e38,
        ]),
    ]
}

proptest! {
    #[test]
    fn rollouts_of_any_values_give_the_bits_of_stepping_by_hand(
        robots in 1usize..4,
        candidates in 1usize..30,
        steps in 1usize..9,
        seed in any::<u64>(),
        poison in prop::collection::vec((any::<prop::sample::Index>(), value(), 0..3), 0..6),
    ) {
        let mut noise = Noise(seed);
        let mut scene = Scene::random(&mut noise, robots, candidates, steps);
        for (place, value, column) in poison {
            match column {
                0 => scene.v_mps[place.index(robots * candidates * steps)] = value,
                1 => scene.omega_radps[place.index(robots * candidates * steps)] = value,
                _ => scene.starts[place.index(robots)].lag_w[place.index(LAGS)] = value,
            }
        }
        for model in models(seed) {
            let expected = by_hand(&model, &scene);
            let found = run(&model, &scene);
            prop_assert!(same(&found.0, &expected.0), "energy");
            prop_assert!(same(&found.1, &expected.1), "power");
        }
    }
}

#[test]
fn models_can_be_shared_between_threads() {
    fn shared<T: Send + Sync>() {}
    shared::<Model>();
    shared::<Rollouts<'_>>();
}
