#!/usr/bin/env python3
"""Fills figures into the pages of docs/, and finds figures that nobody fills in.

    tools/page_figures.py --check    # the gate: pages agree with docs/figures, and have no new bare figures
    tools/page_figures.py --write    # fills the pages, and lowers the baseline of bare figures
    tools/page_figures.py --bare docs/measured/links.md    # the bare figures of a page
    tools/page_figures.py --names [tick]    # the names of figures, and their values

tools/figures.sh measures, and writes docs/figures/NAME.json in the layout of `joulebus bench --json`,
with commit and date. All files are of one commit and one machine (tools/gate_cost.py: of another). A page includes

    <!-- figures: kernel -->                    the tables of a file, up to <!-- end of figures -->
    <!-- figure: tick.tick_over_kernel[1,000 robots].p99 -->2.07<!-- /figure -->
    <!-- figure: benchmark.coverage[*, LightGBM].min:.1% -->65.6 %<!-- /figure -->

The second has a file, a figure's name, its case, a quantile (p50 if none is named) and a format of Python. With `*`
min and max are those of all cases. `benchmark` is docs/measured/benchmark.csv: a column, [task, forecaster].
`models` is what the files in configs/models state. docs/figures/campaigns/NAME.json has what was measured once,
with date, command and the rows of its table: {date, command, machine, corner, columns: {name: {title, format}}, rows}.
What a missing file would have stays as it is. A bare figure is a number with a unit in a sentence or
a table that is in neither marker. Code, the journal and generated pages have none, nor has
a paragraph, an item of a list or a row of a table with `<!-- definition -->`. docs/figures/bare.tsv has their number
in each page, which may only shrink.
The check also looks for the tests that RELIABILITY.md and docs/measured name in a column `test`, for
those that a command `cargo test` of any page names, and for what pins the versions of peers.
Standard library only.
"""
import argparse
import csv
import datetime
import fnmatch
import json
import pathlib
import re
import struct
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import figures  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent
FIGURES = ROOT / "docs/figures"
CAMPAIGNS = FIGURES / "campaigns"
MODELS = ROOT / "configs/models"
BASELINE = FIGURES / "bare.tsv"
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
BENCHMARK = ROOT / "docs/measured/benchmark.csv"
INLINE = re.compile(r"(<!-- figure: (\w+)\.(\w+)(?:\[([^\]]*)\])?(?:\.(\w+))?(?::([\w.,%]+))? -->).*?(<!-- /figure -->)")
BENCHMARK_BLOCK = re.compile(r"(<!-- benchmark: (\w+) -->\n).*?(<!-- end of benchmark -->)", re.DOTALL)
SPREAD = ("p50", "p99", "p999", "max")


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def unique(values):
    return list(dict.fromkeys(values))


def leading(case):
    """The number that a case begins with. Cases without one come first."""
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
        """Names down, cases across. `rows` are pairs of name and title."""
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


def gate(suite):
    report = Report(suite, "gate")
    its = lambda name, case: (f"{figure['p50']:.{0 if figure['unit'] == 's' else 1}f}"
                              if (figure := report.by_name.get(name, {}).get(case)) else "–")
    columns = {"processors": "processors, min", "wall": "wall time, min", "target": "`target`, GB"}
    steps = {"step_cold": "empty clone, s", "step_warm": "after the change, s"}
    known = unique(case for name in columns for case in report.by_name.get(name, {}))
    named = unique(case for name in steps for case in report.by_name.get(name, {}))
    return "\n\n".join([report.about, table(["command", *columns.values()], [[case, *(its(name, case) for name in columns)] for case in known]),
                        table(["step of the gate", *steps.values()], [[case, *(its(name, case) for name in steps)] for case in named])])


def spreads(suite):
    """Every figure of every report, p50 / p99 / p99.9 / max."""
    parts = [figures.describe(suite)]
    for named in suite["reports"]:
        report = Report(suite, named["benchmark"])
        told = "; ".join(f"{name} {value}" for name, value in named["input"].items())
        rows = [(name, name.replace("_", " ")) for name in report.by_name]
        parts += [f"{named['benchmark']}: {told}.", report.spread("p50 / p99 / p99.9 / max", rows)]
    return "\n\n".join(parts)


