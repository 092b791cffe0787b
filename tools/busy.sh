#!/usr/bin/env bash
# Runs the tests on a busy machine: beside eight busy loops, on any number of cores.
# Usage: tools/busy.sh RUNS [cargo test arguments…]   (default of the arguments: --workspace)
# Compiles first, runs the tests RUNS times, and prints for each run the passes, failures and duration.
# Logs are kept in target/busy/. Exits with 1 if anything failed.
set -uo pipefail
cd "$(dirname "$0")/.."

runs=${1:-}
if ! [[ $runs =~ ^[1-9][0-9]*$ ]]; then
    sed -n '2,5s/^# //p' "$0" >&2
    exit 2
fi
shift
[ $# -gt 0 ] || set -- --workspace
export CARGO_TERM_COLOR=never

cargo test --locked --no-run "$@" || exit 1

loops=()
trap 'kill "${loops[@]}" 2>/dev/null' EXIT
trap 'exit 130' INT TERM
for _ in 1 2 3 4 5 6 7 8; do
    # The loops end when this script ends, by whatever cause.
    (while kill -0 $$; do for ((i = 0; i < 100000; i++)); do :; done; done) 2>/dev/null &
    loops+=($!)
done

logs=target/busy
mkdir -p "$logs"
bad=0
table=$(printf '%4s %7s %7s %8s %9s' run passed failed ignored seconds)
for ((run = 1; run <= runs; run++)); do
    log=$logs/run-$run.log
    begun=$SECONDS
    cargo test --locked --no-fail-fast "$@" >"$log" 2>&1 || bad=1
    took=$((SECONDS - begun))
    counts=$(awk '/^test result:/ { p += $4; f += $6; i += $8 }
        END { printf "%7d %7d %8d", p, f, i }' "$log")
    line=$(printf '%4d %s %9d' "$run" "$counts" "$took")
    table+=$'\n'$line
    printf 'run %d: %s\n' "$run" "$line"
    grep -E '^test .* FAILED$' "$log"
done
printf '\n%s\n' "$table"
exit "$bad"
