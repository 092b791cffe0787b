#!/usr/bin/env bash
# Builds libjoulebus and installs it, with its headers and what pkg-config and CMake read.
#
#     tools/install_c.sh --prefix DIR              release build. DIR is /usr/local by default
#     tools/install_c.sh --prefix DIR --from DEPS  takes libjoulebus_c.a from a folder, builds nothing
#
# The shared library is linked here from the static one: rustc's own would have neither the
# functions' version nor a name for releases that fit each other. The prefix may be moved as a
# whole.
set -euo pipefail
prefix=/usr/local from=
while [ $# -gt 0 ]; do
    case $1 in
    --prefix) prefix=$(realpath -m -- "$2") && shift 2 ;;
    --from) from=$(realpath -m -- "$2") && shift 2 ;;
    *) echo "usage: tools/install_c.sh [--prefix DIR] [--from DEPS]" >&2 && exit 2 ;;
    esac
done
cd "$(dirname "$0")/.."
if [ -z "$from" ]; then
    cargo build --locked --release --package joulebus-c
    from=${CARGO_TARGET_DIR:-target}/release
fi
header=crates/languages/c/include/joulebus.h
version=$(sed -n 's/^#define JOULEBUS_VERSION "\(.*\)"$/\1/p' $header)
# Releases before 1.0 fit each other by their second number.
series=${version%.*}
# What Rust's standard library needs on Linux (`cargo rustc -p joulebus-c -- --print
# native-static-libs`).
native="-lgcc_s -lutil -lrt -lpthread -lm -ldl -lc"

install -d "$prefix"/{include,lib/pkgconfig,lib/cmake/joulebus}
install -m 644 $header crates/languages/c/include/joulebus.hpp "$prefix/include"
install -m 644 "$(ls -t "$from"/libjoulebus_c*.a | head -1)" "$prefix/lib/libjoulebus.a"
# The loader looks in these folders anyway. Elsewhere a program states where its library is.
case $prefix in /usr | */usr | /usr/local) rpath= ;; *) rpath='-Wl,-rpath,${libdir} ' ;; esac
filled() {
    sed -e "s|@VERSION@|$version|; s|@SERIES@|$series|; s|@NATIVE_LIBS@|$2|; s|@RPATH@|$rpath|" "crates/languages/c/install/$1.in"
}
for package in joulebus joulebus-static; do
    filled $package.pc "$native" >"$prefix/lib/pkgconfig/$package.pc"
done
filled joulebusConfig.cmake "${native// /;}" >"$prefix/lib/cmake/joulebus/joulebusConfig.cmake"
filled joulebusConfigVersion.cmake "" >"$prefix/lib/cmake/joulebus/joulebusConfigVersion.cmake"

# Each function that the header declares is taken from the archive, with what it needs. The library
# cannot be unloaded: its threads run until the last handle is closed.
functions=$(grep -o '\bjoulebus_[a-z_]*(' $header | tr -d '(' | sort -u)
wanted=()
for function in $functions; do wanted+=("-Wl,-u,$function"); done
map=$(mktemp)
trap 'rm -f "$map"' EXIT
filled joulebus.map "" >"$map"
# shellcheck disable=SC2086
"${CC:-cc}" -shared -o "$prefix/lib/libjoulebus.so.$version" -Wl,-soname,"libjoulebus.so.$series" \
    -Wl,--version-script,"$map" -Wl,--gc-sections -Wl,-z,relro,-z,now,-z,defs,-z,nodelete "${wanted[@]}" \
    "$prefix/lib/libjoulebus.a" $native
# Programs name the series, whose releases fit each other, and so does the version of the functions.
ln -sf "libjoulebus.so.$version" "$prefix/lib/libjoulebus.so.$series"
ln -sf "libjoulebus.so.$series" "$prefix/lib/libjoulebus.so"
