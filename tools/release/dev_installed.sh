#!/usr/bin/env bash
# Installs libjoulebus-dev in a copy-on-write view of a clean Debian, over an older version, and
# builds there what C++ users build. Run by dev_package.sh in mount and process namespaces of its
# own: `dev_installed.sh EMPTY-FOLDER ROOT FILE.deb EXAMPLES`.
set -euo pipefail
work=$1 clean=$2 deb=$3 examples=$4
mount --make-rprivate /
mount -t tmpfs tmpfs "$work"
mkdir "$work"/{upper,work,root}
root=$work/root
mount -t overlay overlay -o "lowerdir=$clean,upperdir=$work/upper,workdir=$work/work" "$root"
mount -t proc proc "$root/proc"
mount --bind /dev "$root/dev"
cp "$deb" "$root/tmp/new.deb"
cp -r "$examples/cpp" "$examples/c" "$root/tmp"
in_root() { chroot "$root" env PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive "$@"; }
fail() { echo "tools/release/dev_installed.sh: $1" >&2; exit 1; }

# The previous version: the same files under a lower number.
dpkg-deb -R "$deb" "$work/previous"
sed -i 's/^Version: .*/Version: 0.0.1-1/' "$work/previous/DEBIAN/control"
dpkg-deb --root-owner-group -Znone --build "$work/previous" "$root/tmp/previous.deb" >/dev/null
in_root dpkg --install /tmp/previous.deb
in_root dpkg --install /tmp/new.deb
[ -z "$(in_root dpkg --verify libjoulebus-dev)" ] || fail 'dpkg --verify finds differences'
# Not by a pipe: `grep -q` ends before ldconfig has written all.
in_root ldconfig -p >"$work/libraries"
grep -q 'libjoulebus\.so\.' "$work/libraries" || fail 'the loader does not know the library'

cp /etc/resolv.conf "$root/etc/resolv.conf" 2>/dev/null || true
# Kept for the next time, outside of this view.
archives=${clean%/*}/archives
mkdir -p "$archives"
mount --bind "$archives" "$root/var/cache/apt/archives"
if ! { in_root apt-get update -qq && in_root apt-get install -y -qq --no-install-recommends g++ cmake make pkgconf; } >"$work/apt" 2>&1; then
    echo "SKIPPED: tools/release/dev_installed.sh: a compiler cannot be installed in the clean root: $(tail -n 1 "$work/apt")" >&2
    [ "${CI:-}" != true ]
    exit
fi
in_root cmake -S /tmp/cpp -B /tmp/built >/dev/null
in_root cmake --build /tmp/built >/dev/null
in_root make --silent -C /tmp/c OUT=/tmp
for planner in /tmp/built/planner /tmp/planner; do
    # No worker runs here: it connects, waits and says so.
    in_root timeout --signal=INT 3 "$planner" >"$work/said" 2>&1 || [ $? = 124 ] || [ -s "$work/said" ] || fail "$planner says nothing"
    ! grep -i 'shared librar\|symbol' "$work/said" || fail "$planner: $(cat "$work/said")"
done
in_root dpkg --purge libjoulebus-dev
[ ! -e "$root/usr/include/joulebus.h" ] || fail 'purging left the header'
echo "libjoulebus-dev: installed over a previous version, a project of CMake and one of pkg-config built and started, removed"
