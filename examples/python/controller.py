"""A fleet controller: publishes commands and readings 30 times a second, whether or not a worker runs.

    python controller.py [CONFIG [TICKS]]        without TICKS until Ctrl-C
"""
import itertools
import sys
import time

import joulebus
import numpy as np

ROBOTS = np.arange(20)
PERIOD_NS = 33_333_333


def speed_mps(tick: int) -> np.ndarray:
    """Up to 0.15 m/s: the built-in model was trained up to 0.2."""
    return 0.1 + 0.05 * np.sin(0.02 * tick + ROBOTS)


def main(config: str = "configs/fleet.toml", ticks: str = "") -> None:
    with joulebus.Publisher(config, "controller") as publisher:
        # The clock that joulebus stamps with.
        due_ns = time.monotonic_ns()
        try:
            for tick in range(int(ticks)) if ticks else itertools.count():
                # Here a controller reads its robots, decides, and sends the commands. The monitor
                # measures at every third tick, and repeats its reading in between.
                power_w = 2.8 + 9.0 * speed_mps(tick - tick % 3)
                # These come full from their chargers. State what yours know: `soc` if they measure it,
                # `charging` and `full`, `swapped` after an exchange, `off` in the last frame of a robot.
                try:
                    publisher.publish(
                        ROBOTS, v=speed_mps(tick), omega=0.0, power=power_w, held=tick % 3 != 0, full=tick == 0,
                        intended_ns=due_ns,
                    )
                except joulebus.PublishError as error:      # this frame is lost, the next one is due soon
                    print(error, file=sys.stderr)
                due_ns += PERIOD_NS
                time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
        except KeyboardInterrupt:
            pass
        print(publisher.samples_sent, "samples sent")


if __name__ == "__main__":
    main(*sys.argv[1:])
