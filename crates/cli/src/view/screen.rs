//! The live view: draws a board.

use joulebus_board::{Board, Link, Point, Row};
use joulebus_predictor_worker::Spread;
use joulebus_wire::{Diagnostic, Level, diagnostic_flag};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize as _};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{
    Axis, Block, BorderType, Cell, Chart, Dataset, GraphType, Paragraph, Row as TableRow,
    Sparkline, Table, TableState,
};

use super::cells::{HEADS, cells, count, fitting, micros, percent};

const ACCENT: Color = Color::Cyan;
const FORECAST: Color = Color::Magenta;
const QUIET: Style = Style::new().fg(Color::DarkGray);
/// Minimum number of lines for a chart below the table.
const CHART_FROM_LINES: u16 = 24;

/// Title of the screen and selected robot.
#[derive(Debug)]
pub(crate) struct Screen {
    fleet: String,
    /// Progress, to the right of the title.
    pub(crate) progress: String,
    /// The robot whose track is shown; the first one if it is absent.
    selected: Option<u32>,
    table: TableState,
}

impl Screen {
    /// Screen of a fleet, optionally with a selected robot.
    pub(crate) fn new(fleet: &str, selected: Option<u32>) -> Self {
        Self {
            fleet: fleet.to_owned(),
            progress: String::new(),
            selected,
            table: TableState::default(),
        }
    }

    /// Moves the selection by `by` rows, within the table.
    pub(crate) fn step(&mut self, board: &Board, by: isize) {
        let now = self.place(board).unwrap_or(0);
        let last = board.rows.len().saturating_sub(1);
        let place = now.saturating_add_signed(by).min(last);
        self.selected = board.rows.keys().nth(place).copied();
    }

    /// Selects the next robot with an alarm or without forecasts, if any.
    pub(crate) fn step_to_alarm(&mut self, board: &Board) {
        let from = self.selected.map_or(0, |robot| robot.saturating_add(1));
        let found = board
            .rows
            .range(from..)
            .chain(board.rows.range(..from))
            .find(|(_, row)| row.level() != Level::Ok);
        if let Some((robot, _)) = found {
            self.selected = Some(*robot);
        }
    }

    fn place(&self, board: &Board) -> Option<usize> {
        let selected = self.selected?;
        board.rows.keys().position(|robot| *robot == selected)
    }

