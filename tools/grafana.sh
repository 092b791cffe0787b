#!/usr/bin/env bash
# Checks configs/grafana/joulebus.json without a Grafana: its form by Grafana's own types
# (@grafana/schema), which also know the options of each kind of panel; its queries by Prometheus'
# parser; its layout. That the metrics exist, tools/browser.sh checks against a live server.
#
#     tools/grafana.sh
#
# Without node 20, npm's registry or promtool it prints what it skips; with CI=true that is a
# failure.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$(realpath -m "${CARGO_TARGET_DIR:-target}")/tools/grafana

skip() {
    echo "SKIPPED: tools/grafana.sh: $1" >&2
    [ "${CI:-}" != true ]
    exit
}

command -v npm >/dev/null || skip "npm is not installed"
[ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ] || skip "node $(node --version) is older than 20"
mkdir -p "$folder"
cp tools/grafana/* "$folder/"
if ! cmp -s "$folder/package.json" "$folder/node_modules/.installed"; then
    # Exact versions, which depend on nothing but typescript's programs for each processor.
    npm install --prefix "$folder" --no-package-lock --silent --no-audit --no-fund || skip "@grafana/schema and typescript were not installed"
    cp "$folder/package.json" "$folder/node_modules/.installed"
fi
node "$folder/write.mjs" configs/grafana/joulebus.json "$folder"
"$folder/node_modules/.bin/tsc" --project "$folder"
echo "configs/grafana/joulebus.json: as @grafana/schema $(node -p "require('$folder/node_modules/@grafana/schema/package.json').version") has it"
command -v promtool >/dev/null || skip "promtool is not installed (tools/prometheus.sh): the queries are not parsed"
promtool check rules --lint=none "$folder/rules.yml"
