"""Proposal for one axis: its columns on a common time, their roles, and whether the axis moves, rests or spins."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import re

import numpy as np

from twin.errors import InputError
from twin.recordings import relations
from twin.recordings.names import Meaning
from twin.recordings.propose_columns import A_SECOND, FOLLOWS, POSITIONS, Proposed, proposed_columns
from twin.recordings.relations import moves
from twin.recordings.roles import MOTION, ORDER, Candidate, Roles, assign
from twin.recordings.roughness import SECOND_DIFFERENCE, decimal_place, roughness
from twin.recordings.signals import BLOCK, Signal
from twin.recordings.timing import timing_of
from twin.recordings.trace import ENCODERS, SPEEDS
from twin.recordings.units_found import as_made, counts_of_a_turn, steps_of_a_turn
from twin.units import RECORDED_UNITS, dimension_recorded, in_words

MOST_ROWS = 1 << 14
"""Samples that are compared: those of the longest stretch around the most motion."""
MOST_STRANGE = 128
"""Columns without a known name whose pairs are compared."""
ONE_WAY_TURNS = 5.0
"""An axis that turns farther than this in one direction is a spindle."""


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
    label = next((s.description for s in signals if s.name in meanings and meanings[s.name].signal == "setpoint"), "")
    called = f"axis {axis}" + (f" ({label})" if label else "")
    names = ", ".join(s.name for s in signals if s.name in meanings)

    def left_out(why: str) -> AxisProposal:
        out.left_out = called + why
        return out

    sound = []
    for one in signals:
        if bad := one.impossible():
            place = f"holds {bad[1]} at sample {bad[0] + 1}: repair it"
            meaning = meanings.get(one.name)
            if meaning is None:
                out.unused[one.name] = place
            elif meaning.signal == "setpoint":
                return left_out(f": its set point '{one.name}' {place}")
            else:
                out.columns.append(Proposed(one.name, axis, meaning.signal, meaning.unit, doubt=place))
        else:
            sound.append(one)
    lead = _lead(sound, meanings)
    if lead is None:
        return left_out(f" does not move in this recording ({names})" if names else ": nothing moves")
    time = times_compared(lead)
    period = float(np.median(np.diff(time)))
    if not period > 0.0:
        raise InputError(f"column '{lead.name}': its time stands still; repair it, or give [time] interval_ms in a map")
    meanings = {**meanings, **_with_unit_of_other(sound, meanings, time)}
    units = {one.name: meanings[one.name].unit if one.name in meanings else one.unit for one in sound}
    values = {one.name: at_times(one, time, units[one.name]) for one in sound}
    scales = _scales_of_counts(sound, values, meanings, units, period)
    for name, (scale, unit) in scales.items():
        values[name], units[name], meanings[name] = scale * values[name], unit, replace(meanings[name], unit=unit)
    bits = _sign_bits(values, meanings)
    of_motion = [n for n in units if n in meanings and meanings[n].signal in (*POSITIONS, *SPEEDS)]
    guess = _kind_of_units([units[n] for n in (*of_motion, *(n for n in units if n not in meanings))], label or axis)
    for name in [n for n, v in values.items() if n not in meanings and moves(v)]:
        switch = len(np.unique(values[name])) == 2
        if switch or relations.even_step(values[name]):
            out.unused[name] = "a switch" if switch else "increases evenly: counts or a time"
            del values[name]
    for name in _constant_targets(values, meanings):
        out.unused[name] = "constant, and the axis goes to it: the path is the recorded position"
        del values[name]
    values |= {n: relations.without_sign_bit(values[n], bit) for n, bit in bits.items() if n in values}
    candidates = [Candidate(one.name, values[one.name], meanings.get(one.name), one.unit, one.turn) for one in sound if one.name in values]
    if (strange := sum(c.meaning is None and moves(c.values) for c in candidates)) > MOST_STRANGE:
        return left_out(f": {strange} columns without a known name are too many to compare; give a map with those that count")
    roles = assign(candidates, period, guess[0], timed)
    motion = next((roles.roles[s] for s in MOTION if s in roles.roles), None)
    if motion is None:
        return left_out(f": no motion among its columns ({', '.join(s.name for s in sound[:8])})")
    out.score = roles.score
    if motion.signal != "velocity":
        if _rests(roles):
            return left_out(f" does not move in this recording ({names})")
        whole = next(one.head for one in sound if one.name == motion.column.name)
        spindle, turns = re.fullmatch(r"S\d?", axis), _turns(whole, guess, motion.column.meaning)
        if spindle or turns is not None:
            how = "by its name" if spindle else f"({turns:.0f} turns one travel)"
            return left_out(f" spins {how}: not a feed axis ({names})")
    stated_otherwise = {one.name: one.stated_unit for one in sound if one.stated_unit}
    columns, out.speed = proposed_columns(axis, roles, guess, period, timed, bits)
    for column in columns:
        if column.name in scales:
            size = f"scale = {scales[column.name][0]:.9g}"
            column = replace(column, extra=(*column.extra, size), remark="counts, by the other encoder of this axis")
        known = not column.assumed and any(key.startswith("scale = ") for key in column.extra)  # the recorded speed gives its counts
        text = f"the file states [{stated_otherwise.get(column.name)}], which is taken as {column.unit}"
        remark = column.remark if column.remark != column.assumed else ""
        out.columns.append(column if known or column.name not in stated_otherwise else replace(column, assumed=text, remark=remark))
    for c in roles.unused:
        other = roles.roles.get(c.meaning.signal) if c.meaning is not None else None
        taken = f"'{other.column.name}' is the {in_words(other.signal)}" if other else ""
        out.unused[c.name] = taken or ("constant" if not moves(c.values) else "")
    out.unused |= {copy: f"a copy of '{original}', but for a constant or the sign" for copy, original in roles.same.items()}
    if roles.doubt:
        out.notes.append(roles.doubt)
    return out


def _kind_of_units(units: Sequence[str], label: str) -> tuple[str, bool]:
    """(linear or rotary, True if a unit shows it). Without a unit the label decides: A, B, C are rotary."""
    for dimension in (dimension_recorded(unit) for unit in units if unit):
        if dimension in ("length", "speed", "angle", "angular speed", "turns"):
            return ("linear" if dimension in ("length", "speed") else "rotary"), True
    return ("rotary" if len(label.strip()) <= 2 and label.strip()[:1].upper() in ("A", "B", "C") else "linear"), False


def _constant_targets(values: Mapping[str, np.ndarray], meanings: Mapping[str, Meaning]) -> list[str]:
    """Set points that stand still while the position goes to them, as in the record of a step: a held axis returns to where it was."""
    of = {meanings[n].signal: v for n, v in values.items() if n in meanings}
    x = of.get("position", of.get("motor_position"))
    if x is None or abs(x[-1] - x[0]) < max(0.5 * np.ptp(x), STILL * max(_noise(x), decimal_place(x))):
        return []
    targets = [n for n, v in values.items() if n in meanings and meanings[n].signal == "setpoint" and not moves(v)]
    return [n for n in targets if abs(values[n][0] - x[-1]) < abs(values[n][0] - x[0])]


def _noise(x: np.ndarray) -> float:
    """Standard deviation of the noise of a position; 0 for one that does not move."""
    return float(roughness(x) / np.sqrt(SECOND_DIFFERENCE)) if moves(x) else 0.0


def _rests(roles: Roles) -> bool:
    """True if what moves is within the noise of the recording itself."""
    place = {s: roles.roles[s].column.values for s in ("setpoint", "position", "motor_position") if s in roles.roles}
    measured = next((v for s, v in place.items() if s != "setpoint"), None)
    moved = place.get("setpoint", measured)
    if moved is None or not moves(moved):
        return True
    return measured is not None and float(np.ptp(moved)) < STILL * _noise(measured)


STILL = 6.0
"""Below this travel, in standard deviations of the position's noise, an axis stands still."""


