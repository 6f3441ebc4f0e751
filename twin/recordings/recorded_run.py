"""One run from its recordings and the map: columns found, converted and resampled; units and skew checked.

The result reads from the recordings block by block, so a run is never held in memory as a whole.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from msgspec import structs
import numpy as np
from scipy.interpolate import CubicSpline

from twin.errors import InputError, nearest
from twin.recordings.channels import Channel, Piece, block_with_most_travel, conversion_of, on_grid, pieces_of, recorded_from
from twin.recordings.encoder_offsets import encoder_offset, offset_notes
from twin.recordings.mapping import FOLLOWING_ERROR, PATH_FROM, PROFILE_SPEED, ColumnMap, Map, RunMap, path_source
from twin.recordings.plausible import doubts_of, lone_samples
from twin.recordings.profile_speed import at_changes
from twin.recordings.relations import ForceSign, force_sign, stuck
from twin.recordings.roles import MOTION
from twin.recordings.roughness import decimal_place
from twin.recordings.signals import BLOCK, Event, Recording, Signal
from twin.recordings.skew import Skew, relative_to_first_encoder, skews_of
from twin.recordings.timing import Timing, at_even_times, timing_of
from twin.recordings.trace import BY_UNIT, ENCODERS, FORCES, POSITIONS
from twin.recordings.units_found import SLOWEST_S, steps_of_a_turn
from twin.units import AXIS_UNITS, in_words

SHORTEST_S = 0.2
"""Shorter pieces between two gaps are left out."""
SAME_INTERVAL = 1e-3


@dataclass(frozen=True)
class Understood:
    """All information about a run. `notes` are shown to the user; `skews` are the estimated skews."""

    run: RunMap
    channels: tuple[Channel, ...]
    kinds: Mapping[str, str]
    pieces: tuple[Piece, ...]
    fill: bool
    notes: tuple[str, ...]
    skews: tuple[Skew, ...]
    started: datetime | None
    begin: float  # start of the recordings [s]
    events: tuple[Event, ...] = ()
    labels: Mapping[tuple[Piece, str], float] = field(default_factory=dict)
    """Value of each label column in each piece where it is constant."""
    signs: Mapping[tuple[str, str], ForceSign] = field(default_factory=dict)
    offsets: Mapping[tuple[Piece, str], tuple[str, float]] = field(default_factory=dict)
    """Encoder that does not have the zero of the set point, and its constant difference to the other one [m or rad], by piece and axis with both."""
    centred: bool = False  # offsets are removed
    made: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """Signals that are not recorded -> what they are made from: a set point, because no run can be simulated without."""

    def block(self, piece: Piece, first: int, last: int) -> dict[tuple[str, str], np.ndarray]:
        """Signals of rows first .. last of a piece, SI."""
        out = {c.key: on_grid(c, piece, first, last, self.fill) for c in self.channels}
        for axis in {a for a, _ in out}:
            error = out.pop((axis, FOLLOWING_ERROR), None)
            if self.centred and (piece, axis) in self.offsets:
                encoder, offset = self.offsets[piece, axis]
                out[axis, encoder] = out[axis, encoder] - offset
            if (source := self.made.get((axis, "setpoint"))) == "velocity":
                out[axis, "motor_position"] = self._travelled((axis, source), piece, first, last)
            if source == PROFILE_SPEED:
                del out[axis, PROFILE_SPEED]  # it is not known whether the control uses it as feedforward
                out[axis, "setpoint"] = self._travelled((axis, source), piece, first, last)
            elif source is not None:
                measured = next(out[axis, s] for s in ENCODERS if (axis, s) in out)
                out[axis, "setpoint"] = measured + (error if source == FOLLOWING_ERROR and error is not None else 0.0)
            if error is not None and source != FOLLOWING_ERROR:
                out.setdefault((axis, "position"), out[axis, "setpoint"] - error)
        return out

    def _travelled(self, key: tuple[str, str], piece: Piece, first: int, last: int) -> np.ndarray:
        """Sum of a speed from the begin of the piece [m or rad], by trapezoids: T (v_0/2 + v_1 + ... + v_k/2)."""
        channel = next(c for c in self.channels if c.key == key)
        before = sum(float(on_grid(channel, piece, at, min(at + BLOCK, first), self.fill).sum()) for at in range(0, first, BLOCK))
        own = on_grid(channel, piece, first, last, self.fill)
        return piece.period * (before - 0.5 * float(on_grid(channel, piece, 0, 1, self.fill)[0]) + np.cumsum(own) - 0.5 * own)


def run_of_recordings(mapping: Map, run: RunMap, recordings: Sequence[Recording]) -> Understood:
    """Analyse a run before it is written. Raises InputError if the map does not fit or units are contradictory."""
    channels, kinds, notes = _channels(mapping, run, recordings)
    fill = mapping.settings.gaps == "fill"
    if fill and (parts := next((r for r in recordings if r.restarts), None)) is not None:
        raise InputError(f'{mapping.path}: gaps = "fill", but the time of {parts.path} starts again in each part; use gaps = "split"')
    made = _made(channels)
    # the samples of the set point, or of what replaces it, define the grid
    leading = [c for s in MOTION for c in channels if c.column.signal == s]
    lead = next((c for c in leading if not c.held), leading[0])
    period = mapping.period_s or _rounded_interval(lead.timing.interval)
    notes += [*_interval_notes(channels, period), *_gap_notes(channels, mapping, run)]
    begin = min(s.begin for c in channels for s in c.timing.stretches)
    if (on := recorded_from(channels) - begin) > run.from_s:
        notes.append(f"all channels are 0 for {on:.4g} s, then the position is somewhere else: this part is left out")

    def pieces_in_common(channels: Sequence[Channel]) -> tuple[Piece, ...]:
        """Pieces of sufficient length with samples of all channels."""
        ordered = sorted(channels, key=lambda c: c.key != lead.key)
        pieces = pieces_of(ordered, period, begin + max(run.from_s, on), begin + run.to_s, fill)
        return tuple(p for p in pieces if p.count * period >= min(SHORTEST_S, 20 * period))

    pieces = pieces_in_common(channels)
    if not pieces:
        apart = f"its signals have no {SHORTEST_S:g} s in common"
        raise InputError(f"{mapping.path}: run {run.name}: {apart}; check from_s, to_s, skew_ms and the files")
    started = next((r.started for r in recordings if r.started is not None), None)
    known = Understood(run, channels, kinds, pieces, fill, (), (), started, begin, made=made)
    notes += [f"{axis}: no set point is recorded; {PATH_FROM[source]}" for (axis, s), source in made.items() if s == "setpoint"]
    longest = max(pieces, key=lambda p: p.count)
    window = known.block(longest, *block_with_most_travel(lead, longest, fill))
    doubts = doubts_of(window, period, kinds, mapping.machine)
    # the size of a force in a unit that is assumed says nothing
    assumed = {c.key for c in channels if c.column.unit_assumed and c.column.signal in FORCES}
    known_units = [d for d in doubts if (d.axis, d.signal) not in assumed]
    if known_units and mapping.settings.units == "refuse":
        more = f" (and {len(known_units) - 1} more)" if len(known_units) > 1 else ""
        raise InputError(f'{mapping.path}: run {run.name}: {known_units[0].text}{more}; units = "report" in the map imports it anyway')
    notes += [*(d.text for d in doubts), *_lone_notes(window, kinds)]
    signs = _force_signs(window, period, kinds)
    skews = relative_to_first_encoder(skews_of(window, period, kinds))
    # a path from the profile's speed is known to half a sample: this may be the last step of the set points or the next one
    moments = [i for i in skews if made.get((i.axis, "setpoint")) == PROFILE_SPEED and i.signal == "velocity" and abs(i.seconds) < period]
    skews = [i for i in skews if i not in moments]
    resting = [key for key, values in window.items() if np.ptp(values) == 0.0 and np.ptp(window[key[0], "setpoint"]) > 0.0]
    notes += [f"{axis}.{signal} never changes while the axis moves: is it the right column?" for axis, signal in resting]
    notes += [f"{axis}.{signal} pushes against the motion: sign = -1?" for axis, signal in sorted(signs) if signs[axis, signal].sign < 0]
    free = [c for c in channels if c.column.sign_bit is None]
    notes += [f"{'.'.join(c.key)}: '{c.column.name}' {place}" for c in free if (place := stuck(c.signal.head))]
    notes += _radian_notes(channels)
    if period >= SLOWEST_S and any(not r.source.known or r.source.column for r in recordings):
        notes.append(f"the samples are {period:g} s apart: an index, or ms taken as s? give [time] unit or interval_ms in the map")
    notes += _left_notes(mapping, recordings)
    notes += [f"{axis}.{signal}: {signs[axis, signal].remark}" for axis, signal in sorted(signs) if signs[axis, signal].unsigned]
    correct = _corrected(skews, mapping.settings.skew, period)
    notes += _skew_notes(skews, correct, period)
    correct |= {(i.axis, PROFILE_SPEED): -0.5 * period * round(2.0 * i.seconds / period) for i in moments}
    if correct:
        channels = tuple(replace(c, skew_s=c.skew_s + correct.get(c.key, 0.0)) for c in channels)
        pieces = pieces_in_common(channels)
    known = replace(known, channels=channels, pieces=pieces, skews=tuple(skews), signs=signs)
    offsets, centred = _offsets(known), mapping.settings.offsets == "correct"
    notes += offset_notes(offsets, kinds, centred)
    events = tuple(sorted((e for r in recordings for e in r.events), key=lambda e: e.time))
    labels = _labels(mapping.settings.labels, recordings, pieces)
    return replace(known, notes=tuple(notes), offsets=offsets, centred=centred, events=events, labels=labels)


def _channels(mapping: Map, run: RunMap, recordings: Sequence[Recording]) -> tuple[tuple[Channel, ...], dict[str, str], list[str]]:
    """The mapped columns with conversion and timing, the kinds of the axes, and notes. Refuses a map that does not fit."""
    notes = [note for recording in recordings for note in recording.notes]
    found, missing = [], []
    for column in mapping.columns:
        place = _find(column, recordings, str(mapping.path))
        if place is None:
            missing.append(column)
            continue
        recording, signal = place
        if not recording.source.known:
            raise InputError(f"{recording.path}: {recording.source.text}, or [time] interval_ms = ... in the map")
        if not len(signal.time):
            where = f"{recording.path}: column '{signal.name}'"
            raise InputError(f"{where}: has {len(signal.values)} samples, which differs from the time column; leave it out of the map")
        conversion = conversion_of(column, signal, mapping.machine, str(recording.path))
        if column.signal in BY_UNIT:
            column = structs.replace(column, signal=BY_UNIT[column.signal][conversion.si])
        found.append((column, recording, signal, conversion))
    keys = [column.key for column, *_ in found]
    if not found:
        raise InputError(f"{mapping.path}: run {run.name}: the map has no [[column]] for its files; run 'twin import' without --map")
    if twice := next((k for k in keys if keys.count(k) > 1), None):
        raise InputError(f"{mapping.path}: run {run.name}: two columns are {'.'.join(twice)}; leave one out of the map")
    notes += [f"no column '{c.name}' ({c.axis}.{c.signal}); it is optional" for c in missing if c.key not in keys]
    for axis in dict.fromkeys(axis for axis, _ in keys):
        if not any((axis, signal) in keys for signal in MOTION):
            raise InputError(f"{mapping.path}: run {run.name}: axis {axis} has no set point, position or speed; map the column of one")
    kinds: dict[str, str] = {}
    for column, _, _, conversion in found:
        if (kind := conversion.kind) and (other := kinds.setdefault(column.axis, kind)) != kind:
            made = f"[{conversion.unit}] makes axis {column.axis} {kind}, another column makes it {other}"
            raise InputError(f"{mapping.path}: column '{column.name}': {made}; correct one unit")
    timings: dict[int, Timing] = {}
    channels = []
    for column, recording, signal, conversion in found:
        # the reader of text has checked every cell
        if recording.format != "CSV" and (bad := signal.impossible()) is not None:
            where = f"{recording.path}: column '{signal.name}': sample {bad[0] + 1} ({float(signal.time[bad[0] : bad[0] + 1][0]):.6g} s)"
            raise InputError(f"{where} holds {bad[1]}; repair it, or leave the column out")
        held = 1
        if column.signal in POSITIONS:
            signal, held = at_changes(signal)
        if held > 1:
            why = "a cycle of the control" if column.signal == "setpoint" else "the recorder reads it once in these"
            notes.append(f"{column.axis}: the {in_words(column.signal)} stands for {held} samples: {why}; it is interpolated between")
        if id(signal.time) not in timings:
            timing = timing_of(signal.time, str(recording.path), mapping.period_s)
            if column.signal in POSITIONS:
                timing = at_even_times(timing, signal.time, signal.values)
            timings[id(signal.time)] = timing
            notes += [n for n in timing.notes if n not in notes]
        timing, skew_s = timings[id(signal.time)], column.skew_ms * 1e-3
        channels.append(Channel(column, signal, timing, conversion, recording.path.name, skew_s, held > 1))
    for k, error in enumerate(channels):
        if error.column.signal == FOLLOWING_ERROR and (error.column.axis, "setpoint") not in keys:
            channels[k], held = _of_interpolated_set_point(error, [c for c in channels if c.column.axis == error.column.axis])
            if held > 1:
                why = "a cycle of the control"
                notes.append(
                    f"{error.column.axis}: position plus following error stands for {held} samples: {why}; it is interpolated between"
                )
    return tuple(channels), kinds, notes


def _of_interpolated_set_point(error: Channel, own: Sequence[Channel]) -> tuple[Channel, int]:
    """The following error of an axis (its channels: `own`) from a set point that does not stand in each cycle of the control, and its samples in a cycle."""
    beside = next((c for s in POSITIONS for c in own if c.column.signal == s and c.signal.time is error.signal.time), None)
    if beside is None:
        return error, 1
    count = len(error.signal.values)
    measured, apart = (c.conversion(np.asarray(c.signal.values[0:count], float)) for c in (beside, error))
    digit = max(decimal_place(c.signal.head) * abs(c.conversion.factor) for c in (beside, error))
    path = np.rint((measured + apart) / digit) * digit if digit else measured + apart
    given, held = at_changes(replace(error.signal, values=path))
    if held > 1:
        at, time = np.asarray(given.time[0 : len(given.values)]), np.asarray(error.signal.time[0:count])
        apart = CubicSpline(at, given.values)(np.clip(time, at[0], at[-1])) - measured
        error = replace(error, signal=replace(error.signal, values=(apart - error.conversion.offset) / error.conversion.factor))
    return error, held


def _made(channels: Sequence[Channel]) -> dict[tuple[str, str], str]:
    """Set points, and motor positions, that are not recorded -> what they are made from."""
    made = {}
    for axis in dict.fromkeys(c.key[0] for c in channels):
        own = {c.key[1] for c in channels if c.key[0] == axis}
        if "setpoint" not in own:
            source = made[axis, "setpoint"] = path_source(own)
            made |= {(axis, "motor_position"): source} if source == "velocity" else {}
    return made


def _corrected(skews: Sequence[Skew], skew: str, period: float) -> dict[tuple[str, str], float]:
    """Skew [s] of the channels that are corrected by the map. A speed that is late because it is a difference of positions is left: the control uses it."""
    chosen = [i for i in skews if i.clear and (skew == "correct" or (i.signal in (*POSITIONS, "velocity") and not i.differenced(period)))]
    return {(i.axis, i.signal): i.seconds for i in chosen} if skew != "report" else {}


def _labels(names: Sequence[str], recordings: Sequence[Recording], pieces: Sequence[Piece]) -> dict[tuple[Piece, str], float]:
    """Values of the label columns in the pieces where they are constant."""
    labels = {}
    for name in names:
        labelled = next((r.signals[name] for r in recordings if name in r.signals and len(r.signals[name].values)), None)
        if labelled is None or not len(labelled.time):
            continue
        time, values = (np.asarray(column[0 : len(column)], float) for column in (labelled.time, labelled.values))
        for piece in pieces:
            own = values[(time >= piece.begin - 1e-9) & (time <= piece.end + 1e-9)]
            if len(own) and not np.ptp(own) > 0.0:
                labels[piece, name] = float(own[0])
    return labels


def _force_signs(window: Mapping[tuple[str, str], np.ndarray], period: float, kinds: Mapping[str, str]) -> dict[tuple[str, str], ForceSign]:
    """Signs of the recorded forces relative to the motion."""
    out = {}
    for axis, signal in (key for key in window if key[1] in FORCES):  # a set point is always there, recorded or made
        position = next(window[axis, s] for s in (*ENCODERS, "setpoint") if (axis, s) in window)
        out[axis, signal] = force_sign(window[axis, signal], position, period, kinds[axis])
    return out


def _offsets(known: Understood) -> dict[tuple[Piece, str], tuple[str, float]]:
    """`encoder_offset` by piece and axis with both encoders."""
    out = {}
    for piece in known.pieces:
        block = known.block(piece, 0, min(piece.count, BLOCK))
        for axis in known.kinds:
            both = {signal: block[axis, signal] for signal in ENCODERS if (axis, signal) in block}
            if len(both) == len(ENCODERS):
                out[piece, axis] = encoder_offset(both, block[axis, "setpoint"])
    return out


def has_columns(mapping: Map, recordings: Sequence[Recording]) -> bool:
    """Whether one of these recordings has a column of the map."""
    return any(_named(column, recording) for column in mapping.columns for recording in recordings)


def _named(column: ColumnMap, recording: Recording) -> list[str]:
    """Names of signals that are this column: its name, or else 'group/channel' that ends in it."""
    return [n for n in recording.signals if n == column.name] or [n for n in recording.signals if n.rpartition("/")[2] == column.name]


def _find(column: ColumnMap, recordings: Sequence[Recording], where: str) -> tuple[Recording, Signal] | None:
    """The column in one of a run's recordings: by name, or by a unique last part of 'group/channel'; None if it is optional and absent."""
    for recording in recordings:
        names = _named(column, recording)
        if len(names) > 1:
            raise InputError(f"{recording.path}: '{column.name}' is in several groups; name one of {', '.join(names)} in the map")
        if names and len(recording.signals[names[0]].values):
            return recording, recording.signals[names[0]]
    if column.optional:
        return None
    known = [n for r in recordings for n in r.signals]
    files = ", ".join(str(r.path) for r in recordings)
    if column.name in known:
        raise InputError(f"{files}: column '{column.name}' is empty; record it again, or leave it out of the map")
    raise InputError(f"{files}: no column '{column.name}'; {nearest(column.name, known)}")


