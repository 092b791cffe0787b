//! Keys of a terminal in raw mode.

use std::io;
use std::time::Duration;

use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use rustix::termios::{OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};

/// Timeout of looking for an event: with none at all crossterm does not look.
pub(crate) const EVENT_TIMEOUT: Duration = Duration::from_millis(1);

/// Has reads of the terminal on stdin return at once until raw mode ends.
///
/// Crossterm reads until a key is whole. After the begin of one (Alt-O, a letter of Latin-1) it
/// would wait for the rest, and no signal would end that.
pub(crate) fn read_at_once() -> io::Result<()> {
    let stdin = io::stdin();
    let mut modes = tcgetattr(&stdin)?;
    modes.special_codes[SpecialCodeIndex::VMIN] = 0;
    modes.special_codes[SpecialCodeIndex::VTIME] = 0;
    Ok(tcsetattr(&stdin, OptionalActions::Now, &modes)?)
}

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
