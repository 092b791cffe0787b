"""A planner: reads forecasts where the worker has written them, and learns at once when the worker ends.

    python planner.py [CONFIG [FRAMES]]        without FRAMES until Ctrl-C
"""
import sys

import joulebus
import numpy as np


def main(config: str = "configs/fleet.toml", frames: str = "") -> None:
    with joulebus.Planner(config) as planner:
        try:
            while not frames or planner.status["frames"] < int(frames):
                event = planner.next(timeout=1.0)
                if isinstance(event, joulebus.Frame):
                    fleet_w = np.nansum(event.power_w)
                    interval_w = event[7].interval_w if 7 in event else None
                    robot = "unknown" if interval_w is None else "{:.2f} to {:.2f} W".format(*interval_w)
                    print(f"tick {event.tick}: fleet {fleet_w:.1f} W, robot 7 {robot}", flush=True)
                elif isinstance(event, joulebus.Gone):
                    print(f"the worker is gone ({event.how}): forecasts are invalid", flush=True)
                elif isinstance(event, joulebus.Stale):
                    print(f"nothing new for {event.age_s:.3f} s", flush=True)
                else:
                    print("no forecasts: does a worker run, and does a controller publish?", flush=True)
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main(*sys.argv[1:])
