"""Unexplained residuals: sizes that differ between runs, or a residual above noise on an axis."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of
from twin.diagnose.channel import Channel
from twin.diagnose.fit import Free, no_effect
from twin.diagnose.search import axes_above_noise_within_tolerance
from twin.diagnose.state import axes_above_noise
from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import tuning_from
from twin.diagnose.verdict import differs_between_runs
from twin.effects import EFFECTS, Setting

SAMPLES, RUNS = 400, 3
TOLERANCE = 0.01
SETTING = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.5})


def settled_as(channel, mask):
    """Set the mask (sample,) of a channel's samples that do not depend on how the axis stuck."""
    channel.__dict__["settled"] = lambda view: mask


def found_with(left, slope):
    """A state with given residual and slope over the factor for each run (run, sample)."""
    channels = [
        Channel(k, "X", "velocity", np.asarray(rows), np.ones(SAMPLES), 1.0, slice(k * SAMPLES, (k + 1) * SAMPLES))
        for k, rows in enumerate(left)
    ]
    for channel in channels:
        settled_as(channel, np.ones(SAMPLES, bool))
    rows = np.concatenate(left)
    parameter = SETTING.effect.parameter("factor")
    return SimpleNamespace(
        group=SimpleNamespace(
            channels=channels,
            size=rows.size,
            expected_loss=0.5 * rows.size,
            views=[None] * RUNS,
            weights=np.ones(rows.size),
            residual=rows,
            axes=("X",),
            part=lambda axes, runs: (None, np.flatnonzero(np.isin(np.arange(rows.size) // SAMPLES, list(runs)))),
            has=lambda axis, channel: any((c.axis, c.name) == (axis, channel) for c in channels),
        ),
        fit=SimpleNamespace(
            settings=(SETTING,),
            free=[Free(0, parameter, False, 0.05)],
            columns=columns_of(np.concatenate(slope)[:, None]),
            residual=lambda group: rows,
        ),
    )


def noise(seed):
    return np.random.default_rng(seed).normal(size=(RUNS, SAMPLES))


@pytest.mark.parametrize(
    ("steps", "differs"), [((0.0, 0.0, 0.0), False), ((2.0, 0.0, -2.0), True), ((2.0, 2.0, 2.0), False), ((0.4, 0.0, -0.4), False)]
)
def test_an_effect_has_one_size(steps, differs):
    """A step of 1 is 0.05 of a factor that is 0.5 from neutral, a tenth of the size."""
    slope = np.full((RUNS, SAMPLES), 2.0)
    assert differs_between_runs(found_with(noise(1) + np.array(steps)[:, None] * slope, slope)) is differs


def test_sizes_that_differ_in_break_aways_do_not_count():
    """Each break-away is different; twenty samples of one must not decide."""
    slope, stuck = np.full((RUNS, SAMPLES), 2.0), np.arange(SAMPLES) < 20
    found = found_with(noise(1) + np.array((40.0, 0.0, -40.0))[:, None] * slope * stuck, slope)
    assert differs_between_runs(found)
    for channel in found.group.channels:
        settled_as(channel, ~stuck)
    assert not differs_between_runs(found)


def test_different_sizes_need_evidence():
    """Two steps of 2 with a standard deviation of 0.025 have an evidence of 6400. If 0.0012 of the loss of noise exceeds this, it may be model error."""
    slope = np.full((RUNS, SAMPLES), 2.0)
    found = found_with(noise(1) + np.array((2.0, 0.0, -2.0))[:, None] * slope, slope)
    assert differs_between_runs(found)
    found.group.expected_loss = 1e7
    assert not differs_between_runs(found)


def test_a_step_that_all_runs_share_is_no_evidence_of_different_sizes():
    """The steps 40, 40 and 41.5 deviate from their mean with an evidence of 1200; their common step, which break-aways cause, has four million."""
    slope = np.full((RUNS, SAMPLES), 2.0)
    found = found_with(noise(1) + np.array((40.0, 40.0, 41.5))[:, None] * slope, slope)
    assert differs_between_runs(found)
    found.group.expected_loss = 1e7
    assert not differs_between_runs(found)


def test_different_sizes_within_chance_do_not_count():
    slope = np.full((RUNS, SAMPLES), 0.01)  # standard deviation of the step from one run: 1 / (0.01 sqrt(400)) = 5
    assert not differs_between_runs(found_with(noise(2), slope))


def test_only_axes_above_their_noise_are_listed():
    found = found_with(noise(4) * np.array((1.0, 1.5, 1.0))[:, None], np.ones((RUNS, SAMPLES)))
    found.group.channels = [replace(channel, axis=axis) for channel, axis in zip(found.group.channels, "XYZ")]
    found.group.credit = np.ones(found.group.size)
    assert axes_above_noise(found.group, found.group.residual) == {"Y"}
    found.group.credit[found.group.channels[1].rows] = 0.03  # the axis was stuck
    assert axes_above_noise(found.group, found.group.residual) == set()


@pytest.mark.parametrize(("size", "loud"), [(30.0, {"X"}), (3.0, set())])
def test_a_residual_that_exceeds_the_tolerance_is_above_noise(size, loud):
    """A friction of many times the tolerance would leave noise only, but is no re-tuning. `size` is in noise; the tolerance accounts for 3."""
    wave = np.where(np.arange(RUNS * SAMPLES) % 40 < 20, 1.0, -1.0)
    tuning = tuning_from([Nuisance("X", "coulomb_friction")], columns_of(3.0 * wave[:, None] * UNIFORM), TOLERANCE * UNIFORM)
    found = found_with(noise(5), np.ones((RUNS, SAMPLES)))
    group = found.group
    group.credit, group.residual = np.ones(group.size), group.residual + size * wave
    found.fit = no_effect(group, tuning)
    group.machine = SimpleNamespace(parameter_tolerance=TOLERANCE)
    assert axes_above_noise_within_tolerance(found) == loud
