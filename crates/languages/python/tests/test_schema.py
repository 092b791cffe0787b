"""JSON Schema of the kinds of config files, judged by the independent validator `jsonschema`."""
from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from conftest import ROOT

jsonschema = pytest.importorskip("jsonschema")
tomllib = pytest.importorskip("tomllib")

CONFIGS = ROOT / "configs"
KINDS = {
    "fleet": [CONFIGS / "fleet.toml", CONFIGS / "mixed.toml"],
    "platform": sorted((CONFIGS / "platforms").glob("*.toml")),
    "bridge": sorted((CONFIGS / "bridges").glob("*.toml")),
    "link": sorted((CONFIGS / "links").glob("*.toml")),
    "webhooks": sorted((CONFIGS / "webhooks").glob("*.toml")),
}
FILES = [(kind, path) for kind, paths in KINDS.items() for path in paths]


@pytest.fixture(scope="module")
def schemas(run):
    schemas = {kind: json.loads(run("config", "schema", kind)) for kind in KINDS}
    for schema in schemas.values():
        jsonschema.Draft202012Validator.check_schema(schema)
    return {kind: jsonschema.Draft202012Validator(schema) for kind, schema in schemas.items()}


def tables(document):
    """Every table of a document: those of sections, and those of lists."""
    if isinstance(document, dict):
        yield document
    for value in document.values() if isinstance(document, dict) else document:
        if isinstance(value, (dict, list)):
            yield from tables(value)


def test_every_shipped_file_is_as_its_schema_says(schemas):
    assert all(KINDS.values())
    for kind, path in FILES:
        errors = list(schemas[kind].iter_errors(tomllib.loads(path.read_text())))
        assert not errors, f"{path}: {errors}"


def test_examples_of_the_documents_are_as_their_schema_says(schemas):
    checked = 0
    for path in sorted((ROOT / "docs").rglob("*.md")):
        for block in re.findall(r"```toml\n(.*?)```", path.read_text(), re.S):
            document = tomllib.loads(block)
            # A mapping file of `import` has no schema.
            if "dependencies" in document or "robot" in document:
                continue
            # A part of a file: what is required may stand in another part.
            found = [
                kind
                for kind, schema in schemas.items()
                if all(error.validator == "required" for error in schema.iter_errors(document))
            ]
            assert found, f"{path.name}: {block}"
            checked += 1
    assert checked >= 3


def test_a_name_that_no_reader_knows_is_refused_by_the_schema_and_by_config_check(schemas, program, tmp_path):
    for kind, path in FILES:
        document = tomllib.loads(path.read_text())
        free = (document.get("robots"), *(it.get("fields") for it in document.get("mqtt", {}).get("write", [])))
        for table in tables(document):
            if any(table is other for other in free):
                continue
            table["nmae_of_nothing"] = 1
            assert not schemas[kind].is_valid(document), f"{path}: {table}"
            del table["nmae_of_nothing"]
        assert schemas[kind].is_valid(document)
        text, changed = re.subn(r"(?m)^(nam|broke|topi|addres)([ercs]) = ", r"\1q\2 = ", path.read_text(), count=1)
        assert changed == 1, path
        wrong = tmp_path / path.name
        wrong.write_text(text)
        checked = subprocess.run([program, "config", "check", wrong, "--format", "json"], capture_output=True, text=True)
        assert checked.returncode == 2, f"{path}: {checked.stdout}"
        file = json.loads(checked.stdout)["files"][0]
        unknown = [problem["remedy"] for problem in file["problems"] if "not a known key" in problem["what"]]
        assert file["kind"] == kind and len(unknown) == 1 and "nearest key is" in unknown[0], file


@pytest.mark.parametrize(
    ("kind", "text", "of"),
    [
        ("fleet", "[tick]\nrate_hz = 0\n", "tick.rate_hz"),
        ("platform", 'rate_hz = 30\nmodel = "persistence"\npower_max_w = "20"\n', "power_max_w"),
        ("bridge", '[mqtt]\nkeep_alive_s = 4\n[robots]\na = 1\n', "mqtt.keep_alive_s"),
        ("bridge", '[robots]\na = 1.5\n[mqtt]\nbroker = "a:1"\n', "robots.a"),
        ("link", '[follow]\nservices = ["samples"]\n', "follow.services"),
        ("link", '[lease]\nendpoints = []\n', "lease.endpoints"),
        ("link", 'workers = ["a"]\n', "workers"),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_both(schemas, program, tmp_path, kind, text, of):
    # The deepest error of each branch.
    errors = [".".join(name for name in error.absolute_path if isinstance(name, str))
              for error in schemas[kind].iter_errors(tomllib.loads(text))]
    assert of in errors, errors
    path = Path(tmp_path / "wrong.toml")
    path.write_text(text)
    checked = subprocess.run([program, "config", "check", path, "--format", "json"], capture_output=True, text=True)
    keys = [problem["key"] for problem in json.loads(checked.stdout)["files"][0]["problems"]]
    assert of in keys, checked.stdout


def test_every_key_has_a_description_and_every_section_refuses_others(schemas):
    def nodes(schema):
        yield schema
        for inner in (*schema.get("properties", {}).values(), schema.get("additionalProperties"), schema.get("items")):
            if isinstance(inner, dict):
                yield from nodes(inner)

    for kind, validator in schemas.items():
        leaves = 0
        for node in nodes(validator.schema):
            if node.get("type") == "object":
                assert node["additionalProperties"] is False or not node["properties"], (kind, node)
            elif "description" in node:
                leaves += 1
                numbers = node.get("type") in ("integer", "number")
                assert not numbers or {"minimum", "maximum"} <= node.keys(), node
                if "default" in node:
                    jsonschema.validate(node["default"], node)
        assert leaves >= 3, kind
