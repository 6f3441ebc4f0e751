"""The speed controller held against its recorded inputs: only where each of its set points was recorded."""

from pathlib import Path

import numpy as np
import pytest

from twin.diagnose.blocks import block_residuals
from twin.diagnose.observe import observe
from twin.diagnose.view import view_of
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import read_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"


@pytest.mark.parametrize(("period_s", "blocks"), [(1e-3, 1), (2e-3, 1), (4e-3, 0)])
def test_law_of_the_speed_controller(period_s: float, blocks: int) -> None:
    machine = load_machine().with_axes(["X"])
    setpoints = setpoints_of(read_trace(EXAMPLE), machine)
    trace = simulate(machine, setpoints, sample_period=period_s, noise_seed=1).trace
    view = view_of(machine, MeasuredRun("out and back", trace, "velocity+torque", 0.0))
    found = [b for b in block_residuals(observe([view], ("X",)), lambda m: m) if b.block == "speed controller"]
    assert len(found) == blocks
    assert all(float(np.std(b.residual)) < 1.3 * b.sigma for b in found)
