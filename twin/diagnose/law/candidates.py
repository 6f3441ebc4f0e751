"""What a law may be: an output of a block over a variable, a force over the position, a friction (it turns with the motion) over the speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twin.diagnose.law.residual import CURRENT_LOOP, MECHANICS, SPRING, Samples, remembered
from twin.machine.machine import Axis

LENGTHS = tuple(np.geomspace(2e-5, 6e-2, 12))
"""Lengths over which a direction of motion may be remembered [m]; of a rotary axis at the same motor angle of a 10 mm lead."""

PLAYS = tuple(np.geomspace(1e-6, 5e-5, 9))
"""Half widths of a play [m]; of a rotary axis in proportion."""

LENGTH_PER_RAD = 0.2
"""Metres that stand for a radian of a rotary axis in the lengths above."""


@dataclass(frozen=True)
class Candidate:
    """What a law may be: the output of a block over one variable, of another axis with `source`; `length` of a remembered variable [m, rad]."""

    block: str
    output: str
    variable: str
    source: str = ""
    length: float = 0.0
    period: float = 0.0  # of a wave over the variable, in its unit

    @property
    def is_friction(self) -> bool:
        return self.output == "friction"


def candidates_of(samples: Samples, axis: Axis) -> Iterator[Candidate]:
    """Everything that the residual of a block may depend on, as far as it was recorded."""
    metre = 1.0 if axis.kind == "linear" else 1.0 / LENGTH_PER_RAD
    turns = axis.kind == "rotary" or axis.ratio != 1.0
    if samples.block == MECHANICS:
        # what is odd in the speed is a friction, what is even a force
        for variable in ("position", *(("turn",) if turns else ()), "speed", "time"):
            yield Candidate(MECHANICS, "force", variable)
        for variable in ("speed", "position", *(("turn",) if turns else ()), "acceleration_size", "time"):
            yield Candidate(MECHANICS, "friction", variable)
        if "current" in samples.motion:
            yield Candidate("current loop", "torque", "current")
        for length in LENGTHS:
            yield Candidate(MECHANICS, "force", "direction", length=length * metre)
        for other in samples.others:
            for variable in ("position", "velocity", "acceleration"):
                yield Candidate(MECHANICS, "force", variable, other)
    elif samples.block == "transmission":
        for variable in ("position", *(("turn",) if turns else ()), "time"):
            yield Candidate("measurement", "displacement", variable)
        yield Candidate("transmission", "displacement", "acceleration")
        for length in PLAYS:
            yield Candidate("measurement", "displacement", "slack", length=length * metre)
        for other in samples.others:
            yield Candidate("measurement", "displacement", "position", other)
    elif samples.block == SPRING:
        yield Candidate("transmission", "force", "windup")
    elif samples.block == CURRENT_LOOP:
        yield Candidate(CURRENT_LOOP, "voltage", "current")
    elif samples.block == "position controller":
        for variable in ("following_error", "speed_setpoint", "position", "velocity"):
            if variable in samples.motion:
                yield Candidate("position controller", "speed", variable)


def variable_of(samples: Samples, candidate: Candidate) -> np.ndarray:
    """Values (sample,) of the variable of a candidate."""
    motion = samples.others[candidate.source] if candidate.source else samples.motion
    if candidate.variable == "speed":
        return np.abs(motion["velocity"])
    if candidate.variable == "acceleration_size":
        return np.abs(motion["acceleration"])
    if candidate.variable in ("direction", "slack"):
        return remembered(motion["velocity"], motion["travel"], samples.first, candidate.length, candidate.variable == "slack")
    return motion[candidate.variable]


def factor_of(samples: Samples, candidate: Candidate, axis: Axis) -> np.ndarray | float:
    """What a value of the law is multiplied by in the residual: a friction acts against the motion, a torque through the ratio."""
    if candidate.is_friction:
        return -np.sign(samples.motion["velocity"])
    if candidate.output == "torque":
        return 1.0 / axis.ratio
    return -1.0 if candidate.block == "measurement" else 1.0


def from_start(samples: Samples, columns: np.ndarray) -> np.ndarray:
    """Columns (sample, n) of a displacement, which is zero where its run begins."""
    return columns - columns[samples.first]


def in_residual(samples: Samples, candidate: Candidate, axis: Axis, columns: np.ndarray) -> np.ndarray:
    """What values of a law (sample, n) make of the residual."""
    if samples.through is not None:
        return samples.through.current(columns, samples.first)
    acting = columns * (factor if np.isscalar(factor := factor_of(samples, candidate, axis)) else np.asarray(factor)[:, None])
    return from_start(samples, acting) if candidate.output == "displacement" else acting
