"""Load of the drives in a run, accumulated at every tick inside the compiled loop.

The position controller steps the current every 2 ms. A record at 1 kHz has two samples per step, so its peak and RMS are too low by an
amount that depends on the design. On request the loop accumulates at every tick:

    mean square     of the current over the tick, exact for the exponential between two ticks
    smooth part     mean over each position cycle, required by the motion; the rest within the cycle is ripple
    work            motor torque times speed, T (w_before + w_after) / 2 h, exact for the kinetic energy at constant torque
    electrical      u times the mean current over the tick
    largest torque  while driving, by speed class: the duty cycle against the torque curve of the motor. Braking is omitted, because the
                    back-EMF then helps

All quantities use the true current without measuring noise. The sums of an axis form one row; D_... index its columns.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.machine.axis import Axis

(
    D_CYCLE_SUM,  # A, sum of the mean currents in the current position cycle
    D_CYCLE_SQUARE,  # A2, sum of the mean squares in the current position cycle
    D_CYCLES,  # number of complete position cycles
    D_SQUARE,  # A2, sum over complete cycles of the mean square
    D_SMOOTH_SQUARE,  # A2, sum over complete cycles of the squared mean
    D_LARGEST,  # A
    D_SMOOTH_LARGEST,  # A
    D_WORK,  # J
    D_BRAKING,  # J, the negative part of the work
    D_ELECTRICAL,  # J
    D_LARGEST_SPEED,  # axis units/s
) = range(11)
SUMS = 11

SPEED_CLASSES = 50
"""Number of speed classes, up to FASTEST times the speed limit of the axis. The last class includes all higher speeds."""
FASTEST = 1.25


class DriveSums(NamedTuple):
    """Accumulators of the loop. They have no axes if the load is not counted."""

    sums: np.ndarray  # (axis, D_...)
    torque: np.ndarray  # (axis, class) largest driving torque, Nm at the motor
    classes_per_speed: np.ndarray  # (axis,) classes per axis unit/s


NO_SUMS = DriveSums(np.zeros((0, SUMS)), np.zeros((0, SPEED_CLASSES)), np.zeros(0))


def empty_sums(axes: tuple[Axis, ...]) -> DriveSums:
    """Accumulators at the start of a run."""
    classes = np.array([SPEED_CLASSES / (FASTEST * axis.max_velocity) for axis in axes])
    return DriveSums(np.zeros((len(axes), SUMS)), np.zeros((len(axes), SPEED_CLASSES)), classes)


@compiled(inline=True)
def count_tick(a, load_sums, drives, state, before, mean, motor_speed, cycle_ends, position_ticks, h):  # type: ignore[no-untyped-def]
    """Add one tick of axis `a`: current [A] `before` the tick, `mean` over it, and after it in `state`; initial speed [axis units/s]."""
    sums = load_sums.sums[a]
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
        at = min(int(speed * load_sums.classes_per_speed[a]), load_sums.torque.shape[1] - 1)
        load_sums.torque[a, at] = max(load_sums.torque[a, at], abs(drives.torque_constant[a] * mean))
    if cycle_ends:
        smooth = sums[D_CYCLE_SUM] / position_ticks
        sums[D_CYCLES] += 1.0
        sums[D_SQUARE] += sums[D_CYCLE_SQUARE] / position_ticks
        sums[D_SMOOTH_SQUARE] += smooth * smooth
        sums[D_SMOOTH_LARGEST] = max(sums[D_SMOOTH_LARGEST], abs(smooth))
        sums[D_CYCLE_SUM] = 0.0
        sums[D_CYCLE_SQUARE] = 0.0


@compiled(inline=True)
def count_work(a, load_sums, torque, before, after, h):  # type: ignore[no-untyped-def]
    """Add the work of axis `a` in one step: motor torque [Nm], rotor speed before and after the step [rad/s]."""
    work = 0.5 * torque * (before + after) * h
    load_sums.sums[a, D_WORK] += work
    if work < 0.0:
        load_sums.sums[a, D_BRAKING] -= work


@dataclass(frozen=True)
class DriveLoad:
    """Load of the drive of one axis in a run.

    `effort_` values are those of the output of the speed controller (`Axis.effort`: A, V or Nm) over all ticks; `smooth_` values those of
    its means over position cycles; `ripple_rms` that of the rest. Energies [J]: `work` is the net work of the motor on the mechanics,
    `braking` the part returned while braking, `electrical` the energy into the winding. `torque` (class,) is the largest driving torque
    [Nm at the motor] in speed classes with upper ends `speed` (class,) [rad/s at the motor].
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


def drive_load(axis: Axis, load_sums: DriveSums, a: int) -> DriveLoad:
    """Load of axis number `a` from the accumulators of a finished run."""
    sums = load_sums.sums[a]
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
        speed=np.arange(1, SPEED_CLASSES + 1) / (load_sums.classes_per_speed[a] * axis.ratio),
        torque=load_sums.torque[a].copy(),
    )
