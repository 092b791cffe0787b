//! Parses a TOML text to checked values. Every problem has its line.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::key::{File, Key, ValueKind};
use crate::numbers::{integer, number};
use crate::problem::{MAX_PROBLEMS, Problem};
use crate::remedy;
use crate::robots;
use crate::table;
use crate::values::{Child, Location, Scalar, Value, Values};

/// Letters of a key or a value that are shown.
const MAX_SHOWN: usize = 60;
/// What is wrong with a key without an effect: the file is accepted.
pub(crate) const RETIRED: &str = "is retired: it has no effect";

/// A text and its name.
pub(crate) struct NamedText<'a> {
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
    pub(crate) header: Location,
    /// Its own file could not be read: missing keys are not reported.
    pub(crate) cut_short: bool,
}

impl<'a> NamedText<'a> {
    /// A text, its name in messages, and the directory to which its paths are relative. `None` for
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

impl NamedText<'_> {
    /// Reads the file of a fleet.
    pub(crate) fn fleet(&self, problems: &mut Vec<Problem>) -> FleetFile {
        let Some(mut values) = self.values(File::Fleet, problems) else {
            return FleetFile { cut_short: true, ..FleetFile::default() };
        };
        let platforms = values.children.remove("platform").unwrap_or_default();
        let listed = |child: Child| Listed {
            values: child.values,
            header: child.location,
            cut_short: false,
        };
        let platforms = platforms.into_iter().map(listed).collect();
        FleetFile { values, platforms, cut_short: false }
    }

    /// Reads a file. `None` if it is not TOML.
    pub(crate) fn values(&self, file: File, problems: &mut Vec<Problem>) -> Option<Values> {
        let mut values = Values::default();
        let document = DeTable::parse(self.text);
        let document = document.map_err(|error| problems.push(self.syntax(&error))).ok()?;
        let mut walk = Walk { source: self, file, name: None, problems };
        values.sections.insert(file.root().to_owned(), self.location(0..0));
        walk.table(document.get_ref(), file.root(), &mut values);
        Some(values)
    }

    fn location(&self, span: Range<usize>) -> Location {
        Location {
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
        let location = self.location(start..start);
        let message = error.message().trim().replace('\n', "; ");
        let (key, what, remedy) = if message.contains("duplicate key") {
            let key = error.span().and_then(|span| self.text.get(span)).unwrap_or("");
            let first = first_of(self.text, location.line)
                .map_or_else(|| "before".to_owned(), |line| format!("in line {line}"));
            let what = format!("is set again. It was first set {first}");
            (key.trim().to_owned(), what, "Keep one of the two")
        } else {
            let what = format!("this is not TOML: {message}");
            (String::new(), what, "Correct the line. The rest of the file was not checked")
        };
        Problem {
            file: location.file.to_string(),
            line: Some(location.line),
            key,
            what,
            remedy: remedy.to_owned(),
        }
    }
}

impl NamedText<'_> {
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

/// A file being traversed.
struct Walk<'a> {
    source: &'a NamedText<'a>,
    file: File,
    /// The free name that `*` stands for.
    name: Option<String>,
    problems: &'a mut Vec<Problem>,
}

