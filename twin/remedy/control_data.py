"""What to enter in a control for each change: data with names, units, new and old values, and the files that hold them.

A function that a control does not have, or whose units stand in no text that could be read, is refused by name. Facts and grades are those
of `twin.remedy.files` and of the manuals named there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from twin.control.library import BLOCKS
from twin.control.number import OnControl, alike
from twin.effects import apply_effects, with_effects
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import parameter
from twin.remedy.advice import GAIN, PULSE, SET_BACK, TABLE
from twin.remedy.change import Change, held
from twin.remedy.files import heidenhain, isg, linuxcnc, sinumerik
from twin.remedy.files.table import Entry, ErrorTable
from twin.units import AXIS_UNITS, in_words, plain

CONTROLS = ("sinumerik", "heidenhain", "linuxcnc", "isg")
POINTS_A_WAVE, FEWEST_A_WAVE, POINTS_A_TURN = 16, 12, 72
"""Points of a correction table in one wave: linear interpolation between them leaves 2 % of the wave, with the fewest 3 %; and in the one wave of a
turning table."""
MOST_POINTS = {"linuxcnc": linuxcnc.MOST_POINTS, "isg": 1500}
"""Points that a table of a control takes (ISG: before V3.1.3079.06). MD38000 sets the memory of SINUMERIK; the lines of a .COM file stand in it."""
REFUSED = {(PULSE, "isg"): "the friction compensation of this kernel is a current over speed; its units stand in no text in reach"}
"""Functions that cannot be entered on a control, and why."""
WITH_CHARACTERISTIC = ("sinumerik",)
"""Controls whose texts say how a pulse depends on the acceleration."""
FAR = 10.0
"""Knees of a characteristic that never act, in units of the largest acceleration."""


def not_said(machine: Machine) -> list[str]:
    """What to know of the entries where nobody said which control it is: the cascade with a current loop is that of a SINUMERIK, others are anyone's."""
    if any(axis.actuator.winding for axis in machine.axes):
        return []
    return [
        f"nothing says which control this is: the entries are those of a {CONTROLS[0]}; give --control {', '.join(CONTROLS[1:-1])} or {CONTROLS[-1]}; "
        "on any other control the numbers hold, but not their names"
    ]


@dataclass(frozen=True)
class ForControl:
    """A change on a control: data to enter, a correction table, or the reason why it cannot be entered there."""

    entries: tuple[Entry, ...] = ()
    table: ErrorTable | None = None
    refused: str = ""
    by_hand: str = ""


def entries_of(change: Change, machine: Machine, control: str) -> ForControl:
    """The change on one of CONTROLS."""
    if refused := REFUSED.get((change.function, control)):
        return ForControl(refused=refused)
    axis = machine.axis(change.axis)
    if change.function == SET_BACK:
        return _set_back(change, machine, control)
    if change.function == GAIN:
        [(field, value)] = change.values.items()
        return ForControl((_entry(parameter(field).data[control], axis, value, axis.number(field)),))
    if change.function == TABLE:
        return _table(change, axis, control)
    return _pulse(change, axis, control) if change.function == PULSE else ForControl(_numbers(change, axis, control))


def _entry(datum: OnControl, axis: Axis, value: float, old: float) -> Entry:
    """A new and an old number of an axis [SI] in the unit of the control."""
    rotary = axis.kind == "rotary"
    return Entry(datum.name, value / datum.si[rotary], old / datum.si[rotary], datum.units[rotary], datum.grade)


def _numbers(change: Change, axis: Axis, control: str) -> tuple[Entry, ...]:
    """The numbers of a block as its declaration says that the control holds them."""
    old, numbers, entries = held(axis, change.function), BLOCKS[change.function].numbers, []
    for number in numbers:
        if control in number.data and number.name in change.values:
            entry = _entry(number.data[control], axis, change.values[number.name], old.get(number.name, 0.0))
            if control == "isg":  # its lists hold whole numbers
                entry = entry._replace(value=round(entry.value), old=round(entry.old or 0.0))
            known = old or number is numbers[0]  # without the block its size is 0, the rest as found
            entries.append(entry if known else entry._replace(old=None))
    return tuple(entries)


