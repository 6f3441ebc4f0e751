"""Every JSON file of the project has a schema in the tree, and what the commands write follows it."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import jsonschema
import pytest

from tests.conftest import ROOT
from twin.cli import main

SCHEMAS = ROOT / "twin" / "report" / "schemas"
WRITERS = {"write_json": 2, "stamped": 1}
"""Functions of twin.files that stamp a document, and the place of the schema's name among their arguments."""


def schema(name: str) -> dict:
    return json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))


def check(path: Path) -> dict:
    document = json.loads(path.read_text(encoding="utf-8"))
    jsonschema.validate(document, schema(document["schema"].split("/")[0]))
    return document


@pytest.mark.parametrize("path", sorted(SCHEMAS.glob("*.json")), ids=lambda path: path.stem)
def test_schema_is_one(path: Path) -> None:
    found = schema(path.stem)
    jsonschema.Draft202012Validator.check_schema(found)
    assert found["properties"]["schema"]["const"] == f"{path.stem}/1"
    assert {"schema", "version"} <= set(found["required"])


def test_every_written_document_names_a_schema_of_the_tree() -> None:
    known = {path.stem for path in SCHEMAS.glob("*.json")}
    used = set()
    for file in (ROOT / "twin").rglob("*.py"):
        if file.name == "files.py":
            continue
        text = file.read_text(encoding="utf-8")
        if "from twin.files import" not in text:
            continue
        for call in ast.walk(ast.parse(text)):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in WRITERS:
                names = [a.value for a in call.args[WRITERS[call.func.id] :] if isinstance(a, ast.Constant)]
                assert names, f"{file.relative_to(ROOT)}:{call.lineno}: a document without the name of its schema"
                used.add(names[0])
    assert used == known


def test_run_gap_and_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = str(ROOT / "examples" / "x_200mm.csv")
    for name, more in (("a", []), ("b", ["--effect", "backlash:X:clearance=15e-6"])):
        assert main(["run", example, "--no-recording", "--out", str(tmp_path / name), *more]) == 0
    assert "after reversals" in capsys.readouterr().out
    worn = check(tmp_path / "b" / "summary.json")
    assert worn["effects"] == [{"name": "backlash", "axis": "X", "clearance": 15e-6}]
    assert worn["input"] == example
    assert 17 < worn["axes"]["X"]["reversal_peak"] < 20
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "c")]) == 0
    found = check(tmp_path / "c" / "compare.json")
    assert {d["axis"] for d in found["differences"] if d["max"] > 0.1} == {"X"}
    assert (
        main(["gap", str(ROOT / "examples" / "campaign"), "--json", str(tmp_path / "gap.json"), "--html", str(tmp_path / "gap.html")]) == 0
    )
    assert capsys.readouterr().out.startswith("a and b differ on X")
    assert check(tmp_path / "gap.json")["verdict"] == "X, Y, Z, A and C as they should be"
    assert "<svg" in (tmp_path / "gap.html").read_text(encoding="utf-8")


def test_machine_check(tmp_path: Path) -> None:
    assert main(["machine", "check", str(ROOT / "examples" / "lab_axis" / "axis.toml"), "--out", str(tmp_path)]) == 0
    check(tmp_path / "check.json")


def test_check_fails_on_a_document_that_lacks_a_key(tmp_path: Path) -> None:
    (tmp_path / "gap.json").write_text('{"schema": "gap/1", "version": "0"}', encoding="utf-8")
    with pytest.raises(jsonschema.ValidationError, match="'machine' is a required property"):
        check(tmp_path / "gap.json")
