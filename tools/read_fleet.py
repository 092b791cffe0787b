#!/usr/bin/env python3
"""Reads a running fleet's forecasts with the PyPI package iceoryx2, by joulebus.h alone, and checks what it sees.

Nothing of joulebus is used: the layout is read from the header, the frames by iceoryx2's own Python package. Until stdin
ends it follows the worker, also a killed and restarted one, and checks that

- ticks of a run of the worker only grow, and so do runs.
- the schema is the header's, and no robot has two rows.
- a forecast that is flagged is finite and lies within its interval, and one that is not is not stated.
- no frame is computed after it was sent, or sent in the future. (Stamps of samples are their sources' own.)

A line of JSON at the end says what was seen. Exit code 1 if a check failed.

    tools/read_fleet.py /dev/shm/joulebus-1000/demo/iceoryx2.toml --fleet demo
"""

import argparse
import json
import math
import os
import pathlib
import re
import select
import struct
import sys
import time

from pinned_environment import python_of

PINNED = ["iceoryx2==0.10.0"]
HOME = pathlib.Path.home() / ".cache/joulebus/read-fleet"
HEADER = pathlib.Path(__file__).resolve().parent.parent / "crates/languages/c/include/joulebus.h"
# Which version of each struct the header describes. iceoryx2 compares it.
VERSION = {"Forecast": "joulebus.Forecast.v1", "ForecastHeader": "joulebus.ForecastHeader.v1"}
# Between two looks. An event would wake it, but belongs to a service of its own.
LOOKS_EVERY_S = 0.002


class Layout:
    """A struct as joulebus.h has it: its fields in order, without padding."""

    def __init__(self, header, name):
        body = re.search(rf"typedef struct {name} \{{(.*?)\n\}} {name};", header, re.S)[1]
        body = re.sub(r"/\*.*?\*/", "", body, flags=re.S)
        codes = {"float": "f", "double": "d", "uint16_t": "H", "uint32_t": "I", "uint64_t": "Q", "int64_t": "q"}
        self.fields, self.bytes = {}, 0
        for of, field, count in re.findall(r"(\w+) (\w+)(?:\[(\d+)\])?;", body):
            size = struct.calcsize("<" + codes[of]) if of in codes else Layout(header, of).bytes
            if of in codes and not count:
                self.fields[field] = ("<" + codes[of], self.bytes)
            self.bytes += size * int(count or 1)

    def read(self, memory, start=0):
        """Every plain field of one struct."""
        return {name: struct.unpack_from(code, memory, start + at)[0] for name, (code, at) in self.fields.items()}


class Checks:
    """What is seen, and what is wrong with it."""

    def __init__(self, header):
        self.header, self.row = Layout(header, "joulebus_forecast_header"), Layout(header, "joulebus_forecast")
        self.schema = int(re.search(r"#define JOULEBUS_SCHEMA_VERSION (\d+)u", header)[1])
        bits = dict(re.findall(r"#define JOULEBUS_FORECAST_(POWER|INTERVAL) (0x\w+?)u", header))
        self.power, self.interval = int(bits["POWER"], 16), int(bits["INTERVAL"], 16)
        self.run, self.tick = 0, 0
        self.seen = {"frames": 0, "forecasts": 0, "runs": 0, "skipped": 0}
        self.wrong = []

    def check(self, holds, text):
        if not holds and len(self.wrong) < 20:
            self.wrong.append(text)

    def frame(self, header, rows):
        head = self.header.read(header)
        now_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        run, tick = head["worker_epoch"], head["tick"]
        self.check(head["schema"] == self.schema, f"schema {head['schema']}, the header has {self.schema}")
        self.check(run >= self.run, f"run {run} after {self.run}")
        if run == self.run:
            self.check(tick > self.tick, f"tick {tick} after {self.tick} of run {run}")
            self.seen["skipped"] += max(0, tick - self.tick - 1)
        else:
            self.seen["runs"] += 1
        self.run, self.tick = run, tick
        self.check(head["compute_end_ns"] <= head["sent_ns"] <= now_ns, f"sent at {head['sent_ns']}, it is {now_ns}")
        robots = set()
        for start in range(0, len(rows), self.row.bytes):
            row = self.row.read(rows, start)
            self.forecast(row)
            self.check(row["robot"] not in robots, f"robot {row['robot']} has two rows at tick {tick}")
            robots.add(row["robot"])
            self.seen["forecasts"] += 1
        self.seen["frames"] += 1

    def forecast(self, row):
        power_w, lo_w, hi_w = row["power_w"], row["lo_w"], row["hi_w"]
        name = f"robot {row['robot']} at tick {self.tick}"
        has_power, has_interval = bool(row["flags"] & self.power), bool(row["flags"] & self.interval)
        self.check(math.isfinite(power_w) == has_power, f"{name}: power {power_w}, flags {row['flags']}")
        self.check(not has_interval or lo_w <= power_w <= hi_w, f"{name}: {power_w} outside {lo_w} to {hi_w}")


def subscriber(node, service, checks):
    """A subscriber of the service, which a worker has made. None if there is none yet."""
    import ctypes

    import iceoryx2

    def opaque(name, size):
        words = {"_fields_": [("words", ctypes.c_uint64 * (size // 8))], "type_name": staticmethod(lambda: VERSION[name])}
        return type(name, (ctypes.Structure,), words)

    rows, header = opaque("Forecast", checks.row.bytes), opaque("ForecastHeader", checks.header.bytes)
    builder = node.service_builder(iceoryx2.ServiceName.new(service)).publish_subscribe(iceoryx2.Slice[rows])
    try:
        return builder.user_header(header).open().subscriber_builder().create()
    except (iceoryx2.PublishSubscribeOpenError, iceoryx2.SubscriberCreateError):
        return None


def follow(config, fleet):
    import ctypes

    import iceoryx2

    iceoryx2.set_log_level(iceoryx2.LogLevel.Fatal)
    checks = Checks(HEADER.read_text())
    loaded = iceoryx2.config.setup_global_config_from_file(iceoryx2.FilePath.new(str(config)))
    node = iceoryx2.NodeBuilder.new().config(loaded or iceoryx2.config.global_config()).create(iceoryx2.ServiceType.Ipc)
    frames = None
    print("ready", file=sys.stderr, flush=True)
    while not select.select([sys.stdin], [], [], LOOKS_EVERY_S)[0]:
        frames = frames or subscriber(node, f"joulebus/{fleet}/forecasts", checks)
        try:
            sample = frames and frames.receive()
        except iceoryx2.ReceiveError as error:
            # A publisher died while it was connected.
            print(f"receive: {error}", file=sys.stderr)
            continue
        while sample:
            rows = sample.payload()
            # Its length is in bytes.
            memory = ctypes.string_at(sample.payload_ptr, rows.len())
            header = ctypes.string_at(sample.user_header_ptr, checks.header.bytes)
            sample.delete()
            checks.frame(header, memory)
            sample = frames.receive()
    print(json.dumps({**checks.seen, "wrong": checks.wrong}))
    return 1 if checks.wrong else 0


def main():
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("config", type=pathlib.Path, help="iceoryx2.toml in the fleet's folder")
    words.add_argument("--fleet", required=True, help="the fleet's name")
    asked = words.parse_args()
    if pathlib.Path(sys.prefix).resolve() == HOME.resolve():
        return follow(asked.config, asked.fleet)
    python = python_of(HOME, PINNED)
    # In place of this process: who stops it stops the reader.
    os.execv(python, [python, *sys.argv])


if __name__ == "__main__":
    sys.exit(main())
