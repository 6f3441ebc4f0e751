"""Size from which an effect is visible: its squared response over noise, beyond re-tuning, compared with the needed evidence."""

from dataclasses import replace
import math

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of
from tests.diagnose.law.test_closed_loop import X as LAB
from tests.diagnose.law.test_closed_loop import runs_of
from twin.diagnose import not_visible
from twin.diagnose.columns import column_of
from twin.diagnose.fit import no_effect
from twin.diagnose.observe import observe
from twin.diagnose.settings import T
from twin.diagnose.starts import Start, middle_starts, starts_of
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import Nuisance
from twin.diagnose.tuning import tuning_from, tuning_of
from twin.diagnose.view import view_of
from twin.effects import EFFECTS, Setting
from twin.errors import SimulationError
from twin.machine.machine import load_machine

ROWS = 500
ALONG = np.repeat([1.0, 0.0], ROWS // 2)
ACROSS = np.repeat([0.0, 1.0], ROWS // 2)


def sizes_of(columns, monkeypatch, moving=None):
    """Multiples of the usual size from which effects with these responses are visible; a nuisance absorbs the part along ALONG."""
    tuning = tuning_from([Nuisance("X", "moving_mass")], columns_of(1e6 * ALONG[:, None]), 0.01)
    group = group_of([np.zeros(ROWS)], moving=moving)
    group = replace(group, views=[replace(view, file=load_machine()) for view in group.views])
    found = found_of(group, tuning)
    axes = dict(zip("XYZ", columns))

    def cached_responses(found, settings):
        columns = [axes[setting.axis] for setting in settings]
        return [SimulationError("unstable") if column is None else column_of(column) for column in columns]

    monkeypatch.setattr(type(found), "cached_responses", cached_responses)
    monkeypatch.setattr(type(found), "remembers", lambda found, setting: True)
    starts = [Start((Setting(EFFECTS["coulomb_friction"], axis, {"factor": 1.3}),)) for axis in axes]
    return {axis: sizes for (_, axis, _), sizes in not_visible.effects_not_visible(found, starts, 3).items()}


def of_evidence(evidence):
    return ACROSS * math.sqrt(2.0 * evidence / ACROSS.sum())


NEEDED = T.evidence + T.imperfect * 0.5 * ROWS
"""Evidence that friction needs in these rows: the minimum plus a share of the loss of noise."""


def test_a_quarter_of_the_evidence_needs_twice_the_size(monkeypatch):
    sizes = sizes_of([of_evidence(NEEDED / 4.0), of_evidence(1.1 * NEEDED), None], monkeypatch)
    assert sizes == {"X": pytest.approx(2.0, rel=1e-6)}  # visible effects and effects without a running machine are not listed


def test_no_response_or_a_collinear_one_is_never_visible(monkeypatch):
    sizes = sizes_of([0.0 * ALONG, 3.0 * ALONG, of_evidence(20.0)], monkeypatch)
    assert sizes == {"X": math.inf, "Y": math.inf}


def test_a_response_at_rest_hardly_counts(monkeypatch):
    sizes = sizes_of([of_evidence(NEEDED)], monkeypatch, moving=np.zeros(ROWS, bool))
    assert sizes == {"X": pytest.approx(T.unsettled_weight**-0.5, rel=1e-6)}


def test_a_limit_is_tested_at_a_usual_level():
    machine = load_machine()
    start = Start((Setting(EFFECTS["current_limit"], "Y", {"limit_a": 0.5}),))
    low, high = EFFECTS["current_limit"].parameter("limit_a").usual_range(machine, machine.axis("Y"))
    (setting,) = not_visible._usual(start, machine)
    assert low <= setting.parameters["limit_a"] <= high


def test_one_run_shows_at_most_what_all_runs_show():
    group = observe([view_of(LAB, run) for run in runs_of([])], ("X",))
    assert len(group.views) > 1
    tuning = tuning_of(group)
    state = GroupState(group, group, tuning, no_effect(group, tuning), 1.0)
    asked = [start.settings for start in middle_starts(starts_of(group, group.residual)).values()]
    shares = not_visible.shares_in_one_run(state, asked, 3)
    in_one = [shares[settings[0].key] for settings in asked]
    in_all = [not_visible.share_in_all_runs(state, settings, state.cached_responses(settings), 3) for settings in asked]
    assert all(one <= (1.0 + 1e-4) * whole + 1e-9 for one, whole in zip(in_one, in_all))
    assert sum(one >= 1.0 for one in in_one) > 0.8 * sum(whole >= 1.0 for whole in in_all) > 0


def test_what_one_run_shows_is_not_simulated_in_the_others(monkeypatch):
    group = observe([view_of(LAB, run) for run in runs_of([])], ("X",))
    tuning = tuning_of(group)
    state = GroupState(group, group, tuning, no_effect(group, tuning), 1.0)
    starts = starts_of(group, group.residual)
    not_visible.effects_not_visible(state, starts, 3)
    assert len(state.response_cache) < 0.5 * sum(len(start.settings) for start in middle_starts(starts).values())
