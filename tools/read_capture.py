#!/usr/bin/env python3
"""Reads a capture with independent Python packages and compares it with `joulebus info`.

Nothing of joulebus is used to read: `mcap` and `mcap-protobuf-support` decode every message by the
descriptors that lie in the file. Checked, for every channel with protobuf messages:

- its schema is a FileDescriptorSet that needs no other file.
- there are plain numbers in it, so that PlotJuggler and Foxglove have something to plot.
- log times never fall, and sequence numbers rise by one.
- every message decodes. Numbers that are not known are NaN or absent, never infinite.
- counts and times are those that `joulebus info --format json` shows, and those in the file.

The packages go into an environment of their own, ~/.cache/joulebus/read-capture (or --venv).

    tools/read_capture.py run.mcap
    tools/read_capture.py run.mcap --joulebus target/release/joulebus
"""

import argparse
import json
import math
import os
import pathlib
import subprocess
import sys

from pinned_environment import python_of

PINNED = ["mcap==1.6.0", "mcap-protobuf-support==0.6.0"]


def arguments():
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("capture", type=pathlib.Path)
    words.add_argument("--joulebus", help="the program whose `info` is compared [default: not compared]")
    words.add_argument(
        "--venv",
        type=pathlib.Path,
        default=pathlib.Path.home() / ".cache" / "joulebus" / "read-capture",
        help="where the packages are installed",
    )
    words.add_argument(
        "--faults",
        action="store_true",
        help="of a fleet with faults: samples may have any bits, and sequence numbers skip what was lost",
    )
    words.add_argument("--show", type=int, default=1, help="messages shown of each channel [default: 1]")
    return words.parse_args()


def inside(place):
    """Runs this script again in an environment that has the packages."""
    python = python_of(place, PINNED)
    environment = dict(os.environ, JOULEBUS_READ_CAPTURE="1")
    return subprocess.run([python, __file__, *sys.argv[1:]], env=environment, check=False).returncode


class Trouble(Exception):
    """Something about the capture that other programs would reject."""


def self_contained(schema):
    """The message that a schema declares, built from nothing but the schema."""
    from google.protobuf import descriptor_pb2, descriptor_pool

    files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        # Fails if an import is missing or out of order.
        pool.Add(file)
    return pool.FindMessageTypeByName(schema.name)


def plain_numbers(descriptor, before="", seen=()):
    """Names of the fields that can be plotted."""
    names = []
    for field in descriptor.fields:
        name = before + field.name
        if field.message_type is not None:
            if field.message_type.full_name not in seen:
                inner = (*seen, field.message_type.full_name)
                names += plain_numbers(field.message_type, name + ".", inner)
        elif field.type not in (field.TYPE_STRING, field.TYPE_BYTES):
            names.append(name)
    return names


def infinite(message):
    """Names of the fields that hold an infinity."""
    found = []
    for field, value in message.ListFields():
        values = value if field.is_repeated else [value]
        for one in values:
            if field.message_type is not None:
                found += [f"{field.name}.{name}" for name in infinite(one)]
            elif isinstance(one, float) and math.isinf(one):
                found.append(field.name)
    return found


class Channel:
    """What is counted of a channel."""

    def __init__(self, channel, schema):
        self.topic = channel.topic
        self.schema = schema.name
        self.numbers = plain_numbers(self_contained(schema))
        if not self.numbers:
            raise Trouble(f"{self.topic}: {self.schema} has no number to plot")
        self.messages = 0
        self.first = self.last = None
        self.sequence = None

    def take(self, message, decoded, faults):
        if self.last is not None and message.log_time < self.last:
            raise Trouble(f"{self.topic}: log time falls at message {message.sequence}")
        skipped = 0 if self.sequence is None else (message.sequence - self.sequence - 1) % 2**32
        if skipped and (not faults or skipped >= 2**31):
            raise Trouble(f"{self.topic}: message {message.sequence} follows {self.sequence}")
        if message.publish_time > message.log_time:
            raise Trouble(f"{self.topic}: message {message.sequence} was logged before it was sent")
        bad = [] if faults and self.topic.endswith("/samples") else infinite(decoded)
        if bad:
            raise Trouble(f"{self.topic}: message {message.sequence} has infinite {', '.join(bad)}")
        self.first = message.log_time if self.first is None else self.first
        self.last, self.sequence = message.log_time, message.sequence
        self.messages += 1


