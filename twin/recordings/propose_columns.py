"""Proposed columns of an axis whose roles are known: units, signs and doubts.

A column whose name fits but whose numbers do not is doubtful: it becomes a comment in the map and is not used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
import re

import numpy as np

from twin.recordings import relations
from twin.recordings.mapping import FOLLOWING_ERROR, PROFILE_SPEED, path_source
from twin.recordings.names import names_output
from twin.recordings.profile_speed import answers_position
from twin.recordings.relations import CLEAR, UNLIKE, moves
from twin.recordings.roles import Role, Roles
from twin.recordings.roughness import decimal_place
from twin.recordings.trace import ENCODERS, FORCES, SPEEDS, Trace
from twin.recordings.units_found import MET, TOLERANCE, Scale, as_made, counts, counts_of_a_turn, position_scale, speed_unit, usual_travel
from twin.units import AXIS_UNITS, RECORDED_UNITS, dimension_recorded, in_words

FOLLOWS = 0.1
"""A position is doubtful if its ratio to the set point or to the other encoder differs from 1 by more."""
APART = 0.02
"""Two encoders that differ by more than this share of their travel do not measure the same motion."""
FARTHER = 2.0
"""A following error does not change that many times as far as the position: from a constant set point it changes as far."""
CONSTANT = 1e-3
"""The sum of a position and its error is constant below this share of the travel, up to their digits."""
COUNTED = 0.2
"""Whole counts per second of few samples may differ from the slope of counts by this share."""
OWN_TURN = 1e-3
"""A turn of the motor that differs from a turn of the axis by less than this share is one."""
FARTHEST = 1e4
"""No axis travels farther in mm: whole numbers are counts then."""
A_SECOND = {"rev/min": 60.0, "rev/s": 1.0}
"""Number of a speed in a unit of one turn a second."""
POSITIONS = ("setpoint", "position", "motor_position", "following_error")
SUPPLY = 20.0
"""Least mean over standard deviation of the voltage of a supply; a command of an axis that moves passes through zero or changes."""
USUAL = {"current": "A", "current_setpoint": "A", "voltage": "V"} | dict.fromkeys(
    ("torque", "torque_setpoint", "torque_feedforward", "disturbance", "injected_command"), "Nm"
)
"""Units of forces without one."""
PROFILE = "speed of the profile (slope of the set point), no output of a controller: no gain follows from it"
_ANGLE = re.compile(r"angle|winkel|angolo|theta|(^|[_. ])phi([_. (\[]|$)", re.IGNORECASE)
_JOINT = re.compile(r"joint|robot|positions(?=[_.\[\d])|(^|[_. ])q(d|dd)?([_. (\[]|$)", re.IGNORECASE)


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
    optional: bool = False  # some of the files do not have it


def proposed_columns(
    axis: str, roles: Roles, guess: tuple[str, bool], period: float, timed: bool, bits: Mapping[str, int]
) -> tuple[list[Proposed], tuple[str, float, float] | None]:
    """Columns of a moving axis with units, signs and doubts; and unit of the position, factor of a speed without unit against its slope, interval [s]."""
    recorded = {signal: role.column.values for signal, role in roles.roles.items()}
    moved = next((recorded[s] for s in ("motor_position", "position") if s in recorded and moves(recorded[s])), None)
    commanded, error = recorded.get("setpoint"), recorded.get(FOLLOWING_ERROR)
    base = moved if moved is not None else commanded if commanded is None or error is None else commanded - error
    if base is None and {"velocity", PROFILE_SPEED, FOLLOWING_ERROR} <= set(recorded):
        base = _less_error(recorded, period)
    speeds = [s for s in SPEEDS if base is not None and s in recorded and moves(recorded[s])]
    factors = {s: relations.slope(recorded[s], base, period).factor for s in speeds}  # type: ignore[arg-type]
    units = {s: role.column.unit for s, role in roles.roles.items()}
    turn = next((A_SECOND[units[s]] / abs(f) for s, f in factors.items() if units[s] in A_SECOND and f and timed), None)
    scale = _scale(roles, base, [f for s, f in factors.items() if not units[s] and timed], guess, turn)
    if turn is not None and scale.factor != 1.0 and abs(turn * scale.factor / 360.0 - 1.0) < MET:
        turn = 360.0 / scale.factor  # the speed showed the counts of a turn, so that its own turn is one
    kind = guess[0] if guess[1] else ("rotary" if RECORDED_UNITS[scale.unit][0] == "angle" else "linear")
    speed = None
    if base is not None and "velocity" in factors and not units.get("velocity"):
        speed = (scale.unit, factors["velocity"] / scale.factor, period)
    columns: list[Proposed] = []
    for signal, role in roles.roles.items():
        column = Proposed(role.column.name, axis, signal, units.get(signal, ""), reason=role.reason, second=role.second)
        if role.column.name in bits:
            column = replace(column, extra=(f"sign_bit = {bits[role.column.name]}",))
        if signal in POSITIONS:
            column = _position(column, scale, recorded)
        elif not moves(role.column.values):
            column = replace(column, doubt="it never changes", unit=column.unit or USUAL.get(signal, f"{scale.unit}/s"))
        elif signal in SPEEDS:
            beside = next((c for c in columns if c.signal == "velocity" and not c.doubt), None)
            column = _which_speed(column, role, recorded, period, timed)
            column = column if column.doubt else _speed(column, role.column.values, scale, recorded, base, period, kind, turn, beside)
        elif signal == "acceleration":
            turning = base is None and dimension_recorded(units.get("velocity") or "rev/min") == "turning speed"
            column = replace(column, unit=column.unit or f"{'deg' if turning else scale.unit}/s2")
        elif signal == "voltage" and abs(mean := float(role.column.values.mean())) > SUPPLY * float(role.column.values.std()):
            column = replace(column, doubt=f"it stays near {mean:.4g}: a supply, no command")
        else:
            column = _force(column, role, base, recorded, period, kind)
        if role.column.name not in bits and not column.doubt and (place := relations.stuck(role.column.values)):
            column = replace(column, doubt=f"it {place}")
        columns.append(column)
    return _without_double(columns), speed


def _less_error(recorded: Mapping[str, np.ndarray], period: float) -> np.ndarray | None:
    """Sum of the profile's speed less the following error, in the unit of the error; None if the error is not that of the two speeds.

    e = a (sum of profile - integral of speed) + b profile + c: the profile may be the last or the next step of the set points, b is its moment. Half a
    sample is much of a small lag.
    """
    profile, speed, error = recorded[PROFILE_SPEED], recorded["velocity"], recorded[FOLLOWING_ERROR]
    apart = (np.cumsum(profile - speed) + 0.5 * speed) * period
    left, (a, b, _) = relations.fitted(np.column_stack([apart, profile, np.ones_like(error)]), error)
    if not a or left > UNLIKE or not np.ptp(apart) > 0.0:
        return None
    return np.asarray(a * np.cumsum(profile) * period + b * profile - error)


def _without_double(columns: list[Proposed]) -> list[Proposed]:
    """A following error is not needed beside a position; without a sound position a set point alone says nothing."""
    measured = [c for c in columns if c.signal in ENCODERS]
    sound = [c.signal for c in columns if not c.doubt]
    needless = ""
    if any(not c.doubt for c in measured):
        needless = "the position itself is recorded" if "setpoint" in sound else ""
    elif measured and FOLLOWING_ERROR not in sound:
        return [replace(c, doubt=c.doubt or "no usable measured position of this axis") for c in columns]
    elif not measured and not any(c.signal == "setpoint" for c in columns) and path_source(sound) != PROFILE_SPEED:
        needless = "no position is recorded that it belongs to"
    return [replace(c, doubt=c.doubt or needless) if c.signal == FOLLOWING_ERROR else c for c in columns]


def _scale(roles: Roles, base: np.ndarray | None, factors: list[float], guess: tuple[str, bool], turn: float | None) -> Scale:
    """Unit of the positions: stated, or of the numbers. `turn`: travel in a turn of the motor, by a speed in turns."""
    placed = [r.column for s, r in roles.roles.items() if s in POSITIONS]
    stated = next((dimension_recorded(c.meaning.unit) for c in placed if c.meaning is not None and c.meaning.unit), "")
    if stated in ("length", "angle", "turns"):
        return Scale("mm" if stated == "length" else "deg", sure=True)  # they were converted
    usual = "deg" if guess[0] == "rotary" else "mm"
    if base is None:
        return Scale(usual, sure=True)
    places = [c.name for c in placed]
    effort = any("effort" in r.column.name.lower() for r in roles.roles.values())  # of a message of ROS, in SI units
    joint = effort or any(_JOINT.search(name) for name in places)  # not i_q
    angle = any(_ANGLE.search(name) for name in places)
    measured = next((roles.roles[s].column.values for s in (*ENCODERS, "setpoint", FOLLOWING_ERROR) if s in roles.roles), base)
    anew = next((c.signal.turn for c in placed if c.signal.turn), 0.0)
    if anew and guess != ("linear", True):
        unit, full = ("rad", 2.0 * math.pi) if abs(anew - 2.0 * math.pi) < MET else ("deg", 360.0)
        turned = abs(anew / full - 1.0) < MET  # of counts it may be the end of their word
        return Scale(unit, full / anew, f"begins anew after {anew:.6g}: {'' if turned else 'taken as '}a turn", turned)
    if guess[1]:  # the kind is known by a speed with a unit
        return Scale(usual, 1.0, f"taken as {usual} beside its speed")
    if turn is not None and (counted := counts_of_a_turn(measured, turn, far=np.ptp(base) > FARTHEST)) is not None:
        return Scale("deg", 360.0 / counted, f"counts: {counted:.0f} a turn of the motor, by the recorded speed", True)
    columns = [measured] if np.ptp(base) > FARTHEST else [r.column.values for r in roles.roles.values()]
    all_whole = all(map(relations.whole, columns))
    return position_scale(measured, factors, angle or guess[0] == "rotary", angle or joint, all_whole)


def _position(column: Proposed, scale: Scale, recorded: Mapping[str, np.ndarray]) -> Proposed:
    """Unit and doubt of a position."""
    doubt = _doubt_of_position(column.signal, recorded)
    if column.unit and dimension_recorded(column.unit) not in ("length", "angle", "turns"):
        return replace(column, doubt=f"[{column.unit}] is no unit of a {in_words(column.signal)}")
    if column.unit:
        turns = ("deg_per_rev = 360",) * (column.unit == "rev")
        return replace(column, doubt=doubt, extra=(*column.extra, *turns), remark="turns of the axis itself" if turns else column.remark)
    extra = (*column.extra, f"scale = {scale.factor:.9g}") if scale.factor != 1.0 else column.extra
    return replace(column, unit=scale.unit, extra=extra, remark=scale.reason, doubt=doubt, assumed="" if scale.sure else scale.reason)


def _which_speed(column: Proposed, role: Role, recorded: Mapping[str, np.ndarray], period: float, timed: bool) -> Proposed:
    """Which speed a column is: measured, that of the profile or the set point; with a doubt if another column is. `timed`: `period` is in seconds."""
    unnamed = role.column.meaning is None
    of_profile = column.signal == "velocity_feedforward" and not role.column.means(column.signal)
    if "setpoint" in recorded and (column.signal == "velocity_setpoint" or of_profile):
        profile = _is_profile(role.column.values, recorded, period, timed)
        signal = {True: "velocity_feedforward", False: "velocity_setpoint", None: column.signal}[profile]
        if signal != column.signal and signal in recorded:
            return replace(column, doubt=PROFILE if profile else "another column is the speed set point")
        either = "slope of the set point or output of the position controller: the record does not show which"
        reason = {True: PROFILE, False: "answers the position: output of the position controller", None: either}[profile]
        remark = {True: PROFILE, False: "", None: "it does not answer the position in this record: no gain follows from it"}[profile]
        column = replace(column, signal=signal, remark=remark, reason=reason)
        if unnamed and profile is None:
            column = replace(column, assumed=f"within this record it is the slope of the set point: taken as {in_words(signal)}")
    if unnamed and column.signal == "velocity" and role.second in SPEEDS and not {*SPEEDS} & {*recorded} - {"velocity"}:
        column = replace(column, assumed=f"the only speed without a name: taken as measured, it may be the {in_words(role.second)}")
    return column


def _speed(
    column: Proposed,
    values: np.ndarray,
    scale: Scale,
    recorded: Mapping[str, np.ndarray],
    base: np.ndarray | None,
    period: float,
    kind: str,
    turn: float | None,
    beside: Proposed | None,
) -> Proposed:
    """Unit and sign of a speed. `turn`: travel in a turn of the motor, by the first speed in turns.

    `beside`: the measured speed. A set point has its unit: a lead of the set point is no other unit.
    """
    if base is None:
        turning = not column.unit or dimension_recorded(column.unit) == "turning speed"
        assumed = "" if column.unit else "nothing states its unit: taken as rev/min"
        shaft = "the motor's shaft is the axis, because no position shows its travel; give mm_per_rev for a slide"
        extra = (*column.extra, *("deg_per_rev = 360",) * turning)
        return replace(column, unit=column.unit or "rev/min", extra=extra, remark=shaft * turning, assumed=assumed)
    s = recorded.get("setpoint")
    x = s if column.signal == "velocity_feedforward" and s is not None else base
    found = relations.slope(values, x, period)
    of = "set point" if x is s else "position"
    if found.left > UNLIKE:
        return replace(column, doubt=f"it is not correlated with the slope of the {of}")
    sign = 1 if found.factor > 0.0 else -1
    remark = "; ".join(part for part in (column.remark, "sign reversed: it runs against the motion" if sign < 0 else "") if part)
    key = "mm_per_rev" if kind == "linear" else "deg_per_rev"
    in_mm_or_deg = RECORDED_UNITS[scale.unit][1] / RECORDED_UNITS["mm" if kind == "linear" else "deg"][1]
    if column.unit and dimension_recorded(column.unit) == "turning speed":
        travel = (turn or A_SECOND[column.unit] / abs(found.factor)) * scale.factor * in_mm_or_deg
        if kind == "rotary" and abs(travel / 360.0 - 1.0) < OWN_TURN:
            return replace(column, sign=sign, extra=(*column.extra, f"{key} = 360"), remark="turns of the axis itself")
        by_slope = f"travel of a motor turn by the slope of the {of}"
        unsure = found.left > CLEAR or base is s  # the axis lags behind its set point
        rough = f"{by_slope}, which explains only {1.0 - found.left:.0%} of it: {key} = {travel:.3g}" if unsure else ""
        return replace(column, sign=sign, extra=(*column.extra, f"{key} = {as_made(travel):.6g}"), remark=by_slope, assumed=rough)
    if column.unit:
        return replace(column, sign=sign, remark=remark)
    coarse = COUNTED if relations.whole(values) else MET
    if scale.factor != 1.0 and abs(abs(found.factor) - 1.0) < coarse:  # counts and counts per second
        return replace(column, unit=f"{scale.unit}/s", sign=sign, extra=(*column.extra, f"scale = {scale.factor:.9g}"), remark=remark)
    if beside is not None:
        measured = relations.slope(recorded["velocity"], x, period).factor
        if abs(math.log(abs(found.factor / measured))) <= math.log(1.0 + TOLERANCE[column.signal]):
            extra = (*column.extra, *(e for e in beside.extra if not e.startswith("sign_bit")))
            return replace(column, unit=beside.unit, sign=sign, extra=extra, remark=remark or f"{beside.unit} like the measured speed")
    unit, travel = speed_unit(scale.unit, found.factor / scale.factor, column.signal, kind)
    if not travel:
        return replace(column, unit=unit, sign=sign, remark=remark or f"{unit} by the slope of the position")
    if travel != 360.0 and found.left > CLEAR:
        return replace(column, doubt=f"no unit makes it the slope of the {of}, which explains only {1.0 - found.left:.0%} of it")
    of_motor = f"read as {unit} of a motor: travel per revolution from the slope of the position"
    said = of_motor if travel != 360.0 else "turns of the axis itself"
    why = "nothing states its unit" if usual_travel(travel) else f"no usual unit makes it the slope of the {of}"
    assumed = "" if travel == 360.0 else f"{why}: taken as {unit} of a motor, {key} = {travel:.4g}"
    extra, remark = (*column.extra, f"{key} = {as_made(travel):.6g}"), f"{said}; {remark}".rstrip("; ")
    return replace(column, unit=unit, sign=sign, extra=extra, remark=remark, assumed=assumed)


def _is_profile(values: np.ndarray, recorded: Mapping[str, np.ndarray], period: float, timed: bool) -> bool | None:
    """True if a speed set point is only the slope of the set point; False if it answers the position; None if the record does not show it.

    If all that is left beside the slope were gain times following error, and the gain would be lower than that of any control, it is the slope.
    """
    s = recorded["setpoint"]
    of_s = relations.slope(values, s, period)
    measured = {signal: recorded[signal] for signal in ENCODERS if signal in recorded and moves(recorded[signal])}
    if not measured:
        return True if of_s.left < relations.EXACT else None
    signals = {("X", name): v for name, v in {"setpoint": s, "velocity_setpoint": values, **measured}.items()}
    if answers_position([Trace(np.arange(len(s)) * period, signals, {"X": "linear"})], "X"):
        return False
    x = next(iter(measured.values()))
    left = np.sqrt(of_s.left) * float(np.std(values)) / max(abs(of_s.factor), 1e-300)
    error = np.sqrt(relations.follows(x, s).left) * float(np.std(x))
    return True if timed and of_s.left < 0.3 and left < LEAST_GAIN * error else None


LEAST_GAIN = 5.0
"""Position gain [1/s] below that of any control: they are set to 8 (0.5 m/min per mm) and more."""


def _force(column: Proposed, role: Role, base: np.ndarray | None, recorded: Mapping[str, np.ndarray], period: float, kind: str) -> Proposed:
    """Unit and sign of a current, torque or voltage. A set point of the effort that alone shows what moves the axis is its effort."""
    unit, assumed, values = column.unit, "", role.column.values
    if base is None and "velocity" in recorded:
        base = np.cumsum(recorded["velocity"]) * period
    effort = column.signal.removesuffix("_setpoint")
    if column.signal != effort and base is not None and not {*FORCES} & {*recorded}:
        moved = relations.balance(values, base, period, kind)
        if moved.left < UNLIKE:
            column = replace(column, signal=effort, reason=f"the only {effort}, explained by the motion to {1.0 - moved.left:.0%}")
    if not unit:
        unit = USUAL[column.signal]
        assumed = f"nothing states its unit: taken as {unit}"
        if column.signal == "current" and counts(values) and np.abs(values).max() > 200.0:
            unit, assumed = "mA", f"whole numbers up to {np.abs(values).max():.0f}: taken as mA"
        elif unit == "Nm" and decimal_place(values, off=1e-6) >= 0.1:  # as controls show percent and per mille
            assumed += ", but steps of 0.1 or 1 may be percent or per mille of the rated torque"
    if role.column.meaning is None and names_output(column.name):
        assumed = f"its name says that a controller gives it, not of which quantity: taken as {effort} [{unit}], it may be a speed"
    if column.signal not in FORCES or base is None:
        return replace(column, unit=unit, assumed=assumed)
    in_si = RECORDED_UNITS[AXIS_UNITS[kind].position[0]][1]
    found = relations.force_sign(role.column.values, base * in_si, period, kind)
    return replace(column, unit=unit, sign=found.sign, remark=found.remark or assumed, assumed=assumed)


def _doubt_of_position(signal: str, values: Mapping[str, np.ndarray]) -> str:
    """Reason to doubt a position that does not follow the set point or the other encoder; "" if there is none."""
    if signal == "setpoint":
        return ""
    y = values[signal]
    if signal == "following_error":
        beside = values.get("position", values.get("motor_position"))
        if beside is None or not moves(beside) or "setpoint" in values:
            return ""
        if np.ptp(beside + y) < CONSTANT * np.ptp(beside):
            return "with the position it gives a constant set point: the path is the recorded position"
        far = float(np.ptp(y) / np.ptp(beside))
        return f"it changes {far:.3g} times as far as the position: unit, scale or column?" if far > FARTHER else ""
    if not moves(y):
        return "it never changes"
    for other in ("motor_position", "setpoint"):
        if other in values and other != signal and moves(x := values[other]):
            found = relations.follows(y, x)
            apart = np.sqrt(found.left) * float(np.std(y)) / float(np.ptp(x))
            if other == "motor_position" and signal == "position" and apart > APART:
                return f"it differs from the motor encoder by {apart:.1%} of the travel (RMS): not the same motion"
            if found.left < CLEAR and abs(found.factor - 1.0) > FOLLOWS and abs(relations.follows_in_part(y, x).factor - 1.0) > FOLLOWS:
                return f"it moves {found.factor:.3g} times as far as the {in_words(other)}: unit, scale or column?"
            if found.left > UNLIKE:
                return f"it does not follow the {in_words(other)}"
    return ""
