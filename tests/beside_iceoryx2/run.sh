#!/usr/bin/env bash
# Builds a program that uses joulebus and iceoryx2 for itself, on its defaults, as a new project, and
# runs it beside two fleets. `target/debug/joulebus` must be built.
set -euo pipefail
cd "$(dirname "$0")/../.."
project=target/beside-iceoryx2
rm -rf "$project"
mkdir -p "$project/src"
cp tests/beside_iceoryx2/main.rs "$project/src"
# A workspace of its own: iceoryx2's features would be those of our programs, too.
{
    printf '[package]\nname = "beside-iceoryx2"\nedition = "2024"\n\n[workspace]\n\n'
    sed "s,\"\.\./joulebus/,\"$PWD/," tests/beside_iceoryx2/dependencies.toml
    sed -n '/^\[profile\.dev\(\.package\."\*"\)\?\]/,/^$/p' Cargo.toml
} >"$project/Cargo.toml"
cp Cargo.lock "$project"
cargo run --quiet --offline --manifest-path "$project/Cargo.toml" --target-dir target -- "$PWD/target/debug/joulebus"
echo 'a program that also uses iceoryx2 works with two fleets'
