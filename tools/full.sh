#!/usr/bin/env bash
# Everything that is too long for the gate: every program of tools/ and every long check, each step
# in a fresh clone of the commit.
#
#     tools/full.sh                      # all steps, hours
#     tools/full.sh --list               # the steps, what they need, how they ended on this commit
#     tools/full.sh --only deny,wheel    # these steps
#     tools/full.sh --except gate,soak   # the others
#     tools/full.sh --here …             # in this work tree, with what is compiled in it
#     tools/full.sh --again …            # also what passed on this commit
#     tools/full.sh --check              # whether the gate, a test or a step runs each file of tools/
#     tools/full.sh --names              # the steps' names, one a line
#
# It can be interrupted: a step that passed on this commit is not repeated, not even if it skipped a
# part (partial). With --here and uncommitted changes all steps are repeated. Logs and records are
# in target/full/COMMIT, the clone with its builds in target/full/clone. What a step changes in the
# clone (a picture, a table) is kept as NAME.patch and undone. At the end a table has each step's
# time and result, and why it was skipped. Ends with 1 if a step failed. With CI=true what is
# missing is a failure.
set -uo pipefail
cd "$(dirname "$0")/.."
root=$PWD

names=() needs=() commands=()
step() { # name, what it needs, command
    names+=("$1") needs+=("$2") commands+=("$3")
}
# Quick ones first.
step deny - 'tools/deny.sh'
step advisories rustsec 'tools/deny.sh advisories'
step actionlint - 'tools/actionlint.sh'
step gate - 'JOULEBUS_AGAIN=1 .ci/run'
step beside-iceoryx2 - 'cargo build --quiet --locked -p joulebus; tests/beside_iceoryx2/run.sh'
# mdBook compiles once, some minutes.
step book - 'tools/book.sh'
step page - 'tools/browser.sh; tools/prometheus.sh; tools/grafana.sh'
step blocks - 'tools/prometheus.sh; tools/mosquitto.sh; export JOULEBUS_PYTHON=$(tools/python.sh --locked)
    tools/python_package.sh --workspace -k test_demo; tools/blocks.py'
step containers - 'cargo build --quiet --locked --workspace --lib --bins --examples; tools/containers.sh'
step c - tools/c_api.sh
step wheel - 'tools/python_package.sh'
step python-bounds python3.10 'tools/python_bounds.sh'
step package - 'cargo package --workspace --exclude "joulebus-test*" --exclude "joulebus-simulat*" --exclude joulebus-python --locked'
# What a release consists of, each artefact installed and tried, then users who start with an empty
# home and that.
step release - 'tools/release.sh; for user in rust python cpp_ros operator; do tools/walks/$user.sh; done'
step install - 'tools/install.sh target/installed; target/installed/bin/joulebus demo --duration 5; target/installed/bin/joulebus mission --help'
step msrv rust-1.89 'cargo +1.89 check --workspace --all-targets --locked'
step aarch64 - 'tools/aarch64.sh'
# With the cross compiler that aarch64.sh installs.
step aarch64-all cross 'export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    cargo check --workspace --all-targets --locked --target aarch64-unknown-linux-gnu'
step model-parity - 'python3 tools/model_parity.py'
# Figures of --quick are none for a document.
step measure - 'tools/figures.sh --quick'
step recorded-models recordings 'python3 tools/recorded_models.py'
step benchmark recordings 'python3 tools/benchmark.py'
step pictures pictures 'tools/pictures.sh'
step attack - 'python3 tools/attack.py --minutes 5 --seed 7'
step system-calls strace 'python3 tools/system_calls.py --minutes 5 --seed 7'
step miri miri 'cargo +nightly miri test -p joulebus-predictor --test all memory --locked'
step fuzz nightly 'tools/fuzz.sh 60'
step mutations - 'python3 tools/mutations.py'
step simulator - 'cargo run --release --locked -p joulebus-simulator --bin joulebus-sim -- --seeds 1000'
step linked-hosts - 'cargo run --release --locked -p joulebus-simulator --bin joulebus-sim -- --linked --seeds 288'
step ignored - 'tested cargo test --workspace --locked --no-fail-fast -- --ignored --nocapture --skip write_the_seeds'
# With a witness, read_capture.py and read_fleet.py run beside the faults.
step random-fleets - 'JOULEBUS_RANDOM_FLEETS=20 JOULEBUS_SEED=7 JOULEBUS_WITNESS=1 tested cargo test --locked -p joulebus-tests --test system random_faults -- --nocapture'
# Eight hours before a release: CONTRIBUTING.md.
step soak - 'JOULEBUS_SOAK_S=${JOULEBUS_SOAK_S:-1800} cargo test --locked -p joulebus-tests --test system soak -- --nocapture'

