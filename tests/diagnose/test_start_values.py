"""Starting values of a fit, and the settings that scaled responses represent."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of
from tests.diagnose.law.test_closed_loop import X, observed, runs_of
from twin.diagnose.screen import screening
from twin.diagnose.start_values import StartValues
from twin.diagnose.starts import Start, combine, starts_of
from twin.effects import EFFECTS, Setting
from twin.machine.machine import load_machine


def delay_of(time_constant_s, cycle):
    """Steady-state delay of a sampled first-order lag behind a ramp of slope 1."""
    lagged = ramp = 0.0
    for _ in range(4000):
        ramp += cycle
        lagged += (ramp - lagged) * -math.expm1(-cycle / time_constant_s)
    return ramp - lagged


@pytest.mark.parametrize("share", [1e-4, 0.01, 0.5, 3.0])
@pytest.mark.parametrize(("effect", "cycle"), [("set_point_filter", "position_cycle"), ("current_filter", "current_cycle")])
def test_a_scaled_lag_has_the_scaled_delay(effect, cycle, share):
    machine = load_machine()
    first = Setting(EFFECTS[effect], "X", {"time_constant_s": 2e-3})
    scaled = combine(Start((first,)), [share], machine)
    wanted = share * delay_of(2e-3, getattr(machine, cycle))
    assert delay_of(scaled.parameters["time_constant_s"], getattr(machine, cycle)) == pytest.approx(wanted, rel=1e-6)


def test_a_filter_much_shorter_than_the_cycle_is_screened():
    """A lag of a fifth of the cycle delays the set point by 14 us, a hundredth of what the start of the screening delays it."""
    group = observed(runs_of([{"name": "set_point_filter", "axis": "X", "time_constant_s": 4e-4}]))
    starts = [s for s in starts_of(group, group.residual) if s.effect.name == "set_point_filter"]
    screened = screening(found_of(group), starts)
    ((i, gain),) = screened.best().values()
    assert screened.setting(i, gain, X).parameters["time_constant_s"] == pytest.approx(4e-4, rel=0.02)


def test_other_sizes_are_scaled_by_their_deviation_from_neutral():
    first = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.5})
    assert combine(Start((first,)), [0.2], load_machine()).parameters["factor"] == pytest.approx(1.1)


def record_of(position, current):
    """A group of one axis and run with given position (sample,) [m] and current residual (sample,) [A], 1 ms apart."""
    time = 1e-3 * np.arange(len(position))
    view = SimpleNamespace(
        machine=load_machine(),
        motion=SimpleNamespace(position=position[:, None], speed=np.gradient(position, 1e-3)[:, None]),
        trace=SimpleNamespace(time=time),
        rows_of=lambda axis, channel: np.ones(len(time), bool),
    )
    channel = SimpleNamespace(axis="X", run=0, name="current", rows=slice(0, len(current)))
    return SimpleNamespace(channels=[channel], views=[view], weights=np.ones(len(current)), machine=view.machine)


@pytest.mark.parametrize("wavelength", [0.02, 0.11, 0.22, 0.29, 0.33])
def test_the_wavelength_of_friction_is_read_from_the_current(wavelength):
    """Both directions have their own mean besides the wave, as other friction causes."""
    there = np.linspace(-0.17, 0.15, 4000)
    position = np.concatenate([there, there[::-1]])
    direction = np.repeat([1.0, -1.0], len(there))
    wave = direction * np.sin(2.0 * np.pi * position / wavelength)
    current = 0.05 * wave + 0.4 * direction + 0.2 + np.random.default_rng(0).normal(0.0, 0.05, len(position))
    machine = load_machine()
    read = StartValues(record_of(position, current), machine.axis("X"), current)
    assert read.of(EFFECTS["position_dependent_friction"].parameter("wavelength"))[0] == pytest.approx(wavelength, rel=0.05)


@pytest.mark.parametrize("reach", [0.0, 1e-9, 40.0])
def test_wavelengths_are_read_from_motions_of_any_length(reach):
    """No motion, almost none, and 40 m: a fast result without excessive memory."""
    position = reach * np.sin(np.linspace(0.0, 6.0, 5000))
    machine = load_machine()
    read = StartValues(record_of(position, np.sin(30.0 * position)), machine.axis("X"), np.sin(30.0 * position))
    found = read.of(EFFECTS["position_dependent_friction"].parameter("wavelength"))
    assert found
    assert all(value > 0.0 for value in found)


@pytest.mark.parametrize("order", [1.0, 2.0, 6.0])
def test_a_wave_that_repeats_once_a_turn_is_among_the_starts_beside_spikes_at_the_reversals(order):
    """Stronger spikes at places of their own have a broad spectrum without a line at a whole number."""
    machine = load_machine()
    turn = 2.0 * np.pi * machine.axis("X").ratio
    position = 0.05 * np.sin(np.linspace(0.0, 8.0 * np.pi, 40_000)) * np.linspace(0.4, 1.0, 40_000)
    spikes = sum(np.exp(-(((position - place) / (0.05 * turn)) ** 2)) for place in (-0.049, -0.0311, 0.0177, 0.0412))
    current = 0.1 * np.sin(2.0 * np.pi * order * position / turn) + 2.0 * spikes
    read = StartValues(record_of(position, current), machine.axis("X"), current)
    found = read.of(EFFECTS["torque_ripple"].parameter("periods_per_rev"))
    assert any(value == pytest.approx(order, rel=0.02) for value in found)
