#!/usr/bin/env python3
"""Reads a capture with PyPI's mcap and mcap-protobuf-support, and compares it with `joulebus info`.

    tools/read_capture.py run.mcap --joulebus target/release/joulebus
    tools/read_capture.py run.mcap --faults    # samples may have any bits, and sequence numbers skip what was lost

Nothing of joulebus is used to read. Checked, for every channel with protobuf messages:

- its schema is a FileDescriptorSet that needs no other file, with numbers that PlotJuggler and Foxglove can plot.
- log times never fall, and sequence numbers rise by one.
- every message decodes. Numbers that are not known are NaN or absent, never infinite.
- counts and times are those that `joulebus info --format json` shows, and those in the file.
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
HOME = pathlib.Path.home() / ".cache/joulebus/read-capture"


def check(holds, text):
    if not holds:
        sys.exit(f"read_capture.py: {text}")


def equal(what, ours, theirs):
    check(ours == theirs, f"{what}: joulebus says {ours}, Python found {theirs}")


def plain_numbers(descriptor, seen=()):
    """How many fields of a message can be plotted."""
    count = 0
    for field in descriptor.fields:
        inner = field.message_type
        if inner is None:
            count += field.type not in (field.TYPE_STRING, field.TYPE_BYTES)
        elif inner.full_name not in seen:
            count += plain_numbers(inner, (*seen, inner.full_name))
    return count


def infinite(message):
    """Names of the fields that hold an infinity."""
    for field, value in message.ListFields():
        for one in value if field.is_repeated else [value]:
            if field.message_type is not None:
                yield from (f"{field.name}.{name}" for name in infinite(one))
            elif isinstance(one, float) and math.isinf(one):
                yield field.name


class Channel:
    """What is counted of a channel."""

    def __init__(self, channel, schema):
        from google.protobuf import descriptor_pb2, descriptor_pool

        self.topic, self.schema = channel.topic, schema.name
        self.messages, self.first, self.last, self.sequence = 0, None, None, None
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            # Fails if an import is missing or out of order.
            pool.Add(file)
        self.numbers = plain_numbers(pool.FindMessageTypeByName(schema.name))
        check(self.numbers, f"{self.topic}: {self.schema} has no number to plot")

    def take(self, message, decoded, faults):
        where = f"{self.topic}: message {message.sequence}"
        check(self.last is None or message.log_time >= self.last, f"{where}: the log time falls")
        skipped = 0 if self.sequence is None else (message.sequence - self.sequence - 1) % 2**32
        check(not skipped or (faults and skipped < 2**31), f"{where} follows {self.sequence}")
        check(message.publish_time <= message.log_time, f"{where} was logged before it was sent")
        bad = [] if faults and self.topic.endswith("/samples") else list(infinite(decoded))
        check(not bad, f"{where} has infinite {', '.join(bad)}")
        self.first = message.log_time if self.first is None else self.first
        self.last, self.sequence = message.log_time, message.sequence
        self.messages += 1


def read(path, faults):
    """All channels of a capture, and what its own statistics say."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    channels, last = {}, 0
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        check(summary and summary.statistics, "there is no summary: the capture was not finished (joulebus recover)")
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            check(message.log_time >= last, f"{channel.topic}: log times of the file fall in the order of bytes")
            last = message.log_time
            if channel.id not in channels:
                channels[channel.id] = Channel(channel, schema)
            channels[channel.id].take(message, decoded, faults)
    counts = summary.statistics.channel_message_counts
    for number, seen in sorted(channels.items()):
        equal(f"{seen.topic}: messages in the statistics", counts.get(number, 0), seen.messages)
        print(f"{seen.topic}: {seen.messages} messages of {seen.schema}, {seen.numbers} numbers to plot")
    equal("messages in the statistics", summary.statistics.message_count, sum(seen.messages for seen in channels.values()))
    return channels, summary.statistics


def compare_with_info(program, path, channels, statistics):
    shown = subprocess.run([program, "info", path, "--format", "json"], check=True, stdout=subprocess.PIPE).stdout
    info = json.loads(shown)["files"][0]
    # Without messages there are no times.
    times = (statistics.message_start_time, statistics.message_end_time) if statistics.message_count else (None, None)
    for what, ours, theirs in [
        ("messages", info["messages"], statistics.message_count),
        ("channels", len(info["channels"]), statistics.channel_count),
        ("schemas", len(info["schemas"]), statistics.schema_count),
        ("attachments", info["attachment_count"], statistics.attachment_count),
        ("chunks", sum(one["chunks"] for one in info["chunks"]), statistics.chunk_count),
        ("times", (info["start_ns"], info["end_ns"]), times),
    ]:
        equal(what, ours, theirs)
    by_id = {one["id"]: one for one in info["channels"]}
    for number, seen in channels.items():
        ours = [by_id[number][key] for key in ("topic", "schema", "messages", "start_ns", "end_ns")]
        equal(seen.topic, ours, [seen.topic, seen.schema, seen.messages, seen.first, seen.last])
    print(f"equal to `{program} info`: {len(channels)} channels, {statistics.message_count} messages")


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("capture")
    words.add_argument("--joulebus", help="the program whose `info` is compared [default: not compared]")
    words.add_argument("--faults", action="store_true")
    asked = words.parse_args()
    if pathlib.Path(sys.prefix).resolve() != HOME.resolve():
        python = python_of(HOME, PINNED)
        os.execv(python, [python, *sys.argv])
    channels, statistics = read(asked.capture, asked.faults)
    if asked.joulebus:
        compare_with_info(asked.joulebus, asked.capture, channels, statistics)


if __name__ == "__main__":
    main()
