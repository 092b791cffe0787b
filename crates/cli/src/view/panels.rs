//! The panels around the live view's table: sums, the selected robot's chart, and events.

use joulebus_board::{Board, Point, Row};
use joulebus_latency::Spread;
use joulebus_wire::{Diagnostic, diagnostic_flag};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize as _};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType, Paragraph, Sparkline};

use super::cells::{count, lacks_charge, micros, percent, shortened};
use super::style::{ACCENT, FORECAST, QUIET, boxed};

/// Width from which the four boxes have room.
pub(super) const BOXES_FROM_COLUMNS: u16 = 104;
/// Lines of the boxes.
pub(super) const BOXES_LINES: u16 = 5;
/// Width from which the title of the chart and what the forecast has learned have room.
const WIDE_CHART_COLUMNS: u16 = 63;
/// Width from which the legend of the chart has room.
const LEGEND_COLUMNS: u16 = 46;

/// Sums as lines of at most `width` columns.
pub(super) fn sums(board: &Board, width: u16) -> Vec<Line<'static>> {
    let name = |name: &str| Span::styled(format!(" {name} "), QUIET);
    let value = |value: String| Span::from(value).bold();
    let (done, skipped, late) = board.ticks();
    let dropped = board.dropped();
    let total = board.stages.latency().total;
    let scores = board.scores();
    let mut samples = vec![
        name("samples"),
        value(count(board.accepted())),
        name("dropped"),
        value(count(dropped.total())),
    ];
    if let Some((reason, dropped)) = dropped.iter().max_by_key(|(_, count)| *count) {
        samples.extend([name(reason.name()), value(count(dropped))]);
    }
    let segments = [
        vec![
            name("ticks"),
            value(count(done)),
            name("skipped"),
            value(count(skipped)),
            name("late"),
            value(count(late)),
        ],
        samples,
        vec![
            name("p50"),
            value(micros(total.p50_us)),
            name("p99"),
            value(micros(total.p99_us)),
            name("max"),
            value(micros(total.max_us)),
        ],
        vec![
            name("RMSE W"),
            value(number(scores.rmse_w)).fg(FORECAST),
            name("persistence"),
            value(number(scores.persistence_rmse_w)),
            name("inside"),
            value(scores.coverage.map_or_else(unknown, percent)),
        ],
    ];
    flow(segments, usize::from(width))
}

/// Puts segments into lines, as many as fit into each.
fn flow(
    segments: impl IntoIterator<Item = Vec<Span<'static>>>,
    width: usize,
) -> Vec<Line<'static>> {
    const BETWEEN: usize = 2;
    let mut lines: Vec<Line> = Vec::new();
    for segment in segments {
        let taken: usize = segment.iter().map(Span::width).sum();
        match lines.last_mut() {
            Some(line) if line.width() + BETWEEN + taken <= width => {
                line.push_span(Span::from(" ".repeat(BETWEEN)));
                line.extend(segment);
            }
            _ => lines.push(Line::from(segment)),
        }
    }
    lines
}

fn unknown() -> String {
    "–".to_owned()
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(unknown, |value| format!("{value:.3}"))
}

/// Sums as boxes, at least [`BOXES_FROM_COLUMNS`] wide.
pub(super) fn draw_boxes(frame: &mut Frame, area: Rect, board: &Board) {
    let [ticks, samples, latency, scores] = Layout::horizontal([
        Constraint::Length(18),
        Constraint::Length(22),
        Constraint::Min(if area.width < 112 { 38 } else { 46 }),
        Constraint::Max(34),
    ])
    .areas(area);
    let (done, skipped, late) = board.ticks();
    let lines = [("done", done), ("skipped", skipped), ("late", late)];
    draw_counts(frame, ticks, " ticks ", &lines);
    let dropped = board.dropped();
    let worst = dropped.iter().max_by_key(|(_, count)| *count);
    let mut lines = vec![("accepted", board.accepted()), ("dropped", dropped.total())];
    lines.extend(worst.map(|(reason, count)| (reason.name(), count)));
    draw_counts(frame, samples, " samples ", &lines);
    draw_latency(frame, latency, board);
    draw_scores(frame, scores, board);
}

