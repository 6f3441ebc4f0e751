"""Machine data of a SINUMERIK 840D with 611D drives, as an alternative to the plain keys of a machine file.

An axis may have a table of machine data by number or name:

[axis.X.sinumerik]
MD32200 = 3.0            # POSCTRL_GAIN [1000/min]
SPEEDCTRL_GAIN_1 = 3.4   # MD1407 [Nms/rad]

Each datum replaces a plain key: plain = factor * datum. If a file gives both, they must agree. `read_machine_data` also reads
archives of machine data (lines `N32200 $MA_POSCTRL_GAIN[0,AX1]=3`). MD32620 FFW_MODE selects the feedforward. Data without a
counterpart in the twin's control law (filters, adaptations, motor data per phase) are ignored.
"""

from collections.abc import Iterator, Mapping
import copy
import math
from pathlib import Path
import re
from typing import Any

from twin.control.number import Datum
from twin.documents import read_toml, value_at
from twin.errors import InputError, nearest, no_file
from twin.machine.parameters import machine_data_of
from twin.tables import is_number

DATA = {kind: machine_data_of(kind) for kind in ("linear", "rotary")}
"""Machine data by kind of axis, from the table of parameters."""

# cycles of control and drive, not of an axis; in units of 31.25 us, in s, or as multiples
CYCLE_UNIT_US = 31.25
GEAR_DENOMINATOR = Datum(31050, "DRIVE_AX_RATIO_DENOM", "1", "", 1.0)
GEAR_NUMERATOR = Datum(31060, "DRIVE_AX_RATIO_NUMERA", "1", "", 1.0)
FFW_MODE = Datum(32620, "FFW_MODE", "-", "", 1.0)
DSC_ENABLE = Datum(32640, "STIFFNESS_CONTROL_ENABLE", "-", "", 1.0)
WITHOUT_KEY = (GEAR_DENOMINATOR, GEAR_NUMERATOR, FFW_MODE, DSC_ENABLE)
"""Machine data of an axis that change the keys of other data."""
CYCLES = {
    1000: "CURRCTRL_CYCLE_TIME",
    1001: "SPEEDCTRL_CYCLE_TIME",
    10050: "SYSCLOCK_CYCLE_TIME",
    10060: "POSCTRL_SYSCLOCK_TIME_RATIO",
    10070: "IPO_SYSCLOCK_TIME_RATIO",
}
DIVISORS = (1113, 31030, GEAR_DENOMINATOR.number, GEAR_NUMERATOR.number)
"""Data that serve as divisors and must not be 0."""

_EQUAL = 1e-6
_KEY = re.compile(r"^(?:MD)?_?(\d{4,5})(?:_\w+)?$", re.IGNORECASE)
_ARCHIVE_LINE = re.compile(r"^\s*N?(\d{4,5})\s+\$M([AND])_(\w+)(?:\[([^\]]*)\])?\s*=\s*\"?([^\s\";']+)")


def by_number(table: Mapping[str, Any], kind: str, where: str) -> dict[int, float]:
    """Machine data of one axis by number; the file may give numbers or names."""
    known = {d.number: d.name for d in (*DATA[kind], *WITHOUT_KEY)}
    names = [*known.values(), *CYCLES.values()]
    out: dict[int, float] = {}
    for key, value in table.items():
        number = _number_of(key, kind)
        if number in CYCLES:
            raise InputError(
                f"{where}: {key} belongs to the whole control, not to an axis; give the cycle in [control] of the machine file"
            )
        if number not in known:
            raise InputError(f"{where}: '{key}' has no counterpart in the twin; {nearest(key, [*names, *(f'MD{n}' for n in known)])}")
        if not is_number(value):
            raise InputError(f"{where}: {key} = {value!r}: expected a number")
        _check_divisor(number, value, where)
        if number in out:
            raise InputError(f"{where}: MD{number} is given twice, by number and by name; keep one")
        out[number] = float(value)
    return out


def _number_of(key: str, kind: str) -> int | None:
    """Number of a machine datum that the file gives by number or by name; None if unknown."""
    if match := _KEY.match(key):
        return int(match[1])
    names = {d.name: d.number for d in (*DATA[kind], *WITHOUT_KEY)} | {name: number for number, name in CYCLES.items()}
    return names.get(key.upper())