# Prints why a step cannot run here, and nothing if it can.
lacks() {
    there() { "$@" >/dev/null 2>&1; }
    case $1 in
        -) ;;
        rustsec) there git ls-remote --quiet https://github.com/RustSec/advisory-db HEAD || echo 'the database of RustSec cannot be reached' ;;
        rust-*) there rustup run "${1#rust-}" rustc -V || there rustup toolchain install "${1#rust-}" --profile minimal || echo "no Rust ${1#rust-}" ;;
        nightly) there rustup run nightly rustc -V || echo 'no nightly toolchain (rustup toolchain install nightly)' ;;
        miri) there cargo +nightly miri --version || echo 'no miri (rustup component add miri rust-src --toolchain nightly)' ;;
        cross) there aarch64-linux-gnu-gcc --version && there rustup target add aarch64-unknown-linux-gnu || echo 'no cross compiler (tools/aarch64.sh installs it)' ;;
        recordings) [ -d ../shared/data ] || echo 'no recordings in ../shared/data' ;;
        pictures) there chromium --version && there tmux -V && [ -d ../shared/data ] || echo 'chromium, tmux or the recordings in ../shared/data are missing' ;;
        *) there command -v "$1" || echo "no $1 (apt-get install $1)" ;;
    esac
}

tested() { # a command, with everything that tests compare with
    JOULEBUS_PYTHON=$(tools/python.sh) JOULEBUS_MOSQUITTO=$(tools/mosquitto.sh) JOULEBUS_CYCLONEDDS=$(tools/cyclonedds.sh) \
        JOULEBUS_ETCD=$(tools/etcd.sh) \
        JOULEBUS_ROS2=$(tools/ros2.sh) "$@"
}
export -f tested

check() {
    local text name file left=() missing=() reached=(.ci/run tools/full.sh)
    mapfile -t left < <(git ls-files --cached --others --exclude-standard tools | sed -E 's,^(tools/(walks/)?[^/]+)/.*,\1,' | sort -u)
    # What tests run, and then what is named or imported by what is run. Comments do not count.
    text=$(git grep -hE 'tools/|\.(sh|py)"' -- '*.rs' | grep -v '^ *//')
    while [ ${#reached[@]} -gt 0 ]; do
        text+=$'\n'$(grep -hv '^ *#' "${reached[@]}")
        reached=() missing=()
        for file in "${left[@]}"; do
            name=${file##*/}
            [ ! -d "$file" ] || name=$file
            if grep -qE "(^|[^[:alnum:]_-])${name//./\\.}([^[:alnum:]_.-]|$)|^ *(import|from) ${name%.py}( |$)" <<<"$text"; then
                [ -d "$file" ] || reached+=("$file")
            else
                missing+=("$file")
            fi
        done
        left=("${missing[@]}")
    done
    [ ${#left[@]} = 0 ] || printf 'full: neither .ci/run, a test nor a step of tools/full.sh runs %s\n' "${left[@]}" >&2
    [ ${#left[@]} = 0 ]
}

list='' only='' except='' here='' again=''
while [ $# -gt 0 ]; do
    case $1 in
        --list) list=1 ;;
        --only) only+=,${2?--only needs names}, && shift ;;
        --except) except+=,${2?--except needs names}, && shift ;;
        --here) here=1 ;;
        --again) again=1 ;;
        --names) printf '%s\n' "${names[@]}" && exit ;;
        --check) check; exit ;;
        *) sed -n '2,/^set/s/^# \?//p' "$0" >&2; exit 2 ;;
    esac
    shift
