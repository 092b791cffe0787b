#!/usr/bin/env bash
# Packs libjoulebus-dev: the C library with headers, pkg-config and CMake files, as
# tools/install_c.sh installs them below /usr.
#
#     tools/release/dev_package.sh FOLDER-OF-libjoulebus_c.a OUTPUT VERSION
#
# Then lintian reads it, and in a clean root (tools/deb/root.sh) a C++ project of `find_package` is
# built and run with it.
set -euo pipefail
from=$(realpath "$1") output=$(realpath "$2") version=$3
cd "$(dirname "$0")/../.."
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
staged=$target/release-steps/dev
fail() { echo "tools/release/dev_package.sh: $1" >&2; exit 1; }
skip() {
    echo "SKIPPED: tools/release/dev_package.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
    # tools/release.sh counts its step as skipped.
    [ -z "${RELEASE_SKIPPED:-}" ] || touch "$RELEASE_SKIPPED"
}
ls "$from"/libjoulebus_c*.a >/dev/null || fail "$from has no libjoulebus_c.a: tools/release.sh programs"

rm -rf "$staged" && mkdir -p "$staged/DEBIAN" "$staged/usr/share/doc/libjoulebus-dev" "$staged/usr/share/lintian/overrides"
tools/install_c.sh --prefix "$staged/usr" --from "$from"
strip --strip-debug --enable-deterministic-archives "$staged/usr/lib/libjoulebus.a"
strip --strip-unneeded "$staged/usr/lib/libjoulebus.so.$version"
chmod 644 "$staged/usr/lib/libjoulebus.so.$version"
doc=$staged/usr/share/doc/libjoulebus-dev
sed 's/^Comment: The libraries that the programs contain/Comment: The libraries that it contains/' configs/debian/copyright >"$doc/copyright"
tools/licences.py joulebus-c | gzip -9n >"$doc/licences.txt.gz"
maintainer=$(sed -n 's/^maintainer = "\(.*\)"$/\1/p' crates/cli/Cargo.toml)
printf 'libjoulebus-dev (%s-1) unstable; urgency=medium\n\n  * Release %s: see CHANGELOG.md of the sources.\n\n -- %s  %s\n' \
    "$version" "$version" "$maintainer" "$(date -R -u -d "@${SOURCE_DATE_EPOCH:-0}")" | gzip -9n >"$doc/changelog.Debian.gz"
cp configs/debian/dev-overrides "$staged/usr/share/lintian/overrides/libjoulebus-dev"
# What the shared library is linked with: glibc's functions by their newest version.
libc=$(objdump -T "$staged/usr/lib/libjoulebus.so.$version" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -n 1)
arch=$(dpkg --print-architecture)
cat >"$staged/DEBIAN/control" <<CONTROL
Package: libjoulebus-dev
Version: $version-1
Architecture: $arch
Maintainer: $maintainer
Installed-Size: $(du -sk "$staged/usr" | cut -f1)
Depends: libc6 (>= ${libc#GLIBC_}), libgcc-s1
Recommends: pkgconf | pkg-config
Suggests: joulebus (= $version-1)
Section: libdevel
Priority: optional
Homepage: https://github.com/joulebus/joulebus
Description: energy broker for robot fleets: C and C++ library
 A fleet controller publishes what it commands and what it measures. Planners
 read forecasts in shared memory and ask what a plan would cost.
 .
 This package has the library, shared and static, with headers for C11 and C++17
 and files for pkg-config and CMake. Its release must be that of the programs.
CONTROL
echo 'activate-noawait ldconfig' >"$staged/DEBIAN/triggers"
echo "libjoulebus ${version%.*} libjoulebus-dev (= $version-1)" >"$staged/DEBIAN/shlibs"
(cd "$staged" && find usr -type f -printf '%P\0' | LC_ALL=C sort -z | sed -z 's,^,usr/,' | xargs -0 md5sum >DEBIAN/md5sums)
find "$staged" -exec touch --no-dereference --date="@${SOURCE_DATE_EPOCH:-0}" {} +
find "$staged" -type d -exec chmod 755 {} +
deb=$output/libjoulebus-dev_$version-1_$arch.deb
dpkg-deb --root-owner-group -Zxz -z2 --build "$staged" "$deb" >/dev/null
tools/deb/lint.sh "$deb"

root=$(tools/deb/root.sh) || { skip 'no clean root: the package is not installed'; exit 0; }
work=$(mktemp -d)
trap 'rmdir "$work"' EXIT
unshare --mount --pid --fork bash tools/release/dev_installed.sh "$work" "$root" "$deb" examples || fail 'the installed library does not work'
