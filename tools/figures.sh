#!/usr/bin/env bash
# Writes the report of measurements of a release: one commit, one machine, dated. It is
# target/figures/COMMIT/report.md, beside the figures themselves, NAME.json.
#
#   tools/figures.sh            some 20 minutes after the builds. Leave the machine alone meanwhile
#   tools/figures.sh --only tick,plan    only these
#   tools/figures.sh --quick    a minute, into target/figures/quick: a smoke test, whose figures are none
#
# It can be interrupted: what was measured on this commit is not measured again. It refuses sources
# that are not committed. JOULEBUS_PEERS names a directory with an existing environment of peers
# (default target/peers).
set -euo pipefail
cd "$(dirname "$0")/.."

quick=() long=20 only='' results='' peers=${JOULEBUS_PEERS:-target/peers}
while [ $# -gt 0 ]; do
    case $1 in
    --quick) quick=(--quick) long=2 results=target/figures/quick ;;
    --only) only=,$2, && shift ;;
    *) sed -n '2,/^set/s/^# \?//p' "$0" && exit 2 ;;
    esac
    shift
done
is_wanted() { [ -z "$only" ] || [[ $only == *,$1,* ]]; }

# What is measured. A commit of pages alone leaves its figures valid.
sources=(crates benches Cargo.toml Cargo.lock configs/models tools/peers)
commit=$(git log -1 --format=%H -- "${sources[@]}")
results=${results:-target/figures/$commit}
if [ ${#quick[@]} = 0 ] && [ -n "$(git status --porcelain -- "${sources[@]}")" ]; then
    echo "tools/figures.sh: these differ from the commit, so commit them first: ${sources[*]}" >&2
    exit 1
fi

# Compiles everything first, so that no build heats the machine between measurements.
cargo build --release --locked -p joulebus-bench
bench=${CARGO_TARGET_DIR:-target}/release/joulebus-bench
! is_wanted peers || python3 tools/peers/network.py --directory "$peers" --install
! is_wanted transport ||
    cargo build --release --locked --manifest-path tools/peers/transport/Cargo.toml --target-dir "$peers/target"
mkdir -p "$results"

# measure NAME COMMAND…: the command writes the file that follows its --json. A file appears when it is whole.
measure() {
    local name=$1 whole=target/figure-$1.json
    shift
    is_wanted "$name" && [ ! -f "$results/$name.json" ] || return 0
    printf '\n== %s: %s (after %d s)\n' "$name" "$*" "$SECONDS"
    "$@" --json "$whole"
    mv "$whole" "$results/$name.json"
}

measure kernel "$bench" kernel "${quick[@]}"
measure tick "$bench" tick --seconds $long "${quick[@]}"
measure learning "$bench" tick --learning --robots 1000 "${quick[@]}"
measure rollout "$bench" rollout "${quick[@]}"
measure plan "$bench" plan "${quick[@]}"
measure questions "$bench" questions --seconds $long "${quick[@]}"
measure latency "$bench" latency --seconds $long "${quick[@]}"
measure transport "$peers/target/release/joulebus-transport-peers" --seconds $long
measure peers python3 tools/peers/network.py --directory "$peers" "${quick[@]}"
{ printf '# Measurements of commit %s, %s\n\n' "$commit" "$(date -I)"; python3 tools/figures.py "$results"; } >"$results/report.md"
printf '\n== %s (after %d s)\n' "$results/report.md" "$SECONDS"
