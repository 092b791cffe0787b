#!/usr/bin/env bash
# From nothing to a yes and a score, as who does research in Python: wheels of dist/,
# `joulebus.demo()`, `ask`, `cross_val_score`.
#
#     tools/walks/python.sh
#
# NumPy, and at its end scikit-learn, come from PyPI. Without it that step is skipped aloud, with
# CI=true it is a failure.
. "$(dirname "$0")/step.sh"
walk_begins python
wheel() { ls "$dist/$1-$version"-*"_$(uname -m).whl"; }

step 'python3 -m venv' python3 -m venv venv
step 'pip install of the wheel' venv/bin/python -m pip install --quiet --disable-pip-version-check "$(wheel joulebus)"
cat >trip.py <<'PYTHON'
import joulebus

with joulebus.demo() as demo:
    trip = demo.planner.ask(7, [(0.0, 0.0), (1.0, 0.0)], back_to=(0.0, 0.0))[0]
    print(f"robot 7: {trip.verdict}, {trip.energy_j:.1f} J, {trip.margin_j:.0f} J to spare")
    assert trip.verdict == "yes"
    ranked = demo.planner.ask(demo.robots, [(0.0, 0.0), (3.0, 0.0)], back_to=(0.0, 0.0))
    print(f"the best of {len(ranked.verdict)} is robot {ranked[0].robot}")
PYTHON
step 'joulebus.demo(): the first yes' venv/bin/python trip.py
cat .out
step 'pip install of the lab' venv/bin/python -m pip install --quiet --disable-pip-version-check "$(wheel joulebus_lab)"
if step 'pip install scikit-learn' bash -c 'venv/bin/python -m pip install --quiet --disable-pip-version-check scikit-learn || [ "${CI:-}" != true ]' &&
    venv/bin/python -c 'import sklearn' 2>/dev/null; then
    cat >score.py <<'PYTHON'
import joulebus
import numpy as np
from sklearn.model_selection import cross_val_score

rows = [trial.rows() for trial in joulebus.simulate(1, steps=2000, progress=False).trials]
features, power_w = (np.concatenate(part) for part in zip(*rows))
scores = cross_val_score(joulebus.Predictor(seed=1, max_epochs=3), features[:, :11], power_w, cv=3)
print(f"R² of three folds: {scores.round(3)}")
assert (scores > 0.5).all()
PYTHON
    step 'cross_val_score of a network, three folds' venv/bin/python score.py
    cat .out
else
    echo 'SKIPPED: tools/walks/python.sh: scikit-learn cannot be installed from PyPI: no cross_val_score' >&2
fi
walk_says 'a yes within the first lines, and a score'
