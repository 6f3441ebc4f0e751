"""The columns of a law of a recorded command over the signals of its control (`command_law`), and what rounding makes of them.

u = c_e (s - x) + sum a_j ds(k-j) - sum b_j dx(k-j) + c_i int (s - x) + c_x x + c
"""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from twin.control.command_run import CommandRun
from twin.estimate.held_out_gain import pieces_of

LONGEST_DIFFERENCE = 6
"""The control differentiates the position over at most this many cycles."""

AHEAD, BEHIND = 1, 2
"""Steps of the set point before and after the present cycle that the feedforward uses; a profile's own speed is a cycle ahead of its steps."""

NO_SPEED = -1
"""In place of a number of differences: the command does not answer the speed, as that of a valve. Then the law is another one."""

EARLIEST, LATEST = -1, 2
"""Whole cycles from the record of the signals to that of the command that answers them; below 0 the position is recorded late."""

FIRST, LAST = LONGEST_DIFFERENCE + BEHIND + LATEST, AHEAD - EARLIEST
"""Cycles at the begin and at the end of a run whose columns need signals beyond it."""

ROUNDED = 1e-5
"""Laws that leave less than this share of the command are equally good: signals are recorded with some digits."""

BLOCK = 256
"""Cycles of a stretch whose errors may be related: at a steady speed a command hardly changes, and its rounding is one error for as long."""

AT_LIMIT = 0.995
"""A command beyond this share of its largest value may be limited and is not used."""

FED = AHEAD + BEHIND + 1
"""Columns of the steps of the set point."""

STEPS_AHEAD = np.arange(AHEAD, -BEHIND - 1, -1)
"""Cycles from the present one to each of them."""


class Form(NamedTuple):
    """Speed over n cycles, with or without an integral part, by one difference (`even`) or any weights, of signals `late` cycles before the
    command. `holds`: the integral part stays where the command is at its largest value, its limit.
    """

    n: int
    integral: bool
    even: bool
    late: int = 0
    holds: bool = False

    @property
    def width(self) -> int:
        """Number of columns of the speed."""
        return 1 if self.even else max(self.n, 0)


ANY_SPEED = Form(LONGEST_DIFFERENCE, True, False)
"""The form that has any speed and an integral part."""


def with_held(forms: Sequence[Form], runs: Sequence[CommandRun]) -> list[Form]:
    """The forms, and those of an integral part that holds at a limit if the command stays at its largest value."""
    stays = any(bool(np.any(at[1:] & at[:-1])) for at in _at_largest(runs))
    return [*forms, *(form._replace(holds=True) for form in forms if form.integral and stays)]


def _at_largest(runs: Sequence[CommandRun]) -> list[np.ndarray]:
    """Where (sample,) the command of each run is at the largest value of all."""
    largest = max(float(np.abs(run.command).max()) for run in runs)
    return [np.abs(run.command) >= largest - 0.5 * run.steps[0] for run in runs]


