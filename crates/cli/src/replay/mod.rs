//! `joulebus replay`: plays captures into shared memory, or verifies them.

mod files;
mod pace;
mod play;
mod report;
mod span;
mod verify;

use std::path::PathBuf;
use std::str::FromStr;

use joulebus_capture_format::MessageKind;
use joulebus_capture_recorder::replay::PlayedChannel;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;

use joulebus_source::rate::{Passes, Rate};
use joulebus_wire::Samples;

/// Play a capture into shared memory, or recompute its forecasts and compare them bit by bit
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus replay run.mcap                       the samples, for a running worker\n  \
    joulebus replay run.mcap --rate max --loop=3\n  \
    joulebus replay run.mcap --topics forecasts diagnostics budgets\n  \
    joulebus replay run.mcap --start-offset 60 --playback-duration 10 --start-paused\n  \
    joulebus replay --verify run.mcap run_1.mcap\n  \
    joulebus replay --model new.safetensors run.mcap\n\n\
    Intervals between stamps stay as recorded at any rate, so a worker computes the same bits. \
    Forecasts, diagnostics, budgets and plan states are played as if the recorded worker sent \
    them, and only while no other worker serves the fleet. Planners first get the last frames \
    before the offset. On a terminal space pauses and continues, the right arrow or s plays a \
    step, q quits. Elsewhere --step and --start-paused read a line of stdin for each step.\n\
    --verify: exit 0 says that all that the worker sent was computed again, compared, and has the \
    same bits. Exit 3 says that something differs, is lost, or was not recorded to compare it. The \
    report has the coverage: by run and channel what was sent, recomputed, compared and excused.")]
pub(crate) struct Args {
    /// The capture, or the files of a split one in order
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The config to use [default: the one attached to the capture]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The fleet to play, if the capture contains several
    #[arg(long, value_name = "NAME")]
    fleet: Option<String>,
    /// Recompute every tick and compare every bit, and play nothing
    #[arg(long, conflicts_with_all = ["model", "rate", "passes", "topics", "remap"])]
    verify: bool,
    /// Recompute with another model, report the differences, and play nothing
    #[arg(long, value_name = "FILE", conflicts_with_all = ["rate", "passes", "topics", "remap"])]
    model: Option<PathBuf>,
    /// Speed: 1 as recorded, 2 twice as fast, max as fast as the worker answers
    #[arg(short, long, value_name = "FACTOR|max", default_value = "1")]
    rate: Rate,
    /// Repeat: indefinitely, or N times in total
    #[arg(short = 'l', long = "loop", value_name = "N", num_args = 0..=1, require_equals = true, default_missing_value = "for-ever")]
    passes: Option<Passes>,
    #[command(flatten)]
    span: span::Span,
    /// Start paused
    #[arg(short = 'p', long)]
    start_paused: bool,
    /// Step by step: each key or line plays up to the next frame
    #[arg(long)]
    step: bool,
    #[arg(long, value_name = "TOPIC", num_args = 1.., value_parser = service,
        help = format!("Services to play: {} [default: samples]", played().join(", ")))]
    topics: Vec<MessageKind>,
    /// Play a fleet under another name
    #[arg(short = 'm', long, value_name = "OLD:=NEW")]
    remap: Vec<Remap>,
    /// Do not wait for a worker: frames sent without one are lost
    #[arg(long)]
    no_wait: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.model {
        _ if args.verify => verify::verify(args, output),
        Some(other) => verify::compare(args, other, output),
        None => play::run(args, output),
    }
}

/// Parses the name of a service or its whole topic.
fn service(text: &str) -> Result<MessageKind, String> {
    let name = text.rsplit('/').next().unwrap_or(text);
    let found = PlayedChannel::all().into_iter().map(|channel| channel.kind);
    let mut found = found.filter(|kind| kind.name() == name);
    found.next().ok_or_else(|| format!("{text:?} is not one of {}", played().join(", ")))
}

/// Names of the services that can be played.
fn played() -> Vec<&'static str> {
    PlayedChannel::all().into_iter().map(|channel| channel.kind.name()).collect()
}

/// A fleet name in the capture and the name it is played under.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Remap {
    old: String,
    new: String,
}

impl FromStr for Remap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "{text:?}: expected old:=new with names of fleets or their topics, such as lab:=copy"
            )
        };
        let (old, new) = text.split_once(":=").ok_or_else(wrong)?;
        // A topic remaps its fleet. The service names stay.
        let fleet = |name: &str| -> Option<(String, String)> {
            match name.split('/').collect::<Vec<&str>>()[..] {
                [fleet] if !fleet.is_empty() => Some((fleet.to_owned(), String::new())),
                ["joulebus", fleet, service] => Some((fleet.to_owned(), service.to_owned())),
                _ => None,
            }
        };
        match (fleet(old), fleet(new)) {
            (Some((old, service)), Some((new, same))) if service == same => Ok(Self { old, new }),
            _ => Err(wrong()),
        }
    }
}

impl Args {
    /// The name under which `fleet` is played.
    fn name_for(&self, fleet: &str) -> Result<String, UsageError> {
        let mut name = fleet.to_owned();
        for remap in &self.remap {
            if remap.old != fleet {
                let old = &remap.old;
                let what = format!("--remap: the played fleet is {fleet:?}, not {old:?}");
                return Err(UsageError(what));
            }
            name.clone_from(&remap.new);
        }
        Ok(name)
    }

    /// The services to play.
    fn kinds(&self) -> Vec<MessageKind> {
        if self.topics.is_empty() {
            vec![MessageKind::of::<Samples>()]
        } else {
            self.topics.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::Budgets;

    use super::*;

    #[test]
    fn remap_takes_fleets_and_their_topics() {
        let remap = |old: &str, new: &str| Remap { old: old.to_owned(), new: new.to_owned() };
        for (text, expected) in [
            ("lab:=copy", Some(remap("lab", "copy"))),
            ("joulebus/lab/samples:=joulebus/copy/samples", Some(remap("lab", "copy"))),
            ("joulebus/lab/samples:=joulebus/copy/budgets", None),
            ("lab=copy", None),
            ("lab:=", None),
        ] {
            assert_eq!(text.parse().ok(), expected, "{text}");
        }
    }

    #[test]
    fn services_are_given_by_name_or_topic() {
        assert_eq!(service("samples"), Ok(MessageKind::of::<Samples>()));
        assert_eq!(service("joulebus/lab/budgets"), Ok(MessageKind::of::<Budgets>()));
        assert!(service("state").unwrap_err().contains("samples, forecasts"));
    }
}
