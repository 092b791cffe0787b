//! Imports between the files of a crate: `use` declarations and paths through `crate`, `self`,
//! `super` and modules, resolved to the file that defines the name. A re-export only passes a name
//! on: its user depends on the definition.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::sources;

/// For each file, the files it imports from, with one of the imported names.
pub(crate) type Imports = BTreeMap<PathBuf, BTreeMap<PathBuf, String>>;

/// The imports within a crate, without tests; paths are relative to `src`. Imports of a submodule
/// from an enclosing module count only with `submodules`.
pub(crate) fn imports(src: &Path, submodules: bool) -> Imports {
    let files: BTreeMap<Vec<String>, File> = sources(src)
        .into_iter()
        .map(|(path, text)| {
            let path = path.strip_prefix(src).unwrap().to_owned();
            (module_of(&path), File::new(path, &text))
        })
        .collect();
    let krate = Crate { files };
    let mut imports = Imports::new();
    for (module, file) in &krate.files {
        let from = imports.entry(file.path.clone()).or_default();
        for used in &file.paths {
            let target = krate.resolve(module, used, 0);
            if let Some((target, name)) = target
                && target != file.path
                && (submodules || !is_within(&file.path, &target))
            {
                from.entry(target).or_insert(name);
            }
        }
    }
    imports
}

/// Cycles of imports, each in ascending order.
pub(crate) fn circles(imports: &Imports) -> Vec<Vec<PathBuf>> {
    let reached: BTreeMap<&PathBuf, BTreeSet<&PathBuf>> =
        imports.keys().map(|file| (file, reachable(imports, file))).collect();
    let together = |a: &PathBuf, b: &PathBuf| reached[a].contains(b) && reached[b].contains(a);
    let mut circles: Vec<Vec<PathBuf>> = Vec::new();
    for file in imports.keys().filter(|file| reached[file].contains(file)) {
        match circles.iter_mut().find(|circle| together(&circle[0], file)) {
            Some(circle) => circle.push(file.clone()),
            None => circles.push(vec![file.clone()]),
        }
    }
    circles
}

fn reachable<'a>(imports: &'a Imports, start: &PathBuf) -> BTreeSet<&'a PathBuf> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&PathBuf> = imports[start].keys().collect();
    while let Some(file) = open.pop() {
        if reached.insert(file) {
            open.extend(imports[file].keys());
        }
    }
    reached
}

/// Both the file `b` and the file `mod` of the folder `b`, in `a`, are the module `a::b`. A root
/// file is the crate itself, or the binary beside its library.
fn module_of(path: &Path) -> Vec<String> {
    let parts = path.with_extension("");
    let mut parts: Vec<String> =
        parts.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if ["mod", "lib"].contains(&parts.last().unwrap().as_str()) {
        parts.pop();
    }
    parts
}

/// True if a file is a submodule of a module that another file defines.
fn is_within(file: &Path, around: &Path) -> bool {
    let root = around == Path::new("main.rs");
    root || module_of(file).starts_with(&module_of(around))
}

struct Crate {
    files: BTreeMap<Vec<String>, File>,
}

impl Crate {
    /// The crate root as seen by a module: that of the binary if there is no library.
    fn root(&self) -> Vec<String> {
        let library = self.files.contains_key(&Vec::new());
        if library { Vec::new() } else { vec!["main".to_owned()] }
    }

    /// The file that defines what a path used in `module` refers to, and the name there; `None` for
    /// items of other crates, for modules themselves and for items local to a function.
    fn resolve(
        &self,
        module: &[String],
        path: &[String],
        depth: usize,
    ) -> Option<(PathBuf, String)> {
        let main = self.root();
        let home = |module: &[String]| {
            if module.is_empty() { main.clone() } else { module.to_vec() }
        };
        let mut at = module.to_vec();
        let mut rest = path;
        match rest.first()?.as_str() {
            "crate" => (at, rest) = (main.clone(), &rest[1..]),
            "self" => rest = &rest[1..],
            "super" => {}
            first => {
                let child = self.child(&at, first);
                let file = self.files.get(&at)?;
                if child.is_none() {
                    let bound = file.bound.get(first)?;
                    // The target of a name bound by `use` is itself a path from this module.
                    let whole: Vec<String> = bound.iter().chain(&rest[1..]).cloned().collect();
                    return (depth < 8 && whole != path)
                        .then(|| self.resolve(module, &whole, depth + 1))
                        .flatten();
                }
            }
        }
        while rest.first().is_some_and(|part| part == "super") {
            at.pop();
            at = home(&at);
            rest = &rest[1..];
        }
        while let Some(child) = rest.first().and_then(|part| self.child(&at, part)) {
            (at, rest) = (child, &rest[1..]);
        }
        let file = self.files.get(&at)?;
        let name = rest.first()?;
        if !file.defined.contains(name) && depth < 8 {
            if let Some(bound) = file.bound.get(name) {
                return self.resolve(&at, bound, depth + 1);
            }
            for glob in &file.globs {
                let mut path = glob.clone();
                path.push(name.clone());
                let found = self.resolve(&at, &path, depth + 1);
                if found.is_some() {
                    return found;
                }
            }
        }
        Some((file.path.clone(), name.clone()))
    }

