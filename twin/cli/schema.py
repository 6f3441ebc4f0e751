"""`twin schema`: JSON Schemas of the files that users write, with which an editor completes and checks them.

They are made from what twin reads the files with: the models of tables, the keys of the machine file. What depends on several keys, on other files or
on the machine, twin alone checks. TOML has no null, and editors know draft 7, in which a tuple is a list of `items`.
"""

from collections.abc import Iterable, Mapping
import itertools
import json
import math
from pathlib import Path
from typing import Any

import msgspec

from twin.cli.arguments import Args, arg
from twin.control.actuator import EFFORTS
from twin.control.library import BLOCKS
from twin.control.number import Key
from twin.control.structures import STRUCTURES
from twin.files import write_whole
from twin.machine import keys
from twin.machine.document import TABLES
from twin.recordings.campaign import CampaignFile
from twin.recordings.mapping import Settings
from twin.regress.suite import KINDS, SIGNAL_UNITS, TOLERANCES, CaseTable
from twin.study.catalogue import ENTRIES
from twin.study.spec import StudyFile
from twin.surface import shapes, tools
from twin.surface.part import PartFile

Schema = dict[str, Any]
MODELS: dict[str, type[msgspec.Struct]] = {
    "campaign": CampaignFile,
    "map": Settings,
    "study": StudyFile,
    "part": PartFile,
    "suite": CaseTable,
}
ARGUMENTS = (arg("folder", "DIR", "folder to write to"),)


def schemas() -> dict[str, Schema]:
    """The schema of each kind of file by its name."""
    found = {name: _of_model(model) for name, model in MODELS.items()}
    part, suite = found["part"]["properties"], found["suite"]["properties"]
    part["tool"], part["surface"]["items"] = _one_of(tools.TABLES), _one_of(shapes.KINDS)
    suite["kind"], suite["compare"]["items"] = {"enum": list(KINDS)}, {"enum": list(SIGNAL_UNITS)}
    suite["tolerance"] = _table({quantity: _of_model(model) for quantity, model in TOLERANCES.items()})
    found["suite"] = _table({**suite, "case": _list_of(_table(suite))})  # a key stands at the top or in each case
    found["catalogue"] = _table({kind: _list_of(_of_model(model)) for kind, model in ENTRIES.items()})
    found["machine"] = _machine()
    return {name: {"$schema": "http://json-schema.org/draft-07/schema#", **one} for name, one in found.items()}


def _of_model(model: type[msgspec.Struct]) -> Schema:
    """The schema of a model with those of the tables below it."""
    (own,), tables = msgspec.json.schema_components((model,), ref_template="{name}")
    return dict(_plain(own, tables))


def _plain(node: Any, tables: Mapping[str, Schema]) -> Any:
    """A part of a schema without references, without null and in draft 7."""
    if isinstance(node, list):
        return [_plain(one, tables) for one in node if one != {"type": "null"}]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:  # title and description are those of the code
        node = {key: one for key, one in tables[node["$ref"]].items() if key not in ("title", "description")}
    out = {
        key: _plain(one, tables)
        for key, one in node.items()
        if key != "default" or isinstance(one, str | int) or (isinstance(one, float) and math.isfinite(one))
    }
    out |= {"items": out.pop("prefixItems")} if "prefixItems" in out else {}
    return out | out.pop("anyOf")[0] if len(out.get("anyOf", ())) == 1 else out


def _one_of(models: Mapping[str, type[msgspec.Struct]]) -> Schema:
    """A table whose key `kind` names its model."""
    out = {kind: _of_model(model) for kind, model in models.items()}
    return {"oneOf": [{**one, "properties": {**one["properties"], "kind": {"enum": [kind]}}} for kind, one in out.items()]}


def _list_of(table: Schema) -> Schema:
    return {"type": "array", "items": table, "minItems": 1}


def _table(properties: Mapping[str, Any], required: Iterable[str] = ()) -> Schema:
    return {"type": "object", "properties": dict(properties), "required": list(required), "additionalProperties": False}


def _machine() -> Schema:
    """The machine file. An axis may have the keys of every drive and structure."""
    tables: dict[str, dict[str, Key]] = {}
    drives = [drive for own in keys.DRIVES.values() for drive in own]
    kinds = [(name, command) for name, blocks in STRUCTURES.items() for command in blocks.actuator.commands]
    for drive, (structure, command) in itertools.product(drives, kinds):
        for table, own in keys.tables_of_axis(drive, keys.numbers_of_axis(structure, command)).items():
            tables.setdefault(table, {}).update(own)
    words: dict[str, Iterable[str]] = {"kind": keys.DRIVES, "structure": STRUCTURES, "drive": drives, **keys.WORDS}
    below = {table: _numbers(own)["properties"] for table, own in tables.items()}
    axis = below.pop("") | {word: {"enum": list(known)} for word, known in words.items()}
    axis["travel_deg"] = {"anyOf": [axis["travel_deg"], {"enum": ["endless"]}]}
    below["actuator"]["command"] = {"enum": list(EFFORTS)}
    blocks = {b.name: _table({n.key(kind): _number(n.bounds) for n in b.numbers for kind in keys.DRIVES}) for b in BLOCKS.values()}
    axis |= {table: _table(own) for table, own in below.items()} | {"sinumerik": {"type": "object"}, "force_unit": {"type": "string"}}
    axis["block"] = _table(blocks) | {"additionalProperties": {"type": "object"}}  # blocks of a user's own file
    control = _numbers(keys.CONTROL)
    control["properties"]["setpoint_interpolation"] = {"enum": list(keys.INTERPOLATIONS)}
    named = {"axis": _table(axis, ["kind"]), "body": _numbers(keys.BODY), "tool": _numbers(keys.TOOL)}
    top: Schema = {name: {"type": "object", "additionalProperties": table} for name, table in named.items()}
    top |= {"control": control, "geometry": _numbers(keys.GEOMETRY), "measurement": _numbers(keys.MEASUREMENT)}
    text = {"type": "string"}
    top |= {"name": text, "model": text, "axis_order": _list_of(text), "driven_axes": _list_of(text)}
    numbers = _numbers(keys.TOP)
    return _table({key: {} for key in TABLES} | top | numbers["properties"], ["axis", "control", "measurement", *numbers["required"]])


def _numbers(table: Mapping[str, Key]) -> Schema:
    return _table({name: _number(key) for name, key in table.items()}, [name for name, key in table.items() if key.required])


def _number(key: Key) -> Schema:
    low, high = max(key.low, -keys.LARGEST), min(key.high, keys.LARGEST)
    one = {"type": "integer" if key.whole else "number", "exclusiveMinimum" if key.above else "minimum": low, "maximum": high}
    return one if key.count == 1 else {"type": "array", "items": one, "minItems": key.count, "maxItems": key.count}


def carry_out(args: Args) -> None:
    """Write the schema of each kind of file."""
    for name, schema in schemas().items():
        write_whole(Path(args.folder) / f"{name}.schema.json", json.dumps(schema, indent=1, allow_nan=False) + "\n")
        print(f"written: {Path(args.folder) / name}.schema.json")
    print(f"name one in the first line of a file, for editors with taplo (Even Better TOML):  #:schema {args.folder}/study.schema.json")
