"""Packages that joulebus uses where they are installed."""
from __future__ import annotations

import importlib
from typing import Any

from . import _native


def needed(package: str, what: str) -> Any:
    """The package, or an ImportError that names the remedy where it is missing."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        top = package.partition(".")[0].replace("sklearn", "scikit-learn")
        raise ImportError(f"{what} need {top}, which cannot be imported ({error}): pip install {top}") from error


def lab(what: str) -> Any:
    """The native half with the lab, or an ImportError that names the remedy where it is missing."""
    if not hasattr(_native, "evaluate"):
        raise ImportError(
            f"{what} need the lab, which is not installed: pip install 'joulebus[lab]'"
            " (in a clone of the repository: pip install ./crates/languages/python/lab)"
        )
    return _native


def axes(ax: Any) -> Any:
    """The given axes of matplotlib, or those of a new figure."""
    pyplot = needed("matplotlib.pyplot", "figures")
    return pyplot.subplots()[1] if ax is None else ax


class Progress:
    """A bar by tqdm, or nothing where tqdm is not installed or no bar is wanted."""

    def __init__(self, wanted: bool, what: str, unit: str, total: int | None = None) -> None:
        self._bar: Any = None
        if wanted:
            try:
                from tqdm import tqdm
            except ImportError:
                return
            self._bar = tqdm(total=total, desc=what, unit=unit, leave=False)

    def reach(self, done: int, total: int | None = None, note: str = "") -> None:
        """`done` of `total` are done. Computations on several threads may tell it in another order."""
        if self._bar is None:
            return
        if total is not None:
            self._bar.total = total
        self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(max(0, done - self._bar.n))

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
