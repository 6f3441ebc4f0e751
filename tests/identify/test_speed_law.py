"""The speed controller from its own signals: exact where they are recorded at its cycle, None where the command answers at another time."""

import numpy as np
import pytest

from twin.control.command_run import CommandRun
from twin.identify.first_values import first_values
from twin.identify.speed_control import speed_law
from twin.machine.axis_lumps import SPEED_GAIN
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace

CYCLE, GAIN, TIME = 1e-3, 40.0, 0.02


def recorded(fed: float = 0.0, every: int = 1, late: int = 0) -> tuple[CommandRun, np.ndarray]:
    """A run and its speed set point of a mass with friction behind a P/PI control with a noisy speed; the record holds every `every`-th cycle, and the command `late` cycles after its own."""
    rng, t = np.random.default_rng(1), np.arange(6000) * CYCLE
    s = 0.05 * np.sin(4.0 * t) ** 3
    slope = np.gradient(s, CYCLE)
    position, asked, speed, u = np.zeros((4, len(t)))
    x = v = held = 0.0
    for k in range(len(t)):
        position[k], speed[k], asked[k] = x, v + 1e-3 * rng.standard_normal(), slope[k] + 30.0 * (s[k] - x)
        u[k] = GAIN * (asked[k] - speed[k]) + held + fed * (s[k] - 2.0 * s[k - 1] + s[k - 2]) / CYCLE**2 * (k > 1)
        held += GAIN * CYCLE / TIME * (asked[k] - speed[k])
        v += CYCLE * (u[k] - 0.3 * np.tanh(v / 1e-3)) / 0.2
        x += CYCLE * v
    return CommandRun(every * CYCLE, *(v[::every] for v in (s, position, speed, np.roll(np.round(u, 4), late)))), asked[::every]


@pytest.mark.parametrize("fed", [0.0, 0.2])
def test_gain_and_integral_time_follow_from_the_signals_of_the_controller(fed: float) -> None:
    found = speed_law([recorded(fed), recorded(fed)])
    assert found is not None
    assert found.speed_gain == pytest.approx(GAIN, rel=1e-3)
    assert found.speed_integral_time_s == pytest.approx(TIME, rel=1e-2)
    assert found.acceleration == pytest.approx(fed, rel=1e-2, abs=1e-9)
    assert found.half[SPEED_GAIN] == pytest.approx(GAIN * CYCLE / TIME, rel=0.1)  # an integrator may hold the error of its own cycle


@pytest.mark.parametrize(("every", "late"), [(4, 0), (1, 1)])
def test_a_command_of_another_time_shows_no_gain(every: int, late: int) -> None:
    assert speed_law([recorded(every=every, late=late)]) is None


def test_a_machine_from_such_a_recording_has_this_controller() -> None:
    run, asked = recorded()
    signals = {
        "setpoint": run.setpoint,
        "position": run.position,
        "velocity_setpoint": asked,
        "velocity": run.speed,
        "current": run.command,
    }
    trace = Trace(np.arange(800) * CYCLE, {("X", name): values[:800] for name, values in signals.items()}, {"X": "linear"})
    law = first_values([MeasuredRun("run", trace, "velocity", 0.0)], ["X"])[0].law
    assert law.direct
    assert (law.speed_gain, law["speed_integral_time_s"]) == pytest.approx((GAIN, TIME), rel=0.01)
