"""Relations that may be laws: an output of a block over one variable, for example friction over speed or force over position."""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from twin.diagnose.law.residual import CURRENT_LOOP, MECHANICS, SPRING, Samples
from twin.machine.machine import Axis

LENGTHS = tuple(np.geomspace(2e-5, 6e-2, 12))
"""Memory lengths of the direction of motion [m]; for a rotary axis at the same motor angle as a 10 mm lead."""

PLAYS = tuple(np.geomspace(1e-6, 5e-5, 9))
"""Half widths of a play [m]; scaled for a rotary axis."""

LENGTH_PER_RAD = 0.2
"""Metres per radian of a rotary axis for the lengths above."""


def metre_of(axis: Axis) -> float:
    """A metre of the lengths above along an axis [m or rad]."""
    return 1.0 if axis.kind == "linear" else 1.0 / LENGTH_PER_RAD


@dataclass(frozen=True)
class Relation:
    """A relation that may be a law: output of a block over a variable of this axis or of the axis `source`; `length` [m, rad] of a variable with memory."""

    block: str
    output: str
    variable: str
    source: str = ""
    length: float = 0.0
    period: float = 0.0  # of a sine over the variable, in its unit

    @property
    def wraps(self) -> float:
        """Period of the variable, in its unit; 0 if it has none."""
        return self.period or (2.0 * math.pi if self.variable == "turn" else 0.0)


OVER = {
    MECHANICS: (
        # a friction is odd in the speed, a force even
        *((MECHANICS, "force", variable) for variable in ("position", "turn", "speed", "time")),
        *((MECHANICS, "friction", variable) for variable in ("speed", "position", "turn", "acceleration_size", "time")),
        ("current loop", "torque", "current"),
    ),
    "transmission": (
        *(("measurement", "displacement", variable) for variable in ("position", "turn", "time")),
        ("transmission", "displacement", "acceleration"),
    ),
    SPRING: (("transmission", "force", "windup"),),
    CURRENT_LOOP: ((CURRENT_LOOP, "voltage", "current"),),
    "position controller": tuple(
        ("position controller", "speed", variable) for variable in ("following_error", "speed_setpoint", "position", "velocity")
    ),
}
"""Block, output and variable of the relations without memory, by the block whose residual is measured."""


def relations_of(samples: Samples, axis: Axis) -> Iterator[Relation]:
    """All relations for the residual of a block whose variables were recorded."""
    metre = metre_of(axis)
    recorded = {*samples.motion, "speed", "acceleration_size"} - ({"turn"} if axis.drive == "direct" else set())
    yield from (Relation(*over) for over in OVER.get(samples.block, ()) if over[2] in recorded)
    if samples.block == MECHANICS:
        yield from (Relation(MECHANICS, "force", "direction", length=length * metre) for length in LENGTHS)
        for variable in ("position", "velocity", "acceleration"):
            yield from (Relation(MECHANICS, "force", variable, other) for other in samples.others)
    elif samples.block == "transmission":
        yield from (Relation("measurement", "displacement", "slack", length=length * metre) for length in PLAYS)
        yield from (Relation("measurement", "displacement", "position", other) for other in samples.others)


def variable_of(samples: Samples, relation: Relation) -> np.ndarray:
    """Values (sample,) of the variable of a relation."""
    motion = samples.others[relation.source] if relation.source else samples.motion
    if relation.variable == "speed":
        return np.abs(motion["velocity"])
    if relation.variable == "acceleration_size":
        return np.abs(motion["acceleration"])
    if relation.variable == "direction":
        return remembered_direction(samples, relation.length)
    if relation.variable == "slack":
        return position_in_play(samples, relation.length)
    if relation.block == "measurement" and relation.variable == "position" and not relation.source:
        return load_position(samples)
    return motion[relation.variable]


def load_position(samples: Samples) -> np.ndarray:
    """Position of the load (sample,) without the error between the encoders: that of the motor encoder, if both were recorded."""
    return samples.motion["motor_position" if samples.block == "transmission" else "position"]


def factor_of(samples: Samples, relation: Relation, axis: Axis) -> np.ndarray | float:
    """Factor from the output of a law to the residual: friction acts against the motion, torque through the ratio."""
    if relation.output == "friction":
        return -np.sign(samples.motion["velocity"])
    if relation.output == "torque":
        return 1.0 / axis.ratio
    return -1.0 if relation.block == "measurement" else 1.0


def zeroed_at_run_start(samples: Samples, columns: np.ndarray) -> np.ndarray:
    """Columns (sample, n) of a displacement, zero at the start of each run."""
    return columns - columns[samples.first]


def contribution_to_residual(samples: Samples, relation: Relation, axis: Axis, columns: np.ndarray) -> np.ndarray:
    """Contribution (sample, n) of values of a law to the residual."""
    if samples.through:
        begins = np.unique(samples.first)[1:]
        return np.concatenate([current(run) for current, run in zip(samples.through, np.split(columns, begins), strict=True)])
    acting = columns * (factor if np.isscalar(factor := factor_of(samples, relation, axis)) else np.asarray(factor)[:, None])
    return zeroed_at_run_start(samples, acting) if relation.output == "displacement" else acting


def remembered_direction(samples: Samples, length: float) -> np.ndarray:
    """Direction of motion (sample,) with exponential memory over `length` of travel, zero at the start of a run: dz/dx = (+-1 - z) / length."""
    z = np.zeros(len(samples))
    for i in np.flatnonzero(np.arange(len(samples)) != samples.first):
        moved = samples.motion["travel"][i] - samples.motion["travel"][i - 1]
        side = 1.0 if samples.motion["velocity"][i] > 0.0 else -1.0
        z[i] = side + (z[i - 1] - side) * math.exp(-moved / length)
    return z


def position_in_play(samples: Samples, length: float) -> np.ndarray:
    """Position of the load within a play of +-`length`, as a fraction of it (sample,); zero at the start of a run.

    The motor encoder shows the load's motion while the scale rests in the play. Signed displacements are summed, so that noise at rest does
    not accumulate.
    """
    z = np.zeros(len(samples))
    moved = np.diff(samples.motion["motor_position"], prepend=0.0) / length
    for i in np.flatnonzero(np.arange(len(samples)) != samples.first):
        z[i] = min(max(z[i - 1] + moved[i], -1.0), 1.0)
    return z
