#!/usr/bin/env bash
# Evaluates in N processes at once, and reports what one run would, to the bit. On a cluster, its
# scheduler runs the same N commands on hosts that see the recordings under the same names. The last
# command needs their files only.
#
#     tools/eval_parts.sh 8 --model my.safetensors recordings/     # arguments of `joulebus eval`
#
# JOULEBUS names the program [default: the one of PATH].
set -euo pipefail
if [ $# -lt 2 ] || ! [[ $1 =~ ^[1-9][0-9]{0,4}$ ]]; then
    echo "usage: $0 N ARGUMENT…, with N from 1 to 99999, and the arguments of joulebus eval" >&2
    exit 2
fi
parts=$1
shift
joulebus=${JOULEBUS:-joulebus}
folder=$(mktemp -d)
children=()
finish() {
    for child in "${children[@]}"; do
        kill "$child" 2>/dev/null || true
    done
    rm -rf "$folder"
}
trap finish EXIT
trap 'exit 130' INT TERM
for ((part = 1; part <= parts; part++)); do
    "$joulebus" eval "$@" --partition "$part/$parts" --out "$folder/$part.part" >/dev/null &
    children+=($!)
done
# One that fails ends the others.
for child in "${children[@]}"; do
    wait "$child"
done
children=()
"$joulebus" eval --merge "$folder"/*.part
