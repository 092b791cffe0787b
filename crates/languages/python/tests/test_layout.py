"""NumPy's types against the table in the documentation, which is made from `crates/core/wire` and compared with C."""
from __future__ import annotations

import re

import joulebus
import numpy as np
import pytest
from conftest import ROOT
from joulebus import _native
from joulebus.live import _dtype

PAGE = (ROOT / "docs/reference/layout.md").read_text()


def table(name: str) -> tuple[int, list[tuple[int, str, np.dtype]]]:
    """Size, and offset, name and type of each field, as the page has them."""
    section = PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]
    size = int(re.match(r"`joulebus_\w+`, (\d+) bytes", section)[1])
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| `[^`]+` \| `([^`]+)` \|", section, re.M)
    return size, [(int(offset), field, np.dtype(code)) for offset, field, code in rows]


@pytest.mark.parametrize(
    ("name", "layout", "fields"),
    [
        ("Sample", _native.SAMPLE, 13),
        ("Forecast", _native.FORECAST, 14),
        ("Diagnostic", _native.DIAGNOSTIC, 35),
        ("Budget", _native.BUDGET, 25),
        ("Outlook", _native.OUTLOOK, 16),
        ("PlanState", _native.PLAN_STATE, 41),
        ("AnswerRow", _native.ANSWER_ROW, 17),
    ],
)
def test_types_have_the_offsets_of_the_documentation(name, layout, fields):
    dtype = _dtype(layout)
    size, expected = table(name)
    assert len(expected) == fields and dtype.itemsize == size
    found = [(dtype.fields[field][1], field, dtype.fields[field][0]) for field in dtype.names]
    assert found == expected


def test_public_types_are_those():
    for public, layout in [
        (joulebus.SAMPLE, _native.SAMPLE),
        (joulebus.FORECAST, _native.FORECAST),
        (joulebus.DIAGNOSTIC, _native.DIAGNOSTIC),
        (joulebus.BUDGET, _native.BUDGET),
        (joulebus.OUTLOOK, _native.OUTLOOK),
    ]:
        assert public == _dtype(layout)
