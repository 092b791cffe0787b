//! The report in the format shared by all benchmarks.

use joulebus_latency::Spread;

use super::Row;
use crate::figure::robots;
use crate::{Distribution, Figure, Report};

/// Figures with names and cases, for text, JSON and comparison.
pub(super) fn report(input: &str, rows: &[Row]) -> Report {
    let mut report = Report::new("latency").with_input("input", input);
    for (name, of) in TIMES {
        let figures = rows.iter().filter_map(|row| {
            let spread = distribution(of(row))?;
            Some(Figure::less(name, &robots(row.robots), "µs", spread))
        });
        report.figures.extend(figures);
    }
    for (name, unit, of) in ONCE {
        for row in rows {
            report.push(Figure::less, name, &robots(row.robots), unit, &[of(row)]);
        }
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

/// The distribution, µs. `None` if nothing was measured.
pub fn distribution(spread: &Spread) -> Option<Distribution> {
    (spread.count > 0).then_some(Distribution {
        count: spread.count,
        min: spread.min_us,
        p25: spread.p25_us,
        p50: spread.p50_us,
        p75: spread.p75_us,
        p99: spread.p99_us,
        p999: spread.p999_us,
        max: spread.max_us,
    })
}