def shown_cell(value, form):
    if value is None:
        return "–"
    return value if isinstance(value, str) else format(value, form).replace("%", " %").replace("-", "−")


def campaign(suite):
    """The table of docs/figures/campaigns/NAME.json."""
    columns = suite["columns"].values()
    body = [[case, *(shown_cell(value, column.get("format", "")) for value, column in zip(values, columns, strict=True))]
            for case, values in suite["rows"].items()]
    return table([suite["corner"], *(column["title"] for column in columns)], body)


def expanded(suite):
    """A campaign with the figures of its rows, as other files have them."""
    found = [{"name": name, "case": case, "unit": "", "format": column.get("format", ""), "p50": value}
             for case, values in suite.get("rows", {}).items()
             for (name, column), value in zip(suite["columns"].items(), values) if not isinstance(value, str)]
    return suite | {"reports": [{"figures": found}]}


FAULTS = {"none": "none", "extra_load": "extra load +{:.0%}", "drift": "drift +{:.0%}/min", "gain": "gain +{:.0%}",
          "stuck_sensor": "stuck sensor", "dropout": "dropout"}


def alarms(suite):
    """Limits and delays of `joulebus calibrate --format json`."""
    def cell(delay):
        times = [delay["median_s"], delay["q90_s"]]
        return ", ".join([f"{delay['found']:.0%}", *(["–" if time is None else f"{time:.1f}" for time in times] if times != [None, None] else [])])

    detectors, limits = ("calibrated", "textbook", "power", "voltage"), suite["thresholds"]
    head = ["calibrated", f"textbook, {suite['textbook_per_robot_h']:.0f} false alarms an hour",
            *(name + (f", false in {false:.0%}" if (false := limits[f"{name}_false"]) else "") for name in detectors[2:])]
    rows = [[FAULTS[delays["fault"]].format(delays.get("share")), *(cell(delays[name]) for name in detectors)] for delays in suite["delays"]]
    chosen = [[f"`{limit['key']}`", f"{limit['before']:g}", f"{limit['value']:g}"] for limit in suite["limits"]]
    return "\n\n".join([table(["limit", "default then", "calibrated"], chosen), table(["fault", *head], rows).replace("%", " %")])


def campaigns():
    return {file.stem: expanded(json.loads(file.read_text())) for file in sorted(CAMPAIGNS.glob("*.json"))}


def unfinished_campaigns():
    """Campaigns that do not say when and how they were measured, or that no page includes."""
    texts = [page.read_text() for page in pages().values()]
    problems = []
    for name, suite in campaigns().items():
        file = f"{(CAMPAIGNS / name).relative_to(ROOT)}.json"
        problems += [f"{file}: no {key}" for key in ("date", "command") if not suite.get(key)]
        including = [text for text in texts if f"<!-- figures: {name} -->" in text or f"<!-- figure: {name}." in text]
        if not including:
            problems.append(f"{file}: no page includes it, so remove it")
        elif not any(" ".join(suite.get("command", "").split()) in " ".join(text.split()) for text in including):
            problems.append(f"{file}: no page that includes it has its command")
    return problems


def unwritten_blocks():
    """Blocks of pages that nothing writes."""
    written = {*RENDER, *WRITERS, *campaigns(), "worth"}
    return [f"{name}: nothing writes the block {match[2]}: docs/figures/campaigns/{match[2]}.json is missing"
            for name, page in pages().items() for match in BLOCK.finditer(page.read_text()) if match[2] not in written]


def model_file(file):
    """The metadata of a model's file."""
    with open(file, "rb") as opened:
        (length,) = struct.unpack("<Q", opened.read(8))
        return json.loads(opened.read(length))["__metadata__"]


