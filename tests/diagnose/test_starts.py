"""Starts of a fit: what a scaled answer stands for."""

import math

import pytest

from twin.diagnose.candidates import Start, combine
from twin.effects import EFFECTS, Setting
from twin.machine.machine import load_machine


def delay_of(time_constant_s, cycle):
    """What a sampled first-order lag is behind a ramp of slope 1, run until it is steady."""
    lagged = ramp = 0.0
    for _ in range(4000):
        ramp += cycle
        lagged += (ramp - lagged) * -math.expm1(-cycle / time_constant_s)
    return ramp - lagged


@pytest.mark.parametrize("share", [1e-4, 0.01, 0.5, 3.0])
@pytest.mark.parametrize(("effect", "cycle"), [("set_point_filter", "position_cycle"), ("current_filter", "current_cycle")])
def test_a_scaled_lag_delays_that_share(effect, cycle, share):
    machine = load_machine()
    first = Setting(EFFECTS[effect], "X", {"time_constant_s": 2e-3})
    scaled = combine(Start((first,)), [share], machine)
    wanted = share * delay_of(2e-3, getattr(machine, cycle))
    assert delay_of(scaled.parameters["time_constant_s"], getattr(machine, cycle)) == pytest.approx(wanted, rel=1e-6)


def test_other_sizes_are_scaled_by_their_deviation_from_neutral():
    first = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.5})
    assert combine(Start((first,)), [0.2], load_machine()).parameters["factor"] == pytest.approx(1.1)
