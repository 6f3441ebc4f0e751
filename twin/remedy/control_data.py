"""What to enter in a control for each change: data with names, units, new and old values, and the files that hold them.

A function that a control does not have, or whose units stand in no text that could be read, is refused by name. Facts and grades are those
of `twin.remedy.files` and of the manuals named there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np

from twin.control.library import BLOCKS
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import key_of, parameter
from twin.remedy.advice import BACKLASH, PULSE, SET_BACK, TABLE
from twin.remedy.change import Change
from twin.remedy.files import heidenhain, isg, linuxcnc, sinumerik
from twin.remedy.files.table import PER_SI, ErrorTable

CONTROLS = ("sinumerik", "heidenhain", "linuxcnc", "isg")
POINTS_A_WAVE, POINTS_A_TURN = 16, 72
"""Points of a correction table in one wave: linear interpolation between them leaves 2 % of the wave; and in the one wave of a turning table."""


FAR = 10.0
"""Knees of a characteristic that never act, in units of the largest acceleration."""


class Entry(NamedTuple):
    """One datum to enter: name on the control, new value, old value (None: unknown), unit, grade of the source."""

    name: str
    value: float
    old: float | None
    unit: str
    grade: str


@dataclass(frozen=True)
class ForControl:
    """What a change means on a control: data to enter, a correction table, or why it cannot be entered there."""

    entries: tuple[Entry, ...] = ()
    table: ErrorTable | None = None
    refused: str = ""
    by_hand: str = ""


def entries_of(change: Change, machine: Machine, control: str) -> ForControl:
    """The change on a control. Raises InputError for an unknown control."""
    if control not in CONTROLS:
        raise InputError(f"--control {control}: use one of {', '.join(CONTROLS)}")
    axis = machine.axis(change.axis)
    if change.function == SET_BACK:
        return _set_back(change, machine, control)
    if change.function == TABLE:
        return ForControl(table=correction_table(change, axis))
    of: Callable[[dict[str, float], dict[str, float], Axis, str], ForControl] = {PULSE: _pulse, BACKLASH: _backlash}[change.function]
    old = next((dict(b.values) for b in axis.blocks if b.block.name == change.function), {})
    return of(dict(change.values), old, axis, control)


def _length(axis: Axis) -> tuple[str, float]:
    """Unit and factor from SI of a length on the control: mm or degrees."""
    return ("mm" if axis.kind == "linear" else "deg"), PER_SI[axis.kind]


def _pulse(values: dict[str, float], old: dict[str, float], axis: Axis, control: str) -> ForControl:
    amplitude, decay, knee = values["amplitude"], values["decay_time"], values.get("acceleration_1", 0.0)
    unit, factor = _length(axis)
    if control == "sinumerik":
        per_min = ("mm/min", 60e3) if axis.kind == "linear" else ("rev/min", 60.0 / (2.0 * math.pi))
        return ForControl(
            (
                Entry("MD32490 FRICT_COMP_MODE", 1.0, None, "", "A"),
                Entry("MD32500 FRICT_COMP_ENABLE", 1.0, None, "", "A"),
                Entry("MD32510 FRICT_COMP_ADAPT_ENABLE", float(knee > 0.0), None, "", "A"),
                Entry("MD32520 FRICT_COMP_CONST_MAX", amplitude * per_min[1], old.get("amplitude", 0.0) * per_min[1], per_min[0], "A"),
                *_characteristic(amplitude * per_min[1], knee, per_min[0], axis),
                Entry("MD32540 FRICT_COMP_TIME", decay, old.get("decay_time"), "s", "C"),
            )
        )
    if knee > 0.0:
        return ForControl(refused="the pulse rises with the acceleration of the reversal; no text in reach says how this control does that")
    if control == "heidenhain":
        # a pulse of constant speed for MP752 with the area of the decaying one
        return ForControl(
            (Entry("MP750", amplitude * decay * factor, 0.0, unit, "C"), Entry("MP752", decay * 1e3, 0.0, "ms", "C")),
            by_hand="the pulse of this control is a rectangle of the same area: tune it by circles; newer controls call it posCtrlRevErr and "
            f"posCtrlRevErrTime, or compStrength = {amplitude * decay * factor:.4g} {unit} with compFFAdjust = compRefAcc = 0",
        )
    if control == "linuxcnc":
        return ForControl(
            by_hand=f"no friction pulse exists: build one in HAL from the sign change of joint.N.vel-cmd to pid.N.bias, "
            f"{amplitude * factor:.4g} {unit}/s, decay {decay:.3g} s"
        )
    return ForControl(refused="the friction compensation of this kernel is a current over speed; its units stand in no text in reach")


def _characteristic(amplitude: float, knee: float, unit: str, axis: Axis) -> tuple[Entry, ...]:
    """Amplitude over acceleration up to its first knee; the other knees out of reach, so that the amplitude stays."""
    if knee == 0.0:
        return ()
    per_s2, factor = ("m/s2", 1.0) if axis.kind == "linear" else ("rev/s2", 1.0 / (2.0 * math.pi))
    knees = (knee, FAR * axis.max_acceleration, 2.0 * FAR * axis.max_acceleration)
    return (
        Entry("MD32530 FRICT_COMP_CONST_MIN", amplitude, None, unit, "A"),
        *(Entry(f"MD325{40 + 10 * i} FRICT_COMP_ACCEL{i}", a * factor, None, per_s2, "A") for i, a in enumerate(knees, 1)),
    )


def _backlash(values: dict[str, float], old: dict[str, float], axis: Axis, control: str) -> ForControl:
    unit, factor = _length(axis)
    width, before = values["width"] * factor, old.get("width", 0.0) * factor
    if control == "isg":
        return ForControl(
            (Entry("getriebe[0].lose", round(width * 1e4), round(before * 1e4), "0.1 um" if axis.kind == "linear" else "0.0001 deg", "A"),)
        )
    name, *_ = BLOCKS[BACKLASH].numbers[0].data[control]
    return ForControl((Entry(name, width, before, unit, "A"),))


def _set_back(change: Change, machine: Machine, control: str) -> ForControl:
    setting, axis = change.setting, machine.axis(change.axis)
    assert setting is not None
    names = _SET_BACK.get(setting.effect.name, {})
    if control not in names:
        return ForControl(
            by_hand=f"set back {setting.effect.name.replace('_', ' ')}: its parameter on this control stands in no text in reach"
        )
    name, field, unit, factor = names[control]
    if setting.effect.name == "inertia":
        new = change.table(machine)["inertia_kg_m2"]
        return ForControl((Entry(name, new, new - setting.size * axis.ratio**2, unit, "C"),))
    if field:
        new = _field(axis, field) * factor
        old = (_field(axis, field) + setting.size) * factor if setting.effect.name == "loop_delay" else new * setting.factor_on(field)
    else:  # a filter that should not be there
        new, old = 0.0, setting.size * factor
    grade = "A" if control == "sinumerik" and field else "C"
    return ForControl((Entry(name, new, old, unit, grade),))


def _field(axis: Axis, field: str) -> float:
    return float(next(getattr(part, field) for part in (axis, axis.motor, axis.loops) if hasattr(part, field)))


def _datum(field: str) -> tuple[str, str, str, float]:
    """Name, field, unit, factor from SI of a SINUMERIK datum that the table of parameters knows."""
    datum = parameter(field).data[0]
    assert datum is not None
    number, name, unit, factor = datum
    key = key_of(field, "linear")
    to_key = 1.0 if not key.endswith("_us") else 1e6
    return f"MD{number} {name}", field, unit, to_key / factor


_SET_BACK: dict[str, dict[str, tuple[str, str, str, float]]] = {
    "position_gain": {
        "sinumerik": _datum("position_gain_per_s"),
        "heidenhain": ("MP1810", "position_gain_per_s", "(m/min)/mm", 0.06),
        "linuxcnc": ("P", "position_gain_per_s", "1/s", 1.0),
        "isg": ("getriebe[0].kv", "position_gain_per_s", "0.01/s", 100.0),
    },
    "velocity_feedforward": {
        "sinumerik": _datum("velocity_feedforward"),
        "heidenhain": ("feedForwardFactor", "velocity_feedforward", "1", 1.0),
        "linuxcnc": ("FF1", "velocity_feedforward", "1", 1.0),
    },
    "loop_delay": {"sinumerik": _datum("position_delay_s")},
    "speed_gain": {"sinumerik": _datum("speed_gain_nm_s_per_rad"), "heidenhain": ("MP2500", "speed_gain_nm_s_per_rad", "file unit", 1.0)},
    "speed_integral_time": {
        "sinumerik": _datum("speed_integral_time_s"),
        "heidenhain": ("MP2510", "speed_integral_time_s", "file unit", 1.0),
    },
    "set_point_filter": {"sinumerik": ("MD32410 AX_JERK_TIME", "", "s", 1.0)},
    "current_filter": {"sinumerik": ("MD1201 current set point filter", "", "ms", 1e3)},
    "inertia": {"sinumerik": ("MD32650 AX_INERTIA", "", "kg m2", 1.0)},
}
"""Control parameter that holds each deviation: effect -> control -> name, field of the axis, unit, factor from SI."""


def datum_lines(machine: Machine, moved: Mapping[str, tuple[float, float]]) -> list[list[str]]:
    """Axis, number, SINUMERIK datum, unit, old and new value of changed numbers of the loops, by key of the machine file."""
    rows = []
    for key, values in moved.items():
        _, name, _, field = key.split(".")
        datum = parameter(f"loops.{field}").data[machine.axis(name).kind == "rotary"]
        label, unit, factor = ("-", "unit of the machine file", 1.0) if datum is None else (f"MD{datum[0]} {datum[1]}", datum[2], datum[3])
        rows.append([name, field, label, unit, *(f"{value / factor:.5g}" for value in values)])
    return rows


def correction_table(change: Change, axis: Axis) -> ErrorTable:
    """The points of a correction: two for a slope alone, else POINTS_A_WAVE a wave over the travel; one turn of a rotary axis repeats."""
    v = change.values
    wave = math.hypot(v["sine"], v["cosine"]) > 0.0
    waves = 2.0 * math.pi / v["wavelength"]
    turn = (
        axis.kind == "rotary"
        and wave
        and math.isclose(waves, round(waves), rel_tol=1e-9)
        and (round(waves) == 1 or not all(map(math.isfinite, axis.travel)))
    )
    low, high = (0.0, 2.0 * math.pi) if turn or not all(map(math.isfinite, axis.travel)) else axis.travel
    count = max(math.ceil((high - low) / v["wavelength"] * POINTS_A_WAVE), POINTS_A_TURN if turn else 1) + 1 if wave else 2
    q = np.linspace(low, high, count)
    k = 2.0 * math.pi / v["wavelength"]
    error = 1e-6 * v["slope"] * (q - v["origin"]) + v["sine"] * np.sin(k * q) + v["cosine"] * np.cos(k * q)
    return ErrorTable(axis.name, q, error, error, modulo=turn)


def files_for(changes: list[Change], machine: Machine, control: str, saved: Sequence[str] = ()) -> tuple[dict[str, str], list[str]]:
    """(file name -> text, sentences on what must be done by hand) of all changes on a control; `saved`: texts of .COM files that it saved."""
    names = list(machine.axis_names)
    entries: list[tuple[str, Entry]] = []
    files: dict[str, str] = {}
    notes = []
    for change in changes:
        of = entries_of(change, machine, control)
        entries += [(change.axis, entry) for entry in of.entries]
        notes += [f"{change.axis}: {text}" for text in (of.refused, of.by_hand) if text]
        if of.table is not None:
            kind = machine.axis(change.axis).kind
            table = of.table
            if control == "linuxcnc" and len(table.positions) > linuxcnc.MOST_POINTS:
                notes.append(
                    f"axis {change.axis}: its wave needs {len(table.positions)} points, LinuxCNC takes {linuxcnc.MOST_POINTS}: the file holds the slope only"
                )
                table = correction_table(replace(change, values={**change.values, "sine": 0.0, "cosine": 0.0}), machine.axis(change.axis))
            try:
                files |= _table_files(table, kind, control, names.index(change.axis), saved)
            except InputError as error:
                notes.append(str(error))
    if entries:
        files |= _data_file(entries, control, names)
    return files, notes


def _table_files(table: ErrorTable, kind: str, control: str, number: int, saved: Sequence[str]) -> dict[str, str]:
    if control == "sinumerik":
        return {f"{table.axis}_EEC.INI": sinumerik.eec_file(table, kind)}
    if control == "linuxcnc":
        text = linuxcnc.compensation_file(table, kind)
        return {
            f"{table.axis}.comp": text,
            f"{table.axis}_comp.ini": linuxcnc.ini_lines(number, {"COMP_FILE": f"{table.axis}.comp", "COMP_FILE_TYPE": "1"}),
        }
    if control == "isg":
        return {f"{table.axis}.lis": isg.list_of(table, kind, number + 1)}
    for text in saved:
        with contextlib.suppress(InputError):  # of another axis
            return {f"{table.axis}.COM": heidenhain.filled(text, table, kind)}
    raise InputError(f"axis {table.axis}: HEIDENHAIN tables are filled only into a .COM file that the control saved: give it with --saved")


def _data_file(entries: list[tuple[str, Entry]], control: str, names: list[str]) -> dict[str, str]:
    if control == "sinumerik":
        data = [
            sinumerik.MachineDatum(int(number[2:]), name, f"AX{names.index(axis) + 1}", e.value, e.old, e.unit, grade=e.grade)
            for axis, e in entries
            for number, _, name in [e.name.partition(" ")]
        ]
        return {"machine_data.ini": sinumerik.archive(data)}
    if control == "heidenhain":
        return {
            "parameters.txt": heidenhain.parameter_list(
                [heidenhain.MachineParameter(e.name, axis, e.value, e.old, e.unit, e.grade) for axis, e in entries]
            )
        }
    if control == "linuxcnc":
        return {"joints.ini": "".join(linuxcnc.ini_lines(names.index(axis), {e.name: e.value}) for axis, e in entries)}
    return {
        "parameters.lis": "".join(
            f"{e.name:<29}{e.value:.9g}  # axis {axis}, {e.unit}{'' if e.grade == 'A' else f', grade {e.grade}: check before use'}\n"
            for axis, e in entries
        )
    }
