"""A recorded disturbance acts on the simulated axis, whichever unit it has; one that the drive cannot take is refused."""

from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import load_machine
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

LAB_AXIS = Path(__file__).resolve().parents[2] / "examples" / "lab_axis" / "axis.toml"


def followed(signal: str | None, size: float) -> np.ndarray:
    """Position of the laboratory axis at rest under a pulse of 0.2 s."""
    machine = load_machine(LAB_AXIS)
    t = np.arange(800) * 1e-3
    signals = {("X", "setpoint"): np.zeros_like(t)}
    if signal:
        signals["X", signal] = np.where((t > 0.2) & (t < 0.4), size, 0.0)
    return simulate(machine, setpoints_of(Trace(t, signals, {"X": "linear"}), machine)).without_noise.get("X", "position")


def test_a_pulse_pushes_the_axis() -> None:
    force, voltage, none = followed("disturbance_force", 36.0), followed("disturbance_voltage", 2.0), followed(None, 0.0)
    assert np.abs(none).max() < 1e-9
    assert np.abs(force - voltage).max() < 1e-12  # 18 N/V
    # held by the position loop: x = (F - friction) / (18 N/V * 100 V s/m * 25 1/s)
    assert force[399] == pytest.approx((36.0 - 6.0) / (18.0 * 100.0 * 25.0), rel=0.05)


def test_a_disturbance_that_the_drive_cannot_take() -> None:
    with pytest.raises(InputError, match="its drive takes V"):
        followed("disturbance_current", 1.0)
