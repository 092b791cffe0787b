//! Parses a TOML text to checked values; every problem has its line.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use joulebus_settings::bounds;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::key::{File, Key, ValueKind};
use crate::keys::{self, KEYS};
use crate::numbers::{integer, number};
use crate::problem::{MAX_PROBLEMS, Problem};
use crate::remedy;
use crate::robots;
use crate::values::{Place, Value, Values};

/// Letters of a key or a value that are shown.
const MAX_SHOWN: usize = 60;

/// A text and its name.
pub(crate) struct Source<'a> {
    text: &'a str,
    pub(crate) name: Arc<str>,
    directory: Option<Arc<PathBuf>>,
    /// Position of the start of each line.
    lines: Vec<usize>,
}

/// Contents of the fleet's file.
#[derive(Debug, Default)]
pub(crate) struct FleetFile {
    pub(crate) values: Values,
    pub(crate) platforms: Vec<Listed>,
    /// The text could not be parsed to its end: missing keys are not reported.
    pub(crate) cut_short: bool,
}

/// One `[[platform]]`.
#[derive(Debug)]
pub(crate) struct Listed {
    pub(crate) values: Values,
    /// Position of its start.
    pub(crate) header: Place,
    /// Its own file could not be read: missing keys are not reported.
    pub(crate) cut_short: bool,
}

impl<'a> Source<'a> {
    /// A text, its name in messages, and the directory to which its paths are relative; `None` for
    /// built-in texts.
    pub(crate) fn new(text: &'a str, name: &str, directory: Option<&Path>) -> Self {
        let breaks = text.match_indices('\n').map(|(at, _)| at + 1);
        Self {
            text,
            name: Arc::from(name),
            directory: directory.map(|directory| Arc::new(directory.to_owned())),
            lines: [0].into_iter().chain(breaks).collect(),
        }
    }
}

impl Source<'_> {
    /// Reads the file of a fleet.
    pub(crate) fn fleet(&self, problems: &mut Vec<Problem>) -> FleetFile {
        let mut read = FleetFile::default();
        let Some(document) = self.document(problems) else {
            read.cut_short = true;
            return read;
        };
        let mut walk = Walk { source: self, file: File::Fleet, problems };
        for (key, item) in document.get_ref() {
            if key.get_ref() != "platform" {
                walk.item(key, item, key.get_ref(), &mut read.values);
                continue;
            }
            let place = walk.source.place(key.span());
            let Some(tables) = tables(item.get_ref()) else {
                walk.wrong(
                    &place,
                    "platform",
                    "is a single table".to_owned(),
                    "Write [[platform]], with two brackets: there is one for each platform"
                        .to_owned(),
                );
                continue;
            };
            let (found, most) = (tables.len(), *bounds::PLATFORMS.end());
            if found > most as usize {
                walk.wrong(
                    &place,
                    "platform",
                    format!("is listed {found} times, allowed are {most}"),
                    "List the robots of one kind in one [[platform]]".to_owned(),
                );
                continue;
            }
            for (table, span) in tables {
                let mut values = Values::default();
                walk.table(table, "platform", &mut values);
                read.platforms.push(Listed {
                    values,
                    header: walk.source.place(span),
                    cut_short: false,
                });
            }
        }
        read
    }

    /// Reads a platform's file; `None` if it is not TOML.
    pub(crate) fn platform(&self, problems: &mut Vec<Problem>) -> Option<Values> {
        let mut values = Values::default();
        let document = self.document(problems)?;
        let mut walk = Walk { source: self, file: File::Platform, problems };
        walk.table(document.get_ref(), "platform", &mut values);
        Some(values)
    }

    fn document(&self, problems: &mut Vec<Problem>) -> Option<Spanned<DeTable<'_>>> {
        match DeTable::parse(self.text) {
            Ok(document) => Some(document),
            Err(error) => {
                problems.push(self.syntax(&error));
                None
            }
        }
    }

    fn place(&self, span: Range<usize>) -> Place {
        Place {
            file: Arc::clone(&self.name),
            directory: self.directory.clone(),
            line: self.lines.partition_point(|line| *line <= span.start),
        }
    }

    /// The value, for messages.
    fn found(&self, item: &Spanned<DeValue<'_>>) -> String {
        let text = self.text.get(item.span()).unwrap_or_default();
        match item.get_ref() {
            DeValue::Table(_) if text.starts_with('[') => "a table".to_owned(),
            value => format!("{} ({})", shown(text), value.type_str()),
        }
    }

    fn syntax(&self, error: &toml::de::Error) -> Problem {
        let start = error.span().map(|span| span.start);
        let start = start.unwrap_or_else(|| self.start_of(error));
        let place = self.place(start..start);
        let message = error.message().trim().replace('\n', "; ");
        let (key, what, remedy) = if message.contains("duplicate key") {
            let key = error.span().and_then(|span| self.text.get(span)).unwrap_or("");
            let first = first_of(self.text, place.line)
                .map_or_else(|| "before".to_owned(), |line| format!("in line {line}"));
            let what = format!("is set again; it was first set {first}");
            (key.trim().to_owned(), what, "Keep one of the two")
        } else {
            let what = format!("this is not TOML: {message}");
            (String::new(), what, "Correct the line; the rest of the file was not checked")
        };
        Problem {
            file: place.file.to_string(),
            line: Some(place.line),
            key,
            what,
            remedy: remedy.to_owned(),
        }
    }
}

