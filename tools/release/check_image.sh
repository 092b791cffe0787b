#!/usr/bin/env bash
# Reads an OCI image by programs of others (skopeo, umoci), and runs what it holds in a root of
# nothing else: its five minutes.
#
#     tools/release/check_image.sh FILE.oci.tar FOLDER     # a folder for what is unpacked
set -euo pipefail
image=$(realpath "$1") folder=$(realpath "$2")
here=$(dirname "$(realpath "$0")")
rm -rf "$folder/layout" "$folder/bundle" "$folder/root"
skopeo inspect "oci-archive:$image" >"$folder/inspected.json"
skopeo copy --quiet "oci-archive:$image" "oci:$folder/layout:checked"
options=()
[ "$(id -u)" = 0 ] || options=(--rootless)
umoci unpack "${options[@]}" --image "$folder/layout:checked" "$folder/bundle" >/dev/null
mv "$folder/bundle/rootfs" "$folder/root"
echo "skopeo and umoci read $(basename "$image")"
if [ "$(id -u)" != 0 ]; then
    echo 'SKIPPED: tools/release/check_image.sh: only root enters the root of the image: it did not run' >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
    # tools/release.sh counts its step as skipped.
    [ -z "${RELEASE_SKIPPED:-}" ] || touch "$RELEASE_SKIPPED"
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
