#!/usr/bin/env bash
# From nothing to an alarm, as who writes a controller in Rust: programs of dist/, `joulebus new`, a
# green page, 3 W too many, LevelHigh.
#
#     tools/walks/rust.sh
#
# Of this machine it takes the Rust toolchain and what Cargo has downloaded: a new CARGO_HOME with
# the registry of the real one. Crates of joulebus are those of this clone (`--sources`) as long as
# crates.io has none.
. "$(dirname "$0")/step.sh"
cargo_home=${CARGO_HOME:-$HOME/.cargo}
toolchain=$(rustup which cargo) || { echo 'tools/walks/rust.sh: no Rust by rustup' >&2; exit 1; }
toolchain=$(dirname "$toolchain")
walk_begins rust
mkdir "$home/.cargo"
for cache in registry git; do [ ! -d "$cargo_home/$cache" ] || ln -s "$cargo_home/$cache" "$home/.cargo/$cache"; done
export CARGO_HOME=$home/.cargo PATH=$home/joulebus/bin:$toolchain:$PATH
unset CARGO_TARGET_DIR

step 'the programs are unpacked' unpack_programs
step 'joulebus new planner' joulebus new planner --sources "$repository" planner
step 'joulebus new controller' joulebus new controller --sources "$repository" controller
own_domain controller/configs/fleet.toml
cp controller/configs/fleet.toml planner/configs/fleet.toml
config=$home/controller/configs/fleet.toml
# The versions that this machine has downloaded.
for project in planner controller; do cp "$repository/Cargo.lock" $project; done
# A robot that gets a load while the controller runs.
sed -i 's/^\( *\)let power_w = 2.8 +/\1let load_w = if robot == 7 \&\& Path::new("loaded").exists() { 3.0 } else { 0.0 };\n\1let power_w = load_w + 2.8 +/' \
    controller/src/main.rs
grep -q load_w controller/src/main.rs
step 'cargo build, in the planner, from a warm registry' cargo build --quiet --manifest-path planner/Cargo.toml
# One folder of builds, as who has both in one workspace.
step 'cargo build, in the controller' env CARGO_TARGET_DIR="$home/planner/target" cargo build --quiet --manifest-path controller/Cargo.toml
background worker joulebus run --config "$config"
step 'the worker is ready' seen worker '^ready'
background page joulebus serve --http 127.0.0.1:0 --config "$config"
step 'the page is served' seen page 'http://'
page=$(grep -o 'http://[0-9.:]*' "$home/.page.log" | head -n 1)
background controller planner/target/debug/controller "$config"
background planner planner/target/debug/planner "$config"
step 'the page is green: 20 robots are ok' until_says '"robots":20,"ok":20' curl -s "$page/api/v1/fleet"
step 'the planner prints forecasts' seen planner ' W'
printf 'x_m,y_m\n0,0\n1,0\n' >out.csv
step 'joulebus ask: yes' until_says ': yes$' joulebus ask --config "$config" --robot 7 --path out.csv --return dock
# Its usual draw is known by then.
step 'ten seconds later, robot 7 gets a load of 3 W' sleep 10
touch loaded
step 'LevelHigh of robot 7, which is promised within 6 s' until_says '"robot":7,"alarm":"LevelHigh"' curl -s "$page/api/v1/alarms"
step 'its card' joulebus alarms --explain LevelHigh
walk_says 'a green page, a yes, and an alarm that explains itself'
