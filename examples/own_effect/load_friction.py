"""An effect of your own: friction that grows with the load on the guides.

    twin effects load_friction --effects examples/own_effect/load_friction.py

With `--effects` and this file alone, the effect is simulated, listed, drawn and searched by `twin diagnose`.
"""

from twin.effects.change import Change
from twin.effects.effect import Parameter, effect
from twin.machine.machine import Axis
from twin.simulation.loop_terms import FORCE, X_FRICTION_LEVEL, X_LOAD_ACCELERATION, arrays, term


@effect(
    block="mechanics",
    parameters=(Parameter("coefficient", "number", 0.0, 0.9, usual=(0.1, 0.5), neutral=0.0, logarithmic=True),),
    separating_move="accelerations",
    rivals="An inertia force opposes the acceleration; this friction opposes the motion, also while the axis decelerates.",
)
def load_friction(change: Change, axis: Axis, coefficient: float) -> None:
    """Friction that grows with the load on the guides.

    F = Fc + coefficient M |a|. The drive force does not act at the centre of mass, so the acceleration of the carriage loads the guides.
    """
    change.add_term(load_dependent_level, FORCE, axis, [coefficient * change.load_inertia(axis)])


@term
def load_dependent_level(parameters, state, signals, axis):
    """F += p[0] |a|."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_FRICTION_LEVEL] += p[0] * abs(x[axis, X_LOAD_ACCELERATION])