fn draw_counts(frame: &mut Frame, area: Rect, title: &'static str, counts: &[(&str, u64)]) {
    let width = usize::from(area.width.saturating_sub(4));
    let lines: Vec<Line> = counts
        .iter()
        .map(|(name, value)| {
            let value = count(*value);
            let gap = width.saturating_sub(name.chars().count() + value.chars().count());
            Line::from(vec![
                Span::styled(format!(" {name}{}", " ".repeat(gap)), QUIET),
                Span::from(value).bold(),
            ])
        })
        .collect();
    frame.render_widget(Paragraph::new(lines).block(boxed(Line::from(title))), area);
}

fn draw_latency(frame: &mut Frame, area: Rect, board: &Board) {
    let block = boxed(Line::from(" sample sent → forecast readable "));
    let inside = block.inner(area);
    frame.render_widget(block, area);
    let latency = board.stages.latency();
    let [text, spark] =
        Layout::vertical([Constraint::Length(2), Constraint::Fill(1)]).areas(inside);
    let name = |name: &'static str| Span::styled(name, QUIET);
    let value = |us: f64| Span::from(micros(us)).bold();
    let total = &latency.total;
    let whole = vec![
        name(" p50 "),
        value(total.p50_us),
        name("  p99 "),
        value(total.p99_us),
        name("  max "),
        value(total.max_us),
    ];
    let median = |spread: &Spread| Span::from(format!("{:.0}", spread.p50_us));
    let stages = vec![
        name(" take "),
        median(&latency.sent_to_taken),
        name("  wait "),
        median(&latency.taken_to_compute),
        name("  compute "),
        median(&latency.compute),
        name("  wake "),
        median(&latency.sent_to_readable),
        name(" µs"),
    ];
    frame.render_widget(Paragraph::new(vec![Line::from(whole), Line::from(stages)]), text);
    let from = board.recent_us.len().saturating_sub(usize::from(spark.width));
    let recent: Vec<u64> = board.recent_us.iter().skip(from).copied().collect();
    // A rare spike would flatten the rest.
    let mut sorted = recent.clone();
    sorted.sort_unstable();
    let top = sorted.get(sorted.len() / 2).map_or(1, |median| 3 * median.max(&1));
    let sparkline = Sparkline::default().data(recent).max(top).style(Style::new().fg(ACCENT));
    frame.render_widget(sparkline, spark);
}

