"""Schemas of the files that users write: what they refuse twin refuses, and what twin refuses in one key they refuse."""

from collections.abc import Callable, Iterator
import copy
import functools
import json
from pathlib import Path
import re
import shutil
import tomllib
from typing import Any

import jsonschema
import pytest
import tomlkit

from tests.conftest import ROOT
from twin.cli import main
from twin.cli.schema import schemas
from twin.documents import read_toml
from twin.errors import InputError
from twin.machine.axis import axis_of_table
from twin.machine.document import check_document
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.recordings.mapping import read_map
from twin.regress.suite import read_suite
from twin.study.catalogue import choices_of
from twin.study.spec import read_study
from twin.surface.part import read_part

CATALOGUE = """
[[motor]]
name = "M80"
torque_constant_nm_per_a = 1.2
back_emf_v_s_per_rad = 0.7
resistance_ohm = 0.9
inductance_h = 0.006
inertia_kg_m2 = 0.0016
peak_current_a = 40.0
rated_torque_nm = 9.5
[[motor]]
name = "M100"
torque_constant_nm_per_a = 1.3
back_emf_v_s_per_rad = 0.75
resistance_ohm = 0.4
inductance_h = 0.004
inertia_kg_m2 = 0.003
peak_torque_nm = 90
"""


def read_machine(file: Path) -> Machine:
    """The machine; its tables are checked first, because a faulty one is then refused before its model is read."""
    document = read_toml(file)
    check_document(document, str(file))
    for name, table in document["axis"].items():
        axis_of_table(name, table, f"[axis.{name}]")
    return load_machine(file)


READ: dict[str, Callable[[Path], object]] = {
    "campaign": lambda file: read_campaign(file.parent), "map": read_map, "study": read_study, "part": read_part, "suite": read_suite,
    "catalogue": lambda file: choices_of(file, [], "M80", (), "factor"), "machine": read_machine,
}  # fmt: skip
SHOWN_BY = {
    "run": "campaign",
    "column": "map",
    "factor": "study",
    "surface": "part",
    "tolerance": "suite",
    "motor": "catalogue",
    "axis": "machine",
}
"""A table that a file of each kind has; the last one that a file has says its kind."""
OPEN = ("fixed", "values", "moves", "effects", "effect", "csv", "frame", "sinumerik", "identified", "variables", "program")
"""Tables whose keys are paths, names or numbers of another table: twin alone checks them."""


def kind_of(document: dict[str, Any], file: Path) -> str:
    return "map" if file.name == "map.toml" else [kind for table, kind in SHOWN_BY.items() if table in document][-1]


@functools.cache
def validators() -> dict[str, jsonschema.Draft7Validator]:
    return {kind: jsonschema.Draft7Validator(schema) for kind, schema in schemas().items()}


@pytest.mark.parametrize(
    "file", sorted([*ROOT.glob("examples/**/*.toml"), *ROOT.glob("models/*.toml")]), ids=lambda f: f.relative_to(ROOT).as_posix()
)
def test_every_example_follows_its_schema(file: Path) -> None:
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    validators()[kind_of(document, file)].validate(document)


def test_the_command_writes_them_for_editors(tmp_path: Path) -> None:
    """Draft 7, which taplo reads: it would take `items: false` of a later draft for a list without items. TOML has no null."""
    assert main(["schema", str(tmp_path)]) == 0
    written = {file.name.removesuffix(".schema.json"): json.loads(file.read_text(encoding="utf-8")) for file in tmp_path.iterdir()}
    assert written == schemas()
    assert written.keys() == READ.keys()
    for schema in written.values():
        jsonschema.Draft7Validator.check_schema(schema)
        assert not {"null", "prefixItems", "$ref"} & set(re.findall(r'"([^"]*)"', json.dumps(schema)))


def tables_in(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """Each table of a document with its path, except what is open."""
    if isinstance(node, dict):
        yield path, node
    for key, below in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        if key not in OPEN:
            yield from tables_in(below, (*path, key))


def faults_of(document: dict[str, Any]) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """The document with one fault: a key that no table has, a value of another type, or a number beyond all bounds."""
    kinds = {tuple(table): (path, table) for path, table in tables_in(document)}  # one of those with the same keys
    for path, table in kinds.values():
        own = {key: value for key, value in table.items() if key not in OPEN}
        wrong = [(key, 12.5 if isinstance(value, str) else "text") for key, value in own.items()]
        beyond = [(key, size) for key, value in own.items() if type(value) is float for size in (-1e200, 1e200)]
        for key, value in [("no_such_key", "text"), *wrong, *beyond]:
            changed: Any = copy.deepcopy(document)
            at = changed
            for step in path:
                at = at[step]
            at[key] = value
            yield (*path, key), changed


@pytest.mark.parametrize("name", [
    "examples/campaign/campaign.toml", "examples/traces/map.toml", "examples/emps/two_thirds.toml", "examples/studies/inertia_matching.toml",
    "examples/half_inertia/study.toml", "examples/parts/part1_tangent_planes.toml", "examples/parts/part3_dome.toml",
    "examples/regression/effects.toml", "examples/regression/parts.toml", "examples/lab_axis/axis.toml", "models/mikron_ucp710.toml",
    "examples/motors.toml",
])  # fmt: skip
def test_schema_and_twin_refuse_alike(name: str, tmp_path: Path) -> None:
    for folder in ("examples", "models"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    file = tmp_path / name
    (tmp_path / "examples" / "motors.toml").write_text(CATALOGUE, encoding="utf-8")
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    kind = kind_of(document, file)
    if kind == "machine":
        document["axis"]["X"]["block"] = {"friction_pulse": {"amplitude_m_per_min": 0.1, "decay_time_s": 0.01}}
        file.write_text(tomlkit.dumps(document), encoding="utf-8")
    READ[kind](file)
    apart = []
    for place, changed in faults_of(document):
        file.write_text(tomlkit.dumps(changed), encoding="utf-8")
        refused = False
        try:
            READ[kind](file)
        except InputError:
            refused = True
        if refused == validators()[kind].is_valid(changed):
            apart.append(f"{'.'.join(map(str, place))}: {'twin' if refused else 'schema'} alone refuses")
    assert apart == []


@pytest.mark.parametrize(("cycles", "right"), [(2, True), (1.5, False)])
def test_what_is_counted_is_whole(cycles: float, right: bool) -> None:
    document = tomllib.loads((ROOT / "examples/lab_axis/axis.toml").read_text(encoding="utf-8"))
    document["axis"]["X"]["loops"]["speed_mean_cycles"] = cycles
    assert validators()["machine"].is_valid(document) is right
