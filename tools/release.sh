#!/usr/bin/env bash
# Builds what a release consists of into dist/. Each artefact is installed into a clean environment
# and does its five minutes there: tools/release/five_minutes.sh.
#
#     tools/release.sh                     # every step, in their order: an hour and more
#     tools/release.sh --list              # the steps, and what each makes
#     tools/release.sh deb image sums      # these steps
#     tools/release.sh --again wheel       # also if it has passed
#     tools/release.sh --profile release   # quicker to build than `dist`, with which releases are built
#     tools/release.sh --programs DIR      # of programs and libjoulebus_c.a that are built already: to check the steps, not to ship
#
# It can be interrupted: a step that passed with the same sources and options is not repeated.
# Progress is told on stderr. What is made is in dist/. What this machine lacks is skipped aloud.
# With CI=true that is a failure. Exit codes: 0 done, 1 a step failed, 2 wrong usage.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
work=$target/release-steps
dist=$root/dist
export CARGO_TARGET_DIR=$target

names=(programs tarball deb dev image wheel wheel-aarch64 sdist sbom sums)
declare -A makes=(
    [programs]='all programs and libjoulebus_c.a, in target/'
    [tarball]='joulebus-VERSION-ARCH-linux.tar.gz: programs, manual pages, completions, configs, joulebus_msgs'
    [deb]='joulebus_VERSION-1_ARCH.deb: programs and services'
    [dev]='libjoulebus-dev_VERSION-1_ARCH.deb: library, headers, pkg-config, CMake'
    [image]='joulebus-VERSION-ARCH.oci.tar: an OCI image'
    [wheel]='joulebus and joulebus_lab for x86-64'
    [wheel-aarch64]='the same for aarch64'
    [sdist]='the source distribution of the Python package'
    [sbom]='joulebus-VERSION.cdx.json: libraries in the programs, CycloneDX'
    [sums]='SHA256SUMS'
)

fail() { echo "tools/release.sh: $1" >&2; exit "${2:-1}"; }
say() { echo "release: $*" >&2; }
skip() {
    echo "SKIPPED: tools/release.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
    touch "$RELEASE_SKIPPED"
}

profile=dist built='' again='' one='' chosen=()
while [ $# -gt 0 ]; do
    case $1 in
        --list) for step in "${names[@]}"; do printf '%-14s %s\n' "$step" "${makes[$step]}"; done; exit ;;
        --profile) profile=${2?--profile needs a name} && shift ;;
        --programs) built=$(realpath -- "${2?--programs needs a folder}") && shift ;;
        --again) again=1 ;;
        --one) one=${2?} && shift ;;
        -*) sed -n '2,/^set/s/^# \?//p' "$0" >&2; exit 2 ;;
        *) [ -n "${makes[$1]:-}" ] || fail "there is no step $1: tools/release.sh --list" 2
            chosen+=("$1") ;;
    esac
    shift
done
[ ${#chosen[@]} -gt 0 ] || chosen=("${names[@]}")
version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"$/\1/p' Cargo.toml)
arch=$(uname -m)
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || date +%s)}
export SOURCE_DATE_EPOCH
from=${built:-$target/$profile}
made=$work/made/$version
mkdir -p "$made" "$dist"

need_programs() { [ -x "$from/joulebus" ] || fail "$from has no programs: tools/release.sh programs"; }
five_minutes() { "$root/tools/release/five_minutes.sh" "$@"; }
# An environment of Python with what this file pins: `python_with FOLDER PACKAGE…`.
python_with() {
    python3 -c 'import sys; from pathlib import Path; sys.path.insert(0, "tools"); from pinned_environment import python_of
print(python_of(Path(sys.argv[1]), sys.argv[2:]))' "$target/tools/$1" "${@:2}"
}

make_programs() {
    [ -z "$built" ] || { say "programs of $built, not built here"; return; }
    local options=()
    for program in $(tools/programs.sh) joulebus-c; do options+=(-p "$program"); done
    cargo build --locked --profile "$profile" "${options[@]}"
}

make_tarball() {
    need_programs
    local name=joulebus-$version-$arch-linux staged=$work/tarball
    rm -rf "$staged"
    tools/install.sh "$staged/$name" --from "$from" >&2
    find "$staged/$name/bin" -type f -exec strip {} +
    cp README.md CHANGELOG.md LICENSE-* "$staged/$name"
    mkdir "$staged/$name/configs"
    cp -r configs/fleet.toml configs/platforms configs/bridges configs/webhooks "$staged/$name/configs"
    cp -r ros2 "$staged/$name"
    mapfile -t programs < <(tools/programs.sh)
    tools/licences.py "${programs[@]}" | gzip -9n >"$staged/$name/licences.txt.gz"
    tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -C "$staged" -c "$name" | gzip -9n >"$dist/$name.tar.gz"
    rm -rf "$staged" && mkdir "$staged"
    tar -xzf "$dist/$name.tar.gz" -C "$staged"
    five_minutes env -i HOME="$staged" PATH=/usr/bin:/bin "$staged/$name/bin/joulebus"
}

