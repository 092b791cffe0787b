//! The files of bridges, links and webhooks: sections whose keys have passed the table of keys.

use std::ops::{Deref, RangeInclusive};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::de::value::{Error, StrDeserializer};
use toml::de::DeTable;

use crate::document::NamedText;
use crate::files;
use crate::key::{DefaultValue, File, Key};
use crate::problem::{ConfigError, Problem};
use crate::table::keys;
use crate::values::{Location, Scalar, Value, Values};

/// A file whose keys have passed the table of keys.
#[derive(Debug)]
pub struct CheckedFile {
    file: File,
    values: Values,
    /// Problems of single keys: unknown ones, wrong values, and missing ones.
    pub problems: Vec<Problem>,
}

/// A text of a file.
#[derive(Debug, Clone)]
pub struct Text {
    text: String,
    key: String,
    location: Location,
}

/// A section of a file, a table of a list, or an entry of a section with free names.
#[derive(Debug, Clone)]
pub struct Section<'a> {
    values: &'a Values,
    path: String,
    name: &'a str,
}

impl File {
    /// The kind that knows most of the file's names outside of sections. A fleet's file if it
    /// cannot be read as TOML.
    #[must_use]
    pub fn new(path: &Path) -> Self {
        let text = files::read(path).unwrap_or_default();
        let Ok(document) = DeTable::parse(&text) else { return Self::Fleet };
        let known = |file: &Self| {
            let names = document.get_ref().keys().map(|name| match file.root() {
                "" => name.get_ref().to_string(),
                root => format!("{root}.{}", name.get_ref()),
            });
            let below =
                |path: &String| keys().any(|key| file.allows(key) && key.below(path).is_some());
            names.filter(below).count()
        };
        // The last of several is the maximum.
        Self::ALL.into_iter().rev().max_by_key(known).unwrap_or(Self::Fleet)
    }
}

impl CheckedFile {
    /// Reads a file and checks its keys.
    ///
    /// # Errors
    /// The file cannot be read, or is not TOML.
    pub fn load(path: &Path, file: File) -> Result<Self, ConfigError> {
        let text = files::read(path)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        Self::parse(&text, path, file)
    }

    /// Checks the keys of a text. `path` is its name in messages.
    ///
    /// # Errors
    /// The text is not TOML.
    pub fn parse(text: &str, path: &Path, file: File) -> Result<Self, ConfigError> {
        let mut problems = Vec::new();
        let source = NamedText::new(text, &path.display().to_string(), path.parent());
        let Some(values) = source.values(file, &mut problems) else {
            return Err(ConfigError::Refused(problems));
        };
        missing(&values, file, "", &mut problems);
        Ok(Self { file, values, problems })
    }

    /// The keys outside of all sections.
    pub fn root(&self) -> Section<'_> {
        Section { values: &self.values, path: self.file.root().to_owned(), name: "*" }
    }
}

/// Adds a problem for each required key of a section that the file has without it. Those of a
/// platform may stand in the fleet's file.
fn missing(values: &Values, file: File, name: &str, problems: &mut Vec<Problem>) {
    for (path, location) in &values.sections {
        let section = Section { values, path: path.clone(), name };
        let required = |key: &&Key| {
            file != File::Platform && file == key.file && key.default == DefaultValue::Required
        };
        for key in keys().filter(required) {
            if key.below(path) == Some(key.name()) && !section.has(key.name()) && key.name() != "*"
            {
                let remedy = format!("{} ({})", key.doc, key.facts());
                let key = section.shown(key.name());
                location.problem(key, "is missing".to_owned(), remedy).add_to(problems);
            }
        }
    }
    for child in values.children.values().flatten() {
        missing(&child.values, file, child.name.as_deref().unwrap_or("*"), problems);
    }
}

impl Location {
    fn problem(&self, key: String, what: String, remedy: String) -> Problem {
        Problem { file: self.file.to_string(), line: Some(self.line), key, what, remedy }
    }
}

impl Deref for Text {
    type Target = str;

    fn deref(&self) -> &str {
        &self.text
    }
}

impl Text {
    /// The path that the text is, relative to the folder of its file.
    pub fn file(&self) -> PathBuf {
        let folder = self.location.directory.as_deref();
        folder.map_or_else(|| PathBuf::from(&self.text), |folder| folder.join(&self.text))
    }

    /// A problem of this text: it is quoted before `what`.
    #[must_use]
    pub fn problem(&self, what: &str, remedy: &str) -> Problem {
        let what = format!("= {:?} {what}", self.text);
        self.location.problem(self.key.clone(), what.trim_end().to_owned(), remedy.to_owned())
    }
}