def _pulse(change: Change, axis: Axis, control: str) -> ForControl:
    amplitude, decay, knee = change.values["amplitude"], change.values["decay_time"], change.values.get("acceleration_1", 0.0)
    if control == "sinumerik":
        if knee > 0.0:  # up to its first knee; the other knees out of reach, so that the amplitude stays
            far = FAR * axis.max_acceleration
            rest = {"amplitude_low": amplitude, "acceleration_2": far, "acceleration_3": 2.0 * far}
            change = replace(change, values={**change.values, **rest})
        on = (("MD32490 FRICT_COMP_MODE", 1.0), ("MD32500 FRICT_COMP_ENABLE", 1.0), ("MD32510 FRICT_COMP_ADAPT_ENABLE", float(knee > 0.0)))
        return ForControl((*(Entry(name, value, None, "", "A") for name, value in on), *_numbers(change, axis, control)))
    if knee > 0.0:
        return ForControl(refused="the pulse rises with the acceleration of the reversal; no text in reach says how this control does that")
    unit, factor = AXIS_UNITS[axis.kind].position
    if control == "heidenhain":
        # a pulse of constant speed for MP752 with the area of the decaying one
        old = {"amplitude": 0.0, "decay_time": 0.0} | held(axis, PULSE)
        was = old["amplitude"] * old["decay_time"] * factor
        return ForControl(
            (Entry("MP750", amplitude * decay * factor, was, unit, "C"), Entry("MP752", decay * 1e3, old["decay_time"] * 1e3, "ms", "C")),
            by_hand="the pulse of this control is a rectangle of the same area: tune it by circles; newer controls call it posCtrlRevErr and "
            f"posCtrlRevErrTime, or compStrength = {amplitude * decay * factor:.4g} {unit} with compFFAdjust = compRefAcc = 0",
        )
    return ForControl(
        by_hand=f"no friction pulse exists: build one in HAL from the sign change of joint.N.vel-cmd to pid.N.bias, "
        f"{amplitude * factor:.4g} {unit}/s, decay {decay:.3g} s"
    )


def _set_back(change: Change, machine: Machine, control: str) -> ForControl:
    setting, axis = change.setting, machine.axis(change.axis)
    assert setting is not None
    if block := setting.effect.block_of_control:
        found = apply_effects(with_effects(machine, [setting])).machine
        whole = entries_of(Change(change.axis, block, values=held(axis, block)), found, control)
        if whole != ForControl():
            return replace(whole, entries=tuple(entry for entry in whole.entries if entry.value != entry.old))
    field = DELAY.get(setting.effect.name) or setting.effect.size.multiplies
    datum = (parameter(field).data if field else _WITHOUT_NUMBER.get(setting.effect.name, {})).get(control)
    if datum is None:
        return ForControl(by_hand=f"set back {in_words(setting.effect.name)}: its parameter on this control stands in no text in reach")
    new, old = 0.0, setting.size  # a filter that should not be there
    if setting.effect.name == "inertia":
        new = change.table(machine)["inertia_kg_m2"]
        old = new - setting.size * axis.ratio**2
    elif field:
        new = axis.number(field)
        old = new + old if field in DELAY.values() else new * setting.factor_on(field)
    return ForControl((_entry(datum, axis, new, old),))


DELAY = {"loop_delay": "position_delay_s"}
"""The number to which an effect adds its size; others multiply theirs."""

_WITHOUT_NUMBER = {
    "set_point_filter": {"sinumerik": OnControl("MD32410 AX_JERK_TIME", *alike("s"), "C")},
    "current_filter": {"sinumerik": OnControl("MD1201 current set point filter", *alike("ms", 1e-3), "C")},
    "inertia": {"sinumerik": OnControl("MD32650 AX_INERTIA", *alike("kg m2"), "C")},
}
"""How controls hold deviations that are none of a number of the loops, by effect."""


