#!/usr/bin/env bash
# Uses the installed C library as others do: pkg-config and make, CMake (installed by apt where it
# is missing and apt works), linked statically, then beside a real worker under valgrind and
# AddressSanitizer. What is not there is skipped aloud. With CI=true that is a failure.
#
#     tools/c_api.sh                builds library and program with the dev profile
#     tools/c_api.sh --workspace    takes those of the workspace's build: what the gate does after `cargo test --workspace`
set -euo pipefail
cd "$(dirname "$0")/.."
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
program=${JOULEBUS_PROGRAM:-}
if [ "${1:-}" = --workspace ]; then
    from=$target/debug/deps
else
    cargo build --quiet --locked --package joulebus-c
    [ -n "$program" ] || cargo build --quiet --locked --package joulebus
    from=$target/debug
fi
joulebus=$(realpath "${program:-$target/debug/joulebus}")
work=$(mktemp -d)
# A prefix has at most eight characters, a pid up to seven digits.
mark=$(($$ % 1000000))
worker= source= planner=
cleanup() {
    for process in $planner $source $worker; do kill "$process" 2>/dev/null && wait "$process" || true; done
    rm -rf "$work" /dev/shm/jbc$$.d /dev/shm/c${mark}_*
}
trap cleanup EXIT
skipped() {
    echo "C library: skipped: $*" >&2
    [ "${CI:-}" != true ]
}
has() { command -v "$1" >/dev/null; }

for needed in cc c++ make; do
    has $needed || { skipped "no $needed"; exit; }
done
tools/install_c.sh --prefix "$work/first" --from "$from"
# What is installed may be moved.
mv "$work/first" "$work/prefix"
prefix=$work/prefix
# What pkg-config and CMake say is enough to run a program, too.
unset LD_LIBRARY_PATH
export PKG_CONFIG_PATH=$prefix/lib/pkgconfig
readelf -d "$prefix/lib/libjoulebus.so" | grep -q 'SONAME.*libjoulebus\.so\.[0-9]*\.[0-9]*\]'
# The functions of the header, with their version, and nothing else.
declared=$(grep -o '\bjoulebus_[a-z_]*(' crates/languages/c/include/joulebus.h | tr -d '(' | sort -u)
exported=$(nm -D --defined-only "$prefix/lib/libjoulebus.so" | awk '$2 == "T" { print $3 }' | sort)
for function in $declared; do
    grep -q "^$function@@JOULEBUS_[0-9]*\.[0-9]*$" <<<"$exported" || { echo "not exported: $function" >&2; exit 1; }
done
if grep -v '^joulebus_[a-z_]*@@JOULEBUS_[0-9.]*$' <<<"$exported"; then
    echo "exported beside the header's functions" >&2
    exit 1
fi

cat >"$work/fleet.toml" <<TOML
[fleet]
name = "c"
[domain]
root = "/dev/shm/jbc$$.d"
prefix = "c${mark}_"
[readers]
max_planners = 16
[[platform]]
file = "builtin:gternal"
robots = ["0-99"]
[platform.battery]
capacity_wh = 5.0
initial_soc_lo = 0.95
TOML
XDG_STATE_HOME=$work/state "$joulebus" run --config "$work/fleet.toml" >"$work/worker.log" 2>&1 &
worker=$!
# So that the planners find it at once.
until grep -q 'ready: fleet' "$work/worker.log"; do
    kill -0 "$worker" || { cat "$work/worker.log" >&2; exit 1; }
    sleep 0.1
done

if has pkg-config; then
    mkdir "$work/make"
    make --silent -C examples/c OUT="$work/make" CFLAGS="-O1 -Wall -Wextra -Werror"
    "$work/make/controller" "$work/fleet.toml" >"$work/source.log" 2>&1 &
    source=$!
    "$work/make/planner" "$work/fleet.toml" 30 | tail -1
    # shellcheck disable=SC2046
    cc -std=gnu11 examples/c/planner.c $(pkg-config --cflags --libs joulebus-static) -o "$work/static"
    ! readelf -d "$work/static" | grep libjoulebus
    "$work/static" "$work/fleet.toml" 30 | tail -1
else
    skipped "no pkg-config"
    exit
fi

if ! has cmake && [ "$(id -u)" = 0 ] && has apt-get; then
    { apt-get update && apt-get install -y --no-install-recommends cmake; } >"$work/apt.log" 2>&1 || true
fi
if has cmake; then
    cmake -S examples/cpp -B "$work/cmake" -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_BUILD_TYPE=Release >"$work/cmake.log"
    cmake --build "$work/cmake" >>"$work/cmake.log"
    "$work/cmake/planner" "$work/fleet.toml" 25 | tail -4
    "$work/cmake/rmf_adapter" "$work/fleet.toml" 7
