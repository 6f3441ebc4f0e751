"""A suite: TOML files with one or several cases each, checked when read. Paths in a case are relative to the suite file.

A file holds the shared keys of its cases and one `[[case]]` table per case (without any, the file is one case named after it).
A case's own key replaces the shared one; tolerances are merged by quantity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
import re
from typing import Any

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import FEEDFORWARD
from twin.tables import is_number, known_keys

KINDS = ("run", "cut", "campaign", "identify", "diagnose", "study")
COMMON_KEYS = ("kind", "name", "why", "machine", "tolerance")
CHANGED = ("axes", "values", "effects")
"""Keys that change the machine of a case: driven axes, numbers by path, effects."""
OWN_KEYS: dict[str, tuple[str, ...]] = {
    "run": (*CHANGED, "feedforward", "input", "moves", "compare", "keep_every_ms"),
    "cut": (*CHANGED, "feedforward", "input", "part", "zone_um"),
    "campaign": (*CHANGED, "campaign", "moves", "recorded"),
    "identify": (*CHANGED, "campaign", "moves", "recorded"),
    "diagnose": (*CHANGED, "campaign", "moves", "recorded", "seed"),
    "study": ("spec",),
}
_TYPES: dict[str, tuple[type, str]] = {
    "axes": (list, 'a list of axes, e.g. ["X"]'),
    "values": (dict, 'paths and numbers, e.g. { "axis.X.moving_mass_kg" = 700.0 }'),
    "effects": (list, 'a list of tables, e.g. [{ name = "backlash", axis = "X", clearance = 1.5e-5 }]'),
    "moves": (dict, "tables of moves; write [moves.X] with distances_mm and speed_mm_per_s"),
    "recorded": (dict, "a table with seed, effect, axis, feedforward"),
    "compare": (list, 'a list of signals, e.g. ["position", "current"]'),
    "seed": (int, "a whole number"),
    **dict.fromkeys(("machine", "input", "part", "spec", "campaign"), (str, "a path beside the suite file")),
}
NEEDED_TOLERANCES = {"run": ("summary", "events"), "campaign": ("gap",), "identify": ("parameters",), "diagnose": ("parameters",)}
"""Compared quantities of a kind besides its signals; all other kinds compare `summary`."""

SIGNAL_UNITS = {
    "setpoint": "um, arcsec",
    "position": "um, arcsec",
    "motor_position": "um, arcsec",
    "load_position": "um, arcsec",
    "velocity": "mm/s, deg/s",
    "velocity_setpoint": "mm/s, deg/s",
    "drive_velocity_setpoint": "mm/s, deg/s",
    "current": "A",
    "current_setpoint": "A",
    "voltage": "V",
    "torque": "Nm",
    "torque_feedforward": "Nm",
    "torque_friction": "Nm",
    "torque_gravity": "Nm",
}
COMPARED = ("setpoint", "position", "velocity", "current")
"""Compared signals of a run by default."""

_NAME = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
_TOLERANCE_KEYS = {
    "signal": ("rms", "max", "unit", "reason"),
    "summary": ("relative", "absolute", "reason"),
    "events": ("time_s", "reason"),
    "gap": ("growth", "above_noise", "reason"),
    "parameters": ("relative", "of_interval", "reason"),
}


@dataclass(frozen=True)
class Case:
    """One case: name, kind, suite file, and its table including the shared keys."""

    name: str
    kind: str
    file: Path
    table: Mapping[str, Any]

    @property
    def where(self) -> str:
        """File and case, for messages."""
        return f"{self.file}: case '{self.name}'"

    @property
    def tolerance(self) -> Mapping[str, Mapping[str, Any]]:
        """Quantity -> tolerance table."""
        return self.table.get("tolerance", {})

    @property
    def compared(self) -> tuple[str, ...]:
        """Signals to compare sample by sample."""
        return tuple(self.table.get("compare", COMPARED)) if self.kind == "run" else ()

    def path(self, key: str) -> Path:
        """The path of a file or folder of the case."""
        return self.file.parent / str(self.table[key])

    def digest(self) -> str:
        """Hash of all keys that influence the result, to detect a golden result of another case."""
        deciding = {k: v for k, v in self.table.items() if k not in ("tolerance", "why", "name", "compare")}
        return hashlib.sha256(json.dumps(deciding, sort_keys=True, default=str).encode()).hexdigest()[:16]


def read_suite(path: str | Path) -> tuple[Case, ...]:
    """All cases of a folder of suite files, or of one file, in the order of the files. Raises InputError with file and key."""
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.toml"))
        if not files:
            raise InputError(f"{path}: no suite file in this folder; write at least one case, e.g. {path / 'runs.toml'}")
    elif path.is_file():
        files = [path]
    else:
        raise InputError(f"{path}: no such suite; give a folder of *.toml files or one such file")
    cases = [case for file in files for case in _read_file(file)]
    seen: dict[str, Path] = {}
    for case in cases:
        if case.name in seen:
            raise InputError(f"{case.where} also exists in {seen[case.name]}; rename one of them")
        seen[case.name] = case.file
    return tuple(cases)


def _read_file(file: Path) -> list[Case]:
    document = read_toml(file)
    shared = {k: v for k, v in document.items() if k != "case"}
    tables = document.get("case", [{"name": document.get("name", file.stem)}])
    if not isinstance(tables, list) or not tables or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{file}: 'case' must be a list of tables; write [[case]] followed by name = \"...\"")
    return [_case(file, i, {**shared, **t, "tolerance": _joined(file, shared, t)}) for i, t in enumerate(tables)]


def _joined(file: Path, shared: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    parts = [part.get("tolerance", {}) for part in (shared, own)]
    if not all(isinstance(part, dict) for part in parts):
        raise InputError(f"{file}: 'tolerance' must be tables; write [tolerance.position] followed by rms, max, unit, reason")
    return {**parts[0], **parts[1]}


def _case(file: Path, index: int, table: dict[str, Any]) -> Case:
    name = table.get("name")
    if not isinstance(name, str) or not _NAME.match(name):
        raise InputError(f"{file}: case {index + 1}: name = {name!r}: give a name of letters, digits, '_', '-' or '.'")
    where = f"{file}: case '{name}'"
    kind = table.get("kind")
    if kind not in KINDS:
        raise InputError(f"{where}: kind = {kind!r}; {nearest(str(kind), KINDS)}")
    known = (*COMMON_KEYS, *OWN_KEYS[kind])
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}' for kind {kind}; {nearest(key, known)}")
        expected, form = _TYPES.get(key, (object, ""))
        if not isinstance(value, expected) or value in ([], {}, ""):
            raise InputError(f"{where}: {key} = {value!r}: expected {form or 'a word'}")
    if table.get("feedforward") is not None and table["feedforward"] not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward '{table['feedforward']}'; use one of {', '.join(FEEDFORWARD)}")
    for key in ("keep_every_ms", "zone_um"):
        length = table.get(key, 1.0)
        if isinstance(length, bool) or not isinstance(length, int | float) or not 0.0 < length < 1e4:
            raise InputError(f"{where}: {key} = {length!r}: give a number above 0, e.g. 10")
    case = Case(name, kind, file, table)
    _check_source(case)
    _check_tolerances(case)
    return case


def _check_source(case: Case) -> None:
    """A case needs exactly one input and existing files; only a campaign may be absent (the case is then skipped)."""
    table = case.table
    one_of = {
        "run": ("input", "moves"),
        "cut": ("input",),
        "campaign": ("campaign", "recorded"),
        "identify": ("campaign", "recorded"),
        "diagnose": ("campaign", "recorded"),
        "study": ("spec",),
    }[case.kind]
    given = [key for key in one_of if key in table]
    if len(given) != 1:
        found = "none is given" if not given else f"{' and '.join(given)} are given"
        raise InputError(f"{case.where}: give one of {', '.join(one_of)}; {found}")
    if "recorded" in table and not isinstance(table.get("moves"), dict):
        raise InputError(f"{case.where}: 'recorded' needs moves to record; write [moves.X] with distances_mm and speed_mm_per_s")
    if case.kind == "cut" and "part" not in table:
        raise InputError(f"{case.where}: 'part' is missing; name the part file")
    for key in ("input", "part", "machine", "spec"):
        if key in table and not case.path(key).is_file():
            raise InputError(f"{case.where}: {key} = '{table[key]}': no such file {case.path(key)}; correct the path")


def _check_tolerances(case: Case) -> None:
    """Every compared quantity needs a well-formed tolerance with a reason."""
    needed = (*case.compared, *NEEDED_TOLERANCES.get(case.kind, ("summary",)))
    for quantity in case.compared:
        if not isinstance(quantity, str) or quantity not in SIGNAL_UNITS:
            raise InputError(f"{case.where}: compare: no signal '{quantity}'; {nearest(str(quantity), SIGNAL_UNITS)}")
    for quantity in needed:
        if quantity not in case.tolerance:
            example = " ".join(f"{key} = ..." for key in _keys_of(quantity))
            raise InputError(f"{case.where}: tolerance of '{quantity}' is missing; write [tolerance.{quantity}] {example}")
    for quantity, table in case.tolerance.items():
        where = f"{case.where}: [tolerance.{quantity}]"
        if not isinstance(table, dict):
            raise InputError(f"{where}: expected a table, found {table!r}; write [tolerance.{quantity}] followed by its keys")
        known = (*SIGNAL_UNITS, *(q for q in _TOLERANCE_KEYS if q != "signal"))
        if quantity not in known:
            raise InputError(f"{where}: no such quantity; {nearest(quantity, known)}")
        keys = _keys_of(quantity)
        known_keys(table, keys, where)
        for key in keys:
            if key not in table:
                raise InputError(f"{where}: '{key}' is missing; a tolerance has {', '.join(keys)}")
            value = table[key]
            if key == "reason":
                if not isinstance(value, str) or len(value.strip()) < 5:
                    raise InputError(f"{where}: reason = {value!r}: give the reason for this tolerance in words")
            elif key == "unit":
                if value != SIGNAL_UNITS[quantity]:
                    raise InputError(f"{where}: unit = {value!r}: {quantity} is compared in '{SIGNAL_UNITS[quantity]}'")
            elif not is_number(value) or value < 0.0:
                raise InputError(f"{where}: {key} = {value!r}: expected a number of 0 or more")


def _keys_of(quantity: str) -> tuple[str, ...]:
    return _TOLERANCE_KEYS["signal" if quantity in SIGNAL_UNITS else quantity]


def chosen(cases: Sequence[Case], only: Sequence[str], suite: str | Path) -> tuple[Case, ...]:
    """Cases whose names match one of the patterns (`*` and `?`); all cases without a pattern."""
    import fnmatch

    for pattern in only:
        if not any(fnmatch.fnmatch(case.name, pattern) for case in cases):
            raise InputError(f"--only {pattern}: no such case in {suite}; {nearest(pattern, [case.name for case in cases])}")
    return tuple(case for case in cases if not only or any(fnmatch.fnmatch(case.name, p) for p in only))
