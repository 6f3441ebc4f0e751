"""What is odd in a recording: one direction against the other, one stroke against the next, one axis against another.

Each remark needs evidence: the interval of a difference excludes zero, or the strokes differ by more than the scatter inside them allows.
The scatter inside a stroke is that of the means of its parts, because neighbouring samples are not independent.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from twin.diagnose.first.axis_facts import AxisFacts
from twin.diagnose.first.people import shown
from twin.identify.recorded_axis import Strokes
from twin.units import AXIS_UNITS

LEVEL = 1e-3
"""Probability of a remark about strokes that do not differ."""
PARTS = 6
"""Parts of a stroke whose means give its scatter."""
LEAST_STROKES = 3
START_S = 0.15
"""The peak of a stroke is sought within this time after its start [s]."""
MANY_TIMES = 2.0
"""A peak that exceeds what motion explains by this factor of the friction is worth a sentence."""


class Odd(NamedTuple):
    """One remark: axis, kind (direction, stroke, start, axes, transmission), sentence."""

    axis: str
    kind: str
    sentence: str


def oddities(facts: Sequence[AxisFacts]) -> list[Odd]:
    """All remarks on a recording, axis by axis."""
    checks = {"direction": _direction, "stroke": _strokes, "start": _starts, "transmission": _encoders}
    return [Odd(one.name, kind, sentence) for one in facts for kind, check in checks.items() for sentence in check(one)] + list(
        _axes(facts)
    )


def _direction(one: AxisFacts) -> Iterator[str]:
    """A constant part of the effort: it needs more in one direction; and a part that goes with the place."""
    f = one.friction
    if f is not None and f.by_place is not None and f.by_place.known:
        by_place = shown(f.effort).interval(abs(f.by_place.value), f.by_place.half)
        yield f"needs {by_place} more at the {'upper' if f.by_place.value > 0 else 'lower'} end of its travel than at the other (counterbalance, cable, slope)"
    if f is None or f.constant is None or not f.constant.known or one.kind == "rotary":
        return
    size = shown(f.effort)
    more, less = abs(f.at_speed.value + abs(f.constant.value)), abs(f.at_speed.value - abs(f.constant.value))
    way = ("negative", "positive") if f.constant.value < 0 else ("positive", "negative")
    yield (
        f"needs {size.text(more)} in {way[0]} and {size.text(less)} in {way[1]} direction: a constant {f.effort} of "
        f"{size.interval(abs(f.constant.value), f.constant.half)} (weight, counterbalance, cable drag, or friction that differs by direction)"
    )


def _strokes(one: AxisFacts) -> Iterator[str]:
    """Strokes of one direction that differ in what their motion does not explain."""
    for name, values in one.left.items() if one.rows is not None else ():
        size = shown("error", one.kind) if name == "error" else shown(name)
        for sign, way in ((1.0, "positive"), (-1.0, "negative")):
            assert one.rows is not None
            means, errors, numbers = _means(one.rows, values, sign)
            if len(means) < LEAST_STROKES or (worst := _different(means, errors)) is None:
                continue
            begin = float(one.rows.time[one.rows.stroke == numbers[worst]].min())
            others = np.delete(means, worst)
            more = (means[worst] - others.mean()) * (sign if name != "error" else 1.0)
            what = "following error" if name == "error" else name
            yield (
                f"the stroke in {way} direction that starts at {begin:.2f} s has about {size.text(abs(more))} {'more' if more > 0 else 'less'} "
                f"{what} than the {len(others)} others of this direction, which scatter by {size.text(float(np.ptp(others)))}"
            )


def _means(rows: Strokes, values: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mean, its standard error, number) of the steady part of each stroke in one direction."""
    means, errors, numbers = [], [], []
    for stroke in np.unique(rows.stroke):
        own = values[(rows.stroke == stroke) & rows.steady & (np.sign(rows.speed) == sign)]
        if len(own) < 4 * PARTS:
            continue
        parts = [float(part.mean()) for part in np.array_split(own, PARTS)]
        means.append(float(np.mean(parts)))
        errors.append(float(np.std(parts, ddof=1)) / np.sqrt(PARTS))
        numbers.append(stroke)
    return np.array(means), np.array(errors), np.array(numbers)


def _different(means: np.ndarray, errors: np.ndarray) -> int | None:
    """Index of the mean that differs most from the others, if it does at LEVEL; else None."""
    from scipy.stats import t

    scores = []
    for i, (mean, error) in enumerate(zip(means, errors)):
        others = np.delete(means, i)
        spread = np.sqrt(error**2 + np.var(others, ddof=1) * (1.0 + 1.0 / len(others)) + np.mean(np.delete(errors, i) ** 2) / len(others))
        scores.append(abs(mean - others.mean()) / max(float(spread), 1e-300))
    worst = int(np.argmax(scores))
    return worst if t.sf(scores[worst], len(means) - 2 + PARTS - 1) * 2.0 * len(means) < LEVEL else None


def _starts(one: AxisFacts) -> Iterator[str]:
    """Peaks of the effort at the starts of strokes that acceleration and friction do not explain."""
    f, rows = one.friction, one.rows
    if f is None or rows is None or not f.at_speed.known:
        return
    peaks = []
    for stroke in np.unique(rows.stroke):
        own = (rows.stroke == stroke) & (rows.time < rows.time[rows.stroke == stroke].min() + START_S)
        peaks.append(float(np.abs(one.left[f.effort][own]).max()))
    size, middle = shown(f.effort), float(np.median(peaks))
    if middle >= max(MANY_TIMES * f.at_speed.half, f.at_speed.value / MANY_TIMES):
        yield (
            f"the {f.effort} peaks at {size.text(f.peak)}; at the starts of its {len(peaks)} strokes up to {size.text(max(peaks))} "
            f"(median {size.text(middle)}) are explained neither by friction ({size.text(f.at_speed.value)}) nor by acceleration"
        )


def _encoders(one: AxisFacts) -> Iterator[str]:
    """Lost motion between motor encoder and scale."""
    found = one.transmission
    if found is not None and found.lost is not None and found.lost.known and abs(found.lost.value) >= one.noise:
        size = shown("error", one.kind)
        yield (
            f"motor encoder and scale differ by {size.interval(abs(found.lost.value), found.lost.half)} between the directions of motion: "
            "play or wind-up of the drive train"
        )


def _axes(facts: Sequence[AxisFacts]) -> Iterator[Odd]:
    """Axes of one kind whose lags differ: they do not meet on a contour."""
    by_flag: dict[tuple[str, str], list[AxisFacts]] = {}
    for one in facts:
        for flag in one.lags:
            by_flag.setdefault((one.kind, flag), []).append(one)
    for (kind, flag), own in by_flag.items():
        ordered = sorted(own, key=lambda one: one.lags[flag].value)
        low, high = ordered[0], ordered[-1]
        more = high.lags[flag].value - low.lags[flag].value
        half = float(np.hypot(high.lags[flag].half, low.lags[flag].half))
        at = min(low.speed, high.speed)
        # a difference that is smaller than what the lag leaves anyway does not show on a part
        left = max(float(np.std(one.left["error"])) for one in (low, high))
        if more > half and more * at > left:
            size, speed = shown("error", kind), AXIS_UNITS[kind].speed
            with_flag = f" with feedforward {flag}" if flag else ""
            yield Odd(
                high.name,
                "axes",
                f"lags {more * 1e3:.2f} +- {half * 1e3:.2f} ms more than axis {low.name}{with_flag}: {size.text(more * at)} apart "
                f"at {at * speed[1]:.3g} {speed[0]} on a common path",
            )
