"""Compensations that a control holds already, read from its own files: error tables over position, and numbers of blocks of a machine file.

    E(q) = slope (q - origin) + sine sin(k q) + cosine cos(k q) + what is left          the block `position_correction` holds the first three

The format follows from the content: SINUMERIK archives, EEC and CEC; LinuxCNC ini and compensation files; HEIDENHAIN parameter lists and old tables;
ISG lists. A LinuxCNC compensation file and an old HEIDENHAIN table name no axis.
"""

from dataclasses import dataclass, field
import math
from pathlib import Path
import re

import numpy as np

from twin.control.library import BLOCKS
from twin.control.number import si_from_key
from twin.documents import read_text
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.remedy.advice import TABLE
from twin.remedy.files import heidenhain, isg, linuxcnc, sinumerik
from twin.remedy.files.table import ErrorTable
from twin.units import AXIS_UNITS

DEFAULTS = {"cycles": 1.0}
"""Numbers of blocks that no file of a control holds: a play is worked off in one cycle."""


@dataclass(frozen=True)
class Existing:
    """What a file holds for one axis: a table, or numbers of blocks [SI at the axis]."""

    axis: Axis
    table: ErrorTable | None = None
    blocks: dict[str, dict[str, float]] = field(default_factory=dict)


def existing(file: str, machine: Machine, kind: int = 0) -> list[Existing]:
    """What 'FILE', or 'AXIS=FILE', holds; `kind` of a LinuxCNC compensation file. Raises InputError for a file of another kind."""
    name, separator, rest = file.partition("=")
    given, path = (name, Path(rest)) if separator and name in machine.axis_names else ("", Path(file))
    text = read_text(path, "a file of a control")

    def own(axis: str = given) -> Axis:
        if not axis:
            raise InputError(f"{path}: it names no axis; write AXIS={path}")
        return _axis(given or axis, machine, path)

    if found := re.search(r"\$AA_ENC_COMP(?:_\w+)?\[[^\]]*?(\w+)\s*\]", text):
        axis = own(found[1])
        return [Existing(axis, sinumerik.eec_table(text, axis.kind))]
    if found := re.search(r"\$AN_CEC_OUTPUT_AXIS\[\d+\]\s*=\s*\(?(\w+)", text):
        return [Existing(_axis(t.axis, machine, path), t) for _, t in sinumerik.cec_tables(text, own(found[1]).kind)]
    if "kw.ssfk." in text:
        number = re.search(r"kopf\.achs_nr\s+(\d+)", text)
        axis = own(f"AX{number[1]}" if number else given)
        return [Existing(axis, isg.table_of(text, axis.name, axis.kind))]
    data = {
        "sinumerik": sinumerik.machine_data(text),
        "heidenhain": heidenhain.parameters_of(text),
        "linuxcnc": linuxcnc.ini_values(text),
    }
    if control := next((c for c, values in data.items() if values), None):
        return _blocks(data[control], control, machine, path)
    axis = own()
    if re.search(rf"^\s*\d+\s+\w+[-+.\d]+\s+{axis.name}[-+.\d]", text, re.M):
        over = re.search(r"^\s*\d+\s+([A-Z])[-+.\d]", text, re.M)
        return [Existing(axis, heidenhain.old_table(text, axis.name, over[1] if over else axis.name))]
    return [Existing(axis, linuxcnc.table_of(text, axis.name, axis.kind, kind))]


