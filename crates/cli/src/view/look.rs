//! Tests of the live view's screen.

use joulebus_board::{Board, Link};
use joulebus_wire::{
    Alarm, AlarmSet, Budget, Diagnostic, Forecast, ForecastHeader, InvalidReason, Quality,
    budget_flag, diagnostic_flag, forecast_flag,
};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::style::Color;

use super::screen::Screen;

fn forecast(robot: u32, seq: u64, quality: Quality) -> Forecast {
    let (quality, quality_detail) = quality.encode();
    Forecast {
        robot,
        flags: forecast_flag::POWER
            | forecast_flag::INTERVAL
            | forecast_flag::READING
            | forecast_flag::SAMPLE,
        quality,
        quality_detail,
        reading_w: 3.21 + seq as f32 * 0.1,
        power_w: 3.33,
        lo_w: 3.05,
        hi_w: 3.75,
        sample_seq: seq,
        ..Forecast::default()
    }
}

fn diagnostic(robot: u32, alarms: AlarmSet) -> Diagnostic {
    Diagnostic {
        robot,
        flags: diagnostic_flag::RESIDUAL | diagnostic_flag::SCORES | diagnostic_flag::LEARNED,
        level: alarms.level().code(),
        alarm: alarms.first().code(),
        alarms: alarms.0,
        residual_w: -0.125,
        scored: 100,
        mae_w: 0.0625,
        persistence_mae_w: 0.09,
        skill: 0.31,
        coverage: 0.875,
        weight_last: 0.05,
        weight_network: 0.1,
        weight_stack: 0.85,
        gain_network: 0.93,
        level_w: -0.25,
        ..Diagnostic::default()
    }
}

/// Robot 2 is ok, 5 is invalid without data, 9 has a stuck sensor.
fn board() -> Board {
    let mut board = Board::new(0);
    for tick in 1..=30 {
        let mut silent = forecast(5, tick, Quality::Invalid(InvalidReason::NoCommand));
        silent.flags = 0;
        let header = ForecastHeader {
            worker_epoch: 1,
            tick,
            pid: 4711,
            samples_accepted: 1_234_567,
            first_sent_ns: 1_000,
            first_taken_ns: 41_000,
            compute_start_ns: 42_000,
            compute_end_ns: 62_000,
            sent_ns: 63_000,
            ..ForecastHeader::default()
        };
        let robots = [
            forecast(2, tick, Quality::Held),
            silent,
            forecast(9, tick, Quality::OpenLoop { steps: 12 }),
        ];
        board.forecasts(&header, &robots, 111_000);
    }
    let alarms = AlarmSet::default()
        .with(Alarm::StuckSensor)
        .with(Alarm::ModelMismatch);
    board.diagnostics(
        &[diagnostic(2, AlarmSet::default()), diagnostic(9, alarms)],
        12_500_000_000,
    );
    board.budgets(&[Budget {
        robot: 2,
        flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::TIME_TO_EMPTY,
        drawn_uj: 63_400_000,
        soc: 0.426,
        time_to_empty_s: 5_040.0,
        ..Budget::default()
    }]);
    board.set_link(Link::Live, 0);
    board
}

fn draw(board: &Board, screen: &mut Screen, width: u16, height: u16) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| screen.draw(frame, board)).unwrap();
    terminal.backend().buffer().clone()
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let width = usize::from(buffer.area.width);
    let symbols: Vec<&str> = buffer.content.iter().map(|cell| cell.symbol()).collect();
    symbols.chunks(width).map(<[&str]>::concat).collect()
}

fn line_of(buffer: &Buffer, text: &str) -> (usize, String) {
    let lines = lines(buffer);
    let found = lines.iter().position(|line| line.contains(text));
    let place = found.unwrap_or_else(|| panic!("no {text:?} in\n{}", lines.join("\n")));
    (place, lines[place].clone())
}

/// Colour of the first character of `text`.
fn color_of(buffer: &Buffer, text: &str) -> Color {
    let (row, line) = line_of(buffer, text);
    let before = &line[..line.find(text).unwrap()];
    buffer[(before.chars().count() as u16, row as u16)].fg
}