make_deb() {
    need_programs
    local options=(--profile "$profile") deb
    [ -z "$built" ] || options=(--programs "$built")
    deb=$(tools/deb.sh "${options[@]}" | tee >(cat >&2) | tail -n 1)
    cp "$deb" "$dist/"
}

make_dev() {
    command -v dpkg-deb >/dev/null || { skip 'dpkg-deb is not installed: no libjoulebus-dev'; return; }
    tools/release/dev_package.sh "$from" "$dist" "$version"
}

make_image() {
    need_programs
    local image=$dist/joulebus-$version-$arch.oci.tar
    mapfile -t programs < <(tools/programs.sh)
    rm -rf "$work/image" && mkdir -p "$work/image/programs"
    for program in "${programs[@]}"; do
        cp "$from/$program" "$work/image/programs/" && strip "$work/image/programs/$program"
    done
    tools/release/image.sh "$work/image/programs" "$version" "$image" "$work/image" || {
        [ $? = 69 ] || return 1
        skip 'skopeo and umoci cannot be installed: no image' && return
    }
    tools/release/check_image.sh "$image" "$work/image"
}

# The environment in which wheels are built: maturin as the tests have it.
python_of_wheels() { python_with wheels "maturin==$(sed -n 's/^maturin==\([0-9.]*\).*/\1/p' crates/languages/python/requirements.lock)" ziglang==0.13.0; }
# Wheels: one for each processor and distribution, for CPython 3.10 and later, of glibc 2.28 and
# later.
make_wheels() { # processor
    local python
    python=$(python_of_wheels) || { skip "maturin and ziglang cannot be installed from PyPI: no wheels for $1"; return; }
    rustup target list --installed 2>/dev/null | grep -qx "$1-unknown-linux-gnu" || rustup target add "$1-unknown-linux-gnu" >&2 \
        || { skip "no Rust for $1-unknown-linux-gnu: no wheels"; return; }
    for project in crates/languages/python crates/languages/python/lab; do
        (cd "$project" && PATH=$(dirname "$python"):$PATH "$python" -m maturin build --release --locked --zig \
            --target "$1-unknown-linux-gnu" --compatibility manylinux_2_28 --out "$dist" >&2)
    done
}
make_wheel() {
    make_wheels x86_64
    [ -e "$RELEASE_SKIPPED" ] || tools/release/check_wheel.sh "$dist" "$version" >&2
}
make_wheel-aarch64() {
    make_wheels aarch64
    # No Python for it is here: what can be read of the wheels without one.
    [ -e "$RELEASE_SKIPPED" ] || tools/release/check_wheel.sh "$dist" "$version" --foreign aarch64
}

make_sdist() {
    local python
    python=$(python_of_wheels) || { skip 'maturin cannot be installed from PyPI: no source distribution'; return; }
    (cd crates/languages/python && "$python" -m maturin sdist --out "$dist" >&2)
    tools/release/check_sdist.sh "$dist" "$version" >&2
}

make_sbom() {
    local python file=$dist/joulebus-$version.cdx.json
    mapfile -t programs < <(tools/programs.sh)
    python3 tools/release/sbom.py "${programs[@]}" >"$file"
    python=$(python_with sbom 'cyclonedx-python-lib[json-validation]==11.5.0') || { skip "cyclonedx-python-lib cannot be installed from PyPI: $file is not validated"; return; }
    "$python" tools/release/sbom.py --validate "$file"
}

make_sums() {
    # Other versions' artefacts may lie beside them.
    (cd "$dist" && cat "$made"/* | { grep -vx SHA256SUMS || true; } | LC_ALL=C sort -u | xargs -r sha256sum >SHA256SUMS && sha256sum --quiet --check SHA256SUMS)
    sed "s/^/  /" "$dist/SHA256SUMS" >&2
}

if [ -n "$one" ]; then
    step=$one
    # Also for the scripts of this step.
    export RELEASE_SKIPPED=$work/$step.skipped
    "make_$step"
    exit
fi

# Sources and options, by which a step has passed.
inputs=$({ git rev-parse HEAD && git diff HEAD && git status --porcelain && echo "$profile $built $arch $version"; } | sha256sum | cut -d' ' -f1)
passed() { # on these inputs, and what it made is still there
    [ "$(cat "$work/$step.passed" 2>/dev/null)" = "$inputs" ] && (cd "$dist" && xargs -r ls <"$made/$step") >/dev/null 2>&1
}
for step in "${chosen[@]}"; do
    if [ -z "$again" ] && [ "$step" != sums ] && passed; then
        say "$step: passed before"
        continue
    fi
    say "$step: ${makes[$step]}"
    begun=$SECONDS
    rm -f "$work/$step.passed" "$work/$step.skipped"
    touch "$work/begun"
    options=(--profile "$profile")
    [ -z "$built" ] || options+=(--programs "$built")
    tools/release.sh "${options[@]}" --one "$step" || fail "step $step failed after $((SECONDS - begun)) s"
    find "$dist" -type f -newer "$work/begun" -printf '%P\n' >"$made/$step"
    [ -e "$work/$step.skipped" ] || echo "$inputs" >"$work/$step.passed"
    say "$step: done after $((SECONDS - begun)) s"
done
