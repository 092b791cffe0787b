# What the walks share: an empty home, steps with the time that each took, processes that end with
# the walk. To be sourced:
#
#     . "$(dirname "$0")/step.sh"
#     walk_begins rust            # $home is empty, HOME, and the working directory. $dist is where artefacts are
#     step 'the planner builds' cargo build
#     background worker joulebus run --config fleet.toml
#     step 'the worker is ready' seen worker '^ready'
#
# A step that fails ends the walk with 1 and its output. A wait has ten minutes. No time is
# judged.
set -euo pipefail
repository=$(realpath "$(dirname "${BASH_SOURCE[0]}")/../..")
dist=${JOULEBUS_DIST:-$repository/dist}
version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"$/\1/p' "$repository/Cargo.toml")
walked=()
total_ms=0

walk_ends() {
    local result=$? process
    for process in "${walked[@]}"; do kill "$process" 2>/dev/null && wait "$process" 2>/dev/null || true; done
    rm -rf "$home" "$shm"
    exit "$result"
}

walk_begins() { # name
    walk=$1
    [ -d "$dist" ] || { echo "tools/walks/$walk.sh: there is no $dist: tools/release.sh" >&2; exit 1; }
    # As a user's, short: sockets below it have names of at most 108 bytes.
    home=$(mktemp -d -t "walk-$walk-XXXX")
    shm=/dev/shm/walk-$$
    trap walk_ends EXIT
    trap 'exit 130' INT TERM
    export HOME=$home XDG_STATE_HOME=$home/.state PATH=/usr/local/bin:/usr/bin:/bin
    unset XDG_CONFIG_HOME XDG_DATA_HOME PYTHONPATH RUSTFLAGS
    cd "$home"
    echo "== $walk, with what $dist holds, in an empty home"
}

took() { # ms, what
    printf '%3d min %4.1f s  %s\n' $(($1 / 60000)) "$((($1 % 60000) / 100))e-1" "$2"
}

step() { # what, command…
    local begun what=$1 ms
    shift
    begun=$(date +%s%3N)
    "$@" >"$home/.out" 2>&1 || { tail -n 40 "$home/.out"; echo "tools/walks/$walk.sh: failed: $what"; exit 1; }
    ms=$(($(date +%s%3N) - begun))
    total_ms=$((total_ms + ms))
    took "$ms" "$what"
}

background() { # name, command…
    local name=$1
    shift
    "$@" >"$home/.$name.log" 2>&1 &
    walked+=($!)
    declare -g "pid_$name=$!"
}

ended() { # name
    local pid=pid_$1
    kill "${!pid}" 2>/dev/null || true
    wait "${!pid}" 2>/dev/null || true
}

# Until the output of a process in the background has a line of this pattern.
seen() { # name, pattern
    local pid=pid_$1
    for _ in $(seq 6000); do
        ! grep -qE "$2" "$home/.$1.log" || return 0
        kill -0 "${!pid}" 2>/dev/null || { cat "$home/.$1.log"; return 1; }
        sleep 0.1
    done
    echo "no line of $1 is '$2'"
    tail -n 20 "$home/.$1.log"
    return 1
}

# Until a command prints what has this pattern.
until_says() { # pattern, command…
    local pattern=$1
    shift
    for _ in $(seq 3000); do
        "$@" >"$home/.says" 2>&1 || true
        ! grep -qE "$pattern" "$home/.says" || { cat "$home/.says"; return 0; }
        sleep 0.2
    done
    echo "'$*' never says '$pattern'"
    tail -n 20 "$home/.says"
    return 1
}

# The programs of the tarball, below $home/joulebus.
unpack_programs() {
    local packed
    packed=$(ls "$dist/joulebus-$version-$(uname -m)-linux.tar.gz")
    tar -xzf "$packed" -C "$home"
    mv "$home/$(basename "$packed" .tar.gz)" "$home/joulebus"
}

# A fleet of its own, beside others of this user.
own_domain() { # config
    local root="root = \"$shm\"" prefix="prefix = \"w$(($$ % 1000000))_\""
    if grep -q '^\[domain\]' "$1"; then
        sed -i "s|^root = .*|$root|; s|^prefix = .*|$prefix|" "$1"
    else
        sed -i "s|^\[\[platform\]\]|[domain]\n$root\n$prefix\n&|" "$1"
    fi
}

walk_says() { # the result worth staying for
    took "$total_ms" "in all, at load $(cut -d' ' -f1 /proc/loadavg): $1"
}
