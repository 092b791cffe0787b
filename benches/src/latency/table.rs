//! The report as text.

use std::fmt;

use super::{Report, Row};
use crate::line;

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}; µs: p50, p99, p99.9, max", self.input)?;
        self.rows.iter().try_for_each(|row| write!(out, "{row}"))
    }
}

impl fmt::Display for Row {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "\n{} robots ({} frames missed, {} places passed over)",
            self.robots, self.missed, self.passed_over
        )?;
        for (name, spread) in [
            ("sample due → forecast readable", &self.end_to_end_us),
            ("  the source wakes and writes", &self.source_us),
            (
                "  sample sent → forecast readable",
                &self.sent_to_readable_us,
            ),
            ("    sample sent → taken by the worker", &self.one_way_us),
            ("    compute", &self.compute_us),
            ("whole tick", &self.tick_us),
            ("two raw hops, due → read", &self.raw_two_hops_us),
            ("bare kernel after the same sleep", &self.kernel_us),
        ] {
            writeln!(out, "{name:<38}{}", line(spread))?;
        }
        writeln!(
            out,
            "end to end / (raw + kernel): p50 {:.2}, p99 {:.2}",
            self.ratio_p50, self.ratio_p99
        )?;
        let each = self.worker_bytes as f64 / self.robots as f64;
        writeln!(
            out,
            "memory of the worker's own: {} kB, {each:.0} bytes a robot",
            self.worker_bytes / 1024
        )
    }
}