impl Source<'_> {
    /// The start of the line of an error without a position: the text up to any earlier line does
    /// not have the error.
    fn start_of(&self, error: &toml::de::Error) -> usize {
        let starts = &self.lines;
        let fails_before = |start: &usize| {
            let found = DeTable::parse(&self.text[..*start]).err();
            found.is_some_and(|found| found.span().is_none() && found.message() == error.message())
        };
        let next = starts.partition_point(|start| !fails_before(start));
        starts[next.saturating_sub(1)]
    }
}

/// The beginning of a key or a value.
fn shown(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(MAX_SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]).into(),
        None => text.into(),
    }
}

/// The line before `line` that sets the same key or opens the same section.
fn first_of(text: &str, line: usize) -> Option<usize> {
    let head = |line: &str| -> Option<String> {
        let end = line.find(if line.trim_start().starts_with('[') { ']' } else { '=' })?;
        Some(line[..=end].split_whitespace().collect())
    };
    let lines: Vec<&str> = text.lines().collect();
    let wanted = head(lines.get(line.checked_sub(1)?)?)?;
    let before = lines[..line - 1].iter().enumerate().rev();
    let mut same_section = before
        .take_while(|(_, text)| wanted.starts_with('[') || !text.trim_start().starts_with('['));
    let (index, _) = same_section.find(|(_, text)| head(text).as_ref() == Some(&wanted))?;
    Some(index + 1)
}

type SpannedTable<'t> = (&'t DeTable<'t>, Range<usize>);

/// The tables of `[[platform]]`, or of an array of inline tables, with their positions.
fn tables<'t>(item: &'t DeValue<'t>) -> Option<Vec<SpannedTable<'t>>> {
    let table = |value: &'t Spanned<DeValue<'t>>| Some((value.get_ref().as_table()?, value.span()));
    item.as_array()?.iter().map(table).collect()
}

/// A file being traversed.
struct Walk<'a> {
    source: &'a Source<'a>,
    file: File,
    problems: &'a mut Vec<Problem>,
}

