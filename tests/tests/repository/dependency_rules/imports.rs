//! Imports between the files of a crate: `use` declarations and paths through `crate`, `self`,
//! `super` and modules, resolved to the file that defines the name. A re-export only passes a name
//! on: its user depends on the definition.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};

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

#[derive(Default)]
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
    /// Names that are re-exported, with their paths.
    handed_on: Vec<(String, Vec<String>)>,
    /// Names in the code, outside of `use`.
    mentioned: BTreeSet<String>,
}

impl File {
    fn new(path: PathBuf, text: &str) -> Self {
        let mut file = Self { path, ..Self::default() };
        file.read(text.parse().unwrap(), 0, true);
        let handed_on = std::mem::take(&mut file.handed_on).into_iter();
        let used = handed_on.filter(|(name, _)| file.mentioned.contains(name));
        file.paths.extend(used.map(|(_, path)| path));
        file
    }

    /// Reads the file, or what stands within brackets in it, in so many inline modules.
    fn read(&mut self, tokens: TokenStream, inline: usize, is_top: bool) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let name_at = |at: usize| match tokens.get(at) {
            Some(TokenTree::Ident(name)) => Some(name.to_string()),
            _ => None,
        };
        let is_path_at = |at: usize| is_colons(&tokens[at.min(tokens.len())..]);
        let mut at = 0;
        while at < tokens.len() {
            if is_of_tests(&tokens[at..]) {
                let ends = |token: &TokenTree| is_punct(token, ';') || is_block(token);
                at += tokens[at..].iter().position(ends).unwrap_or(tokens.len()) + 1;
                continue;
            }
            if let TokenTree::Group(group) = &tokens[at] {
                let is_module = at > 1 && name_at(at - 2).as_deref() == Some("mod");
                self.read(group.stream(), inline + usize::from(is_module), false);
            }
            let Some(word) = name_at(at) else {
                at += 1;
                continue;
            };
            match word.as_str() {
                "use" if !tokens.get(at + 1).is_some_and(|next| is_punct(next, '<')) => {
                    let end = tokens[at..].iter().position(|token| is_punct(token, ';')).unwrap();
                    let before = tokens[..at].last().map(TokenTree::to_string).unwrap_or_default();
                    let is_public = before == "pub" || before.starts_with('(');
                    for (path, name) in tree(&tokens[at + 1..at + end]) {
                        self.import(outward(path, inline), name, is_public, is_top);
                    }
                    at += end;
                }
                "struct" | "enum" | "trait" | "type" | "fn" | "const" | "static" | "union"
                    if is_top =>
                {
                    self.defined.extend(name_at(at + 1).filter(|name| name != "_"));
                }
                "macro_rules" => self.defined.extend(name_at(at + 2)),
                _ if at < 2 || !is_path_at(at - 2) => {
                    self.mentioned.insert(word.clone());
                    let mut path = vec![word];
                    while is_path_at(at + 1)
                        && let Some(next) = name_at(at + 3)
                    {
                        path.push(next);
                        at += 3;
                    }
                    if path.len() > 1 {
                        self.paths.push(outward(path, inline));
                    }
                }
                _ => {}
            }
            at += 1;
        }
    }

    /// One path of a `use` declaration, and the name that it binds.
    fn import(&mut self, mut path: Vec<String>, name: String, is_public: bool, is_top: bool) {
        if name == "*" {
            self.globs.push(path.clone());
            path.push("*".to_owned());
        } else if is_top {
            self.bound.insert(name.clone(), path.clone());
        }
        if is_public {
            self.handed_on.push((name, path));
        } else {
            self.paths.push(path);
        }
    }
}

/// The path without as many leading `super` as there are enclosing inline modules: they refer to
/// this file.
fn outward(mut path: Vec<String>, inline: usize) -> Vec<String> {
    let supers = path.iter().take_while(|part| *part == "super").count();
    if supers > 0 && inline > 0 {
        path.drain(..supers.min(inline));
        if path.first().is_none_or(|part| part != "super") {
            path.insert(0, "self".to_owned());
        }
    }
    path
}

/// Paths of a `use` declaration, each with the name it binds, `*` for a glob.
fn tree(tokens: &[TokenTree]) -> Vec<(Vec<String>, String)> {
    let mut prefix = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        match token {
            TokenTree::Group(group) => {
                let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                let branches = inner.split(|token| is_punct(token, ','));
                let whole = |(path, name): (Vec<String>, String)| {
                    let own = path.first().is_some_and(|part| part == "self");
                    let rest = &path[usize::from(own)..];
                    let is_prefix = own && name == "self";
                    let name = if is_prefix { prefix.last().cloned() } else { Some(name) };
                    ([&prefix, rest].concat(), name.unwrap())
                };
                let branches = branches.filter(|branch| !branch.is_empty());
                return branches.flat_map(tree).map(whole).collect();
            }
            TokenTree::Ident(word) if word == "as" => {
                return vec![(prefix, tokens[at + 1].to_string())];
            }
            TokenTree::Ident(word) => prefix.push(word.to_string()),
            star if is_punct(star, '*') => return vec![(prefix, "*".to_owned())],
            _ => {}
        }
    }
    let name = prefix.last().cloned().unwrap_or_default();
    vec![(prefix, name)]
}

fn is_punct(token: &TokenTree, char: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == char)
}

fn is_block(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Group(group) if group.delimiter() == Delimiter::Brace)
}

/// True if `::` comes first.
fn is_colons(tokens: &[TokenTree]) -> bool {
    tokens.len() > 1 && tokens[..2].iter().all(|token| is_punct(token, ':'))
}

/// True if the next item is marked `#[cfg(test)]`.
fn is_of_tests(tokens: &[TokenTree]) -> bool {
    let mark = |token: &TokenTree| token.to_string().replace(' ', "") == "[cfg(test)]";
    tokens.len() > 1 && is_punct(&tokens[0], '#') && mark(&tokens[1])
}
