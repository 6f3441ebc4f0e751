"""The speed controller from its own signals: exact where they are recorded at its cycle, None where the command answers at another time."""

import numpy as np
import pytest

from twin.identify.first_values import first_values
from twin.identify.speed_law import SpeedLaw, speed_law
from twin.machine.axis_lumps import SPEED_GAIN
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace

CYCLE, GAIN, TIME = 1e-3, 40.0, 0.02
Run = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def recorded(fed: float = 0.0, every: int = 1, late: int = 0) -> Run:
    """A mass with friction behind a P/PI control with a noisy speed; the record holds every `every`-th cycle, and the command `late` cycles after its own."""
    rng, t = np.random.default_rng(1), np.arange(6000) * CYCLE
    s = 0.05 * np.sin(4.0 * t) ** 3
    slope = np.gradient(s, CYCLE)
    asked, speed, u = np.zeros((3, len(t)))
    x = v = held = 0.0
    for k in range(len(t)):
        speed[k], asked[k] = v + 1e-3 * rng.standard_normal(), slope[k] + 30.0 * (s[k] - x)
        u[k] = GAIN * (asked[k] - speed[k]) + held + fed * (s[k] - 2.0 * s[k - 1] + s[k - 2]) / CYCLE**2 * (k > 1)
        held += GAIN * CYCLE / TIME * (asked[k] - speed[k])
        v += CYCLE * (u[k] - 0.3 * np.tanh(v / 1e-3)) / 0.2
        x += CYCLE * v
    signals = (s, asked, speed, np.roll(np.round(u, 4), late))
    return (every * CYCLE, *(signal[::every] for signal in signals))


@pytest.mark.parametrize("fed", [0.0, 0.2])
def test_gain_and_integral_time_follow_from_the_signals_of_the_controller(fed: float) -> None:
    found = speed_law([recorded(fed), recorded(fed)])
    assert isinstance(found, SpeedLaw)
    assert found.gain == pytest.approx(GAIN, rel=1e-3)
    assert found.integral_time == pytest.approx(TIME, rel=1e-2)
    assert found.acceleration == pytest.approx(fed, rel=1e-2, abs=1e-9)
    assert found.half[SPEED_GAIN] == pytest.approx(GAIN * CYCLE / TIME, rel=0.1)  # an integrator may hold the error of its own cycle


@pytest.mark.parametrize(("every", "late"), [(4, 0), (1, 1)])
def test_a_command_of_another_time_shows_no_gain(every: int, late: int) -> None:
    assert speed_law([recorded(every=every, late=late)]) is None


def test_a_machine_from_such_a_recording_has_this_controller() -> None:
    s, asked, speed, u = (signal[:800] for signal in recorded()[1:])
    position = s - (asked - np.gradient(s, CYCLE)) / 30.0  # by the law of the position
    signals = {"setpoint": s, "position": position, "velocity_setpoint": asked, "velocity": speed, "current": u}
    trace = Trace(np.arange(len(s)) * CYCLE, {("X", name): values for name, values in signals.items()}, {"X": "linear"})
    law = first_values([MeasuredRun("run", trace, "velocity", 0.0)], ["X"])[0].law
    assert law.direct
    assert (law.speed_gain, law.integral_time) == pytest.approx((GAIN, TIME), rel=0.01)
