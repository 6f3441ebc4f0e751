"""Terms: compiled laws beyond the nominal machine, called by the loop at eight stages.

A term is a C function `void law(parameters*, state*, signals*, axis)`. `@term` makes it from a function whose first line is
`p, s, x = arrays(parameters, state, signals)`. It reads and changes the row `x[axis]` of the signals and may read the rows of other axes.
The loop calls the terms of a table by address and depends on none of them. A stage without terms is skipped.

    MEASURE   every tick            encoder readings: SCALE, MOTOR_POSITION, MOTOR_SPEED
    SETPOINT  every position cycle  the delayed set point
    SPEED     every position cycle  the speed set point, output of the position controller
    DRIVE     every speed cycle     the speed set point, input of the speed controller
    CURRENT   every current cycle   the current set point
    VOLTAGE   every current cycle   the voltage, output of the current controller
    FORCE     every tick            LOAD_FORCE, ROTOR_FORCE, MOTOR_TORQUE, FRICTION_LEVEL
    RECORD    every tick            the recorded current
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import itertools
from typing import Any, NamedTuple

from numba import carray, types
import numpy as np

from twin.compiled_functions import compiled, compiled_callback

MEASURE, SETPOINT, SPEED, DRIVE, CURRENT, VOLTAGE, FORCE, RECORD = range(8)
STAGES = 8

# columns of the signals, one row per axis; positions in m or rad, forces at the axis in N or Nm
(
    X_TIME,  # time of the tick, s
    X_STEP,  # base tick, s
    X_LOAD_POSITION,  # at the tick
    X_LOAD_SPEED,
    X_LOAD_ACCELERATION,  # mean over the last tick
    X_LOAD_MIDDLE,  # position at the middle of the next step, for springs
    X_ROTOR_POSITION,  # motor side in axis units; equal to the load's if both are rigidly coupled
    X_ROTOR_SPEED,
    X_ROTOR_MIDDLE,
    X_SCALE,  # reading of the direct measuring system
    X_MOTOR_POSITION,  # reading of the motor encoder, axis units
    X_MOTOR_SPEED,  # axis units/s
    X_SETPOINT,  # delayed set point
    X_CURRENT_SETPOINT,
    X_LOAD_FORCE,  # force on the load
    X_ROTOR_FORCE,  # force on the rotor, at the axis
    X_MOTOR_TORQUE,  # torque added to the motor torque, Nm
    X_FRICTION_LEVEL,  # Coulomb friction of both sides of the drive train, N or Nm
    X_FRICTION_FORCE,  # friction beyond the model's Coulomb and viscous friction
    X_CURRENT,  # motor current, A, or the command of an axis without current loop
    X_SPEED_SETPOINT,  # axis units/s
    X_FOLLOWING_ERROR,  # delayed set point minus the measured position of the position loop
    X_TRANSMISSION_ERROR,  # lead of the load over the rotor by transmission error, for an elastic coupling
    X_TRANSMISSION_ERROR_SPEED,
    X_RECORDED_CURRENT,  # A
    X_VOLTAGE,  # voltage at the winding, V
    X_RECORDED_SPEED_SETPOINT,  # axis units/s
    X_NOISE,  # noise of the position, m or rad, with digits for random effects; 0 for an ideal sensor
    X_FED_STEP,  # step over a position cycle of the set point that the feedforward differentiates
    X_OTHER_SIDE_LEVEL,  # part of the Coulomb friction on the side of a drive train on which no effect acts
) = range(30)
SIGNAL_COUNT = 30
PARAMETER_COUNT = 88
STATE_COUNT = 70
"""Size of a term's state; a dead time stores its last cycles there."""
MAX_AXES = 32

_Pointer = types.CPointer(types.float64)
_term_signature = types.void(_Pointer, _Pointer, _Pointer, types.int64)


@compiled(inline=True)
def arrays(parameters, state, signals):  # type: ignore[no-untyped-def]
    """Arrays behind a term's pointers: parameters, state, signals (axis, signal)."""
    return carray(parameters, PARAMETER_COUNT), carray(state, STATE_COUNT), carray(signals, (MAX_AXES, SIGNAL_COUNT))


