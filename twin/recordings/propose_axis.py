"""Proposed columns of one axis: roles by names and numbers, then units, signs and doubts.

A column whose name fits but whose numbers do not is doubtful: it becomes a comment in the map and is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import re

import numpy as np

from twin.errors import InputError
from twin.recordings import relations
from twin.recordings.force_sign import force_sign
from twin.recordings.names import Meaning
from twin.recordings.relations import moves
from twin.recordings.roles import ORDER, Candidate, Role, Roles, assign
from twin.recordings.roughness import SECOND_DIFFERENCE, roughness
from twin.recordings.signals import BLOCK, IMPOSSIBLE_VALUE, Signal
from twin.recordings.timing import timing_of
from twin.recordings.units_found import Scale, counts, position_scale, speed_unit
from twin.units import AXIS_UNITS, RECORDED_UNITS, dimension_recorded

MOST_ROWS = 1 << 14
"""Samples that are compared: those of the longest stretch around the most motion."""
ONE_WAY_TURNS = 5.0
"""An axis that turns farther than this in one direction is a spindle."""
FOLLOWS = 0.1
"""A position is doubtful if its ratio to the set point or to the other encoder differs from 1 by more."""
APART = 0.02
"""Two encoders that differ by more than this share of their travel do not measure the same motion."""
CLEAR, UNLIKE = 0.02, 0.5
"""Unexplained share of the variance below which a ratio of two positions is clear, and above which one does not follow the other."""
COUNTED = 0.2
"""Share by which counts per second may differ from the slope of counts: few samples and whole numbers are coarse."""
POSITIONS = ("setpoint", "position", "motor_position", "following_error")
SPEEDS = ("velocity", "velocity_setpoint", "velocity_feedforward")
FORCES = ("current", "torque", "voltage")
PROFILE = "speed of the profile (slope of the set point), no output of a controller: no gain follows from it"
_JOINT = re.compile(r"joint|robot|(^|[_. ])q(d|dd)?([_. (\[]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Proposed:
    """One column of the map. `reason`: evidence in a sentence; `second`: next best signal; `doubt`: why it is not used; "" if it is used.

    `assumed`: what nobody states and no number shows about its unit.
    """

    name: str
    axis: str
    signal: str
    unit: str
    sign: int = 1
    extra: tuple[str, ...] = ()  # further keys of the map
    remark: str = ""
    doubt: str = ""
    reason: str = ""
    second: str = ""
    assumed: str = ""


@dataclass
class AxisProposal:
    """Columns of an axis, or the reason why it is omitted; columns without a use; remarks and questions."""

    columns: list[Proposed] = field(default_factory=list)
    left_out: str = ""
    unused: dict[str, str] = field(default_factory=dict)  # column -> reason, "" if there is none
    notes: list[str] = field(default_factory=list)
    speed: tuple[str, float, float] | None = None  # unit of the position, factor of a speed without unit against its slope, interval [s]
    score: float = 0.0


def propose_axis(axis: str, signals: Sequence[Signal], meanings: Mapping[str, Meaning], timed: bool = True) -> AxisProposal:
    """The proposal for the columns of one axis. `timed`: their times are seconds, not row numbers."""
    out = AxisProposal()
    labels = [s.description for s in signals if s.name in meanings and meanings[s.name].signal == "setpoint"]
    label = labels[0] if labels else ""
    called = f"axis {axis}" + (f" ({label})" if label else "")
    names = ", ".join(s.name for s in signals if s.name in meanings)
    sound = []
    for one in signals:
        if place := _impossible_value(one):
            meaning = meanings.get(one.name)
            if meaning is None:
                out.unused[one.name] = place
            elif meaning.signal == "setpoint":
                out.left_out = f"{called}: its set point '{one.name}' {place}"
                return out
            else:
                out.columns.append(Proposed(one.name, axis, meaning.signal, meaning.unit, doubt=place))
        else:
            sound.append(one)
    lead = _lead(sound, meanings)
    if lead is None:
        out.left_out = f"{called} does not move in this recording ({names})" if names else f"{called}: nothing moves"
        return out
    time = _times(lead)
    period = float(np.median(np.diff(time)))
    if not period > 0.0:
        raise InputError(f"column '{lead.name}': its time stands still; repair it, or give [time] interval_ms in a map")
    values = {one.name: _in_mm_or_deg(_interpolated(one, time), _unit(one, meanings)) for one in sound}
    bits = _sign_bits(values, sound, meanings)
    guess = _kind_of_units(meanings.values(), label or axis)
    stated = {one.name: one.unit for one in sound}
    for name in [n for n, v in values.items() if n not in meanings and moves(v)]:
        if (
            why := "a switch"
            if relations.switches(values[name])
            else "increases evenly: counts or a time"
            if relations.even_step(values[name])
            else ""
        ):
            out.unused[name] = why
            del values[name]
    candidates = [Candidate(n, _signed(v, bits.get(n)), meanings.get(n), stated[n]) for n, v in values.items()]
    roles = assign(candidates, period, guess[0], timed)
    motion = next((roles.roles[s] for s in ("setpoint", "position", "motor_position", "velocity") if s in roles.roles), None)
    if motion is None:
        out.left_out = f"{called}: no motion among its columns ({', '.join(s.name for s in sound[:8])})"
        return out
    out.score = roles.score
    if motion.signal != "velocity":
        if _rests(roles):
            out.left_out = f"{called} does not move in this recording ({names})"
            return out
        whole = next(_first_block(one.values) for one in sound if one.name == motion.column.name)
        if re.fullmatch(r"S\d?", axis) or (turns := _turns(whole, guess, motion.column.meaning)) is not None:
            how = "by its name" if re.fullmatch(r"S\d?", axis) else f"({turns:.0f} turns one travel)"
            out.left_out = f"{called} spins {how}: not a feed axis ({names})"
            return out
    out.columns += _columns(axis, roles, guess, period, timed, bits, out)
    out.unused |= {c.name: _why_unused(c, roles) for c in roles.unused}
    out.unused |= {copy: f"equal to '{original}' in every sample" for copy, original in roles.same.items()}
    if roles.doubt:
        out.notes.append(f"{axis}: {roles.doubt}")
    return out


def _columns(
    axis: str, roles: Roles, guess: tuple[str, bool], period: float, timed: bool, bits: Mapping[str, int], out: AxisProposal
) -> list[Proposed]:
    """Columns of a moving axis with units, signs and doubts."""
    recorded = {signal: role.column.values for signal, role in roles.roles.items()}
    base = next((recorded[s] for s in ("motor_position", "position") if s in recorded and moves(recorded[s])), None)
    if base is None and {"setpoint", "following_error"} <= set(recorded):
        base = recorded["setpoint"] - recorded["following_error"]
    base = base if base is not None else recorded.get("setpoint")
    factors = (
        {s: relations.slope(recorded[s], base, period).factor for s in SPEEDS if s in recorded and moves(recorded[s])}
        if base is not None
        else {}
    )
    units = {s: role.column.meaning.unit if role.column.meaning is not None else role.column.unit for s, role in roles.roles.items()}
    scale = _scale(roles, base, [f for s, f in factors.items() if not units.get(s) and timed], guess, axis)
    kind = guess[0] if guess[1] else ("rotary" if RECORDED_UNITS[scale.unit][0] == "angle" else "linear")
    if base is not None and "velocity" in factors and not units.get("velocity"):
        out.speed = (scale.unit, factors["velocity"] / scale.factor, period)
    columns = []
    for signal, role in roles.roles.items():
        column = Proposed(role.column.name, axis, signal, units.get(signal, ""), reason=role.reason, second=role.second)
        if role.column.name in bits:
            column = replace(column, extra=(f"sign_bit = {bits[role.column.name]}",))
        if signal in POSITIONS:
            column = _position(column, scale, recorded)
        elif not moves(role.column.values):
            column = replace(column, doubt="it never changes")
        elif signal in SPEEDS:
            column = _speed(column, role, scale, recorded, base, period, kind)
        elif signal == "acceleration":
            column = replace(column, unit=column.unit or f"{scale.unit if scale.unit in ('mm', 'm', 'um', 'deg', 'rad') else 'mm'}/s2")
        elif signal == "voltage" and relations.supplies(role.column.values):
            column = replace(column, doubt=f"it stays near {role.column.values.mean():.4g}: a supply, no command")
        else:
            column = _force(column, role, base, recorded, period, kind)
        if (limit := relations.stuck_at(role.column.values)) is not None and role.column.name not in bits and not column.doubt:
            share = np.count_nonzero(role.column.values == limit) / len(role.column.values)
            column = replace(column, doubt=f"it stands at {limit:.0f}, the end of its counter, in {share:.0%} of the samples")
        columns.append(column)
    return _without_double(columns)


def _without_double(columns: list[Proposed]) -> list[Proposed]:
    """A following error is not needed beside a position; without a sound position a set point alone says nothing."""
    measured = [c for c in columns if c.signal in ("position", "motor_position")]
    if any(not c.doubt for c in measured):
        return [
            replace(c, doubt=c.doubt or "the position itself is recorded")
            if c.signal == "following_error" and _has(columns, "setpoint")
            else c
            for c in columns
        ]
    if measured and not any(c.signal == "following_error" and not c.doubt for c in columns):
        return [replace(c, doubt=c.doubt or "no usable measured position of this axis") for c in columns]
    return columns


def _has(columns: Sequence[Proposed], signal: str) -> bool:
    return any(c.signal == signal and not c.doubt for c in columns)


def _scale(roles: Roles, base: np.ndarray | None, factors: list[float], guess: tuple[str, bool], axis: str) -> Scale:
    """Unit of the positions: stated, or of the numbers."""
    stated = [
        r.column.meaning.unit for s, r in roles.roles.items() if s in POSITIONS and r.column.meaning is not None and r.column.meaning.unit
    ]
    if stated and dimension_recorded(stated[0]) in ("length", "angle"):
        return Scale("mm" if dimension_recorded(stated[0]) == "length" else "deg", 1.0, "", True)  # they were converted
    if base is None:
        return Scale("deg" if guess[0] == "rotary" else "mm", sure=True)
    joint = any(_JOINT.search(r.column.name) for r in roles.roles.values())
    measured = next((roles.roles[s].column.values for s in ("position", "motor_position", "setpoint") if s in roles.roles), base)
    if guess[1]:  # the kind is known by a speed with a unit
        return Scale("deg" if guess[0] == "rotary" else "mm", 1.0, f"taken as {'deg' if guess[0] == 'rotary' else 'mm'} beside its speed")
    all_whole = all(relations.whole(r.column.values) for r in roles.roles.values())
    return position_scale(measured, factors, guess[0] == "rotary", joint, all_whole)


def _position(column: Proposed, scale: Scale, recorded: Mapping[str, np.ndarray]) -> Proposed:
    """Unit and doubt of a position."""
    doubt = _doubt_of_position(column.signal, recorded)
    if column.unit:
        return replace(column, doubt=doubt)
    extra = (*column.extra, f"scale = {scale.factor:.9g}") if scale.factor != 1.0 else column.extra
    return replace(column, unit=scale.unit, extra=extra, remark=scale.reason, doubt=doubt, assumed="" if scale.sure else scale.reason)


def _speed(
    column: Proposed, role: Role, scale: Scale, recorded: Mapping[str, np.ndarray], base: np.ndarray | None, period: float, kind: str
) -> Proposed:
    """Signal, unit and sign of a speed."""
    values, s = role.column.values, recorded.get("setpoint")
    if column.signal == "velocity_setpoint" and s is not None and _is_profile(values, s, base, period):
        column = replace(
            column,
            signal="velocity_feedforward" if "velocity_feedforward" not in recorded else column.signal,
            remark=PROFILE,
            reason=PROFILE,
        )
        if column.signal == "velocity_setpoint":
            return replace(column, doubt=PROFILE)
    if column.signal == "velocity_feedforward" and role.column.meaning is None:
        column = replace(column, remark=PROFILE)
    if base is None:
        return replace(column, unit=column.unit or "rev/min", assumed="" if column.unit else "nothing states its unit: taken as rev/min")
    x = s if column.signal == "velocity_feedforward" and s is not None else base
    found = relations.slope(values, x, period)
    if found.left > 0.5:
        return replace(column, doubt=f"it is not correlated with the slope of the {'set point' if x is s else 'position'}")
    sign = 1 if found.factor > 0.0 else -1
    remark = "; ".join(part for part in (column.remark, "sign reversed: it runs against the motion" if sign < 0 else "") if part)
    if column.unit:
        return replace(column, sign=sign, remark=remark)
    if scale.factor != 1.0 and relations.whole(values) and abs(abs(found.factor) - 1.0) < COUNTED:  # counts and counts per second
        return replace(column, unit=f"{scale.unit}/s", sign=sign, extra=(*column.extra, f"scale = {scale.factor:.9g}"), remark=remark)
    unit, travel = speed_unit(scale.unit, found.factor / scale.factor, column.signal, kind)
    if not travel:
        return replace(column, unit=unit, sign=sign, remark=remark or f"{unit} by the slope of the position")
    key = "mm_per_rev" if kind == "linear" else "deg_per_rev"
    said = (
        "read as rev/min of a motor: travel per revolution from the slope of the position"
        if travel != 360.0
        else "turns of the axis itself"
    )
    return replace(column, unit=unit, sign=sign, extra=(*column.extra, f"{key} = {travel:.6g}"), remark=f"{said}; {remark}".rstrip("; "))


def _is_profile(values: np.ndarray, s: np.ndarray, x: np.ndarray | None, period: float) -> bool:
    """True if a speed set point is only the slope of the set point: the following error adds nothing to it."""
    if relations.is_slope(values, s, period):
        return True
    if x is None or x is s:
        return False
    found = relations.law(values, s, x, period)
    return found.left_without < 0.3 and 2.0 * found.left > found.left_without


def _force(column: Proposed, role: Role, base: np.ndarray | None, recorded: Mapping[str, np.ndarray], period: float, kind: str) -> Proposed:
    """Unit and sign of a current, torque or voltage."""
    unit, assumed = column.unit, ""
    if role.column.meaning is None and not unit:
        unit = {"current": "A", "torque": "Nm", "voltage": "V"}[column.signal]
        assumed = f"nothing states its unit: taken as {unit}"
        if column.signal == "current" and counts(role.column.values) and np.abs(role.column.values).max() > 200.0:
            unit, assumed = "mA", f"whole numbers up to {np.abs(role.column.values).max():.0f}: taken as mA"
    unit = unit or {"torque_setpoint": "Nm", "torque_feedforward": "Nm"}.get(column.signal, "A")
    if column.signal not in FORCES:
        return replace(column, unit=unit)
    if base is None and "velocity" in recorded:
        base = np.cumsum(recorded["velocity"]) * period
    if base is None:
        return replace(column, unit=unit, assumed=assumed)
    in_si = RECORDED_UNITS[AXIS_UNITS[kind].position[0]][1]
    found = force_sign(role.column.values, base * in_si, period, kind)
    return replace(column, unit=unit, sign=found.sign, remark=found.remark or assumed, doubt=found.doubt, assumed=assumed)


def _doubt_of_position(signal: str, values: Mapping[str, np.ndarray]) -> str:
    """Reason to doubt a position that does not follow the set point or the other encoder; "" if there is none."""
    if signal in ("setpoint", "following_error"):
        return ""
    y = values[signal]
    if not moves(y):
        return "it never changes"
    for other in ("motor_position", "setpoint"):
        if other in values and other != signal and moves(x := values[other]):
            found = relations.follows(y, x)
            apart = np.sqrt(found.left) * float(np.std(y)) / float(np.ptp(x))
            if other == "motor_position" and signal == "position" and apart > APART:
                return f"it differs from the motor encoder by {apart:.1%} of the travel (RMS): not the same motion"
            if found.left < CLEAR and abs(found.factor - 1.0) > FOLLOWS and abs(relations.follows_in_part(y, x).factor - 1.0) > FOLLOWS:
                return f"it moves {found.factor:.3g} times as far as the {other.replace('_', ' ')}: unit, scale or column?"
            if found.left > UNLIKE:
                return f"it does not follow the {other.replace('_', ' ')}"
    return ""


def _why_unused(c: Candidate, roles: Roles) -> str:
    if c.meaning is not None and c.meaning.signal in roles.roles:
        return f"'{roles.roles[c.meaning.signal].column.name}' is the {c.meaning.signal.replace('_', ' ')}"
    return "constant" if not moves(c.values) else ""


def _kind_of_units(meanings: object, label: str) -> tuple[str, bool]:
    """(linear or rotary, True if a unit shows it). Without a unit the label decides: A, B, C are rotary."""
    for meaning in meanings:  # type: ignore[attr-defined]
        if meaning.unit and meaning.signal in (*POSITIONS, *SPEEDS):
            named = dimension_recorded(meaning.unit)
            if named in ("length", "speed", "angle", "angular speed"):
                return ("rotary" if named.startswith("ang") else "linear"), True
    return ("rotary" if len(label.strip()) <= 2 and label.strip()[:1].upper() in ("A", "B", "C") else "linear"), False


def _rests(roles: Roles) -> bool:
    """True if what moves is within the noise of the recording itself."""
    place = {s: roles.roles[s].column.values for s in ("setpoint", "position", "motor_position") if s in roles.roles}
    measured = next((v for s, v in place.items() if s != "setpoint"), None)
    moved = place.get("setpoint", measured)
    if moved is None or not moves(moved):
        return True
    noise = roughness(measured) / np.sqrt(SECOND_DIFFERENCE) if measured is not None and moves(measured) else 0.0
    return float(np.ptp(moved)) < STILL * noise


STILL = 6.0
"""Travel in standard deviations of the position's noise below which an axis stands still."""


