//! Tests of the live view's screen.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use joulebus_board::{Board, Link, Platforms};
use joulebus_wire::{
    Acknowledgement, Alarm, AlarmSet, Budget, Diagnostic, Forecast, ForecastHeader, InvalidReason,
    Quality, budget_flag, diagnostic_flag, forecast_flag,
};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::style::Color;

use super::plain::table;
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
    let alarms = AlarmSet::default().with(Alarm::StuckSensor).with(Alarm::ModelMismatch);
    board.diagnostics(&[diagnostic(2, AlarmSet::default()), diagnostic(9, alarms)], 12_500_000_000);
    board.budgets(&[Budget {
        robot: 2,
        flags: budget_flag::LEDGER
            | budget_flag::BATTERY
            | budget_flag::CHARGE
            | budget_flag::TIME_TO_EMPTY,
        drawn_uj: 63_400_000,
        soc: 0.426,
        time_to_empty_s: 5_040.0,
        ..Budget::default()
    }]);
    board.set_link(Link::Live, 0);
    board
}

fn screen(selected: Option<u32>) -> Screen {
    Screen::new("lab", Platforms::default(), selected)
}

/// Presses keys one after the other. True if the last requested the end.
fn press(screen: &mut Screen, board: &Board, keys: impl IntoIterator<Item = KeyCode>) -> bool {
    let mut over = false;
    for key in keys {
        over = screen.press(KeyEvent::new(key, KeyModifiers::NONE), board);
    }
    over
}

fn typed(text: &str) -> Vec<KeyCode> {
    text.chars().map(KeyCode::Char).collect()
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
    let buffer = draw(&board(), &mut screen(None), 130, 40);
    let words = |text| {
        let (_, line) = line_of(&buffer, text);
        let words = line.split_whitespace().map(ToOwned::to_owned);
        words.filter(|word| word != "│").collect::<Vec<String>>().join(" ")
    };
    // The last reading is 3.21 + 30 · 0.1. Its forecast was 3.33. The diagnostics' residual is the
    // network's.
    let fine = "2 held 6.21 3.33 3.05 – 3.75 +2.88 0.062 +0.31 88 % 63.4 J 43 % 1 h 24 ok";
    assert_eq!(words("2 held").trim_matches('│').trim(), fine);
    let silent = "5 ✗ NoCommand – – – – – – – – – – –";
    assert_eq!(words("5 ✗").trim_matches('│').trim(), silent);
    assert!(words("9 open loop 12").contains("error StuckSensor +1"));
}

#[test]
fn a_robot_without_a_battery_in_the_config_names_the_missing_key() {
    let mut board = board();
    let names_it = |board: &Board, robot| {
        let shown = lines(&draw(board, &mut screen(Some(robot)), 120, 40)).concat();
        let key = "capacity_wh";
        assert_eq!(table(board, Some(robot)).contains(key), shown.contains(key));
        shown.contains(key)
    };
    // Nobody has counted energy of the second one yet.
    assert_eq!([names_it(&board, 2), names_it(&board, 9)], [false, false]);
    board.budgets(&[Budget { robot: 9, flags: budget_flag::LEDGER, ..Budget::default() }]);
    assert_eq!([names_it(&board, 2), names_it(&board, 9)], [false, true]);
}

#[test]
fn problems_are_coloured() {
    let buffer = draw(&board(), &mut screen(None), 120, 40);
    assert_eq!(color_of(&buffer, "error StuckSensor"), Color::Red);
    assert_eq!(color_of(&buffer, "● live"), Color::Green);
    let mut board = board();
    board.set_link(Link::Gone, 0);
    let buffer = draw(&board, &mut screen(None), 120, 40);
    assert_eq!(color_of(&buffer, "● gone"), Color::Red);
    line_of(&buffer, "worker 4711 is gone");
}

#[test]
fn a_cause_stands_before_its_consequence_and_what_is_acknowledged_is_marked() {
    let mut board = board();
    let alarms = AlarmSet::default().with(Alarm::NoData).with(Alarm::OutOfRange);
    board.diagnostics(&[diagnostic(2, alarms)], 0);
    assert!(table(&board, Some(2)).contains("stale OutOfRange +1"));
    board.acknowledged(&[Acknowledgement::new(2, Alarm::OutOfRange, 0, "ann").unwrap()]);
    assert!(table(&board, Some(2)).contains("stale OutOfRange ✓ +1"));
    assert!(table(&board, None).find("9 open loop") < table(&board, None).find("2 held"));
    board.acknowledged(&[]);
    assert!(!table(&board, None).contains('✓'));
}

