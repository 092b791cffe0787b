//! What is stated about a network is checked on recordings.

use std::fmt::Write as _;

use joulebus_dataset::trial::Trial;
use joulebus_model_files::{
    CommandConvention, Convention, Derivative, ImportError, Imported, LagOrder, Lags, Magnitude,
    Plain, PowerUnit,
};
use joulebus_predictor::{Activation, FEATURES};
use joulebus_testkit::assert_contains;
use joulebus_testkit_fleets::exact;

use crate::plain::{Contents, Layers, layers, trial};

const STEP_S: f64 = 1.0 / 30.0;
/// Statistics of the published model.
const V: (f64, f64) = (0.0279, 0.0736);
const OMEGA: (f64, f64) = (0.0479, 1.0187);
const POWER_W: (f64, f64) = (3.6517, 0.3747);

const COMMAND: CommandConvention = CommandConvention {
    lags: Lags::Last,
    derivative: Derivative::NormalisedPerSecond,
    magnitude: Magnitude::AsVelocity,
};
const CONVENTION: Convention = Convention {
    unit: PowerUnit::Milliwatt,
    order: LagOrder::Newest,
    activation: Activation::GeluErf,
    command: Some(COMMAND),
};

fn network() -> Layers {
    layers(&[11, 64, 64, 32, 1], 3)
}

/// The plain network under a convention.
fn plain(layers: &Layers, convention: &Convention) -> Plain {
    Plain::read(&contents(layers, convention).bytes()).unwrap()
}

fn contents(layers: &Layers, convention: &Convention) -> Contents {
    let CommandConvention { lags, derivative, magnitude } = convention.command.unwrap();
    let of_derivative = |(_, std): (f64, f64)| match derivative {
        Derivative::RawPerSecond | Derivative::RawPerStep => (0.0, 1.0),
        _ => (0.0, std),
    };
    let of_magnitude = |(mean, std): (f64, f64)| match magnitude {
        Magnitude::Raw => (0.0, 1.0),
        Magnitude::AsVelocity => (mean, std),
        _ => (0.0, std),
    };
    let commands =
        [V, OMEGA, of_derivative(V), of_derivative(OMEGA), of_magnitude(V), of_magnitude(OMEGA)];
    let scale = if convention.unit == PowerUnit::Milliwatt { 1e3 } else { 1.0 };
    let power = (POWER_W.0 * scale, POWER_W.1 * scale);
    let inputs = match lags {
        Lags::Last => [&commands[..], &[power; 5]].concat(),
        Lags::First => [&[power; 5][..], &commands].concat(),
    };
    // As a person would state it: by the arguments of the conversion.
    let shown = convention.to_string();
    let stated: Vec<(&str, &str)> = shown
        .split(", ")
        .map(|pair| pair.split_once('=').unwrap())
        .map(|(key, value)| (key, value.trim_matches('"')))
        .collect();
    Contents::new(layers, &inputs, power, &stated)
}

/// Inputs of a network under a convention, computed directly from its definition.
fn inputs(convention: &Convention, now: [f64; 2], before: [f64; 2], lag_w: &[f64]) -> Vec<f64> {
    let [v, omega] = now;
    let command = convention.command.unwrap();
    let normal = |x: f64, (mean, std): (f64, f64)| (x - mean) / std;
    let difference = |now: f64, before: f64, stat: (f64, f64)| match command.derivative {
        Derivative::RawPerSecond => (now - before) / STEP_S,
        Derivative::RawPerStep => now - before,
        Derivative::NormalisedPerSecond => (normal(now, stat) - normal(before, stat)) / STEP_S,
        Derivative::NormalisedPerStep => normal(now, stat) - normal(before, stat),
        _ => panic!("these networks have no statistics of derivatives"),
    };
    let magnitude = |x: f64, stat: (f64, f64)| match command.magnitude {
        Magnitude::Raw => x.abs(),
        Magnitude::Divided => x.abs() / stat.1,
        Magnitude::AsVelocity => normal(x.abs(), stat),
        Magnitude::OfNormalised => normal(x, stat).abs(),
        Magnitude::Own => panic!("these networks have no statistics of magnitudes"),
    };
    let commands = [
        normal(v, V),
        normal(omega, OMEGA),
        difference(v, before[0], V),
        difference(omega, before[1], OMEGA),
        magnitude(v, V),
        magnitude(omega, OMEGA),
    ];
    let mut lags: Vec<f64> = lag_w.iter().map(|power| normal(*power, POWER_W)).collect();
    if convention.order == LagOrder::Oldest {
        lags.reverse();
    }
    match command.lags {
        Lags::Last => [&commands[..], &lags].concat(),
        Lags::First => [&lags[..], &commands].concat(),
    }
}

/// A trial whose robot draws the network's forecast under a convention, and a little noise. Its
/// command changes if it is `moving`.
fn recorded(layers: &Layers, convention: &Convention, rows: usize, moving: bool) -> Trial {
    let mut seed = 7_u64;
    let mut uniform = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f64 / f64::from(1 << 24) * 2.0 - 1.0
    };
    let mut csv = "robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    let network = exact::Layers::new(layers, convention.activation);
    let mut before = [0.0, 0.0];
    let mut lag_w = vec![3.6; 5];
    let mut command = [0.05, 0.1];
    for row in 0..rows {
        if moving && row % 3 == 0 {
            command = [0.2 * uniform(), 2.0 * uniform()];
        }
        let values = inputs(convention, command, before, &lag_w);
        let output = network.output(values);
        let power_w = output * POWER_W.1 + POWER_W.0 + 0.001 * uniform();
        let ([v, omega], time_s) = (command, row as f64 * STEP_S);
        writeln!(csv, "1,{time_s:.9},{v},{omega},{}", power_w * 1e3).unwrap();
        lag_w.insert(0, power_w);
        lag_w.truncate(5);
        before = command;
    }
    trial(&csv)
}