else
    skipped "no cmake"
fi

build() {
    local output=$1 source=$2
    shift 2
    # shellcheck disable=SC2046
    "$@" -g -O1 "$source" $(pkg-config --cflags --libs joulebus) -pthread -lm -o "$output"
}
build "$work/misuse" crates/languages/c/tests/programs/misuse.c cc -std=gnu11
build "$work/layer" crates/languages/c/tests/programs/layer.cpp c++ -std=c++17
if has valgrind; then
    for program in misuse layer; do
        # It warns of system calls that it does not know (pidfd_open).
        # Leaks of the layer's calls. `misuse` has threads and a child, whose tables of handles are
        # left on purpose.
        leaks=no
        [ "$program" = misuse ] || leaks=full
        valgrind --quiet --error-exitcode=9 --leak-check=$leaks --errors-for-leak-kinds=definite \
            "$work/$program" "$work/fleet.toml" >"$work/$program.out" 2>"$work/$program.err" ||
            { grep -v '^--' "$work/$program.err" >&2; exit 1; }
        echo "valgrind: $program is clean"
    done
else
    skipped "no valgrind"
fi
if echo 'int main(void) { return 0; }' | cc -fsanitize=address,undefined -x c - -o "$work/asan" 2>/dev/null && "$work/asan"; then
    build "$work/misuse" crates/languages/c/tests/programs/misuse.c cc -std=gnu11 -fsanitize=address,undefined -fno-sanitize-recover=all
    build "$work/layer" crates/languages/c/tests/programs/layer.cpp c++ -std=c++17 -fsanitize=address,undefined -fno-sanitize-recover=all
    # Sizes that no memory holds are to be refused by the library, not by the sanitizer. Leaks are
    # valgrind's.
    export ASAN_OPTIONS=allocator_may_return_null=1:detect_leaks=0
    for program in misuse layer; do
        "$work/$program" "$work/fleet.toml" >"$work/$program.out"
        echo "AddressSanitizer: $program is clean"
    done
else
    skipped "no AddressSanitizer"
fi
kill "$source" && wait "$source"
kill "$worker" && wait "$worker"
source= worker=

# Projects of `joulebus new`, by the commands that it prints, but for the library, which is
# installed already.
has cmake || exit 0
mkdir "$work/home"
ln -s "$prefix" "$work/home/.local"
for kind in planner controller; do
    "$joulebus" new $kind --lang cpp "$work/$kind" >"$work/$kind.txt"
    sed -i "s|^\[\[platform\]\]|[domain]\nroot = \"/dev/shm/jbc$$.d\"\nprefix = \"c${mark}_\"\n&|" "$work/$kind/configs/fleet.toml"
done
printed() { # kind, beginning of the command: this shell becomes it
    local command
    command=$(grep -F "  cd $work/$1 && $2" "$work/$1.txt")
    HOME=$work/home XDG_STATE_HOME=$work/state exec bash -c "${command%"$2"*}exec $2${command##*"$2"}"
}
said() { # file, text, process
    until grep -q "$2" "$1"; do
        kill -0 "$3" || { cat "$1" >&2; exit 1; }
        sleep 0.1
    done
}
for kind in planner controller; do (printed $kind cmake) >>"$work/cmake.log"; done
(printed planner build/planner) >"$work/planner.log" 2>&1 &
planner=$!
said "$work/planner.log" 'no forecasts' $planner
(printed planner "$joulebus run") >"$work/worker.log" 2>&1 &
worker=$!
said "$work/worker.log" 'ready: fleet' $worker
(printed controller build/controller) >"$work/source.log" 2>&1 &
source=$!
said "$work/planner.log" 'a trip of' $planner
# 3: ticks were missed. Others than these alarms depend on being scheduled.
"$joulebus" alarms --config "$work/planner/configs/fleet.toml" --format json --duration 15 >"$work/alarms" || [ $? = 3 ]
if grep -vE '"alarm":"(NoData|HeldTooLong|DeadlineMissed|WatchdogStop|WorkerStale|WorkerGone)"' "$work/alarms"; then
    echo 'a project of joulebus new raises alarms' >&2
    exit 1
fi
for process in planner source worker; do kill "${!process}" && wait "${!process}"; done
source= worker= planner=
echo "joulebus new --lang cpp: $(grep -c '^tick' "$work/planner.log") frames, $(grep '^tick' "$work/planner.log" | cut -d: -f2 | sort -u | wc -l) different"
