#!/usr/bin/env bash
# Prints the path of an etcd server, for the tests of `joulebus link` with a lease
# (`JOULEBUS_ETCD`): the one that is installed, or Debian's package, which root installs here.
# Without one it prints nothing and says why. With CI=true that is a failure.
set -euo pipefail

if ! command -v etcd >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends etcd-server; } >&2 || true
fi
if ! command -v etcd; then
    echo "etcd: skipped: it is not installed (apt-get install etcd-server)" >&2
    [ "${CI:-}" != true ]
fi
