//! The live view: draws a board, and does what keys ask for.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use joulebus_board::{Board, Link, Platforms, Row};
use joulebus_wire::{Level, budget_flag};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize as _};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Cell, Paragraph, Row as TableRow, Table, TableState, Wrap};

use super::cells::{HEADS, cells, count, fitting, state_within};
use super::choice::{Choice, Listed};
use super::style::{ACCENT, FORECAST, QUIET, boxed, level_style, link_style};
use super::{help, panels};
use crate::keys::asks_for_the_end;

/// Minimum number of lines for a chart below the table.
const CHART_FROM_LINES: u16 = 24;
/// Minimum number of columns for chart and events beside each other.
const EVENTS_FROM_COLUMNS: u16 = 76;
/// Minimum number of lines for sums, and for the last line.
const SUMS_FROM_LINES: u16 = 13;
const HELP_FROM_LINES: u16 = 5;
/// Minimum number of lines of a table with a border and a head.
const BORDER_FROM_LINES: u16 = 5;

/// Meaning of the keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    List,
    /// A search is typed.
    Search,
    /// The keys are shown.
    Help,
}

/// Title of the screen, and what the user chose.
#[derive(Debug)]
pub(crate) struct Screen {
    fleet: String,
    /// Progress, to the right of the title.
    pub(crate) progress: String,
    choice: Choice,
    mode: Mode,
    /// Events instead of the chart where they have no room beside it.
    events: bool,
    table: TableState,
    /// What the table says until a worker is seen.
    waiting: String,
}

/// Heights of the screen's parts.
#[derive(Debug, Clone, Copy)]
struct Heights {
    sums: u16,
    below: u16,
    help: u16,
}

impl Screen {
    /// Screen of a fleet, optionally with a selected robot.
    pub(crate) fn new(fleet: &str, platforms: Platforms, selected: Option<u32>) -> Self {
        Self {
            fleet: fleet.to_owned(),
            progress: String::new(),
            choice: Choice::new(platforms, selected),
            mode: Mode::List,
            events: false,
            table: TableState::default(),
            waiting: "waiting for a worker: `joulebus run` starts one".to_owned(),
        }
    }

    /// What the table says until a worker is seen.
    pub(crate) fn say_while_waiting(&mut self, text: String) {
        self.waiting = text;
    }

