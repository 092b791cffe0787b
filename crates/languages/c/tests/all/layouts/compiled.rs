//! Offsets of the fields by compilers of C and C++.

use std::fmt::Write as _;
use std::fs;
use std::process::Command;

use joulebus_wire::{Constant, constants, layouts};

use super::header::c_name;
use super::root;

/// A compiler, if it is there. Without one the tests skip, and fail with CI=true.
fn compiler(name: &str) -> Option<&str> {
    let found = Command::new(name).arg("--version").output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(name);
    }
    eprintln!("skipped: no {name}");
    assert!(std::env::var("CI").as_deref() != Ok("true"), "CI=true needs {name}");
    None
}

/// Prints a line for each struct, field and constant.
fn program() -> String {
    let mut text = String::from(
        "#include <joulebus.h>\n#include <stdio.h>\n#include <string.h>\nint main(void) {\n",
    );
    for layout in layouts() {
        let name = c_name(layout.name);
        writeln!(text, "printf(\"{name} %zu\\n\", sizeof({name}));").unwrap();
        for field in layout.fields {
            let field = field.name;
            writeln!(
                text,
                "printf(\"{name}.{field} %zu %zu\\n\", offsetof({name}, {field}), sizeof((({name} *)0)->{field}));"
            )
            .unwrap();
        }
    }
    for of in constants() {
        for Constant { name, .. } in &of.values {
            let name = format!("JOULEBUS_{}_{name}", of.of);
            writeln!(text, "printf(\"{name} %u\\n\", {name});").unwrap();
        }
    }
    text + "return strcmp(JOULEBUS_VERSION, \"\") == 0; }\n"
}

/// The same of the layouts of Rust.
fn expected() -> String {
    let mut text = String::new();
    for layout in layouts() {
        let name = c_name(layout.name);
        writeln!(text, "{name} {}", layout.size).unwrap();
        for field in layout.fields {
            writeln!(text, "{name}.{} {} {}", field.name, field.offset, field.size).unwrap();
        }
    }
    for of in constants() {
        for Constant { name, value, .. } in &of.values {
            writeln!(text, "JOULEBUS_{}_{name} {value}", of.of).unwrap();
        }
    }
    text
}

#[test]
fn compilers_of_c_and_cpp_put_all_fields_where_rust_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let include = root().join("crates/languages/c/include");
    for (name, file, standard) in [
        ("cc", "layout.c", "-std=c99"),
        ("cc", "layout.c", "-std=c11"),
        ("c++", "layout.cpp", "-std=c++17"),
    ] {
        let Some(compiler) = compiler(name) else {
            continue;
        };
        let (source, binary) = (folder.path().join(file), folder.path().join("layout"));
        fs::write(&source, program()).unwrap();
        let made = Command::new(compiler)
            .args([standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
            .args([&include, &source])
            .arg("-o")
            .arg(&binary)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let printed = Command::new(&binary).output().unwrap();
        assert!(printed.status.success());
        let printed = String::from_utf8(printed.stdout).unwrap();
        for (found, expected) in printed.lines().zip(expected().lines()) {
            assert_eq!(found, expected, "{standard}");
        }
        assert_eq!(printed.lines().count(), expected().lines().count());
    }
}
