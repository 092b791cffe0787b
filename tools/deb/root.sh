#!/usr/bin/env bash
# Prints a folder with a Debian of nothing but what packages are installed into, made by debootstrap
# when it is first needed. It stays as it was made: who installs into it has a copy-on-write view of
# it. Ends with 1 where it cannot be made.
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$(realpath -m "${CARGO_TARGET_DIR:-target}")/tools/clean-root
say() { echo "tools/deb/root.sh: $1" >&2; exit 1; }
# Who comes while another makes it waits.
mkdir -p "${root%/*}"
exec 9>"$root.lock"
flock 9
if [ ! -e "$root.made" ]; then
    [ "$(id -u)" = 0 ] || say 'only root makes a root'
    if ! command -v debootstrap >/dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends debootstrap; } >/dev/null 2>&1 \
            || say 'debootstrap cannot be installed'
    fi
    echo "making $root: two minutes" >&2
    rm -rf "$root"
    . /etc/os-release
    debootstrap --variant=minbase --include=systemd,man-db "$VERSION_CODENAME" "$root" "${JOULEBUS_DEBIAN:-http://deb.debian.org/debian}" >&2 \
        || say 'debootstrap failed'
    rm -rf "$root"/var/cache/apt/archives/*.deb "$root"/var/lib/apt/lists/*
    touch "$root.made"
fi
echo "$root"
