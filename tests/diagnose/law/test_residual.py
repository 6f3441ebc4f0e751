"""Residuals of an axis on a voltage whose control differentiates the position, and the lag of its drive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnose.law.test_closed_loop import X, laws_beside, runs_of
from twin.diagnose.law.relations import Relation, contribution_to_residual
from twin.diagnose.law.residual import CURRENT_LOOP, MECHANICS, residuals_of
from twin.diagnose.law.wording import sentence
from twin.diagnose.observe import observe
from twin.diagnose.view import view_of
from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

EMPS = Path(__file__).resolve().parents[3] / "examples/emps/axis.toml"


DRIVE = load_machine(EMPS)
LAG = {
    "name": "law", "axis": "X", "block": "current loop", "output": "torque", "variables": ["current"], "formula": "first-order lag",
    "time_constant_s": 0.4e-3,
}  # fmt: skip


def strokes(effects: list[dict], speeds=(0.1,)) -> list[MeasuredRun]:
    """A stroke there and back at each speed, recorded as on the real axis: set point, motor encoder and command."""
    runs = []
    for seed, speed in enumerate(speeds):
        position = moves_in_turn(0.0, [0.1, -0.1], speed, 0.8, 50.0, 0.1, 1e-3)[1]
        run = simulate(with_effects(DRIVE, effects), Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=seed)
        recorded = {key: values for key, values in run.trace.signals.items() if key[1] in ("setpoint", "motor_position", "voltage")}
        runs.append(MeasuredRun(f"stroke{seed}", replace(run.trace, signals=recorded), "off", 0.0))
    return runs


def test_a_control_that_differentiates_the_position_leaves_no_force():
    """Its speed is a mean over two cycles and therefore late. A record without speed is differentiated as it is; so is the simulation."""
    (run,) = strokes([])
    (samples,) = [s for s in residuals_of([view_of(DRIVE, run)], lambda m: m, "X", map) if s.block == MECHANICS]
    assert np.std(samples.y) < 3.0 * samples.sigma


def test_the_lag_of_a_drive_is_found_as_a_law():
    """The smoothed force hides it, so it is always tried in closed loop."""
    views = [view_of(DRIVE, run) for run in strokes([LAG], (0.06, 0.1, 0.12))]
    laws = laws_beside([], observe(views, ("X",)), DRIVE)
    (law,) = laws.laws
    assert law.setting.table()["formula"] == "first-order lag"
    assert law.setting.parameters["time_constant_s"] == pytest.approx(0.4e-3, rel=0.02)
    assert sum(law.explained for law in laws.laws) > 0.8
    assert sentence(law, DRIVE).startswith("a first-order lag in the delivered torque of X, of (0.399 +- 0.007) ms")


def test_a_drive_without_lag_gets_none():
    views = [view_of(DRIVE, run) for run in strokes([], (0.06, 0.1, 0.12))]
    assert laws_beside([], observe(views, ("X",)), DRIVE).laws == ()


def changed(run: MeasuredRun, left_out: str = "", every: int = 1) -> MeasuredRun:
    """The run without a signal, recorded at every so many samples."""
    trace = run.trace
    return replace(
        run, trace=Trace(trace.time[::every], {k: v[::every] for k, v in trace.signals.items() if k[1] != left_out}, trace.kinds)
    )


@pytest.mark.parametrize("order", [1, -1])
def test_runs_with_different_signals_share_the_variables_that_all_of_them_have(order: int) -> None:
    runs = [runs_of([])[0], changed(runs_of([])[1], left_out="current")][::order]
    found = {s.block: s for s in residuals_of([view_of(X, run) for run in runs], lambda m: m, "X", map)}
    assert "current" not in found["transmission"].motion
    assert "velocity" in found["transmission"].motion


def test_a_voltage_passes_the_current_loop_at_the_period_of_each_run() -> None:
    runs = [runs_of([])[0], changed(runs_of([])[1], every=2)]
    (samples,) = [s for s in residuals_of([view_of(X, run) for run in runs], lambda m: m, "X", map) if s.block == CURRENT_LOOP]
    voltage = np.sign(np.sin(np.arange(len(samples)) / 50.0))[:, None]
    current = contribution_to_residual(samples, Relation(CURRENT_LOOP, "voltage", "current"), X.axes[0], voltage)
    first, second = samples.through
    assert not np.allclose(first(voltage), second(voltage))
    for loop, run in ((first, 0), (second, 1)):
        rows = samples.run == run
        assert np.array_equal(current[rows], loop(voltage[rows]))
