//! A snapshot in Prometheus's text format, which every scraper reads.

use std::fmt::{Display, Write as _};

use joulebus_board::{Counted, UPPER_S};
use joulebus_wire::{
    Alarm, AlarmCard, Budget, Diagnostic, Forecast, OUTLOOK_S, Outlook, budget_flag,
    diagnostic_flag, forecast_flag,
};

use super::entry::Entry;
use super::snapshot::Snapshot;

/// The type of the text.
pub(super) const KIND: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The metrics at `now_ns` (monotonic). At most `max_robots` robots have series of their own,
/// those with the smallest ids.
pub(super) fn text(
    snapshot: &Snapshot,
    outlooks: &[Outlook],
    now_ns: u64,
    (fleet, max_robots): (&str, usize),
) -> String {
    let metrics = Metrics { snapshot, outlooks, now_ns, max_robots };
    let mut families = Families { fleet: label("fleet", &fleet), text: String::new() };
    metrics.worker(&mut families);
    metrics.counts(&mut families);
    metrics.fleet(&mut families);
    metrics.robots(&mut families);
    families.text
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Counter,
    Gauge,
    Histogram,
    Info,
}

/// Families of metrics, one after the other, each with its series.
struct Families {
    /// The label that every series has.
    fleet: String,
    text: String,
}

impl Families {
    /// Begins a family, and returns the name of its samples.
    fn begin(&mut self, name: &str, help: &str, unit: Option<&str>, kind: Kind) -> String {
        let unit = unit.map(|unit| format!("_{unit}")).unwrap_or_default();
        let (suffix, typed) = match kind {
            Kind::Counter => ("_total", "counter"),
            Kind::Gauge => ("", "gauge"),
            Kind::Histogram => ("", "histogram"),
            Kind::Info => ("_info", "gauge"),
        };
        let name = format!("{name}{unit}{suffix}");
        self.line(format_args!("# HELP {name} {help}"));
        self.line(format_args!("# TYPE {name} {typed}"));
        name
    }

    fn line(&mut self, line: impl Display) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{line}");
    }

    fn sample<L: Display>(&mut self, name: &str, labels: &[(&str, L)], value: impl Display) {
        let _ = write!(self.text, "{name}{{{}", self.fleet);
        for (key, of) in labels {
            let _ = write!(self.text, ",{}", label(key, of));
        }
        self.line(format_args!("}} {value}"));
    }

    fn counter(&mut self, name: &str, help: &str, unit: Option<&str>, value: impl Display) {
        let name = self.begin(name, help, unit, Kind::Counter);
        self.sample(&name, &NO_LABELS, value);
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.gauges(name, help, None, [(NO_LABELS, value)]);
    }

    fn gauges<'a, L: Display>(
        &mut self,
        name: &str,
        help: &str,
        unit: Option<&str>,
        series: impl IntoIterator<Item = (impl AsRef<[(&'a str, L)]>, f64)>,
    ) {
        let name = self.begin(name, help, unit, Kind::Gauge);
        for (labels, value) in series {
            self.sample(&name, labels.as_ref(), Number(value));
        }
    }

    fn by_reason(
        &mut self,
        name: &str,
        help: &str,
        counts: impl Iterator<Item = (&'static str, u64)>,
    ) {
        let name = self.begin(name, help, None, Kind::Counter);
        for (reason, count) in counts {
            self.sample(&name, &[("reason", reason)], count);
        }
    }

    fn histogram(&mut self, name: &str, help: &str, counted: &Counted) {
        let name = self.begin(name, help, Some(SECONDS), Kind::Histogram);
        let sum_s = counted.sum_ns as f64 * 1e-9;
        self.sample(&format!("{name}_sum"), &NO_LABELS, Number(sum_s));
        let count: u64 = counted.counts.iter().sum();
        self.sample(&format!("{name}_count"), &NO_LABELS, count);
        let bucket = format!("{name}_bucket");
        let mut cumulative = 0;
        for (upper_s, count) in UPPER_S.into_iter().chain([f64::INFINITY]).zip(counted.counts) {
            cumulative += count;
            self.sample(&bucket, &[("le", Number(upper_s))], cumulative);
        }
    }
}

/// A number as the format writes it.
struct Number(f64);

impl Display for Number {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            f64::INFINITY => out.write_str("+Inf"),
            f64::NEG_INFINITY => out.write_str("-Inf"),
            // As a float, also if it is whole.
            value => write!(out, "{value:?}"),
        }
    }
}