def _turns(values: np.ndarray, guess: tuple[str, bool], meaning: Meaning | None) -> float | None:
    """Revolutions of an axis that turns far in one direction only, else None."""
    steps = np.diff(values)
    total, net = float(np.abs(steps).sum()), abs(float(values[-1] - values[0]))
    if net < 0.98 * total or (guess[0] == "linear" and guess[1]):
        return None
    unit = meaning.unit if meaning is not None and meaning.unit else "deg"
    turns = total * RECORDED_UNITS[unit][1] / (2.0 * np.pi) if dimension_recorded(unit) == "angle" else total / 360.0
    return turns if turns > ONE_WAY_TURNS else None


def _lead(signals: Sequence[Signal], meanings: Mapping[str, Meaning]) -> Signal | None:
    """The signal whose samples define the grid: set point, position, speed by name, else the longest one that moves."""
    named = {meanings[s.name].signal: s for s in signals if s.name in meanings}
    for signal in ORDER[:5]:
        if signal in named and moves(_first_block(named[signal].values)):
            return named[signal]
    if "setpoint" in named:  # it rests, and so does the axis
        return None
    moving = [s for s in signals if moves(_first_block(s.values))]
    return max(moving, key=lambda s: len(s.values), default=None)


def _times(lead: Signal) -> np.ndarray:
    """Sample times of the part that is compared: of the longest stretch that moves, the MOST_ROWS with the most motion."""
    assert lead.time is not None
    times, values = _first_block(lead.time), _first_block(lead.values)
    timing = timing_of(times, lead.name, period_s=None)
    best = max(timing.stretches, key=lambda s: (moves(values[s.first : s.first + s.count]), s.count))
    time = times[best.first : best.first + best.count]
    if len(time) <= MOST_ROWS:
        return time
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(values[best.first : best.first + best.count])))])
    first = int(np.argmax(moved[MOST_ROWS:] - moved[:-MOST_ROWS]))
    return time[first : first + MOST_ROWS]