def _check_divisor(number: int, value: float, where: str) -> None:
    if number in DIVISORS and value <= 0.0:
        raise InputError(f"{where}: MD{number} = {value:g}: impossible; give a number above 0")


def plain_values(data: Mapping[int, float], kind: str) -> dict[str, Any]:
    """Plain keys below the axis (dotted) with the values of the machine data."""
    out: dict[str, Any] = {d.key: d.factor * data[d.number] for d in DATA[kind] if d.number in data}
    ratio = data.get(GEAR_NUMERATOR.number, 1.0) / data.get(GEAR_DENOMINATOR.number, 1.0)
    if kind == "rotary" and {GEAR_NUMERATOR.number, GEAR_DENOMINATOR.number} & data.keys():
        out["gear_ratio"] = ratio
    elif "screw_lead_m_per_rev" in out:
        out["screw_lead_m_per_rev"] /= ratio  # per motor revolution
    if FFW_MODE.number in data:
        mode = int(data[FFW_MODE.number])
        if mode == 0:
            out["loops.velocity_feedforward"] = 0.0
        else:
            out.setdefault("loops.velocity_feedforward", 1.0)
        out["loops.torque_feedforward"] = 1.0 if mode in (2, 4) else 0.0
    if data.get(DSC_ENABLE.number) == 0.0:
        out.pop("loops.dsc_delay_s", None)  # the delay has no effect while MD32640 is 0
    return out


