"""The first five minutes of who has installed the package alone: the demo, and a yes."""

import joulebus

with joulebus.demo() as demo:
    trip = demo.planner.ask(7, [(0.0, 0.0), (1.0, 0.0)], back_to=(0.0, 0.0))[0]
assert trip.verdict == "yes", trip
print(trip.verdict, f"{trip.energy_j:.1f} J, {trip.margin_j:.0f} J to spare")
print(joulebus.__version__, joulebus.EnergyPredictor().step(0.1, 0.0), "mW")
try:
    joulebus.simulate(1)
except ImportError as error:
    print(error)
else:
    raise SystemExit("the lab is there without joulebus-lab")
