"""A change that is too large for its slope gets its size by simulation."""

import numpy as np
import pytest

from devtools.histories import machine_tables, program
from twin.exam.plant.parameters import AXES
from twin.history.columns import changed, directions_of
from twin.history.projection import Reference
from twin.history.series import Series, filters, scatter_of
from twin.history.watch import sizes_on
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


@pytest.mark.parametrize(("effect", "theta"), [("torque_constant", -1.2), ("speed_gain", -1.0), ("coulomb_friction", 0.5)])
def test_the_size_is_the_one_that_was_put_in(mikron: Machine, effect: str, theta: float) -> None:
    machine = mikron.with_axes(["X"]).with_feedforward("velocity+torque")
    points = program(machine_tables(), 2.0).set_points[:, [AXES.index("X")]]
    direction = next(d for d in directions_of(machine, ("X",)) if d.cause[0] == effect)
    trace = simulate(changed(machine, [(direction, theta)]), Setpoints(points, 1e-3)).trace
    run = MeasuredRun("production", trace, "velocity+torque", 0.0)
    [(_, own)] = Reference(machine, map, lambda: [run]).linearised([run], ("X",))
    directions = directions_of(machine, ("X",))
    k = [d.name for d in directions].index(direction.name)
    series = Series(("X",), directions, np.array([0]), np.zeros((1, len(directions))), own.gram, scatter_of(directions))
    w = filters(own.gram, series.scatter)[:, k]
    slope = float(w @ own.right(trace) / (w @ own.gram[:, k]))
    found = sizes_on(lambda _: [own])(direction, series, slope)
    assert found == pytest.approx(theta, rel=0.04)
    assert (abs(slope / theta - 1.0) > 0.1) is (effect != "coulomb_friction")  # friction is linear, the others are not
