#!/usr/bin/env bash
# Reads a Debian package by lintian: `lint.sh FILE.deb`. It is installed if apt may, else that is
# skipped aloud, and a failure with CI=true.
set -euo pipefail
if ! command -v lintian >/dev/null && [ "$(id -u)" = 0 ]; then
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends lintian; } >/dev/null 2>&1 || true
fi
if command -v lintian >/dev/null; then
    lintian --allow-root --fail-on error,warning "$1"
    echo "lintian: no errors, no warnings in ${1##*/}"
else
    echo "SKIPPED: tools/deb/lint.sh: lintian is not installed (apt-get install lintian)" >&2
    [ "${CI:-}" != true ]
    # tools/release.sh counts its step as skipped.
    [ -z "${RELEASE_SKIPPED:-}" ] || touch "$RELEASE_SKIPPED"
fi
