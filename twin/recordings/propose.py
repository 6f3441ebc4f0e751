"""A map proposed from column names and recorded numbers: units, signs, moving axes.

A column whose name fits but whose numbers do not is doubtful: it becomes a comment in the map and is not used. Columns that do not
move, spin or have an unknown name are listed in the map as well, so that nothing is omitted silently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin.errors import InputError
from twin.recordings.force_sign import force_sign
from twin.recordings.names import Meaning, meaning_of
from twin.recordings.signals import BLOCK, IMPOSSIBLE_VALUE, Recording, Signal
from twin.recordings.timing import timing_of
from twin.units import AXIS_UNITS, RECORDED_UNITS, dimension_recorded

STILL_SI = 2e-6
"""An axis whose set point moves less than this [m or rad] is at rest."""
ONE_WAY_TURNS = 5.0
"""An axis that turns farther than this in one direction is a spindle."""
FOLLOWS = 0.1
"""A position is doubtful if its ratio to the set point or to the other encoder differs from 1 by more."""
APART = 0.02
"""Two encoders that differ by more than this share of their travel do not measure the same motion."""
SAME_SLOPE = 2e-3
"""Relative RMS difference below which a speed set point is only the slope of the position set point, not a controller output."""
_ORDER = ("setpoint", "position", "following_error", "motor_position", "velocity", "velocity_setpoint", "velocity_feedforward",
          "acceleration", "current", "torque", "torque_setpoint", "torque_feedforward", "voltage", "disturbance", "injected_command")  # fmt: skip
_SPEED_UNITS = {
    "linear": {"mm/s": 1.0, "mm/min": 60.0, "m/min": 0.06, "m/s": 1e-3, "um/s": 1e3},
    "rotary": {"deg/s": 1.0, "rad/s": np.pi / 180.0, "deg/min": 60.0, "rev/min": 1.0 / 6.0},
}
"""Number that represents 1 mm/s or 1 deg/s in each unit."""
_NEAR = {"velocity": 1.05, "velocity_feedforward": 1.4, "velocity_setpoint": 2.0}
"""Factor by which a speed may differ from the slope of the position: a feedforward has a weight, and a set point leads (1.17 to 1.5 with a
position loop in the drive)."""


@dataclass(frozen=True)
class Proposed:
    """One column of the map. `doubt`: why it is not used; "" if it is used."""

    name: str
    axis: str
    signal: str
    unit: str
    sign: int = 1
    extra: str = ""  # further keys of the map
    remark: str = ""
    doubt: str = ""


@dataclass
class Proposal:
    """Columns; omitted axes with the reason; columns with unknown names; feedforward in use."""

    columns: list[Proposed] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    feedforward: str | None = None  # of all recordings
    mixed_feedforward: bool = False  # it differs between them

    @property
    def used(self) -> list[Proposed]:
        """Columns without doubt."""
        return [c for c in self.columns if not c.doubt]

    @property
    def axes(self) -> list[str]:
        return list(dict.fromkeys(c.axis for c in self.used))


OWN_COMMANDS = {"velocity_setpoint": "a speed", "torque_setpoint": "a torque"}
"""Commands of an axis without a position loop, which has no set point."""


def propose(recordings: Sequence[Recording]) -> Proposal:
    """Propose the map of these recordings. Raises InputError if times cannot be read."""
    out = Proposal()
    found = _by_meaning(recordings, out)
    for axis in sorted({axis for axis, _ in found}, key=lambda a: (a.isdigit(), int(a) if a.isdigit() else 0, a)):
        own = {signal: one for (a, signal), one in found.items() if a == axis}
        if "setpoint" not in own:
            commanded = " or ".join(word for signal, word in OWN_COMMANDS.items() if signal in own)
            alone = f"; an axis commanded by {commanded} alone has no position loop and cannot be simulated" if commanded else ""
            out.left_out.append(f"axis {axis}: no set point among its columns ({', '.join(name for _, name in own.values())}){alone}")
        else:
            _axis(axis, _signals_of_one_recording(recordings, own), out)
    moving = {c.axis for c in out.used if c.signal == "setpoint"}
    modes = {_feedforward_in(r, [c for c in out.columns if c.axis in moving]) for r in recordings} - {None}
    out.feedforward = modes.pop() if len(modes) == 1 else None
    out.mixed_feedforward = bool(modes)
    return out


def _feedforward_in(recording: Recording, columns: Sequence[Proposed]) -> str | None:
    """The feedforward that a recording shows; None if it has no feedforward signal of these columns."""
    speeds, torques = (
        [recording.signals[c.name] for c in columns if c.signal == signal and c.name in recording.signals]
        for signal in ("velocity_feedforward", "torque_feedforward")
    )
    if not speeds:
        return None
    return "off" if not any(map(_changes, speeds)) else "velocity+torque" if any(map(_changes, torques)) else "velocity"


def _signals_of_one_recording(recordings: Sequence[Recording], own: Mapping[str, tuple[Meaning, str]]) -> dict[str, tuple[Meaning, Signal]]:
    """The signals of an axis from the recording in which its set point moves farthest; signals missing there from another."""

    def travel(recording: Recording) -> float:
        signal = recording.signals.get(own["setpoint"][1])
        return float(np.ptp(_first_block(signal.values))) if signal is not None and _timed(signal) else -1.0

    ranked = sorted(recordings, key=travel, reverse=True)
    return {
        signal: (meaning, next(r.signals[name] for r in ranked if name in r.signals and _timed(r.signals[name])))
        for signal, (meaning, name) in own.items()
    }


def _timed(signal: Signal) -> bool:
    return signal.time is not None and len(signal.values) > 0


def _by_meaning(recordings: Sequence[Recording], out: Proposal) -> dict[tuple[str, str], tuple[Meaning, str]]:
    """(axis, signal) -> meaning and column name."""
    found: dict[tuple[str, str], tuple[Meaning, str]] = {}
    names = list(dict.fromkeys(name for r in recordings for name in r.signals))
    for name in names:
        own = [r.signals[name] for r in recordings if name in r.signals and _timed(r.signals[name])]
        if not own:
            continue
        signal = own[0]
        meaning = meaning_of(name, signal.unit)
        if meaning is None or not meaning.signal:
            parts = [r for r in recordings if r.restarts and name in r.signals]
            (out.labels if parts and _label(signal) else out.unknown).append(name)
            continue
        key = (meaning.axis, meaning.signal)
        if key in found and found[key][0].rank <= meaning.rank:
            out.unknown.append(name)
            continue
        if key in found:
            out.unknown.append(found[key][1])
        found[key] = (meaning, name)
    return found


def _axis(axis: str, found: Mapping[str, tuple[Meaning, Signal]], out: Proposal) -> None:
    """Add the columns of one axis to the proposal, or the reason why it is omitted."""
    names = ", ".join(s.name for _, s in found.values())
    unsound = {signal: place for signal, (_, one) in found.items() if (place := _impossible_value(one))}
    if "setpoint" in unsound:
        out.left_out.append(f"axis {axis}: its set point '{found['setpoint'][1].name}' {unsound['setpoint']}")
        return
    for signal in unsound:
        meaning, one = found[signal]
        out.columns.append(Proposed(one.name, axis, signal, meaning.unit, doubt=unsound[signal]))
    found = {signal: one for signal, one in found.items() if signal not in unsound}
    label = found["setpoint"][1].description
    called = f"axis {axis}" + (f" ({label})" if label else "")
    rows = _longest(found["setpoint"][1])
    time = _first_block(found["setpoint"][1].time)[rows]  # type: ignore[arg-type]
    kind, sure = _kind(found, label)
    unit = {s: meaning.unit or {"linear": "mm", "rotary": "deg"}[kind] for s, (meaning, _) in found.items()}
    values = {signal: _in_mm_or_deg(_interpolated(one, time), unit[signal], kind) for signal, (_, one) in found.items()}
    to_si = RECORDED_UNITS[unit["setpoint"]][1] if dimension_recorded(unit["setpoint"]) in ("length", "angle") else 1e-3
    full = _first_block(found["setpoint"][1].values)
    if float(np.ptp(full)) * to_si < STILL_SI:
        out.left_out.append(f"{called} does not move in this recording ({names})")
        return
    if (turns := _turns(full * to_si, kind, sure)) is not None:
        out.left_out.append(f"{called} spins ({turns:.0f} turns one travel): not a feed axis ({names})")
        return
    out.columns += _columns(axis, kind, found, values, unit, time)


def _columns(
    axis: str,
    kind: str,
    found: Mapping[str, tuple[Meaning, Signal]],
    values: Mapping[str, np.ndarray],
    unit: Mapping[str, str],
    time: np.ndarray,
) -> list[Proposed]:
    """Columns of a moving axis with units, signs and doubts. `values` (sample,) of each signal at `time` [s]: positions in mm or deg, other signals
    in recorded units."""
    setpoint = values["setpoint"]
    other = "deg for a rotary" if kind == "linear" else "mm for a linear"
    assumed = "" if found["setpoint"][0].unit else f"assumed: the file gives no unit; {other} axis"
    period = float(np.median(np.diff(time)))
    if not period > 0.0:
        raise InputError(f"column '{found['setpoint'][1].name}': its time stands still; repair it, or give [time] interval_ms in a map")
    position = next((values[s] for s in ("position", "motor_position") if s in values and np.ptp(values[s]) > 0.0), None)
    if position is None and "following_error" in values:
        position = setpoint - values["following_error"]
    columns: list[Proposed] = []
    for signal in (s for s in _ORDER if s in found):
        meaning, one = found[signal]
        column = Proposed(one.name, axis, signal, unit[signal])
        if signal in ("setpoint", "position", "motor_position", "following_error"):
            column = replace(column, remark=assumed, doubt=_doubt_of_position(signal, values))
        elif not _changes(one):
            column = replace(column, unit=unit[signal] if meaning.unit else "", doubt="it never changes")
        elif signal in _NEAR:
            column = _speed(column, meaning, values[signal], setpoint, position, period, kind)
        elif signal == "acceleration":
            column = replace(column, unit=meaning.unit or f"{unit['setpoint']}/s2")
        elif signal in ("current", "torque", "voltage") and position is not None:
            sign = force_sign(values[signal], position / AXIS_UNITS[kind].position[1], period, kind)
            column = replace(column, sign=sign.sign, remark=sign.remark, doubt=sign.doubt)
        columns.append(column)
    measured = [c for c in columns if c.signal in ("position", "motor_position")]
    if any(not c.doubt for c in measured):
        return [replace(c, doubt="the position itself is recorded") if c.signal == "following_error" else c for c in columns]
    if measured and not any(c.signal == "following_error" for c in columns):
        return [replace(c, doubt=c.doubt or "no usable measured position of this axis") for c in columns]
    return columns


def _in_mm_or_deg(values: np.ndarray, unit: str, kind: str) -> np.ndarray:
    """A length or an angle in mm or degrees; the values of any other unit as they are."""
    return values * RECORDED_UNITS[unit][1] * AXIS_UNITS[kind].position[1] if dimension_recorded(unit) in ("length", "angle") else values


def _doubt_of_position(signal: str, values: Mapping[str, np.ndarray]) -> str:
    """Reason to doubt a position that does not follow the set point or the other encoder; "" if there is none."""
    if signal in ("setpoint", "following_error"):
        return ""
    y = values[signal]
    if not np.ptp(y) > 0.0:
        return "it never changes"
    for other in ("motor_position", "setpoint"):
        if other in values and other != signal and (x := values[other]).any() and np.ptp(x) > 0.0:
            slope, offset = np.polyfit(x - x.mean(), y, 1)
            left = float(np.std(y - offset - slope * (x - x.mean()))) / float(np.ptp(x))
            if other == "motor_position" and signal == "position" and left > APART:
                return f"it differs from the motor encoder by {left:.1%} of the travel (RMS): not the same motion"
            if abs(slope - 1.0) > FOLLOWS and left < 3.0 * FOLLOWS:
                return f"it moves {slope:.3g} times as far as the {other.replace('_', ' ')}: unit, scale or column?"
            if left > 3.0 * FOLLOWS:
                return f"it does not follow the {other.replace('_', ' ')}"
    return ""


def _speed(
    column: Proposed, meaning: Meaning, values: np.ndarray, setpoint: np.ndarray, position: np.ndarray | None, period: float, kind: str
) -> Proposed:
    """Unit and sign of a speed from the slope of the position, or of the set point for a feedforward."""
    base = setpoint if column.signal == "velocity_feedforward" or position is None else position
    if column.signal == "velocity_setpoint" and _is_slope(values, setpoint, period):
        return replace(column, unit=meaning.unit, doubt="it is the slope of the set point, not the output of a controller")
    step = max(1, min(round(0.02 / period), len(values) // 4))
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))]) * period
    v, x = summed[step:] - summed[:-step], base[step:] - base[:-step]
    xx, xy, vv = float(x @ x), float(x @ v), float(v @ v)
    if xx <= 0.0 or vv <= 0.0 or xy**2 < 0.5 * xx * vv:
        return replace(
            column, unit=meaning.unit, doubt=f"it is not correlated with the slope of the {'set point' if base is setpoint else 'position'}"
        )
    ratio = xy / xx  # recorded per (unit of the position)/s
    sign = 1 if ratio > 0.0 else -1
    remark = "sign reversed: it runs against the motion" if sign < 0 else ""
    if meaning.unit:
        return replace(column, unit=meaning.unit, sign=sign, remark=remark)
    units = _SPEED_UNITS[kind]
    nearest = min(units, key=lambda u: abs(np.log(abs(ratio) / units[u])))
    if abs(np.log(abs(ratio) / units[nearest])) <= np.log(_NEAR[column.signal]):
        found = "" if nearest in ("mm/s", "deg/s") else "unit from the slope of the position"
        return replace(column, unit=nearest, sign=sign, remark=remark or found)
    travel = 60.0 / abs(ratio)  # a motor in rev/min
    key = "mm_per_rev" if kind == "linear" else "deg_per_rev"
    return replace(
        column, unit="rev/min", sign=sign, extra=f"{key} = {travel:.6g}", remark=f"read as rev/min of a motor: travel per revolution from the slope of the position; {remark}".rstrip("; ")
    )  # fmt: skip


def _is_slope(values: np.ndarray, setpoint: np.ndarray, period: float) -> bool:
    """True if a speed is a forward, backward or central difference of set points, in any unit."""
    forward = np.diff(setpoint)[1:] / period
    backward = np.diff(setpoint)[:-1] / period
    v = values[1:-1]
    for slope in (forward, backward, 0.5 * (forward + backward)):
        xx = float(slope @ slope)
        if xx > 0.0 and np.std(v - float(slope @ v) / xx * slope) < SAME_SLOPE * np.std(v):
            return True
    return False


def _kind(found: Mapping[str, tuple[Meaning, Signal]], label: str) -> tuple[str, bool]:
    """(linear or rotary, True if a unit shows it). Without a unit the label decides: A, B, C are rotary."""
    for signal in ("setpoint", "position", "motor_position", "velocity"):
        if signal in found and (unit := found[signal][0].unit):
            named = dimension_recorded(unit)
            if named in ("length", "speed", "angle", "angular speed"):
                return ("rotary" if named.startswith("ang") else "linear"), True
    first = label.strip()[:1].upper() if len(label.strip()) <= 2 else found["setpoint"][0].axis[:1].upper()
    return ("rotary" if first in ("A", "B", "C") else "linear"), False


def _turns(travel: np.ndarray, kind: str, sure: bool) -> float | None:
    """Revolutions of an axis that turns far in one direction only, else None. `travel` in SI (1e-3 of the recorded number if its unit is unknown)."""
    steps = np.diff(travel)
    total, net = float(np.abs(steps).sum()), abs(float(travel[-1] - travel[0]))
    if net < 0.98 * total:
        return None
    if kind == "linear" and sure:
        return None
    turns = total / (2.0 * np.pi) if kind == "rotary" else total * 1e3 / 360.0
    return turns if turns > ONE_WAY_TURNS else None


def _impossible_value(signal: Signal) -> str:
    """Text on the first NaN, infinite or impossible value of a column; "" if there is none."""
    for first, values in signal.blocks():
        bad = ~(np.abs(values) < IMPOSSIBLE_VALUE)
        if bad.any():
            row = int(np.argmax(bad))
            return f"holds {values[row]:g} at sample {first + row + 1}: repair it"
    return ""


def _first_block(column: object) -> np.ndarray:
    """The first block of a column."""
    return np.asarray(column[0:BLOCK], float)  # type: ignore[index]


def _longest(signal: Signal) -> slice:
    """Rows of the longest stretch without a gap, preferably one in which the signal moves."""
    assert signal.time is not None
    timing = timing_of(_first_block(signal.time), signal.name, period_s=None)
    values = _first_block(signal.values)
    best = max(timing.stretches, key=lambda s: (float(np.ptp(values[s.first : s.first + s.count])) > 0.0, s.count))
    return slice(best.first, best.first + best.count)


def _interpolated(signal: Signal, time: np.ndarray) -> np.ndarray:
    """Values at these times, linear between samples."""
    own, values = _first_block(signal.time), _first_block(signal.values)
    if len(own) < 2:
        raise InputError(f"column '{signal.name}' has {len(own)} sample{'s' * (len(own) != 1)}; a trace needs at least two")
    return np.interp(time, own, values)


def _changes(signal: Signal) -> bool:
    return float(np.ptp(_first_block(signal.values))) > 0.0


def _label(signal: Signal) -> bool:
    """True if a column is constant within the parts of a file and differs between them."""
    values = np.asarray(signal.values[0 : len(signal.values)], float)
    changes = np.flatnonzero(np.diff(values) != 0.0)
    return 0 < len(changes) < len(values) / 20
