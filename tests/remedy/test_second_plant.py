"""Compensations in the twin and in the second plant, which has its own equations: the same numbers entered move the same load alike."""

from __future__ import annotations

import numpy as np
import pytest

from devtools.switched_on import switch_on
from tests.conftest import swings
from tests.reference.test_dsc import fine_measuring
from twin.exam.plant.parameters import AXES, settings_of, unit_factors
from twin.exam.plant.plant import run
from twin.machine.machine import Machine
from twin.remedy.advice import BACKLASH, GAIN, PULSE, TABLE
from twin.remedy.change import Change
from twin.simulation.run import simulate

ENTERED = {
    "pulse": ("X", PULSE, {"amplitude": 1.5e-3, "decay_time": 0.01}),
    "pulse of a table": ("C", PULSE, {"amplitude": 0.02, "decay_time": 0.015}),
    "pulse with a characteristic": (
        "X", PULSE, {"amplitude": 3e-3, "decay_time": 0.01, "amplitude_low": 1e-3, "acceleration_1": 0.1, "acceleration_2": 0.3, "acceleration_3": 0.9},
    ),
    "pulse of a slow reversal": ("X", PULSE, {"amplitude": 3e-3, "decay_time": 0.01, "acceleration_1": 2.0}),
    "position gain": ("X", GAIN, {"position_gain_per_s": 90.0}),
    "backlash value": ("Y", BACKLASH, {"width": 12e-6, "cycles": 3.0}),
    "backlash value of a table": ("C", BACKLASH, {"width": 1e-4, "cycles": 1.0}),
    "table": ("X", TABLE, {"slope": 80.0, "origin": 0.01, "sine": 4e-6, "cosine": 3e-6, "wavelength": 0.01}),
    "table of a geared axis": ("C", TABLE, {"slope": 0.0, "origin": 0.0, "sine": 4e-5, "cosine": -3e-5, "wavelength": np.pi / 45.0}),
    "table of a turn": ("C", TABLE, {"slope": 0.0, "origin": 0.0, "sine": 4e-5, "cosine": -3e-5, "wavelength": 2.0 * np.pi}),
}  # fmt: skip


@pytest.mark.parametrize("name", ENTERED)
def test_both_plants_move_alike(mikron: Machine, name: str) -> None:
    axis, function, values = ENTERED[name]
    machine = fine_measuring(mikron).with_values({f"axis.{axis}.encoder": "motor"})
    change = Change(axis, function, values=values)
    points = swings(machine, 0.8)
    moved, own = [], []
    for entered in ([], [change]):
        settings = settings_of(dict(machine.document), unit_factors())
        for one in entered:
            switch_on(settings, {"axis": axis, "function": function, "parameters": one.table(machine)})
        moved.append(run(settings, points.position, noise=False).load[:, AXES.index(axis)])
        own.append(simulate(change.applied(machine) if entered else machine, points).trace.get(axis, "load_position"))
    there, here = moved[1] - moved[0], own[1] - own[0]
    assert np.abs(there).max() > 0.2e-6
    assert np.sqrt(np.mean((there - here) ** 2)) < 0.05 * np.sqrt(np.mean(there**2))
