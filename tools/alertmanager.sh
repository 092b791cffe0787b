#!/usr/bin/env bash
# Prints the path of Prometheus' Alertmanager, for the test of `joulebus serve --webhooks`
# (`JOULEBUS_ALERTMANAGER`): the one that is installed, or Debian's package, which root installs
# here. Without one it prints nothing and says why. With CI=true that is a failure.
set -euo pipefail

if ! command -v prometheus-alertmanager >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends prometheus-alertmanager; } >&2 || true
fi
if ! command -v prometheus-alertmanager; then
    echo "alertmanager: skipped: it is not installed (apt-get install prometheus-alertmanager)" >&2
    [ "${CI:-}" != true ]
fi
