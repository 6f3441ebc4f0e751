"""Re-tuning linearised on a machine with an effect: it changes the re-tuned axis only."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import swings
from twin.diagnose.columns import Columns
from twin.diagnose.fit import Fit, free_parameters, simulated_response
from twin.diagnose.observe import observe
from twin.diagnose.search import tuning_beside
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState
from twin.diagnose.tuning import linearised, tuning_of
from twin.diagnose.view import view_of
from twin.effects import parse_setting
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate


@pytest.fixture(scope="module")
def table(mikron: Machine):
    """Both rotary axes on a nominal machine, and the fit of an unbalance that changes both."""
    trace = simulate(mikron, swings(mikron, 1.5), noise_seed=1).trace
    group = observe([view_of(mikron, MeasuredRun("swings", trace, None, 0.0))], ("A", "C"))
    tuning = tuning_of(group)
    settings = (parse_setting("table_unbalance:A:mass_kg=50,radius_m=0.2,angle_rad=1.0,height_m=0.15", mikron),)
    response = simulated_response(group, settings)
    free = free_parameters(settings, mikron)
    columns = Columns([np.zeros(group.size)] * len(free), group.size)
    return group, Fit(settings, free, 0.0, tuning.solve(group.residual), response, columns, tuning)


def rows(group, axis):
    return np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in group.channels if c.axis == axis])


def test_an_unbalance_on_the_tilting_axis_changes_the_table_axis(table):
    group, fit = table
    assert np.abs(fit.response[rows(group, "C")]).max() > 10.0


def test_relinearising_leaves_the_tuning_as_it_was(table, mikron: Machine):
    group, fit = table
    before = fit.about.jacobian.part(slice(0, group.size))
    beside = linearised(fit.about, group, fit.settings, fit.response)
    np.testing.assert_array_equal(fit.about.jacobian.part(slice(0, group.size)), before)
    assert np.abs(beside.jacobian.part(slice(0, group.size)) - before).max() > 0.1
    with pytest.raises(ValueError, match="read-only"):
        fit.about.jacobian.each[0].values[0] = 1.0


@pytest.mark.parametrize("quantity", ["torque_constant", "coulomb_friction"])
def test_a_motor_parameter_changes_its_own_axis_only(table, mikron: Machine, quantity: str):
    """Regression: the column of one axis contained minus the effect on the other, so that re-tuning could cancel the effect."""
    group, fit = table
    beside = linearised(fit.about, group, fit.settings, fit.response)
    (i,) = (i for i, n in enumerate(beside.nuisances) if (n.owner, n.quantity) == ("A", quantity))
    own, other = (np.abs(beside.jacobian.whole(i)[rows(group, axis)]).max() for axis in "AC")
    assert own > 0.1
    assert other == 0.0


@pytest.mark.parametrize("share", [0.0, 3.0])
def test_columns_are_simulated_again_where_the_machine_answers_otherwise(table, share: float):
    """Columns that did not know the unbalance are right without deviations, and wrong with large ones."""
    group, fit = table
    theta = share * np.cos(np.arange(len(fit.coefficients)))
    tuning = tuning_beside(GroupState(group, group, fit.about, replace(fit, coefficients=theta), 1.0))
    like = linearised(fit.about, group, fit.settings, fit.response) if share else fit.about
    np.testing.assert_array_equal(tuning.jacobian.part(), like.jacobian.part())


def test_columns_that_were_simulated_with_these_effects_are_not_simulated_again(table):
    """A response that bends is missed by right columns, too."""
    group, fit = table
    theta = 30.0 * np.cos(np.arange(len(fit.coefficients)))
    state = GroupState(group, group, fit.about, replace(fit, coefficients=theta), 1.0)
    tuning = tuning_beside(state)
    assert tuning.bend > T.price
    again = tuning_beside(replace(state, tuning=tuning, fit=replace(state.fit, about=tuning)))
    assert all(a is b for a, b in zip(again.jacobian.each, tuning.jacobian.each, strict=True))
