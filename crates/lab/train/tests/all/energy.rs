//! The energy model that training stores.

use joulebus_dataset::rows::{Dataset, Row, RowOrigin};
use joulebus_energy::{CommandModel, Commands, EnergyModel, EnergySample, EnergyState, Limit};
use joulebus_predictor::{FeatureSet, INPUTS, LAGS, features};
use joulebus_statistics::noise::Noise;
use joulebus_train::energy_model;

const PERIOD_S: f32 = 0.1;

fn commands<'a>(v_mps: &'a [f32], omega_radps: &'a [f32]) -> Commands<'a> {
    Commands { period_s: PERIOD_S, v_mps, omega_radps }
}

fn made(robots: &[Robot]) -> EnergyModel {
    energy_model(&dataset(robots), FeatureSet::Full).expect("enough recordings")
}

/// A robot whose power is its own level times the power of its commands, with noise.
struct Robot {
    level: f32,
    commands: Vec<(f32, f32)>,
    power_w: Vec<f32>,
}

impl Robot {
    fn new(number: u64, level: f32, steps: usize) -> Self {
        let mut noise = Noise::new(5, number);
        let (mut commands, mut power_w) = (Vec::new(), Vec::new());
        let (mut command, mut drift) = ((0.0, 0.0), 0.0);
        for step in 0..steps {
            if step % 20 == 0 {
                command.0 = noise.between(-0.2, 0.3) as f32;
                command.1 = noise.between(-1.0, 1.0) as f32;
            }
            commands.push(command);
            drift = 0.9 * drift + 0.01 * noise.normal() as f32;
            power_w.push(level * true_w(command) * (1.0 + drift));
        }
        Self { level, commands, power_w }
    }

    fn rows(&self) -> Vec<Row> {
        (LAGS..self.commands.len())
            .map(|at| {
                let lag_w = std::array::from_fn(|lag| self.power_w[at - 1 - lag]);
                let (v, omega) = self.commands[at];
                let (v_before, omega_before) = self.commands[at - 1];
                let previous = Some((v_before, omega_before, PERIOD_S));
                Row::new(features(v, omega, previous, &lag_w), self.power_w[at])
            })
            .collect()
    }

    /// The state with the readings up to a step.
    fn after(&self, model: &EnergyModel, from: usize) -> EnergyState {
        let mut state = EnergyState::new(0);
        for at in 0..=from {
            let (v_mps, omega_radps) = self.commands[at];
            let before = at.checked_sub(1);
            let sample = EnergySample {
                power_w: before.map_or(f32::NAN, |before| self.power_w[before]),
                elapsed_s: PERIOD_S,
                v_mps,
                omega_radps,
            };
            state.observe(model, &sample);
        }
        state
    }

    /// Forecast and measured energy of `steps` after `from`, and whether the interval contains it.
    fn judge(&self, model: &EnergyModel, from: usize, steps: usize) -> (f64, f64, bool) {
        let state = self.after(model, from);
        let plan: (Vec<f32>, Vec<f32>) = self.commands[from..from + steps].iter().copied().unzip();
        let plan = commands(&plan.0, &plan.1);
        let forecast = model.forecast(&state, plan);
        let powers_w = self.power_w[from..from + steps].iter();
        let measured: f64 = powers_w.map(|p| f64::from(p * PERIOD_S)).sum();
        let end = |p| f64::from(forecast.quantile_j(p).expect("a known horizon"));
        let inside = (end(0.05)..=end(0.95)).contains(&measured);
        (forecast.energy_j.into(), measured, inside)
    }
}

fn true_w((v_mps, omega_radps): (f32, f32)) -> f32 {
    2.0 + 20.0 * v_mps.abs() + 1.5 * omega_radps.abs()
}

fn robots(numbers: std::ops::Range<u64>) -> Vec<Robot> {
    numbers.map(|number| Robot::new(number, 0.6 + 0.1 * (number % 9) as f32, 1_200)).collect()
}

fn dataset(robots: &[Robot]) -> Dataset {
    Dataset {
        training: robots
            .iter()
            .enumerate()
            .flat_map(|(number, robot)| {
                let origin = RowOrigin::recording(number);
                robot.rows().into_iter().map(move |row| row.of(origin))
            })
            .collect(),
        validation: Vec::new(),
        held_out: Vec::new(),
        description: "levels".to_owned(),
        period_s: PERIOD_S,
    }
}