def term(law: Callable[..., None]) -> Any:
    """Compile a law to a C function that the loop calls by address; compiled on first use and cached on disk."""
    return _LazyTerm(law)


class _LazyTerm:
    """A law that is compiled on the first access to its address."""

    def __init__(self, law: Callable[..., None]) -> None:
        self.law = law
        self._compiled: Any = None
        self.__doc__ = law.__doc__
        self.__name__ = law.__name__

    @property
    def address(self) -> int:
        if self._compiled is None:
            self._compiled = compiled_callback(_term_signature, self.law)
        return int(self._compiled.address)


@dataclass(frozen=True)
class Term:
    """One active term: law, stage, axis index and parameters; its state begins with zeros.

    `order` sorts the terms of a stage: terms that change the friction level (0) precede the bristle that uses it (1). `first` is the row of
    the signals at which the axes of its machine begin, not 0 if several machines share a loop.
    """

    law: _LazyTerm
    stage: int
    axis: int
    parameters: Sequence[float]
    order: int = 0
    first: int = 0


OF_ALL_AXES = (MEASURE, FORCE)
"""Stages whose terms are called for all axes at once. The other stages are called axis by axis."""


class TermTable(NamedTuple):
    """Active terms as arrays of the loop.

    `start` (STAGES + 1,) bounds the terms of each stage. `of_axis` (STAGES, row + 1) bounds the terms of each row of the signals in the
    stages that are called axis by axis. `axis` counts from `first`, the first row of the term's machine.
    """

    start: np.ndarray
    of_axis: np.ndarray
    address: np.ndarray
    axis: np.ndarray
    first: np.ndarray
    parameters: np.ndarray
    state: np.ndarray


def term_table(terms: Sequence[Term], axes: int) -> TermTable:
    """Table of terms, sorted by stage and order; `axes` is the number of rows of the signals."""
    # machines in one loop mostly have the same terms: consecutive calls of one law overlap in the processor
    seen: Counter[tuple[int, int]] = Counter()
    keyed = []
    for t in terms:
        row = t.first + t.axis
        place = seen[t.first, t.stage]
        seen[t.first, t.stage] += 1
        keyed.append(((t.stage, 0 if t.stage in OF_ALL_AXES else row, t.order, place, row), t))
    ordered = [t for _, t in sorted(keyed, key=lambda item: item[0])]
    start, of_axis = _bounds(np.array([t.stage for t in ordered], int), np.array([t.first + t.axis for t in ordered], int), axes)
    table = TermTable(
        start=start,
        of_axis=of_axis,
        address=np.array([t.law.address for t in ordered], np.int64),
        axis=np.array([t.axis for t in ordered], np.int64),
        first=np.array([t.first for t in ordered], np.int64),
        parameters=np.zeros((len(ordered), PARAMETER_COUNT)),
        state=np.zeros((len(ordered), STATE_COUNT)),
    )
    for i, t in enumerate(ordered):
        table.parameters[i, : len(t.parameters)] = t.parameters
    return table


def of_first_rows(table: TermTable, axes: int) -> TermTable:
    """The table of the terms on the first rows of the signals; it goes on with their state."""
    rows = table.first + table.axis
    kept = rows < axes
    start, of_axis = _bounds(np.repeat(np.arange(STAGES), np.diff(table.start))[kept], rows[kept], axes)
    return TermTable(start, of_axis, *(values[kept] for values in table[2:]))


def _bounds(stages: np.ndarray, rows: np.ndarray, axes: int) -> tuple[np.ndarray, np.ndarray]:
    """`start` and `of_axis` of a table from the stage and the row of each of its terms."""
    start = np.searchsorted(stages, np.arange(STAGES + 1))
    of_axis = [a + np.searchsorted(rows[a:b], np.arange(axes + 1)) for a, b in itertools.pairwise(start.tolist())]
    return start.astype(np.int64), np.array(of_axis, np.int64)
