#!/usr/bin/env bash
# Runs the fuzz targets, each for SECONDS, and prints a table of the results:
#
#   tools/fuzz.sh SECONDS [TARGET…]      # all targets unless some are named. JOBS=2 runs two at a time
#
# Needs a nightly toolchain. Installs cargo-fuzz if it is missing. New inputs are kept in
# fuzz/corpus, findings in fuzz/artifacts, logs in fuzz/logs. Exits with 1 if there is a finding.
set -euo pipefail
cd "$(dirname "$0")/.."
export CARGO_TERM_COLOR=never CARGO_INCREMENTAL=0

# The targets that execute unsafe code, which run with AddressSanitizer. The others are safe Rust
# throughout, and run without.
UNSAFE="frames keyframes model"

sanitizer() { [[ " $UNSAFE " == *" $1 "* ]] && echo address || echo none; }
seeds() { case $1 in recover | scan) echo mcap ;; *) echo "$1" ;; esac; }
# Maximum length of an input, bytes.
longest() { case $1 in frames) echo 2048 ;; *) echo 16384 ;; esac; }

run() {
    local target=$1 seconds=$2 program status=0
    program=fuzz/target/$(sanitizer "$target")/$(host)/release/$target
    mkdir -p "fuzz/corpus/$target" "fuzz/artifacts/$target" fuzz/logs
    # Trials are files: in memory, if possible.
    [ -w /dev/shm ] && export TMPDIR=/dev/shm
    TIMEFORMAT='cpu %U %S'
    { time "$program" -max_total_time="$seconds" -max_len="$(longest "$target")" -timeout=20 \
        -rss_limit_mb=1024 -malloc_limit_mb=256 -print_final_stats=1 -verbosity=1 \
        -artifact_prefix="fuzz/artifacts/$target/" \
        "fuzz/corpus/$target" "fuzz/seeds/$(seeds "$target")"; } >"fuzz/logs/$target.log" 2>&1 || status=$?
    row "$target" "$seconds" "$status" >"fuzz/logs/$target.row"
}

# A line of the table, from the log of a run.
row() {
    awk -v target="$1" -v sanitizer="$(sanitizer "$1")" -v status="$3" '
        / cov: / { for (i = 1; i < NF; i++) { if ($i == "cov:") cov = $(i + 1); if ($i == "ft:") ft = $(i + 1);
                   if ($i == "corp:") { split($(i + 1), corp, "/") } } }
        /^stat::number_of_executed_units/ { runs = $2 }
        /^stat::peak_rss_mb/ { rss = $2 }
        /^Done .* runs in/ { wall = $5 }
        /^cpu / { cpu = $2 + $3 }
        END { printf "%s|%s|%d|%d|%d|%d|%d|%d|%d|%d|%s\n", target, sanitizer, wall, cpu, runs,
              (cpu > 0 ? runs / cpu : 0), cov, ft, corp[1], rss, (status == 0 ? "none" : "FOUND, status " status) }
    ' "fuzz/logs/$1.log"
}

host() { rustc +nightly -vV | sed -n 's/^host: //p'; }

if [ "${1-}" = --one ]; then
    run "$3" "$2"
    exit
fi
if [[ ! "${1-}" =~ ^[0-9]+$ ]]; then
    sed -n '2,8s/^# \?//p' "$0"
    exit 2
fi
seconds=$1
shift
targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
    mapfile -t targets < <(basename -s .rs -a fuzz/fuzz_targets/*.rs)
fi
for target in "${targets[@]}"; do
    [ -f "fuzz/fuzz_targets/$target.rs" ] || { echo "no target $target: see fuzz/fuzz_targets"; exit 2; }
done
command -v rustup >/dev/null && rustup run nightly true 2>/dev/null ||
    { echo "needs a nightly toolchain: rustup toolchain install nightly"; exit 2; }
command -v cargo-fuzz >/dev/null || cargo install cargo-fuzz --locked

for target in "${targets[@]}"; do
    which=$(sanitizer "$target")
    (cd fuzz && cargo +nightly fuzz build -s "$which" --target-dir "target/$which" "$target")
done
printf '%s\n' "${targets[@]}" | xargs -P "${JOBS:-1}" -I{} "$0" --one "$seconds" {}

{
    echo "target|sanitizer|wall s|CPU s|executions|exec/CPU s|edges|features|corpus|peak MB|findings"
    for target in "${targets[@]}"; do cat "fuzz/logs/$target.row"; done
} | column -t -s '|'
! grep -l FOUND $(printf 'fuzz/logs/%s.row ' "${targets[@]}")