    fn child(&self, module: &[String], name: &str) -> Option<Vec<String>> {
        let in_main =
            module.len() == 1 && module[0] == "main" && !self.files.contains_key(&Vec::new());
        let mut child = if in_main { Vec::new() } else { module.to_vec() };
        child.push(name.to_owned());
        (name != "main" && self.files.contains_key(&child)).then_some(child)
    }
}

struct File {
    path: PathBuf,
    /// Names defined by top-level items of the file.
    defined: BTreeSet<String>,
    /// Names bound by `use`, with their paths.
    bound: BTreeMap<String, Vec<String>>,
    /// Paths of `use …::*`.
    globs: Vec<Vec<String>>,
    /// Paths used in the code; those of a re-export only if the name is also used here.
    paths: Vec<Vec<String>>,
}

impl File {
    fn new(path: PathBuf, text: &str) -> Self {
        let tokens = without_tests(&tokens(text));
        let mut file = Self {
            path,
            defined: BTreeSet::new(),
            bound: BTreeMap::new(),
            globs: Vec::new(),
            paths: Vec::new(),
        };
        let (mut handed_on, mut mentioned) = (Vec::new(), BTreeSet::new());
        // Brace depth at which each inline module ends.
        let (mut inline, mut depth) = (Vec::new(), 0usize);
        let mut at = 0;
        while at < tokens.len() {
            let token = tokens[at].as_str();
            match token {
                "{" => depth += 1,
                "}" => {
                    depth = depth.saturating_sub(1);
                    if inline.last() == Some(&depth) {
                        inline.pop();
                    }
                }
                "mod" if tokens.get(at + 2).is_some_and(|next| next == "{") => inline.push(depth),
                "use" => {
                    let end = at + tokens[at..].iter().position(|token| token == ";").unwrap();
                    let public = at > 0 && (tokens[at - 1] == "pub" || tokens[at - 1] == ")");
                    for (mut path, name) in tree(&tokens[at + 1..end]) {
                        outward(&mut path, inline.len());
                        if name == "*" {
                            file.globs.push(path.clone());
                            path.push("*".to_owned());
                        } else if depth == 0 {
                            file.bound.insert(name.clone(), path.clone());
                        }
                        if public {
                            handed_on.push((name, path));
                        } else {
                            file.paths.push(path);
                        }
                    }
                    at = end;
                }
                "struct" | "enum" | "trait" | "type" | "fn" | "const" | "static" | "union"
                    if depth == 0 =>
                {
                    let name = tokens.get(at + 1).filter(|name| *name != "_");
                    file.defined.extend(name.cloned());
                }
                "macro_rules" => file.defined.extend(tokens.get(at + 2).cloned()),
                _ if is_name(token) && (at == 0 || tokens[at - 1] != "::") => {
                    mentioned.insert(token.to_owned());
                    let mut path = vec![token.to_owned()];
                    while tokens.get(at + 1).is_some_and(|next| next == "::")
                        && tokens.get(at + 2).is_some_and(|next| is_name(next))
                    {
                        path.push(tokens[at + 2].clone());
                        at += 2;
                    }
                    if path.len() > 1 {
                        outward(&mut path, inline.len());
                        file.paths.push(path);
                    }
                }
                _ => {}
            }
            at += 1;
        }
        let used = handed_on.into_iter().filter(|(name, _)| mentioned.contains(name));
        file.paths.extend(used.map(|(_, path)| path));
        file
    }
}

/// Removes as many leading `super` from a path as there are enclosing inline modules: they refer to
/// this file.
fn outward(path: &mut Vec<String>, inline: usize) {
    let supers = path.iter().take_while(|part| *part == "super").count();
    if supers > 0 && inline > 0 {
        path.drain(..supers.min(inline));
        if path.first().is_none_or(|part| part != "super") {
            path.insert(0, "self".to_owned());
        }
    }
}