def models():
    """What the files of the models that ship state."""
    found, cards = [], {}
    for file in sorted(MODELS.glob("*.safetensors"), key=lambda file: file.stem):
        card = cards[file.stem] = model_file(file)
        rate = re.search(r"([\d.]+) Hz", card["training_data"])
        powers = [place for place, name in enumerate(card["features"].split(",")) if name.startswith("power_lag")]
        bound = lambda key, pick: pick(float(card[key].split(",")[place]) for place in powers)
        its = {
            "period_ms": 1e3 * float(card["step_s"]) if "step_s" in card else 1e3 / float(rate[1]),
            "lowest_w": bound("feature_min", min), "highest_w": bound("feature_max", max),
            "network_mae_mw": 1e3 * float(card["score_network_mae_w"]), "network_r2": float(card["score_network_r2"]),
            "persistence_mae_mw": 1e3 * float(card["score_persistence_mae_w"]), "persistence_r2": float(card["score_persistence_r2"]),
            "rows": int(card["score_rows"]),
        }
        found += [{"name": name, "case": file.stem, "unit": "", "p50": value} for name, value in its.items()]
    return {"reports": [{"figures": found}], "cards": cards}


INPUTS = {
    "full": "velocities, five readings", "power_only": "five readings",
    "freshness": "velocities, five readings, the age of the reading",
}


def shipped(suite):
    """The models that ship: docs/reference/models.md."""
    of = {(figure["name"], figure["case"]): figure["p50"] for figure in suite["reports"][0]["figures"]}
    watts = lambda power: f"{power:,.{0 if power == 0 or power >= 1000 else 1}f}"
    rows = []
    for name, card in suite["cards"].items():
        robot, *_, licence = card["source"].split(", ") if ", " in card["source"] else ("simulated GTernal", "")
        data = f"simulation, seed {card['seed']}" if not licence else f"{card['training_data'].split()[0]} recordings, {licence}"
        rows.append([f"`builtin:{name}`", robot, f"{round(of['period_ms', name], 2):g} ms", data,
                      f"{watts(of['lowest_w', name])} to {watts(of['highest_w', name])} W", INPUTS[card["feature_set"]]])
    return table(["model", "robot", "period", "trained on", "range of power in the training", "inputs"], rows)


RENDER = {
    "models": shipped, "alarms": alarms,
    "kernel": kernel, "tick": tick, "rollout": rollout, "peers": peers, "instructions": instructions,
    "plan": spreads, "questions": spreads, "learning": tick, "latency": spreads, "transport": spreads,
    "gate": gate,
}

# Blocks whose rows another program writes into the page, or a test compares with it.
ENERGY, FORECASTS = "tools/energy_tables.py", "tools/forecast_tables.py"
WRITERS = {
    "energy_halves": ENERGY, "energy_groups": ENERGY, "outlooks": ENERGY, "verdicts": ENERGY, "starts": ENERGY,
    "forecasts": FORECASTS, "online_learning": FORECASTS,
    "freshness": "joulebus-eval --example freshness", "mission": "joulebus mission",
    "plant": "every_figure_of_the_paper_is_within_its_band_on_average_and_in_the_docs",
}


# What is no sentence: blocks and figures that are filled in, code, comments, targets of links.
FILLED = [
    re.compile(r"<!-- (figures|benchmark)\b[^>]*-->.*?<!-- end\b[^>]*-->", re.DOTALL),
    re.compile(r"<!-- (cards|doors|keys)\b[^>]*-->.*?<!-- \1\b[^>]*-->", re.DOTALL),
    re.compile(r"^ *```.*?^ *```", re.DOTALL | re.MULTILINE),
    re.compile(r"<!-- figure: .*?<!-- /figure -->"),
    re.compile(r"<!--.*?-->", re.DOTALL),
    re.compile(r"`[^`]*`"),
    re.compile(r"\]\([^)]*\)"),
]
# Pages that a program writes whole, and the journal, whose figures have dates.
EXEMPT = re.compile(r"docs/measured/journal|docs/(.*/)?layout\.md$")
UNITS = ("ns|µs|us|ms|s|min|minutes|hours|days|seconds|h|bytes|kB|MB|GB|TB|KiB|MiB|GiB|W|mW|kW|J|kJ|MJ|µJ|Wh|kWh|V|A|"
         "%|×|ppm|Hz|kHz|MHz|[kMG]?bit/s|[kMG]?B/s|m/s|rad/s|m|km|rad|instructions")
