"""A map proposed from column names and recorded numbers: roles, units, signs, moving axes, time. There is always one.

Names group the columns by axis and state what they say; numbers assign the rest (`roles`) and check the names (`propose_axis`). Columns that do
not move, spin or have no use are listed as well, so that nothing is omitted silently. The columns of a given map stand, and the rest is added.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace

import numpy as np

from twin.errors import InputError
from twin.recordings.mapping import MOTIONS, PATH_FROM, Map, path_source
from twin.recordings.names import Meaning, axis_alone, compared, groups, meaning_of, without_shared_words
from twin.recordings.one_axis import by_signals
from twin.recordings.propose_axis import AxisProposal, propose_axis
from twin.recordings.propose_columns import PROFILE, Proposed
from twin.recordings.relations import moves
from twin.recordings.signals import Recording, Signal, TimeSource
from twin.recordings.time_column import by_speed, numbers_rows, time_of, with_time
from twin.recordings.timing import is_riddled, timing_of
from twin.recordings.trace import FORCES
from twin.units import in_words

FURTHER = 8.0
"""Least evidence that columns without names are a further axis: a position, its speed, and a set point that it follows or a force."""
OWN_COMMANDS = {"velocity_setpoint": "a speed", "torque_setpoint": "a torque"}
"""Commands of an axis without a position loop, which has no set point."""
_LETTERS = "XYZUVWABC"


@dataclass
class Proposal:
    """Columns; omitted axes and columns with the reason; time if the map must give it; lost samples; feedforward in use; what is said and asked."""

    columns: list[Proposed] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    unknown: dict[str, str] = field(default_factory=dict)  # column -> reason, "" if there is none
    labels: list[str] = field(default_factory=list)
    time: TimeSource = field(default_factory=TimeSource)
    fill: bool = False  # lost samples are filled
    feedforward: set[str] = field(default_factory=set)  # of the recordings that show it
    notes: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    said: list[tuple[str, str, str]] = field(default_factory=list)  # axis, signal, remark
    asked: list[tuple[str, str, str]] = field(default_factory=list)  # the same, assumptions

    @property
    def used(self) -> list[Proposed]:
        """Columns without doubt."""
        return [c for c in self.columns if not c.doubt]

    @property
    def axes(self) -> list[str]:
        return list(dict.fromkeys(c.axis for c in self.used))


def propose(recordings: Sequence[Recording], given: Map | None = None) -> Proposal:
    """Propose the map of these recordings. `given`: a partial map. Raises InputError if times cannot be read."""
    time = time_of(recordings)
    out, axes = _axes(with_time(recordings, time), given, time.known)
    speed = next((a.speed for a in axes if a.speed is not None), None)
    if speed is not None and (better := by_speed(time, *speed)) != time:
        changed = (better.unit, better.interval) != (time.unit, time.interval)
        time = better
        if changed:
            out, axes = _axes(with_time(recordings, time), given, True)
    out.time = time
    timed = with_time(recordings, time)
    out.fill = any(_is_riddled(r, out.used) for r in timed) and not any(r.restarts for r in recordings)
    everywhere = set.intersection(*({*r.signals} for r in recordings))
    out.columns = [replace(c, optional=c.name not in everywhere) for c in out.columns]
    out.notes += [time.text] * (not time.question.startswith(time.text))
    out.questions += [time.question] * bool(time.question)
    out.notes += _together(out.said)
    out.questions += _together(out.asked, "; if not, correct it in the map")
    counters = {name for r in recordings for name, s in r.signals.items() if numbers_rows(s.head)}
    out.unknown |= {name: "counts rows: an index, no time" for name in out.unknown if name in counters}
    if not out.used and not out.left_out:
        out.notes.append("none of these columns is the motion of an axis")
    commanded = {c.axis for c in out.used if c.signal == "setpoint"}  # without one, a speed of the profile may have this name
    fed = [c for c in out.columns if c.axis in commanded and PROFILE not in c.remark and not c.assumed]
    out.feedforward = {_feedforward_in(r, fed) for r in recordings} - {""}
    return out


def _is_riddled(recording: Recording, columns: Sequence[Proposed]) -> bool:
    """Whether samples of its first column are lost so often that a run would fall into short pieces."""
    own = next((recording.signals[c.name] for c in columns if c.name in recording.signals), None)
    if own is None or len(own.time) < 2:
        return False
    with contextlib.suppress(InputError):  # importing says what is wrong with the times
        return is_riddled(timing_of(own.time, str(recording.path)))
    return False


def _axes(recordings: Sequence[Recording], given: Map | None, timed: bool) -> tuple[Proposal, list[AxisProposal]]:
    """The proposal without the time, and the proposals of its axes."""
    out = Proposal()
    meanings = _meanings(recordings, given, out)
    names = list(dict.fromkeys(name for r in recordings for name in r.signals))
    free = [n for n in names if n not in out.unknown and n not in out.labels]
    labels, astray, shown = by_signals(recordings, meanings, free)
    meanings = {name: replace(m, axis=labels[name]) for name, m in meanings.items() if name in labels}
    out.unknown |= dict.fromkeys(astray, "nothing states its axis, and its numbers go with no axis alone")
    out.said += [(axis, "", f"one axis by their numbers: {', '.join(map(repr, found))}") for axis, found in shown.items()]
    by_axis = groups([n for n in free if n not in astray], labels)
    if list(by_axis) == [""]:
        by_axis = {"X": by_axis[""]}
    out.unknown |= dict.fromkeys(by_axis.pop("", []), "")
    found = []
    for group in sorted(by_axis, key=lambda a: (a.isdigit(), int(a) if a.isdigit() else 0, a)):
        left = by_axis[group]
        known = {n: meanings[n] for n in left if n in meanings}
        # columns without names may hold further axes
        for axis in (group, *(a for a in _LETTERS if a not in by_axis)):
            signals = _signals_of_one_recording(recordings, left, known)
            own = propose_axis(axis, signals, known, timed) if signals else None
            if own is None or (axis != group and own.score < FURTHER):
                break
            out.unknown = {name: why for name, why in out.unknown.items() if name not in left}
            _take(own, axis, left, meanings, out)
            found.append(own)
            offered = {signal.name for signal in signals}
            left = [n for n in left if n not in meanings and (n not in offered or own.unused.get(n) == "")]
            out.unknown |= dict.fromkeys(left, "")
            if known or len(left) < 2:
                break
    return out, found


def _take(own: AxisProposal, axis: str, names: Sequence[str], meanings: Mapping[str, Meaning], out: Proposal) -> None:
    """Add an axis to the proposal, or the reason why it is omitted."""
    signals = {c.signal for c in own.columns if not c.doubt}
    if not own.left_out and not signals & {*MOTIONS, "setpoint"}:
        own.left_out = f"axis {axis}: none of its columns is a sound motion"
    elif not own.left_out and not signals & {*MOTIONS, *FORCES}:
        only = f"only its set point is recorded ({', '.join(c.name for c in own.columns)})"
        own.left_out = f"axis {axis}: {only}; the actual position is missing"
    if own.left_out:
        # a group without a known name is no axis that anyone would miss
        if any(n in meanings for n in names):
            out.left_out.append(own.left_out)
        out.columns += [c if c.doubt else replace(c, doubt="its axis is left out") for c in own.columns]
        out.unknown |= {n: own.unused.get(n, "") for n in names if n not in {c.name for c in own.columns}}
        return
    out.columns += own.columns
    out.unknown |= own.unused
    out.said += [(axis, "", own.doubt)] * bool(own.doubt)
    if "setpoint" not in signals:
        commanded = " or ".join(word for signal, word in OWN_COMMANDS.items() if signal in signals)
        alone = f"; commanded by {commanded} alone it has no position loop" if commanded else ""
        out.said.append((axis, "", f"no set point is recorded; {PATH_FROM[path_source(signals)]}{alone}"))
    used = [c for c in own.columns if not c.doubt]
    out.said += [(axis, in_words(c.signal), c.remark) for c in used if c.remark and c.remark != c.assumed]
    if not any(c.name in meanings for c in used):
        out.asked.append((axis, "", "no name says what its columns are: taken by their numbers alone"))
    out.asked += [(axis, in_words(c.signal), c.assumed) for c in used if c.assumed]


def _together(said: Sequence[tuple[str, str, str]], ending: str = "") -> Iterator[str]:
    """Remarks (axis, signal, text) with those of the same text in one line: 'X Y Z: velocity: ...'."""
    for text in dict.fromkeys(text for *_, text in said):
        axes, signals = (dict.fromkeys(one[k] for one in said if one[2] == text) for k in (0, 1))
        yield f"{' '.join(axes)}: " + (f"{', '.join(signals)}: " if any(signals) else "") + text + ending


def _feedforward_in(recording: Recording, columns: Sequence[Proposed]) -> str:
    """The feedforward that a recording shows; "" if it has no feedforward signal of these columns."""
    moved = [(c.signal, moves(recording.signals[c.name].head)) for c in columns if c.name in recording.signals]
    if not any(signal == "velocity_feedforward" for signal, _ in moved):
        return ""
    torque = ("torque_feedforward", True) in moved
    return "off" if ("velocity_feedforward", True) not in moved else "velocity+torque" if torque else "velocity"


def _signals_of_one_recording(recordings: Sequence[Recording], names: Sequence[str], known: Collection[str]) -> list[Signal]:
    """The signals of an axis from the recording with most of them (of equals, where they change most); of those that it lacks, the known ones.

    A column without a known name is judged by its numbers, which another recording's motion does not explain.
    """

    def motion(recording: Recording) -> tuple[int, float]:
        own = [recording.signals[n] for n in names if n in recording.signals and _timed(recording.signals[n])]
        return len(own), sum(float(np.ptp(fine)) for s in own if len(fine := s.head[np.isfinite(s.head)]))

    ranked = sorted(recordings, key=motion, reverse=True)
    there = {n: [r.signals[n] for r in ranked[: None if n in known else 1] if n in r.signals and _timed(r.signals[n])] for n in names}
    return [found[0] for found in there.values() if found]


def _timed(signal: Signal) -> bool:
    return len(signal.time) > 0 and len(signal.values) > 0


def _meanings(recordings: Sequence[Recording], given: Map | None, out: Proposal) -> dict[str, Meaning]:
    """Column -> meaning, of the given map or of its name. Labels and columns of other use are entered into the proposal."""
    stated = {c.name: Meaning(c.axis, c.signal, c.unit or "", -1) for c in given.columns} if given else {}
    meanings: dict[str, Meaning] = {}
    plain = without_shared_words(dict.fromkeys(name for r in recordings for name in r.signals))
    for name in plain:
        own = [r.signals[name] for r in recordings if name in r.signals and _timed(r.signals[name])]
        if not own:
            if rows := max(len(r.signals[name].values) for r in recordings if name in r.signals):
                out.unknown[name] = f"{rows} samples, whose times nothing states"
            continue
        meaning = stated.get(name) or meaning_of(plain[name], own[0].unit, "")
        if meaning is not None and meaning.signal:
            meanings[name] = meaning
        elif any(r.restarts and name in r.signals for r in recordings) and _label(own[0]):
            out.labels.append(name)
        elif meaning is not None:
            out.unknown[name] = "known, but no signal of the twin"
    said = {*meanings, *out.unknown, *out.labels}
    others = {n: s.unit for r in recordings for n, s in r.signals.items() if n not in said}
    if not any(m.signal in (*MOTIONS, "setpoint") for m in meanings.values()):
        alone = {n: m for n, unit in others.items() if (m := axis_alone(plain[n], unit)) is not None}
        alone = {n: m for n, m in alone.items() if m.unit or m.axis not in _LETTERS or _glides(recordings, n)}
        letters = {m.axis for m in alone.values()} & {*_LETTERS}
        if letters & {*"XYZ"} or any(m.axis not in letters for m in alone.values()):  # U, V, W may be phases
            meanings |= alone
            others = {n: unit for n, unit in others.items() if n not in alone}
            out.asked += [(m.axis, "position", "the column is named by its axis alone: taken as the position") for m in alone.values()]
    moved = {m.axis for m in meanings.values() if m.signal != "acceleration"}
    lone = [n for n, m in meanings.items() if m.signal == "acceleration" and m.axis and m.axis not in moved and n not in stated]
    out.unknown |= dict.fromkeys(lone, "the acceleration of a sensor: no other column is of its axis")
    meanings = {n: m for n, m in meanings.items() if n not in lone}
    axes = {c.axis for c in given.columns} if given else {m.axis for m in meanings.values() if m.axis}
    return compared(meanings, others, "" if len(axes) > 1 else next(iter(axes), "X"))


def _glides(recordings: Sequence[Recording], name: str) -> bool:
    """True if a column changes little from row to row, as a position does, and a vibration not."""
    values = next(r.signals[name].head for r in recordings if name in r.signals)
    fine = values[np.isfinite(values)]
    return len(fine) > 2 and moves(fine) and float(np.std(np.diff(fine))) < GLIDES * float(np.std(fine))


GLIDES = 0.3
"""Largest step from row to row of a position in standard deviations: at ten samples a period it is 0.6, of noise 1.4."""


def _label(signal: Signal) -> bool:
    """True if a column is constant within the parts of a file and differs between them."""
    values = np.asarray(signal.values[0 : len(signal.values)], float)
    changes = np.flatnonzero(np.diff(values) != 0.0)
    return 0 < len(changes) < len(values) / 20