def asked_of(runs: Sequence[CommandRun]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row,) Commands that a law explains, their pieces of the motion, and whether they are below the limit."""
    y = np.concatenate([r.command[FIRST:-LAST] for r in runs])
    pieces = np.concatenate([pieces_of(len(r.command) - FIRST - LAST, k) for k, r in enumerate(runs)])
    return y, pieces, np.abs(y) <= AT_LIMIT * np.abs(y).max()


def blocks_of(runs: Sequence[CommandRun]) -> np.ndarray:
    """(row,) Number of the stretch of BLOCK cycles of each row; stretches count as independent."""
    ends = np.cumsum([0, *(len(run.command) for run in runs)])
    return np.concatenate([(end + np.arange(FIRST, len(run.command) - LAST)) // BLOCK for end, run in zip(ends, runs)])


def columns_of(runs: Sequence[CommandRun], form: Form) -> np.ndarray:
    """Columns (row, k): error, steps of the set point, steps of the position or motor encoder (or the speed), a constant of each run, integral terms
    with an offset.
    """
    parts = []
    for k, (run, largest) in enumerate(zip(runs, _at_largest(runs))):
        at = np.arange(FIRST, len(run.command) - LAST) - form.late
        asked = at + min(form.late, 0)  # a position that is recorded late alone
        ds, dx = (np.diff(v, prepend=v[0]) / run.period for v in (run.setpoint, run.turned))
        speeds = [dx[at - j] for j in range(form.n)] if form.n else [run.speed[at]]  # type: ignore[index]  # none for NO_SPEED
        speeds = [np.mean(speeds, axis=0)] if form.even else speeds
        own = [float(k == other) for other in range(len(runs))]
        constant = [np.full(len(at), one) for one in own]
        error = run.setpoint[asked] - run.position[at]
        integral: list[np.ndarray] = []
        if form.integral:
            # a cycle counts where the command that answers it is below its limit
            counts, asked_counts = (~np.roll(largest & form.holds, -late) for late in (form.late, max(form.late, 0)))
            integral += [one * run.period * (np.cumsum(counts)[at - 1] - FIRST) for one in own]  # an offset of the position, summed
            signals = ((run.setpoint, asked_counts), (run.turned, counts))
            gone, turned = (v - np.cumsum(np.diff(v, prepend=v[0]) * ~counted) for v, counted in signals)
            if sums_apart(runs, form):
                integral.append(gone[asked - 1] - turned[at - 1] - error)
            # the integrator of this cycle holds the errors up to the last one
            of_setpoint = np.cumsum((run.setpoint - run.setpoint[0]) * asked_counts) * run.period
            of_position = np.cumsum((run.position - run.setpoint[0]) * counts) * run.period
            integral += [of_setpoint[asked - 1] - of_position[at - 1], turned[at - 1] - turned[0]]
        parts.append(np.column_stack([error, *(ds[asked + j] for j in range(AHEAD, -BEHIND - 1, -1)), *speeds, *constant, *integral]))
    return np.concatenate(parts)


def sums_apart(runs: Sequence[CommandRun], form: Form) -> bool:
    """Whether the integral of the feedforward has a column: of one encoder and without a limit, error and steps have it in them."""
    return runs[0].motor is not None or form.holds


def roundings_of(form: Form, period: float, apart: bool) -> list[np.ndarray]:
    """(column, cycle) What a change of set point, of position and, if it is another (`apart`), of the motor encoder in each cycle adds to the
    error and to the steps of `columns_of`.
    """
    steps = np.eye(FED, FED + 1) - np.eye(FED, FED + 1, 1)
    moves = np.eye(form.n, form.n + 1) - np.eye(form.n, form.n + 1, 1)
    moves = (moves.mean(axis=0, keepdims=True) if form.even and form.n else moves) / period
    moves = moves if form.n else np.zeros((1, 1))
    of_setpoint = np.vstack([np.eye(1, FED + 1, AHEAD), steps / period, np.zeros((len(moves), FED + 1))])
    of_error = np.vstack([-np.eye(1, moves.shape[1]), np.zeros((FED + len(moves), moves.shape[1]))])
    of_speed = np.vstack([np.zeros((1 + FED, moves.shape[1])), moves])
    return [of_setpoint, of_error, of_speed] if apart else [of_setpoint, of_error + of_speed]


def rounding_of(runs: Sequence[CommandRun], b: np.ndarray, form: Form) -> list[float]:
    """RMS of the command that the rounding of command, set point and encoders makes in a law with the coefficients of `columns_of`."""
    answers = answers_of(runs, b, form)
    return [float(np.linalg.norm(answer)) * max(run.steps[i] for run in runs) / math.sqrt(12.0) for i, answer in enumerate(answers)]


def answers_of(runs: Sequence[CommandRun], b: np.ndarray, form: Form) -> list[np.ndarray]:
    """What a change of command, set point, position and another motor encoder in one cycle adds to the command in this and others (cycle,)."""
    apart = runs[0].motor is not None
    return [np.ones(1), *(b[: len(each)] @ each for each in roundings_of(form, runs[0].period, apart))]