BARE = re.compile(rf"(?<![\w.,])(?:\d[\d,]*)?\.?\d+ ?(?:{UNITS})(?![\w/])")


def pages():
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {str(page.relative_to(ROOT)): page for page in found}


def without_definitions(text):
    """The text, with lines emptied of paragraphs, items of lists and rows of tables that define something."""
    parts = [[]]
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith(("|", "- ", "#")):
            parts.append([])
        parts[-1].append(line)
    return "\n".join("" if "<!-- definition -->" in "".join(part) else line for part in parts for line in part)


def bare(text):
    """The bare figures of a page, each with the number of its line."""
    text = without_definitions(text)
    for pattern in FILLED:
        # Lines keep their numbers.
        text = pattern.sub(lambda match: "\n" * match[0].count("\n"), text)
    return [(number, match[0]) for number, line in enumerate(text.splitlines(), 1) for match in BARE.finditer(line)]


def all_bare():
    texts = {name: page.read_text() for name, page in pages().items() if not EXEMPT.match(name)}
    found = {name: bare(text) for name, text in texts.items() if "<!-- generated" not in text[:400]}
    return {name: figures for name, figures in found.items() if figures}


def baseline():
    if not BASELINE.exists():
        return None
    rows = (line.split("\t") for line in BASELINE.read_text().splitlines())
    return {page: int(count) for count, page in rows}


def suites(folder):
    return {file.stem: json.loads(file.read_text()) for file in sorted(folder.glob("*.json"))}


def known_suites(folder):
    """The files of one run, the campaigns, and what the models' files state."""
    measured, once = suites(folder), campaigns()
    if twice := sorted(measured.keys() & (once.keys() | {"models"})):
        sys.exit(f"{CAMPAIGNS.relative_to(ROOT)}: {', '.join(twice)} is in {folder.name} too, so rename it")
    return measured | once | {"models": models()}


def benchmark():
    """docs/measured/benchmark.csv by column and [task, forecaster]."""
    with open(BENCHMARK) as file:
        return {(column, f"{row['task']}, {row['forecaster']}"): float(text) for row in csv.DictReader(file)
                for column, text in row.items() if column not in ("task", "forecaster") and text}


def value(suites, file, name, case, quantile, shown):
    """The text of one figure, or `None`."""
    quantile = quantile or "p50"
    if file == "benchmark":
        of = {key: {quantile: number} for key, number in benchmark().items()}
    else:
        reports = suites.get(file, {"reports": []})["reports"]
        of = {(figure["name"], figure["case"]): figure for report in reports for figure in report["figures"]}
    found = [figure for (known, its), figure in of.items() if known == name and (case is None or its == case or fnmatch.fnmatchcase(its, case))]
    shown = next((figure["format"] for figure in found if "format" in figure), None) if shown is None else shown
    found = [number for figure in found if isinstance(number := figure.get(quantile), (int, float))]
    if len(found) > 1 and quantile in ("min", "max"):
        found = [min(found) if quantile == "min" else max(found)]
    if len(found) != 1:
        return None
    text = figures.shown(found[0]) if shown is None else format(found[0], shown)
    return text.replace("%", " %").replace("-", "−")