fn draw_scores(frame: &mut Frame, area: Rect, board: &Board) {
    let scores = board.scores();
    let (versus, inside) = if area.width < 32 {
        (" vs ", " inside ")
    } else {
        ("  persistence ", " inside the interval ")
    };
    let line = |name: &str, ours, theirs| {
        Line::from(vec![
            Span::styled(format!(" {name:<6}"), QUIET),
            Span::from(format!("{:>6}", number(ours))).fg(FORECAST).bold(),
            Span::styled(versus, QUIET),
            Span::from(number(theirs)),
        ])
    };
    let coverage = scores.coverage.map_or_else(unknown, percent);
    let lines = vec![
        line("RMSE W", scores.rmse_w, scores.persistence_rmse_w),
        line("R²", scores.r2, scores.persistence_r2),
        Line::from(vec![Span::styled(inside, QUIET), Span::from(coverage).bold()]),
    ];
    let block = boxed(Line::from(" forecasts "));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

/// The chart of `robot`'s readings.
pub(super) fn draw_chart(frame: &mut Frame, area: Rect, board: &Board, robot: Option<u32>) {
    let row = robot.and_then(|robot| board.rows.get(&robot));
    let (Some(robot), Some(row)) = (robot, row) else {
        frame.render_widget(boxed(Line::from("")), area);
        return;
    };
    let [reading, forecast, interval] = match area.width {
        LEGEND_COLUMNS.. => ["━ reading ", "━ forecast ", "· interval "],
        _ => ["━ read ", "━ forecast ", ""],
    };
    let title = Line::from(vec![
        Span::from(format!(" robot {robot} ")),
        Span::styled(reading, Style::new().fg(ACCENT)),
        Span::styled(forecast, Style::new().fg(FORECAST)),
        Span::styled(interval, QUIET),
    ]);
    let refused = board.refused_value(robot).and_then(|refused| refused.found.clone());
    let refused = refused.map(|found| format!("refused: {found}"));
    let learned = match refused.or(lacks_charge(row).map(str::to_owned)) {
        Some(hint) => format!(" {hint} "),
        None => learned(row, area.width >= WIDE_CHART_COLUMNS),
    };
    let block = boxed(title).title_bottom(Line::styled(learned, QUIET));
    let points: Vec<&Point> = row.track.iter().collect();
    let line = |value: fn(&Point) -> f32| -> Vec<(f64, f64)> {
        let at = |(place, point): (usize, &&Point)| {
            (place as f64 - points.len() as f64, f64::from(value(point)))
        };
        let known = |(_, y): &(f64, f64)| y.is_finite();
        points.iter().enumerate().map(at).filter(known).collect()
    };
    let (reading, forecast) = (line(|p| p.reading_w), line(|p| p.forecast_w));
    let (lo, hi) = (line(|p| p.interval_w.0), line(|p| p.interval_w.1));
    let all = || reading.iter().chain(&forecast).map(|(_, y)| *y);
    let least = all().fold(f64::INFINITY, f64::min) - 0.15;
    let greatest = all().fold(f64::NEG_INFINITY, f64::max) + 0.15;
    let known = least < greatest;
    if !known {
        frame.render_widget(block, area);
        return;
    }
    let set = |data, color, marker, kind| {
        let set = Dataset::default().data(data).marker(marker);
        set.graph_type(kind).style(Style::new().fg(color))
    };
    let labels = [least, 0.5 * (least + greatest), greatest].map(|w| format!("{w:.2} W"));
    let chart = Chart::new(vec![
        set(&lo, Color::DarkGray, Marker::Braille, GraphType::Scatter),
        set(&hi, Color::DarkGray, Marker::Braille, GraphType::Scatter),
        set(&forecast, FORECAST, Marker::Braille, GraphType::Line),
        set(&reading, ACCENT, Marker::Braille, GraphType::Line),
    ])
    .x_axis(Axis::default().bounds([-(points.len().max(2) as f64), -1.0]))
    .y_axis(Axis::default().bounds([least, greatest]).labels(labels).style(QUIET))
    .legend_position(None)
    .block(block);
    frame.render_widget(chart, area);
}

/// Lessons of the robot's online forecast. Empty if it learns nothing.
fn learned(row: &Row, is_wide: bool) -> String {
    let learning = |diagnostic: &&Diagnostic| diagnostic.flags & diagnostic_flag::LEARNED != 0;
    let Some(learned) = row.diagnostic.as_ref().filter(learning) else {
        return String::new();
    };
    let [last, network, stack] =
        [learned.weight_last, learned.weight_network, learned.weight_stack]
            .map(|weight| percent(weight.into()));
    let weights = format!(" last {last} network {network} stack {stack}");
    match is_wide {
        true => format!(
            "{weights}, gain {:+.2}, level {:+.2} W ",
            learned.gain_network, learned.level_w
        ),
        false => format!("{weights} "),
    }
}

pub(super) fn draw_notes(frame: &mut Frame, area: Rect, board: &Board) {
    let room = usize::from(area.height.saturating_sub(2));
    // The time takes ten columns.
    let width = usize::from(area.width.saturating_sub(2)).saturating_sub(10);
    let from = board.notes.len().saturating_sub(room);
    let lines: Vec<Line> = board
        .notes
        .iter()
        .skip(from)
        .map(|(at_s, note)| {
            Line::from(vec![
                Span::styled(format!("{at_s:>6.1} s  "), QUIET),
                Span::from(shortened(note, width)),
            ])
        })
        .collect();
    let questions =
        board.questions().map_or_else(String::new, |questions| format!(" {questions} "));
    let block = boxed(Line::from(" events ")).title_bottom(Line::styled(questions, QUIET));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}
