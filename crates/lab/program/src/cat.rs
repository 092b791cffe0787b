//! `joulebus cat`: the messages of captures and other MCAP files, one by one.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::{self, BufWriter, Write as _};
use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_capture_format::scan::ScanError;
use joulebus_capture_format::values::{Line, values};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::StdoutClosed;
use joulebus_program::output::{Output, OutputFormat, log_line, printable};
use regex::Regex;
use serde_json::Value;

/// Write the messages of an MCAP file with their values
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus cat run.mcap --topics joulebus/lab/forecasts | head\n  \
    joulebus cat run.mcap --format csv --topics joulebus/lab/samples > samples.csv\n  \
    joulebus cat recording.mcap -e battery --format ndjson\n\n\
    Protobuf is decoded by the descriptors in the file, and JSON is passed on. BatteryState, \
    Twist, TwistStamped and Odometry of ROS 2 are decoded too. Other messages are shown with \
    time, number and length. CSV has \
    a row for each robot of a message and takes one type of messages.\n\
    Exit code 1: the file has no topic that was asked for. Exit code 3: it is corrupt, or values \
    could not be decoded.")]
pub(crate) struct Args {
    /// An MCAP file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Only these topics
    #[arg(long, value_name = "TOPIC", num_args = 1..)]
    topics: Vec<String>,
    /// Topics that match, in addition to --topics
    #[arg(short = 'e', long, value_name = "REGEX")]
    regex: Option<String>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let regex = args.regex.as_deref().map(Regex::new).transpose();
    let regex = regex.map_err(|error| UsageError(error.to_string()))?;
    let topics = RefCell::new(BTreeSet::new());
    let wanted = |topic: &str| {
        topics.borrow_mut().insert(topic.to_owned());
        let named = args.topics.iter().any(|wanted| wanted == topic);
        let matches = regex.as_ref().is_some_and(|regex| regex.is_match(topic));
        named || matches || args.topics.is_empty() && regex.is_none()
    };
    let named = || args.file.display().to_string();
    let file = joulebus_files::open(&args.file).with_context(named)?;
    let mut out = Out::new(output.asked());
    let passed = values(file, wanted, |line| out.take(&line)).map_err(|error: anyhow::Error| {
        if error.is::<ScanError>() { error.context(named()) } else { error }
    })?;
    out.out.flush().map_err(closed)?;
    for damage in &passed.damage {
        log_line(&format!("{}: {damage}", named()));
    }
    for (topic, count) in &passed.undecoded {
        log_line(&format!("{topic}: the values of {count} messages cannot be decoded"));
    }
    if out.unlisted > 0 {
        log_line(&format!("{} values had no column", out.unlisted));
    }
    if passed.damage.is_empty() {
        refuse_strangers(args, regex.as_ref(), &topics.into_inner()).with_context(named)?;
    }
    let is_whole = passed.damage.is_empty() && passed.undecoded.is_empty() && out.unlisted == 0;
    Ok(Outcome::unless_lost(!is_whole))
}

/// Refuses topics that were asked for and are not in the file, which is whole.
fn refuse_strangers(
    args: &Args,
    regex: Option<&Regex>,
    topics: &BTreeSet<String>,
) -> anyhow::Result<()> {
    /// Topics that are listed. A file may have thousands.
    const LISTED: usize = 10;
    let named = args.topics.iter().find(|name| !topics.contains(*name));
    let unmatched = regex.filter(|regex| !topics.iter().any(|topic| regex.is_match(topic)));
    let asked = match (named, unmatched) {
        (Some(name), _) => format!("is {name}"),
        (None, Some(regex)) => format!("matches {regex}"),
        (None, None) => return Ok(()),
    };
    let first: Vec<&str> = topics.iter().take(LISTED).map(String::as_str).collect();
    let more = match topics.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more: `joulebus info` lists them"),
    };
    anyhow::bail!("no topic {asked}, there are {}{more}", first.join(", "));
}

/// Writer of messages to stdout.
struct Out {
    form: OutputFormat,
    out: BufWriter<io::StdoutLock<'static>>,
    schema: Option<String>,
    columns: Vec<String>,
    /// Values of later messages without a column in the first.
    unlisted: u64,
}

fn closed(error: io::Error) -> anyhow::Error {
    if error.kind() == io::ErrorKind::BrokenPipe {
        StdoutClosed.into()
    } else {
        anyhow::Error::new(error).context("cannot write to stdout")
    }
}

impl Out {
    fn new(form: OutputFormat) -> Self {
        Self {
            form,
            out: BufWriter::new(io::stdout().lock()),
            schema: None,
            columns: Vec::new(),
            unlisted: 0,
        }
    }

