//! The terminal: in raw mode for the live view and always restored.

use std::mem::ManuallyDrop;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use crossterm::event;
use joulebus_board::Feed;
use joulebus_program::stop::Stop;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::screen::Screen;
use crate::keys::{EVENT_TIMEOUT, pressed, read_at_once};

/// Interval at which the processes and the end are checked.
const POLL_INTERVAL: Duration = Duration::from_millis(30);
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// The terminal in use by the view. Restored when dropped, and by a panic hook.
struct RawTerminal {
    terminal: ManuallyDrop<ratatui::DefaultTerminal>,
}

impl RawTerminal {
    fn take() -> anyhow::Result<Self> {
        let terminal = ratatui::try_init().context("cannot use the terminal. Try --plain")?;
        let taken = Self { terminal: ManuallyDrop::new(terminal) };
        read_at_once().context("cannot read keys. Try --plain")?;
        Ok(taken)
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        // The terminal's own drop shows the cursor, and panics if stderr is closed: a closed
        // terminal is left alone.
        if ratatui::try_restore().is_ok() {
            let _ = self.terminal.show_cursor();
        }
    }
}

/// Shows the board until `q`, a signal, the end of the feed, or until `look` returns none. `look`
/// is called often and returns the progress.
pub(crate) fn show(
    feed: &Feed,
    screen: &mut Screen,
    stop: &Stop,
    mut look: impl FnMut() -> anyhow::Result<Option<String>>,
) -> anyhow::Result<()> {
    let mut terminal = RawTerminal::take()?;
    let mut drawn: Option<Instant> = None;
    while !stop.is_asked() && feed.is_reading() {
        let Some(progress) = look()? else {
            return Ok(());
        };
        screen.progress = progress;
        if drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
            drawn = Some(Instant::now());
            let terminal = &mut terminal.terminal;
            let result = terminal.draw(|frame| screen.draw(frame, &feed.board()));
            // One that has gone away takes nothing. Its signal may come later.
            if result.is_err() && is_closed(Duration::ZERO)? {
                return Ok(());
            }
            result.context("cannot draw")?;
        }
        if is_closed(POLL_INTERVAL)? {
            return Ok(());
        }
        // All waiting events: with one per redraw, a repeating key would outpace the drawing.
        while event::poll(EVENT_TIMEOUT).context("cannot read keys")? {
            let event = event::read().context("cannot read keys")?;
            if pressed(&event).is_some_and(|key| screen.press(key, &feed.board())) {
                return Ok(());
            }
            drawn = None;
        }
    }
    Ok(())
}

/// Waits for a key. Returns true if the terminal is closed. Crossterm would wait forever for the
/// keys of a closed terminal.
fn is_closed(patience: Duration) -> anyhow::Result<bool> {
    let stdin = std::io::stdin();
    let mut polled = [PollFd::new(&stdin, PollFlags::IN)];
    let timeout = Timespec { tv_sec: 0, tv_nsec: patience.subsec_nanos().into() };
    match poll(&mut polled, Some(&timeout)) {
        Ok(_) => {
            let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
            Ok(polled[0].revents().intersects(gone))
        }
        // A signal: the stop request is checked in the next iteration.
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error).context("cannot wait for keys"),
    }
}
