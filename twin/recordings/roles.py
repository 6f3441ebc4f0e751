"""Joint best assignment of the columns of one axis to its signals, from names and numbers.

Evidence is a log likelihood ratio, roughly: E = -ln(share of the variance that the relation leaves) - 1, limited to MOST. A name that
states a signal adds NAMED. For every pair of columns that can be set point and position, the other columns are assigned by the best
linear assignment (`scipy.optimize.linear_sum_assignment`); the pair with the largest sum wins. A column without positive evidence for any
signal stays out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import itertools

import numpy as np
from scipy.optimize import linear_sum_assignment

from twin.recordings import relations
from twin.recordings.names import Meaning, names_no_position, names_output
from twin.recordings.relations import CLEAR, TINY, Relation
from twin.recordings.roughness import decimal_place
from twin.recordings.signals import Signal
from twin.recordings.trace import QUANTITY, SPEEDS, quantity_of
from twin.recordings.units_found import usual_factor

NAMED = 8.0
"""Evidence of a name that states a signal."""
PROFILE = 1e-4
"""A speed set point that leaves less of the slope of the set point (share of the variance) may be that of the profile."""
MOST = 6.0
"""Most evidence of one relation: beyond a residual of 0.1 % it says no more."""
DIFFERENCE, EQUAL = 3.0, 1e-3
"""Evidence of a column that is the difference of set point and position itself, or a thousand times it (um beside mm), to this share: a controller's
gain would be a power of ten by chance only."""
RANK = 10.0
"""Evidence of each rank of a name."""
ALONE = {"position": -1.0, "setpoint": -6.0}
"""Evidence for a position without a set point: the rarer record. A set point without a position is rarer still: it shows nothing of the axis."""
STRANGE = -9.0
"""Evidence against a column with an unknown name and unit beside others whose names state a motion: its name would have said what it is."""
SMOOTH = 0.1
"""Share of the variance that a cubic course leaves: below it, acceleration, speed and friction explain a column of any kind."""
NEVER = -1e3
_INJECTED = ("current", "voltage", "torque", "force")
"""Quantities of a known disturbance, and of an injected command."""
ORDER = ("setpoint", "position", "following_error", "motor_position", "velocity", "velocity_setpoint", "velocity_feedforward",
         "acceleration", "current", "current_setpoint", "torque", "torque_setpoint", "torque_feedforward", "voltage", "disturbance", "injected_command")  # fmt: skip
_FORCES = {"current": 0.0, "torque": -0.1, "voltage": -0.2}
"""Evidence for a force without a name: most controls record the current."""
MOTION = ("setpoint", "position", "motor_position", "velocity")
"""Signals that show where an axis moves, the likeliest first."""
POSITIONS = ("setpoint", "position", "motor_position")
_NO_OUTPUT = (*MOTION, "acceleration", "following_error", "velocity_feedforward")
_MOST_PAIRS = 10


@dataclass(frozen=True)
class Candidate:
    """A column of an axis: the recorded signal, its values (sample,) at the times compared, meaning of its name if known."""

    signal: Signal
    values: np.ndarray
    meaning: Meaning | None = None

    @property
    def name(self) -> str:
        return self.signal.name

    @property
    def unit(self) -> str:
        """Unit of the meaning, else of the file."""
        return self.signal.unit if self.meaning is None else self.meaning.unit

    def able(self, signal: str) -> bool:
        """True if the unit that the file states, if any, is one of this signal, and the name says nothing else; what a controller gives is not measured."""
        if signal in _NO_OUTPUT and self.meaning is None and names_output(self.name):
            return False
        if self.meaning is None and signal in POSITIONS and names_no_position(self.name):
            return False
        if self.signal.turn and signal not in POSITIONS:  # only a position begins anew
            return False
        if not self.signal.unit:
            return True
        quantity = quantity_of(self.signal.unit)[0]
        wanted = "position" if signal == "following_error" else QUANTITY.get(signal, "")
        return quantity in ("number", wanted) or (quantity in _INJECTED and (not wanted or {quantity, wanted} == {"torque", "force"}))

    def means(self, *signals: str) -> bool:
        """True if the name states one of these signals."""
        return self.meaning is not None and self.meaning.signal in signals


@dataclass(frozen=True)
class Role:
    """A column as a signal, with its evidence and one sentence of numbers; `second`: the next best signal, "" if there is none."""

    column: Candidate
    signal: str
    score: float
    reason: str
    second: str = ""


@dataclass(frozen=True)
class Roles:
    """The best assignment. `same`: copy -> original of equal columns. `doubt`: another pair of set point and position is nearly as good."""

    roles: Mapping[str, Role] = field(default_factory=dict)
    unused: tuple[Candidate, ...] = ()
    same: Mapping[str, str] = field(default_factory=dict)
    doubt: str = ""
    score: float = -np.inf


def assign(columns: Sequence[Candidate], period: float, kind: str = "linear", timed: bool = True) -> Roles:
    """The best assignment of the columns of one axis. `timed`: the period is known, so that a usual unit of a speed is evidence."""
    kept, same = _without_copies(columns)
    named = sum(c.meaning is not None and c.meaning.rank >= 0 and c.meaning.signal in MOTION for c in columns)
    evidence = _Evidence(period, kind, timed, STRANGE if named > 1 else 0.0)
    hypotheses = [(evidence.of_pair(s, x, kept), s, x) for s, x in evidence.pairs(kept)]
    (total, chosen), s, x = max(hypotheses, key=lambda h: h[0][0])
    if not chosen or not np.isfinite(total) or (total <= 0.0 and not any(c.meaning for c in kept)):
        return Roles({}, tuple(kept), same)
    doubt = ""
    if s is not None and x is not None:
        swapped = max((t for (t, _), rs, rx in hypotheses if rs is x and rx is s), default=-np.inf)
        if total - swapped < 1.0:
            doubt = f"'{s.name}' and '{x.name}' may be exchanged: neither lags clearly"
    used = {id(role.column) for role in chosen.values()}
    ordered = {signal: chosen[signal] for signal in ORDER if signal in chosen}
    return Roles(ordered, tuple(c for c in kept if id(c) not in used), same, doubt, total)


def _without_copies(columns: Sequence[Candidate]) -> tuple[list[Candidate], dict[str, str]]:
    """The columns without exact copies of others, and copy -> original. Of columns with names of different signals both are kept, but for one encoder
    that is recorded as position and as motor position: two encoders never agree to the last digit."""
    kept: list[Candidate] = []
    same: dict[str, str] = {}
    for column in sorted(columns, key=lambda c: (c.meaning is None, c.means("position"))):
        twin = next((k for k in kept if column.meaning is None and _is_copy(column.values, k.values)), None)
        if column.means("position"):
            twin = next((k for k in kept if k.means("motor_position") and np.array_equal(k.values, column.values)), None)
        if twin is not None and relations.moves(column.values):
            same[column.name] = twin.name
        else:
            kept.append(column)
    return [c for c in columns if any(c is k for k in kept)], same


def _is_copy(a: np.ndarray, b: np.ndarray) -> bool:
    """True for equal columns, up to a constant and the sign: a position in the coordinates of the machine and of the part, or what is left to a target."""
    equal = max(1.01 * decimal_place(b), COPY * float(np.ptp(b)))
    return a.shape == b.shape and min(float(np.ptp(a - b)), float(np.ptp(a + b))) <= equal


COPY = 1e-9
"""Copies differ by the last printed digit, or by rounding in this share of their range."""


class _Evidence:
    """Evidence of the columns of one axis; relations between two columns are computed once."""

    def __init__(self, period: float, kind: str, timed: bool, strange: float) -> None:
        self.period, self.kind, self.timed, self.strange = period, kind, timed, strange
        self._known: dict[tuple[object, ...], Relation] = {}
        self._kept: list[object] = []  # so that no array is freed and its id used again

    def relation(self, find: Callable[..., Relation], a: np.ndarray, b: np.ndarray, *more: object) -> Relation:
        """find(a, b, *more), remembered."""
        key = (find.__name__, *map(id, (a, b, *more)))
        if key not in self._known:
            self._kept += [a, b, *more]
            self._known[key] = find(a, b, *more)
        return self._known[key]

    def pairs(self, columns: Sequence[Candidate]) -> list[tuple[Candidate | None, Candidate | None]]:
        """The likeliest pairs of columns that can be set point and position; None: not recorded."""
        able: list[list[Candidate | None]] = []
        for signal in ("setpoint", "position"):
            able.append([c for c in columns if c.means(signal)] or [None, *_nameless(columns, signal)])
        found = [(s, x) for s, x in itertools.product(*able) if s is not x or s is None]
        both = sorted((p for p in found if None not in p), key=lambda p: -self._pair(*p)[0])  # type: ignore[arg-type]
        return [*both[:_MOST_PAIRS], *(p for p in found if None in p)]

    def of_pair(self, s: Candidate | None, x: Candidate | None, columns: Sequence[Candidate]) -> tuple[float, dict[str, Role]]:
        """Total evidence and roles if s is the set point and x the position."""
        rest = [c for c in columns if c is not s and c is not x]
        shaft = next((c for c in rest if x is None and c.means("motor_position") and relations.moves(c.values)), None)
        total, chosen = 0.0, {}
        for signal, column, other in (("setpoint", s, x), ("position", x, s)):
            if column is not None:
                total += (NAMED - RANK * column.meaning.rank) if column.meaning is not None else ALONE[signal] * ((other or shaft) is None)
                chosen[signal] = Role(column, signal, 0.0, "the axis moves along it" if other is None else "")
        if s is not None and (follower := x or shaft) is not None:
            score = self._pair(s, follower)[0]
            if x is not None and score <= 0.0 and (s.meaning is None or x.meaning is None):
                return -np.inf, {}
            total += score
        if s is not None or x is not None:
            motions = [self._motion(s, x, rest)]
        else:  # only a speed may be recorded
            speeds = [c for c in rest if c.means("velocity")] or _nameless(rest, "velocity")
            summed = [np.cumsum(c.values - (c.values[0] if c.meaning is None else 0.0)) * self.period for c in speeds]
            motions = [shaft.values] if shaft is not None else [*summed]
        best = max((self._assigned(rest, s, x, motion) for motion in motions if motion is not None), key=lambda r: r[0], default=None)
        if best is None:
            return -np.inf, {}
        chosen |= best[1]
        own = chosen.get("position") or chosen.get("motor_position") or chosen.get("velocity")
        if s is not None and own is not None and own.signal != "velocity":
            _, lag, fit = self._pair(s, own.column)
            chosen["setpoint"] = replace(chosen["setpoint"], reason=f"'{own.column.name}' follows it {lag}")
            chosen[own.signal] = replace(own, reason=f"follows '{s.name}' {lag}, to {_within(fit)}")
        if s is None and x is None:
            if own is None:
                return -np.inf, {}
            # a speed is the slope of its own sum: no evidence
            total += 2.0 * ALONE["position"] - (own.score if own.column.meaning is None else 0.0)
            chosen[own.signal] = replace(own, reason="" if own.column.meaning is not None else "the only motion recorded")
        return total + best[0], chosen

    def _motion(self, s: Candidate | None, x: Candidate | None, rest: Sequence[Candidate]) -> np.ndarray | None:
        """Values of the measured motion: position, other encoder, set point minus error; at last the set point."""
        own = {c.meaning.signal: c.values for c in rest if c.meaning is not None and relations.moves(c.values)}
        if x is not None and relations.moves(x.values):
            return x.values
        if "motor_position" in own:
            return own["motor_position"]
        if s is not None and "following_error" in own:
            return s.values - own["following_error"]
        return s.values if s is not None else None

    def _assigned(
        self, rest: Sequence[Candidate], s: Candidate | None, x: Candidate | None, motion: np.ndarray
    ) -> tuple[float, dict[str, Role]]:
        """Best assignment of the other columns to the other signals."""
        signals = ORDER[2:]
        if not rest:
            return 0.0, {}
        found = [[self._of(c, signal, s, x, motion) for signal in signals] for c in rest]
        # of columns that nothing but the motion shows to be a force, only the likeliest is one: the others may be of another axis
        forces = np.isin(signals, list(_FORCES))
        score = np.array([[e for e, _ in row] for row in found])
        nameless = [k for k, c in enumerate(rest) if c.meaning is None and not c.unit]
        for k in sorted(nameless, key=lambda k: max(score[k, ~forces].max(), 0.0) - score[k, forces].max())[1:]:
            score[k, score[k] <= score[k, forces].max()] = NEVER
        # one column of zeros for each column of the record: it may stay out
        matrix = np.hstack([score, np.zeros((len(rest), len(rest)))])
        total, chosen = 0.0, {}
        for row, at in zip(*linear_sum_assignment(matrix, maximize=True)):
            if at < len(signals) and matrix[row, at] > 0.0:
                others = [(matrix[row, j], signals[j]) for j in range(len(signals)) if j != at and matrix[row, j] > 0.0]
                second = max(others)[1] if others and rest[row].meaning is None else ""
                chosen[signals[at]] = Role(rest[row], signals[at], float(matrix[row, at]), found[row][at][1], second)
                total += float(matrix[row, at])
        return total, chosen

    def _of(self, c: Candidate, signal: str, s: Candidate | None, x: Candidate | None, motion: np.ndarray) -> tuple[float, str]:
        """Evidence that a column is a signal of the axis that moves along `motion`, and its reason in numbers."""
        profile = signal == "velocity_feedforward" and s is not None and c.means("velocity_setpoint")
        profile = profile and self.relation(relations.slope, c.values, s.values, self.period).left < PROFILE  # type: ignore[union-attr]
        if not (c.able(signal) if c.meaning is None else profile or c.means(signal)):
            return NEVER, ""
        number, reason = -3.0, ""
        if relations.moves(c.values):
            number, reason = self._numbers(c.values, signal, s.values if s else None, motion)
            if signal in (*_FORCES, "acceleration") and c.meaning is None and relations.plain_course(c.values) < SMOOTH:
                return -1.0, ""  # the motion explains any course as simple as this one
            if signal == "velocity_setpoint" and c.meaning is None and names_output(c.name) and self.timed:
                moved = self.relation(relations.slope, c.values, motion, self.period)
                if moved.left < CLEAR and usual_factor(moved.factor) and (at_speed := min(_of(moved.left), MOST) - 1.5) > number:
                    number, reason = at_speed, f"the axis moves at this speed (to {_within(np.sqrt(moved.left))})"
            if signal == "motor_position" and c.meaning is None:
                number -= 3.0 * (s is None) + 10.0 * (x is None)  # two positions without names are set point and position first
        if c.meaning is not None:
            named = NAMED - 1.0 * (not c.means(signal))  # the speed of a profile, where another column is the output of the controller
            return named - RANK * c.meaning.rank + max(number, -3.0), reason if number > 0.0 else ""
        return number + (0.0 if c.unit or names_output(c.name) else self.strange), reason

    def _pair(self, s: Candidate, x: Candidate) -> tuple[float, str, float]:
        """Evidence that x follows s: how well, how late, and that a set point is smoother than what is measured; lag as text, residual."""
        found = self.relation(relations.follows, x.values, s.values)
        fits = _of(found.left)
        if fits > -0.5 and abs(found.factor - 1.0) > 0.1:
            found = self.relation(relations.follows_in_part, x.values, s.values)
            fits = _of(found.left) - 2.0
        if abs(found.factor - 1.0) > 0.1 and (s.meaning is None or x.meaning is None):
            return -np.inf, "", 1.0
        if found.left > CLEAR and s.meaning is None and x.meaning is None:  # a circle's other axis follows, too
            return -np.inf, "", 1.0
        later = np.sign(found.lag) * _ratio(found.left_without, found.left, 3.0)
        smooth = _ratio(relations.uneven(x.values) ** 2, relations.uneven(s.values) ** 2, 2.0)
        size = f"{abs(found.lag) * self.period * 1e3:.3g} ms" if self.timed else f"{abs(found.lag):.2g} rows"
        lag = f"{size} {'later' if found.lag > 0 else 'earlier'}" if abs(found.lag) > 0.05 else "within a sample"
        return fits + later + smooth, lag, float(np.sqrt(found.left))

    def _numbers(self, y: np.ndarray, signal: str, s: np.ndarray | None, x: np.ndarray) -> tuple[float, str]:
        """Evidence of the numbers alone."""
        if signal == "motor_position":
            return self._encoder(y, s, x)
        if signal in SPEEDS:
            return self._speed(y, signal, s, x)
        if signal == "acceleration":
            found = self.relation(relations.second_slope, y, x, self.period)
            return _of(found.left), f"second slope of the position (to {_within(np.sqrt(found.left))})"
        if signal == "following_error" and s is not None and s is not x:
            found = relations.follows(y, s - x, 1)
            if any(abs(found.factor / power - 1.0) < EQUAL for power in (1.0, 1e3, 1e-3)):
                return _of(found.left) + DIFFERENCE, "set point minus position"
            return _of(found.left) if abs(found.factor - 1.0) < 0.05 else -1.0, "set point minus position"
        if signal in _FORCES:
            found = self.relation(relations.balance, y, x, self.period, self.kind)
            of_x = self.relation(relations.slope, y, x, self.period)
            # a speed is explained by the speed alone
            speed = 3.0 if self.timed and of_x.left < CLEAR and usual_factor(of_x.factor) else 0.0
            how = f"{'goes with' if found.factor >= 0.0 else 'opposes'} acceleration and direction of motion"
            return min(_of(found.left), 4.0) - speed + _FORCES[signal], f"{how} ({100.0 * (1.0 - found.left):.0f} %)"
        return -1.0, ""

    def _encoder(self, y: np.ndarray, s: np.ndarray | None, x: np.ndarray) -> tuple[float, str]:
        """Evidence that y is the motor's encoder beside the position x: it agrees, leads in motion, and does not close the position loop."""
        found = self.relation(relations.follows, y, x, 5)
        score = _of(found.left) if abs(found.factor - 1.0) < 0.1 else -1.0
        if score <= 0.0:
            return score, ""
        ahead = relations.ahead(y, x)
        score += float(np.clip(2.0 * ahead, -1.5, 1.5))
        if s is not None:
            score += _ratio(self.relation(relations.follows, y, s).left, found.left, 3.0)
            score += _ratio(relations.settled(s, y), relations.settled(s, x), 1.0)
        lead = ", ahead of it in motion" if ahead > 0.0 else ""
        return score, f"agrees with the position (to {_within(float(np.std(y - x) / (np.ptp(x) or 1.0)))} of its travel){lead}"

    def _speed(self, y: np.ndarray, signal: str, s: np.ndarray | None, x: np.ndarray) -> tuple[float, str]:
        """Evidence for a speed, the speed of the profile or the output of the position controller."""
        of_x = self.relation(relations.slope, y, x, self.period)
        of_s = self.relation(relations.slope, y, s, self.period) if s is not None else Relation(0.0, 1.0)
        # an unusual factor or a speed against the motion is rare
        odd = -(1.5 * (self.timed and not usual_factor(of_x.factor)) + 1.5 * (of_x.factor < 0.0))
        if signal == "velocity":
            better = _ratio(of_s.left, of_x.left, 2.0) if s is not None else 0.0
            return _of(of_x.left) + better + odd, f"slope of the position (to {_within(np.sqrt(of_x.left))})"
        if s is None:
            return -1.0, ""
        if signal == "velocity_feedforward":
            return _of(of_s.left) + _ratio(of_x.left, of_s.left, 2.0) + odd, f"slope of the set point (to {_within(np.sqrt(of_s.left))})"
        found = self.relation(relations.law, y, s, x, self.period)
        # the axis does what the command says: without this, a force that a controller commands would pass, too
        better = min(_ratio(min(of_x.left, of_s.left), found.left, 3.0), max(_of(of_x.left), 0.0))
        score = min(_of(found.left), 2.0 * _of(of_x.left)) - 1.5 + better
        return score, f"gain times following error (to {_within(np.sqrt(found.left))})"


def _within(share: float) -> str:
    """A remainder as a share: '0.3 %', '< 0.1 %'."""
    return f"{100.0 * share:.1f} %" if share >= 0.0005 else "< 0.1 %"


def _nameless(columns: Sequence[Candidate], signal: str) -> list[Candidate]:
    """The columns that move, whose names say nothing, and whose units are those of this signal."""
    return [c for c in columns if c.meaning is None and c.able(signal) and relations.moves(c.values)]


def _of(left: float) -> float:
    """Evidence of a relation that leaves this share of the variance."""
    return float(min(-np.log(max(left, TINY)) - 1.0, MOST))


def _ratio(worse: float, better: float, limit: float) -> float:
    """Half the logarithm of two residuals, limited; 0 if one is unknown."""
    if not (np.isfinite(worse) and np.isfinite(better)):
        return 0.0
    return float(np.clip(0.5 * np.log(max(worse, 1e-12) / max(better, 1e-12)), -limit, limit))
