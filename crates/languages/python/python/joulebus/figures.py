"""Figures of reports, drawn by matplotlib from the data in report.json.

    python3 -m joulebus.figures report/report.json              # every figure as SVG and PDF, beside the report
    python3 -m joulebus.figures report.json -o paper/ figure-4-time      # one of them, elsewhere
"""
from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ._optional import needed

#: Share of a category's width that its marks occupy.
_TAKEN = 0.78
#: Inches of a panel's width, and CSS pixels in an inch.
_PANEL_IN, _PX_IN = 5.0, 80.0


class Figure:
    """A figure of a report as data: ``name``, ``title``, ``description``, ``panels``."""

    def __init__(self, data: dict[str, Any]) -> None:
        self.data = data
        self.name: str = data["name"]
        self.title: str = data["title"]
        self.description: str = data["description"]
        self.panels: list[dict[str, Any]] = data["panels"]

    def figure(self) -> Any:
        """A new ``matplotlib.figure.Figure``. Needs matplotlib."""
        pyplot = needed("matplotlib.pyplot", "figures")
        columns = max(1, self.data["columns"])
        rows = math.ceil(len(self.panels) / columns)
        size = (_PANEL_IN * columns, rows * (self.data["panel_height_px"] / _PX_IN + 0.6))
        figure, places = pyplot.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
        for ax, panel in zip(places.flat, self.panels):
            _draw(ax, panel)
        for ax in places.flat[len(self.panels) :]:
            ax.set_axis_off()
        figure.suptitle(self.title)
        if self.data["note"]:
            figure.supxlabel(self.data["note"], fontsize="small")
        return figure

    def plot(self, ax: Any = None) -> Any:
        """The only panel, on `ax` or on new axes, which are returned. Needs matplotlib."""
        if len(self.panels) != 1:
            raise ValueError(f"{self.name} has {len(self.panels)} panels: figure() draws them")
        if ax is None:
            ax = needed("matplotlib.pyplot", "figures").subplots()[1]
        _draw(ax, self.panels[0])
        ax.set_title(self.title)
        return ax

    def __repr__(self) -> str:
        return f"Figure({self.name!r}, {self.title!r})"


def _draw(ax: Any, panel: dict[str, Any]) -> None:
    for layer in panel["layers"]:
        _mark(ax, layer["mark"], layer["colour"], layer["label"])
    ax.set_title(panel["title"])
    for way in "xy":
        axis = panel[way]
        getattr(ax, f"set_{way}label")(axis["label"])
        scale, limits = axis["scale"], axis["limits"]
        if scale != "linear":
            names = scale["names"]
            getattr(ax, f"set_{way}ticks")(range(len(names)), names)
            # From the top down.
            getattr(ax, f"set_{way}lim")(*((-0.6, len(names) - 0.4) if way == "x" else (len(names) - 0.4, -0.6)))
        if limits is not None:
            getattr(ax, f"set_{way}lim")(*limits)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")


def _mark(ax: Any, mark: Any, colour: str, label: str | None) -> None:
    if mark == "diagonal":
        ends = [*ax.get_xlim(), *ax.get_ylim()]
        ax.plot([min(ends), max(ends)], [min(ends), max(ends)], "--", color=colour, label=label, linewidth=1.0)
        return
    ((kind, data),) = mark.items()
    if kind == "line":
        points = _numbers(data["points"], 2)
        ax.plot(*points.T, "--" if data["dashed"] else "-", color=colour, label=label, linewidth=1.2)
    elif kind == "band":
        x, low, high = _numbers(data, 3).T
        ax.fill_between(x, low, high, color=colour, alpha=0.2, label=label, linewidth=0.0)
    elif kind == "points":
        ax.plot(*_numbers(data, 2).T, ".", color=colour, label=label, markersize=3.0)
    elif kind in ("bars", "dots"):
        _categories(ax, kind, data, colour, label)
    elif kind == "columns":
        ax.stairs(_numbers(data["heights"]), _numbers(data["edges"]), fill=True, alpha=0.5, color=colour, label=label)
    elif kind == "tiles":
        x, y = _numbers(data["x_edges"]), _numbers(data["y_edges"])
        counts = _numbers(data["counts"]).reshape(len(y) - 1, len(x) - 1)
        ax.pcolormesh(x, y, np.where(counts > 0, counts, np.nan), cmap="Blues", norm="log")
    elif kind == "rule":
        draw = ax.axhline if data["direction"] == "across" else ax.axvline
        draw(data["at"], linestyle="--", color=colour, label=label, linewidth=1.0)
    elif kind == "stripe":
        ax.axvspan(*data, color=colour, alpha=0.2, label=label, linewidth=0.0)


def _categories(ax: Any, kind: str, data: dict[str, Any], colour: str, label: str | None) -> None:
    values, low, high = (_numbers([value[name] for value in data["values"]]) for name in ("value", "low", "high"))
    slot, slots = data["slot"]
    width = _TAKEN / max(1, slots)
    at = np.arange(len(values)) + (slot - 0.5 * (slots - 1)) * width
    errors = np.nan_to_num(np.stack([values - low, high - values]))
    if kind == "bars":
        ax.barh(at, values, color=colour, label=label, height=0.9 * width)
    else:
        ax.plot(values, at, "o", color=colour, label=label, markersize=4.0)
    if errors.any():
        ax.errorbar(values, at, xerr=errors, fmt="none", color="#1B1F24", linewidth=1.0)


def _numbers(values: Any, width: int | None = None) -> np.ndarray:
    # In JSON, a number that is not finite is null.
    found = np.array(values, np.float64)
    return found if width is None else found.reshape(-1, width)


def draw(report: Path, out: Path, names: list[str]) -> list[Path]:
    """Draws figures of a report.json, all if none is named, as SVG and PDF. Needs matplotlib."""
    pyplot = needed("matplotlib.pyplot", "figures")
    parts = [part for section in json.loads(report.read_text())["sections"] for part in section["parts"]]
    figures = {part["figure"]["name"]: Figure(part["figure"]) for part in parts if "figure" in part}
    for name in names:
        if name not in figures:
            raise ValueError(f"{report}: there is no figure {name}, allowed are {', '.join(figures)}")
    out.mkdir(parents=True, exist_ok=True)
    written = []
    # The same bytes each time.
    with pyplot.rc_context({"svg.hashsalt": "joulebus"}):
        for name in names or figures:
            drawn = figures[name].figure()
            for ending, date in ("svg", "Date"), ("pdf", "CreationDate"):
                written.append(out / f"{name}.{ending}")
                drawn.savefig(written[-1], metadata={date: None})
            pyplot.close(drawn)
    return written


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python3 -m joulebus.figures", description="Draws the figures of a report.")
    parser.add_argument("report", type=Path, help="the report.json of a report")
    parser.add_argument("names", nargs="*", metavar="NAME", help="figures to draw (default: all)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: figures/ beside the report)")
    given = parser.parse_intermixed_args()
    needed("matplotlib", "figures").use("agg")
    try:
        for path in draw(given.report, given.out or given.report.parent / "figures", given.names):
            print(path)
    except (OSError, ValueError, KeyError) as error:
        print(f"figures: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
