//! A snapshot in Prometheus's text format, which every scraper reads.

use std::fmt;
use std::sync::Arc;

use joulebus_board::{Counted, UPPER_S};
use joulebus_wire::{
    Alarm, AlarmCard, Budget, Diagnostic, Forecast, OUTLOOK_S, Outlook, budget_flag,
    diagnostic_flag, forecast_flag,
};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeLabelSet, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use super::entry::Entry;
use super::snapshot::Snapshot;

/// The type of the text.
pub(super) const KIND: &str = "text/plain; version=0.0.4; charset=utf-8";

/// OpenMetrics, which the encoder writes, in Prometheus's own format: counters and infos are typed under their samples' names, and
/// an info is a gauge.
fn classic(open: &str) -> String {
    let mut text = String::with_capacity(open.len());
    let mut help = "";
    for line in open.lines() {
        if let Some(rest) = line.strip_prefix("# HELP ") {
            help = rest.split_once(' ').map_or("", |(_, help)| help);
        } else if let Some((name, kind)) =
            line.strip_prefix("# TYPE ").and_then(|typed| typed.split_once(' '))
        {
            let (suffix, kind) = match kind {
                "counter" => ("_total", kind),
                "info" => ("_info", "gauge"),
                "unknown" => ("", "untyped"),
                _ => ("", kind),
            };
            for part in ["# HELP ", name, suffix, " ", help, "\n# TYPE ", name, suffix] {
                text.push_str(part);
            }
            for part in [" ", kind, "\n"] {
                text.push_str(part);
            }
        } else if !line.starts_with('#') {
            text.push_str(line);
            text.push('\n');
        }
    }
    text
}

/// The metrics at `now_ns` (monotonic). At most `max_robots` robots have series of their own,
/// those with the smallest ids.
pub(super) fn text(
    snapshot: &Arc<Snapshot>,
    outlooks: Vec<Outlook>,
    now_ns: u64,
    (fleet, max_robots): (&str, usize),
) -> Result<String, fmt::Error> {
    let mut registry =
        Registry::with_labels([("fleet".into(), fleet.to_owned().into())].into_iter());
    registry.register_collector(Box::new(Metrics {
        snapshot: Arc::clone(snapshot),
        outlooks,
        now_ns,
        max_robots,
    }));
    let mut text = String::new();
    prometheus_client::encoding::text::encode(&mut text, &registry)?;
    Ok(classic(&text))
}

#[derive(Debug)]
struct Metrics {
    snapshot: Arc<Snapshot>,
    outlooks: Vec<Outlook>,
    now_ns: u64,
    max_robots: usize,
}

/// The labels of a metric without labels.
const NO_LABELS: [(&str, &str); 0] = [];

type Labels = Vec<(&'static str, String)>;

impl Collector for Metrics {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        self.worker(&mut encoder)?;
        self.counts(&mut encoder)?;
        self.fleet(&mut encoder)?;
        self.robots(&mut encoder)
    }
}

impl Metrics {
    fn worker(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let mut info = encoder.encode_descriptor(
            "joulebus_build",
            "Version of joulebus-serve",
            None,
            MetricType::Info,
        )?;
        info.encode_info(&vec![("version", env!("CARGO_PKG_VERSION"))])?;
        let up = self.snapshot.why_not_up(self.now_ns).is_none();
        gauge(
            encoder,
            "joulebus_worker_up",
            "1 while frames of a worker arrive in time and are read, else 0",
            up.into(),
        )?;
        let counters = &self.snapshot.accumulated;
        histogram(
            encoder,
            "joulebus_tick",
            "Time from a tick's begin to its last forecast written",
            &counters.tick,
        )?;
        histogram(
            encoder,
            "joulebus_forecast_latency",
            "Time from a sample sent to its forecast sent",
            &counters.latency,
        )
    }