impl Walk<'_> {
    fn table(&mut self, table: &DeTable<'_>, path: &str, values: &mut Values) {
        let within = |name: &str| match path {
            "" => name.to_owned(),
            path => format!("{path}.{name}"),
        };
        let free = within("*");
        let is_free = table::keys().any(|key| self.file.allows(key) && key.below(&free).is_some());
        for (key, item) in table {
            if !is_free {
                self.item(key, item, &within(key.get_ref()), values);
                continue;
            }
            self.name = Some(key.get_ref().to_string());
            let mut child = self.child(self.source.location(key.span()), &free);
            self.item(key, item, &free, &mut child.values);
            child.name = self.name.take();
            values.children.entry(free.clone()).or_default().push(child);
        }
    }

    fn child(&self, location: Location, path: &str) -> Child {
        let mut values = Values::default();
        values.sections.insert(path.to_owned(), location.clone());
        Child { name: None, location, values }
    }

    /// The tables of a list, or of an array of inline tables.
    fn list(
        &mut self,
        (location, path, most): (&Location, &str, usize),
        item: &DeValue<'_>,
        values: &mut Values,
    ) {
        let list = item.as_array().into_iter().flatten();
        let tables = list.map(|item| Some((item.get_ref().as_table()?, item.span())));
        let tables = tables.collect::<Option<Vec<_>>>().filter(|_| item.is_array());
        let Some(tables) = tables else {
            let remedy = format!(
                "Write [[{path}]], with two brackets: there is one for each {}",
                path.rsplit('.').next().unwrap_or(path)
            );
            self.wrong(location, path, "is a single table".to_owned(), remedy);
            return;
        };
        if tables.len() > most {
            let what = format!("is listed {} times, allowed are {most}", tables.len());
            let remedy = match path {
                "platform" => "List the robots of one kind in one [[platform]]",
                _ => "List fewer of them",
            };
            self.wrong(location, path, what, remedy.to_owned());
            return;
        }
        for (table, span) in tables {
            let mut child = self.child(self.source.location(span), path);
            self.table(table, path, &mut child.values);
            values.children.entry(path.to_owned()).or_default().push(child);
        }
    }

    fn item(
        &mut self,
        key: &Spanned<DeString<'_>>,
        item: &Spanned<DeValue<'_>>,
        path: &str,
        values: &mut Values,
    ) {
        let location = self.source.location(key.span());
        let below = |key: &Key| key.below(path).is_some_and(|rest| !rest.is_empty());
        let is_section = table::keys().any(|key| self.file.allows(key) && below(key));
        if let (true, Some(most)) = (is_section, table::list(path)) {
            return self.list((&location, path, most), item.get_ref(), values);
        }
        if is_section {
            match item.get_ref().as_table() {
                Some(table) => {
                    values.sections.insert(path.to_owned(), location);
                    self.table(table, path, values);
                }
                None => self.wrong(
                    &location,
                    path,
                    format!("is {}, but it is the name of a section", self.source.found(item)),
                    format!(
                        "Write [{path}] on a line of its own, and the keys of the section below it"
                    ),
                ),
            }
            return;
        }
        let Some(known) = table::find(path).filter(|key| self.file.allows(key)) else {
            self.unknown(&location, path, item);
            return;
        };
        let value = match self.value(known, item) {
            Ok(value) => Some(value),
            Err((what, remedy)) => {
                self.wrong(&location, path, what, remedy);
                None
            }
        };
        values.set(path, value, location);
    }

    /// The path as the file's reader knows it.
    fn shown(&self, path: &str) -> String {
        let path = match self.file {
            File::Platform => path.strip_prefix("platform.").unwrap_or(path),
            _ => path,
        };
        match &self.name {
            Some(name) => path.replacen('*', name, 1),
            None => path.to_owned(),
        }
    }

    /// A key that had an effect once is a [`RETIRED`] problem, which [`crate::Config`] only tells.
    fn unknown(&mut self, location: &Location, path: &str, item: &Spanned<DeValue<'_>>) {
        if self.problems.len() > MAX_PROBLEMS {
            return;
        }
        let value = number(item.get_ref());
        let (what, remedy) = if item.get_ref().is_table() {
            ("is not a known section", remedy::unknown_section(self.file, path))
        } else if let Some(instead) = remedy::retired(path) {
            (RETIRED, instead.to_owned())
        } else {
            ("is not a known key", remedy::unknown_key(Some(self.file), path, value))
        };
        self.wrong(location, path, what.to_owned(), remedy);
    }

    fn wrong(&mut self, location: &Location, path: &str, what: String, remedy: String) {
        let key = shown(&self.shown(path)).into_owned();
        let file = location.file.to_string();
        Problem { file, line: Some(location.line), key, what, remedy }.add_to(self.problems);
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
            ValueKind::Choice(_) | ValueKind::Text(_) => {
                let text = item.get_ref().as_str().ok_or_else(mistaken)?;
                self::text(key, text).map_err(|(what, advice)| refused(what, advice))?;
                Ok(Value::Text(text.to_owned()))
            }
            ValueKind::Flag => item.get_ref().as_bool().map(Value::Flag).ok_or_else(mistaken),
            ValueKind::Texts { min, max, .. } => {
                let list = item.get_ref().as_array().ok_or_else(mistaken)?;
                if !(min..=max).contains(&list.len()) {
                    return Err(refused(format!("has {} entries", list.len()), None));
                }
                Ok(Value::Texts(self.texts(key, list, mistaken)?))
            }
            ValueKind::Words(_) => {
                let list = item.get_ref().as_array().ok_or_else(mistaken)?;
                Ok(Value::Texts(self.texts(key, list, mistaken)?))
            }
            ValueKind::Scalars => {
                let list = item.get_ref().as_array().ok_or_else(mistaken)?;
                let scalars: Option<Vec<Scalar>> =
                    list.iter().map(|item| scalar(item.get_ref())).collect();
                scalars.map(Value::Scalars).ok_or_else(mistaken)
            }
            ValueKind::Ids => match scalar(item.get_ref()) {
                Some(Scalar::Integer(id)) => Ok(Value::Text(id.to_string())),
                Some(Scalar::Text(ids)) => Ok(Value::Text(ids)),
                _ => Err(mistaken()),
            },
            ValueKind::Robots => {
                let list = item.get_ref().as_array().ok_or_else(mistaken)?;
                let ranges: Result<Vec<_>, String> =
                    list.iter().map(|entry| robots::parse(entry, self.source.text)).collect();
                Ok(Value::Robots(ranges.map_err(|what| refused(what, None))?))
            }
        }
    }

    /// The texts of a list, each with its line.
    fn texts(
        &self,
        key: &Key,
        list: &[Spanned<DeValue<'_>>],
        mistaken: impl Fn() -> (String, String),
    ) -> Result<Vec<(String, usize)>, (String, String)> {
        let one = |item: &Spanned<DeValue<'_>>| {
            let found = item.get_ref().as_str().ok_or_else(&mistaken)?;
            text(key, found).map_err(|(what, advice)| {
                let advice = advice.map_or_else(String::new, |advice| format!("{advice}. "));
                (what, format!("{advice}Allowed: {}", key.facts()))
            })?;
            Ok((found.to_owned(), self.source.location(item.span()).line))
        };
        list.iter().map(one).collect()
    }
}