fn trained() -> EnergyModel {
    made(&robots(0..16))
}

#[test]
fn robots_of_other_levels_are_forecast_by_their_commands_and_intervals_hold() {
    let model = trained();
    let (mut error, mut energy, mut inside, mut count) = (0.0, 0.0, 0, 0);
    for robot in robots(100..124) {
        for from in (60..1_050).step_by(45) {
            let (forecast_j, measured_j, covered) = robot.judge(&model, from, 100);
            error += (forecast_j - measured_j).abs();
            energy += measured_j;
            inside += usize::from(covered);
            count += 1;
        }
    }
    let (error, coverage) = (error / energy, inside as f64 / f64::from(count));
    println!("error {error:.4}, coverage {coverage:.3} of {count}");
    // The commands alone move the mean power of ten seconds by a tenth, levels by a quarter.
    assert!(error < 0.02, "{error}");
    // Alone, each narrows its interval slowly: the robots of a platform do that together.
    assert!((0.82..=0.97).contains(&coverage), "{coverage}");
}

#[test]
fn what_differs_between_robots_is_not_attributed_to_commands() {
    // Strong robots drive slowly, weak ones fast.
    let mut robots = robots(0..16);
    for robot in &mut robots {
        let share = (1.5 - robot.level).max(0.1);
        for (v, omega) in &mut robot.commands {
            (*v, *omega) = (*v * share, *omega * share);
        }
        let commands = robot.commands.iter();
        robot.power_w = commands.map(|command| robot.level * true_w(*command)).collect();
    }
    let model = made(&robots);
    let (v_mps, omega_radps) = ([0.1f32; 50], [0.4f32; 50]);
    let moving = commands(&v_mps, &omega_radps);
    let at_rest = commands(&[0.0; 50], &[0.0; 50]);
    // Of a robot whose level is known.
    let state = robots[3].after(&model, 1_000);
    let ratio = model.forecast(&state, moving).energy_j / model.forecast(&state, at_rest).energy_j;
    let expected = true_w((0.1, 0.4)) / true_w((0.0, 0.0));
    assert!((ratio / expected - 1.0).abs() < 0.1, "{ratio}, {expected}");
}

/// Highest terms of two velocities or of a change in some recordings, by going through all rows.
fn combined(robots: &[Robot]) -> [f32; 5] {
    let rows = robots.iter().flat_map(Robot::rows);
    let terms =
        rows.map(|row| CommandModel::combined_terms(std::array::from_fn(|at| row.features[at])));
    terms.fold([0.0f32; 5], |highest, terms| {
        std::array::from_fn(|term| highest[term].max(terms[term]))
    })
}

#[test]
fn changes_of_commands_are_known_up_to_those_that_two_recordings_reached() {
    let mut robots = robots(0..16);
    let sound = made(&robots);
    let reached = sound.combined.expect("known");
    for (term, reached) in reached.into_iter().enumerate() {
        let highest_of = |robot| combined(std::slice::from_ref(robot))[term];
        let mut all: Vec<f32> = robots.iter().map(highest_of).collect();
        all.sort_by(f32::total_cmp);
        assert_eq!(reached, all[all.len() - 2], "{term}");
    }
    // A velocity of one recording is wrong for a moment.
    robots[3].commands[500].0 = 40.0;
    let spoilt = made(&robots);
    let highest = combined(&robots);
    for (term, known) in spoilt.combined.expect("known").into_iter().enumerate() {
        assert!(known <= combined(&robots[..3])[term].max(combined(&robots[4..])[term]));
        assert!(known <= highest[term]);
    }
    let outside = |v_mps: &[f32]| {
        let at_rest = vec![0.0; v_mps.len()];
        let plan = commands(v_mps, &at_rest);
        spoilt.forecast(&EnergyState::new(0), plan).steps_outside
    };
    assert_eq!(outside(&[0.0, 0.25, 0.25, 0.0]), 0);
    assert_eq!(outside(&[-0.19, 0.25, 0.25]), 0, "as in training");
    assert_eq!(outside(&[0.0, 0.25, 20.0]), 1);
}

