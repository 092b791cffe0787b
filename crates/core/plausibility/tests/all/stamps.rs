//! Stamps beside times of recording.

use joulebus_plausibility::{StampState, Stamps};

fn stamps(stamp_s: impl Fn(f64) -> Option<f64>) -> Stamps {
    let mut stamps = Stamps::default();
    for message in 0..200 {
        let log_s = 1_000.0 + f64::from(message) / 10.0;
        stamps.take(stamp_s(log_s), log_s);
    }
    stamps
}

#[test]
fn offsets_and_drifts_are_measured_and_stamps_that_are_none_are_named() {
    for offset_s in [0.0, 0.02, 0.09] {
        assert!(stamps(|log_s| Some(log_s - offset_s)).fits_log(), "{offset_s}");
    }
    for offset_s in [-90.0, -0.2, 0.15, 2.0, 900.0] {
        let found = stamps(|log_s| Some(log_s - offset_s + 1e-4));
        assert!(!found.fits_log(), "{offset_s}");
        let StampState::Good { offset_s: measured_s, drift_s } = found.state() else {
            panic!("{:?}", found.state());
        };
        assert!((measured_s - offset_s).abs() < 1e-3 && drift_s.abs() < 1e-6);
    }
    // A clock that is 2 % fast drifts by 0.4 s in 20 s.
    let drifts = stamps(|log_s| Some(log_s - 0.02 * (log_s - 1_000.0)));
    assert!(!drifts.fits_log(), "{:?}", drifts.state());
    assert_eq!(stamps(|_| None).state(), StampState::Missing);
    assert_eq!(stamps(|_| Some(12.0)).state(), StampState::Still);
    assert_eq!(stamps(|log_s| Some(log_s.floor())).state(), StampState::WholeSeconds);
    let back = stamps(|log_s| Some(if log_s > 1_010.0 { log_s - 30.0 } else { log_s }));
    assert!(matches!(back.state(), StampState::Backward(back_s) if (29.0..31.0).contains(&back_s)));
}