    /// Draws everything.
    pub(crate) fn draw(&mut self, frame: &mut Frame, board: &Board) {
        let area = frame.area();
        let below = if area.height >= CHART_FROM_LINES {
            // The table gets the height for the fleet, the chart the rest, within bounds.
            let table = board.rows.len() as u16 + 3;
            area.height.saturating_sub(7 + table).clamp(8, 14)
        } else {
            0
        };
        let [title, boxes, table, bottom, help] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(5),
            Constraint::Min(5),
            Constraint::Length(below),
            Constraint::Length(1),
        ])
        .areas(area);
        self.draw_title(frame, title, board);
        draw_boxes(frame, boxes, board);
        self.draw_table(frame, table, board);
        if below > 0 {
            let [chart, notes] =
                Layout::horizontal([Constraint::Fill(3), Constraint::Fill(2)]).areas(bottom);
            self.draw_chart(frame, chart, board);
            draw_notes(frame, notes, board);
        }
        frame.render_widget(Paragraph::new(help_line()), help);
    }

    fn draw_title(&self, frame: &mut Frame, area: Rect, board: &Board) {
        let left = Line::from(vec![
            Span::from(" joulebus ").bold().fg(Color::Black).bg(ACCENT),
            Span::from(format!(" fleet {}", self.fleet)).bold(),
            Span::styled(
                format!("  {} robots", count(board.rows.len() as u64)),
                QUIET,
            ),
        ]);
        let worker = board
            .header()
            .map_or_else(String::new, |header| format!("worker {}  ", header.pid));
        let right = Line::from(vec![
            Span::styled(worker, QUIET),
            Span::styled(format!("● {}", board.link.name()), link_style(board.link)),
            Span::from(format!("  {} ", self.progress)),
        ])
        .right_aligned();
        frame.render_widget(Paragraph::new(left), area);
        frame.render_widget(Paragraph::new(right), area);
    }

    fn draw_table(&mut self, frame: &mut Frame, area: Rect, board: &Board) {
        let [ok, warn, error, stale] = board.levels();
        let title = Line::from(vec![
            Span::from(" robots "),
            Span::styled(format!(" {ok} ok "), level_style(Level::Ok)),
            Span::styled(format!(" {warn} warn "), level_style(Level::Warn)),
            Span::styled(format!(" {error} error "), level_style(Level::Error)),
            Span::styled(format!(" {stale} stale "), level_style(Level::Stale)),
        ]);
        if board.rows.is_empty() {
            let text = match board.link {
                Link::Waiting => "waiting for a worker: `joulebus run` starts one",
                _ => "the worker has received no samples yet: `joulebus publish` sends some",
            };
            let text = Paragraph::new(text).style(QUIET).centered();
            frame.render_widget(text.block(boxed(title)), area);
            return;
        }
        self.table.select(Some(self.place(board).unwrap_or(0)));
        let places = fitting(area.width.saturating_sub(2));
        let heads = places.iter().map(|place| HEADS[*place]);
        let widths = heads.clone().map(|(_, width)| Constraint::Length(width));
        let heads = heads.map(|(head, _)| right_or_left(head, head));
        // Only visible rows are formatted: a fleet may have thousands of robots.
        let seen = usize::from(area.height);
        let from = self.table.selected().unwrap_or(0).saturating_sub(seen);
        let rows = board.rows.iter().enumerate().map(|(place, (robot, row))| {
            if place < from || place > from + 2 * seen {
                TableRow::default()
            } else {
                table_row(*robot, row, &places)
            }
        });
        let table = Table::new(rows, widths)
            .header(TableRow::new(heads).style(QUIET))
            .row_highlight_style(
                Style::new()
                    .bg(Color::Indexed(237))
                    .add_modifier(Modifier::BOLD),
            )
            .block(boxed(title));
        frame.render_stateful_widget(table, area, &mut self.table);
    }

    fn draw_chart(&self, frame: &mut Frame, area: Rect, board: &Board) {
        let robot = self.selected.filter(|robot| board.rows.contains_key(robot));
        let robot = robot.or_else(|| board.rows.keys().next().copied());
        let row = robot.and_then(|robot| board.rows.get(&robot));
        let (Some(robot), Some(row)) = (robot, row) else {
            frame.render_widget(boxed(Line::from("")), area);
            return;
        };
        let title = Line::from(vec![
            Span::from(format!(" robot {robot} ")),
            Span::styled("━ reading ", Style::new().fg(ACCENT)),
            Span::styled("━ forecast ", Style::new().fg(FORECAST)),
            Span::styled("· interval ", QUIET),
        ]);
        let block = boxed(title).title_bottom(Line::styled(learned(row), QUIET));
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
        .y_axis(
            Axis::default()
                .bounds([least, greatest])
                .labels(labels)
                .style(QUIET),
        )
        .legend_position(None)
        .block(block);
        frame.render_widget(chart, area);
    }
}

/// What the robot's forecast has learned; empty if it learns nothing.
fn learned(row: &Row) -> String {
    let learning = |diagnostic: &&Diagnostic| diagnostic.flags & diagnostic_flag::LEARNED != 0;
    row.diagnostic
        .as_ref()
        .filter(learning)
        .map_or_else(String::new, |learned| {
            format!(
                " last {} network {} stack {}, gain {:+.2}, level {:+.2} W ",
                percent(learned.weight_last.into()),
                percent(learned.weight_network.into()),
                percent(learned.weight_stack.into()),
                learned.gain_network,
                learned.level_w,
            )
        })
}

fn boxed(title: Line<'_>) -> Block<'_> {
    let block = Block::bordered().border_type(BorderType::Rounded);
    block.border_style(QUIET).title(title.style(Style::new()))
}

fn right_or_left(head: &str, text: &str) -> Cell<'static> {
    let line = Line::from(text.to_owned());
    Cell::new(match head {
        "quality" | "state" => line,
        _ => line.right_aligned(),
    })
}

