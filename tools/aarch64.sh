#!/usr/bin/env bash
# What x86-64 records and trains, aarch64 computes again to the bit: the tests of predictor, fleet
# and capture's verification, and a short training, compiled for aarch64 and run by qemu.
# Usage: tools/aarch64.sh   (installs Debian's qemu and cross compiler if it may)
# Where that cannot be it says so and ends with 0. With CI=true, with 1.
set -euo pipefail
cd "$(dirname "$0")/.."

target=aarch64-unknown-linux-gnu
libraries=/usr/aarch64-linux-gnu
packages=(qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross)

skip() {
    if [ "${CI:-}" = true ]; then
        printf 'aarch64: FAILED, nothing was run: %s\n' "$*" >&2
        exit 1
    fi
    printf 'aarch64: SKIPPED, nothing was run: %s\n' "$*" >&2
    exit 0
}

installed() {
    command -v qemu-aarch64 && command -v aarch64-linux-gnu-gcc && [ -e "$libraries/lib/libc.so.6" ]
} >/dev/null

install() {
    local as_root=()
    [ "$(id -u)" = 0 ] || as_root=(sudo -n)
    command -v apt-get >/dev/null || return 1
    "${as_root[@]}" apt-get update -qq &&
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends "${packages[@]}"
} >&2

[ "$(uname -sm)" = 'Linux x86_64' ] || skip "this is $(uname -sm), not Linux on x86_64"
installed || install || skip "cannot install ${packages[*]}"
installed || skip "${packages[*]} are installed, but qemu-aarch64, the compiler or its libraries are not"
if ! rustup target list --installed 2>/dev/null | grep -qx "$target"; then
    rustup target add "$target" >&2 || skip "cannot add the target $target"
fi

export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L $libraries"
export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc
export CARGO_TERM_COLOR=never
# Under qemu a property takes ten times as long. Natively it has all its cases.
export PROPTEST_CASES=${PROPTEST_CASES:-8}

machines=$(mktemp -d)
beside=$(mktemp)
trap 'kill ${shards:-} 2>/dev/null || :; rm -rf "$machines" "$beside"' EXIT
export JOULEBUS_MACHINES=$machines

step() {
    printf -- '-- %s (after %d s)\n' "$*" "$SECONDS"
    "$@"
}

# One set of packages, so that nothing is compiled twice.
cross=(cargo test --locked --target "$target")
for crate in predictor fleet capture-verify train; do
    cross+=(-p "joulebus-$crate")
done
tests=(kernels:: rollouts:: files:: oracle::)

# Records here what is computed again there.
step cargo test --locked --workspace --test verify what_one_machine_records
[ -s "$machines/x86_64.mcap" ] || { echo 'aarch64: nothing was recorded' >&2; exit 1; }
step "${cross[@]}" --test all --test verify --no-run
# One long test on one processor, beside all that follow.
"${cross[@]}" --test all shards:: >"$beside" 2>&1 &
shards=$!
step "${cross[@]}" --test verify
[ -s "$machines/aarch64.mcap" ] || { echo 'aarch64: nothing was recorded there' >&2; exit 1; }
cmp "$machines/x86_64.mcap" "$machines/aarch64.mcap"
step "${cross[@]}" --test all the_same_seed_gives_the_same_bytes
step "${cross[@]}" --test all -- "${tests[@]}"
step wait "$shards" || {
    cat "$beside" >&2
    exit 1
}
printf 'aarch64: the same bits (after %d s)\n' "$SECONDS"
