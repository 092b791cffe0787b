//! The terminal: taken over for the live view and always given back.

use std::mem::ManuallyDrop;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use crossterm::event::{self, Event, KeyCode};
use joulebus_program::stop::Stop;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::board::Board;
use super::feed::Feed;
use super::screen::Screen;
use crate::keys::{asks_for_the_end, pressed};

/// How often the processes and the end are looked after.
const LOOK_EVERY: Duration = Duration::from_millis(30);
/// How often the view is drawn.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// The terminal in the view's hands; given back when dropped, and by a hook when somebody panics.
struct Taken {
    terminal: ManuallyDrop<ratatui::DefaultTerminal>,
}

impl Taken {
    fn take() -> anyhow::Result<Self> {
        let terminal = ratatui::try_init().context("cannot use the terminal; try --plain")?;
        Ok(Self {
            terminal: ManuallyDrop::new(terminal),
        })
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        // The terminal's own drop shows the cursor, and panics when there is nobody to complain to:
        // a terminal that is gone is left alone.
        if ratatui::try_restore().is_ok() {
            let _ = self.terminal.show_cursor();
        }
    }
}

/// Shows the board until `q`, a signal, the end of the feed, or until `look` says that it is over.
/// `look` is called often; it returns how far the run is, or none when it is over.
///
/// # Errors
/// What `look` said, or the terminal.
pub(crate) fn show(
    feed: &Feed,
    screen: &mut Screen,
    stop: &Stop,
    mut look: impl FnMut() -> anyhow::Result<Option<String>>,
) -> anyhow::Result<()> {
    let mut taken = Taken::take()?;
    let mut drawn: Option<Instant> = None;
    while !stop.is_asked() && feed.is_reading() {
        let Some(progress) = look()? else {
            return Ok(());
        };
        screen.progress = progress;
        if drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
            drawn = Some(Instant::now());
            let terminal = &mut taken.terminal;
            terminal
                .draw(|frame| screen.draw(frame, &feed.board()))
                .context("cannot draw")?;
        }
        if is_closed(LOOK_EVERY)? {
            return Ok(());
        }
        if event::poll(Duration::ZERO).context("cannot read keys")? {
            let event = event::read().context("cannot read keys")?;
            if act(&event, screen, &feed.board()) {
                return Ok(());
            }
            drawn = None;
        }
    }
    Ok(())
}

/// Waits for a key; whether the terminal is gone instead. Crossterm would wait indefinitely for the
/// keys of one that is.
fn is_closed(patience: Duration) -> anyhow::Result<bool> {
    let stdin = std::io::stdin();
    let mut polled = [PollFd::new(&stdin, PollFlags::IN)];
    let timeout = Timespec {
        tv_sec: 0,
        tv_nsec: patience.subsec_nanos().into(),
    };
    match poll(&mut polled, Some(&timeout)) {
        Ok(_) => {
            let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
            Ok(polled[0].revents().intersects(gone))
        }
        // A signal: whoever asked for the end is seen in the next round.
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error).context("cannot wait for keys"),
    }
}

/// Does what a key asks for; whether it asks for the end.
fn act(event: &Event, screen: &mut Screen, board: &Board) -> bool {
    let Some(key) = pressed(event) else {
        return false;
    };
    match key.code {
        _ if asks_for_the_end(key) => return true,
        KeyCode::Down | KeyCode::Char('j') => screen.step(board, 1),
        KeyCode::Up | KeyCode::Char('k') => screen.step(board, -1),
        KeyCode::PageDown => screen.step(board, 10),
        KeyCode::PageUp => screen.step(board, -10),
        KeyCode::Char('a') => screen.step_to_alarm(board),
        _ => {}
    }
    false
}