def _rounded_interval(interval: float) -> float:
    """An interval without rounding errors of printed times: 1 ms instead of 1.00000004 ms."""
    for digits in (2, 3, 4, 5):
        rounded = float(f"{interval:.{digits}g}")
        if abs(rounded - interval) < 2e-7 * interval:
            return rounded
    return interval


def _gap_notes(channels: Sequence[Channel], mapping: Map, run: RunMap) -> list[str]:
    """A note on missing samples; refused if the map asks for that."""
    gaps = {(round(a.end, 6), round(b.begin, 6)) for c in channels for a, b in zip(c.timing.stretches, c.timing.stretches[1:])}
    if not gaps:
        return []
    shown = ", ".join(f"{(b - a) * 1e3:.4g} ms after {a:.6g} s" for a, b in sorted(gaps)[:3]) + (", ..." if len(gaps) > 3 else "")
    if mapping.settings.gaps == "refuse":
        raise InputError(f'{mapping.path}: run {run.name}: samples are missing ({shown}); gaps = "split" or "fill" in the map imports it')
    done = "filled by a cubic" if mapping.settings.gaps == "fill" else "the run is split there"
    return [f"{len(gaps)} gap{'s' * (len(gaps) > 1)} in time ({shown}): {done}"]


def _skew_notes(skews: Sequence[Skew], correct: Collection[tuple[str, str]], period: float) -> Iterator[str]:
    """Notes on each clear skew, with its interval and whether it was corrected."""
    for item in skews:
        if item.clear:
            size = f"{abs(item.seconds) * 1e3:.3f} ms {'late' if item.seconds > 0 else 'early'}"
            left = "left as it is: skew = 'correct' or skew_ms in the map corrects it"
            done = "corrected" if (item.axis, item.signal) in correct else left
            if samples := item.differenced(period):
                done += f" (a difference of positions over {samples} samples is late by this)"
            against = f"against the {in_words(item.reference)} (+-{1e3 * item.half:.3f} ms)"
            yield f"{item.axis}.{item.signal} is {size} {against}; {done}"


