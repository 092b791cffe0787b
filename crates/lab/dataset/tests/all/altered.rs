//! Altered copies of recordings are told from other recordings by the shape of their power.

use joulebus_dataset::altered::Shapes;
use joulebus_dataset::rows::{Row, sample_rows};
use joulebus_statistics::noise::Noise;
use joulebus_wire::Sample;

const PERIOD_NS: u64 = 33_000_000;

/// Readings of a robot whose power wanders, in mW, W.
fn driving(seed: u64, rows: usize) -> Vec<f32> {
    let mut noise = Noise::new(seed, 0);
    let mut power_w = 30.0_f64;
    let mut next = || {
        power_w = 0.9 * power_w + 3.0 + (noise.below(4_001) as f64 - 2_000.0) * 1e-3;
        ((power_w * 1e3).round() * 1e-3) as f32
    };
    (0..rows).map(|_| next()).collect()
}

fn rows(powers_w: &[f32]) -> Vec<Row> {
    let samples = (1..).zip(powers_w).map(|(seq, power_w)| {
        let stamp_ns = seq * PERIOD_NS;
        Sample::new(0, seq, stamp_ns).reading(*power_w, stamp_ns)
    });
    let samples: Vec<Sample> = samples.collect();
    sample_rows(&samples, PERIOD_NS).rows
}

/// Share of a recording's rows whose shape is that of the other.
fn share(recording: &[f32], of: &[f32]) -> f64 {
    let (recording, mut shapes) = (rows(recording), Shapes::default());
    shapes.add(&rows(of));
    shapes.matches(&recording) as f64 / recording.len() as f64
}

fn every(powers_w: &[f32], nth: usize) -> Vec<f32> {
    powers_w.iter().copied().step_by(nth).collect()
}

#[test]
fn scaled_reversed_and_thinned_copies_have_the_shape_of_the_recording() {
    let whole = driving(5, 1_200);
    let backward: Vec<f32> = whole.iter().rev().copied().collect();
    let scaled = |factor: f32| whole.iter().map(|power_w| power_w * factor).collect::<Vec<f32>>();
    for (what, copy) in [
        ("itself", whole.clone()),
        ("scaled a bit", scaled(1.0005)),
        ("in another unit", scaled(1e3)),
        ("reversed", backward.clone()),
        ("every second", every(&whole, 2)),
        ("every fourth", every(&whole, 4)),
        ("every third, reversed", every(&backward, 3)),
        ("every second, scaled", every(&scaled(1.0005), 2)),
    ] {
        let found = share(&copy, &whole);
        assert!((0.5..=1.0).contains(&found), "{what}: {found}");
    }
    // The recording is the finer one.
    assert!(share(&whole, &every(&whole, 2)) >= 0.4);
}

#[test]
fn other_recordings_have_no_common_shape() {
    let whole = driving(5, 2_000);
    for seed in 100..120 {
        assert_eq!(share(&driving(seed, 2_000), &whole), 0.0, "{seed}");
    }
    // Resting robots have the same short sequences of few readings.
    let resting = |seed: u64| -> Vec<f32> {
        let mut noise = Noise::new(seed, 1);
        (0..2_000).map(|_| 3.5 + 0.01 * noise.below(2) as f32).collect()
    };
    let found: f64 = (0..20).map(|seed| share(&resting(seed + 1), &resting(0))).sum();
    assert!(found < 0.02, "{found}");
    assert_eq!(share(&[0.0; 200], &[0.0; 200]), 0.0);
    assert_eq!(share(&[1.0; 20], &whole), 0.0);
}
