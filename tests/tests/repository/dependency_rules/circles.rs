//! No import cycles, and within `fleet` only downward imports.

use std::path::{Path, PathBuf};

use joulebus_testkit::cases;

use super::imports::{circles, imports};
use super::{crates, members, members_below, root};

/// Crates in which a submodule may import from an enclosing module that calls it; in all others not
/// even these may import each other.
const LENIENT: [&str; 3] = ["benches", "cli", "lab"];

#[test]
fn files_have_no_import_cycles() {
    let mut described = String::new();
    let others = ["benches", "tests/simulator"].map(|folder| members_below(&root().join(folder)));
    for member in members().into_iter().chain(others.into_iter().flatten()) {
        let name = member.name;
        let (src, lenient) = (member.directory.join("src"), LENIENT.contains(&name.as_str()));
        assert!(
            !lenient || !circles(&imports(&src, true)).is_empty(),
            "{name} has no such import: remove it from the list"
        );
        let imports = imports(&src, !lenient);
        for circle in circles(&imports) {
            for from in &circle {
                let within = imports[from].iter().filter(|(to, _)| circle.contains(to));
                described.extend(within.map(|(to, taken)| {
                    let (from, to) = (from.display(), to.display());
                    format!("{name}: {from} imports `{taken}` from {to}\n")
                }));
            }
        }
    }
    assert!(described.is_empty(), "\n{described}");
}

/// The layers of `fleet`, from the lowest.
const LAYERS: [&str; 8] =
    ["layout", "ingest", "ledger", "estimate", "alarms", "state", "tick", "fleet"];

#[test]
fn the_layers_of_the_fleet_import_only_downward() {
    let imports = imports(&crates().join("core/fleet/src"), true);
    let layer = |file: &PathBuf| {
        let folder = file.iter().next().unwrap().to_str().unwrap();
        LAYERS.iter().position(|layer| *layer == folder)
    };
    let mut downward = 0;
    for (from, targets) in &imports {
        if from == Path::new("lib.rs") {
            continue;
        }
        let above = layer(from).unwrap_or_else(|| panic!("{} is in no layer", from.display()));
        for (to, taken) in targets {
            let below = layer(to).unwrap_or_else(|| panic!("{} is in no layer", to.display()));
            assert!(
                below <= above,
                "{} imports `{taken}` from {}, a higher layer",
                from.display(),
                to.display()
            );
            downward += usize::from(below < above);
        }
    }
    assert!(downward > 50, "found only {downward} imports: imports are not detected");
}

/// Checks that cycles are found: two files in a temporary directory, for each form of path.
#[test]
fn an_import_cycle_is_found_in_every_notation() {
    for case in cases(
        r#"
        use crate::two::Two; pub struct One; | use crate::one::One; pub struct Two; | true
        use super::two; pub fn one() { two::two() } | pub fn two() { crate::one::one() } | true
        use crate::{two::{self, Two}}; pub struct One(Two); | use super::One; pub struct Two; | true
        use crate::two::Two; pub struct One; | pub struct Two; // use crate::one::One; | false
        use crate::two::Two; pub struct One; | pub struct Two; #[cfg(test)] mod tests { use crate::one::One; } | false
        use crate::two::Two; pub struct One; | pub const TWO: &str = "crate::one::One"; pub struct Two; | false
        pub use crate::two::Two; pub struct One; | use crate::one::One; pub struct Two; | false
        pub use crate::two::Two; pub struct One(Two); | use crate::one::One; pub struct Two; | true
        "#,
    ) {
        let [one, two, circle] = case.as_slice() else {
            panic!("{case:?}");
        };
        let directory = tempfile::tempdir().unwrap();
        let write =
            |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
        write("lib.rs", "mod one; mod two; pub use one::One;");
        write("one.rs", one);
        write("two.rs", two);
        let found = circles(&imports(directory.path(), false));
        assert_eq!((!found.is_empty()).to_string(), *circle, "{one}\n{two}\n{found:?}");
    }
}