fn table_row(robot: u32, row: &Row, places: &[usize]) -> TableRow<'static> {
    let texts = cells(robot, row);
    let level = row.level();
    let known = row.forecast.power_w().is_some();
    let cells = places.iter().map(|place| {
        let head = HEADS[*place].0;
        let cell = right_or_left(head, &texts[*place]);
        match head {
            "read W" => cell.fg(ACCENT),
            "forecast W" => cell.fg(FORECAST),
            "quality" if !known => cell.fg(Color::Yellow),
            "state" => cell.style(level_style(level)),
            "interval W" | "inside" | "quality" => cell.style(QUIET),
            _ => cell,
        }
    });
    let row = TableRow::new(cells);
    match level {
        Level::Ok => row,
        _ => row.style(level_style(level)),
    }
}

fn draw_boxes(frame: &mut Frame, area: Rect, board: &Board) {
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
    frame.render_widget(
        Paragraph::new(vec![Line::from(whole), Line::from(stages)]),
        text,
    );
    let from = board
        .recent_us
        .len()
        .saturating_sub(usize::from(spark.width));
    let recent: Vec<u64> = board.recent_us.iter().skip(from).copied().collect();
    // A rare spike would flatten the rest.
    let mut sorted = recent.clone();
    sorted.sort_unstable();
    let top = sorted
        .get(sorted.len() / 2)
        .map_or(1, |median| 3 * median.max(&1));
    let sparkline = Sparkline::default()
        .data(recent)
        .max(top)
        .style(Style::new().fg(ACCENT));
    frame.render_widget(sparkline, spark);
}

fn draw_scores(frame: &mut Frame, area: Rect, board: &Board) {
    let scores = board.scores();
    let unknown = || "–".to_owned();
    let number = |value: Option<f64>| value.map_or_else(unknown, |value| format!("{value:.3}"));
    let (versus, inside) = if area.width < 32 {
        (" vs ", " inside ")
    } else {
        ("  persistence ", " inside the interval ")
    };
    let line = |name: &str, ours, theirs| {
        Line::from(vec![
            Span::styled(format!(" {name:<6}"), QUIET),
            Span::from(format!("{:>6}", number(ours)))
                .fg(FORECAST)
                .bold(),
            Span::styled(versus, QUIET),
            Span::from(number(theirs)),
        ])
    };
    let coverage = scores.coverage.map_or_else(unknown, percent);
    let lines = vec![
        line("RMSE W", scores.rmse_w, scores.persistence_rmse_w),
        line("R²", scores.r2, scores.persistence_r2),
        Line::from(vec![
            Span::styled(inside, QUIET),
            Span::from(coverage).bold(),
        ]),
    ];
    let block = boxed(Line::from(" forecasts "));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_notes(frame: &mut Frame, area: Rect, board: &Board) {
    let room = usize::from(area.height.saturating_sub(2));
    let from = board.notes.len().saturating_sub(room);
    let lines: Vec<Line> = board
        .notes
        .iter()
        .skip(from)
        .map(|(at_s, note)| {
            Line::from(vec![
                Span::styled(format!("{at_s:>6.1} s  "), QUIET),
                Span::from(note.clone()),
            ])
        })
        .collect();
    let questions = board
        .questions()
        .map_or_else(String::new, |questions| format!(" {questions} "));
    let block = boxed(Line::from(" events ")).title_bottom(Line::styled(questions, QUIET));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn help_line() -> Line<'static> {
    let key = |key: &'static str| Span::from(key).bold().fg(ACCENT);
    let does = |does: &'static str| Span::styled(does, QUIET);
    Line::from(vec![
        key(" ↑ ↓"),
        does(" robot   "),
        key("PgUp PgDn"),
        does(" ten robots   "),
        key("a"),
        does(" next alarm   "),
        key("q"),
        does(" quit"),
    ])
}

const fn level_style(level: Level) -> Style {
    Style::new().fg(match level {
        Level::Ok => Color::Green,
        Level::Warn => Color::Yellow,
        Level::Error => Color::Red,
        Level::Stale => Color::DarkGray,
    })
}

const fn link_style(link: Link) -> Style {
    Style::new().fg(match link {
        Link::Live => Color::Green,
        Link::Waiting | Link::Stale => Color::Yellow,
        Link::Gone => Color::Red,
        Link::Ended => Color::DarkGray,
    })
}