    /// Handles a key. True if it requests the end.
    pub(crate) fn press(&mut self, key: KeyEvent, board: &Board) -> bool {
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return asks_for_the_end(key);
        }
        match self.mode {
            Mode::Search => self.press_in_search(key.code),
            // Any key closes it.
            Mode::Help => self.mode = Mode::List,
            Mode::List if key.code == KeyCode::Esc && self.choice.is_filtered() => {
                self.choice.clear_filter();
            }
            Mode::List if asks_for_the_end(key) => return true,
            Mode::List => self.press_in_list(key.code, board),
        }
        false
    }

    fn press_in_search(&mut self, key: KeyCode) {
        match key {
            KeyCode::Char(character) => self.choice.type_in(character),
            KeyCode::Backspace => self.choice.delete(),
            KeyCode::Enter => self.mode = Mode::List,
            KeyCode::Esc => {
                self.choice.clear_search();
                self.mode = Mode::List;
            }
            _ => {}
        }
    }

    fn press_in_list(&mut self, key: KeyCode, board: &Board) {
        match key {
            KeyCode::Down | KeyCode::Char('j') => self.choice.step(board, 1),
            KeyCode::Up | KeyCode::Char('k') => self.choice.step(board, -1),
            KeyCode::PageDown => self.choice.step(board, 10),
            KeyCode::PageUp => self.choice.step(board, -10),
            KeyCode::Home => self.choice.step(board, isize::MIN),
            KeyCode::End => self.choice.step(board, isize::MAX),
            KeyCode::Char('a') => self.choice.step_to_alarm(board),
            KeyCode::Char('s') => self.choice.next_order(),
            KeyCode::Char('r') => self.choice.reverse(),
            KeyCode::Char('f') => self.choice.toggle_only_alarms(),
            KeyCode::Char('e') => self.events = !self.events,
            KeyCode::Char('/') => self.mode = Mode::Search,
            KeyCode::Char('?' | 'h') => self.mode = Mode::Help,
            _ => {}
        }
    }

    pub(crate) fn draw(&mut self, frame: &mut Frame, board: &Board) {
        let area = frame.area();
        let boxes = area.width >= panels::BOXES_FROM_COLUMNS;
        let lines = if boxes { Vec::new() } else { panels::sums(board, area.width) };
        let heights =
            self.heights(area, board, if boxes { panels::BOXES_LINES } else { lines.len() as u16 });
        let [title, sums, table, bottom, help] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(heights.sums),
            Constraint::Min(1),
            Constraint::Length(heights.below),
            Constraint::Length(heights.help),
        ])
        .areas(area);
        let listed = self.choice.listed(board);
        frame.render_widget(Paragraph::new(self.title(title.width, board)), title);
        if boxes && heights.sums > 0 {
            panels::draw_boxes(frame, sums, board);
        } else {
            frame.render_widget(Paragraph::new(lines), sums);
        }
        self.draw_table(frame, table, board, &listed);
        if heights.below > 0 {
            self.draw_bottom(frame, bottom, board, listed.robot());
        }
        frame.render_widget(Paragraph::new(self.last_line(help.width)), help);
        if self.mode == Mode::Help {
            help::draw(frame, area);
        }
    }

    fn heights(&self, area: Rect, board: &Board, sums: u16) -> Heights {
        let help = u16::from(area.height >= HELP_FROM_LINES || self.mode == Mode::Search);
        let sums = if area.height >= SUMS_FROM_LINES { sums } else { 0 };
        let below = if area.height >= CHART_FROM_LINES {
            // The table gets the height for the fleet, the chart the rest, within bounds.
            let table = (board.rows.len() as u16).saturating_add(3);
            let others = table.saturating_add(1 + sums + help);
            area.height.saturating_sub(others).clamp(8, 14)
        } else {
            0
        };
        Heights { sums, below, help }
    }

    /// Parts that do not fit are left out, the least important first.
    fn title(&self, width: u16, board: &Board) -> Line<'static> {
        // Importance, whether it is on the right, and the part.
        let mut parts = vec![
            (2, false, Span::from(" joulebus ").bold().fg(Color::Black).bg(ACCENT)),
            (3, false, Span::from(format!(" fleet {}", self.fleet)).bold()),
            (1, false, Span::styled(format!("  {} robots", count(board.rows.len() as u64)), QUIET)),
        ];
        if let Some(header) = board.header() {
            let worker = format!("worker {}  ", header.pid);
            parts.push((0, true, Span::styled(worker, QUIET)));
        }
        let link = format!("● {} ", board.link.name());
        parts.push((5, true, Span::styled(link, link_style(board.link))));
        parts.push((4, true, Span::from(format!(" {} ", self.progress))));
        let taken = |parts: &[(u8, bool, Span)]| -> usize {
            // A space between left and right.
            1 + parts.iter().map(|(_, _, span)| span.width()).sum::<usize>()
        };
        for importance in 0..5 {
            if taken(&parts) > usize::from(width) {
                parts.retain(|(found, _, _)| *found != importance);
            }
        }
        let gap = (usize::from(width) + 1).saturating_sub(taken(&parts));
        let (right, left): (Vec<_>, Vec<_>) = parts.into_iter().partition(|(_, right, _)| *right);
        let mut line: Line = left.into_iter().map(|(_, _, span)| span).collect();
        line.push_span(Span::from(" ".repeat(gap)));
        line.extend(right.into_iter().map(|(_, _, span)| span));
        line
    }

    fn last_line(&self, width: u16) -> Line<'static> {
        if self.mode != Mode::Search {
            return help::line(width);
        }
        Line::from(vec![
            Span::from(" search: ").bold().fg(ACCENT),
            Span::from(format!("{}▏", self.choice.search())),
            Span::styled("  Enter keeps it, Esc clears it", QUIET),
        ])
    }

    fn draw_bottom(&self, frame: &mut Frame, area: Rect, board: &Board, robot: Option<u32>) {
        if area.width < EVENTS_FROM_COLUMNS {
            return match self.events {
                true => panels::draw_notes(frame, area, board),
                false => panels::draw_chart(frame, area, board, robot),
            };
        }
        let chart = if area.width < panels::BOXES_FROM_COLUMNS { 1 } else { 3 };
        let notes = if area.width < panels::BOXES_FROM_COLUMNS { 1 } else { 2 };
        let [chart, notes] =
            Layout::horizontal([Constraint::Fill(chart), Constraint::Fill(notes)]).areas(area);
        panels::draw_chart(frame, chart, board, robot);
        panels::draw_notes(frame, notes, board);
    }

    fn draw_table(&mut self, frame: &mut Frame, area: Rect, board: &Board, listed: &Listed) {
        let has_border = area.height >= BORDER_FROM_LINES;
        let block = has_border.then(|| {
            let title = self.choice.title(listed.robots.len(), board.rows.len());
            boxed(levels(board)).title_bottom(Line::styled(title, QUIET))
        });
        if listed.robots.is_empty() {
            let text = match board.link {
                _ if !board.rows.is_empty() => "no robot is found: Esc lists all",
                Link::Waiting => &self.waiting,
                _ => "no robot is in the fleet: `joulebus publish` sends samples",
            };
            let text = Paragraph::new(text).style(QUIET).centered().wrap(Wrap { trim: true });
            let text = match block {
                Some(block) => text.block(block),
                None => text,
            };
            frame.render_widget(text, area);
            return;
        }
        self.table.select(Some(listed.selected));
        let width = area.width.saturating_sub(if has_border { 2 } else { 0 });
        let (places, state_columns) =
            fitting(width, (has_batteries(board), !board.outlooks.is_empty()));
        let heads = places.iter().map(|place| HEADS[*place]);
        let widths = heads.clone().map(|(head, width)| match head {
            "state" => Constraint::Length(state_columns),
            _ => Constraint::Length(width),
        });
        // Only visible rows are formatted: a fleet may have thousands of robots.
        let seen = usize::from(area.height);
        let from = listed.selected.saturating_sub(seen);
        let rows =
            listed.robots.iter().enumerate().map(|(place, robot)| match board.rows.get(robot) {
                Some(row) if place >= from && place <= from + 2 * seen => {
                    let texts = cells(*robot, row, board.outlooks.get(robot));
                    table_row(texts, row, &places, state_columns)
                }
                _ => TableRow::default(),
            });
        let mut table = Table::new(rows, widths)
            .row_highlight_style(Style::new().bg(Color::Indexed(237)).add_modifier(Modifier::BOLD));
        if let Some(block) = block {
            let heads = heads.map(|(head, _)| right_or_left(head, head));
            table = table.header(TableRow::new(heads).style(QUIET)).block(block);
        }
        frame.render_stateful_widget(table, area, &mut self.table);
    }
}

