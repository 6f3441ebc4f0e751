"""A suite: TOML files with one or several cases each, checked when read. Paths in a case are relative to the suite file.

A file holds the shared keys of its cases and one `[[case]]` table per case (without any, the file is one case named after it).
A case's own key replaces the shared one; tolerances are merged by quantity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import fnmatch
import hashlib
import json
from pathlib import Path
import re
from typing import Annotated, Any

import msgspec

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import Feedforward
from twin.recordings.campaign import is_campaign
from twin.recordings.trace import POSITIONS
from twin.system import shell_word
from twin.tables import NotNegative, Table, asks, typed

SIGNAL_UNITS = {
    **dict.fromkeys(POSITIONS, "um, arcsec"),
    **dict.fromkeys(("velocity", "velocity_setpoint", "drive_velocity_setpoint"), "mm/s, deg/s"),
    **dict.fromkeys(("current", "current_setpoint"), "A"),
    "voltage": "V",
    **dict.fromkeys(("torque", "torque_feedforward", "torque_friction", "torque_gravity"), "Nm"),
}
"""Unit of the differences of each signal that is stored, of linear and rotary axes."""
COMPARED = ("setpoint", "position", "velocity", "current")
"""Compared signals of a run by default."""

_NAME = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
_File = Annotated[str, asks("give a path beside the suite file", min_length=1)]
_Length = Annotated[float, asks("give a number above 0, e.g. 10", gt=0.0, lt=1e4)]
_Reason = Annotated[str, asks("give the reason for this tolerance in words", pattern=r"(?s)\S.{3,}\S")]


class Recorded(Table, frozen=True):
    """A campaign of the second plant, see `recorded`."""

    seed: int
    effect: str | None = None
    axis: str | None = None
    feedforward: Annotated[tuple[Feedforward, ...], asks("give a list of off, velocity, velocity+torque", min_length=1)] = (
        "off",
        "velocity+torque",
    )


class CaseTable(Table, frozen=True):
    kind: str
    name: str
    tolerance: dict[str, dict[str, Any]]
    why: str = ""
    machine: _File | None = None
    # what changes the machine
    axes: Annotated[tuple[str, ...], asks('give a list of axes, e.g. ["X"]', min_length=1)] | None = None
    values: Annotated[dict[str, Any], asks('give paths and numbers, e.g. { "axis.X.moving_mass_kg" = 700.0 }', min_length=1)] | None = None
    effects: (
        Annotated[tuple[dict[str, Any], ...], asks('give a list of tables, e.g. [{ name = "backlash", axis = "X" }]', min_length=1)] | None
    ) = None
    feedforward: Feedforward | None = None
    # what it runs
    input: _File | None = None
    moves: Annotated[dict[str, Any], asks("write [moves.X] with distances_mm and speed_mm_per_s", min_length=1)] | None = None
    part: _File | None = None
    campaign: _File | None = None
    recorded: Recorded | None = None
    spec: _File | None = None
    seed: int = 0
    # what is compared
    compare: Annotated[tuple[str, ...], asks('give a list of signals, e.g. ["position", "current"]', min_length=1)] | None = None
    keep_every_ms: _Length = 1.0
    zone_um: _Length = 1.0


_ALL = ("kind", "name", "why", "machine", "tolerance")
_CHANGED = (*_ALL, "axes", "values", "effects")
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "run": ((*_CHANGED, "feedforward", "compare", "keep_every_ms"), ("input", "moves"), ("summary", "events")),
    "cut": ((*_CHANGED, "feedforward", "part", "zone_um"), ("input",), ("summary",)),
    "campaign": ((*_CHANGED, "moves"), ("campaign", "recorded"), ("gap",)),
    "identify": ((*_CHANGED, "moves"), ("campaign", "recorded"), ("parameters",)),
    "diagnose": ((*_CHANGED, "moves", "seed"), ("campaign", "recorded"), ("parameters",)),
    "study": (_ALL, ("spec",), ("summary",)),
}
"""Of each kind: its keys; the keys of which it has exactly one, its source; the quantities compared besides its signals."""

_LIMITS = {
    **dict.fromkeys(SIGNAL_UNITS, ("rms", "max")),
    "summary": ("relative", "absolute"),
    "events": ("time_s",),
    "gap": ("growth", "above_noise"),
    "parameters": ("relative", "of_interval"),
}
TOLERANCES = {
    quantity: msgspec.defstruct(
        quantity,
        [*((key, NotNegative) for key in keys), *([("unit", str)] if quantity in SIGNAL_UNITS else []), ("reason", _Reason)],
        bases=(Table,),
        frozen=True,
    )
    for quantity, keys in _LIMITS.items()
}
"""The table of the tolerance of each quantity."""


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
    if is_campaign([path]):
        raise InputError(
            f"{path}: is a campaign, not a suite; compare it with: twin gap {shell_word(path)}; in a suite it is a case of kind 'campaign'"
        )
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
    name, kind = table.get("name"), table.get("kind")
    if not isinstance(name, str) or not _NAME.match(name):
        raise InputError(f"{file}: case {index + 1}: name = {name!r}; give a name of letters, digits, '_', '-' or '.'")
    case = Case(name, str(kind), file, table)
    if not isinstance(kind, str) or kind not in KINDS:
        said = "'kind' is missing" if kind is None else f"kind = {kind!r}"
        raise InputError(f"{case.where}: {said}; {nearest(kind, KINDS)}")
    keys, sources, others = KINDS[kind]
    if wrong := next((key for key in table if key not in (*keys, *sources)), None):
        raise InputError(f"{case.where}: unknown key '{wrong}' for kind {kind}; {nearest(wrong, (*keys, *sources))}")
    typed(table, CaseTable, case.where)
    given = [key for key in sources if key in table]
    if len(given) != 1:
        found = "none is given" if not given else f"{' and '.join(given)} are given"
        raise InputError(f"{case.where}: give one of {', '.join(sources)}; {found}")
    if "recorded" in table and "moves" not in table:
        raise InputError(f"{case.where}: 'recorded' needs moves to record; write [moves.X] with distances_mm and speed_mm_per_s")
    if kind == "cut" and "part" not in table:
        raise InputError(f"{case.where}: 'part' is missing; name the part file")
    for key in ("input", "part", "machine", "spec"):  # only a campaign may be absent; the case is then skipped
        if key in table and not case.path(key).is_file():
            raise InputError(f"{case.where}: {key} = '{table[key]}': no such file {case.path(key)}; correct the path")
    if wrong := next((signal for signal in case.compared if signal not in SIGNAL_UNITS), None):
        raise InputError(f"{case.where}: compare: no signal '{wrong}'; {nearest(wrong, SIGNAL_UNITS)}")
    _check_tolerances(case, (*case.compared, *others))
    return case


def _check_tolerances(case: Case, needed: Sequence[str]) -> None:
    """Every compared quantity needs a tolerance with a reason."""
    for quantity in needed:
        if quantity not in case.tolerance:
            example = " ".join(f"{key} = ..." for key in TOLERANCES[quantity].__struct_fields__)
            raise InputError(f"{case.where}: tolerance of '{quantity}' is missing; write [tolerance.{quantity}] {example}")
    for quantity, table in case.tolerance.items():
        where = f"{case.where}: [tolerance.{quantity}]"
        if quantity not in TOLERANCES:
            raise InputError(f"{where}: no such quantity; {nearest(quantity, TOLERANCES)}")
        typed(table, TOLERANCES[quantity], where)
        if (unit := table.get("unit")) != SIGNAL_UNITS.get(quantity):
            raise InputError(f"{where}: unit = {unit!r}: {quantity} is compared in '{SIGNAL_UNITS[quantity]}'")


def chosen(cases: Sequence[Case], only: Sequence[str], suite: str | Path) -> tuple[Case, ...]:
    """Cases whose names match one of the patterns (`*` and `?`); all cases without a pattern."""
    for pattern in only:
        if not any(fnmatch.fnmatch(case.name, pattern) for case in cases):
            raise InputError(f"--only {pattern}: no such case in {suite}; {nearest(pattern, [case.name for case in cases])}")
    return tuple(case for case in cases if not only or any(fnmatch.fnmatch(case.name, p) for p in only))