def _turns(values: np.ndarray, guess: tuple[str, bool], meaning: Meaning | None) -> float | None:
    """Revolutions of an axis that turns far in one direction only, else None."""
    steps = np.diff(values)
    total, net = float(np.abs(steps).sum()), abs(float(values[-1] - values[0]))
    if net < 0.98 * total or (guess[0] == "linear" and guess[1]):
        return None
    if not (meaning is not None and meaning.unit) and relations.whole(values):
        return None  # counts of unknown size
    unit = meaning.unit if meaning is not None and meaning.unit else "deg"
    turns = total * RECORDED_UNITS[unit][1] / (2.0 * np.pi) if dimension_recorded(unit) == "angle" else total / 360.0
    return turns if turns > ONE_WAY_TURNS else None


def _lead(signals: Sequence[Signal], meanings: Mapping[str, Meaning]) -> Signal | None:
    """The signal whose samples define the grid: set point, position, speed by name, else the longest one that moves."""
    named = {meanings[s.name].signal: s for s in signals if s.name in meanings}
    for signal in ORDER[:5]:
        if signal in named and moves(named[signal].head):
            return named[signal]
    if "setpoint" in named:  # it rests, and so does the axis
        return None
    moving = [s for s in signals if moves(s.head)]
    return max(moving, key=lambda s: len(s.values), default=None)


def times_compared(lead: Signal) -> np.ndarray:
    """Sample times of the part that is compared: of the longest stretch that moves, the MOST_ROWS with the most motion."""
    assert lead.time is not None
    times, values = np.asarray(lead.time[0:BLOCK], float), lead.head
    timing = timing_of(times, lead.name, period_s=None)
    best = max(timing.stretches, key=lambda s: (moves(values[s.first : s.first + s.count]), s.count))
    time = times[best.first : best.first + best.count]
    if not best.even or np.any(np.diff(time) == 0.0):  # slopes need even times
        time = best.begin + best.interval * np.arange(best.count)
    if len(time) <= MOST_ROWS:
        return time
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(values[best.first : best.first + best.count])))])
    first = int(np.argmax(moved[MOST_ROWS:] - moved[:-MOST_ROWS]))
    return time[first : first + MOST_ROWS]


