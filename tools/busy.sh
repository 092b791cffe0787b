#!/usr/bin/env bash
# Runs the tests on a busy machine: beside eight busy loops, on any number of cores.
# Usage: tools/busy.sh RUNS [cargo test arguments…]   (default of the arguments: --workspace)
# Compiles first, runs the tests RUNS times, and prints for each run the passes, failures and
# duration. Exits with 1 if anything failed. After an interruption it continues: a run that ended,
# passed or failed, is not repeated for the same sources, arguments and variables of tests. Logs and
# records: target/busy/KEY/. Remove that folder to begin again.
set -uo pipefail
cd "$(dirname "$0")/.."

runs=${1:-}
if ! [[ $runs =~ ^[1-9][0-9]*$ ]]; then
    sed -n '2,7s/^# //p' "$0" >&2
    exit 2
fi
shift
[ $# -gt 0 ] || set -- --workspace
export CARGO_TERM_COLOR=never

# What a run depends on: the commit, what was changed since, the arguments, and what tests read from
# the environment.
sources=$(git rev-parse HEAD && git diff HEAD && git ls-files --others --exclude-standard -z | xargs -0r sha256sum) || exit 1
key=$({ printf '%s\n' "$sources" "$@"; env | grep -E '^(CI=|RUST_TEST_THREADS=|JOULEBUS_|PROPTEST_)' | sort; } | sha256sum | cut -c1-16)
logs=target/busy/$key
mkdir -p "$logs"
printf '%s\n' "$(git rev-parse HEAD)" "$@" >"$logs/about"

done_before=0
for ((run = 1; run <= runs; run++)); do
    [ -e "$logs/run-$run.row" ] && ((done_before += 1))
done
[ "$done_before" = 0 ] || printf '%d of %d runs were done before: %s\n' "$done_before" "$runs" "$logs"

loops=()
trap '[ ${#loops[@]} = 0 ] || kill "${loops[@]}" 2>/dev/null' EXIT
trap 'exit 130' INT TERM
start() {
    cargo test --locked --no-run "$@" || exit 1
    for _ in 1 2 3 4 5 6 7 8; do
        # The loops end when this script ends, by whatever cause.
        (while kill -0 $$; do for ((i = 0; i < 100000; i++)); do :; done; done) 2>/dev/null &
        loops+=($!)
    done
}

bad=0
table=$(printf '%4s %7s %7s %8s %9s' run passed failed ignored seconds)
for ((run = 1; run <= runs; run++)); do
    log=$logs/run-$run.log row=$logs/run-$run.row
    if [ ! -e "$row" ]; then
        [ ${#loops[@]} -gt 0 ] || start "$@"
        begun=$SECONDS status=0
        cargo test --locked --no-fail-fast "$@" >"$log" 2>&1 || status=$?
        # The first word is for this script.
        awk -v status="$status" -v run="$run" -v took=$((SECONDS - begun)) '/^test result:/ { p += $4; f += $6; i += $8 }
            END { printf "%d %4d %7d %7d %8d %9d\n", status, run, p, f, i, took }' "$log" >"$row.part"
        mv "$row.part" "$row"
    fi
    read -r status line <"$row"
    [ "$status" = 0 ] || bad=1
    line=$(printf '%4d %7d %7d %8d %9d' $line)
    table+=$'\n'$line
    printf 'run %d: %s\n' "$run" "$line"
    grep -E '^test .* FAILED$' "$log"
done
printf '\n%s\n' "$table"
exit "$bad"