impl<'a> Section<'a> {
    fn path(&self, name: &str) -> String {
        match (self.path.as_str(), name) {
            (path, "") => path.to_owned(),
            ("", name) => name.to_owned(),
            (path, name) => format!("{path}.{name}"),
        }
    }

    /// The path with the free name.
    fn shown(&self, name: &str) -> String {
        self.path(name).replacen('*', self.name, 1)
    }

    /// The location of a key or section, else that of this section.
    fn location(&self, name: &str) -> Option<&Location> {
        let path = self.path(name);
        let list = || Some(&self.values.children.get(&path)?.first()?.location);
        let own = self.values.location(&path).or_else(|| self.values.sections.get(&path));
        let within = || self.values.sections.get(&self.path);
        // The first one is the table or file that all others are in.
        own.or_else(list).or_else(within).or_else(|| self.values.sections.values().next())
    }

    /// True if the file sets the key or has the section.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        let path = self.path(name);
        self.values.names(&path) || self.values.sections.contains_key(&path)
    }

    /// A problem of a key of this section, or of the section itself if `name` is empty.
    #[must_use]
    pub fn problem(&self, name: &str, what: String, remedy: &str) -> Problem {
        let (key, remedy) = (self.shown(name), remedy.to_owned());
        match self.location(name) {
            Some(location) => location.problem(key, what, remedy),
            None => Problem { file: String::new(), line: None, key, what, remedy },
        }
    }

    /// A section of this section, if the file has it.
    #[must_use]
    pub fn section(&self, name: &str) -> Option<Self> {
        let path = self.path(name);
        self.values.sections.contains_key(&path).then(|| Self { path, ..self.clone() })
    }

    /// A section of this section. If the file does not have it, its keys have their defaults.
    #[must_use]
    pub fn or_defaults(&self, name: &str) -> Self {
        Self { path: self.path(name), ..self.clone() }
    }

    /// The tables of a list, or the entries of a section with free names, which `*` names.
    pub fn list(&self, name: &str) -> impl Iterator<Item = Self> + use<'a> {
        let path = self.path(name);
        self.values.children.get(&path).into_iter().flatten().map(move |child| {
            let name = child.name.as_deref().unwrap_or("*");
            Self { values: &child.values, path: path.clone(), name }
        })
    }

    /// The free name of this entry.
    pub fn name(&self) -> Option<Text> {
        let location = self.location("")?.clone();
        Some(Text { text: self.name.to_owned(), key: self.shown(""), location })
    }

    /// A text, or its default.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<Text> {
        let text = self.values.text(&self.path(name))?;
        Some(Text { text, key: self.shown(name), location: self.location(name)?.clone() })
    }

    /// A number, or its default.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<f64> {
        self.values.number(&self.path(name))
    }

    /// An integer, or its default.
    #[must_use]
    pub fn integer<T: TryFrom<i64>>(&self, name: &str) -> Option<T> {
        self.values.integer(&self.path(name))
    }

    /// A flag, or its default.
    #[must_use]
    pub fn flag(&self, name: &str) -> Option<bool> {
        match self.values.get(&self.path(name))? {
            Value::Flag(flag) => Some(flag),
            _ => None,
        }
    }

    /// A word of a key, or its default.
    #[must_use]
    pub fn word<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let text = self.text(name)?;
        T::deserialize(StrDeserializer::<Error>::new(&text)).ok()
    }

    /// A list of texts, empty if it is not set.
    #[must_use]
    pub fn texts(&self, name: &str) -> Vec<Text> {
        let Some(Value::Texts(texts)) = self.values.get(&self.path(name)) else {
            return Vec::new();
        };
        let location = |line| Some(Location { line, ..self.location(name)?.clone() });
        let text =
            |(text, line)| Some(Text { text, key: self.shown(name), location: location(line)? });
        texts.into_iter().filter_map(text).collect()
    }

    /// A list of ids and ranges of robots, if it is set.
    #[must_use]
    pub fn robots(&self, name: &str) -> Option<Vec<RangeInclusive<u32>>> {
        match self.values.get(&self.path(name))? {
            Value::Robots(ranges) => Some(ranges),
            _ => None,
        }
    }

    /// A list of numbers, texts and flags, if it is set.
    #[must_use]
    pub fn scalars(&self, name: &str) -> Option<Vec<Scalar>> {
        match self.values.get(&self.path(name))? {
            Value::Scalars(scalars) => Some(scalars),
            _ => None,
        }
    }
}