def benchmark_table(what):
    """A table of docs/measured/benchmark.md, or that of docs/reference/models.md."""
    if what == "models":
        return shipped_scores()
    with open(BENCHMARK) as file:
        rows = list(csv.DictReader(file))
    tasks, forecasters = unique(row["task"] for row in rows), unique(row["forecaster"] for row in rows)
    of = {(row["task"], row["forecaster"]): row for row in rows}
    number = lambda value, digits: f"{float(value):.{digits}f}" if value else "–"
    leading = ["joulebus (online)", "LightGBM"]
    names, cell = {
        "r2": (forecasters, lambda row: number(row["r2"], 3)),
        "skill": (leading, lambda row: f"{number(row['skill'], 3)} [{number(row['skill_lo'], 2)}, {number(row['skill_hi'], 2)}]"),
        "interval": ([*leading, "persistence", "AR(5)"], lambda row: " · ".join([
            number(row["interval_score_w"] or row["constant_interval_score_w"], 2),
            number(row["coverage"] and 100 * float(row["coverage"]), 1)])),
        "bias": ([*leading, "persistence", "mean so far"], lambda row: number(100 * float(row["energy_bias"] or "nan"), 2)),
    }[what]
    body = [[task, *(cell(of[task, name]) if (task, name) in of else "–" for name in names)] for task in tasks]
    return table(["task", *names], body)


def shipped_scores():
    """Scores of the models of real robots on the trials that they hold out: docs/reference/models.md."""
    of = benchmark()
    number = lambda value, form=".3f": format(value, form).replace("-", "−").replace("%", " %")
    bounded, names = ["joulebus (online)", "joulebus (network)", "persistence"], ["AR(5)", "ridge, AR(5) + velocities", "mean so far"]
    bounds = lambda column, case: f"{number(of[column, case])} [{number(of[f'{column}_lo', case])}, {number(of[f'{column}_hi', case])}]"
    rows = []
    for robot in ("robotino", "husky", "rover"):
        case = lambda name: f"{robot}/trial, {name}"
        online = case("joulebus (online)")
        beside = 1 - (1 - of["r2", online]) / (1 - of["r2", case("AR(5)")])
        rows.append([robot, f"{of['rows', online]:,.0f}", *(bounds("r2", case(name)) for name in bounded), *(number(of["r2", case(name)]) for name in names),
                     bounds("skill", online), number(beside), number(of["coverage", online], ".1%"), number(of["energy_bias", online], ".1%")])
    return table(["model", "rows", "R² online", "network", "persistence", "AR(5)", "ridge, AR(5) + velocities", "mean so far",
                  "skill of online against persistence", "against AR(5)", "coverage of the 90 % interval", "energy"], rows)


def worth():
    """R² of the benchmark's tasks, and what intervals and energies are worth: docs/explanation/where-to-use-it.md."""
    of = benchmark()
    names = ["joulebus (online)", "LightGBM", "joulebus (network)", "AR(5)", "persistence"]
    groups = {
        "known floors: Robotino · Husky · rover": ["robotino/trial", "husky/trial", "rover/trial"],
        "Robotino on brown · table": ["robotino/brown", "robotino/table"],
        "Husky on ice · sandy loam · snow": ["husky/ICE", "husky/SANDY_LOAM", "husky/SNOW"],
        "rover before · after its change": ["rover/before", "rover/after"],
    }
    tasks = list(dict.fromkeys(case.split(", ", 1)[0] for _, case in of))
    shifts = [task for task in tasks if not task.endswith("/trial")]
    r2 = lambda task, name: of["r2", f"{task}, {name}"]
    number = lambda value, shown=".3f": format(value, shown).replace("-", "−")
    rows = [[title, *(" · ".join(number(r2(task, name)) for task in its) for name in names)] for title, its in groups.items()]
    below = [str(sum(r2(task, name) < r2(task, "persistence") for task in shifts)) for name in names[:-1]]
    rows.append([f"below the last reading, of the {len(shifts)}", *below, "–"])

    def spread(column, name):
        found = [100 * of[column, f"{task}, {name}"] for task in tasks if (column, f"{task}, {name}") in of]
        return f"{number(min(found), '.1f')} to {number(max(found), '.1f')} %" if found else "–"

    rows.append([f"readings in the 90 % interval, lowest and highest of all {len(tasks)} tasks",
                 *(spread("coverage", name) for name in names)])
    rows.append([f"bias of the energy, of all {len(tasks)} tasks", *(spread("energy_bias", name) for name in names)])
    return table(["", "joulebus, online", "LightGBM", "network alone", "AR(5)", "last reading"], rows)