/// Paths of a `use` declaration, each with the name it binds, `*` for a glob.
fn tree(tokens: &[String]) -> Vec<(Vec<String>, String)> {
    let (mut prefix, mut at) = (Vec::new(), 0);
    while at < tokens.len() {
        match tokens[at].as_str() {
            "::" => {}
            "*" => return vec![(prefix, "*".to_owned())],
            "as" => return vec![(prefix, tokens[at + 1].clone())],
            "{" => {
                let inner = &tokens[at + 1..tokens.len() - 1];
                let branches = split(inner);
                return branches
                    .into_iter()
                    .flat_map(tree)
                    .map(|(path, name)| {
                        let own = path.first().is_some_and(|part| part == "self");
                        let whole: Vec<String> =
                            prefix.iter().chain(&path[usize::from(own)..]).cloned().collect();
                        let name = if own && name == "self" {
                            prefix.last().unwrap().clone()
                        } else {
                            name
                        };
                        (whole, name)
                    })
                    .collect();
            }
            part => prefix.push(part.to_owned()),
        }
        at += 1;
    }
    let name = prefix.last().cloned().unwrap_or_default();
    vec![(prefix, name)]
}

/// Parts separated by commas outside inner braces.
fn split(tokens: &[String]) -> Vec<&[String]> {
    let (mut parts, mut depth, mut from) = (Vec::new(), 0, 0);
    for (at, token) in tokens.iter().enumerate() {
        match token.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            "," if depth == 0 => {
                parts.push(&tokens[from..at]);
                from = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&tokens[from..]);
    parts.retain(|part| !part.is_empty());
    parts
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Identifiers, `::` and single punctuation characters; no comments, no contents of string and
/// character literals.
fn tokens(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let (mut tokens, mut at) = (Vec::new(), 0);
    let text_at = |at: usize, text: &str| {
        text.chars().enumerate().all(|(i, c)| chars.get(at + i) == Some(&c))
    };
    while at < chars.len() {
        let char = chars[at];
        if text_at(at, "//") {
            while at < chars.len() && chars[at] != '\n' {
                at += 1;
            }
        } else if text_at(at, "/*") {
            while at < chars.len() && !text_at(at, "*/") {
                at += 1;
            }
            at += 2;
        } else if char == 'r'
            && (text_at(at + 1, "\"") || text_at(at + 1, "#\"") || text_at(at + 1, "##\""))
        {
            let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
            let end = format!("\"{}", "#".repeat(hashes));
            at += 2 + hashes;
            while at < chars.len() && !text_at(at, &end) {
                at += 1;
            }
            at += end.len();
        } else if char == '"' {
            at += 1;
            while at < chars.len() && chars[at] != '"' {
                at += if chars[at] == '\\' { 2 } else { 1 };
            }
            at += 1;
        } else if char == '\''
            && (chars.get(at + 1) == Some(&'\\') || chars.get(at + 2) == Some(&'\''))
        {
            at += if chars[at + 1] == '\\' { 3 } else { 2 };
            while at < chars.len() && chars[at] != '\'' {
                at += 1;
            }
            at += 1;
        } else if char.is_alphanumeric() || char == '_' {
            let from = at;
            while at < chars.len() && (chars[at].is_alphanumeric() || chars[at] == '_') {
                at += 1;
            }
            tokens.push(chars[from..at].iter().collect());
        } else if text_at(at, "::") {
            tokens.push("::".to_owned());
            at += 2;
        } else {
            if !char.is_whitespace() {
                tokens.push(char.to_string());
            }
            at += 1;
        }
    }
    tokens
}

/// The tokens without items marked `#[cfg(test)]`.
fn without_tests(tokens: &[String]) -> Vec<String> {
    let mark = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut kept, mut at) = (Vec::new(), 0);
    while at < tokens.len() {
        let marked = tokens[at..].iter().map(String::as_str).take(mark.len()).eq(mark);
        if !marked {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        let mut depth = 0;
        while at < tokens.len() {
            match tokens[at].as_str() {
                "{" => depth += 1,
                "}" => depth -= 1,
                _ => {}
            }
            let ends = tokens[at] == "}" || tokens[at] == ";";
            at += 1;
            if ends && depth == 0 {
                break;
            }
        }
    }
    kept
}