def _with_unit_of_other(signals: Sequence[Signal], meanings: Mapping[str, Meaning], time: np.ndarray) -> dict[str, Meaning]:
    """Meanings of the set points and positions without a unit whose numbers are those of another one with a unit: they have this unit."""
    places = {s.name: at_times(s, time, "") for s in signals if s.name in meanings and meanings[s.name].signal in POSITIONS[:3]}
    given = next((name for name in places if meanings[name].unit), None)
    free = [name for name in places if given and not meanings[name].unit and moves(places[name])]
    same = [name for name in free if abs(relations.follows(places[given], places[name]).factor - 1.0) < FOLLOWS]  # type: ignore[index]
    return {name: replace(meanings[name], unit=meanings[given].unit) for name in same}  # type: ignore[index]


def _scales_of_counts(
    signals: Sequence[Signal], values: Mapping[str, np.ndarray], meanings: Mapping[str, Meaning], units: Mapping[str, str], period: float
) -> dict[str, tuple[float, str]]:
    """Size and unit of the counts of positions whose stated unit is none that is known: another position of the axis with a unit shows them.

    Play and windup make this ratio another one in each recording; the counts of a turn and a lead of few digits are the same.
    """
    places = {s.name: s for s in signals if s.name in meanings and meanings[s.name].signal in POSITIONS and moves(values[s.name])}
    given = [n for n, unit in units.items() if unit and dimension_recorded(unit) in ("length", "angle") and moves(values[n])]
    given = [n for n in given if n not in meanings or meanings[n].signal in POSITIONS[:3]]
    scales: dict[str, tuple[float, str]] = {}
    for stated in dict.fromkeys(s.stated_unit for s in places.values() if s.stated_unit):
        alike = [n for n, s in places.items() if s.stated_unit == stated]
        if not all(relations.whole(values[n]) for n in alike):
            continue
        pairs = [(relations.follows(values[one], values[n]), one, n) for one in given for n in alike if meanings[n].signal in POSITIONS[:3]]
        best, one, own = min(pairs, key=lambda pair: pair[0].left, default=(relations.Relation(0.0, 1.0), "", ""))
        if best.left < relations.CLEAR and best.factor:
            scale, counts = best.factor, values[own]
            for speed in (n for n, unit in units.items() if unit in A_SECOND and moves(values[n])):
                slope = relations.slope(values[speed], counts, period).factor
                if slope and (turn := counts_of_a_turn(counts, A_SECOND[units[speed]] / abs(slope), far=True)):
                    scale = as_made(best.factor * turn) / turn
            scales |= dict.fromkeys(alike, (scale, "mm" if dimension_recorded(units[one]) == "length" else "deg"))
    return scales


def _sign_bits(values: Mapping[str, np.ndarray], meanings: Mapping[str, Meaning]) -> dict[str, int]:
    """Columns of whole numbers with a sign bit, by the direction of a recorded position."""
    measured = (n for n, meaning in meanings.items() if n in values and meaning.signal in ENCODERS)
    if (place := next((values[n] for n in measured), None)) is None:
        return {}
    direction = np.sign(np.gradient(place))
    places = {name for name, meaning in meanings.items() if meaning.signal in POSITIONS}
    found = {name: relations.sign_bit(v, direction) for name, v in values.items() if name not in places}
    return {name: bit for name, bit in found.items() if bit is not None}


def at_times(signal: Signal, time: np.ndarray, unit: str) -> np.ndarray:
    """Values at these times, linear between samples but on the steps of the encoder; lengths, angles and turns with a unit in mm or degrees."""
    assert signal.time is not None
    own, values = np.array(signal.time[0:BLOCK], float), signal.head
    if len(own) < 2:
        raise InputError(f"column '{signal.name}' has {len(own)} sample{'s' * (len(own) != 1)}; a trace needs at least two")
    if np.any(np.diff(own) == 0.0):  # printed with few digits
        for part in timing_of(own, signal.name, period_s=None).stretches:
            own[part.first : part.first + part.count] = part.begin + part.interval * np.arange(part.count)
    in_si, usual = RECORDED_UNITS, {"length": "mm", "angle": "deg", "turns": "deg"}.get(dimension_recorded(unit) if unit else "")
    if relations.whole(values):  # counts have no values between them, and words with a sign bit nothing where it changes
        row = np.interp(time, own, np.arange(len(own)))
        ends = values[np.floor(row).astype(int)], values[np.ceil(row).astype(int)]
        at = np.where(
            np.abs(ends[1] - ends[0]) > 0.5 * np.ptp(values), values[np.rint(row).astype(int)], np.rint(np.interp(time, own, values))
        )
    else:
        at = np.interp(time, own, values)
        turns = () if unit or (len(at) == len(values) and np.array_equal(at, values)) else (2.0 * np.pi, 360.0)
        if step := next((base / turn for base in turns if (turn := steps_of_a_turn(values, base))), 0.0):
            at = np.rint(at / step) * step
    return at * (in_si[unit][1] / in_si[usual][1] if usual else 1.0)
