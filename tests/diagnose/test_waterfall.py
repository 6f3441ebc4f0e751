"""The gap step by step."""

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of, no_tuning
from twin.diagnose.fit import Fit
from twin.diagnose.waterfall import retuning_share, waterfall
from twin.effects import EFFECTS, Setting


def test_a_law_has_a_step_of_its_own():
    """Re-tuning does not get the credit for what an unlisted law closes."""
    found = found_of(group_of([np.full(50, 10.0)]))
    steps = waterfall([found], {"X": (100.0, 100.0)}, 0.01, (), {"X": 1.0})
    assert [label for label, _ in steps] == ["machine file", "re-tuned within tolerance", "unlisted law X"]
    assert [level for _, level in steps] == pytest.approx([10.0, 10.0, 1.0])
    assert retuning_share(steps) == 0.0


@pytest.mark.parametrize("kept", [True, False])
def test_an_effect_that_a_law_replaced_has_no_step(kept):
    group = group_of([np.full(50, 10.0)])
    setting = Setting(EFFECTS["viscous_friction"], "X", {"factor": 1.5})
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.full(50, 8.0), np.zeros((50, 0)), no_tuning(50))
    steps = waterfall([found_of(group, fit=fit)], {"X": (100.0, 4.0)}, 0.01, {setting.key} if kept else (), {"X": 1.0})
    assert len(steps) == 3 + kept
    assert steps[-1] == ("unlisted law X", 1.0)
