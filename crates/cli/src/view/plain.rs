//! The board as plain text.

use std::fmt::Write as _;

use joulebus_board::{Board, Row};
use joulebus_wire::Level;

use super::cells::{HEADS, cells, columns, lacks_charge, micros, state};

/// Maximum number of robots named in a line.
const MAX_NAMED: usize = 4;

/// State of the fleet in one line.
pub(crate) fn line(board: &Board, now_ns: u64) -> String {
    let (done, skipped, late) = board.ticks();
    let (accepted, dropped) = (board.accepted(), board.dropped().total());
    let total = board.stages.latency().total;
    let (p50, p99) = (micros(total.p50_us), micros(total.p99_us));
    let mut text = format!(
        "{:>6.1} s  {:<7}  ticks {done} ({skipped} skipped, {late} late)  samples {accepted} \
         ({dropped} dropped)  p50 {p50}, p99 {p99}",
        board.seconds(now_ns),
        board.link.name(),
    );
    if let Some(questions) = board.questions() {
        let _ = write!(text, "  {questions}");
    }
    let scores = board.scores();
    if let (Some(ours), Some(theirs)) = (scores.rmse_w, scores.persistence_rmse_w) {
        let _ = write!(text, "  RMSE {ours:.3} W (persistence {theirs:.3})");
    }
    let stands_out = |row: &Row| row.level() != Level::Ok && row.diagnostic.is_some();
    let rows = board.by_urgency().into_iter().map(|robot| (robot, &board.rows[&robot]));
    let standing_out: Vec<(u32, &Row)> = rows.filter(|(_, row)| stands_out(row)).collect();
    for (robot, row) in standing_out.iter().take(MAX_NAMED) {
        let _ = write!(text, "  [{robot} {}]", state(row));
    }
    if standing_out.len() > MAX_NAMED {
        let _ = write!(text, "  and {} more", standing_out.len() - MAX_NAMED);
    }
    text
}

/// Table of all robots or of one.
pub(crate) fn table(board: &Board, only: Option<u32>) -> String {
    let mut text = String::new();
    let columns = columns(!board.outlooks.is_empty());
    let heads = HEADS.map(|(head, _)| head.to_owned());
    push_row(&mut text, &heads, &columns);
    for robot in board.by_urgency() {
        if let Some(row) = board.rows.get(&robot).filter(|_| only.is_none_or(|only| only == robot))
        {
            push_row(&mut text, &cells(robot, row, board.outlooks.get(&robot)), &columns);
        }
    }
    let refused = board.rows.keys().filter(|robot| only.is_none_or(|only| only == **robot));
    let refused: Vec<_> = refused.filter_map(|robot| board.refused_value(*robot)).collect();
    for refused in &refused {
        let _ = writeln!(text, "robot {}: {refused}", refused.robot);
    }
    if !refused.is_empty() {
        return text;
    }
    let mut shown = board.rows.iter().filter(|(robot, _)| only.is_none_or(|only| only == **robot));
    if let Some((robot, hint)) =
        shown.find_map(|(robot, row)| lacks_charge(row).map(|hint| (robot, hint)))
    {
        let _ = writeln!(text, "robot {robot}: {hint}");
    }
    text
}

fn push_row(text: &mut String, cells: &[String], columns: &[usize]) {
    let columns = columns.iter().map(|place| {
        let ((head, width), cell) = (HEADS[*place], &cells[*place]);
        let width = usize::from(width);
        match head {
            "quality" | "state" => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        }
    });
    let row = columns.collect::<Vec<String>>().join(" ");
    text.push_str(row.trim_end());
    text.push('\n');
}