def filled(name, text, suites, absent, problems):
    """The page with its tables and figures as the files have them."""
    def block(match):
        begin, file, end = match.groups()
        if file == "worth":
            return f"{begin}{worth()}\n{end}"
        render = RENDER.get(file, campaign if "rows" in suites.get(file, {}) else None)
        if file not in suites or render is None:
            return match[0]
        return f"{begin}{date(suites[file])}{render(suites[file])}\n{end}"

    def inline(match):
        begin, *figure, end = match.groups()
        if figure[0] not in ("benchmark", *suites):
            absent.add(figure[0])
            return match[0]
        shown = value(suites, *figure)
        if shown is None:
            problems.append(f"{name}: docs/figures has not one figure {begin[12:-4].strip()} (--names lists them)")
            return match[0]
        return f"{begin}{shown}{end}"

    text = BENCHMARK_BLOCK.sub(lambda match: f"{match[1]}{benchmark_table(match[2])}\n{match[3]}", text)
    return INLINE.sub(inline, BLOCK.sub(block, text))


def date(suite):
    """Day and commit of a file's run, or day and machine of a campaign."""
    if "command" in suite:
        day = datetime.date.fromisoformat(suite["date"])
        return f"Measured on {day.day} {day:%B %Y}{', ' + suite['machine'] if 'machine' in suite else ''}.\n\n"
    return f"{suite['date']}, commit {suite['commit'][:8]}. " if "commit" in suite else ""


def of_one_run(suites):
    """Problems of files that are not of one commit and one machine. The gate's is of another one: it measures all files."""
    of = {name: (suite.get("commit"), suite.get("date"), suite["machine"]["processor"], suite["build"]["profile"])
          for name, suite in suites.items() if name != "gate"}
    problems = [f"docs/figures/{name}.json: commit or date is missing: let tools/figures.sh write it"
                for name, (commit, day, *_) in of.items() if not commit or not day]
    problems += [f"docs/figures/{name}.json: a {profile} build" for name, (*_, profile) in of.items() if profile.partition(",")[0] != "release"]
    if len(runs := {(commit, processor) for commit, _, processor, _ in of.values()}) > 1:
        problems.append(f"docs/figures: of {len(runs)} commits or machines: {', '.join(map(str, runs))}")
    return problems


def packages():
    """The folder of each package, without `joulebus-`."""
    found = {}
    for manifest in ROOT.glob("**/Cargo.toml"):
        path = manifest.relative_to(ROOT).parts
        if "target" not in path and (name := re.search(r'^name = "(?:joulebus-)?([\w-]+)"', manifest.read_text(), re.MULTILINE)):
            found.setdefault(name[1], manifest.parent)
    return found


def sources(folder, target):
    """The sources of a package's target."""
    if target in ("lib", "bin"):
        return list((folder / "src").rglob("*.rs"))
    tests = folder / "tests"
    return [file for file in [tests / f"{target}.rs", *(tests / target).rglob("*.rs")] if file.exists()]


def is_test(folders, text):
    """Whether there is what a table's cell names: [PACKAGE/TARGET ]NAME, or a script with pytest's -k."""
    if text.startswith("tools/"):
        script, _, name = text.partition(" -k ")
        tests = [path.name + path.read_text() for path in ROOT.glob("crates/languages/python/tests/test_*.py")]
        return (ROOT / script.split()[0]).exists() and any(name in test for test in tests)
    target, _, name = text.rpartition(" ") if " " in text else (text, "", "") if "/" in text else ("tests/system", "", text)
    package, _, target = target.partition("/")
    files = sources(folders[package], target) if package in folders else []
    last = re.escape(name.split("::")[-1])
    in_text = re.compile(rf"\bfn \w*{last}|\bmod \w*{last}")
    return any(not name or name in str(file.relative_to(ROOT)) or in_text.search(file.read_text()) for file in files)


