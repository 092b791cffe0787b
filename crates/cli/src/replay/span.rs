//! The part of a capture that is played.

use std::time::Duration;

use joulebus_capture_format::Entry;

use joulebus_source::rate::number;

/// Start and length in recorded time.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(super) struct Span {
    /// Start at this time after the start of the capture, s
    #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = offset)]
    start_offset: Duration,
    /// Length of recorded time to play, s [default: to the end]
    #[arg(long, value_name = "SECONDS", value_parser = joulebus_source::rate::seconds)]
    playback_duration: Option<Duration>,
}

/// Position of a message relative to the span.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SpanPosition {
    Before,
    Inside,
    After,
}

fn offset(text: &str) -> Result<Duration, String> {
    number(text, 0.0, 1e8, "s").map(Duration::from_secs_f64)
}

impl Span {
    /// True if it leaves out a part.
    pub(super) fn is_part(&self) -> bool {
        !self.start_offset.is_zero() || self.playback_duration.is_some()
    }

    /// Position of a message recorded `at_ns` after the first.
    pub(super) fn position(&self, at_ns: u64) -> SpanPosition {
        let at = Duration::from_nanos(at_ns);
        let end = self.playback_duration.map(|duration| self.start_offset.saturating_add(duration));
        if at < self.start_offset {
            SpanPosition::Before
        } else if end.is_some_and(|end| at > end) {
            SpanPosition::After
        } else {
            SpanPosition::Inside
        }
    }

    /// The messages inside the span.
    pub(super) fn of<'a>(
        &'a self,
        entries: &'a mut impl Iterator<Item = Entry>,
    ) -> impl Iterator<Item = Entry> + 'a {
        let mut first_ns = None;
        let placed = move |entry: Entry| {
            let first_ns = *first_ns.get_or_insert(entry.log_time_ns);
            (self.position(entry.log_time_ns.saturating_sub(first_ns)), entry)
        };
        entries
            .map(placed)
            .take_while(|(position, _)| *position != SpanPosition::After)
            .filter_map(|(position, entry)| (position == SpanPosition::Inside).then_some(entry))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn span_includes_both_its_ends() {
        let span = Span {
            start_offset: Duration::from_secs(2),
            playback_duration: Some(Duration::from_secs(3)),
        };
        for (at_s, position) in [
            (0, SpanPosition::Before),
            (2, SpanPosition::Inside),
            (5, SpanPosition::Inside),
            (6, SpanPosition::After),
        ] {
            assert_eq!(span.position(at_s * 1_000_000_000), position, "{at_s} s");
        }
    }
}
