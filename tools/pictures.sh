#!/usr/bin/env bash
# Renders every picture of README.md again and takes a screenshot of each in a browser, for
# inspection.
#
#     tools/pictures.sh [SCREENSHOTS]     # default: target/pictures
#
# JOULEBUS_BIN names another directory of the programs (default: built here, target/release). The
# live view and the page show latencies: on a quiet machine.
#
# Needs Chromium, node, tmux, Python 3 and the recordings in ../shared/data (Robotino:
# BrOleg5/research-wheel-slippage at b4303b4c, Apache-2.0; 648 trials of a Festo Robotino v2 on four
# surfaces). docs/pictures/dataflow.svg is drawn by hand.
set -euo pipefail
cd "$(dirname "$0")/.."
screenshots=${1:-target/pictures}
data=../shared/data/robotino
for program in chromium tmux python3; do
    command -v "$program" >/dev/null || { echo "pictures.sh: $program is missing: apt-get install $program" >&2; exit 1; }
done
[ -d "$data" ] || { echo "pictures.sh: $data is missing: the pictures show these recordings" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$screenshots"
if [ -z "${JOULEBUS_BIN:-}" ]; then
    cargo build --release --workspace --bins
    JOULEBUS_BIN=$PWD/target/release
fi
joulebus=$JOULEBUS_BIN/joulebus

# The live view: a demo in a terminal of 120 columns, moving from its begin to just before its end.
tmux -L pictures new-session -d -s view -x 120 -y 30 "$joulebus demo --capture $work/demo.mcap"
frames=()
for at in 01 02 03 04 05 06 07 08 09; do
    sleep 2
    tmux -L pictures capture-pane -t view -p -e > "$work/frame-$at"
    frames+=("$work/frame-$at")
done
python3 tools/ansi_svg.py --seconds 1.5 "${frames[@]}" > docs/pictures/live-view.svg
tmux -L pictures kill-server

# The report: trained on every second trial, shown on held-out trials.
"$joulebus" train trials "$data/*exp*[02468].csv.gz" --split trial --out "$work/robotino.safetensors" > /dev/null
"$joulebus" report "$data/*gray_surface_exp*[13579].csv.gz" --battery-wh 70 --model "$work/robotino.safetensors" -o "$work/report" > /dev/null

screenshot() { # page, width, height, file
    chromium --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking \
        --disable-component-update --disable-sync --user-data-dir="$work/chromium" --hide-scrollbars \
        --screenshot="$4" --window-size="$2,$3" "file://$1" > "$work/chromium.log" 2>&1
}
screenshot "$work/report/report.html" 1100 1250 "$PWD/docs/pictures/report-page.png"
for picture in docs/pictures/*.svg; do
    size=$(python3 -c 'import re,sys; t=open(sys.argv[1]).read(); print(*re.search(r"<svg[^>]*? width=\"(\d+)[^>]*? height=\"(\d+)", t).groups())' "$picture")
    screenshot "$PWD/$picture" ${size} "$PWD/$screenshots/$(basename "$picture" .svg).png"
done
JOULEBUS_BIN=$JOULEBUS_BIN tools/browser.sh --pictures
cp docs/pictures/*.png "$screenshots"
echo "rendered into docs/; inspect the screenshots in $screenshots"
