"""A plan stays inside the travel, whatever it is; figures of rows tell the machine's own cycle."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.builders.identify_campaigns import campaign, usual_runs
from twin.identify.drive_balance import ROW_STRIDE
from twin.identify.figures import residual_figure
from twin.identify.identify import identify
from twin.identify.plan import _check_runs, _table_runs
from twin.machine.machine import Machine
from twin.simulation.setpoints import check_travel


@pytest.mark.parametrize(
    ("axis", "travel"),
    [("C", [-170.0, 170.0]), ("C", [0.0, 60.0]), ("A", [-110.0, -5.0]), ("A", [10.0, 100.0]), ("A", "endless"), ("C", "endless")],
)
def test_the_table_turns_within_its_travel(mikron: Machine, axis: str, travel: object) -> None:
    machine = mikron.with_values({f"axis.{axis}.travel_deg": travel})
    (run,) = _table_runs(machine)
    check_travel(run.setpoints, machine, run.name)
    check_travel(_check_runs(machine)[0].setpoints, machine, "plan_check")
    places = {name: sorted({round(t[name], 6) for t, _ in run.blocks if name in t}) for name in "AC"}
    assert {name: len(of_axis) for name, of_axis in places.items()} == {"A": 3, "C": 3}


def test_the_residual_axis_uses_the_spacing_of_the_rows(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    result = identify(campaign(usual_runs(machine)), machine, refine=False, gaps=False)
    for cycle in (machine.position_cycle, 0.5 * machine.position_cycle):
        trace, white = residual_figure(replace(result, before=machine.with_values({"control.position_cycle_us": cycle * 1e6}))).axes
        assert trace.get_xlabel() == f"rows where the axis slides, {ROW_STRIDE * cycle * 1e3:g} ms apart"
        lags = [segment[0, 0] for segment in white.collections[-1].get_segments()]
        assert lags[1] - lags[0] == pytest.approx(ROW_STRIDE * cycle * 1e3)
