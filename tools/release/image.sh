#!/usr/bin/env bash
# Writes an OCI image of programs as a tarball, without a daemon, by Debian's umoci: for `podman load`, `docker load`
# and `skopeo copy oci-archive:…`.
#
#     tools/release/image.sh PROGRAMS VERSION FILE.oci.tar FOLDER     # a folder to work in
#
# Two layers: the libraries that the programs are linked with, as this machine has them, and the programs with the
# shipped configs. The same inputs give the same bytes. What the image does is that of configs/container/Containerfile.
set -euo pipefail
cd "$(dirname "$0")/../.."
programs=$1 version=$2 file=$3 work=$4 user=10001
made=@${SOURCE_DATE_EPOCH:-0}
case $(uname -m) in x86_64) processor=amd64 ;; aarch64) processor=arm64 ;; *) processor=$(uname -m) ;; esac
if [ "$(id -u)" = 0 ] && ! { command -v skopeo && command -v umoci; } >/dev/null; then
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends skopeo umoci; } >/dev/null 2>&1 || true
fi
{ command -v skopeo && command -v umoci; } >/dev/null || { echo 'tools/release/image.sh: no skopeo or no umoci: apt-get install skopeo umoci' >&2; exit 69; }
umask 022
rm -rf "$work"/{base,added,layout}
packed() { # -c or -r, folder, tar, what
    tar "$1" --sort=name --numeric-owner --owner="${owner:-0}" --group="${owner:-0}" --mtime="$made" -C "$2" -f "$3" "${4:-.}"
}

base=$work/base
install -d "$base"/{run,etc,dev} && install -d -m 1777 "$base/tmp" "$base/dev/shm" && install -d -m 555 "$base/proc" "$base/sys"
printf 'root:x:0:0:root:/root:/sbin/nologin\njoulebus:x:%d:%d::/var/lib/joulebus:/sbin/nologin\n' $user $user >"$base/etc/passwd"
printf 'root:x:0:\njoulebus:x:%d:\n' $user >"$base/etc/group"
linked=$(ldd "$programs"/*)
if grep 'not found' <<<"$linked"; then echo "tools/release/image.sh: a program lacks that library" >&2; exit 1; fi
for library in $(grep -oE '/[^ ]+ \(0x' <<<"$linked" | cut -d' ' -f1 | sort -u); do
    install -D -m 755 "$library" "$base$library"
done
for text in /usr/share/doc/{libc6,libgcc-s1,gcc-12-base}/copyright; do
    [ ! -e "$text" ] || install -D -m 644 "$text" "$base$text"
done
packed -c "$base" "$work/base.tar"

added=$work/added
install -d "$added/var/lib"
install -D -m 755 -t "$added/usr/local/bin" "$programs"/*
install -D -m 644 -t "$added/etc/joulebus" configs/fleet.toml
install -D -m 644 -t "$added/etc/joulebus/platforms" configs/platforms/*.toml
install -D -m 644 -t "$added/usr/share/doc/joulebus" LICENSE-*
packed -c "$added" "$work/added.tar"
# The only folder of the user.
install -d -m 750 "$added/var/lib/joulebus"
owner=$user packed -r "$added" "$work/added.tar" ./var/lib/joulebus

image=$work/layout:$version when=$(date -u -d "$made" +%Y-%m-%dT%H:%M:%SZ)
umoci init --layout "$work/layout"
umoci new --image "$image"
for layer in base added; do
    umoci raw add-layer --image "$image" --history.created "$when" --history.created_by "$layer" "$work/$layer.tar"
done
labels=()
for label in title=joulebus "version=$version" source=https://github.com/joulebus/joulebus 'licenses=MIT OR Apache-2.0'; do
    labels+=(--config.label "org.opencontainers.image.$label" --manifest.annotation "org.opencontainers.image.$label")
done
umoci config --image "$image" --no-history --created "$when" --architecture $processor --os linux --config.user $user:$user \
    --config.env PATH=/usr/local/bin --config.env STATE_DIRECTORY=/var/lib/joulebus --config.entrypoint /usr/local/bin/joulebus \
    --config.cmd --help --config.stopsignal SIGTERM "${labels[@]}"
umoci gc --layout "$work/layout"
packed -c "$work/layout" "$file"
echo "$file: $(ls "$programs" | wc -l) programs, $(stat -c %s "$file") bytes" >&2
