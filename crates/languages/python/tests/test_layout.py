"""NumPy's types against the C header, which is made from `crates/core/wire` and compared with a C compiler."""
from __future__ import annotations

import re

import joulebus
import numpy as np
import pytest
from conftest import ROOT
from joulebus import _native
from joulebus.live import _dtype

HEADER = (ROOT / "crates/languages/c/include/joulebus.h").read_text()
CODES = {"uint16_t": "<u2", "uint32_t": "<u4", "uint64_t": "<u8", "int64_t": "<i8", "float": "<f4", "double": "<f8"}


def struct(name: str) -> list[tuple[int, str, np.dtype]]:
    """Offset, name and type of each field, as the header has them: without padding."""
    body = re.search(rf"typedef struct {name} \{{(.*?)\n\}} {name};", HEADER, re.S)[1]
    body = re.sub(r"/\*.*?\*/", "", body, flags=re.S)
    fields, at = [], 0
    for of, field, count in re.findall(r"(\w+) (\w+)(?:\[(\d+)\])?;", body):
        dtype = np.dtype(f"({count},){CODES[of]}" if count else CODES[of])
        fields.append((at, field, dtype))
        at += dtype.itemsize
    return fields


@pytest.mark.parametrize(
    ("name", "layout", "fields"),
    [
        ("joulebus_sample", _native.SAMPLE, 13),
        ("joulebus_forecast", _native.FORECAST, 14),
        ("joulebus_diagnostic", _native.DIAGNOSTIC, 35),
        ("joulebus_budget", _native.BUDGET, 33),
        ("joulebus_outlook", _native.OUTLOOK, 16),
        ("joulebus_plan_state", _native.PLAN_STATE, 41),
        ("joulebus_answer_row", _native.ANSWER_ROW, 17),
    ],
)
def test_types_have_the_offsets_of_the_header(name, layout, fields):
    dtype = _dtype(layout)
    expected = struct(name)
    assert len(expected) == fields
    assert dtype.itemsize == sum(field.itemsize for _, _, field in expected)
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
