"""An effect of your own: friction that grows with the force that the guides carry.

    twin effects load_friction --effects examples/own_effect/load_friction.py

This file is all there is of it. With `--effects` it is simulated, listed, drawn, and searched by `twin diagnose`.
"""

from twin.effects.change import Change
from twin.effects.effect import Parameter, effect
from twin.machine.machine import Axis
from twin.simulation.loop_terms import FORCE, X_FRICTION_LEVEL, X_LOAD_ACCELERATION, arrays, term


@effect(
    block="mechanics",
    parameters=(Parameter("coefficient", "number", 0.0, 0.9, usual=(0.1, 0.5), neutral=0.0, logarithmic=True),),
    separating_move="accelerations",
    rivals="Inertia pushes against the acceleration; this friction pushes against the motion, also while the axis slows down.",
)
def load_friction(change: Change, axis: Axis, coefficient: float) -> None:
    """Friction that grows with the load on the guides.

    Fc + coefficient M |a|: the carriage is driven beside its centre of mass, so that its acceleration presses on the guides.
    """
    change.add_term(level_under_load, FORCE, axis, [coefficient * change.load_inertia(axis)])


@term
def level_under_load(parameters, state, signals, axis):
    """F += p[0] |a|."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_FRICTION_LEVEL] += p[0] * abs(x[axis, X_LOAD_ACCELERATION])
