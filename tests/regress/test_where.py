"""Finds the first changed block on a machine whose drive closes the position loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace, read_trace
from twin.regress.compare import Check
from twin.regress.where import FOLLOWED, SHARE, block_shares, place_of
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"
LAG = "axis.X.loops.speed_filter_time_s"


def machine_with(lag_s: float = 0.0, **values: float) -> Machine:
    """X of the home machine with dynamic servo control and a set point between two cycles; `lag_s` filters its speed."""
    dsc = {"axis.X.loops.dsc_delay_s": 5.25e-3, "axis.X.loops.position_delay_s": 3e-3, "control.setpoint_interpolation": "linear"}
    changed = {f"axis.X.{key.replace('loops_', 'loops.')}": value for key, value in values.items()}
    return load_machine().with_axes(["X"]).with_values({**dsc, LAG: lag_s, **changed})


@pytest.mark.parametrize("lag_s", [0.0, 1e-3])
@pytest.mark.parametrize(
    ("change", "block"),
    [
        ({"loops_position_gain_per_s": 50.5}, "position controller"),
        ({"loops_dsc_delay_s": 5.5e-3}, "position controller"),
        ({"loops_speed_gain_nm_s_per_rad": 1.01}, "speed controller"),
        ({"coulomb_friction_nm": 1.02}, "mechanics"),
    ],
)
def test_a_drive_that_closes_the_position_loop(change: dict[str, float], block: str, lag_s: float) -> None:
    """The changed block is the first with a large share; blocks before it follow the golden law."""
    golden = machine_with(lag_s)
    if block in ("speed controller", "mechanics"):  # a share of what the file has
        document = golden.document["axis"]["X"]
        (key,) = change
        was = document["loops"]["speed_gain_nm_s_per_rad"] if key.startswith("loops") else document[key]
        change = {key: was * change[key]}
    now = machine_with(lag_s, **change)
    traces = [simulate(m, setpoints_of(read_trace(EXAMPLE), m), sample_period=m.position_cycle).trace for m in (golden, now)]
    shares = dict(block_shares(golden, golden.axis("X"), *traces))
    assert next((name for name, share in shares.items() if share > SHARE), "") == block, shares


def test_further_blocks_of_the_control_belong_to_its_law() -> None:
    """Another friction changes what a pid answers, not its law; a pid that is gone is the position controller."""
    plain = load_machine().with_axes(["X"])
    golden = plain.with_values({"axis.X.block": {"pid": {"dead_band_m": 2e-6, "integral_gain_per_s2": 400.0}}})
    rougher = golden.with_values({"axis.X.coulomb_friction_nm": 1.05 * plain.axis("X").coulomb_friction_nm})
    traces = [simulate(m, setpoints_of(read_trace(EXAMPLE), m), sample_period=m.position_cycle).trace for m in (golden, rougher, plain)]
    after_friction, without = (dict(block_shares(golden, golden.axis("X"), traces[0], trace)) for trace in traces[1:])
    assert after_friction["position controller"] < 1e-3, after_friction
    assert without["position controller"] > SHARE, without


@pytest.mark.parametrize(("key", "block"), [("loops_speed_gain_nm_s_per_rad", "speed controller"), ("coulomb_friction_nm", "mechanics")])
def test_a_change_is_located_without_the_recorded_drive_set_point(key: str, block: str) -> None:
    """It follows from the command and the position."""
    golden = machine_with()
    axis = golden.axis("X")
    was = axis.coulomb_friction_nm if key.startswith("coulomb") else axis.loops.speed_gain_nm_s_per_rad
    traces = []
    for machine in (golden, machine_with(**{key: 1.05 * was})):
        trace = simulate(machine, setpoints_of(read_trace(EXAMPLE), machine), sample_period=machine.position_cycle).trace
        signals = {name: values for name, values in trace.signals.items() if name[1] != FOLLOWED}
        traces.append(Trace(trace.time, signals, trace.kinds))
    shares = dict(block_shares(golden, axis, *traces))
    assert next((name for name, share in shares.items() if share > SHARE), "") == block, shares
    if block == "mechanics":
        assert shares["speed controller"] < 1e-3, shares  # 1.6e-3 with what the NC sends


@pytest.mark.parametrize(
    ("shares", "named"),
    [
        ({"position controller": 0.05, "current loop": 0.4, "mechanics": 0.9}, "current loop"),  # first above SHARE, not the largest
        ({"position controller": 0.1, "current loop": 0.3, "mechanics": 0.2}, "current loop"),  # none above SHARE: the largest
    ],
)
def test_the_first_block_with_a_large_share_is_named(monkeypatch: pytest.MonkeyPatch, shares: dict[str, float], named: str) -> None:
    monkeypatch.setattr("twin.regress.where.block_shares", lambda *_: iter(shares.items()))
    time = np.arange(10) * 2e-3
    trace = Trace(time, {("X", "position"): np.zeros(10)}, {"X": "linear"})
    place = place_of(load_machine(), trace, trace, [Check("X.position max", "X", "um", 1.0, 0.1)])
    assert place is not None
    assert (place.axis, place.block) == ("X", named)