#[test]
fn the_same_rows_give_the_same_bits_on_every_machine_and_a_model_that_passes_every_check() {
    let (one, arc) = (trained(), made(&arcs(0..8, [0.0, 0.8])));
    // No product of matrices may depend on the CPU.
    let digests = [&one, &arc].map(|model| joulebus_wire::fnv1a(model.to_text().into_bytes()));
    assert_eq!(digests, [0x4396_edf7_95d4_71a3, 0x8b32_5047_cded_1dec]);
    assert!(arc.ridge.is_some() && one.command.reads_commands());
    assert_eq!(one.check(), Ok(()));
    assert_eq!(EnergyModel::from_text(&one.to_text()), Ok(one));
}

#[test]
fn horizons_that_no_recording_is_long_enough_for_are_not_calibrated() {
    // 120 s each.
    let model = trained();
    let longest_s = model.longest_s();
    assert!((100.0..300.0).contains(&longest_s), "{longest_s}");
    let short: Vec<Robot> = (0..16).map(|number| Robot::new(number, 1.0, 60)).collect();
    let model = made(&short);
    assert!(model.longest_s() <= 3.0, "{}", model.longest_s());
}

#[test]
fn without_velocities_commands_make_no_difference() {
    let model = energy_model(&dataset(&robots(0..8)), FeatureSet::PowerOnly).expect("long enough");
    assert!(!model.command.reads_commands());
}

#[test]
fn recordings_without_information_give_no_model() {
    let mut unknown = dataset(&robots(0..8));
    unknown.period_s = 0.0;
    assert_eq!(energy_model(&unknown, FeatureSet::Full), None);
    let none = dataset(&[]);
    assert_eq!(energy_model(&none, FeatureSet::Full), None);
    let mut off = dataset(&robots(0..8));
    off.training.iter_mut().for_each(|row| row.target_w = 0.0);
    assert_eq!(energy_model(&off, FeatureSet::Full), None);
    let mut odd = dataset(&robots(0..8));
    for row in odd.training.iter_mut().step_by(7) {
        row.features = [f32::NAN; INPUTS];
    }
    if let Some(model) = energy_model(&odd, FeatureSet::Full) {
        assert_eq!(model.check(), Ok(()));
    }
}

/// A dataset whose rows are all of one recording of a robot, or of several.
fn recorded(robots: &[Robot], origin: impl Fn(usize) -> RowOrigin) -> Dataset {
    let mut dataset = dataset(robots);
    for row in &mut dataset.training {
        row.origin = origin(row.origin.recording as usize);
    }
    dataset
}

#[test]
fn the_fewer_the_recordings_the_wider_are_the_intervals_and_pieces_of_one_are_no_recordings() {
    let robots = robots(0..16);
    // Half width of the 90 % interval over ten seconds.
    let half = |origin: &dyn Fn(usize) -> RowOrigin| {
        let model = energy_model(&recorded(&robots, origin), FeatureSet::Full);
        let model = model.expect("long enough");
        assert_eq!(model.check(), Ok(()));
        assert!(model.longest_s() >= 10.0, "{}", model.longest_s());
        0.5 * (model.errors[2][7] - model.errors[2][1])
    };
    // Sixteen stretches between gaps are one recording.
    let [one, two, three, four, all] = [1, 2, 3, 4, 16]
        .map(|count| half(&|place| RowOrigin { recording: (place % count) as u32, robot: 0 }));
    println!("{one} {two} {three} {four} {all}");
    assert!(one > two && two > three && three > four && four > all);
    assert!(three > 0.3, "{three}: another drive may differ by 30 %");
    // Known to the tables of Student's distribution: 2.92 at 2 degrees of freedom, times 0.3 and √2.
    assert!((one / (2.92 * 0.3 * 2f32.sqrt()) - 1.0).abs() < 0.05, "{one}");
}

/// Drives of a skid-steer robot, which draws more the tighter it turns and less the faster it is.
fn arcs(numbers: std::ops::Range<u64>, v_mps: [f64; 2]) -> Vec<Robot> {
    let drive = |number| {
        let mut robot = Robot::new(number, 1.0, 800);
        let mut noise = Noise::new(6, number);
        for at in 0..robot.commands.len() {
            if at % 60 == 0 {
                robot.commands[at].0 = noise.between(v_mps[0], v_mps[1]) as f32;
                robot.commands[at].1 = noise.between(-1.0, 1.0) as f32;
            } else {
                robot.commands[at] = robot.commands[at - 1];
            }
            let (v, omega) = robot.commands[at];
            let noise = 1.0 + 0.03 * noise.normal() as f32;
            robot.power_w[at] = (100.0 + 150.0 * omega.abs() - 80.0 * v) * noise;
        }
        robot
    };
    numbers.map(drive).collect()
}

