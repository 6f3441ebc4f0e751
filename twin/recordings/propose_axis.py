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
    """Columns of an axis, or the reason why it is omitted; columns without a use; what is in doubt."""

    columns: list[Proposed] = field(default_factory=list)
    left_out: str = ""
    unused: dict[str, str] = field(default_factory=dict)  # column -> reason, "" if there is none
    doubt: str = ""
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
    candidates = _candidates(sound, meanings, time)
    scales = _scales_of_counts(candidates, period)
    for i, c in enumerate(candidates):
        if c.meaning is not None and c.name in scales:
            scale, unit = scales[c.name]
            candidates[i] = replace(c, values=scale * c.values, meaning=replace(c.meaning, unit=unit))
    bits = _sign_bits(candidates)
    named = [c for c in candidates if c.means(*POSITIONS, *SPEEDS)]
    guess = _kind_of_units([c.unit for c in (*named, *(c for c in candidates if c.meaning is None))], label or axis)
    for c in candidates:
        if c.meaning is None and moves(c.values):
            if len(np.unique(c.values)) == 2:
                out.unused[c.name] = "a switch"
            elif relations.even_step(c.values):
                out.unused[c.name] = "increases evenly: counts or a time"
    target = "constant, and the axis goes to it: the path is the recorded position"
    out.unused |= {c.name: target for c in _constant_targets(candidates)}
    candidates = [c for c in candidates if c.name not in out.unused]
    candidates = [replace(c, values=relations.without_sign_bit(c.values, bits[c.name])) if c.name in bits else c for c in candidates]
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
        spindle, turns = re.fullmatch(r"S\d?", axis), _turns(motion.column.signal.head, guess, motion.column.meaning)
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
    out.doubt = roles.doubt
    return out


def _kind_of_units(units: Sequence[str], label: str) -> tuple[str, bool]:
    """(linear or rotary, True if a unit shows it). Without a unit the label decides: A, B, C are rotary."""
    for dimension in (dimension_recorded(unit) for unit in units if unit):
        if dimension in ("length", "speed", "angle", "angular speed", "turns"):
            return ("linear" if dimension in ("length", "speed") else "rotary"), True
    return ("rotary" if len(label.strip()) <= 2 and label.strip()[:1].upper() in ("A", "B", "C") else "linear"), False


def _constant_targets(columns: Sequence[Candidate]) -> list[Candidate]:
    """Set points that stand still while the position goes to them, as in the record of a step: a held axis returns to where it was."""
    x = next((c.values for signal in ENCODERS for c in reversed(columns) if c.means(signal)), None)
    if x is None or abs(x[-1] - x[0]) < max(0.5 * np.ptp(x), STILL * max(_noise(x), decimal_place(x))):
        return []
    targets = [c for c in columns if c.means("setpoint") and not moves(c.values)]
    return [c for c in targets if abs(c.values[0] - x[-1]) < abs(c.values[0] - x[0])]


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


def _candidates(signals: Sequence[Signal], meanings: Mapping[str, Meaning], time: np.ndarray) -> list[Candidate]:
    """The columns at these times. Set points and positions without a unit whose numbers are those of another one with a unit have this unit."""
    places = {s.name: at_times(s, time, "") for s in signals if s.name in meanings and meanings[s.name].signal in POSITIONS[:3]}
    if given := next((name for name in places if meanings[name].unit), None):
        free = [name for name in places if not meanings[name].unit and moves(places[name])]
        same = [name for name in free if abs(relations.follows(places[given], places[name]).factor - 1.0) < FOLLOWS]
        meanings = {**meanings, **{name: replace(meanings[name], unit=meanings[given].unit) for name in same}}
    columns = [Candidate(s, np.empty(0), meanings.get(s.name)) for s in signals]
    return [replace(c, values=at_times(c.signal, time, c.unit)) for c in columns]


def _scales_of_counts(columns: Sequence[Candidate], period: float) -> dict[str, tuple[float, str]]:
    """Size and unit of the counts of positions whose stated unit is none that is known: another position of the axis with a unit shows them.

    Play and windup make this ratio another one in each recording; the counts of a turn and a lead of few digits are the same.
    """
    moving = [c for c in columns if moves(c.values)]
    given = [
        c for c in moving if c.unit and dimension_recorded(c.unit) in ("length", "angle") and (c.meaning is None or c.means(*POSITIONS[:3]))
    ]
    scales: dict[str, tuple[float, str]] = {}
    for stated in dict.fromkeys(c.signal.stated_unit for c in moving if c.signal.stated_unit and c.means(*POSITIONS)):
        alike = [c for c in moving if c.signal.stated_unit == stated and c.means(*POSITIONS)]
        if not all(relations.whole(c.values) for c in alike):
            continue
        pairs = [(relations.follows(one.values, c.values), one, c) for one in given for c in alike if c.means(*POSITIONS[:3])]
        best, one, own = min(pairs, key=lambda pair: pair[0].left, default=(relations.Relation(0.0, 1.0), columns[0], columns[0]))
        if best.left < relations.CLEAR and best.factor:
            scale, counts = best.factor, own.values
            for speed in (c for c in moving if c.unit in A_SECOND):
                slope = relations.slope(speed.values, counts, period).factor
                if slope and (turn := counts_of_a_turn(counts, A_SECOND[speed.unit] / abs(slope), far=True)):
                    scale = as_made(best.factor * turn) / turn
            scales |= {c.name: (scale, "mm" if dimension_recorded(one.unit) == "length" else "deg") for c in alike}
    return scales


def _sign_bits(columns: Sequence[Candidate]) -> dict[str, int]:
    """Columns of whole numbers with a sign bit, by the direction of a recorded position."""
    if (place := next((c.values for c in columns if c.means(*ENCODERS)), None)) is None:
        return {}
    direction = np.sign(np.gradient(place))
    found = {c.name: relations.sign_bit(c.values, direction) for c in columns if not c.means(*POSITIONS)}
    return {name: bit for name, bit in found.items() if bit is not None}


def at_times(signal: Signal, time: np.ndarray, unit: str) -> np.ndarray:
    """Values at these times, linear between samples but on the steps of the encoder; lengths, angles and turns with a unit in mm or degrees."""
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
