//! Complete real recordings of three platforms.

use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use joulebus_dataset::trial::{Column, Trial};
use joulebus_testkit::recordings::trials;
use joulebus_wire::sample_flag::{OMEGA, POWER, V};

fn read_all(platform: &str) -> Option<Vec<Trial>> {
    let read = |path: &PathBuf| Trial::read(path).unwrap_or_else(|error| panic!("{error}"));
    Some(trials(platform)?.iter().map(read).collect())
}

const PLATFORMS: [(&str, usize, usize); 3] =
    [("robotino", 648, 264_476), ("borealtc_husky", 72, 54_151), ("ase_rover", 60, 28_260)];

/// Rows, trapezoid energy in J and mean power in W, from the text alone.
fn by_hand(path: &Path) -> (usize, f64, f64) {
    let mut text = String::new();
    let file = std::fs::File::open(path).unwrap();
    GzDecoder::new(file).read_to_string(&mut text).unwrap();
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').collect::<Vec<_>>();
    let position = |name: &str| names.iter().position(|found| *found == name).unwrap();
    let (time, power) = (position("timestamp_s"), position("power_mW"));
    let rows = lines
        .map(|line| {
            let fields = line.split(',').collect::<Vec<_>>();
            let number = |at: usize| fields[at].parse::<f64>().unwrap();
            (number(time), number(power) / 1000.0)
        })
        .collect::<Vec<_>>();
    let steps = rows.windows(2);
    let energy_j = steps.map(|w| (w[1].0 - w[0].0) * (w[0].1 + w[1].1) / 2.0).sum();
    let total_w = rows.iter().map(|row| row.1).sum::<f64>();
    (rows.len(), energy_j, total_w / rows.len() as f64)
}

#[test]
fn every_recording_of_three_platforms_reads_with_every_row_and_its_energy() {
    for (platform, trials, rows) in PLATFORMS {
        let Some(found) = read_all(platform) else {
            return;
        };
        assert_eq!(found.len(), trials, "{platform}");
        assert_eq!(found.iter().map(Trial::rows).sum::<usize>(), rows, "{platform}");
        for trial in &found {
            let context = trial.path().display();
            let samples = trial.to_samples(1, 0);
            // In the samples, the reading of sample k belongs to the stamp of sample k − 1.
            let readings = std::iter::once(0)
                .chain(samples.iter().map(|sample| sample.stamp_ns))
                .zip(&samples)
                .collect::<Vec<_>>();
            let energy_j = readings
                .windows(2)
                .map(|w| {
                    let mean_w = f64::from(w[0].1.power_w) + f64::from(w[1].1.power_w);
                    (w[1].0 - w[0].0) as f64 / 1e9 * mean_w / 2.0
                })
                .sum::<f64>();
            let power_w = trial.column(Column::Power).unwrap();
            let mean_w = power_w.iter().sum::<f64>() / power_w.len() as f64;
            let (hand_rows, hand_energy_j, hand_mean_w) = by_hand(trial.path());
            assert_eq!(trial.rows(), hand_rows, "{context}");
            let near = |found: f64, wanted: f64| (found - wanted).abs() <= 1e-6 * wanted.abs();
            assert!(near(energy_j, hand_energy_j), "{context}: {energy_j} J, {hand_energy_j} J");
            assert!(near(mean_w, hand_mean_w), "{context}: {mean_w} W, {hand_mean_w} W");
        }
    }
}

#[test]
fn the_husky_runs_at_its_own_rate_without_gaps() {
    let Some(trials) = read_all("borealtc_husky") else {
        return;
    };
    for trial in trials {
        let notes = trial.notes();
        let context = trial.path().display();
        assert!((notes.rate_hz - 6.5).abs() < 0.01, "{context}: {} Hz", notes.rate_hz);
        assert!(notes.is_clean(), "{context}: {notes}");
        assert!(trial.column(Column::X).is_none() && trial.column(Column::V).is_some());
    }
}

#[test]
fn the_rover_has_no_velocities_and_its_samples_state_it() {
    let Some(trials) = read_all("ase_rover") else {
        return;
    };
    for trial in trials {
        let missing = [Column::V, Column::Omega, Column::Voltage, Column::Current, Column::X];
        for column in missing {
            assert!(trial.notes().missing_columns.contains(&column), "{column:?}");
            assert!(trial.column(column).is_none(), "{column:?}");
        }
        for sample in trial.to_samples(1, 0) {
            assert_eq!(sample.flags & (V | OMEGA), 0);
            assert!(sample.v_mps.is_nan() && sample.omega_radps.is_nan());
            assert!(sample.has(POWER));
        }
        assert!((trial.notes().rate_hz - 30.0).abs() < 0.1);
    }
}

#[test]
fn the_robotino_has_reported_gaps_and_increasing_stamps() {
    let Some(trials) = read_all("robotino") else {
        return;
    };
    let longest_ns =
        trials.iter().flat_map(|trial| &trial.notes().gaps).map(|gap| gap.length_ns).max();
    assert_eq!(longest_ns.map(|ns| (ns as f64 / 1e7).round() as u64), Some(68), "0.68 s");
    for trial in trials {
        let advancing = trial.notes().not_advancing.is_empty();
        let samples = trial.to_samples(1, 0);
        let rising = samples.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns);
        assert_eq!(rising, advancing, "{}", trial.path().display());
        let last = samples.last().unwrap();
        assert!(last.has(POWER) && last.flags & (V | OMEGA) == 0);
    }
}
