//! Keys of a terminal in raw mode.

use std::time::Duration;

use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Timeout of looking for an event: with none at all crossterm does not look.
pub(crate) const EVENT_TIMEOUT: Duration = Duration::from_millis(1);

/// The key that was pressed, or is held down. `None` for other events.
pub(crate) fn pressed(event: &Event) -> Option<KeyEvent> {
    let key = event.as_key_event()?;
    matches!(key.kind, KeyEventKind::Press | KeyEventKind::Repeat).then_some(key)
}

/// True if a key requests the exit: `q`, Escape, and Ctrl-C, which raw mode does not convert to a
/// signal.
pub(crate) fn asks_for_the_end(key: KeyEvent) -> bool {
    match key.code {
        KeyCode::Char('q') | KeyCode::Esc => true,
        KeyCode::Char('c') => key.modifiers.contains(KeyModifiers::CONTROL),
        _ => false,
    }
}
