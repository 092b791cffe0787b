#!/usr/bin/env bash
# Reads an OCI image by programs of others (skopeo, umoci), and runs what it holds in a root of
# nothing else: its five minutes.
#
#     tools/release/check_image.sh FILE.oci.tar FOLDER     # a folder for what is unpacked
set -euo pipefail
image=$(realpath "$1") folder=$(realpath "$2")
here=$(dirname "$(realpath "$0")")
skip() {
    echo "SKIPPED: tools/release/check_image.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
    # tools/release.sh counts its step as skipped.
    [ -z "${RELEASE_SKIPPED:-}" ] || touch "$RELEASE_SKIPPED"
}
if [ "$(id -u)" = 0 ] && ! { command -v skopeo && command -v umoci; } >/dev/null; then
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends skopeo umoci; } >/dev/null 2>&1 || true
fi
rm -rf "$folder/layout" "$folder/bundle" "$folder/root"
if { command -v skopeo && command -v umoci; } >/dev/null; then
    skopeo inspect "oci-archive:$image" >"$folder/inspected.json"
    skopeo copy --quiet "oci-archive:$image" "oci:$folder/layout:checked"
    options=()
    [ "$(id -u)" = 0 ] || options=(--rootless)
    umoci unpack "${options[@]}" --image "$folder/layout:checked" "$folder/bundle" >/dev/null
    mv "$folder/bundle/rootfs" "$folder/root"
    echo "skopeo and umoci read $(basename "$image")"
else
    skip 'skopeo and umoci cannot be installed (apt-get install skopeo umoci): the image was not read'
    exit 0
fi
if [ "$(id -u)" != 0 ]; then
    skip 'only root enters the root of the image: it did not run'
    exit 0
fi
# In a mount namespace: shared memory and processes are this machine's, files are the image's.
FIVE_MINUTES_ROOT=$folder/root unshare --mount bash -euo pipefail -c '
    mount --bind /dev/shm "$FIVE_MINUTES_ROOT/dev/shm"
    mount -t proc proc "$FIVE_MINUTES_ROOT/proc"
    exec "$1/five_minutes.sh" chroot "$FIVE_MINUTES_ROOT" /usr/local/bin/joulebus' - "$here"
for program in "$folder"/root/usr/local/bin/*; do
    chroot "$folder/root" "/usr/local/bin/${program##*/}" --help >/dev/null
done
