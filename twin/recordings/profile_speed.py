"""What a recorded speed set point is: the output of a position controller, or a profile such as the slope of the set point; and its cycle.

profile     w*(t) = c + sum_j a_j (s(t+j) - s(t+j-1))                     any difference, filter or delay of the set point
                  + sum_j f_j f(t-j)                                      and the velocity feedforward f, where it is recorded
output      w*(t) = the same + sum_j b_j (s(t-j) - x(t-j))                a controller also answers the following error

Both laws are fitted on the even pieces of the motion and judged on the odd ones, and the other way round. A recorded speed that the first
law gives as well as the second does not answer the position: no gain, delay or lateness of a position controller follows from it.
The pieces vote by the logarithm of what is left, so that one piece unlike the others (a pulse of friction compensation) does not decide.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.estimate.held_out_gain import held_out, is_better, pieces_of
from twin.recordings.signals import Signal
from twin.recordings.trace import ENCODERS, Trace

SIGNAL = "velocity_setpoint"
AHEAD, BEHIND, ERRORS = 2, 10, 3
"""Samples of the set point before and after the present one, and samples of the following error that the laws use."""

LEAST_ROWS, MOST_ROWS = 60, 4_000
"""Fewest samples that are judged, and most that are read of one run."""

ANSWERS = 0.8
"""The recorded speed answers the position if the second law leaves surely less than the first of a held-out piece, on average less than this share.
Controllers leave 0.02 to 0.3, profiles 1.0."""

PROFILE = f"{SIGNAL} does not answer the position in this record: taken as the slope of the set point or another profile, it is not used"


def answers_position(traces: Sequence[Trace], axis: str) -> bool | None:
    """Whether the recorded speed set point of an axis answers its following error; None if too little is recorded."""
    parts = [p for t in traces if t.has(axis, SIGNAL) and (p := _rows(t, axis)) is not None]
    if not parts or sum(len(p[1]) for p in parts) < LEAST_ROWS:
        return None
    profile, errors, y = (np.concatenate([p[i] for p in parts]) for i in range(3))
    pieces = np.concatenate([pieces_of(len(p[2]), k) for k, p in enumerate(parts)])
    alone, both = (held_out(columns, y, pieces) for columns in (profile, np.column_stack([profile, errors])))
    least = 1e-9 * float(np.std(y)) + 1e-150
    return is_better(both, ANSWERS**2 * alone, least)


def held_samples(speed_setpoints: Sequence[np.ndarray]) -> int:
    """Samples for which recorded speed set points stand: a position controller of a longer cycle than the samples gives them. 0: no whole number of them."""
    changes = np.concatenate([np.diff(w) for w in speed_setpoints] or [np.zeros(1)])
    if not changes.any():
        return 1
    # means of the samples up to each one, and from each one on; in slow motion rounding hides changes
    means = np.abs(np.convolve(changes, np.ones(WINDOW) / WINDOW, "full"))
    digit = np.abs(changes[changes != 0.0]).min()
    fast = np.minimum(means[: len(changes)], means[WINDOW - 1 :]) > FINE * digit
    steps = np.diff(np.flatnonzero(np.abs(changes[fast]) > 1.5 * digit))  # a sum of two rounded signals wavers by a digit
    if not len(steps) or np.mean(steps > 1) < SELDOM:
        return 1
    held = int(np.median(steps))
    if held == 1:  # a cycle between one and two samples has no longer gaps; those of an output that rests in a dead band have any length
        return 0 if np.mean(steps[steps > 1] == 2) > MOSTLY_HELD else 1
    return held if np.mean(steps % held == 0) > MOSTLY_HELD else 0


def at_changes(signal: Signal) -> tuple[Signal, int]:
    """A position that stands for several samples, once in them: a set point as the control gave it; and for how many it stands, 1 for any other signal."""
    held = held_samples([signal.head])
    if held < 2:
        return signal, 1
    first = int(np.bincount((np.flatnonzero(np.diff(signal.head)) + 1) % held).argmax())
    values, time = (np.asarray(column[0 : len(column)], float)[first::held] for column in (signal.values, signal.time))
    return replace(signal, values=values, time=time), held


WINDOW, FINE = 10, 5.0
"""Motion is fast enough to judge where the speed set point changes by more than FINE of its digits a sample, in the mean over WINDOW samples on
both sides: there a controller that computes in each sample changes it in each."""

SELDOM, MOSTLY_HELD = 0.1, 0.9
"""A signal is held if more than SELDOM of its changes follow after two samples or later, and for a whole number of samples if MOSTLY_HELD of them lie
multiples of it apart."""


def _rows(trace: Trace, axis: str) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Columns of the profile and of the errors (row, k), and speed set point (row,) of one trace while its set point moves."""
    seen = [trace.get(axis, s) for s in ENCODERS if trace.has(axis, s)]
    if not seen or not trace.moves(axis):
        return None
    setpoint, y = trace.get(axis, "setpoint"), trace.get(axis, SIGNAL)
    step = np.diff(setpoint, prepend=setpoint[0])
    at = np.arange(BEHIND + 1, len(y) - AHEAD)
    at = at[np.convolve(step != 0.0, np.ones(BEHIND + AHEAD), "same")[at] > 0]
    at = at[y[at] != y[at - 1]]  # a record faster than the controller repeats its output
    at = at[:: max(1, len(at) // MOST_ROWS)]
    fed = trace.signals.get((axis, "velocity_feedforward"), np.zeros(len(y)))
    profile = np.column_stack([*(step[at + j] for j in range(AHEAD, -BEHIND - 1, -1)), *(fed[at - j] for j in range(2)), np.ones(len(at))])
    # only one encoder closes the loop; with both in each run the law finds which
    errors = np.column_stack([(setpoint - (seen[0] if k == 0 else seen[-1]))[at - j] for k in range(2) for j in range(ERRORS)])
    return profile, errors, y[at]
