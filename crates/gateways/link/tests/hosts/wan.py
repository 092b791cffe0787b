"""A long way between two network namespaces: packets are delayed, lost and reordered. There is no netem in every kernel.

    python3 wan.py NAMESPACE_A NAMESPACE_B DELAY_MS JITTER_MS LOSS_PERCENT

Gives each namespace a TUN device `way` (10.78.0.1 and 10.78.0.2), prints "open", and passes packets on until it is killed.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import sys
import time

CLONE_NEWNET = 0x4000_0000
# <linux/if_tun.h>: TUNSETIFF; IFF_TUN, IFF_NO_PI.
TUNSETIFF = 0x4004_54CA
FLAGS = 0x0001 | 0x1000


def enter(path):
    """Makes this process one of the network namespace at `path`."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open(path) as namespace:
        if libc.setns(namespace.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"setns {path}")


def device(namespace, address):
    """The descriptor of a TUN device in a namespace; it stays there when this process returns."""
    enter(f"/run/netns/{namespace}")
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH", b"way", FLAGS))
    for words in (["addr", "add", f"{address}/24", "dev", "way"], ["link", "set", "way", "up"]):
        subprocess.run(["ip", *words], check=True)
    return descriptor


def main():
    one, other = sys.argv[1:3]
    delay_s, jitter_s, loss = (float(word) for word in sys.argv[3:6])
    delay_s, jitter_s, loss = delay_s / 1e3, jitter_s / 1e3, loss / 100
    chance = random.Random(1)
    ends = [device(one, "10.78.0.1"), device(other, "10.78.0.2")]
    print("open", flush=True)
    waiting, number = [], 0
    while True:
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            _, _, to, packet = heapq.heappop(waiting)
            try:
                os.write(to, packet)
            except BlockingIOError:
                pass
        within = max(0, waiting[0][0] - now) if waiting else None
        for end in select.select(ends, [], [], within)[0]:
            packet = os.read(end, 1 << 16)
            if chance.random() < loss:
                continue
            number += 1
            to = ends[1 - ends.index(end)]
            at = time.monotonic() + delay_s + jitter_s * chance.random()
            heapq.heappush(waiting, (at, number, to, packet))


if __name__ == "__main__":
    main()
