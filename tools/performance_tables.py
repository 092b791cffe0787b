#!/usr/bin/env python3
"""Fills the marked blocks of docs/measured/performance.md from the figures in bench-results/.

A block begins with `<!-- figures: NAME -->`, ends with `<!-- end of figures -->`, and is replaced by
the tables of bench-results/NAME.json. A block whose file is missing is unchanged.

    tools/measure.sh                       # measures everything and calls this
    python3 tools/performance_tables.py    # only the tables
"""
import json
import pathlib
import re
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import figures  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
SPREAD = ("p50", "p99", "p999", "max")


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def unique(values):
    return list(dict.fromkeys(values))


def leading(case):
    """The number that a case begins with; cases without one come first."""
    number = re.match(r"[\d,]+", case)
    return int(number[0].replace(",", "")) if number else 0


class Report:
    """The figures of one benchmark, by name and case."""

    def __init__(self, suite, benchmark):
        found = [report for report in suite["reports"] if report["benchmark"] == benchmark]
        if not found:
            sys.exit(f"no {benchmark} among {[report['benchmark'] for report in suite['reports']]}")
        self.report = found[0]
        self.about = figures.describe(suite)
        self.by_name = {}
        for figure in self.report["figures"]:
            self.by_name.setdefault(figure["name"], {})[figure["case"]] = figure

    def names(self, ending):
        return [name for name in self.by_name if name.endswith(ending)]

    def cases(self, names):
        found = unique(case for name in names if name in self.by_name for case in self.by_name[name])
        return sorted(found, key=leading)

    def pivot(self, corner, rows, quantile="p50"):
        """Names down, cases across; `rows` are pairs of name and title."""
        rows = [(name, title) for name, title in rows if name in self.by_name]
        cases = self.cases(name for name, _ in rows)
        cell = lambda name, case: figures.shown(figure[quantile]) if (figure := self.by_name[name].get(case)) else "–"
        body = [[title, *(cell(name, case) for case in cases)] for name, title in rows]
        return table([corner, *cases], body)

    def spread(self, corner, rows):
        """As `pivot`, each cell p50 / p99 / p99.9 / max."""
        rows = [(name, title) for name, title in rows if name in self.by_name]
        cases = self.cases(name for name, _ in rows)

        def cell(name, case):
            figure = self.by_name[name].get(case)
            if figure is None:
                return "–"
            if figure["count"] == 1:
                return figures.shown(figure["p50"])
            return " / ".join(figures.shown(figure[quantile]) for quantile in SPREAD)

        body = [[title, *(cell(name, case) for case in cases)] for name, title in rows]
        return table([corner, *cases], body)

    def head(self):
        told = "; ".join(f"{name} {value}" for name, value in self.report["input"].items())
        return f"{self.about} {told}."


def kernel(suite):
    report = Report(suite, "kernel")
    kernels = [name.removesuffix("_ns_per_robot") for name in report.names("_ns_per_robot") if "_pinned_" not in name]
    fast = report.report["input"].get("dispatched", kernels[-1])
    peaks = ", ".join(
        f"{name.removesuffix('_peak_gmac_per_s')} {figures.shown(next(iter(report.by_name[name].values()))['p50'])}"
        for name in report.names("_peak_gmac_per_s"))
    pinned = [name for name in report.by_name if "_pinned_" in name]
    parts = [
        report.head(),
        f"Peak of fused multiply-adds in the same run, 10⁹/s: {peaks}.",
        report.pivot("ns a robot, p50", [(f"{name}_ns_per_robot", name) for name in kernels]),
        report.pivot("share of the peak", [(f"{name}_share_of_peak", name) for name in kernels]),
        report.spread("p50 / p99 / p99.9 / max, ns a robot", [(f"{fast}_ns_per_robot", fast)]),
    ]
    if pinned:
        parts.append(report.pivot("pinned threads", [(name, name.replace("_", " ")) for name in pinned]))
    return "\n\n".join(parts)


def tick(suite):
    report = Report(suite, "tick")
    titled = lambda names: [(name, title) for name, title in names]
    parts = [
        report.head(),
        report.pivot("ns a robot, p50", titled([
            ("tick_ns_per_robot", "whole tick"), ("take_ns_per_robot", "samples taken"),
            ("forecast_ns_per_robot", "forecast"), ("account_ns_per_robot", "account"),
            ("kernel_ns_per_robot", "bare kernel"), ("features_ns_per_robot", "stage: features"),
            ("network_ns_per_robot", "stage: network"), ("bookkeeping_ns_per_robot", "stage: bookkeeping"),
            ("writing_ns_per_robot", "stage: writing"),
        ])),
        report.pivot("over the bare kernel", titled([
            ("tick_over_kernel", "whole tick"), ("forecast_over_kernel", "forecast"),
            ("take_and_forecast_over_kernel", "taken and forecast"),
            ("account_share_of_tick", "share of account in the tick"),
        ])),
    ]
    words = lambda name: (name, name.replace("_", " "))
    paced = [name for name in report.by_name if name.startswith("paced_") and "missed" not in name]
    counts = [name for name in report.by_name if "missed" in name or "bytes" in name]
    threads = [name for name in report.by_name if "_threads_" in name and not name.startswith("paced_")]
    parts.append(report.spread("paced: p50 / p99 / p99.9 / max", [words(name) for name in paced]))
    parts.append(report.pivot("", [words(name) for name in counts]))
    if threads:
        parts.append(report.pivot("threads", [words(name) for name in threads]))
    return "\n\n".join(parts)


