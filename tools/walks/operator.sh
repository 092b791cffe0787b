#!/usr/bin/env bash
# From nothing to an alarm in a chat, as who operates a fleet: the Debian package of dist/, the two
# services' commands, a page that names what is missing, an alarm's card, the webhook.
#
#     tools/walks/operator.sh
#
# The package is unpacked into the home and its units' commands are run: tools/release.sh installs
# it in a clean root.
. "$(dirname "$0")/step.sh"
walk_begins operator
command -v dpkg-deb >/dev/null || { echo 'SKIPPED: tools/walks/operator.sh: no dpkg-deb' >&2; [ "${CI:-}" != true ]; exit; }
export PATH=$home/root/usr/bin:$PATH STATE_DIRECTORY=$home/state
mkdir state

step 'the package is unpacked' dpkg-deb -x "$(ls "$dist/joulebus_$version-1_$(dpkg --print-architecture).deb")" root
for unit in joulebus@ joulebus-serve@; do
    [ -f "root/usr/lib/systemd/system/$unit.service" ] || { echo "tools/walks/operator.sh: the package has no $unit.service"; exit 1; }
done
cp -r root/etc/joulebus etc
own_domain etc/lab.toml
# The operator's robots are others than the shipped ones: nobody has told their battery yet.
sed '/^\[battery\]/,/^\[/{/^\[battery\]/d;/^\[/!d}' etc/platforms/gternal.toml >etc/platforms/mine.toml
sed -i 's|^file = .*|file = "platforms/mine.toml"|' etc/lab.toml
step 'joulebus config check' joulebus config check etc/lab.toml
# What a chat would be.
cat >hook.py <<'PYTHON'
import http.server
import json


class Hook(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        for change in json.loads(self.rfile.read(int(self.headers["Content-Length"])))["changes"]:
            card = change.get("card", {})
            print(change["change"], change["alarm"], "robot", change["robot"], "-", card.get("check"), flush=True)
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


server = http.server.HTTPServer(("127.0.0.1", 0), Hook)
print("listening on", server.server_port, flush=True)
server.serve_forever()
PYTHON
background hook python3 hook.py
step 'somebody listens for alarms' seen hook '^listening'
hook=http://127.0.0.1:$(sed -n 's/^listening on //p' .hook.log)/
background worker joulebus run --config etc/lab.toml
step 'the worker of joulebus@lab is ready' seen worker '^ready'
background page joulebus serve --http 127.0.0.1:0 --webhook "$hook" --config etc/lab.toml
step 'the page of joulebus-serve@lab is served' seen page 'http://'
page=$(grep -o 'http://[0-9.:]*' .page.log | head -n 1)
background robots joulebus publish sim --config etc/lab.toml --robots 10
step 'the page lists ten robots' until_says '"robots":10' curl -s "$page/api/v1/fleet"
step 'what is missing is named: the battery' until_says 'no \[battery\]: add its capacity_wh' joulebus watch --config etc/lab.toml --once
printf '\n[battery]\ncapacity_wh = 10.0\ninitial_soc = 1.0\ninitial_soc_lo = 0.9\n' >>etc/platforms/mine.toml
ended robots
ended worker
background worker joulebus run --config etc/lab.toml
step 'it is added, and the worker is started again' seen worker '^ready'
background robots joulebus publish sim --config etc/lab.toml --robots 10 --fault 4=load:3
step 'the page has charge and time to empty' until_says '"time_to_empty_s":[0-9]' curl -s "$page/api/v1/robots?count=10"
step 'robot 4 draws 3 W too many: an alarm' until_says '"robot":4,"alarm":"[A-Za-z]*' curl -s "$page/api/v1/alarms"
step 'the webhook is told, with what to check' seen hook '^raised .* robot 4 - [A-Za-z]'
grep -m 1 '^raised .* robot 4' .hook.log
alarm=$(sed -n 's/^raised \([A-Za-z]*\) robot 4.*/\1/p' .hook.log | head -n 1)
step "its card: joulebus alarms --explain $alarm" joulebus alarms --explain "$alarm"
step 'it is acknowledged' joulebus alarms --config etc/lab.toml --acknowledge 4 "$alarm" --by operator
walk_says 'a page that names what is missing, a card, a webhook'