impl Walk<'_> {
    fn table(&mut self, table: &DeTable<'_>, path: &str, values: &mut Values) {
        for (key, item) in table {
            self.item(key, item, &format!("{path}.{}", key.get_ref()), values);
        }
    }

    fn item(
        &mut self,
        key: &Spanned<DeString<'_>>,
        item: &Spanned<DeValue<'_>>,
        path: &str,
        values: &mut Values,
    ) {
        let place = self.source.place(key.span());
        let section = format!("{path}.");
        if KEYS.iter().any(|key| key.path.starts_with(&section)) {
            match item.get_ref().as_table() {
                Some(table) => self.table(table, path, values),
                None => self.wrong(
                    &place,
                    path,
                    format!("is {}, but it is the name of a section", self.source.found(item)),
                    format!(
                        "Write [{path}] on a line of its own, and the keys of the section below it"
                    ),
                ),
            }
            return;
        }
        let Some(known) = keys::find(path).filter(|key| self.allows(key)) else {
            self.unknown(&place, path, item);
            return;
        };
        let value = match self.value(known, item) {
            Ok(value) => Some(value),
            Err((what, remedy)) => {
                self.wrong(&place, self.shown(path), what, remedy);
                None
            }
        };
        values.set(known, value, place);
    }

    /// A fleet's file may set every key, a platform's file only its own.
    fn allows(&self, key: &Key) -> bool {
        self.file == File::Fleet || key.file == File::Platform
    }

    fn shown<'p>(&self, path: &'p str) -> &'p str {
        match self.file {
            File::Fleet => path,
            File::Platform => path.strip_prefix("platform.").unwrap_or(path),
        }
    }

    fn unknown(&mut self, place: &Place, path: &str, item: &Spanned<DeValue<'_>>) {
        if self.problems.len() > MAX_PROBLEMS {
            return;
        }
        let file = (self.file == File::Platform).then_some(File::Platform);
        let value = number(item.get_ref());
        let (what, remedy) = if item.get_ref().is_table() {
            let remedy = remedy::unknown_section(file, path);
            ("is not a known section", remedy)
        } else {
            let remedy = remedy::unknown_key(file, path, value);
            ("is not a known key", remedy)
        };
        self.wrong(place, self.shown(path), what.to_owned(), remedy);
    }

    fn wrong(&mut self, place: &Place, path: &str, what: String, remedy: String) {
        let line = Some(place.line);
        let problem = match self.problems.len() {
            ..MAX_PROBLEMS => Problem {
                file: place.file.to_string(),
                line,
                key: shown(path).into_owned(),
                what,
                remedy,
            },
            MAX_PROBLEMS => Problem::more(&place.file, line),
            _ => return,
        };
        self.problems.push(problem);
    }

    /// The value if the key's kind and range allow it, else the found value and the remedy.
    fn value(&self, key: &Key, item: &Spanned<DeValue<'_>>) -> Result<Value, (String, String)> {
        let refused = |what: String, advice: Option<String>| {
            let advice = advice.map_or_else(String::new, |advice| format!("{advice}. "));
            (what, format!("{advice}Allowed: {}", key.facts()))
        };
        let mistaken = || {
            let advice = item.get_ref().as_str().and_then(|text| remedy::number_in_text(key, text));
            refused(format!("is {}", self.source.found(item)), advice)
        };
        match key.kind {
            ValueKind::Integer { min, max } => {
                let value = integer(item.get_ref()).ok_or_else(mistaken)?;
                if !(min..=max).contains(&value) {
                    let advice = remedy::other_unit(key, value as f64);
                    return Err(refused(format!("is {value}, out of its range"), advice));
                }
                Ok(Value::Integer(value))
            }
            ValueKind::Number { min, max } => {
                let value = number(item.get_ref()).ok_or_else(mistaken)?;
                if !(min <= value && value <= max) {
                    let advice = remedy::other_unit(key, value);
                    return Err(refused(format!("is {value}, out of its range"), advice));
                }
                Ok(Value::Number(value))
            }
            ValueKind::Choice(words) => {
                let text = item.get_ref().as_str().ok_or_else(mistaken)?;
                if words.contains(&text) {
                    return Ok(Value::Text(text.to_owned()));
                }
                let text = shown(text);
                let text = text.as_ref();
                let near = words.iter().max_by(|one, other| {
                    strsim::jaro_winkler(one, text).total_cmp(&strsim::jaro_winkler(other, text))
                });
                let advice = match remedy::replaced_word(key, text) {
                    Some(by) => Some(by.to_owned()),
                    None => near.map(|word| format!("The nearest word is {word:?}")),
                };
                Err(refused(format!("is {text:?}"), advice))
            }
            ValueKind::Text(rule) => {
                let text = item.get_ref().as_str().ok_or_else(mistaken)?;
                if !rule.allows(text) {
                    return Err(refused(format!("is {:?}", shown(text)), None));
                }
                Ok(Value::Text(text.to_owned()))
            }
            ValueKind::Robots => {
                let list = item.get_ref().as_array().ok_or_else(mistaken)?;
                let ranges: Result<Vec<_>, String> =
                    list.iter().map(|entry| robots::parse(entry, self.source.text)).collect();
                Ok(Value::Robots(ranges.map_err(|what| refused(what, None))?))
            }
        }
    }
}
