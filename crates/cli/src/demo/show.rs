//! The display while a demo runs.

use std::io::IsTerminal as _;

use joulebus_board::{Feed, Platforms};
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_program::output::{log_line, text};
use joulebus_program::stop::Stop;

use super::{Demo, POLL_INTERVAL};
use crate::supervisor::Event;
use crate::view::{Screen, line, show};

const LINE_EVERY_NS: u64 = 1_000_000_000;

impl Demo<'_> {
    /// Shows the fleet until the time is over, `q` or a signal.
    pub(super) fn show(
        &mut self,
        config: &Config,
        feed: &Feed,
        stop: &Stop,
        began_ns: u64,
    ) -> anyhow::Result<()> {
        let terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal();
        if terminal && !self.args.plain && self.lines_to_stdout {
            self.show_live(config, feed, stop, began_ns)
        } else {
            self.show_lines(feed, stop, began_ns)
        }
    }

    fn show_live(
        &mut self,
        config: &Config,
        feed: &Feed,
        stop: &Stop,
        began_ns: u64,
    ) -> anyhow::Result<()> {
        let selected = self.planted.first().map(|planted| planted.robot);
        let mut screen = Screen::new("demo", Platforms::new(config.settings()), selected);
        show(feed, &mut screen, stop, || {
            self.look_after(feed)?;
            let seconds = (clock::monotonic_ns() - began_ns) as f64 * 1e-9;
            let whole = self.args.duration;
            Ok((seconds < whole).then(|| format!("{seconds:.1} of {whole:.0} s")))
        })
    }

    fn show_lines(&mut self, feed: &Feed, stop: &Stop, began_ns: u64) -> anyhow::Result<()> {
        let end_ns = began_ns + (self.args.duration * 1e9) as u64;
        let mut next_ns = began_ns + LINE_EVERY_NS;
        let mut printed = 0;
        while !stop.is_asked() && feed.is_reading() {
            self.look_after(feed)?;
            for event in self.events.iter().skip(printed) {
                if matches!(event, Event::Started { .. }) {
                    log_line(&event.to_string());
                }
            }
            printed = self.events.len();
            let now_ns = clock::monotonic_ns();
            if now_ns >= end_ns {
                break;
            }
            if now_ns >= next_ns {
                next_ns += LINE_EVERY_NS;
                let line = line(&feed.board(), now_ns);
                if self.lines_to_stdout {
                    text(&line)?;
                } else {
                    log_line(&line);
                }
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }
}