fn import(plain: &Plain, trial: &Trial) -> Result<Imported, ImportError> {
    plain.import(std::slice::from_ref(trial), "lab", "x.safetensors")
}

#[test]
fn a_true_statement_is_imported_and_a_false_one_refused_with_the_true_one() {
    let network = network();
    let command = |change: fn(&mut CommandConvention)| {
        let mut command = COMMAND;
        change(&mut command);
        Convention { command: Some(command), ..CONVENTION }
    };
    for truth in [
        CONVENTION,
        Convention { order: LagOrder::Oldest, ..CONVENTION },
        Convention { activation: Activation::Relu, ..CONVENTION },
        command(|command| command.lags = Lags::First),
        command(|command| command.derivative = Derivative::NormalisedPerStep),
        command(|command| {
            (command.derivative, command.magnitude) = (Derivative::RawPerSecond, Magnitude::Raw);
        }),
        command(|command| {
            (command.derivative, command.magnitude) = (Derivative::RawPerStep, Magnitude::Divided);
        }),
    ] {
        let trial = recorded(&network, &truth, 1_500, true);
        let imported = import(&plain(&network, &truth), &trial).unwrap();
        assert_eq!(imported.stated.convention, truth);
        assert!(imported.stated.r2 > 0.99, "{:?}", imported.stated);
        // Both forms of GELU are nearly the same.
        let best = imported.others[0].r2;
        assert!(best < imported.stated.r2 + 1e-3, "{truth}: {best}");
        assert_contains(&imported.network.card().source, [&truth.to_string()]);
        // Another one is stated.
        let other =
            if truth == CONVENTION { command(|c| c.lags = Lags::First) } else { CONVENTION };
        match import(&plain(&network, &other), &trial) {
            Err(ImportError::Contradicted { stated_r2, better, r2, less }) => {
                assert_eq!(better, truth);
                assert!(r2 > 0.99 && stated_r2 < r2 && less > 5.0, "{stated_r2} {r2} {less}");
            }
            result => panic!("{truth}: {result:?}"),
        }
    }
}

#[test]
fn the_unit_of_power_is_checked_too() {
    let network = network();
    let trial = recorded(&network, &CONVENTION, 600, true);
    let mut contents = contents(&network, &CONVENTION);
    contents.metadata.insert("unit".to_owned(), "W".to_owned());
    let error = import(&Plain::read(&contents.bytes()).unwrap(), &trial).unwrap_err();
    assert_contains(&error.to_string(), ["contradict", "convert it again with unit=\"mW\""]);
}

#[test]
fn a_convention_that_the_worker_cannot_compute_is_named_and_not_imported() {
    let network = network();
    let magnitude = Magnitude::OfNormalised;
    let truth =
        Convention { command: Some(CommandConvention { magnitude, ..COMMAND }), ..CONVENTION };
    let trial = recorded(&network, &truth, 1_500, true);
    match import(&plain(&network, &CONVENTION), &trial) {
        Err(error @ ImportError::CannotRun { r2, .. }) => {
            assert!(r2 > 0.99);
            assert_contains(&error.to_string(), ["|v − mean|"]);
        }
        result => panic!("{result:?}"),
    }
}

#[test]
fn what_the_recordings_cannot_tell_apart_is_imported_as_stated() {
    // All readings weigh the same, so their order is not identifiable.
    let mut network = network();
    for row in network[0].0.chunks_mut(FEATURES) {
        let mean = row[6..].iter().sum::<f32>() / 5.0;
        for (lag, weight) in row[6..].iter_mut().enumerate() {
            *weight = mean * (1.0 + 0.001 * lag as f32);
        }
    }
    let trial = recorded(&network, &CONVENTION, 1_500, true);
    for order in [LagOrder::Newest, LagOrder::Oldest] {
        let stated = Convention { order, ..CONVENTION };
        let imported = import(&plain(&network, &stated), &trial).unwrap();
        assert_eq!(imported.stated.convention, stated);
    }
}

#[test]
fn recordings_that_say_nothing_about_the_network_are_refused() {
    let network = network();
    let plain = plain(&network, &CONVENTION);
    let few = recorded(&network, &CONVENTION, 50, true);
    let error = import(&plain, &few).unwrap_err();
    assert!(matches!(error, ImportError::TooFewRows { found: 45, .. }), "{error}");
    // Of another robot: its power has nothing to do with the command.
    let mut csv = "robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    for row in 0..600_u32 {
        let power_mw = 90_000 + (row * 7919) % 1000;
        writeln!(csv, "1,{:.9},0.1,0.2,{power_mw}", f64::from(row) * STEP_S).unwrap();
    }
    let error = import(&plain, &trial(&csv)).unwrap_err().to_string();
    assert!(error.contains("R²"), "{error}");
    let constant = csv.lines().map(|line| match line.rsplit_once(',') {
        Some((rest, last)) if last != "power_mW" => format!("{rest},3600\n"),
        _ => format!("{line}\n"),
    });
    let error = import(&plain, &trial(&constant.collect::<String>())).unwrap_err();
    assert!(matches!(error, ImportError::ConstantPower { .. }), "{error}");
}