fn label(key: &str, value: &impl Display) -> String {
    let value = value.to_string().replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n");
    format!("{key}=\"{value}\"")
}

#[derive(Debug)]
struct Metrics<'a> {
    snapshot: &'a Snapshot,
    outlooks: &'a [Outlook],
    now_ns: u64,
    max_robots: usize,
}

/// The labels of a metric without labels.
const NO_LABELS: [(&str, &str); 0] = [];
const JOULES: &str = "joules";
const RATIO: &str = "ratio";
const SECONDS: &str = "seconds";
const WATTS: &str = "watts";

type Labels = Vec<(&'static str, String)>;

impl Metrics<'_> {
    fn worker(&self, families: &mut Families) {
        let build = families.begin("joulebus_build", "Version of joulebus-serve", None, Kind::Info);
        families.sample(&build, &[("version", env!("CARGO_PKG_VERSION"))], 1);
        let up = self.snapshot.why_not_up(self.now_ns).is_none();
        families.gauge(
            "joulebus_worker_up",
            "1 while frames of a worker arrive in time and are read, else 0",
            up.into(),
        );
        let counters = &self.snapshot.accumulated;
        families.histogram(
            "joulebus_tick",
            "Time from a tick's begin to its last forecast written",
            &counters.tick,
        );
        families.histogram(
            "joulebus_forecast_latency",
            "Time from a sample sent to its forecast sent",
            &counters.latency,
        );
    }

    fn counts(&self, families: &mut Families) {
        let counters = &self.snapshot.accumulated;
        for (name, help, count) in [
            ("joulebus_ticks", "Ticks done", counters.ticks),
            (
                "joulebus_tick_deadline_missed",
                "Ticks that started over a tenth of a period late",
                counters.ticks_late,
            ),
            (
                "joulebus_ticks_skipped",
                "Ticks skipped because the one before took too long",
                counters.ticks_skipped,
            ),
            (
                "joulebus_samples_accepted",
                "Samples that the worker accepted",
                counters.samples_accepted,
            ),
            (
                "joulebus_questions_answered",
                "Questions about plans that the worker answered",
                counters.queries.answered,
            ),
        ] {
            families.counter(name, help, None, count);
        }
        let dropped = counters.samples_dropped.iter();
        let dropped = dropped.map(|(reason, count)| (reason.name(), count));
        families.by_reason("joulebus_samples_dropped", "Samples that the worker dropped", dropped);
        let refused = counters.queries.iter().map(|(reason, count)| (reason.name(), count));
        families.by_reason(
            "joulebus_questions_refused",
            "Questions about plans that the worker refused",
            refused,
        );
    }

    fn fleet(&self, families: &mut Families) {
        let totals = &self.snapshot.fleet.totals;
        let levels = [
            ("ok", totals.ok),
            ("warn", totals.warn),
            ("error", totals.error),
            ("stale", totals.stale),
        ];
        let levels = levels.map(|(level, count)| (vec![("level", level.to_owned())], count as f64));
        families.gauges("joulebus_robots", "Robots at each level", None, levels);
        let mut raised = [0_u32; Alarm::ALL.len()];
        for diagnostic in self.snapshot.entries().iter().filter_map(|entry| entry.newest.diagnostic)
        {
            for (count, alarm) in raised.iter_mut().zip(Alarm::ALL) {
                *count += u32::from(diagnostic.alarms().has(alarm));
            }
        }
        let alarms = Alarm::ALL.iter().zip(raised);
        let alarms =
            alarms.map(|(alarm, count)| (vec![("alarm", alarm.name().to_owned())], count.into()));
        let card = AlarmCard::IMPLAUSIBLE;
        let implausible = self.snapshot.alarms.raised.iter();
        let implausible = implausible.filter(|raised| raised.is(&card)).count() as u32;
        let of_sources = (vec![("alarm", card.name.to_owned())], implausible.into());
        let alarms = alarms.chain([of_sources]);
        families.gauges("joulebus_alarms", "Alarms that are raised", None, alarms);
        let power_w = totals.power_w.map(|power_w| (NO_LABELS, power_w));
        families.gauges(
            "joulebus_fleet_power",
            "Sum of the robots' newest readings",
            Some(WATTS),
            power_w,
        );
        let consumed_j = Number(self.snapshot.accumulated.consumed_uj as f64 * 1e-6);
        families.counter(
            "joulebus_fleet_consumed",
            "Energy consumed by all robots. It does not fall when robots leave",
            Some(JOULES),
            consumed_j,
        );
    }

    fn robots(&self, families: &mut Families) {
        let all = self.snapshot.entries();
        let robots = &all[..all.len().min(self.max_robots)];
        let beyond = (all.len() - robots.len()) as f64;
        families.gauge(
            "joulebus_robots_without_series",
            "Robots beyond --metrics-robots, without metrics of their own",
            beyond,
        );
        if robots.is_empty() {
            return;
        }
        consumed(families, robots);
        let power = robots.iter().flat_map(|entry| {
            let kinds = power_w(&entry.newest.forecast);
            kinds.into_iter().filter_map(|(kind, value)| {
                let mut labels = of(entry);
                labels.push(("kind", kind.to_owned()));
                Some((labels, value?))
            })
        });
        families.gauges(
            "joulebus_power",
            "Newest reading, forecast of the next reading, and the ends of its interval",
            Some(WATTS),
            power,
        );
        let now_ns = self.now_ns;
        let series = |value: &dyn Fn(&Entry) -> Option<f64>| -> Vec<(Labels, f64)> {
            let known = |entry| Some((of(entry), value(entry)?));
            robots.iter().filter_map(known).collect()
        };
        let residual = series(&|entry| residual_w(entry.newest.diagnostic.as_ref()?));
        families.gauges(
            "joulebus_residual",
            "Reading minus the network's forecast",
            Some(WATTS),
            residual,
        );
        let soc = series(&|entry| {
            battery(entry.newest.budget.as_ref()?, budget_flag::CHARGE, |budget| budget.soc)
        });
        families.gauges("joulebus_soc", "State of charge, 0 to 1", Some(RATIO), soc);
        let left = series(&|entry| {
            battery(entry.newest.budget.as_ref()?, budget_flag::TIME_TO_EMPTY, |budget| {
                budget.time_to_empty_s
            })
        });
        families.gauges(
            "joulebus_time_to_empty",
            "Expected time until the battery is empty",
            Some(SECONDS),
            left,
        );
        let to_full = series(&|entry| {
            let budget = entry.newest.budget.as_ref()?;
            budget.charging_s(budget.soc.into(), 1.0)
        });
        families.gauges(
            "joulebus_time_to_full",
            "Time on the charger until the battery is full, by earlier charges",
            Some(SECONDS),
            to_full,
        );
        let capacity = series(&|entry| Some(entry.newest.budget?.learned_capacity_j()?.0.into()));
        families.gauges(
            "joulebus_capacity",
            "Learned capacity of the battery",
            Some(JOULES),
            capacity,
        );
        let last = robots.last().map_or(0, |entry| entry.robot);
        let outlooks = self.outlooks.iter().filter(|outlook| outlook.robot <= last);
        let ahead = outlooks.flat_map(|outlook| {
            OUTLOOK_S.into_iter().enumerate().flat_map(move |(place, horizon_s)| {
                let bounds_j = outlook.bounds_j(place);
                let kinds = [
                    ("forecast", outlook.expected_j(place)),
                    ("lo", bounds_j.map(|(lo_j, _)| lo_j)),
                    ("hi", bounds_j.map(|(_, hi_j)| hi_j)),
                ];
                kinds.into_iter().filter_map(move |(kind, joules)| {
                    let robot = ("robot", outlook.robot.to_string());
                    let horizon = ("horizon_s", horizon_s.to_string());
                    Some((vec![robot, horizon, ("kind", kind.to_owned())], joules?.into()))
                })
            })
        });
        families.gauges("joulebus_energy_ahead",
            "Energy over the next seconds if the robot goes on as now, and the ends of its interval",
            Some(JOULES),
            ahead,
        );
        let age = series(&|entry| Some(entry.sample_age_ns(now_ns)? as f64 * 1e-9));
        families.gauges(
            "joulebus_sample_age",
            "Time since the newest sample's stamp",
            Some(SECONDS),
            age,
        );
        let health = series(&|entry| Some(entry.newest.level().code().into()));
        families.gauges("joulebus_health_level", "0 ok, 1 warn, 2 error, 3 stale", None, health);
    }
}

