//! `include/joulebus.h`.

use std::fmt::Write as _;

use cbindgen::{Builder, Config, DocumentationStyle, ExportConfig, Language, RenameRule, Style};
use joulebus_wire::{Constant, FieldType, SCHEMA_VERSION, constants, layouts};

use super::{compare, root, snake, text_of};

const WIDTH: usize = 100;

#[test]
fn the_c_header_is_made_from_the_sources() {
    compare("crates/languages/c/include/joulebus.h", &made());
}

fn made() -> String {
    let folder = root().join("crates/languages/c/src/abi");
    let mut config = Config {
        language: Language::C,
        cpp_compat: true,
        include_guard: Some("JOULEBUS_H".to_owned()),
        no_includes: true,
        sys_includes: ["stddef.h", "stdint.h"].map(str::to_owned).to_vec(),
        header: Some(TOP.to_owned()),
        after_includes: Some(shared_memory()),
        documentation_style: DocumentationStyle::Doxy,
        usize_is_size_t: true,
        style: Style::Both,
        line_length: WIDTH,
        tab_width: 4,
        export: ExportConfig {
            rename: layouts()
                .iter()
                .map(|layout| (layout.name.to_owned(), c_name(layout.name)))
                .collect(),
            ..ExportConfig::default()
        },
        ..Config::default()
    };
    config.enumeration.rename_variants = RenameRule::QualifiedScreamingSnakeCase;
    let mut builder = Builder::new().with_config(config);
    for file in ["types", "errors", "publisher", "subscriber", "questions", "client", "predictor"] {
        builder = builder.with_src(folder.join(file).with_extension("rs"));
    }
    let mut text = Vec::new();
    builder.generate().unwrap().write(&mut text);
    String::from_utf8(text).unwrap()
}

const TOP: &str = "/**
 * @file
 * libjoulebus: publisher, subscriber, questions about plans and predictor of joulebus, a
 * shared-memory energy broker for robot fleets. docs/tutorial/cpp.md introduces it. joulebus.hpp is
 * a layer above for C++17.
 *
 * This file is made from the sources of joulebus-c and joulebus-wire: cargo test -p joulebus-c
 * --test all layouts.
 *
 * Errors. Calls return a joulebus_error. joulebus_last_error() has the message. After an error a
 * call has written no results, unless its comment says otherwise. No call aborts the program
 * because of its arguments or of what it reads.
 *
 * Threads. A publisher, subscriber, frame, questions or client belongs to the thread that opened
 * it. A call by another thread is refused (JOULEBUS_ERROR_THREAD), also one that closes it. Each
 * thread may open its own. A predictor may be used by any thread. A signal handler must make no
 * call. If it does, the call that it interrupted is not disturbed. The handler's calls on the same
 * handle are refused.
 *
 * Processes. In a child made by fork, handles of the parent are refused (JOULEBUS_ERROR_PROCESS).
 * The parent's memory is not disturbed. Open other handles in the child. Handles of a process may
 * be of several fleets.
 *
 * Handles are numbers in the shape of pointers. A handle that is closed, NULL or invalid is
 * refused. Closing twice is an error and nothing else. A handle that is open when its thread ends
 * stays open until the process ends. Other members of the fleet then remove what is left.
 *
 * The caller promises that every pointer that is not NULL points to as many elements as the call
 * says, aligned, in memory that no other thread changes meanwhile. NULL is allowed where a comment
 * says so, and for arrays without elements. Texts are UTF-8 and end with a zero. Do not write to
 * what a call returns in shared memory. You may read it until the time that the call states.
 *
 * Units: W, J, s, m, rad, V, A, ns. Times are of the host's monotonic clock
 * (joulebus_monotonic_ns()). Unknown values have their flag cleared, and are NaN.
 */";

/// Version, structs and constants of `joulebus-wire`.
fn shared_memory() -> String {
    let mut text = String::new();
    let version = env!("CARGO_PKG_VERSION");
    for (words, name, value) in [
        ("The release of this header.", "VERSION", format!("\"{version}\"")),
        (
            "Checked when a handle is opened: header and library must be of one release.",
            "HEADER",
            format!("\"{version}, schema {SCHEMA_VERSION}\""),
        ),
    ] {
        writeln!(text, "\n/** {words} */\n#define JOULEBUS_{name} {value}").unwrap();
    }
    bits_and_codes(&mut text);
    for layout in layouts() {
        let name = c_name(layout.name);
        let words = text_of(layout.doc);
        write!(text, "\n{}typedef struct {name} {{\n", comment("", &words)).unwrap();
        for field in layout.fields {
            let words = comment("    ", &text_of(field.doc));
            let array = field.elements.map_or(String::new(), |count| format!("[{count}]"));
            writeln!(text, "{words}    {} {}{array};", c_type(field.of), field.name).unwrap();
        }
        writeln!(text, "}} {name};").unwrap();
    }
    text
}

fn bits_and_codes(text: &mut String) {
    for of in constants() {
        writeln!(text).unwrap();
        for Constant { name, value, doc } in &of.values {
            if of.bits {
                let words = comment("", &text_of(doc));
                writeln!(text, "{words}#define JOULEBUS_{}_{name} {value:#x}u", of.of).unwrap();
            } else {
                writeln!(text, "#define JOULEBUS_{}_{name} {value}u", of.of).unwrap();
            }
        }
    }
}

fn comment(indent: &str, words: &str) -> String {
    let room = WIDTH - indent.len() - 3;
    let mut lines = vec![String::new()];
    for paragraph in words.split('\n') {
        for word in paragraph.split(' ') {
            let line = lines.last_mut().unwrap();
            if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > room {
                lines.push(word.to_owned());
            } else {
                line.push_str(if line.is_empty() { "" } else { " " });
                line.push_str(word);
            }
        }
        lines.push(String::new());
    }
    lines.pop();
    if let [line] = lines.as_slice()
        && line.chars().count() + 4 <= room
    {
        return format!("{indent}/** {line} */\n");
    }
    let lines: String = lines.iter().map(|line| format!("{indent} * {line}\n")).collect();
    format!("{indent}/**\n{lines}{indent} */\n")
}

/// A struct's name in C.
pub(crate) fn c_name(name: &str) -> String {
    format!("joulebus_{}", snake(name))
}

pub(crate) fn c_type(of: FieldType) -> String {
    match of {
        FieldType::U16 => "uint16_t".to_owned(),
        FieldType::U32 => "uint32_t".to_owned(),
        FieldType::U64 => "uint64_t".to_owned(),
        FieldType::I64 => "int64_t".to_owned(),
        FieldType::F32 => "float".to_owned(),
        FieldType::F64 => "double".to_owned(),
        FieldType::Struct(name) => c_name(name),
        other => panic!("no type of C for {other:?}"),
    }
}