def rollout(suite):
    report = Report(suite, "rollout")
    cases = report.cases(["rollout_us"])
    rows = []
    for case in cases:
        time, step, over = (report.by_name[name][case] for name in ("rollout_us", "ns_per_step", "step_over_kernel"))
        spread = " / ".join(figures.shown(time[quantile] / 1e3) for quantile in SPREAD)
        rows.append([case, spread, figures.shown(step["p50"]), figures.shown(over["p50"])])
    parts = [
        report.head(),
        table(["candidates", "ms a call: p50 / p99 / p99.9 / max", "ns a step", "over the bare kernel"], rows),
    ]
    pinned = [name for name in report.by_name if name.startswith("pinned_")]
    if pinned:
        parts.append(report.pivot("pinned threads", [(name, name.replace("_", " ")) for name in pinned]))
    return "\n\n".join(parts)


def peers(suite):
    report = Report(suite, "peers")
    ending = "_ns_per_robot"
    title = lambda name: name.removesuffix(ending).replace("_2_threads", ", 2 threads")
    version = lambda peer: f"{peer} {report.report['input'].get(peer, '')}".strip()
    one = [name for name in report.names(ending) if "_threads" not in name]
    two = [name for name in report.names(ending) if "_threads" in name]
    big = report.cases(one)[-1] if one else None
    order = lambda name: report.by_name[name].get(big, {"p50": float("inf")})["p50"]
    error = lambda name: report.by_name.get(name.removesuffix(ending) + "_largest_error_w", {})

    def row(name):
        cells = [version(title(name))]
        for case in report.cases(one):
            figure = report.by_name[name].get(case)
            cells.append(figures.shown(figure["p50"]) if figure else "–")
        found = next(iter(error(name).values()), None)
        return [*cells, f"{found['p50']:.1e}" if found else "–"]

    ratios = []
    for case in report.cases(one):
        mine = report.by_name[f"joulebus{ending}"].get(case)
        others = [(figure["p50"], title(name)) for name in one if not name.startswith("joulebus")
                  if (figure := report.by_name[name].get(case))]
        best = min(others) if others and mine else None
        ratios.append(f"{best[0] / mine['p50']:.2f} ({best[1]})" if best else "–")
    rows = [row(name) for name in sorted(one, key=order)]
    rows.append(["*best peer over joulebus*", *ratios, ""])
    told = {name: value for name, value in report.report["input"].items() if name in ("model", "seed", "seconds", "rounds")}
    parts = [
        f"{report.about} {'; '.join(f'{name} {value}' for name, value in told.items())}.",
        table(["ns a robot, p50, one thread", *report.cases(one), "largest error, W"], rows),
    ]
    if two:
        parts.append(report.pivot("ns a robot, p50, two threads", [(name, title(name)) for name in sorted(two, key=order)]))
    parts.append("![ns a robot by batch, one thread](peers.svg)")
    return "\n\n".join(parts)


def instructions(suite):
    report = Report(suite, "instructions")
    return "\n\n".join([report.head(), report.pivot("instructions", [(name, name.replace("_", " ")) for name in report.by_name])])


def spreads(suite):
    """Every figure of every report, p50 / p99 / p99.9 / max."""
    parts = [figures.describe(suite)]
    for named in suite["reports"]:
        report = Report(suite, named["benchmark"])
        told = "; ".join(f"{name} {value}" for name, value in named["input"].items())
        rows = [(name, name.replace("_", " ")) for name in report.by_name]
        parts += [f"{named['benchmark']}: {told}.", report.spread("p50 / p99 / p99.9 / max", rows)]
    return "\n\n".join(parts)


RENDER = {
    "kernel": kernel, "tick": tick, "rollout": rollout, "peers": peers, "instructions": instructions,
    "plan": spreads, "latency": spreads, "transport": spreads,
}


def main():
    page = ROOT / "docs/measured/performance.md"
    results = ROOT / "bench-results"

    def fill(match):
        begin, name, end = match.groups()
        file = results / f"{name}.json"
        if name not in RENDER:
            sys.exit(f"{page}: no figures are called {name!r}; there are {', '.join(RENDER)}")
        if not file.exists():
            print(f"{name}: unchanged, {file} is missing", file=sys.stderr)
            return match.group(0)
        return begin + RENDER[name](json.loads(file.read_text())) + "\n" + end

    page.write_text(BLOCK.sub(fill, page.read_text()))


if __name__ == "__main__":
    main()
