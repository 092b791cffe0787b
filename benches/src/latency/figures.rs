//! The report in the format shared by all benchmarks.

use joulebus_latency::Spread;

use super::Row;
use crate::Report;
use crate::report::robots;

/// Figures with names and cases, for text, JSON and comparison.
pub(super) fn report(input: &str, rows: &[Row]) -> Report {
    let mut report = Report::new("latency").with_input("input", input);
    for (name, of) in TIMES {
        rows.iter().for_each(|row| report.times(name, &robots(row.robots), of(row)));
    }
    for (name, unit, of) in ONCE {
        rows.iter().for_each(|row| report.less(name, &robots(row.robots), unit, &[of(row)]));
    }
    report
}

type Time = (&'static str, fn(&Row) -> &Spread);
type Once = (&'static str, &'static str, fn(&Row) -> f64);

const TIMES: [Time; 8] = [
    ("due_to_readable_us", |row| &row.broker.end_to_end_us),
    ("due_to_sent_us", |row| &row.broker.source_us),
    ("sent_to_readable_us", |row| &row.broker.sent_to_readable_us),
    ("sent_to_taken_us", |row| &row.broker.one_way_us),
    ("compute_us", |row| &row.broker.compute_us),
    ("whole_tick_us", |row| &row.broker.tick_us),
    ("two_raw_hops_us", |row| &row.raw_two_hops_us),
    ("kernel_after_sleep_us", |row| &row.kernel_us),
];

const ONCE: [Once; 5] = [
    ("over_hops_and_kernel_at_p50", "1", |row| row.ratio_p50),
    ("over_hops_and_kernel_at_p99", "1", |row| row.ratio_p99),
    ("worker_memory_bytes", "bytes", |row| row.broker.worker_bytes as f64),
    ("missed_frames", "frames", |row| row.broker.missed as f64),
    ("passed_over_frames", "frames", |row| row.passed_over as f64),
];
