#!/usr/bin/env bash
# Measures everything on this machine, in order, and fills the tables of docs/measured/performance.md.
#
#   tools/measure.sh            about 15 minutes after the builds; leave the machine alone meanwhile
#   tools/measure.sh --quick    a minute: a smoke test
#
# Figures: bench-results/*.json. JOULEBUS_PEERS names a directory with an existing environment of
# peers (default target/peers).
set -euo pipefail
cd "$(dirname "$0")/.."
results=bench-results
peers=${JOULEBUS_PEERS:-target/peers}
quick=()
long=20
[ "${1:-}" = --quick ] && quick=(--quick) && long=2
mkdir -p "$results"

step() {
    printf '\n== %s (after %d s)\n' "$*" "$SECONDS"
    "$@"
}
bench() {
    local name=$1
    shift
    step "$program" "$name" --json "$results/$name.json" "${quick[@]}" "$@"
}

# Compiles everything first, so that no build heats the machine between measurements.
step cargo build --release --locked -p joulebus-bench
target=$(cargo metadata --no-deps --format-version 1 | python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
program=$target/release/joulebus-bench
step python3 tools/peers/network.py --directory "$peers" --install
step cargo build --release --locked --manifest-path tools/peers/transport/Cargo.toml --target-dir "$peers/target"

bench kernel
bench tick --seconds "$long"
bench rollout
bench plan
bench latency --seconds "$long"
step "$peers/target/release/joulebus-transport-peers" --seconds "$long" --json "$results/transport.json"
step python3 tools/peers/network.py --directory "$peers" --json "$results/peers.json" --picture docs/measured/peers.svg "${quick[@]}"
if command -v valgrind >/dev/null; then
    step python3 tools/instructions.py --json "$results/instructions.json"
fi
[ ${#quick[@]} -gt 0 ] || step python3 tools/performance_tables.py
printf '\n== measured after %d s\n' "$SECONDS"