/// Checks a word or a text.
fn text(key: &Key, text: &str) -> Result<(), (String, Option<String>)> {
    match key.kind {
        ValueKind::Text(rule) | ValueKind::Texts { rule, .. } if rule.allows(text) => Ok(()),
        ValueKind::Choice(words) | ValueKind::Words(words) if words.contains(&text) => Ok(()),
        ValueKind::Choice(words) | ValueKind::Words(words) => {
            let text = shown(text);
            let near = words.iter().max_by(|one, other| {
                strsim::jaro_winkler(one, &text).total_cmp(&strsim::jaro_winkler(other, &text))
            });
            let advice = match remedy::replaced_word(key, &text) {
                Some(by) => Some(by.to_owned()),
                None => near.map(|word| format!("The nearest word is {word:?}")),
            };
            Err((format!("is {text:?}"), advice))
        }
        _ => Err((format!("is {:?}", shown(text)), None)),
    }
}

/// A number, a text, `true` or `false`.
fn scalar(value: &DeValue<'_>) -> Option<Scalar> {
    let text = || Some(Scalar::Text(value.as_str()?.to_owned()));
    let flag = || value.as_bool().map(Scalar::Flag);
    let number = || number(value).filter(|number| number.is_finite()).map(Scalar::Number);
    integer(value).map(Scalar::Integer).or_else(number).or_else(text).or_else(flag)
}
