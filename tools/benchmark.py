#!/usr/bin/env python3
"""Energy forecasting over open robot recordings: fixed splits, one table.

    python3 tools/benchmark.py                         # all tasks, from ../shared/data; fills docs/measured/benchmark.csv
    python3 tools/benchmark.py DATA --tasks husky/ICE  # some tasks; nothing is filled
    python3 tools/benchmark.py --list DIR              # writes which recordings each task holds out, DIR/TASK.csv
    python3 tools/benchmark.py --forecasts mine=DIR    # and DIR/TASK.csv of another program: docs/measured/benchmark.md

It fetches no data. LightGBM comes from PyPI, pinned, into target/boosting. A task trains joulebus' network
and LightGBM on the recordings that are not held out, and scores both and the baselines on the same rows.
"""
import csv
import json
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from pinned_environment import python_of  # noqa: E402
from recorded_models import DATA, ROOT, arguments, program  # noqa: E402

PACKAGES = ["lightgbm==4.7.0", "numpy==2.4.6", "scipy==1.17.1"]
SURFACE = "one_surface_type_{}_surface_exp"
LOAD = "wheel_load_distribution_gray_surface_exp"
# What is left out. None: 15 % of the recordings, dealt out with seed 0. The wheel load was recorded
# on gray.
TASKS = {
    "robotino/trial": None,
    **{f"robotino/{floor}": [SURFACE.format(floor)] for floor in ("brown", "green", "table")},
    "robotino/gray": [SURFACE.format("gray"), LOAD],
    "robotino/wheel-load": [LOAD],
    "husky/trial": None,
    **{f"husky/{ground}": [ground] for ground in ("ASPHALT", "FLOORING", "ICE", "MIXED", "SANDY_LOAM", "SNOW")},
    "rover/trial": None,
    "rover/before": ["baseline_on_track"],
    "rover/after": ["final_intervention_on_track"],
}
NAMES = ["task", "forecaster", "rows", "r2", "r2_lo", "r2_hi", "mae_w", "skill", "skill_lo", "skill_hi", "energy_bias",
         "coverage", "interval_score_w", "interval_score_lo_w", "interval_score_hi_w", "constant_interval_score_w",
         "weighted_interval_score_w"]


def report(*command):
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    return json.loads(done.stdout)


def held_out(robot, left_out, folder, trained):
    """The held-out recordings of a task."""
    if left_out is None:
        return {pathlib.Path(name).name for name in trained["split"]["held_out"]}
    group = lambda path: path.name.split(".")[0].rstrip("0123456789").rstrip("_- ")
    return {path.name for path in folder.glob("*.csv.gz") if group(path) in left_out}


def run_task(task, given, lab, boosting, place):
    robot, left_out = task.split("/")[0], TASKS[task]
    folder, model = given.data / DATA[robot][0], place / "model.safetensors"
    leave_out = [] if left_out is None else ["--leave-out", ",".join(left_out)]
    recipe = ["--recipe", ROOT / f"configs/recipes/{robot}.toml"]
    trained = report(lab, "--format", "json", "train", "trials", folder, *recipe, *leave_out, "--out", model)
    out = held_out(robot, left_out, folder, trained)
    if given.list:
        with open(given.list / f"{task.replace('/', '-')}.csv", "w") as file:
            file.writelines(["recording\n", *(f"{name}\n" for name in sorted(out))])
        return []
    files = {path.name: path for path in sorted(folder.glob("*.csv.gz"))}
    learned = [str(path) for name, path in files.items() if name not in out]
    made = place / "lightgbm.csv"
    subprocess.run([boosting, ROOT / "tools/boosting.py", made], check=True, text=True,
                   input=json.dumps([learned, [str(files[name]) for name in sorted(out)]]))
    forecasts = [f"LightGBM={made}", *(f"{name}={folder}/{task.replace('/', '-')}.csv" for name, folder in given.forecasts)]
    asked = ["--split", "trial"] if left_out is None else leave_out
    scored = report(lab, "--format", "json", "eval", folder, "--model", model, *asked,
                    *(word for named in forecasts for word in ("--forecasts", named)))
    cell = scored["evaluations"][0]["all"]
    rows = []
    for one in cell["forecasters"]:
        against = [skill for skill in one["skill"] if skill["against"] == "persistence"]
        skill, interval = (against or [{}])[0], one["interval"] or {}
        score, name = interval.get("score", {}), one["name"]
        name = name.replace("model (", "joulebus (").replace(f"{robot} (", "joulebus (")
        rows.append([task, name, one["count"], one["r2"]["value"], one["r2"]["lo"], one["r2"]["hi"], one["mae_w"]["value"],
                     skill.get("value"), skill.get("lo"), skill.get("hi"), one["energy_error"]["value"],
                     interval.get("coverage"), score.get("value"), score.get("lo"), score.get("hi"),
                     one["hindsight"]["score_w"], interval.get("wis_w")])
        print(f"{task}: {name}: R² {one['r2']['value'] or float('nan'):.4f}", file=sys.stderr)
    return rows


def main():
    parser = arguments(__doc__)
    named = lambda text: tuple(text.split("=", 1))
    parser.add_argument("--tasks", help="with commas between them")
    parser.add_argument("--list", type=pathlib.Path, metavar="DIR")
    parser.add_argument("--forecasts", type=named, action="append", default=[], metavar="NAME=DIR")
    given = parser.parse_args()
    tasks = given.tasks.split(",") if given.tasks else list(TASKS)
    lab = program(given.program)
    boosting = None if given.list else python_of(ROOT / "target/boosting", PACKAGES)
    out = csv.writer(sys.stdout)
    table = [NAMES]
    for task in tasks:
        with tempfile.TemporaryDirectory() as place:
            table += run_task(task, given, lab, boosting, pathlib.Path(place))
    if given.list:
        return
    digits = lambda value: f"{value:.4g}" if isinstance(value, float) else value
    table = [[digits(value) for value in row] for row in table]
    out.writerows(table)
    if not given.tasks and not given.forecasts:
        with open(ROOT / "docs/measured/benchmark.csv", "w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()