def with_plain_keys(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """An axis table with its `sinumerik` table replaced by plain keys. Raises InputError if two values disagree."""
    plain = copy.deepcopy(dict(table))
    given = plain.pop("sinumerik")
    kind = plain.get("kind")
    if not isinstance(given, Mapping) or not isinstance(kind, str) or kind not in DATA:
        raise InputError(f"{where[:-1]}.sinumerik]: must be a table of machine data of an axis with a kind")
    for key, value in plain_values(by_number(given, kind, f"{where[:-1]}.sinumerik]"), kind).items():
        *tables, last = key.split(".")
        target: Any = plain
        if last in ("0", "1"):
            target = target.setdefault(tables[0], [None, None])
            if not isinstance(target, list) or len(target) != 2:
                raise InputError(f"{where}: {tables[0]} = {target!r} and software limits in [sinumerik] disagree; keep one")
            slot: Any = int(last)
            present = target[slot] is not None
        else:
            for name in tables:
                target = target.setdefault(name, {})
                if not isinstance(target, dict):
                    raise InputError(f"{where[:-1]}.{name}]: must be a table; machine data in [sinumerik] belong in it")
            slot, present = last, last in target
        old = target[slot] if present else value
        if isinstance(old, int | float) and not math.isclose(old, value, rel_tol=_EQUAL, abs_tol=1e-12):
            raise InputError(f"{where}: {key} = {old:g} and its machine datum ({value:g}) disagree; keep one")
        target[slot] = value
    for key in ("travel_m", "travel_deg"):
        if isinstance(plain.get(key), list) and None in plain[key]:
            raise InputError(f"{where}: only one of MD36100 and MD36110 is given; give both ends of the travel")
    return plain


def datum_in_file(table: Mapping[str, Any], key: str, value: Any) -> tuple[str, Any] | None:
    """Place of a plain key that the file gives only as a machine datum: (key below the axis, value there); None otherwise."""
    given = table.get("sinumerik")
    if not isinstance(given, Mapping) or table.get("kind") not in DATA:
        return None
    written = {_number_of(name, table["kind"]): name for name in given}
    datum = next((d for d in DATA[table["kind"]] if d.key == key and d.number in written), None)
    gear = GEAR_NUMERATOR.number, GEAR_DENOMINATOR.number
    shared = (
        (key == "gear_ratio")
        or (key.endswith("_feedforward") and FFW_MODE.number in written)
        or (key == "screw_lead_m_per_rev" and any(number in written for number in gear))
    )
    if datum is None or shared or not isinstance(value, int | float):
        return None
    return f"sinumerik.{written[datum.number]}", value / datum.factor


def machine_data(table: Mapping[str, Any]) -> list[tuple[Datum, float]]:
    """Machine data of an axis table in plain keys, as far as it has values."""
    out = []
    for datum in DATA[table["kind"]]:
        if isinstance(value := value_at(table, datum.key), int | float):
            out.append((datum, value / datum.factor))
    loops = table.get("loops", {})
    torque, velocity = loops.get("torque_feedforward", 0.0), loops.get("velocity_feedforward", 0.0)
    if loops.get("dsc_delay_s", 0.0):
        out.append((DSC_ENABLE, 1.0))
    return [*out, (FFW_MODE, 4.0 if torque else 3.0 if velocity else 0.0)]


def control_cycles(data: Mapping[int, float]) -> dict[str, float]:
    """Keys of `[control]` from machine data."""
    out = {}
    for number, key in ((1000, "current_cycle_us"), (1001, "speed_cycle_us")):
        if number in data:
            out[key] = CYCLE_UNIT_US * data[number]
    if 10050 in data:
        for number, key in ((10060, "position_cycle_us"), (10070, "interpolation_cycle_us")):
            if number in data:
                out[key] = data[10050] * data[number] * 1e6
    return out


def read_machine_data(path: Path, axes: Mapping[str, str]) -> tuple[dict[str, dict[int, float]], list[str]]:
    """Machine data of each axis from a TOML (`[X]` or `[axis.X]` tables) or an archive, and the data that were ignored.

    `axes` maps axis names to kinds. In an archive AX1 is the first of them, unless AXCONF_MACHAX_NAME_TAB names another. Data
    without an axis (cycles) have the key ''.
    """
    if not path.is_file():
        raise no_file(path, "give machine data as TOML or as an archive of the control")
    if path.suffix.lower() == ".toml":
        document = read_toml(path)
        tables = document.get("axis", document)
        if not isinstance(tables, Mapping):
            raise InputError(f"{path}: axis = {tables!r} is not a table; write [axis.X] and the data below it")
        out = {}
        for name, table in tables.items():
            if name not in axes:
                raise InputError(f"{path}: [{name}]: no such axis; {nearest(str(name), axes)}")
            given = table.get("sinumerik", table) if isinstance(table, Mapping) else {}
            out[name] = by_number(given, axes[name], f"{path}: [{name}]")
        return out, []
    return _read_archive(path.read_text(encoding="utf-8", errors="replace"), path, axes)


def _read_archive(text: str, path: Path, axes: Mapping[str, str]) -> tuple[dict[str, dict[int, float]], list[str]]:
    names = list(axes)
    of_index = {f"AX{i + 1}": name for i, name in enumerate(names)}
    out: dict[str, dict[int, float]] = {}
    left: list[str] = []
    lines = list(archive_values(text))
    if not lines:
        raise InputError(f"{path}: no line like N32200 $MA_POSCTRL_GAIN[0,AX1]=3; give an archive of machine data, or a TOML")
    for number, _, index, value in lines:
        if number == 10000 and index[0].isdigit():  # AXCONF_MACHAX_NAME_TAB[0]="X1"
            same = [n for n in names if value in (n, f"{n}1")]
            of_index[f"AX{int(index[0]) + 1}"] = same[0] if same else ""  # a spindle, for example
            continue
        axis = of_index.get(index[-1], index[-1] if index[-1] in axes else "")
        known = {d.number for d in (*DATA[axes[axis]], *WITHOUT_KEY)} if axis else set(CYCLES)
        first = len(index) < 2 or index[0] in ("", "0")  # parameter set 0 is the active one
        try:
            number_value = float(value)
        except ValueError:
            continue
        if number in known and first:
            _check_divisor(number, number_value, f"{path}: axis {axis}")
            out.setdefault(axis, {})[number] = number_value
        elif number not in known:
            left.append(f"MD{number}")
    return out, sorted(set(left))


def archive_values(text: str) -> Iterator[tuple[int, str, list[str], str]]:
    """Number, area (A: an axis, N: the control), indices and value of each datum of an archive."""
    for line in text.splitlines():
        if match := _ARCHIVE_LINE.match(line):
            yield int(match[1]), match[2], [part.strip() for part in (match[4] or "").split(",")], match[5]