def _sign_bits(values: Mapping[str, np.ndarray], signals: Sequence[Signal], meanings: Mapping[str, Meaning]) -> dict[str, int]:
    """Columns of whole numbers with a sign bit, by the direction of a recorded position."""
    place = next(
        (values[s.name] for s in signals if s.name in meanings and meanings[s.name].signal in ("position", "motor_position")), None
    )
    if place is None:
        return {}
    direction = np.sign(np.gradient(place))
    places = {name for name, meaning in meanings.items() if meaning.signal in POSITIONS}
    found = {name: relations.sign_bit(v, direction) for name, v in values.items() if name not in places}
    return {name: bit for name, bit in found.items() if bit is not None}


def _unit(signal: Signal, meanings: Mapping[str, Meaning]) -> str:
    return meanings[signal.name].unit if signal.name in meanings else signal.unit


def _in_mm_or_deg(values: np.ndarray, unit: str) -> np.ndarray:
    """A length or an angle with a unit in mm or degrees; other values as they are."""
    quantity = dimension_recorded(unit) if unit else ""
    if quantity not in ("length", "angle"):
        return values
    return values * RECORDED_UNITS[unit][1] / RECORDED_UNITS["mm" if quantity == "length" else "deg"][1]


def _signed(values: np.ndarray, bit: int | None) -> np.ndarray:
    return values if bit is None else np.where(values >= 2.0**bit, 2.0**bit - values, values)


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


def _interpolated(signal: Signal, time: np.ndarray) -> np.ndarray:
    """Values at these times, linear between samples."""
    own, values = _first_block(signal.time), _first_block(signal.values)
    if len(own) < 2:
        raise InputError(f"column '{signal.name}' has {len(own)} sample{'s' * (len(own) != 1)}; a trace needs at least two")
    return np.interp(time, own, values)
