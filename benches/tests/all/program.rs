//! Benchmarks run and report; speed is never tested.

use std::fs;
use std::path::Path;
use std::process::Command;

use joulebus_testkit::{Child, Ended, end_signals, run};
use serde_json::Value;

fn output<'a>(arguments: impl IntoIterator<Item = &'a str>) -> Ended {
    run(env!("CARGO_BIN_EXE_joulebus-bench"), arguments)
}

fn figures(suite: &Value) -> Vec<&Value> {
    let reports = suite["reports"].as_array().unwrap();
    reports.iter().flat_map(|report| report["figures"].as_array().unwrap()).collect()
}

#[test]
fn a_quick_measurement_gives_finite_figures_with_machine_and_build() {
    let measured = output(["kernel", "--quick", "--format", "json"]).exits(0);
    let suite = measured.json();
    for (part, name) in [("machine", "processor"), ("build", "rustc"), ("build", "iceoryx2")] {
        assert!(suite[part][name].as_str().unwrap().len() > 2, "{part} {name}");
    }
    let iceoryx2 = suite["build"]["iceoryx2"].as_str().unwrap();
    let pinned = format!("iceoryx2 = {{ version = \"={iceoryx2}\"");
    assert!(include_str!("../../../Cargo.toml").contains(&pinned), "{pinned}");
    let input = &suite["reports"][0]["input"];
    assert_eq!((&input["seed"], &input["model"]), (&"7".into(), &"builtin:gternal-sim".into()));
    let figures = figures(&suite);
    assert!(figures.iter().any(|figure| figure["name"] == "scalar_ns_per_robot"));
    for figure in figures {
        for quantile in ["min", "p25", "p50", "p75", "p99", "p999", "max"] {
            let value = figure[quantile].as_f64();
            assert!(value.is_some_and(|value| value > 0.0), "{quantile} of {figure}");
        }
        assert!(figure["count"].as_u64().unwrap() > 0, "{figure}");
    }
}

#[test]
fn the_tick_and_rollouts_are_measured_too() {
    for (benchmark, name) in [("tick", "tick_over_kernel"), ("rollout", "ns_per_step")] {
        let measured =
            output(format!("{benchmark} --quick --robots 10 --format json").split(' ')).exits(0);
        let suite = measured.json();
        let figures = figures(&suite);
        assert!(figures.iter().any(|figure| figure["name"] == name), "{figures:?}");
    }
}

#[test]
fn invalid_requests_are_refused_before_measuring() {
    for (more, exit, expected) in
        [(vec!["--kernel", "abacus"], 1, "scalar"), (vec!["--robots", "0"], 2, "1..=1000000")]
    {
        let arguments = ["kernel", "--quick"].into_iter().chain(more.iter().copied());
        let refused = output(arguments);
        assert_eq!(refused.exit_code(), exit, "{more:?}: {}", refused.errors());
        assert!(refused.errors().contains(expected), "{more:?}: {}", refused.errors());
        assert_eq!(refused.text(), "", "{more:?}");
    }
}

#[test]
fn a_signal_ends_a_measurement_between_processes_and_leaves_no_files() {
    for signal in end_signals() {
        // Three at the same time: none removes the others' files.
        let mut benches: Vec<Child> = (0..3)
            .map(|_| {
                let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-bench"));
                command.args(["latency", "--robots", "1", "--seconds", "3600"]);
                Child::spawn("bench", command)
            })
            .collect();
        for bench in &mut benches {
            bench.wait_for_line("latency: 1 robots");
            bench.signal(signal);
        }
        for bench in &mut benches {
            let ended = bench.wait();
            assert_eq!(ended.exit_code(), 1, "{ended:?}");
            assert!(ended.errors().contains("interrupted"), "{ended:?}");
            let pid = bench.pid().to_string();
            for folder in [Path::new("/dev/shm"), &std::env::temp_dir()] {
                let names = fs::read_dir(folder).unwrap().flatten();
                let left = names.map(|entry| entry.file_name().into_string().unwrap_or_default());
                let own = [format!("-{pid}"), format!("jbraw_{pid}_")];
                let left: Vec<String> = left
                    .filter(|name| name.starts_with("joulebus-bench") || name.starts_with("jbraw_"))
                    .filter(|name| own.iter().any(|own| name.contains(own)))
                    .collect();
                assert_eq!(left, Vec::<String>::new(), "{signal:?}");
            }
        }
    }
}
