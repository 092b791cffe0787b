//! Comparison of two runs.

use joulebus_bench::{Better, Comparison, Distribution, Figure, Report, Suite, Verdict};
use joulebus_testkit::assert_contains;

fn spread(median: f64, half_width: f64) -> Distribution {
    let values: Vec<f64> = (-2..=2).map(|step| median + f64::from(step) * half_width).collect();
    Distribution::new(&values).expect("there are values")
}

fn figure(name: &str, better: Better, median: f64) -> Figure {
    Figure {
        name: name.to_owned(),
        case: "100 robots".to_owned(),
        unit: "ns".to_owned(),
        better,
        spread: spread(median, median / 100.0),
    }
}

fn suite(figures: Vec<Figure>) -> Suite {
    let mut report = Report::new("kernel").with_input("seed", 7);
    report.figures = figures;
    Suite::here(vec![report])
}

#[test]
fn worse_is_reported_for_either_direction_of_improvement() {
    for (better, old, new, verdict, times_worse) in [
        (Better::Less, 100.0, 200.0, Verdict::Worse, 2.0),
        (Better::Less, 200.0, 100.0, Verdict::Better, 0.5),
        (Better::More, 100.0, 200.0, Verdict::Better, 0.5),
        (Better::More, 200.0, 100.0, Verdict::Worse, 2.0),
        (Better::Less, 100.0, 101.0, Verdict::WithinNoise, 1.01),
        (Better::More, 100.0, 101.0, Verdict::WithinNoise, 100.0 / 101.0),
    ] {
        let old = suite(vec![figure("ns_per_robot", better, old)]);
        let new = suite(vec![figure("ns_per_robot", better, new)]);
        let comparison = Comparison::new(&old, &new).expect("a figure in common");
        let change = &comparison.changes[0];
        assert_eq!(change.verdict, verdict, "{change:?}");
        assert!((change.times_worse - times_worse).abs() < 1e-12, "{change:?}");
    }
}

#[test]
fn only_what_is_worse_beyond_noise_and_beyond_the_ratio_is_too_slow() {
    let of = |medians: [f64; 3]| {
        let figures = ["a", "b", "c"].into_iter().zip(medians);
        let figures = figures.map(|(name, median)| figure(name, Better::Less, median));
        suite(figures.collect())
    };
    let comparison = Comparison::new(&of([100.0; 3]), &of([100.5, 120.0, 150.0]));
    let comparison = comparison.expect("figures in common");
    let worse_than = |ratio| -> Vec<&str> {
        let worse = comparison.worse_than(ratio);
        worse.map(|change| change.name.as_str()).collect()
    };
    assert_eq!(worse_than(1.0), ["kernel b, 100 robots", "kernel c, 100 robots"]);
    assert_eq!(worse_than(1.3), ["kernel c, 100 robots"]);
    assert!(worse_than(2.0).is_empty());
}

#[test]
fn figures_of_one_run_alone_are_named_and_not_compared() {
    let old = suite(vec![figure("kept", Better::Less, 1.0), figure("gone", Better::Less, 1.0)]);
    let new = suite(vec![figure("kept", Better::Less, 1.0), figure("fresh", Better::Less, 1.0)]);
    let comparison = Comparison::new(&old, &new).expect("a figure in common");
    assert_eq!(comparison.changes.len(), 1);
    let missing = ["only now: kernel fresh, 100 robots", "only before: kernel gone, 100 robots"];
    assert_eq!(comparison.missing, missing);
    assert_contains(&comparison.to_string(), missing);
}

#[test]
fn another_unit_is_another_figure() {
    let old = suite(vec![figure("time", Better::Less, 1.0)]);
    let mut new = old.clone();
    new.reports[0].figures[0].unit = "ms".to_owned();
    let refused = Comparison::new(&old, &new).expect_err("nothing in common");
    assert_contains(&refused, ["none of the 1 new figures is among the 1 old ones"]);
}

#[test]
fn another_layout_is_refused_with_what_was_found() {
    let new = suite(vec![figure("time", Better::Less, 1.0)]);
    let mut old = new.clone();
    old.schema = "joulebus-bench/0".to_owned();
    let refused = Comparison::new(&old, &new).expect_err("another layout");
    assert_contains(&refused, ["joulebus-bench/0"]);
}

#[test]
fn a_different_machine_build_or_input_is_reported() {
    let new = suite(vec![figure("time", Better::Less, 1.0)]);
    let mut old = new.clone();
    old.machine.insert("processor".to_owned(), "abacus".into());
    old.build.insert("rustc".to_owned(), "rustc 0.1".into());
    old.reports[0].input.insert("seed".to_owned(), "8".into());
    let comparison = Comparison::new(&old, &new).expect("a figure in common");
    assert_eq!(comparison.differing.len(), 3);
    let text = comparison.to_string();
    assert_contains(&text, ["abacus", "rustc 0.1", "seed 8 before, now 7"]);
    let same = Comparison::new(&new, &new).expect("a figure in common");
    assert!(same.differing.is_empty());
}
