#!/usr/bin/env bash
# Measures the figures of the pages: one commit, one machine. Writes target/figures/COMMIT/NAME.json,
# and report.md beside them, which a release keeps.
#
#   tools/figures.sh            some 20 minutes after the builds. Leave the machine alone meanwhile
#   tools/figures.sh --list     what is measured, and what is still to be measured
#   tools/figures.sh --only tick,plan    only these
#   tools/figures.sh --quick    a minute, into target/figures/quick: a smoke test, whose figures are none
#
# It can be interrupted: what was measured on this commit is not measured again. No step begins 120 minutes after the start. It refuses sources that are not committed. JOULEBUS_PEERS
# names a directory with an existing environment of peers (default target/peers).
set -euo pipefail
cd "$(dirname "$0")/.."

results='' picture=docs/measured/peers.svg peers=${JOULEBUS_PEERS:-target/peers}
quick=() long=20 only='' list=''
while [ $# -gt 0 ]; do
    case $1 in
    --quick) quick=(--quick) long=2 results=target/figures/quick picture=target/figures/quick/peers.svg ;;
    --only) only=,$2, && shift ;;
    --list) list=1 ;;
    *) sed -n '2,/^set/s/^# \?//p' "$0" && exit 2 ;;
    esac
    shift
done
last=$((120 * 60))
# What is measured. A commit of pages alone leaves its figures valid.
sources=(crates benches Cargo.toml Cargo.lock configs/models tools/peers)
commit=$(git log -1 --format=%H -- "${sources[@]}")
results=${results:-target/figures/$commit}

# The figures are of the commit that they state.
if [ -z "$list" ] && [ ${#quick[@]} = 0 ] && [ -n "$(git status --porcelain -- "${sources[@]}")" ]; then
    echo "tools/figures.sh: these differ from the commit, so commit them first: ${sources[*]}" >&2
    exit 1
fi

# Whether NAME was measured on this commit.
is_done() { [ -f "$results/$1.json" ]; }
is_wanted() { [ -z "$only" ] || [[ $only == *,$1,* ]]; }

built=''
# Compiles everything first, so that no build heats the machine between measurements.
build() {
    [ -z "$built" ] || return 0
    built=1
    cargo build --release --locked -p joulebus-bench
    target=$(cargo metadata --no-deps --format-version 1 | python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
    bench=$target/release/joulebus-bench
    if is_wanted peers; then
        python3 tools/peers/network.py --directory "$peers" --install
    fi
    if is_wanted transport; then
        cargo build --release --locked --manifest-path tools/peers/transport/Cargo.toml --target-dir "$peers/target"
    fi
    mkdir -p "$results"
}

# measure NAME COMMAND…: the command writes the file that follows its --json.
measure() {
    local name=$1
    shift
    is_wanted "$name" || return 0
    if is_done "$name"; then
        printf '%-13s measured\n' "$name"
        return
    fi
    if [ -n "$list" ]; then
        printf '%-13s to be measured: %s\n' "$name" "$*"
        return
    fi
    if [ "$SECONDS" -gt "$last" ]; then
        printf '%-13s left: 120 minutes are over; run tools/figures.sh again\n' "$name"
        return
    fi
    build
    printf '\n== %s: %s (after %d s)\n' "$name" "$*" "$SECONDS"
    # A file appears when it is whole.
    local whole=target/figure-$name.json
    eval "$*" --json "$whole"
    mv "$whole" "$results/$name.json"
}

measure kernel '"$bench"' kernel "${quick[@]}"
measure tick '"$bench"' tick --seconds $long "${quick[@]}"
measure learning '"$bench"' tick --fleet learning --robots 1000 --threads 1 "${quick[@]}"
measure rollout '"$bench"' rollout "${quick[@]}"
measure plan '"$bench"' plan "${quick[@]}"
measure questions '"$bench"' questions --seconds $long "${quick[@]}"
measure latency '"$bench"' latency --seconds $long "${quick[@]}"
measure transport '"$peers/target/release/joulebus-transport-peers"' --seconds $long
measure peers python3 tools/peers/network.py --directory '"$peers"' --picture "$picture" "${quick[@]}"
if [ -z "$list" ]; then
    { printf '# Figures of commit %s, %s\n\n' "$commit" "$(date -I)"; python3 tools/figures.py "$results"; } >"$results/report.md"
    printf '\n== %s\n' "$results/report.md"
fi
printf '\n== after %d s\n' "$SECONDS"