/// Robots at each level.
fn levels(board: &Board) -> Line<'static> {
    let [ok, warn, error, stale] = board.levels();
    Line::from(vec![
        Span::from(" robots "),
        Span::styled(format!(" {ok} ok "), level_style(Level::Ok)),
        Span::styled(format!(" {warn} warn "), level_style(Level::Warn)),
        Span::styled(format!(" {error} error "), level_style(Level::Error)),
        Span::styled(format!(" {stale} stale "), level_style(Level::Stale)),
    ])
}

fn has_batteries(board: &Board) -> bool {
    let budgets = board.rows.values().filter_map(|row| row.budget.as_ref());
    let mut flags = budgets.map(|budget| budget.flags);
    flags.any(|flags| flags & budget_flag::BATTERY != 0)
}

fn right_or_left(head: &str, text: &str) -> Cell<'static> {
    let line = Line::from(text.to_owned());
    Cell::new(match head {
        "quality" | "state" => line,
        _ => line.right_aligned(),
    })
}

fn table_row(
    mut texts: [String; HEADS.len()],
    row: &Row,
    places: &[usize],
    state_columns: u16,
) -> TableRow<'static> {
    texts[HEADS.len() - 1] = state_within(row, usize::from(state_columns));
    let level = row.level();
    let known = row.forecast.expected_w().is_some();
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
