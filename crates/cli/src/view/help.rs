//! The keys of the live view: in its last line, and in a box over it.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Stylize as _;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Clear, Paragraph};

use super::style::{ACCENT, QUIET, boxed};

/// Keys of the last line and what they do, in the order in which they stand.
const SHORT: [(&str, &str); 7] = [
    ("q", "quit"),
    ("?", "help"),
    ("↑ ↓", "robot"),
    ("s", "sort"),
    ("/", "search"),
    ("f", "only alarms"),
    ("a", "next alarm"),
];

const ALL: [(&str, &str); 13] = [
    ("↑ ↓  k j", "the robot before, the next one"),
    ("PgUp PgDn", "ten robots"),
    ("Home End", "the first, the last"),
    ("a", "the next robot with an alarm"),
    ("s", "sort by urgency, name, battery, power"),
    ("r", "the other way round"),
    ("f", "only robots with an alarm, or all"),
    ("/", "search: id, platform, alarm, level"),
    ("", "or <30: batteries below 30 %"),
    ("Enter Esc", "keep the search, clear it"),
    ("e", "events or chart, if narrow"),
    ("? h", "this help"),
    ("q  Ctrl-C", "quit"),
];

/// The most important keys, as many as fit into a line of `width`.
pub(super) fn line(width: u16) -> Line<'static> {
    let mut spans = Vec::new();
    let mut left = usize::from(width);
    for (key, does) in SHORT {
        let segment = [
            Span::from(format!(" {key}")).bold().fg(ACCENT),
            Span::styled(format!(" {does}  "), QUIET),
        ];
        let taken: usize = segment.iter().map(Span::width).sum();
        // The last two spaces may be missing.
        if taken > left + 2 {
            break;
        }
        left = left.saturating_sub(taken);
        spans.extend(segment);
    }
    Line::from(spans)
}

/// All keys, over the middle of `area`.
pub(super) fn draw(frame: &mut Frame, area: Rect) {
    let lines: Vec<Line> = ALL
        .iter()
        .map(|(key, does)| {
            Line::from(vec![
                Span::from(format!(" {key:<10} ")).bold().fg(ACCENT),
                Span::from(*does),
                Span::from(" "),
            ])
        })
        .collect();
    let widest = lines.iter().map(Line::width).max().unwrap_or(0) as u16;
    let (width, height) = (widest + 2, lines.len() as u16 + 2);
    let (width, height) = (width.min(area.width), height.min(area.height));
    let inside = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, inside);
    let block = boxed(Line::from(" keys "));
    // Without room for a border and a line: the keys alone.
    let keys = Paragraph::new(lines);
    let keys = if inside.height < 3 { keys } else { keys.block(block) };
    frame.render_widget(keys, inside);
}
