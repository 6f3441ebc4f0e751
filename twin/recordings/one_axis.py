"""Columns of one axis that a file names in several ways: `pid.x` beside `joint.0`, a slave of a bus by its number, a force without an axis.

The stem of a path numbers its own things: no name says which of `pid.x`, `joint.1`, `encoder.00` are one axis. The signals do: a copy of the set
point or position up to unit and a short delay, a position that follows a set point, a speed that is a slope, a force that moves a mass. Parts join where
this holds for one pair alone: not two axes of a gantry with one set point, nor two on a straight line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from twin.recordings import relations
from twin.recordings.names import Meaning, stem_and_axis
from twin.recordings.propose_axis import at_times, times_compared
from twin.recordings.relations import Relation, moves
from twin.recordings.signals import Recording
from twin.recordings.trace import SPEEDS
from twin.recordings.units_found import MET
from twin.units import RECORDED_UNITS

COPY, FOLLOWS, SLOPE, FORCE = 1e-4, 1e-2, 0.05, 0.35
"""Most share of the variance that is left of a copy, a position by its set point, a speed by a slope, a force by the motion that it drives."""
LEAST = 1e-18
"""A smaller share is rounding."""
LATE_S = 0.05
"""Longest delay: a longer one would fit one axis of a circle to the other."""
CLEARLY = 1.0
"""Least logarithm of the ratio of two residuals by which one pair is better than another."""
_PLACES = {"setpoint": "setpoint", "position": "position", "motor_position": "position"}


@dataclass
class Part:
    """Columns of one axis by their names. `label`: its name, "" if none is stated; `sure`: it names an axis, not a board or an input."""

    label: str
    sure: bool
    names: list[str] = field(default_factory=list)
    found: list[str] = field(default_factory=list)  # one name of each part that the signals joined to this one


def by_signals(
    recordings: Sequence[Recording], meanings: Mapping[str, Meaning], free: Sequence[str]
) -> tuple[dict[str, str], list[str], dict[str, list[str]]]:
    """Column -> axis; the columns that go with none of several axes; axis -> one column of each part that the signals joined to it."""
    places: dict[object, dict[str, Part]] = {}
    for name in free:
        stem, label, sure = stem_and_axis(name)
        if (meaning := meanings.get(name)) is not None and meaning.axis != label:
            stem, label, sure = "", meaning.axis, bool(meaning.axis)
        if label or meaning is not None:
            place: object = (stem, label.isdigit()) if label else name
            places.setdefault(place, {}).setdefault(label, Part(label, sure)).names.append(name)
    axes: list[Part] = []
    astray: list[str] = []
    by_place = [list(parts.values()) for parts in places.values()]
    for parts in sorted(by_place, key=lambda own: -sum(meanings[n].signal in _PLACES for p in own for n in p.names if n in meanings)):
        standing = list(axes)
        evidence = np.array([[_evidence(recordings, meanings, p, q) for q in standing] for p in parts]).reshape(len(parts), len(standing))
        links = {i: j for i, j in np.ndindex(evidence.shape) if _alone(evidence, i, j)}
        for i, part in enumerate(parts):
            named = [j for j, q in enumerate(standing) if part.label in ("", q.label) and j not in links.values()]
            if i in links:
                axis = standing[links[i]]
                axis.found += part.names[:1] if part.label != axis.label else []
            elif len(named) == 1 and (part.label or len(standing) == 1):
                axis = standing[named[0]]
            elif not part.label or any(part.label == q.label for q in axes):
                astray += part.names
                continue
            else:
                axes.append(axis := Part(part.label, part.sure))
            axis.names += part.names
            if part.sure and not (axis.sure and part.label.isdigit()):
                axis.label, axis.sure = part.label, True
    labels = {name: axis.label for axis in axes for name in axis.names}
    return labels, astray, {axis.label: [axis.names[0], *axis.found] for axis in axes if axis.found}


def _alone(evidence: np.ndarray, i: int, j: int) -> bool:
    """True if part i is axis j, and neither may be another one."""
    others = [*np.delete(evidence[i], j), *np.delete(evidence[:, j], i)]
    return bool(evidence[i, j] > 0.0 and all(evidence[i, j] >= other + CLEARLY for other in others))


def _evidence(recordings: Sequence[Recording], meanings: Mapping[str, Meaning], p: Part, q: Part) -> float:
    """Logarithm of the limits of the relations between the columns of p and q over what they leave: positive where they are one axis."""
    if p.sure and q.sure and (p.label == q.label or p.label.isdigit() == q.label.isdigit()):
        return math.inf if p.label == q.label else -math.inf
    recording = next((r for r in recordings if all(any(n in r.signals for n in part.names) for part in (p, q))), None)
    if recording is None:
        return 0.0
    own = [{n: recording.signals[n] for n in part.names if n in recording.signals} for part in (p, q)]
    own = [{n: s for n, s in part.items() if len(s.time) and moves(s.head) and not s.impossible()} for part in own]
    leads = [next((s for n, s in part.items() if n in meanings and meanings[n].signal in _PLACES), None) for part in own]
    lead = leads[1] or leads[0]
    if lead is None:
        return 0.0
    time = times_compared(lead)
    late = max(int(LATE_S / float(np.median(np.diff(time)))), 1)
    values = [{n: at_times(s, time, meanings[n].unit if n in meanings else s.unit) for n, s in part.items()} for part in own]
    placed = [{n: v for n, v in part.items() if n in meanings and meanings[n].signal in _PLACES} for part in values]
    kinds = [{_PLACES[meanings[n].signal]: v for n, v in part.items()} for part in placed]
    if both := kinds[0].keys() & kinds[1].keys():
        return sum(_copy(relations.follows(kinds[0][k], kinds[1][k], late), COPY) for k in both)
    if all(kinds):
        (a,), (b,) = (tuple(part.values()) for part in kinds)
        return _copy(relations.follows(a, b, late), FOLLOWS)
    places, rest = (kinds[1], values[0]) if kinds[1] else (kinds[0], values[1])
    base = places.get("position", places.get("setpoint"))
    assert base is not None
    return max((_goes_with(meanings[n].signal if n in meanings else "", v, base, time, kinds) for n, v in rest.items()), default=0.0)


def _goes_with(signal: str, y: np.ndarray, place: np.ndarray, time: np.ndarray, kinds: Sequence[Mapping[str, np.ndarray]]) -> float:
    """Evidence that a speed, a following error, a force, or a column of unknown use is of the axis that moves along `place`."""
    period = float(np.median(np.diff(time)))
    if signal == "following_error":
        known = next((part for part in kinds if len(part) == 2), None)
        return _copy(relations.follows(y, known["setpoint"] - known["position"], 2), SLOPE) if known else 0.0
    slope = math.log(SLOPE / max(relations.slope(y, place, period).left, LEAST))
    if signal in SPEEDS:
        return slope
    force = math.log(FORCE / max(relations.balance(y, place, period, "linear").left, LEAST))
    return force if signal else max(slope, force)


def _copy(found: Relation, limit: float) -> float:
    """Evidence of a copy up to a unit: axes that move along a straight line are proportional, too."""
    usual = any(abs(abs(found.factor) / ratio - 1.0) < MET for ratio in _RATIOS)
    return math.log(limit / max(found.left, LEAST)) if usual else -CLEARLY


_UNITS = [unit for unit in RECORDED_UNITS.values() if unit[0] in ("length", "angle")]
_RATIOS = [a / b for kind, a in _UNITS for other, b in _UNITS if kind == other]
