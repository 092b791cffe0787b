#!/usr/bin/env bash
# Checks the alert rules and the config in configs/prometheus with Prometheus' own tool, and what
# each rule fires on (tools/prometheus/rules.test.yml). Installs Debian's package where root may, so
# that the test of crates/gateways/serve that has the metrics scraped finds it. Skips aloud without
# it. With CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."

if ! command -v promtool >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends prometheus; } >&2 || true
fi
if ! command -v promtool >/dev/null; then
    echo "prometheus: skipped: promtool is not installed (apt-get install prometheus)" >&2
    [ "${CI:-}" != true ]
    exit
fi
rules=configs/prometheus/joulebus.rules.yml tests=tools/prometheus/rules.test.yml
promtool check config configs/prometheus/prometheus.yml
promtool test rules "$tests"
while read -r alert; do
    grep -q "alertname=\"$alert\"" "$tests" || { echo "prometheus: no test in $tests fires $alert" >&2; exit 1; }
done < <(sed -n 's/^ *- alert: //p' "$rules")
