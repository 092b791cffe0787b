#!/usr/bin/env bash
# Prints the path of a Mosquitto broker, for the tests of `joulebus bridge` (`JOULEBUS_MOSQUITTO`):
# the one that is installed, or Debian's package, which root installs here with its clients
# (tools/blocks.py). Without one it prints nothing and says why. With CI=true that is a failure.
set -euo pipefail
PATH=$PATH:/usr/sbin:/usr/local/sbin

if ! { command -v mosquitto && command -v mosquitto_pub; } >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends mosquitto mosquitto-clients; } >&2 || true
fi
if ! command -v mosquitto; then
    echo "mosquitto: skipped: it is not installed (apt-get install mosquitto)" >&2
    [ "${CI:-}" != true ]
fi