def datum_lines(machine: Machine, moved: Mapping[str, tuple[float, float]]) -> list[list[str]]:
    """Axis, number, SINUMERIK datum, unit, old and new value of numbers of the loops that change in three digits, by key of the machine file."""
    rows = []
    for key, values in moved.items():
        _, name, _, field = key.split(".")
        nameless = OnControl("-", *(alike("ms", 1e-3) if field.endswith("_s") else alike("1")))
        datum, rotary = parameter(f"loops.{field}").data.get("sinumerik", nameless), machine.axis(name).kind == "rotary"
        if len({plain(value / datum.si[rotary]) for value in values}) > 1:
            rows.append([name, field, datum.name, datum.units[rotary], *(plain(value / datum.si[rotary], 4) for value in values)])
    return rows


def _table(change: Change, axis: Axis, control: str) -> ForControl:
    """The table of a correction, or why its wave does not fit into a table of this control."""
    v, most = change.values, MOST_POINTS.get(control, math.inf)
    table = correction_table(change, axis)
    if len(table.positions) > 2 and not table.modulo and not all(map(math.isfinite, axis.travel)):
        return ForControl(refused="its wave does not repeat after a turn of the axis, so no table of a turn holds it")
    if len(table.positions) > most:
        fewest = math.ceil((table.positions[-1] - table.positions[0]) / v["wavelength"] * FEWEST_A_WAVE) + 1
        if fewest > most:
            return ForControl(refused=f"its wave needs {fewest} points, {FEWEST_A_WAVE} a period; a table of this control takes {most}")
        table = correction_table(change, axis, int(most))
    loading = (
        f"MD38000 MM_ENC_COMP_MAX_POINTS must be {len(table.positions)} or more (changing it clears the memory: save first); "
        "load the table with MD32700 ENC_COMP_ENABLE[0] = 0, then set it to 1 and reference the axis"
    )
    return ForControl(table=table, by_hand=loading if control == "sinumerik" else "")


def correction_table(change: Change, axis: Axis, most: int | None = None) -> ErrorTable:
    """The points of a correction: two for a slope alone, else POINTS_A_WAVE a wave over the travel, or `most`; a wave that fits into one turn repeats."""
    v, endless = change.values, not all(map(math.isfinite, axis.travel))
    k, wave = 2.0 * math.pi / v["wavelength"], math.hypot(v["sine"], v["cosine"]) > 0.0  # k: waves in a turn of a rotary axis
    turn = axis.kind == "rotary" and wave and math.isclose(k, round(k), rel_tol=1e-9) and (round(k) == 1 or endless)
    low, high = (0.0, 2.0 * math.pi) if turn or endless else axis.travel
    count = max(math.ceil((high - low) / v["wavelength"] * POINTS_A_WAVE), POINTS_A_TURN if turn else 1) + 1 if wave else 2
    q = np.linspace(low, high, count if most is None else min(count, most))
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
            try:
                files |= _table_files(of.table, machine.axis(change.axis).kind, control, names.index(change.axis), saved)
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
        if heidenhain.holds(text, table.axis):
            return {f"{table.axis}.COM": heidenhain.filled(text, table, kind)}
    raise InputError(f"axis {table.axis}: HEIDENHAIN tables are filled only into a .COM file that the control saved: give it with --saved")


def _data_file(entries: list[tuple[str, Entry]], control: str, names: list[str]) -> dict[str, str]:
    if control == "sinumerik":
        return {"machine_data.ini": sinumerik.archive([(f"AX{names.index(axis) + 1}", e) for axis, e in entries])}
    if control == "heidenhain":
        return {"parameters.txt": heidenhain.parameter_list(entries)}
    if control == "linuxcnc":
        return {"joints.ini": "".join(linuxcnc.ini_lines(names.index(axis), {e.name: e.value}) for axis, e in entries)}
    return {
        "parameters.lis": "".join(
            f"{e.name:<29}{e.value:.9g}  # axis {axis}, {e.unit}{', ' if e.graded else ''}{e.graded}\n" for axis, e in entries
        )
    }