    fn counts(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
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
            let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
            metric.encode_counter::<NoLabelSet, u64, f64>(&count, None)?;
        }
        let dropped = counters.samples_dropped.iter();
        let dropped = dropped.map(|(reason, count)| (reason.name(), count));
        by_reason(encoder, "joulebus_samples_dropped", "Samples that the worker dropped", dropped)?;
        let refused = counters.queries.iter().map(|(reason, count)| (reason.name(), count));
        by_reason(
            encoder,
            "joulebus_questions_refused",
            "Questions about plans that the worker refused",
            refused,
        )
    }

    fn fleet(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let totals = &self.snapshot.fleet.totals;
        let levels = [
            ("ok", totals.ok),
            ("warn", totals.warn),
            ("error", totals.error),
            ("stale", totals.stale),
        ];
        let levels = levels.map(|(level, count)| (vec![("level", level.to_owned())], count as f64));
        gauges(encoder, "joulebus_robots", "Robots at each level", None, levels)?;
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
        gauges(encoder, "joulebus_alarms", "Alarms that are raised", None, alarms)?;
        let power_w = totals.power_w.map(|power_w| (NO_LABELS, power_w));
        gauges(
            encoder,
            "joulebus_fleet_power",
            "Sum of the robots' newest readings",
            Some(&watts()),
            power_w,
        )?;
        let mut metric = encoder.encode_descriptor(
            "joulebus_fleet_consumed",
            "Energy consumed by all robots. It does not fall when robots leave",
            Some(&Unit::Joules),
            MetricType::Counter,
        )?;
        let consumed_j = self.snapshot.accumulated.consumed_uj as f64 * 1e-6;
        metric.encode_counter::<NoLabelSet, f64, f64>(&consumed_j, None)
    }

    fn robots(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let all = self.snapshot.entries();
        let robots = &all[..all.len().min(self.max_robots)];
        let beyond = (all.len() - robots.len()) as f64;
        gauge(
            encoder,
            "joulebus_robots_without_series",
            "Robots beyond --metrics-robots, without metrics of their own",
            beyond,
        )?;
        if robots.is_empty() {
            return Ok(());
        }
        consumed(encoder, robots)?;
        let power = robots.iter().flat_map(|entry| {
            let kinds = power_w(&entry.newest.forecast);
            kinds.into_iter().filter_map(|(kind, value)| {
                let mut labels = of(entry);
                labels.push(("kind", kind.to_owned()));
                Some((labels, value?))
            })
        });
        gauges(
            encoder,
            "joulebus_power",
            "Newest reading, forecast of the next reading, and the ends of its interval",
            Some(&watts()),
            power,
        )?;
        let now_ns = self.now_ns;
        let ratio = Unit::Other("ratio".to_owned());
        let series = |value: &dyn Fn(&Entry) -> Option<f64>| -> Vec<(Labels, f64)> {
            let known = |entry| Some((of(entry), value(entry)?));
            robots.iter().filter_map(known).collect()
        };
        let residual = series(&|entry| residual_w(entry.newest.diagnostic.as_ref()?));
        gauges(
            encoder,
            "joulebus_residual",
            "Reading minus the network's forecast",
            Some(&watts()),
            residual,
        )?;
        let soc = series(&|entry| {
            battery(entry.newest.budget.as_ref()?, budget_flag::CHARGE, |budget| budget.soc)
        });
        gauges(encoder, "joulebus_soc", "State of charge, 0 to 1", Some(&ratio), soc)?;
        let left = series(&|entry| {
            battery(entry.newest.budget.as_ref()?, budget_flag::TIME_TO_EMPTY, |budget| {
                budget.time_to_empty_s
            })
        });
        gauges(
            encoder,
            "joulebus_time_to_empty",
            "Expected time until the battery is empty",
            Some(&Unit::Seconds),
            left,
        )?;
        let to_full = series(&|entry| {
            let budget = entry.newest.budget.as_ref()?;
            budget.charging_s(budget.soc.into(), 1.0)
        });
        gauges(
            encoder,
            "joulebus_time_to_full",
            "Time on the charger until the battery is full, by earlier charges",
            Some(&Unit::Seconds),
            to_full,
        )?;
        let capacity = series(&|entry| Some(entry.newest.budget?.learned_capacity_j()?.0.into()));
        gauges(
            encoder,
            "joulebus_capacity",
            "Learned capacity of the battery",
            Some(&Unit::Joules),
            capacity,
        )?;
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
        gauges(
            encoder,
            "joulebus_energy_ahead",
            "Energy over the next seconds if the robot goes on as now, and the ends of its interval",
            Some(&Unit::Joules),
            ahead,
        )?;
        let age = series(&|entry| Some(entry.sample_age_ns(now_ns)? as f64 * 1e-9));
        gauges(
            encoder,
            "joulebus_sample_age",
            "Time since the newest sample's stamp",
            Some(&Unit::Seconds),
            age,
        )?;
        let health = series(&|entry| Some(entry.newest.level().code().into()));
        gauges(encoder, "joulebus_health_level", "0 ok, 1 warn, 2 error, 3 stale", None, health)
    }
}

fn consumed(encoder: &mut DescriptorEncoder, robots: &[Entry]) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(
        "joulebus_consumed",
        "Greatest energy drawn that the robot's ledger counted. It does not fall when energy is fed back",
        Some(&Unit::Joules),
        MetricType::Counter,
    )?;
    for entry in robots {
        if let Some(consumed_uj) = entry.consumed_uj {
            let (labels, consumed_j) = (of(entry), consumed_uj as f64 * 1e-6);
            let mut series = metric.encode_family(&labels)?;
            series.encode_counter::<NoLabelSet, f64, f64>(&consumed_j, None)?;
        }
    }
    Ok(())
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

fn watts() -> Unit {
    Unit::Other("watts".to_owned())
}

fn gauge(encoder: &mut DescriptorEncoder, name: &str, help: &str, value: f64) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
    metric.encode_gauge(&value)
}

fn gauges<S: EncodeLabelSet>(
    encoder: &mut DescriptorEncoder,
    name: &str,
    help: &str,
    unit: Option<&Unit>,
    series: impl IntoIterator<Item = (S, f64)>,
) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(name, help, unit, MetricType::Gauge)?;
    for (labels, value) in series {
        metric.encode_family(&labels)?.encode_gauge(&value)?;
    }
    Ok(())
}

fn by_reason(
    encoder: &mut DescriptorEncoder,
    name: &str,
    help: &str,
    counts: impl Iterator<Item = (&'static str, u64)>,
) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
    for (reason, count) in counts {
        let labels = vec![("reason", reason)];
        let mut series = metric.encode_family(&labels)?;
        series.encode_counter::<NoLabelSet, u64, f64>(&count, None)?;
    }
    Ok(())
}

fn histogram(
    encoder: &mut DescriptorEncoder,
    name: &str,
    help: &str,
    counted: &Counted,
) -> fmt::Result {
    let mut metric =
        encoder.encode_descriptor(name, help, Some(&Unit::Seconds), MetricType::Histogram)?;
    let uppers = UPPER_S.into_iter().chain([f64::INFINITY]);
    let buckets: Vec<(f64, u64)> = uppers.zip(counted.counts).collect();
    let count = counted.counts.iter().sum();
    metric.encode_histogram::<NoLabelSet>(counted.sum_ns as f64 * 1e-9, count, &buckets, None)
}

#[cfg(test)]
mod tests {
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
            let text = text(&snapshot, Vec::new(), now_ns, ("lab", 0)).unwrap();
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
        let text = text(&snapshot(&board), vec![outlook], SECOND_NS, ("lab", 1)).unwrap();
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
