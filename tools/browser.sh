#!/usr/bin/env bash
# Drives the operator's page (`joulebus serve --http`) and reports in a real browser: real programs,
# headless Chromium, Playwright and axe, whose versions tools/browser/package-lock.json fixes.
#
#     tools/browser.sh              # the tests
#     tools/browser.sh --pictures   # docs/pictures/page*.png again
#
# Root installs Debian's Chromium. Without node 20, npm, Chromium or npm's registry it prints a note
# and passes, except with CI=true. CHROMIUM names another browser, JOULEBUS_BIN another directory of
# the programs (default: built here, target/debug).
set -euo pipefail
cd "$(dirname "$0")/.."
folder=target/browser

skip() {
    echo "browser: skipped: $1" >&2
    [ "${CI:-}" != true ]
    exit
}

command -v node >/dev/null || skip "node is not installed"
command -v npm >/dev/null || skip "npm is not installed"
[ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ] || skip "node $(node --version) is older than 20"
installed() { command -v chromium || command -v chromium-browser || command -v google-chrome; }
if [ -z "${CHROMIUM:-}" ] && ! installed >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium; } >&2 || true
fi
CHROMIUM=${CHROMIUM:-$(installed || true)}
[ -n "$CHROMIUM" ] || skip "Chromium is not installed (apt-get install chromium)"

mkdir -p "$folder"
rm -rf "$folder/page"
cp -r crates/gateways/serve/page "$folder/page"
cp tools/browser/* "$folder/"
if ! cmp -s "$folder/package-lock.json" "$folder/node_modules/.installed"; then
    npm ci --prefix "$folder" --silent --no-audit --no-fund || skip "playwright-core and axe-core were not installed"
    cp "$folder/package-lock.json" "$folder/node_modules/.installed"
fi
if [ -z "${JOULEBUS_BIN:-}" ]; then
    # Examples need what tests need: so the dependencies have the features that `cargo test
    # --workspace` compiled them with.
    cargo build --locked --workspace --lib --bins --examples
    JOULEBUS_BIN=$PWD/target/debug
fi
export CHROMIUM JOULEBUS_BIN JOULEBUS_ROOT=$PWD
if [ "${1:-}" = --pictures ]; then
    exec node "$folder/pictures.mjs" "${2:-docs/pictures}"
fi
node --test --test-reporter=spec "$folder/parts.test.mjs"
node --test --test-reporter=spec "$folder/report.test.mjs"
node --test --test-reporter=spec "$folder/page.test.mjs"