/// Asked energy of a whole drive before its first reading, its interval, and the measured one, J.
fn asked(model: &EnergyModel, robot: &Robot) -> ([f64; 3], f64) {
    let (v_mps, omega_radps): (Vec<f32>, Vec<f32>) = robot.commands.iter().copied().unzip();
    let forecast = model.forecast(&EnergyState::new(0), commands(&v_mps, &omega_radps));
    let end = |p| f64::from(forecast.quantile_j(p).expect("known"));
    let measured = robot.power_w.iter().map(|power_w| f64::from(power_w * PERIOD_S)).sum();
    ([forecast.energy_j.into(), end(0.05), end(0.95)], measured)
}

#[test]
fn a_drive_that_is_asked_before_its_first_reading_costs_what_its_commands_say() {
    for drives in [3, 8] {
        let model = made(&arcs(0..drives, [0.0, 0.8]));
        let plain = EnergyModel { ridge: None, ..model.clone() };
        let ([mut with, mut without], mut inside) = ([0.0; 2], 0);
        for robot in arcs(100..120, [0.0, 0.8]) {
            let ([energy_j, lo_j, hi_j], measured_j) = asked(&model, &robot);
            with += (energy_j / measured_j - 1.0).abs() / 20.0;
            without += (asked(&plain, &robot).0[0] / measured_j - 1.0).abs() / 20.0;
            inside += usize::from((lo_j..=hi_j).contains(&measured_j));
        }
        println!(
            "{drives} drives: {with:.3}, without the regression {without:.3}, {inside} inside"
        );
        assert!(with < 0.04 && with < 0.5 * without, "{drives}: {with} {without}");
        assert!(inside >= 17, "{drives}: {inside}");
    }
}

#[test]
fn a_model_states_what_was_recorded_and_what_its_recordings_cannot_show() {
    let robots = arcs(0..6, [0.0, 0.3]);
    let model = made(&robots);
    assert_eq!(model.limits, []);
    let [lowest, highest] = model.recorded_w.expect("known");
    assert!((70.0..130.0).contains(&lowest) && (200.0..260.0).contains(&highest), "{model:?}");
    // At twice the speed it is outside, and what is drawn lies within the bounds.
    let fast = &arcs(50..51, [0.6, 0.8])[0];
    let (v_mps, omega_radps): (Vec<f32>, Vec<f32>) = fast.commands.iter().copied().unzip();
    let forecast = model.forecast(&EnergyState::new(0), commands(&v_mps, &omega_radps));
    let drawn_w = asked(&model, fast).1 / f64::from(forecast.duration_s);
    let [lowest, _, highest] = forecast.outside_w.expect("known");
    assert!(f64::from(lowest) <= drawn_w && drawn_w <= f64::from(highest));
    assert!(forecast.steps_outside > 700, "{forecast:?}");
    // Robots that never turn, and recordings without velocities.
    let mut straight = arcs(0..6, [0.0, 0.3]);
    straight.iter_mut().flat_map(|robot| &mut robot.commands).for_each(|command| command.1 = 0.0);
    assert_eq!(made(&straight).limits, [Limit::NoTurns]);
    let without = energy_model(&dataset(&robots), FeatureSet::PowerOnly).expect("enough");
    assert_eq!((without.limits, without.ridge), (vec![Limit::NoVelocities], None));
    assert!(without.recorded_w.is_some());
}

#[test]
fn robots_that_differ_are_not_on_both_sides_of_the_cross_validation() {
    // Eight recordings of each of two robots. What the second draws does not depend on commands.
    let mut robots = robots(0..16);
    for robot in &mut robots[8..] {
        let mut noise = Noise::new(9, 0);
        robot
            .power_w
            .iter_mut()
            .for_each(|power_w| *power_w = 4.0 + noise.between(0.0, 0.1) as f32);
    }
    let width = |origin: &dyn Fn(usize) -> RowOrigin| {
        let model = energy_model(&recorded(&robots, origin), FeatureSet::Full).expect("enough");
        assert!(model.calibrated >= 3, "{model:?}");
        model.errors[0][7] - model.errors[0][1]
    };
    let by_recording = width(&|place| RowOrigin { recording: place as u32, robot: 0 });
    let by_robot = width(&|place| RowOrigin { recording: place as u32, robot: place as u32 / 8 });
    assert!(by_robot > by_recording, "{by_robot} {by_recording}");
}
