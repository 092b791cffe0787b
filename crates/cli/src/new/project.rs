//! The files of a project, and the commands that build and run it.

use std::env;
use std::fs;
use std::path::Path;

use joulebus_program::exit::UsageError;
use joulebus_program::shell::{quoted, word};
use serde::Serialize;

use super::{Kind, Language};

const VERSION: &str = env!("CARGO_PKG_VERSION");
const CONFIG: &str = "configs/fleet.toml";

/// A project: what is written, and what is typed next.
pub(super) struct Project {
    /// Paths below its folder, with their text.
    pub(super) files: Vec<(String, String)>,
    /// The requirement of the commands that is still missing.
    pub(super) missing: Option<String>,
    pub(super) prepare: Vec<Command>,
    pub(super) run: Vec<Command>,
}

/// A command, as it is typed.
#[derive(Debug, Serialize)]
pub(super) struct Command {
    /// Purpose of the program.
    pub(super) about: String,
    pub(super) command: String,
}

impl Project {
    /// A project in `folder`, which need not exist. `sources` is a clone of joulebus.
    ///
    /// # Errors
    /// The commands could not be typed: a name that is not UTF-8.
    pub(super) fn new(
        kind: Kind,
        language: Language,
        folder: &Path,
        sources: Option<&Path>,
    ) -> Result<Self, UsageError> {
        for path in [Some(folder), sources].into_iter().flatten() {
            if path.to_str().is_none() {
                let shown = path.display();
                return Err(UsageError(format!("{shown} is not UTF-8: choose another name")));
            }
        }
        let mut project = Self {
            files: vec![(CONFIG.to_owned(), include_str!("../../templates/fleet.toml").to_owned())],
            missing: None,
            prepare: Vec::new(),
            run: Vec::new(),
        };
        let here = word(folder);
        let within = |about: &str, command: String| Command {
            about: about.to_owned(),
            command: format!("cd {here} && {command}"),
        };
        let own = match language {
            Language::Rust => project.rust(kind, folder, sources),
            Language::Python => {
                project.python(kind, sources);
                let install = "python3 -m venv venv && venv/bin/pip install -r requirements.txt";
                let about = "joulebus for Python, which takes some minutes to compile:";
                project.prepare.push(within(about, install.to_owned()));
                format!("venv/bin/python {}.py", kind.name())
            }
            Language::Cpp => {
                project.cpp(kind);
                if let Some(sources) = sources {
                    let install = word(&sources.join("tools/install_c.sh"));
                    project.prepare.push(Command {
                        about: "the C library, which takes some minutes to compile:".to_owned(),
                        command: format!("{install} --prefix \"$HOME/.local\""),
                    });
                }
                let build = "cmake -S . -B build -DCMAKE_PREFIX_PATH=\"$HOME/.local\" && cmake --build build";
                project.prepare.push(within("the project:", build.to_owned()));
                format!("build/{}", kind.name())
            }
        };
        if sources.is_none() {
            project.missing = Some(format!(
                "joulebus {VERSION} is not published yet: clone its sources, and name them with --sources"
            ));
        }
        let joulebus = this_program();
        let with_config = |program: &str| format!("{program} {CONFIG}");
        let worker = within("the worker:", format!("{joulebus} run --config {CONFIG}"));
        let own = within(&format!("this {}, until Ctrl-C:", kind.name()), with_config(&own));
        let other = match kind {
            Kind::Controller => within(
                "forecasts, batteries and alarms, live:",
                format!("{joulebus} watch --config {CONFIG}"),
            ),
            Kind::Planner => within(
                "a simulated controller:",
                format!("{joulebus} publish sim --config {CONFIG} --robots 20"),
            ),
        };
        project.run = vec![worker, own, other];
        Ok(project)
    }

    /// Returns the command that runs it.
    fn rust(&mut self, kind: Kind, folder: &Path, sources: Option<&Path>) -> String {
        let mut manifest =
            include_str!("../../templates/Cargo.toml.in").replace("@KIND@", kind.name());
        let (package, program) = match kind {
            Kind::Controller => ("publisher", include_str!("../../templates/controller.rs")),
            Kind::Planner => ("consumer", include_str!("../../templates/planner.rs")),
        };
        // Processes of one fleet are of one release.
        let version = format!("version = \"={VERSION}\"");
        manifest += &match sources {
            Some(sources) => format!(
                "# Not on crates.io yet, so `path` names the sources. Remove it once joulebus is \
                    published.\n\
                 joulebus-{package} = {{ {version}, path = {:?} }}\n",
                sources.join("crates").join(package)
            ),
            None => format!(
                "# Not on crates.io yet: add `path = \"CLONE/crates/{package}\"`.\n\
                 joulebus-{package} = {{ {version} }}\n"
            ),
        };
        if lies_in_workspace(folder) {
            manifest += "\n# Not a member of the workspace around it.\n[workspace]\n";
        }
        self.files.push(("Cargo.toml".to_owned(), manifest));
        self.files.push(("src/main.rs".to_owned(), program.to_owned()));
        "cargo run --".to_owned()
    }

    fn python(&mut self, kind: Kind, sources: Option<&Path>) {
        let program = match kind {
            Kind::Controller => include_str!("../../templates/controller.py"),
            Kind::Planner => include_str!("../../templates/planner.py"),
        };
        let requirement = match sources {
            Some(sources) => format!(
                "# Not on PyPI yet: built from the sources, by Rust of rustup.\n{}\n",
                sources.join("crates/languages/python").display()
            ),
            None => format!(
                "# Not on PyPI yet: write CLONE/crates/languages/python.\njoulebus=={VERSION}\n"
            ),
        };
        self.files.push((format!("{}.py", kind.name()), program.to_owned()));
        self.files.push(("requirements.txt".to_owned(), requirement));
    }

    fn cpp(&mut self, kind: Kind) {
        let program = match kind {
            Kind::Controller => include_str!("../../templates/controller.cpp"),
            Kind::Planner => include_str!("../../templates/planner.cpp"),
        };
        // Sources of releases before 1.0 fit each other by their second number.
        let series = VERSION.rsplit_once('.').map_or(VERSION, |(series, _)| series);
        let build = include_str!("../../templates/CMakeLists.txt.in")
            .replace("@KIND@", kind.name())
            .replace("@SERIES@", series);
        self.files.push((format!("{}.cpp", kind.name()), program.to_owned()));
        self.files.push(("CMakeLists.txt".to_owned(), build));
    }
}

impl Kind {
    /// Name of the project's program.
    const fn name(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Planner => "planner",
        }
    }
}

/// True if Cargo would take a project in `folder` for a member of a workspace.
fn lies_in_workspace(folder: &Path) -> bool {
    let Ok(whole) = std::path::absolute(folder) else {
        return false;
    };
    let is_workspace =
        |manifest: String| manifest.lines().any(|line| line.starts_with("[workspace"));
    let mut around = whole.ancestors().skip(1);
    around.any(|folder| fs::read_to_string(folder.join("Cargo.toml")).is_ok_and(is_workspace))
}

/// This program as a word of a command: its name where the shell would find this very file.
fn this_program() -> String {
    let name = "joulebus";
    let Ok(own) = env::current_exe().and_then(fs::canonicalize) else {
        return name.to_owned();
    };
    let path = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&path).map(|folder| folder.join(name)).find(|file| file.is_file());
    match found.and_then(|file| fs::canonicalize(file).ok()) {
        Some(found) if found == own => name.to_owned(),
        _ => quoted(&own.display().to_string()),
    }
}
