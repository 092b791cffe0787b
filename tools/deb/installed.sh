#!/usr/bin/env bash
# Installs, uses, upgrades and removes the package in a copy-on-write view of a Debian: a clean one,
# or `/`. Run by tools/deb.sh as root, in mount and process namespaces of its own: `installed.sh
# EMPTY-FOLDER FILE.deb ROOT`.
set -euo pipefail
work=$1 deb=$2 clean=$3
mount --make-rprivate /
mount -t tmpfs tmpfs "$work"
mkdir "$work"/{upper,work,root}
root=$work/root
mount -t overlay overlay -o "lowerdir=$clean,upperdir=$work/upper,workdir=$work/work" "$root"
mount -t proc proc "$root/proc"
mount -t tmpfs tmpfs "$root/dev/shm" -o mode=1777
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/tmp" -o mode=1777
for device in null zero urandom random full; do
    [ -e "$root/dev/$device" ] || { touch "$root/dev/$device"; mount --bind "/dev/$device" "$root/dev/$device"; }
done
cp "$deb" "$root/tmp/joulebus.deb"
# The version before: the same files under a lower number.
dpkg-deb -R "$deb" "$work/previous"
sed -i 's/^Version: .*/Version: 0.0.1-1/' "$work/previous/DEBIAN/control"
dpkg-deb --root-owner-group -Znone --build "$work/previous" "$root/tmp/previous.deb" > /dev/null
in_root() { chroot "$root" "$@"; }
as_joulebus() { in_root setpriv --reuid joulebus --regid joulebus --clear-groups -- "$@"; }
fail() { echo "tools/deb/installed.sh: $1" >&2; exit 1; }
# What an installation changed, but not what dpkg and its kind keep for themselves.
changed() {
    (cd "$work/upper" && find . -not -type d | sed 's/^\.//') \
        | grep -Ev '^/(var/lib/dpkg|var/log|var/cache|var/lib/systemd|dev|proc|run|tmp|root|usr/share/man/.*\.cache)(/|$)' | sort
}

in_root dpkg --install /tmp/previous.deb
[ -z "$(in_root dpkg --verify joulebus)" ] || fail "dpkg --verify finds differences"
in_root getent passwd joulebus
in_root getent group joulebus-read

# The programs, as the user that the units have.
in_root joulebus --version
for program in $(in_root dpkg -L joulebus | grep '^/usr/bin/'); do
    in_root "$program" --help > "$work/help" && [ -s "$work/help" ] || fail "$program has no help"
done
in_root joulebus config check /etc/joulebus/lab.toml
in_root install -d -o joulebus -g joulebus /var/lib/joulebus
run_a_worker() {
    # Not by a function, so that the process is this shell's child.
    chroot "$root" setpriv --reuid joulebus --regid joulebus --clear-groups -- \
        env STATE_DIRECTORY=/var/lib/joulebus joulebus run --config /etc/joulebus/lab.toml > "$work/report" 2> "$work/worker" &
    worker=$!
    until grep -q '^ready' "$work/worker"; do
        kill -0 "$worker" 2> /dev/null || fail "the worker ended: $(cat "$work/worker")"
        sleep 0.1
    done
    as_joulebus joulebus publish sim --config /etc/joulebus/lab.toml --robots 3 --duration 2
    as_joulebus joulebus watch --config /etc/joulebus/lab.toml --once --robot 2 --format json > "$work/robot"
    kill "$worker"
    wait "$worker" || fail "the worker failed: $(cat "$work/worker")"
}
drawn_j() { sed -n 's/.*"drawn_j":\([0-9.]*\).*/\1/p' "$work/robot"; }
run_a_worker
before_j=$(drawn_j)
echo "ran a worker and a source as user joulebus: robot 2 drew $before_j J"

# Manual pages and completions.
for page in $(in_root dpkg -L joulebus | sed -n 's:^/usr/share/man/man1/\(.*\)\.1\.gz$:\1:p'); do
    in_root env MANWIDTH=100 MANROFFSEQ='' man --warnings "$page" > "$work/page" 2> "$work/warnings"
    [ ! -s "$work/warnings" ] || fail "man $page: $(head -n 3 "$work/warnings")"
    grep -q '^NAME' "$work/page" || fail "man $page shows no NAME"
done
in_root bash -c '
    . /usr/share/bash-completion/completions/joulebus
    completed() { COMP_WORDS=("$@"); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=(); _joulebus joulebus "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"; echo "${COMPREPLY[*]}"; }
    [ "$(completed joulebus wat)" = watch ] && [ "$(completed joulebus record --per-)" = --per-robot ]
' || fail "bash completes no verbs and options"
in_root bash -c 'if command -v zsh > /dev/null; then zsh -n /usr/share/zsh/vendor-completions/_joulebus; fi
    if command -v fish > /dev/null; then fish --no-execute /usr/share/fish/vendor_completions.d/joulebus.fish; fi'

# The units, whose programs are where they say.
for unit in $(in_root dpkg -L joulebus | grep '@\.service$'); do
    in_root systemd-analyze verify --man=no "$unit" > "$work/verified" 2>&1 || fail "$unit: $(cat "$work/verified")"
    ! grep -F "${unit##*/}" "$work/verified" || fail "$unit has warnings"
done
echo "manual pages, completions and units are fine"

# An upgrade keeps what was configured and what was metered; removal leaves both; purging, the state
# and the user.
echo '# changed here' >> "$root/etc/joulebus/lab.toml"
in_root dpkg --install /tmp/joulebus.deb
[ "$(in_root dpkg-query --show --showformat '${Version}' joulebus)" != 0.0.1-1 ] || fail "the previous version is still installed"
[ -z "$(in_root dpkg --verify joulebus | grep -v /etc/joulebus/lab.toml)" ] || fail "dpkg --verify finds differences after the upgrade"
grep -q '# changed here' "$root/etc/joulebus/lab.toml" || fail "an upgrade replaced the config"
run_a_worker
awk "BEGIN { exit !($(drawn_j) > $before_j) }" || fail "an upgrade lost what was metered: $(drawn_j) J after $before_j J"
echo "upgraded from 0.0.1-1: the config stayed, robot 2 drew $(drawn_j) J"
rm -rf "$root/var/lib/joulebus/"*
touch "$root/var/lib/joulebus/lab.json"
in_root dpkg --remove joulebus
left=$(changed | grep -Ev '^/etc/(joulebus/|passwd|group|shadow|gshadow|\.pwd)' || true)
[ "$left" = /var/lib/joulebus/lab.json ] || fail "removal left: $left"
in_root dpkg --purge joulebus
left=$(changed | grep -Ev '^/etc/(passwd|group|shadow|gshadow|\.pwd)' || true)
[ "$left" = /var/lib/joulebus/lab.json ] || fail "purging left: $left"
[ ! -e "$root/etc/joulebus" ] || fail "purging left /etc/joulebus"
echo "removal left config and state, purging the state"
