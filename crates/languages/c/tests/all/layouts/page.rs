//! `docs/reference/layout.md`.

use std::fmt::Write as _;

use joulebus_wire::{Constant, FieldType, SCHEMA_VERSION, constants, layouts};

use super::header::{c_name, c_type};
use super::{compare, text_of};

#[test]
fn the_table_in_the_documentation_is_made_from_the_sources() {
    compare("docs/reference/layout.md", &made());
}

fn made() -> String {
    let mut page = format!(
        "# Layout of shared memory\n\n\
         Made from `crates/core/wire` by `JOULEBUS_WRITE=1 cargo test -p joulebus-c --test all layouts`, which also compares this page, the C \
         header and a compiled C program with it. `crates/languages/python/tests/test_layout.py` compares NumPy's types. Schema version \
         {SCHEMA_VERSION}.\n\n\
         All structs are `repr(C)`, little endian as the hosts are, aligned to 8 bytes and without padding. Units are those of the \
         names: W, J, s, m, rad, V, A, ns on the monotonic clock. An unknown value is NaN and has its flag cleared.\n"
    );
    for layout in layouts() {
        let (name, c) = (layout.name, c_name(layout.name));
        let words = text_of(layout.doc).replace('\n', " ");
        let size = layout.size;
        write!(
            page,
            "\n## {name}\n`{c}`, {size} bytes. {words}\n\n\
             | offset | field | C | NumPy | |\n|---|---|---|---|---|\n"
        )
        .unwrap();
        for field in layout.fields {
            let words = text_of(field.doc).replace('\n', " ");
            let (numpy, array) = (numpy(field.of), field.elements);
            let shape = array.map_or(String::new(), |count| format!("({count},)"));
            let c_array = array.map_or(String::new(), |count| format!("[{count}]"));
            writeln!(
                page,
                "| {} | `{}` | `{}{c_array}` | `{shape}{numpy}` | {} |",
                field.offset,
                field.name,
                c_type(field.of),
                words.replace('|', "\\|")
            )
            .unwrap();
        }
    }
    page.push_str("\n## Bits and codes\n\n| constant of C | value |\n|---|---|\n");
    for of in constants() {
        for Constant { name, value, .. } in &of.values {
            writeln!(page, "| `JOULEBUS_{}_{name}` | {value} |", of.of).unwrap();
        }
    }
    page
}

fn numpy(of: FieldType) -> &'static str {
    match of {
        FieldType::U16 => "<u2",
        FieldType::U32 => "<u4",
        FieldType::U64 => "<u8",
        FieldType::I64 => "<i8",
        FieldType::F32 => "<f4",
        FieldType::F64 => "<f8",
        FieldType::Struct(name) => name,
        other => panic!("no type of NumPy for {other:?}"),
    }
}
