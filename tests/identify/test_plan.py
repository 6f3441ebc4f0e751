"""A plan stays inside the travel, whatever it is."""

from __future__ import annotations

import pytest

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
