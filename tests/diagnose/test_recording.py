"""Steps shown in the replay of a diagnosis, and detection of ballbar-only groups."""

from types import SimpleNamespace

import numpy as np

from tests.builders.diagnosis_state import group_of
from twin.diagnose.recording import one_by_one
from twin.effects import settings_of, with_effects
from twin.machine.machine import load_machine

X = load_machine().with_axes(["X"])
LAW = {"name": "law", "axis": "X", "block": "mechanics", "output": "friction", "formula": "gaussian", "height": -300.0, "width": 0.01}


def test_two_laws_of_one_axis_are_two_steps():
    laws = [LAW | {"variables": ["speed"]}, LAW | {"variables": ["position"], "output": "force"}]
    corrected = with_effects(X, laws)
    rows = tuple(SimpleNamespace(axis="X", effect="law", name="law", setting=s) for s in settings_of(corrected))
    steps = one_by_one(SimpleNamespace(machine=X, corrected=corrected, budget=SimpleNamespace(rows=rows)), "X")
    assert [len(settings_of(machine)) for machine in steps.values()] == [0, 0, 1, 2]
    assert list(steps)[:2] == ["machine file", "re-tuned"]


def test_axes_that_never_move_are_not_a_ballbar_group():
    assert not group_of([np.zeros(50)], moving=np.zeros(50, bool)).by_radius
