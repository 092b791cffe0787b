//! Which reading and command a sample carries, with which times and flags.

use joulebus_dataset::trial::{Column, Trial};
use joulebus_testkit::trials::{Files, ROWS, npy_f8, timed};
use joulebus_wire::sample_flag::{CURRENT, HELD, OMEGA, POWER, V, VOLTAGE};
use joulebus_wire::{Freshness, Sample};
use proptest::prelude::*;

#[test]
fn a_sample_carries_the_reading_of_its_row_and_the_command_of_the_next() {
    let files = Files::new();
    let trial = Trial::read(files.write("rows.npy", &npy_f8(&ROWS))).unwrap();
    let samples = trial.to_samples(42, 1_000);
    let ms = |ms: u64| 1_000 + ms * 1_000_000;
    let all = V | OMEGA | POWER | VOLTAGE | CURRENT;
    // Flags, stamp, measured, v, omega, power, voltage, current.
    let expected = [
        (all, ms(100), ms(0), 0.2, -1.5, 3.5, 7.0, 0.5),
        (all, ms(200), ms(100), 0.3, 2.0, 3.5, 7.0, 0.5),
        (all, ms(300), ms(200), 0.4, -2.5, 3.55, 7.1, 0.5),
        (all & !POWER & !V, ms(400), 0, 0.0, 3.0, 0.0, 7.1, 0.5),
        (all & !V & !OMEGA, ms(500), ms(400), 0.0, 0.0, -1.8, 7.2, 0.25),
    ];
    assert_eq!(samples.len(), expected.len());
    for (k, (sample, wanted)) in samples.iter().zip(expected).enumerate() {
        let (mut flags, stamp_ns, mut measured_ns, v, omega, power, voltage, current) = wanted;
        if k == 1 {
            flags |= HELD;
            measured_ns = ms(0);
        }
        assert_eq!((sample.robot, sample.seq), (42, k as u64));
        assert_eq!(
            (sample.flags, sample.stamp_ns, sample.measured_ns),
            (flags, stamp_ns, measured_ns),
            "{k}"
        );
        let fields = [
            (V, sample.v_mps, v),
            (OMEGA, sample.omega_radps, omega),
            (POWER, sample.power_w, power),
            (VOLTAGE, sample.voltage_v, voltage),
            (CURRENT, sample.current_a, current),
        ];
        for (flag, found, value) in fields {
            if flags & flag == 0 {
                assert!(found.is_nan(), "{k}: unknown is NaN");
            } else {
                assert_eq!(found, value as f32, "{k}");
            }
        }
    }
    assert_eq!(samples[1].freshness(), Freshness::Held);
    assert_eq!(samples[3].freshness(), Freshness::Missing);
}

#[test]
fn a_reading_is_held_only_if_voltage_and_current_are_equal_too() {
    let files = Files::new();
    for (column, held) in [(8, false), (9, false), (10, false), (3, true), (2, true)] {
        let mut rows = ROWS;
        rows[1][column] += 1.0;
        let samples =
            Trial::read(files.write("rows.npy", &npy_f8(&rows))).unwrap().to_samples(1, 0);
        assert_eq!(samples[1].has(HELD), held, "column {column} differs");
    }
}

#[test]
fn a_held_run_keeps_the_time_of_its_first_reading_and_a_missing_reading_ends_it() {
    let files = Files::new();
    let power = [1.0, 1.0, 1.0, f64::NAN, 1.0, 1.0];
    let rows = power.into_iter().enumerate().map(|(row, power)| (row as f64, power));
    let rows = timed(&rows.collect::<Vec<_>>());
    let samples = Trial::read(files.write("held.npy", &npy_f8(&rows))).unwrap().to_samples(1, 0);
    let measured_s = samples.iter().map(|sample| sample.measured_ns / 1_000_000_000);
    assert_eq!(measured_s.collect::<Vec<_>>(), [0, 0, 0, 0, 4, 4]);
    let held = samples.iter().map(|sample| sample.has(HELD));
    assert_eq!(held.collect::<Vec<_>>(), [false, true, true, false, false, true]);
}