def missing_tests():
    """Tests that a column `test` names, and that do not exist."""
    folders, problems, column = packages(), [], None
    named = [ROOT / "RELIABILITY.md", *sorted((ROOT / "docs/measured").rglob("*.md"))]
    for page in named:
        for number, line in enumerate(page.read_text().splitlines(), 1):
            cells = [cell.strip() for cell in line.strip().strip("|").split(" |")] if line.startswith("|") else []
            if not cells:
                column = None
            elif column is None:
                column = cells.index("test") if "test" in cells else -1
            elif 0 <= column < len(cells):
                tests = [text for text in re.findall(r"`([^`]+)`", cells[column]) if not text.startswith(("cargo ", "JOULEBUS_"))]
                problems += [f"{page.relative_to(ROOT)}:{number}: no test {text}" for text in tests if not is_test(folders, text)]
    return problems


# Options of `cargo test` with a value.
VALUED = {"-p": "package", "--package": "package", "--test": "target", "--bin": "bin", "--profile": None, "--exclude": None, "--features": None}


def commands(text):
    """The arguments of each `cargo test` of a page: in a block to the end of the line, else to the end of the inline code."""
    blocks = re.findall(r"^ *```.*?^ *```", text, re.DOTALL | re.MULTILINE)
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line.split(" #")[0] for block in blocks for line in block.splitlines()]
    for code in [*lines, *(" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose))]:
        for arguments in re.findall(r"cargo test ([^|;&]*)", code):
            yield arguments.replace("\"", "").split()


def wrong_commands():
    """Commands of pages that run no test, because cargo refuses them or no name has their filter."""
    folders, problems = packages(), []
    python = "".join(f"{file.stem} {file.read_text()}" for file in ROOT.glob("crates/languages/python/tests/*.py"))
    everywhere = [ROOT / "CONTRIBUTING.md", ROOT / "RELEASING.md", ROOT / "RELIABILITY.md", *pages().values()]
    for page in everywhere:
        problems += [f"{page.relative_to(ROOT)}: no test {name} of the Python package"
                     for name in re.findall(r"python_package\.sh [^`\n]*-k (\w+)", page.read_text()) if name not in python]
        for words in commands(page.read_text()):
            own, after = (words[:words.index("--")], words[words.index("--") + 1:]) if "--" in words else (words, [])
            given, names, rest = {"package": [], "target": []}, [], iter(own)
            for word in rest:
                if word in VALUED:
                    value, kind = next(rest, ""), VALUED[word]
                    given.setdefault("target" if kind == "bin" else kind, []).append("bin" if kind == "bin" else value)
                elif word in ("--lib", "--bins"):
                    given["target"].append("lib" if word == "--lib" else "bin")
                elif not word.startswith("-"):
                    names.append(word)
            if len(names) > 1:
                problems.append(f"{page.relative_to(ROOT)}: cargo takes one name of a test, more of them after `--`: {' '.join(words)}")
            names += [word for word in after if re.fullmatch(r"[a-z_]\w*(::\w+)*", word)]
            places = [f"{package.removeprefix('joulebus-')}/{target}" for package in given["package"] for target in given["target"] or ["lib"]]
            if not given["target"]:
                places += [f"{place.partition('/')[0]}/{file.stem}" for place in places
                           for file in (folders.get(place.partition("/")[0], ROOT / "none") / "tests").glob("*")]
            known = [name for name in names if re.fullmatch(r"[a-z_]\w*(::\w+)*", name)]
            problems += [f"{page.relative_to(ROOT)}: no test {name}: cargo test {' '.join(words)}"
                         for name in known if places and not any(is_test(folders, f"{place} {name}") for place in places)]
    return problems


def missing_pins():
    """Versions in the table of peers that nothing pins. Debian's are of the machine."""
    table = (ROOT / "docs/measured/peers.md").read_text().split("## Tested with\n")[1].split("\n\n")[0]
    cells = [row.split(" | ")[1] for row in table.splitlines() if " | " in row]
    versions = {version for cell in cells if "Debian" not in cell for version in re.findall(r"\d+\.\d+\.\d+", cell)}
    pins = [ROOT / "Cargo.lock", *(ROOT / "tools").rglob("*.*"), *(ROOT / "crates").rglob("*.lock")]
    pinned = "".join(path.read_text(errors="replace") for path in pins if path.suffix in (".json", ".lock", ".py", ".sh"))
    return [f"docs/measured/peers.md: nothing pins {version}" for version in sorted(versions) if version not in pinned]


def check(folder, write):
    known, absent, problems, stale = known_suites(folder), set(), [], []
    problems += of_one_run(suites(folder)) if folder == FIGURES else []
    for name, page in pages().items():
        before = page.read_text()
        after = filled(name, before, known, absent, problems)
        if before == after:
            continue
        if write:
            page.write_text(after)
        else:
            problems.append(f"{name}: its figures are not those of docs/figures: tools/page_figures.py --write")
    now = {name: len(found) for name, found in all_bare().items()}
    allowed = baseline()
    if write and folder == FIGURES:
        if allowed is not None and sum(now.values()) > sum(allowed.values()):
            problems.append(f"{sum(now.values())} bare figures, {sum(allowed.values())} before: mark, name or remove the new ones")
        else:
            BASELINE.write_text("".join(f"{count}\t{name}\n" for name, count in sorted(now.items())))
    elif not write:
        for name, count in now.items():
            if count > (before := (allowed or {}).get(name, 0)):
                problems.append(f"{name}: {count} bare figures, {before} in {BASELINE.relative_to(ROOT)}. `--bare {name}` shows them. "
                                "Include a figure of docs/figures, or add <!-- definition -->. "
                                "Where text has moved between pages: --write")
        stale = [name for name, count in (allowed or {}).items() if now.get(name, 0) < count]
        problems += missing_tests() + wrong_commands() + missing_pins() + unfinished_campaigns() + unwritten_blocks()
    if stale:
        print(f"fewer bare figures than {BASELINE.relative_to(ROOT)} says, so --write: {', '.join(stale)}")
    for problem in problems:
        print(problem, file=sys.stderr)
    tables = {match[2] for page in pages().values() for match in BLOCK.finditer(page.read_text()) if match[2] in RENDER}
    if missing := sorted((tables | absent) - known.keys()):
        print(f"of an earlier run, since docs/figures has no file: {', '.join(missing)}")
    print(f"{sum(now.values())} bare figures in {len(now)} pages, {len(known)} files of figures")
    sys.exit(1 if problems else 0)


def stamp(file, commit):
    """Adds the commit of what was measured and the day to a file of figures."""
    suite = json.loads(file.read_text())
    today = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
    figures.write(file, {"commit": commit, "date": today} | {name: value for name, value in suite.items() if name not in ("commit", "date")})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--check", action="store_true")
    action.add_argument("--write", action="store_true")
    action.add_argument("--bare", metavar="PAGE")
    action.add_argument("--names", nargs="?", const="", metavar="FILE")
    action.add_argument("--stamp", nargs=2, metavar=("FILE", "COMMIT"), help="add commit and date (tools/figures.sh)")
    parser.add_argument("--figures", type=pathlib.Path, default=FIGURES, metavar="DIR", help="other files [docs/figures]")
    given = parser.parse_args()
    if given.stamp:
        stamp(pathlib.Path(given.stamp[0]), given.stamp[1])
    elif given.bare:
        for number, figure in bare((ROOT / given.bare).read_text()):
            print(f"{given.bare}:{number}: {figure}")
    elif given.names is not None:
        for file, suite in known_suites(given.figures).items():
            for figure in (figure for report in suite["reports"] for figure in report["figures"] if file.startswith(given.names)):
                print(f"{file}.{figure['name']}[{figure['case']}]  {figures.shown(figure['p50'])} {figure['unit']}")
    else:
        check(given.figures, given.write)


if __name__ == "__main__":
    main()
