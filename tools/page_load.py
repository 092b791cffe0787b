#!/usr/bin/env python3
"""What a page with many browsers, or links to other hosts, cost the worker: its tick times without and with them, in turn.

    cargo build --release -p joulebus -p joulebus-serve -p joulebus-link
    tools/page_load.py --browsers 50 --robots 100 --seconds 30 --rounds 3
    tools/page_load.py --links 3 --robots 100 --seconds 30 --rounds 3

Each run has a worker and a source of its own. A browser is a stream of 50 rows and a robot at 5 Hz, as the page opens it. A link
is one of another host that follows forecasts, diagnostics and budgets, all on this machine.
Prints p50, p99 and p99.9 of the worker's ticks, µs, of each run, and their medians.
"""

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import tempfile
import threading
import time
from pathlib import Path

CONFIG = """[fleet]
name = "load"
capacity = {capacity}
[domain]
root = "/dev/shm/jbload-{number}"
prefix = "jbload_"
[ledger]
checkpoint = ""
[worker]
priority = {priority}
cpus = "{cpus}"
[[platform]]
file = "builtin:gternal"
robots = ["0-{last}"]
"""


def browser(address, stop, counts, place):
    """Reads a stream and counts its events."""
    # Browsers are on other hosts. Here they take what is left. A property of the calling thread.
    os.nice(19)
    host, port = address.split(":")
    with socket.create_connection((host, int(port))) as stream:
        stream.settimeout(10)
        request = f"GET /api/v1/stream?count=50&robot=1&hz=5 HTTP/1.1\r\nHost: {address}\r\n\r\n"
        stream.sendall(request.encode())
        while not stop.is_set():
            received = stream.recv(1 << 16)
            if not received:
                return
            counts[place] += received.count(b"event: ")


def links(programs, config, count, args):
    """The worker's link and those of so many other hosts, in the order in which they end."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{found.getsockname()[1]}"
    started = []
    for place in range(count + 1):
        name = f"desk{place}" if place else "base"
        own = config
        if place:
            own = config.with_name(f"{name}.toml")
            own.write_text(config.read_text().replace("jbload", f"jbl{place}"))
        sides = f'connect = ["{address}"]\n[follow]\nworker = "base"\n' if place else f'listen = ["{address}"]\n[worker]\n'
        file = config.with_name(f"{name}.link.toml")
        file.write_text(f'name = "{name}"\n[network]\n{sides}')
        link = subprocess.Popen(
            [programs / "joulebus-link", file, "--config", own, "--format", "json"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while "is open" not in link.stderr.readline():
            pass
        started.insert(0, link)
    return started


def run(programs, config, browsers, args):
    """The worker's report of one run, and the events that browsers, or the frames that links, received."""
    named = ["--config", str(config)]
    worker = subprocess.Popen(
        [programs / "joulebus", "--format", "json", "run", *named],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while "ready:" not in worker.stderr.readline():
        pass
    # Links before the source: until it sends there is no tick, so that none counts in which a link
    # starts.
    linked = links(programs, config, args.links, args) if browsers and args.links else []
    source = subprocess.Popen(
        [programs / "joulebus", "publish", "sim", "--robots", str(args.robots), *named],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stop, counts, threads, server = threading.Event(), [0] * browsers, [], None
    if browsers and not linked:
        server = subprocess.Popen(
            [programs / "joulebus-serve", "--http", "127.0.0.1:0", *named],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        line = ""
        while "serving fleet" not in line:
            line = server.stderr.readline()
        address = line.strip().rsplit("/", 1)[1]
        for place in range(browsers):
            thread = threading.Thread(target=browser, args=(address, stop, counts, place))
            thread.start()
            threads.append(thread)
    time.sleep(args.seconds)
    stop.set()
    for thread in threads:
        thread.join()
    for process in (server, source):
        if process:
            process.send_signal(signal.SIGTERM)
            process.wait()
    for link in linked:
        link.send_signal(signal.SIGTERM)
        taken = json.loads(link.communicate()[0])["taken"]
        counts.append(sum(host["frames"] for host in taken))
    worker.send_signal(signal.SIGTERM)
    report, _ = worker.communicate()
    return json.loads(report), sum(counts)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--browsers", type=int, default=50)
    parser.add_argument("--links", type=int, default=0, help="links to other hosts, instead of a page with browsers")
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--priority", type=int, default=0, help="worker.priority: SCHED_FIFO above 0")
    parser.add_argument("--programs", type=Path, default=Path(__file__).parent.parent / "target/release")
    parser.add_argument("--cpu", type=int, help="the worker's own processor (worker.cpus); all else runs on the others")
    args = parser.parse_args()
    if args.cpu is not None:
        # Inherited by all processes and threads. The worker's ticks go where its config says.
        os.sched_setaffinity(0, os.sched_getaffinity(0) - {args.cpu})
    found = {0: [], args.links or args.browsers: []}
    what = "links" if args.links else "browsers"
    with tempfile.TemporaryDirectory() as directory:
        for number in range(args.rounds):
            for browsers in found:
                config = Path(directory) / "fleet.toml"
                config.write_text(CONFIG.format(capacity=args.robots, last=args.robots - 1, number=number,
                                                priority=args.priority,
                                                cpus="" if args.cpu is None else args.cpu))
                report, events = run(args.programs, config, browsers, args)
                tick = report["tick"]
                found[browsers].append((tick["p50_us"], tick["p99_us"], tick["p999_us"]))
                print(f"{browsers:>3} {what}: ticks {report['ticks']}, p50 {tick['p50_us']:.0f}, p99 {tick['p99_us']:.0f}, "
                      f"p99.9 {tick['p999_us']:.0f} µs, skipped {report['ticks_skipped']}, {'frames' if args.links else 'events'} {events}", flush=True)
    for place, name in enumerate(["p50", "p99", "p99.9"]):
        without, beside = (statistics.median(run[place] for run in runs) for runs in found.values())
        print(f"{name}: {without:.0f} µs without, {beside:.0f} µs with {args.links or args.browsers} {what}: {100 * (beside / without - 1):+.0f} %")


if __name__ == "__main__":
    main()
