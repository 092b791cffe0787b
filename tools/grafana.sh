#!/usr/bin/env bash
# Checks configs/grafana/joulebus.json without a Grafana: its queries by Prometheus' parser, that each is of the data source
# and of variables that are declared, and that no panel lies over another. That the metrics exist, tools/browser.sh checks
# against a live server.
#
#     tools/grafana.sh
#
# Without promtool it prints what it skips; with CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$(realpath -m "${CARGO_TARGET_DIR:-target}")/tools/grafana
mkdir -p "$folder"
python3 - configs/grafana/joulebus.json "$folder/rules.yml" <<'PYTHON'
import json
import re
import sys

VALUES = {"$__range": "1h", "$__rate_interval": "1m", "$fleet": "lab|hall", "$robot": "1|2"}
board = json.load(open(sys.argv[1]))
panels, names = board["panels"], {f"${one['name']}" for one in board["templating"]["list"]}
assert len({panel["id"] for panel in panels}) == len(panels), "two panels have one id"
taken, rules = {}, []
for panel in panels:
    place, title = panel["gridPos"], panel["title"]
    for column in range(place["x"], place["x"] + place["w"]):
        assert column < 24, f"{title} is wider than the page"
        for row in range(place["y"], place["y"] + place["h"]):
            over = taken.setdefault((column, row), title)
            assert over == title, f"{title} lies over {over}"
    for query in panel.get("targets", []):
        assert query.get("datasource", panel.get("datasource"))["uid"] == "${datasource}", f"{title} has a data source of its own"
        for variable in re.findall(r"\$\w+", query["expr"]):
            assert variable in VALUES and (variable.startswith("$__") or variable in names), f"{title}: no variable {variable}"
        replaced = re.sub(r"\$\w+", lambda found: VALUES[found[0]], query["expr"])
        rules.append(f"  - record: query:{len(rules)}\n    expr: {json.dumps(replaced)}\n")
open(sys.argv[2], "w").write("groups:\n- name: dashboard\n  rules:\n" + "".join(rules))
print(f"{sys.argv[1]}: {len(panels)} panels, {len(rules)} queries")
PYTHON
command -v promtool >/dev/null || { echo 'SKIPPED: tools/grafana.sh: promtool is not installed (tools/prometheus.sh): the queries are not parsed' >&2; [ "${CI:-}" != true ]; exit; }
promtool check rules --lint=none "$folder/rules.yml"
