"""The gap step by step: its steps lead from the measured gap before to the measured gap after, whatever was found."""

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of, no_tuning
from twin.diagnose import sizes
from twin.diagnose.columns import Columns
from twin.diagnose.fit import Fit
from twin.diagnose.waterfall import retuning_share, waterfall
from twin.effects import EFFECTS, Setting
from twin.simulation.gap_level import overall

FRICTION = Setting(EFFECTS["viscous_friction"], "X", {"factor": 1.5})


def state_of(axes: str, rows: np.ndarray, response: np.ndarray | None):
    """A group of axes whose only run leaves these rows on each axis, with an effect on X if it has a response."""
    group = group_of([rows], axes)
    if response is None:
        return found_of(group)
    size = group.size
    columns = np.zeros((size, 0))
    return found_of(group, fit=Fit((FRICTION,), [], 0.0, np.zeros(0), np.resize(response, size), columns, no_tuning(size)))


def test_a_law_has_a_step_of_its_own():
    """Re-tuning does not get the credit for what an unlisted law closes."""
    steps = waterfall([state_of("X", np.full(50, 10.0), None)], {"X": (100.0, 100.0)}, (), {"X": 1.0})
    assert [label for label, _ in steps] == ["machine file", "re-tuned within tolerance", "unlisted law X"]
    assert [level for _, level in steps] == pytest.approx([10.0, 10.0, 1.0])
    assert retuning_share(steps) == 0.0


@pytest.mark.parametrize("seed", range(40))
def test_the_steps_add_up(seed):
    """For random groups, effects (some replaced by laws), laws and levels: the first step is the gap before, the last one the gap after."""
    rng = np.random.default_rng(seed)
    groups = [("X", "YZ"), ("XYZ",), ("X", "Y")][seed % 3]
    states, ends, with_laws = [], {"A": (4.0, 4.0)}, {}
    for axes in groups:
        rows = rng.normal(0.0, 8.0, 60)
        states.append(state_of(axes, rows, rng.uniform(0.0, 1.0) * rows if "X" in axes and rng.random() < 0.7 else None))
        ends |= {axis: (float(rng.uniform(1.0, 200.0)), float(rng.uniform(0.8, 60.0))) for axis in axes}
        with_laws |= {axis: float(rng.uniform(0.8, 3.0)) for axis in axes if rng.random() < 0.3}
    kept = {FRICTION.key} if rng.random() < 0.6 else set()
    steps = waterfall(states, ends, kept, with_laws)
    after = {axis: last for axis, (_, last) in ends.items()} | with_laws
    assert steps[0][1] == pytest.approx(overall({axis: first**0.5 for axis, (first, _) in ends.items()}))
    assert steps[-1][1] == pytest.approx(overall({axis: square**0.5 for axis, square in after.items()}))
    assert any("viscous" in label for label, _ in steps) == any(FRICTION.key in kept and s.fit.settings for s in states)


def test_normal_imperfections_count_as_re_tuned():
    """The machine file leaves 10 x noise; a normal spring alone, about which the group is linearised, leaves 1 x noise."""
    rigid, imperfect = (group_of([np.full(50, level)]) for level in (10.0, 1.0))
    state = replace(found_of(imperfect), rigid=rigid)
    setting = replace(FRICTION)
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.full(50, 0.5), Columns([], 50), no_tuning(50))
    state = replace(state, fit=fit).with_accepted(1)
    steps = waterfall([state], {"X": (100.0, 0.25)}, {setting.key}, {})
    assert [level for _, level in steps] == pytest.approx([10.0, 1.0, 0.5])
    assert retuning_share(steps) == pytest.approx(1.0)


def test_each_effect_that_stays_keeps_its_step(monkeypatch):
    """Of three effects, each accepted in its own round, the first one has no plausible final size."""
    names = {"viscous_friction": {"factor": 2.0}, "coulomb_friction": {"factor": 1.5}, "constant_force": {"force": 50.0}}
    settings = tuple(Setting(EFFECTS[name], "X", values) for name, values in names.items())

    def fit_of(some):
        return Fit(tuple(some), [], 0.0, np.zeros(0), np.zeros(50), Columns([], 50), no_tuning(50))

    state = found_of(group_of([np.full(50, 10.0)]))
    for count in (1, 2, 3):
        state = replace(state, fit=fit_of(settings[:count])).with_accepted(count)
    monkeypatch.setattr(sizes, "is_plausible", lambda setting, *_: setting is not settings[0])
    monkeypatch.setattr(sizes, "fit_effects", lambda group, tuning, kept, *_: fit_of(kept))
    steps = waterfall([sizes.without_implausible(state)], {"X": (100.0, 1.0)}, {s.key for s in settings}, {})
    assert [label for label, _ in steps[2:]] == ["Coulomb friction on axis X", "constant force on axis X"]
