"""A recorded command with the signals of its control, and what the control does to its set points before it uses them.

s'(k) = sum_j w_j s(k - d - j)        d whole cycles late, behind a filter of weights w (`set_point_filters`) or none
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import functools

import numpy as np
from scipy.optimize import minimize_scalar

from twin.control.block import Block
from twin.control.set_point_filters import SET_POINT_AVERAGE, SET_POINT_LAG
from twin.estimate.held_out_gain import is_better

MOST_DELAY_CYCLES = 24
"""Latest set points that are looked for, in cycles of the record."""

LONGEST_FILTER = 4.0
"""Longest time of a filter in delays that make up for it: an average is as late as a delay of half its time, a lag as one of all of it."""

MOST_CYCLES = 40_000
"""The path of the set points is searched on at most so many cycles, from the first motion of each run on."""

RESOLVED_CYCLES = 1e-3
"""The time of a filter is searched this closely."""


@dataclass(frozen=True)
class CommandRun:
    """Signals of one run at the cycles of the control (sample,), SI; the steps to which command, set point, position and motor encoder are rounded, and
    the noise of all but the first that the record shows (RMS). `motor`: the position whose differences are the speed, None if it is `position`.
    """

    period: float
    setpoint: np.ndarray
    position: np.ndarray
    speed: np.ndarray | None
    command: np.ndarray
    steps: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    noise: tuple[float, ...] = (0.0, 0.0, 0.0)
    motor: np.ndarray | None = None

    def part(self, cycles: slice) -> "CommandRun":
        """The run in some of its cycles."""
        speed, motor = (None if values is None else values[cycles] for values in (self.speed, self.motor))
        return replace(
            self, setpoint=self.setpoint[cycles], position=self.position[cycles], speed=speed, command=self.command[cycles], motor=motor
        )

    @property
    def turned(self) -> np.ndarray:
        """The position whose differences are the speed."""
        return self.position if self.motor is None else self.motor


@dataclass(frozen=True)
class _SampleCycles:
    """A control that computes once a sample."""

    position_cycle: float
    speed_cycle: float
    current_cycle: float


@dataclass(frozen=True)
class SetPointPath:
    """Set points that act some cycles late, behind a filter with a time [cycles] or none."""

    delay: int = 0
    filter: Block | None = None
    cycles: float = 0.0

    @property
    def number(self) -> str:
        """Name of the time of its filter."""
        assert self.filter is not None
        return self.filter.numbers[0].name

    def at(self, cycles: float) -> "SetPointPath":
        """The same with another time of its filter."""
        return replace(self, cycles=cycles)

    def of(self, runs: Sequence[CommandRun]) -> list[CommandRun]:
        """The runs with the set points that the control uses, without the first cycles, whose set points are not recorded."""
        return [self._of_run(run) for run in runs]

    def _of_run(self, run: CommandRun) -> CommandRun:
        s, lost = run.setpoint, self.delay
        if self.filter is not None and self.filter.kernel is not None:
            weights = self.filter.kernel({self.number: self.cycles * run.period}, _SampleCycles(run.period, run.period, run.period))
            s = s[0] + np.convolve(s - s[0], weights)[: len(s)]
        return replace(run.part(slice(lost, None)), setpoint=s[: len(s) - lost])


PROMPT = SetPointPath()
"""Set points that act at once."""


def _moving_part(run: CommandRun, most: int) -> CommandRun:
    """At most so many cycles of a run, from its first motion on."""
    moved = int(np.argmax(run.setpoint != run.setpoint[0]))
    first = max(min(moved, len(run.setpoint) - most), 0)
    return run.part(slice(first, first + most))


def set_point_path(runs: Sequence[CommandRun], fewest: int, squares: Callable[[Sequence[CommandRun], bool], np.ndarray]) -> SetPointPath:
    """How the set points of these runs reach the control; at once where nothing else predicts the command better.

    `fewest`: cycles of a run that a law needs. `squares`: mean squares (piece,) of what a law leaves of the held-out commands, if the set point acts
    by a single step (True) or by several. Several steps make up for a wrong delay, so a single one decides, once several show that the set points
    act late, or once a single late one leaves as much as several prompt ones, but for rounding.
    """
    most = max(MOST_CYCLES // len(runs), 8 * fewest)
    runs = [_moving_part(run, most) for run in runs]
    longest = min(len(run.command) for run in runs) - fewest

    @functools.cache
    def left(path: SetPointPath, single: bool = True) -> np.ndarray:
        return squares(path.of(runs), single)

    def misfit(path: SetPointPath) -> float:
        return float(np.log(left(path)).mean())

    late = min((SetPointPath(delay) for delay in range(min(longest, MOST_DELAY_CYCLES) + 1)), key=misfit)
    single, several = left(late), left(PROMPT, False)
    of_rounding = max(run.steps[0] for run in runs) ** 2 / 12.0
    as_good = is_better(single, left(PROMPT), 0.0) and single.mean() - several.mean() <= min(several.mean(), of_rounding)
    if not (as_good or is_better(left(late, False), several, 0.0)):
        return PROMPT
    paths = [late]
    for block in (SET_POINT_AVERAGE, SET_POINT_LAG):
        for delay in range(late.delay):  # what is shorter than the delay alone
            path = SetPointPath(delay, block)
            longest_filter = LONGEST_FILTER * (late.delay - delay)
            end = minimize_scalar(
                lambda cycles, at=path.at: misfit(at(cycles)),
                bounds=(RESOLVED_CYCLES, longest_filter),
                method="bounded",
                options={"xatol": RESOLVED_CYCLES},
            )
            paths.append(path.at(float(end.x)))
    best = min(paths, key=misfit)
    return best if is_better(left(best), left(late), 0.0) else late
