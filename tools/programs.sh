#!/usr/bin/env bash
# Names of the programs that are installed, one a line: those of the Debian package. Each is a
# package of its own name.
sed -n 's|^ *\["target/release/\(joulebus[a-z-]*\)", "usr/bin/", "755"\],$|\1|p' "$(dirname "$0")/../crates/cli/Cargo.toml"
