#!/usr/bin/env bash
# Builds the Debian package that crates/cli/Cargo.toml describes ([package.metadata.deb]), and
# checks it: contents, lintian, and, for root, its installation, use, upgrade and removal in a
# copy-on-write view of a clean Debian (tools/deb/root.sh).
#
#     tools/deb.sh                         # profile dist, as it is released. The package is in target/debian
#     tools/deb.sh --profile release       # quicker to build
#     tools/deb.sh --programs target/debug # of programs that are built already: to check the package, not to ship it
#     tools/deb.sh --check FILE.deb        # only the checks
#
# cargo-deb is installed into target/tools if it is missing. What cannot be checked here is said.
# With CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
export CARGO_TARGET_DIR=$target
mapfile -t programs < <(tools/programs.sh)
cargo_deb_version=3.8.0

fail() { echo "tools/deb.sh: $1" >&2; exit 1; }
skip() {
    echo "SKIPPED: tools/deb.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
    # tools/release.sh counts its step as skipped.
    [ -z "${RELEASE_SKIPPED:-}" ] || touch "$RELEASE_SKIPPED"
}

# The programs' manual pages, completions, changelog and licences, in the folder that the manifest
# names.
make_files() { # folder of the programs
    local made=$1/deb version
    rm -rf "$made"
    mkdir -p "$made/completions"
    "$1/joulebus" man "$made/man1"
    gzip -9n "$made"/man1/*.1
    "$1/joulebus" completions bash > "$made/completions/joulebus"
    "$1/joulebus" completions fish > "$made/completions/joulebus.fish"
    "$1/joulebus" completions zsh > "$made/completions/_joulebus"
    tools/licences.py "${programs[@]}" | gzip -9n > "$made/licences.txt.gz"
    version=$("$1/joulebus" --version)
    # Debian's form of a changelog. Ours is in CHANGELOG.md.
    printf 'joulebus (%s-1) unstable; urgency=medium\n\n  * Release %s: see CHANGELOG.md of the sources.\n\n -- %s  %s\n' \
        "${version##* }" "${version##* }" "$(sed -n 's/^maintainer = "\(.*\)"$/\1/p' crates/cli/Cargo.toml)" \
        "$(date -R -u -d "@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || date +%s)}")" | gzip -9n > "$made/changelog.Debian.gz"
}

build() { # profile
    local tools=$target/tools/deb options=() fast=()
    if ! command -v cargo-deb > /dev/null; then
        export PATH=$tools/bin:$PATH
        command -v cargo-deb > /dev/null \
            || cargo install cargo-deb --version "$cargo_deb_version" --locked --no-default-features --root "$tools" --target-dir "$tools/target"
    fi
    if [ -n "$built" ]; then
        # cargo-deb looks in the folder of a profile. What is not shipped need not be small.
        fast=(--fast)
        mkdir -p "$target/$1"
        for program in "${programs[@]}"; do
            [ -x "$built/$program" ] || fail "$built has no $program: cargo build -p $program"
            ln -sf "$(realpath "$built/$program")" "$target/$1/$program"
        done
    else
        for program in "${programs[@]}"; do options+=(-p "$program"); done
        cargo build --locked --profile "$1" --bins "${options[@]}"
    fi
    make_files "$target/$1"
    mkdir -p "$target/debian"
    deb=$(cargo deb --quiet --locked --package joulebus --profile "$1" --no-build --strip "${fast[@]}" --output "$target/debian/" | tail -n 1)
    [ -f "$deb" ] || fail "cargo deb wrote no package"
}

check_contents() {
    dpkg-deb --info "$deb"
    dpkg-deb --contents "$deb"
    tools/deb/lint.sh "$deb" || fail "lintian finds errors"
}

# In a mount namespace of its own: a clean Debian where debootstrap makes one, else this machine,
# with changes that go into a folder in memory.
check_installed() {
    if [ "$(id -u)" != 0 ]; then
        skip "the package is installed by root only"
        return
    fi
    local work clean=/
    if ! unshare --mount true 2> /dev/null; then
        skip "this machine has no mount namespaces: the package is not installed"
        return
    fi
    clean=$(tools/deb/root.sh) || { skip "no clean root: the package is installed in a view of this machine"; clean=/; }
    work=$(mktemp -d)
    local result=0
    unshare --mount --pid --fork bash "$PWD/tools/deb/installed.sh" "$work" "$deb" "$clean" || result=$?
    rmdir "$work"
    [ "$result" = 0 ] || fail "the installed package does not work"
}

deb='' profile=dist built=''
while [ $# -gt 0 ]; do
    case $1 in
        --profile) profile=$2 ;;
        --programs) built=$(realpath "$2") profile=packaged ;;
        --check) deb=$(realpath "$2") ;;
        *) fail "unknown option $1; see the head of this file" ;;
    esac
    shift 2
done
[ -n "$deb" ] || build "$profile"
check_contents
check_installed
echo "$deb"
