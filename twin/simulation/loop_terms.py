"""Terms: small compiled laws that a machine may have beyond the nominal ones, called by the loop at eight places.

A term is a C function `void law(parameters*, state*, signals*, axis)` made by `@term` from a function whose first line
is `p, s, x = arrays(parameters, state, signals)`. It reads and changes the row `x[axis]` of the signals (and may read
the rows of other axes). The loop keeps one table of active terms and knows none of them: no term, no cost.

    MEASURE   every tick            what the encoders see: SCALE, MOTOR_POSITION, MOTOR_SPEED
    SETPOINT  every position cycle  the delayed set point
    SPEED     every position cycle  the speed set point that the position controller made
    DRIVE     every speed cycle     the speed set point as the speed controller gets it
    CURRENT   every current cycle   the current set point
    VOLTAGE   every current cycle   the voltage that the current controller gives
    FORCE     every tick            LOAD_FORCE, ROTOR_FORCE, MOTOR_TORQUE, FRICTION_LEVEL
    RECORD    every tick            the current as it is recorded
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from numba import carray, types
import numpy as np

from twin.compiled_functions import compiled, compiled_callback

MEASURE, SETPOINT, SPEED, DRIVE, CURRENT, VOLTAGE, FORCE, RECORD = range(8)
STAGES = 8

# columns of the signals, one row an axis; positions in m or rad, forces at the axis in N or Nm
(
    X_TIME,  # time of the tick, s
    X_STEP,  # base tick, s
    X_LOAD_POSITION,  # at the tick
    X_LOAD_SPEED,
    X_LOAD_ACCELERATION,  # mean over the last tick
    X_LOAD_MIDDLE,  # position in the middle of the coming step, which springs are evaluated at
    X_ROTOR_POSITION,  # motor side in axis units; the load's where both are rigidly coupled
    X_ROTOR_SPEED,
    X_ROTOR_MIDDLE,
    X_SCALE,  # what the direct measuring system shows
    X_MOTOR_POSITION,  # what the motor encoder shows, axis units
    X_MOTOR_SPEED,  # axis units a second
    X_SETPOINT,  # delayed set point
    X_CURRENT_SETPOINT,
    X_LOAD_FORCE,  # force on the load
    X_ROTOR_FORCE,  # force on the rotor, at the axis
    X_MOTOR_TORQUE,  # torque added to the motor's, Nm
    X_FRICTION_LEVEL,  # Coulomb level of the load's contact, N or Nm
    X_FRICTION_FORCE,  # friction on the load beside Coulomb's and the viscous one of the model
    X_CURRENT,  # current of the motor, A, or the command of an axis without current loop
    X_SPEED_SETPOINT,  # axis units a second
    X_FOLLOWING_ERROR,  # delayed set point minus what the position loop is closed on
    X_TRANSMISSION_ERROR,  # how far the transmission carries the load ahead of a rotor on a joint of its own; the coupling takes it
    X_TRANSMISSION_ERROR_SPEED,
    X_RECORDED_CURRENT,  # current as it is recorded, A
    X_VOLTAGE,  # voltage at the winding, V
) = range(26)
SIGNAL_COUNT = 26
PARAMETER_COUNT = 88
STATE_COUNT = 70
"""Numbers of a term's state; a dead time remembers its last cycles there."""
MAX_AXES = 32

_Pointer = types.CPointer(types.float64)
_term_signature = types.void(_Pointer, _Pointer, _Pointer, types.int64)


@compiled(inline=True)
def arrays(parameters, state, signals):  # type: ignore[no-untyped-def]
    """The three arrays behind a term's pointers: parameters, state, signals (axis, signal)."""
    return carray(parameters, PARAMETER_COUNT), carray(state, STATE_COUNT), carray(signals, (MAX_AXES, SIGNAL_COUNT))


def term(law: Callable[..., None]) -> Any:
    """Compile a law to a C function whose address the loop can call; compiled on first use and cached on disk."""
    return _LazyTerm(law)


class _LazyTerm:
    """A law that is compiled when its address is first asked for."""

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
    """One active term: which law, where, on which axis (index), with which parameters and initial state.

    `order` sorts the terms of a stage: a friction level (0) is shaped before it is used up by a bristle (1).
    """

    law: _LazyTerm
    stage: int
    axis: int
    parameters: Sequence[float]
    state: Sequence[float] = ()
    order: int = 0


class TermTable(NamedTuple):
    """Active terms as the loop reads them; `start` (STAGES + 1,) bounds the terms of each stage."""

    start: np.ndarray
    address: np.ndarray
    axis: np.ndarray
    parameters: np.ndarray
    state: np.ndarray


def term_table(terms: Sequence[Term]) -> TermTable:
    """Sort terms by stage and order into the arrays of the loop."""
    ordered = sorted(terms, key=lambda t: (t.stage, t.order))
    table = TermTable(
        start=np.searchsorted([t.stage for t in ordered], np.arange(STAGES + 1)).astype(np.int64),
        address=np.array([t.law.address for t in ordered], np.int64),
        axis=np.array([t.axis for t in ordered], np.int64),
        parameters=np.zeros((len(ordered), PARAMETER_COUNT)),
        state=np.zeros((len(ordered), STATE_COUNT)),
    )
    for i, t in enumerate(ordered):
        table.parameters[i, : len(t.parameters)] = t.parameters
        table.state[i, : len(t.state)] = t.state
    return table