#[test]
fn screen_shows_counters_latencies_and_events() {
    let buffer = draw(&board(), &mut screen(None), 120, 40);
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
    line_of(&draw(&empty, &mut screen(None), 100, 30), "`joulebus run`");
    empty.forecasts(&ForecastHeader::default(), &[], 0);
    empty.set_link(Link::Live, 0);
    line_of(&draw(&empty, &mut screen(None), 100, 30), "`joulebus publish`");
}

#[test]
fn keys_select_robots_within_the_fleet_and_find_the_next_that_stands_out() {
    let (board, mut screen) = (board(), screen(None));
    let shown = |screen: &mut Screen| {
        let (_, line) = line_of(&draw(&board, screen, 120, 40), "━ reading");
        line.split_whitespace().nth(2).unwrap().to_owned()
    };
    assert_eq!(shown(&mut screen), "9");
    for (key, robot) in [
        (KeyCode::Down, "5"),
        (KeyCode::Char('j'), "2"),
        (KeyCode::Down, "2"),
        (KeyCode::PageUp, "9"),
        (KeyCode::PageDown, "2"),
        (KeyCode::Char('k'), "5"),
        (KeyCode::Home, "9"),
        (KeyCode::End, "2"),
        (KeyCode::Char('a'), "9"),
        (KeyCode::Char('a'), "5"),
        (KeyCode::Char('a'), "9"),
    ] {
        assert!(!press(&mut screen, &board, [key]));
        assert_eq!(shown(&mut screen), robot, "{key:?}");
    }
}

/// The ids in the table, from above.
fn listed(board: &Board, screen: &mut Screen) -> Vec<String> {
    let lines = lines(&draw(board, screen, 80, 24));
    let head = lines.iter().position(|line| line.contains("robot quality"));
    let Some(head) = head else {
        return Vec::new();
    };
    let rows = lines[head + 1..].iter();
    rows.take_while(|line| !line.starts_with('╰'))
        .filter_map(|line| line.split_whitespace().nth(1))
        .filter(|word| word.chars().all(|digit| digit.is_ascii_digit()))
        .map(str::to_owned)
        .collect()
}

#[test]
fn robots_are_sorted_by_urgency_name_battery_and_power_in_either_direction() {
    let mut board = board();
    board.budgets(&[Budget {
        robot: 9,
        flags: budget_flag::BATTERY | budget_flag::CHARGE,
        soc: 0.1,
        ..Budget::default()
    }]);
    let mut screen = screen(None);
    for (name, upwards, downwards) in [
        ("by urgency", ["9", "5", "2"], ["2", "5", "9"]),
        ("by name", ["2", "5", "9"], ["9", "5", "2"]),
        // Unknown values are last either way.
        ("by battery", ["9", "2", "5"], ["2", "9", "5"]),
        ("by power", ["2", "9", "5"], ["2", "9", "5"]),
    ] {
        assert_eq!(listed(&board, &mut screen), upwards, "{name}");
        line_of(&draw(&board, &mut screen, 80, 24), &format!("{name} ↑"));
        press(&mut screen, &board, typed("r"));
        assert_eq!(listed(&board, &mut screen), downwards, "{name}");
        line_of(&draw(&board, &mut screen, 80, 24), &format!("{name} ↓"));
        press(&mut screen, &board, typed("rs"));
    }
    line_of(&draw(&board, &mut screen, 80, 24), "by urgency ↑");
}

#[test]
fn robots_are_filtered_by_alarm_battery_and_name() {
    let (board, mut screen) = (board(), screen(None));
    for (keys, found, expected) in [
        ("f", vec!["9", "5"], "2 of 3: alarms"),
        ("/stuck", vec!["9"], "1 of 3: \"stuck\""),
        ("/<50", vec!["2"], "1 of 3: \"<50\""),
        ("/9", vec!["9"], "1 of 3: \"9\""),
        ("/quiet", vec![], "no robot is found: Esc lists all"),
    ] {
        press(&mut screen, &board, typed(keys));
        press(&mut screen, &board, [KeyCode::Enter]);
        assert_eq!(listed(&board, &mut screen), found, "{keys}");
        line_of(&draw(&board, &mut screen, 80, 24), expected);
        assert!(!press(&mut screen, &board, [KeyCode::Esc]), "{keys}");
        assert_eq!(listed(&board, &mut screen), ["9", "5", "2"], "{keys}");
    }
    // While a search is typed, letters are letters, and are shown.
    press(&mut screen, &board, typed("/quit"));
    line_of(&draw(&board, &mut screen, 60, 24), "search: quit");
    press(&mut screen, &board, [KeyCode::Backspace, KeyCode::Esc]);
    assert!(press(&mut screen, &board, [KeyCode::Esc]));
    let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    press(&mut screen, &board, typed("/"));
    assert!(screen.press(control_c, &board));
}