    fn take(&mut self, line: &Line<'_>) -> anyhow::Result<()> {
        match self.form {
            OutputFormat::Json | OutputFormat::Ndjson => {
                let json = serde_json::to_string(line).context("cannot write as JSON")?;
                self.line(&json)
            }
            OutputFormat::Text => self.text(line),
            OutputFormat::Csv => self.csv(line),
        }
    }

    fn text(&mut self, line: &Line<'_>) -> anyhow::Result<()> {
        let (s, ns) = (line.log_time_ns / 1_000_000_000, line.log_time_ns % 1_000_000_000);
        let value = match &line.undecoded {
            None => line.value.to_string(),
            Some(why) => format!("[{} bytes of {}: {why}]", line.bytes, line.schema),
        };
        let (topic, sequence) = (line.topic, line.sequence);
        self.line(&format!("{s}.{ns:09} {topic} #{sequence} {value}"))
    }

    fn line(&mut self, text: &str) -> anyhow::Result<()> {
        writeln!(self.out, "{}", printable(text)).map_err(closed)
    }

    fn csv(&mut self, line: &Line<'_>) -> anyhow::Result<()> {
        let rows = rows(&line.value);
        match &self.schema {
            None => self.begin(line, rows.first().map_or(&[], Vec::as_slice))?,
            Some(schema) if schema != line.schema => {
                let what = format!("a table of {schema} cannot hold {}", line.schema);
                return Err(UsageError(format!("{what}. Name one kind with --topics")).into());
            }
            Some(_) => {}
        }
        for row in rows {
            let place = [
                line.topic.to_owned(),
                line.log_time_ns.to_string(),
                line.publish_time_ns.to_string(),
                line.sequence.to_string(),
            ];
            let known: BTreeSet<&str> = self.columns.iter().map(String::as_str).collect();
            self.unlisted +=
                row.iter().filter(|(name, _)| !known.contains(name.as_str())).count() as u64;
            let values = self.columns.iter().map(|column| {
                let found = row.iter().find(|(name, _)| name == column);
                found.map_or_else(String::new, |(_, value)| cell(value))
            });
            let cells: Vec<String> =
                place.iter().cloned().chain(values).map(|text| quoted(&text)).collect();
            self.line(&cells.join(","))?;
        }
        Ok(())
    }

    fn begin(&mut self, line: &Line<'_>, first: &[(String, Value)]) -> anyhow::Result<()> {
        self.schema = Some(line.schema.to_owned());
        self.columns = if line.columns.is_empty() {
            first.iter().map(|(name, _)| name.clone()).collect()
        } else {
            line.columns.to_vec()
        };
        let columns: Vec<String> = self.columns.iter().map(|name| quoted(name)).collect();
        let place = "topic,log_time_ns,publish_time_ns,sequence";
        let comma = if columns.is_empty() { "" } else { "," };
        self.line(&format!("{place}{comma}{}", columns.join(",")))
    }
}

/// The values of a message as rows: one per element of its only list of messages, else one.
fn rows(value: &Value) -> Vec<Vec<(String, Value)>> {
    let lists: Vec<&String> = value
        .as_object()
        .into_iter()
        .flatten()
        .filter(|(_, value)| is_list(value))
        .map(|(name, _)| name)
        .collect();
    let mut common = Vec::new();
    if let [list] = lists.as_slice() {
        flatten("", value, &mut common, Some(list));
        let elements = value[list.as_str()].as_array().into_iter().flatten();
        return elements
            .map(|element| {
                let mut row = common.clone();
                flatten(&format!("{list}."), element, &mut row, None);
                row
            })
            .collect();
    }
    flatten("", value, &mut common, None);
    vec![common]
}

fn is_list(value: &Value) -> bool {
    value.as_array().is_some_and(|list| list.first().is_some_and(Value::is_object))
}

/// Dotted names of nested values.
fn flatten(before: &str, value: &Value, row: &mut Vec<(String, Value)>, without: Option<&str>) {
    let Some(fields) = value.as_object() else {
        let name = before.trim_end_matches('.');
        row.push((if name.is_empty() { "value" } else { name }.to_owned(), value.clone()));
        return;
    };
    for (name, value) in fields.iter().filter(|(name, _)| Some(name.as_str()) != without) {
        match value {
            Value::Object(_) => flatten(&format!("{before}{name}."), value, row, None),
            // An empty list yields no rows and no value.
            Value::Array(list) if list.is_empty() => {}
            value => row.push((format!("{before}{name}"), value.clone())),
        }
    }
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        value => value.to_string(),
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