fn consumed(families: &mut Families, robots: &[Entry]) {
    let name = families.begin(
        "joulebus_consumed",
        "Greatest energy drawn that the robot's ledger counted. It does not fall when energy is fed back",
        Some(JOULES),
        Kind::Counter,
    );
    for entry in robots {
        if let Some(consumed_uj) = entry.consumed_uj {
            families.sample(&name, &of(entry), Number(consumed_uj as f64 * 1e-6));
        }
    }
}

fn power_w(forecast: &Forecast) -> [(&'static str, Option<f64>); 4] {
    let read = forecast.flags & forecast_flag::READING != 0;
    let interval_w = forecast.interval_w();
    [
        ("reading", read.then(|| forecast.reading_w.into())),
        ("forecast", forecast.expected_w().map(f64::from)),
        ("lo", interval_w.map(|(lo_w, _)| lo_w.into())),
        ("hi", interval_w.map(|(_, hi_w)| hi_w.into())),
    ]
}

fn residual_w(diagnostic: &Diagnostic) -> Option<f64> {
    let scored = diagnostic.flags & diagnostic_flag::RESIDUAL != 0;
    scored.then(|| f64::from(diagnostic.residual_w)).filter(|value| value.is_finite())
}

fn battery(budget: &Budget, flag: u32, value: fn(&Budget) -> f32) -> Option<f64> {
    let known = budget.flags & flag != 0;
    known.then(|| f64::from(value(budget))).filter(|value| value.is_finite())
}

fn of(entry: &Entry) -> Labels {
    vec![("robot", entry.robot.to_string())]
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use joulebus_board::{Board, Link, Platforms};
    use joulebus_testkit::assert_page_contains;
    use joulebus_wire::{CHARGE_TENTHS, DropReason, ForecastHeader, QueryCounts, QueryRefusal};

    use super::super::alarms::Alarms;
    use super::super::fleet::{Around, Distributions, FleetRecord};
    use super::super::totals::Accumulator;
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    /// The snapshot of a fleet at the end of the first second.
    fn snapshot(board: &Board) -> Arc<Snapshot> {
        let around = Around {
            fleet: "lab",
            period_ns: 33_333_333,
            stale_after_ns: 1_000_000_000,
            now_ns: SECOND_NS,
            now_unix_ns: SECOND_NS,
            distributions: &Distributions::default(),
            recorders: None,
            model_warnings: &[],
            without_worker: "",
        };
        Arc::new(Snapshot::new(
            board,
            FleetRecord::new(board, &around),
            Arc::<Alarms>::default(),
            &mut Accumulator::default(),
            SECOND_NS,
            Arc::new(Platforms::default()),
        ))
    }

    #[test]
    fn a_worker_is_not_up_when_the_reading_thread_shows_nothing_more() {
        let mut board = Board::new(0);
        board.link = Link::Live;
        let snapshot = snapshot(&board);
        for (now_ns, up) in [(SECOND_NS, 1), (3 * SECOND_NS, 1), (3 * SECOND_NS + 1, 0)] {
            let why = snapshot.why_not_up(now_ns);
            assert_eq!(why.is_none(), up == 1, "{why:?}");
            let text = text(&snapshot, &[], now_ns, ("lab", 0));
            let line = format!("joulebus_worker_up{{fleet=\"lab\"}} {up}");
            assert!(text.contains(&line), "{now_ns}: {text}");
        }
        let why = snapshot.why_not_up(9 * SECOND_NS).unwrap_or_default();
        assert!(why.contains("for 8.0 s, 2.0 s are allowed"), "{why}");
    }

    /// Values of these labels are not listed.
    const MANY: [&str; 3] = ["robot", "alarm", "version"];

    /// `JOULEBUS_WRITE=1 cargo test -p joulebus-serve --bins every_metric` writes the page.
    #[test]
    fn the_page_about_metrics_has_every_metric() {
        let mut board = Board::new(0);
        let forecast = Forecast { robot: 1, flags: u32::MAX, ..Forecast::default() };
        let mut header = ForecastHeader::default();
        DropReason::ALL.into_iter().for_each(|reason| header.samples_dropped.add(reason, 1));
        board.forecasts(&header, &[forecast], 0);
        let mut queries = QueryCounts::default();
        QueryRefusal::ALL.into_iter().for_each(|reason| queries.refuse(reason));
        board.queries = Some(queries);
        board.diagnostics(&[Diagnostic { robot: 1, flags: u32::MAX, ..Diagnostic::default() }], 0);
        board.budgets(&[Budget {
            robot: 1,
            flags: u32::MAX,
            charge_rate: [100; CHARGE_TENTHS],
            capacity_j: 1.0,
            capacity_sd_j: 0.1,
            ..Budget::default()
        }]);
        let outlook =
            Outlook { robot: 1, flags: u32::MAX, bounded: u16::MAX, ..Outlook::default() };
        let text = text(&snapshot(&board), &[outlook], SECOND_NS, ("lab", 1));
        let mut tables = [String::new(), String::new()];
        for family in text.split("# HELP ").skip(1) {
            let (name, rest) = family.split_once(' ').unwrap();
            let (help, rest) = rest.split_once('\n').unwrap();
            let (typed, samples) = rest.split_once('\n').unwrap();
            let kind = typed.rsplit(' ').next().unwrap();
            let mut labels: Vec<(&str, Vec<&str>)> = Vec::new();
            for sample in samples.lines() {
                let (_, sample) = sample.split_once('{').unwrap();
                for label in sample.split("\",").filter_map(|label| label.split_once("=\"")) {
                    let value = label.1.split('"').next().unwrap();
                    match labels.iter_mut().find(|known| known.0 == label.0) {
                        _ if ["fleet", "le"].contains(&label.0) => {}
                        Some((_, values)) if values.contains(&value) => {}
                        Some((_, values)) => values.push(value),
                        None => labels.push((label.0, vec![value])),
                    }
                }
            }
            assert!(samples.contains('{'), "{name} has no value");
            let is_of_robot = labels.iter().any(|(label, _)| *label == "robot");
            let described = labels.iter().map(|(label, values)| match MANY.contains(label) {
                true => format!("`{label}`"),
                false => format!("`{label}`: {}", values.join(", ")),
            });
            let described: Vec<String> = described.filter(|label| label != "`robot`").collect();
            tables[usize::from(is_of_robot)] +=
                &format!("| `{name}` | {kind} | {} | {help} |\n", described.join("<br>"));
        }
        let head = "| metric | type | labels | meaning |\n|---|---|---|---|\n";
        let tables = tables.map(|rows| format!("{head}{rows}"));
        assert_page_contains("docs/reference/metrics.md", &tables);
    }
}