#[test]
fn times_that_do_not_advance_are_passed_on_unchanged() {
    let files = Files::new();
    let rows = timed(&[(5.0, 1.0), (5.1, 2.0), (5.1, 3.0), (4.9, 4.0), (5.2, 5.0)]);
    let trial = Trial::read(files.write("back.npy", &npy_f8(&rows))).unwrap();
    let base_ns = 1_000_000_000;
    let stamps = trial.to_samples(1, base_ns).into_iter().map(|sample| sample.stamp_ns);
    let stamps_ms = stamps.map(|stamp_ns| stamp_ns / 1_000_000).collect::<Vec<_>>();
    assert_eq!(stamps_ms, [1_100, 1_100, 900, 1_200, 1_300]);
    assert_eq!(trial.notes().not_advancing, [3, 4]);
}

/// The alignment computed row by row from the public columns.
fn slow(trial: &Trial, robot: u32, base_ns: u64) -> Vec<Sample> {
    let time_s = trial.timestamp_s();
    let at = |row: usize| base_ns + ((time_s[row] - time_s[0]) * 1e9).round() as u64;
    let value = |column: Column, row: usize| {
        let value = trial.column(column).and_then(|values| values.get(row).copied());
        value.filter(|value| !value.is_nan()).map(|value| value as f32)
    };
    let reading = |row: usize| {
        [Column::Power, Column::Voltage, Column::Current]
            .map(|column| trial.column(column).map_or(f64::NAN, |values| values[row]))
            .map(|value| if value.is_nan() { None } else { Some(value.to_bits()) })
    };
    let mut samples = Vec::new();
    for row in 0..trial.rows() {
        let stamp_ns =
            if row + 1 < trial.rows() { at(row + 1) } else { at(row) + trial.period_ns() };
        let mut sample = Sample::new(robot, row as u64, stamp_ns);
        let mut first = row;
        while first > 0 && reading(first)[0].is_some() && reading(first) == reading(first - 1) {
            first -= 1;
        }
        if let Some(power_w) = value(Column::Power, row) {
            sample = sample.reading(power_w, at(first));
            if first < row {
                sample = sample.with(HELD);
            }
        }
        for (column, row, flag) in [
            (Column::V, row + 1, V),
            (Column::Omega, row + 1, OMEGA),
            (Column::Voltage, row, VOLTAGE),
            (Column::Current, row, CURRENT),
        ] {
            let Some(value) = value(column, row) else {
                continue;
            };
            match column {
                Column::V => sample.v_mps = value,
                Column::Omega => sample.omega_radps = value,
                Column::Voltage => sample.voltage_v = value,
                _ => sample.current_a = value,
            }
            sample.flags |= flag;
        }
        samples.push(sample);
    }
    samples
}

/// Samples as bits, so that NaN equals NaN.
pub(crate) fn bits(samples: &[Sample]) -> Vec<[u64; 9]> {
    samples
        .iter()
        .map(|sample| {
            [
                u64::from(sample.robot),
                u64::from(sample.flags),
                sample.seq,
                sample.stamp_ns,
                sample.measured_ns,
                u64::from(sample.v_mps.to_bits()) << 32 | u64::from(sample.omega_radps.to_bits()),
                u64::from(sample.power_w.to_bits()),
                u64::from(sample.voltage_v.to_bits()),
                u64::from(sample.current_a.to_bits()),
            ]
        })
        .collect()
}

fn sparse() -> impl Strategy<Value = f64> {
    prop_oneof![Just(f64::NAN), Just(1500.0), Just(2500.0), -1e4..1e4]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn samples_equal_the_slow_alignment_to_the_bit(
        steps in prop::collection::vec(
            (1e-4..0.5_f64, sparse(), sparse(), sparse(), sparse(), sparse()), 2..60),
        base_ns in 0..u64::MAX / 2,
    ) {
        let mut time_s = 1.7e9;
        let rows = steps.into_iter().map(|(step_s, v, omega, voltage, current, power)| {
            time_s += step_s;
            [3.0, time_s, 0.0, v, omega, 0.0, 0.0, 0.0, voltage, current, power]
        });
        let bytes = npy_f8(&rows.collect::<Vec<_>>());
        let trial = Trial::read(Files::new().write("any.npy", &bytes)).unwrap();
        prop_assert_eq!(bits(&trial.to_samples(9, base_ns)), bits(&slow(&trial, 9, base_ns)));
        let held = trial.to_samples(9, 0).iter().filter(|sample| sample.has(HELD)).count();
        prop_assert_eq!(trial.notes().held_readings, held);
    }
}
