"""What a run takes from the drives, counted at every tick inside the compiled loop.

A record of 1 kHz sees two samples of a current that the position controller steps every 2 ms: its largest value and its RMS come
out too low, and differently for each design. The loop therefore adds up, tick by tick, where a run asks for it:

    mean square     of the current over the tick, exact for the exponential between two ticks
    smooth part     the mean over each position cycle: what the motion asks for; the rest within the cycle is ripple
    work            motor torque times speed, T (w_before + w_after) / 2 h: exact for the kinetic energy under held torque
    electrical      u times the mean current over the tick
    largest torque  while driving, in classes of speed: the duty cycle against the motor's curve; braking, the back EMF helps

Everything is of the true current, without measuring noise. Sums stand in one row an axis, D_... name its columns.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.machine.axis import Axis

(
    D_CYCLE_SUM,  # A, mean currents of the ticks of the running position cycle
    D_CYCLE_SQUARE,  # A2, their mean squares
    D_CYCLES,  # whole position cycles
    D_SQUARE,  # A2, mean squares of whole cycles
    D_SMOOTH_SQUARE,  # A2, squares of the means of whole cycles
    D_LARGEST,  # A
    D_SMOOTH_LARGEST,  # A
    D_WORK,  # J
    D_BRAKING,  # J, the negative part of the work
    D_ELECTRICAL,  # J
    D_LARGEST_SPEED,  # axis units a second
) = range(11)
SUMS = 11

SPEED_CLASSES = 50
"""Classes of speed, up to FASTEST times the axis' limit; what is faster counts to the last one."""
FASTEST = 1.25


class DriveSums(NamedTuple):
    """What the loop adds up: sums (axis, D_...) and largest torque (axis, class) [Nm at the motor]; no axis where nothing is counted."""

    sums: np.ndarray
    torque: np.ndarray
    classes_per_speed: np.ndarray  # (axis,) classes for each axis unit a second


NOTHING_COUNTED = DriveSums(np.zeros((0, SUMS)), np.zeros((0, SPEED_CLASSES)), np.zeros(0))


def drive_sums(axes: tuple[Axis, ...]) -> DriveSums:
    """Sums of a run that has not begun."""
    classes = np.array([SPEED_CLASSES / (FASTEST * axis.max_velocity) for axis in axes])
    return DriveSums(np.zeros((len(axes), SUMS)), np.zeros((len(axes), SPEED_CLASSES)), classes)


@compiled(inline=True)
def count_tick(a, counted, drives, state, before, mean, motor_speed, cycle_ends, position_ticks, h):  # type: ignore[no-untyped-def]
    """Add one tick of axis `a`: current `before` it, `mean` over it and, in the state, after it [A]; speed at its start, axis units a second."""
    sums = counted.sums[a]
    after = state.current[a]
    # between the ticks i(t) = final + away exp(-R t / L)
    square = mean * mean
    if drives.current_loop[a]:
        away = (before - after) / (1.0 - drives.decay[a])
        final = before - away
        mean_decay = drives.mean_decay[a]
        square = final * final + 2.0 * final * away * mean_decay + away * away * mean_decay * (0.5 + 0.5 * drives.decay[a])
        sums[D_ELECTRICAL] += state.voltage[a] * mean * h
    sums[D_CYCLE_SUM] += mean
    sums[D_CYCLE_SQUARE] += square
    sums[D_LARGEST] = max(sums[D_LARGEST], abs(before))
    speed = abs(motor_speed)
    sums[D_LARGEST_SPEED] = max(sums[D_LARGEST_SPEED], speed)
    if mean * motor_speed >= 0.0:
        at = min(int(speed * counted.classes_per_speed[a]), counted.torque.shape[1] - 1)
        counted.torque[a, at] = max(counted.torque[a, at], abs(drives.torque_constant[a] * mean))
    if cycle_ends:
        smooth = sums[D_CYCLE_SUM] / position_ticks
        sums[D_CYCLES] += 1.0
        sums[D_SQUARE] += sums[D_CYCLE_SQUARE] / position_ticks
        sums[D_SMOOTH_SQUARE] += smooth * smooth
        sums[D_SMOOTH_LARGEST] = max(sums[D_SMOOTH_LARGEST], abs(smooth))
        sums[D_CYCLE_SUM] = 0.0
        sums[D_CYCLE_SQUARE] = 0.0


@compiled(inline=True)
def count_work(a, counted, torque, before, after, h):  # type: ignore[no-untyped-def]
    """Add the work of axis `a` in one step: its motor's torque [Nm], speed of the rotor before and after [rad/s]."""
    work = 0.5 * torque * (before + after) * h
    counted.sums[a, D_WORK] += work
    if work < 0.0:
        counted.sums[a, D_BRAKING] -= work


@dataclass(frozen=True)
class DriveLoad:
    """What a run took from the drive of one axis.

    `effort_` numbers are of what its speed controller commands (`Axis.effort`: A, V or Nm): over all ticks, of the smooth part
    (means over position cycles), and of the ripple around it. Energies [J]: what the motor gave to the mechanics in all (`work`), what
    of it came back while braking, and what its winding took. `torque` (class,) is the largest driving torque [Nm at the motor] in
    classes of speed whose upper ends are `speed` (class,) [rad/s at the motor].
    """

    effort_max: float
    effort_rms: float
    smooth_max: float
    smooth_rms: float
    ripple_rms: float
    work: float
    braking: float
    electrical: float
    speed_max: float
    speed: np.ndarray
    torque: np.ndarray


def drive_load(axis: Axis, counted: DriveSums, a: int) -> DriveLoad:
    """The load of axis number `a` from the sums of a finished run."""
    sums = counted.sums[a]
    cycles = max(sums[D_CYCLES], 1.0)
    square, smooth = float(sums[D_SQUARE] / cycles), float(sums[D_SMOOTH_SQUARE] / cycles)
    return DriveLoad(
        effort_max=float(sums[D_LARGEST]),
        effort_rms=math.sqrt(square),
        smooth_max=float(sums[D_SMOOTH_LARGEST]),
        smooth_rms=math.sqrt(smooth),
        ripple_rms=math.sqrt(max(square - smooth, 0.0)),
        work=float(sums[D_WORK]),
        braking=float(sums[D_BRAKING]),
        electrical=float(sums[D_ELECTRICAL]),
        speed_max=float(sums[D_LARGEST_SPEED]),
        speed=np.arange(1, SPEED_CLASSES + 1) / (counted.classes_per_speed[a] * axis.ratio),
        torque=counted.torque[a].copy(),
    )
