"""Figures in the layout of `joulebus bench --json`, for the scripts in tools/ (standard library only).

    python3 tools/figures.py FOLDER                       # prints the figures of its *.json as Markdown
    python3 tools/figures.py --compare BEFORE.json AFTER.json    # prints what changed, beyond noise or not

A suite is {schema, machine, build, reports}. A report is {benchmark, input, notes, figures}. A
figure is {name, case, unit, better, count, min, p25, p50, p75, p99, p999, max}.
"""
import json
import math
import os
import pathlib
import platform
import subprocess
import sys

SCHEMA = "joulebus-bench/1"
UNKNOWN = "unknown"


def told(path):
    try:
        return pathlib.Path(path).read_text().strip()
    except OSError:
        return UNKNOWN


def machine():
    """This machine, described as by the Rust side."""
    fields = {}
    for line in told("/proc/cpuinfo").splitlines():
        name, _, value = line.partition(":")
        fields.setdefault(name.strip(), value.strip())
    cpu = "/sys/devices/system/cpu"
    boost, no_turbo = told(f"{cpu}/cpufreq/boost"), told(f"{cpu}/intel_pstate/no_turbo")
    turbo = {"1": "on", "0": "off"}.get(boost) or {"0": "on", "1": "off"}.get(no_turbo) or UNKNOWN
    return {
        "processor": fields.get("model name", UNKNOWN),
        "processors": len(os.sched_getaffinity(0)),
        "kernel": platform.release(),
        "governor": told(f"{cpu}/cpu0/cpufreq/scaling_governor"),
        "turbo": turbo,
        "virtual_machine": "hypervisor" in fields.get("flags", "").split(),
    }


def build(root):
    """What cargo builds with --release here."""
    manifest = (root / "Cargo.toml").read_text()
    version = manifest.split('version = "', 1)[1].split('"', 1)[0]
    iceoryx2 = manifest.split('iceoryx2 = { version = "=', 1)[1].split('"', 1)[0]
    rustc = subprocess.run(["rustc", "--version"], capture_output=True, text=True, cwd=root)
    return {
        "joulebus": version,
        "rustc": rustc.stdout.strip() or UNKNOWN,
        "iceoryx2": iceoryx2,
        "profile": "release",
        "target": f"{platform.machine()}-{platform.system().lower()}",
        "target_features": UNKNOWN,
    }


def figure(name, case, unit, values, better="less"):
    """A figure from its repetitions. Quantiles are nearest ranks."""
    ranked = sorted(values)
    at = lambda share: ranked[max(math.ceil(share * len(ranked)), 1) - 1]
    quantiles = {"min": 0.0, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p99": 0.99, "p999": 0.999, "max": 1.0}
    figure = {"name": name, "case": case, "unit": unit, "better": better, "count": len(ranked)}
    return figure | {quantile: at(share) for quantile, share in quantiles.items()}


def report(benchmark, inputs, figures, notes=()):
    return {
        "benchmark": benchmark,
        "input": {name: str(value) for name, value in inputs.items()},
        "notes": list(notes),
        "figures": figures,
    }


def suite(root, reports):
    return {"schema": SCHEMA, "machine": machine(), "build": build(root), "reports": reports}


def write(path, suite):
    path = pathlib.Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(suite, indent=2) + "\n")


def robots(count):
    return f"{count:,} robot{'' if count == 1 else 's'}"


def shown(value):
    """Four digits."""
    if value == 0:
        return "0"
    decimals = 3 - math.floor(math.log10(abs(value)))
    return f"{value:,.{max(min(decimals, 9), 0)}f}" if abs(value) < 1e4 else f"{value:,.0f}"


def describe(suite):
    machine, build = suite["machine"], suite["build"]
    parts = [machine["processor"], f"{machine['processors']} processors", f"Linux {machine['kernel']}",
             f"governor {machine['governor']}", f"turbo {machine['turbo']}"]
    if machine["virtual_machine"]:
        parts.append("virtual machine")
    return f"{', '.join(parts)}; joulebus {build['joulebus']}, {build['rustc']}, {build['profile']}."


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cell(figure):
    """p50, and p99, p99.9 and max of what was repeated."""
    names = ["p50"] if figure["count"] == 1 else ["p50", "p99", "p999", "max"]
    return " / ".join(shown(figure[name]) for name in names)


def page(*suites):
    """Suites as Markdown: names down, cases across. A machine or build is described where it changes."""
    parts, described = [], None
    for suite, report in ((suite, report) for suite in suites for report in suite["reports"]):
        if describe(suite) != described:
            described = describe(suite)
            parts.append(described)
        told = ", ".join(f"{name} {value}" for name, value in report["input"].items())
        cases = list(dict.fromkeys(figure["case"] for figure in report["figures"]))
        rows = {}
        for figure in report["figures"]:
            name = f"{figure['name'].replace('_', ' ')}, {figure['unit']}"
            rows.setdefault(name, {})[figure["case"]] = cell(figure)
        lines = [[name, *(of.get(case, "–") for case in cases)] for name, of in rows.items()]
        parts += [f"## {report['benchmark']}", f"{told}. Cells: p50 / p99 / p99.9 / max.",
                  table(["figure", *cases], lines), *report["notes"]]
    return "\n\n".join(parts)


def compare(old, new):
    """The figures of both suites: medians, how many times worse, and whether the interquartile ranges are apart."""
    named = lambda suite: {(report["benchmark"], figure["name"], figure["case"], figure["unit"]): figure
                           for report in suite["reports"] for figure in report["figures"]}
    for part in ("machine", "build"):
        for name in old[part].keys() & new[part].keys():
            if old[part][name] != new[part][name]:
                print(f"differs, {part}: {name} {old[part][name]} before, now {new[part][name]}")
    before, now = named(old), named(new)
    if not before.keys() & now.keys():
        sys.exit("nothing in common: measure the same benchmark with the same sizes")
    for key, figure in now.items():
        if key not in before:
            continue
        was = before[key]
        times = figure["p50"] / was["p50"] if figure["better"] == "less" else was["p50"] / figure["p50"]
        apart = figure["p25"] > was["p75"] or was["p25"] > figure["p75"]
        verdict = "" if not apart else "WORSE" if times > 1 else "better"
        print(f"{' '.join(key[:3]):<60} {shown(was['p50']):>10} {shown(figure['p50']):>10} {times:7.3f}× worse  {verdict}")
    for key in before.keys() ^ now.keys():
        print("only", "before:" if key in before else "now:", *key)


def main():
    if sys.argv[1:2] == ["--compare"]:
        return compare(*(json.loads(pathlib.Path(name).read_text()) for name in sys.argv[2:4]))
    print(page(*(json.loads(file.read_text()) for file in sorted(pathlib.Path(sys.argv[1]).glob("*.json")))))


if __name__ == "__main__":
    main()