#[test]
fn a_key_shows_what_keys_do_and_the_next_hides_it() {
    let (board, mut screen) = (board(), screen(None));
    for (width, height) in [(60, 24), (80, 24), (120, 40)] {
        press(&mut screen, &board, typed("?"));
        let buffer = draw(&board, &mut screen, width, height);
        for text in ["only robots with an alarm, or all", "the other way round", "Ctrl-C"] {
            line_of(&buffer, text);
        }
        // It closes the help, and nothing else.
        assert!(!press(&mut screen, &board, typed("q")));
        let shown = lines(&draw(&board, &mut screen, width, height)).concat();
        assert!(!shown.contains("the other way round"));
    }
}

#[test]
fn small_screens_show_whole_words() {
    let mut board = board();
    let alarms = AlarmSet::default().with(Alarm::BatteryCritical).with(Alarm::CannotReturn);
    board.diagnostics(&[diagnostic(5, alarms)], 13_000_000_000);
    let mut screen = screen(None);
    screen.progress = "12.5 of 15 s".to_owned();
    let name = alarms.first().name();
    for (width, texts) in [
        (
            80,
            [
                "joulebus  fleet lab  3 robots",
                "worker 4711  ● live  12.5 of 15 s",
                "RMSE W 1.700 persistence 0.100 inside 88 %",
                "p50 110 µs",
            ],
        ),
        (
            60,
            [
                "joulebus  fleet lab  3 robots",
                "● live  12.5 of 15 s",
                "RMSE W 1.700 persistence 0.100 inside 88 %",
                "samples 1\u{202f}234\u{202f}567 dropped 0",
            ],
        ),
    ] {
        let buffer = draw(&board, &mut screen, width, 24);
        for text in texts {
            line_of(&buffer, text);
        }
        line_of(&buffer, &format!("{name} +1"));
        line_of(&buffer, "error StuckSensor +1");
        // No box without content.
        let all = lines(&buffer);
        assert!(all.iter().all(|line| !line.contains("╮╭──╮")), "{all:#?}");
    }
}

#[test]
fn screen_fits_every_terminal_size() {
    let (full, empty) = (board(), Board::new(0));
    for width in (1..=140).step_by(9) {
        for height in (1..=8).chain((9..=45).step_by(4)) {
            for keys in ["", "e", "/9", "?", "fsr"] {
                for board in [&full, &empty] {
                    let mut screen = screen(Some(9));
                    press(&mut screen, board, typed(keys));
                    draw(board, &mut screen, width, height);
                }
            }
        }
    }
}

#[test]
fn a_tiny_screen_shows_the_selected_robot() {
    let board = board();
    let buffer = draw(&board, &mut screen(Some(9)), 10, 3);
    assert_eq!(lines(&buffer)[1].trim(), "9 err…");
    let buffer = draw(&board, &mut screen(Some(9)), 30, 3);
    assert_eq!(lines(&buffer)[1].trim(), "9 error StuckSensor +1");
}

#[test]
fn selected_robot_is_visible_in_a_large_fleet() {
    let mut board = Board::new(0);
    let robots: Vec<Forecast> = (0..5_000).map(|id| forecast(id, 1, Quality::Fresh)).collect();
    board.forecasts(&ForecastHeader::default(), &robots, 0);
    let mut screen = screen(Some(4_321));
    line_of(&draw(&board, &mut screen, 120, 40), "4321 fresh");
    for (key, robot) in
        [(KeyCode::PageUp, "4311 fresh"), (KeyCode::End, "4999 fresh"), (KeyCode::Home, "0 fresh")]
    {
        press(&mut screen, &board, [key]);
        line_of(&draw(&board, &mut screen, 120, 40), robot);
    }
}
