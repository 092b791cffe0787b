//! Colours and borders of the live view.

use joulebus_board::Link;
use joulebus_wire::Level;
use ratatui::style::{Color, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, BorderType};

pub(super) const ACCENT: Color = Color::Cyan;
pub(super) const FORECAST: Color = Color::Magenta;
pub(super) const QUIET: Style = Style::new().fg(Color::DarkGray);

pub(super) fn boxed(title: Line<'_>) -> Block<'_> {
    let block = Block::bordered().border_type(BorderType::Rounded);
    block.border_style(QUIET).title(title.style(Style::new()))
}

pub(super) const fn level_style(level: Level) -> Style {
    Style::new().fg(match level {
        Level::Ok => Color::Green,
        Level::Warn => Color::Yellow,
        Level::Error => Color::Red,
        Level::Stale => Color::DarkGray,
    })
}

pub(super) const fn link_style(link: Link) -> Style {
    Style::new().fg(match link {
        Link::Live => Color::Green,
        Link::Waiting | Link::Stale => Color::Yellow,
        Link::Gone => Color::Red,
        Link::Ended => Color::DarkGray,
    })
}
