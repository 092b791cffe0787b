//! Asking into memory of the caller allocates nothing.

use crate::world::{Rows, fleet};
use joulebus_plan::Candidates;
use joulebus_testkit::counting;

#[test]
fn questions_about_candidates_allocate_nothing() {
    const STEPS: usize = 50;
    let fleet = fleet();
    let robot = Rows::with_usable(60.0).robot(&fleet);
    let v: Vec<f32> = (0..16 * STEPS).map(|at| 0.2 * (at as f32).sin()).collect();
    let omega: Vec<f32> = v.iter().map(|v_mps| 5.0 * v_mps).collect();
    let candidates = Candidates::new(16, 1.0 / 30.0, &v, &omega).expect("allowed");
    let mut answers = robot.what_if(&candidates, 0.9).expect("allowed");
    let mut columns = [(); 3].map(|()| vec![0.0; 16 * STEPS]);
    let [power_w, by_v, by_omega] = &mut columns;
    let before = counting::calls();
    let copy = robot;
    copy.what_if_into(&candidates, 0.9, &mut answers).expect("allowed");
    copy.power_w(&candidates, power_w).expect("allowed");
    copy.gradient(&candidates, by_v, by_omega).expect("allowed");
    assert_eq!(counting::calls() - before, 0, "allocations");
}