def _radian_notes(channels: Sequence[Channel]) -> Iterator[str]:
    """Notes on positions that were mapped as lengths, but have the steps of an encoder in radians."""
    for c in channels:
        linear = c.key[1] in POSITIONS and c.conversion.kind == "linear" and c.column.scale is None
        if linear and (turn := steps_of_a_turn(c.signal.head, 2.0 * np.pi)) is not None:
            steps = f"its steps are 1/{turn:.0f} of a turn in rad"
            yield f"{'.'.join(c.key)}: {steps}, but it is mapped as {c.conversion.unit}: radians?"


def _lone_notes(window: Mapping[tuple[str, str], np.ndarray], kinds: Mapping[str, str]) -> Iterator[str]:
    """Notes on measured positions that hold what no axis does in one sample."""
    for (axis, signal), values in window.items():
        if signal in ENCODERS and len(lone := lone_samples(values)):
            unit, factor = AXIS_UNITS[kinds[axis]].position
            far = float(np.abs(np.diff(values)).max()) * factor
            spoilt = "errors of the record? they spoil mass, friction and gains: leave these rows out"
            yield f"{axis}.{signal} leaves its motion for single samples, {len(lone)} times by up to {far:.3g} {unit}: {spoilt}"


def _left_notes(mapping: Map, recordings: Sequence[Recording]) -> list[str]:
    """A note on the columns of the files that the map leaves out."""
    used = {*(c.name for c in mapping.columns), *mapping.settings.labels}
    left = [name for r in recordings for name in r.signals if name not in used and name.rpartition("/")[2] not in used]
    shown = ", ".join(left[:6]) + (f" and {len(left) - 6} more" if len(left) > 6 else "")
    return [f"not in the map: {shown}"] if left else []


def _interval_notes(channels: Sequence[Channel], period: float) -> Iterator[str]:
    """Notes on signals with another interval."""
    groups: dict[float, list[str]] = {}
    for channel in channels:
        interval = channel.timing.interval
        if abs(interval - period) > SAME_INTERVAL * period:
            groups.setdefault(round(interval, 9), []).append(".".join(channel.key))
    for every, names in groups.items():
        taken = f"picked every {period * 1e3:.4g} ms; period_ms = {every * 1e3:.4g} in the map keeps all of it"
        if every > period:
            taken = f"interpolated to {period * 1e3:.4g} ms"
        yield f"{', '.join(names)}: recorded every {every * 1e3:.4g} ms, {taken}"