#[test]
fn a_robots_row_shows_all_columns_with_a_dash_for_unknown_values() {
    let buffer = draw(&board(), &mut Screen::new("lab", None), 130, 40);
    let words = |text| {
        let (_, line) = line_of(&buffer, text);
        let words = line.split_whitespace().map(ToOwned::to_owned);
        words
            .filter(|word| word != "│")
            .collect::<Vec<String>>()
            .join(" ")
    };
    // The last reading: 3.21 + 30 · 0.1. Its forecast was the 3.33 before; the diagnostics' residual is the
    // network's.
    let fine = "2 held 6.21 3.33 3.05 – 3.75 +2.88 0.062 +0.31 88 % 63.4 43 % 1 h 24 ok";
    assert_eq!(words("2 held").trim_matches('│').trim(), fine);
    let silent = "5 ✗ NoCommand – – – – – – – – – – –";
    assert_eq!(words("5 ✗").trim_matches('│').trim(), silent);
    assert!(words("9 open loop 12").contains("error StuckSensor +1"));
}

#[test]
fn problems_are_coloured() {
    let buffer = draw(&board(), &mut Screen::new("lab", None), 120, 40);
    assert_eq!(color_of(&buffer, "error StuckSensor"), Color::Red);
    assert_eq!(color_of(&buffer, "● live"), Color::Green);
    let mut board = board();
    board.set_link(Link::Gone, 0);
    let buffer = draw(&board, &mut Screen::new("lab", None), 120, 40);
    assert_eq!(color_of(&buffer, "● gone"), Color::Red);
    line_of(&buffer, "worker 4711 is gone");
}

#[test]
fn screen_shows_counters_latencies_and_events() {
    let buffer = draw(&board(), &mut Screen::new("lab", None), 120, 40);
    for text in [
        "1\u{202f}234\u{202f}567",
        "p50 110 µs",
        "take 40  wait 1  compute 20  wake 48 µs",
        "1.700  persistence 0.100",
        "inside the interval 88 %",
        "last 5 % network 10 % stack 85 %, gain +0.93, level -0.25 W",
        "12.5 s  robot 9: StuckSensor",
        " 1 ok  0 warn  1 error  1 stale",
    ] {
        line_of(&buffer, text);
    }
}

#[test]
fn screen_without_a_worker_or_robots_shows_a_hint() {
    let mut empty = Board::new(0);
    line_of(
        &draw(&empty, &mut Screen::new("lab", None), 100, 30),
        "`joulebus run`",
    );
    empty.forecasts(&ForecastHeader::default(), &[], 0);
    empty.set_link(Link::Live, 0);
    line_of(
        &draw(&empty, &mut Screen::new("lab", None), 100, 30),
        "`joulebus publish`",
    );
}

#[test]
fn keys_select_robots_within_the_fleet_and_find_the_next_that_stands_out() {
    let (board, mut screen) = (board(), Screen::new("lab", None));
    let shown = |screen: &mut Screen| {
        let (_, line) = line_of(&draw(&board, screen, 120, 40), "━ reading");
        line.split_whitespace().nth(2).unwrap().to_owned()
    };
    assert_eq!(shown(&mut screen), "2");
    for (by, robot) in [(1, "5"), (1, "9"), (1, "9"), (-10, "2"), (10, "9")] {
        screen.step(&board, by);
        assert_eq!(shown(&mut screen), robot, "{by}");
    }
    for robot in ["5", "9", "5"] {
        screen.step_to_alarm(&board);
        assert_eq!(shown(&mut screen), robot);
    }
}

#[test]
fn screen_fits_every_terminal_size() {
    let (full, empty) = (board(), Board::new(0));
    for width in (1..=140).step_by(7) {
        for height in 1..=45 {
            draw(&full, &mut Screen::new("lab", Some(9)), width, height);
            draw(&empty, &mut Screen::new("lab", Some(9)), width, height);
        }
    }
}

#[test]
fn selected_robot_is_visible_in_a_large_fleet() {
    let mut board = Board::new(0);
    let robots: Vec<Forecast> = (0..5_000)
        .map(|id| forecast(id, 1, Quality::Fresh))
        .collect();
    board.forecasts(&ForecastHeader::default(), &robots, 0);
    let mut screen = Screen::new("lab", None);
    for (by, robot) in [
        (4_321, "4321 fresh"),
        (-2_000, "2321 fresh"),
        (9_999, "4999 fresh"),
    ] {
        screen.step(&board, by);
        line_of(&draw(&board, &mut screen, 120, 40), robot);
    }
}