def read(path, show, faults):
    """All channels of a capture, and what its own statistics say."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    channels = {}
    last = 0
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise Trouble("the capture has no summary: it was not finished (joulebus recover)")
        messages = reader.iter_decoded_messages(log_time_order=False)
        for schema, channel, message, decoded in messages:
            if channel.id not in channels:
                channels[channel.id] = Channel(channel, schema)
            if message.log_time < last:
                raise Trouble(f"{channel.topic}: log times of the file fall at byte order")
            last = message.log_time
            seen = channels[channel.id]
            seen.take(message, decoded, faults)
            if seen.messages <= show:
                text = " ".join(str(decoded).split())
                print(f"  {channel.topic} #{message.sequence}: {text[:200]}")
        attachments = [index.name for index in summary.attachment_indexes]
    return channels, summary.statistics, attachments


def compare(what, ours, theirs):
    if ours != theirs:
        raise Trouble(f"{what}: joulebus says {ours}, Python found {theirs}")


def compare_with_info(program, path, channels, statistics):
    shown = subprocess.run(
        [program, "info", str(path), "--format", "json"], check=True, stdout=subprocess.PIPE
    )
    info = json.loads(shown.stdout)["files"][0]
    compare("statistics", info["statistics"]["state"], "agree")
    compare("messages", info["messages"], statistics.message_count)
    compare("channels", len(info["channels"]), statistics.channel_count)
    compare("schemas", len(info["schemas"]), statistics.schema_count)
    compare("attachments", info["attachment_count"], statistics.attachment_count)
    compare("chunks", sum(one["chunks"] for one in info["chunks"]), statistics.chunk_count)
    # Without messages there are no times.
    times = (statistics.message_start_time, statistics.message_end_time)
    start, end = times if statistics.message_count else (None, None)
    compare("start", info["start_ns"], start)
    compare("end", info["end_ns"], end)
    by_id = {one["id"]: one for one in info["channels"]}
    for number, seen in channels.items():
        ours = by_id[number]
        compare(f"{seen.topic}: topic", ours["topic"], seen.topic)
        compare(f"{seen.topic}: schema", ours["schema"], seen.schema)
        compare(f"{seen.topic}: messages", ours["messages"], seen.messages)
        compare(f"{seen.topic}: start", ours["start_ns"], seen.first)
        compare(f"{seen.topic}: end", ours["end_ns"], seen.last)
    print(f"equal to `{program} info`: {len(channels)} channels, {statistics.message_count} messages")


def main():
    asked = arguments()
    if not os.environ.get("JOULEBUS_READ_CAPTURE"):
        return inside(asked.venv)
    try:
        channels, statistics, attachments = read(asked.capture, asked.show, asked.faults)
        counted = sum(seen.messages for seen in channels.values())
        compare("messages in the statistics", statistics.message_count, counted)
        for number, seen in sorted(channels.items()):
            compare(
                f"{seen.topic}: messages in the statistics",
                statistics.channel_message_counts.get(number, 0),
                seen.messages,
            )
            numbers = len(seen.numbers)
            print(f"{seen.topic}: {seen.messages} messages of {seen.schema}, {numbers} numbers to plot")
        print(f"attachments: {', '.join(attachments) or 'none'}")
        if asked.joulebus:
            compare_with_info(asked.joulebus, asked.capture, channels, statistics)
    except Trouble as trouble:
        print(f"{asked.capture}: {trouble}", file=sys.stderr)
        return 1
    print("ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())