done
for name in ${only//,/ } ${except//,/ }; do
    [[ " ${names[*]} " = *" $name "* ]] || { echo "full: there is no step $name: tools/full.sh --list" >&2; exit 2; }
done

commit=$(git rev-parse HEAD) || exit 1
records=$root/target/full/$commit
chosen=()
for at in "${!names[@]}"; do
    [ -z "$only" ] || [[ $only = *,${names[at]},* ]] || continue
    [[ $except != *,${names[at]},* ]] || continue
    chosen+=("$at")
done
table() {
    printf '\n%-15s %-8s %7s  %s\n' step result seconds "commit ${commit:0:12}"
    local at result seconds note
    for at in "${chosen[@]}"; do
        result=not\ run seconds=- note=
        [ ! -e "$records/${names[at]}.row" ] || IFS=$'\t' read -r result seconds note <"$records/${names[at]}.row"
        [ "$1" = results ] || note="[${needs[at]}] ${commands[at]//$'\n'   /;}"
        printf '%-15s %-8s %7s  %s\n' "${names[at]}" "$result" "$seconds" "$note"
    done
}
if [ -n "$list" ]; then
    table commands
    exit
fi

place=$root
clean() { [ -z "$(git -C "$place" status --porcelain)" ]; }
if [ -z "$here" ]; then
    clean || echo 'full: uncommitted changes are not in the clone' >&2
    place=$root/target/full/clone
    [ -d "$place" ] || git clone --quiet --no-checkout "$root" "$place" || exit 1
    # Recordings that some tests read. A copy: who empties the folder keeps the originals.
    rm -rf "$root/target/full/shared"
    [ ! -d ../shared ] || cp -r --no-preserve=mode ../shared "$root/target/full/shared"
    git -C "$place" fetch --quiet "$root" "$commit" || exit 1
elif ! clean; then
    records=$root/target/full/uncommitted
    rm -rf "$records"
fi
mkdir -p "$records"
cd "$place" || exit 1
trap 'table results; exit 130' INT TERM
bad=0
for at in "${chosen[@]}"; do
    name=${names[at]}
    row=$records/$name.row log=$records/$name.log
    [ -n "$again" ] || ! grep -qsE '^(passed|partial)' "$row" || continue
    if [ -z "$here" ]; then
        # As cloned now, but for what was compiled.
        git reset --quiet --hard "$commit" && git clean -fdxq -e /target || exit 1
    fi
    rm -f "$row"
    printf '== %s: %s\n' "$name" "${commands[at]}"
    why=$(lacks "${needs[at]}")
    if [ -n "$why" ]; then
        if [ "${CI:-}" = true ]; then result=failed bad=1; else result=skipped; fi
        printf '%s\t%s\t%s\n' "$result" 0 "$why" | tee "$row"
        continue
    fi
    begun=$SECONDS
    if bash -euo pipefail -c "${commands[at]}" >"$log" 2>&1 </dev/null; then
        why=$(grep -E '^([A-Za-z0-9 _.-]+: )?(SKIPPED|skipped)[:,] ' "$log" | head -c 300 | tr '\n\t' '; ')
        if [ -n "$why" ]; then result=partial; else result=passed; fi
    else
        result=failed bad=1 why="see $log"
        tail -n 20 "$log"
    fi
    if [ -z "$here" ] && ! clean; then
        git add --all && git diff --binary --cached >"$records/$name.patch"
        why+=" changed: $(git diff --cached --name-only | head -n 5 | tr '\n' ' ')"
    fi
    printf '%s\t%d\t%s\n' "$result" $((SECONDS - begun)) "$why" | tee "$row"
done
table results
exit "$bad"