def _axis(name: str, machine: Machine, path: Path) -> Axis:
    """The axis of a control's name: 'X', 'X1', or 'AX1', the first one."""
    number = re.fullmatch(r"AX(\d+)", name)
    if number and 0 < int(number[1]) <= len(machine.axes):
        return machine.axes[int(number[1]) - 1]
    known = next((n for n in (name, name.rstrip("0123456789")) if n in machine.axis_names), None)
    if known is None:
        raise InputError(f"{path}: axis {name} is not one of {', '.join(machine.axis_names)}; write AXIS={path}")
    return machine.axis(known)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _blocks(data: dict[tuple[str, str], str], control: str, machine: Machine, path: Path) -> list[Existing]:
    """The blocks whose numbers stand in a control's data and are switched on."""
    held: dict[str, dict[str, float]] = {}
    for (name, of), text in data.items():
        own, value = _axis(of, machine, path).name, _number(text)
        if math.isfinite(value) and value != 0.0:
            held.setdefault(own, {})[name] = value
    out: dict[str, Existing] = {}
    for name, found in held.items():
        axis = machine.axis(name)
        for block in BLOCKS.values():
            known = {n.name: n.data[control] for n in block.numbers if control in n.data}
            values = {number: found[d.code] * d.si[axis.kind == "rotary"] for number, d in known.items() if d.code in found}
            if values:
                defaults = {n.name: DEFAULTS[n.name] for n in block.numbers if n.name in DEFAULTS}
                out.setdefault(name, Existing(axis)).blocks[block.name] = defaults | values
    if not out:
        names = sorted({n.data[control].code for b in BLOCKS.values() for n in b.numbers if control in n.data})
        raise InputError(f"{path}: holds no compensation that is switched on; give a file with {', '.join(names)} or a table")
    return list(out.values())


def correction_of(table: ErrorTable, axis: Axis) -> tuple[dict[str, float], float]:
    """Numbers of the block `position_correction` that a table holds [SI], and the RMS of what they leave.

    The wave is that of a turn of the motor or of the axis, whichever leaves less.
    """
    q, error = table.positions, 0.5 * (table.forward + table.backward)
    turns = [2.0 * np.pi * axis.ratio, *([2.0 * np.pi] if axis.kind == "rotary" else [])]
    fits = []
    for wave in [w for w in turns if 4.0 * float(np.diff(q).max()) <= w] or [math.inf]:
        k = 2.0 * np.pi / wave
        columns = np.column_stack([np.ones(len(q)), q, np.sin(k * q), np.cos(k * q)])[:, : 4 if k else 2]
        (offset, slope, *waves), *_ = np.linalg.lstsq(columns, error, rcond=1e-9)
        left = float(np.sqrt(np.mean((error - columns @ [offset, slope, *waves]) ** 2)))
        sine, cosine = waves or (0.0, 0.0)
        origin = -offset / slope if slope else 0.0
        values = {"slope": 1e6 * slope, "origin": origin, "sine": sine, "cosine": cosine, "wavelength": wave if k else turns[0]}
        fits.append(({name: float(v) for name, v in values.items()}, left))
    return min(fits, key=lambda fit: fit[1])


def lines_of(found: Existing) -> list[str]:
    """What was read in words, and the tables to enter in the machine file."""
    axis, lines, blocks = found.axis, [], dict(found.blocks)
    (length, per_si), (unit, to) = AXIS_UNITS[axis.kind].position, AXIS_UNITS[axis.kind].error
    if (table := found.table) is not None:
        q, way = table.positions * per_si, "by direction" if table.by_direction else "one for both directions"
        own, left = correction_of(table, axis)
        both = np.concatenate([table.forward, table.backward])
        over = f" over axis {table.input_axis}" if table.input_axis not in ("", table.axis) else ""
        lines.append(
            f"{axis.name}: {len(q)} points from {q[0]:.6g} to {q[-1]:.6g} {length}{over}, {way}; "
            f"the axis goes {both.min() * to:.4g} to {both.max() * to:.4g} {unit} too far"
        )
        if over:
            return [*lines, "  from another axis: no block of the machine file corrects that"]
        lines.append(f"  as a slope and a wave: {left * to:.3g} {unit} RMS left, and a constant, which a reference removes")
        if table.by_direction:
            play = float(np.mean(table.backward - table.forward))
            lines.append(f"  the directions differ by {play * to:.4g} {unit} on average: a backlash value")
            blocks["backlash_value"] = {"width": play, **DEFAULTS}
        blocks[TABLE] = own
    for name, values in blocks.items():
        lines.append(f"[axis.{axis.name}.block.{name}]")
        for n in BLOCKS[name].numbers:
            if n.name in values:
                key = n.key(axis.kind)
                lines.append(f"{key} = {float(f'{values[n.name] / si_from_key(key):.9g}')!r}")
    return lines
