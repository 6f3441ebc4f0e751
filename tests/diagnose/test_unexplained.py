"""What a fit leaves: one size in one run and another in the next, too much in most runs, or more than noise on an axis."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twin.diagnose.channel import Channel
from twin.diagnose.fit import Free, no_effect
from twin.diagnose.search import axes_above_noise_within_tolerance
from twin.diagnose.settings import DEFAULT
from twin.diagnose.state import axes_above_noise, is_systematic
from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import tuning_from
from twin.diagnose.verdict import differs_between_runs
from twin.effects import EFFECTS, Setting

SAMPLES, RUNS = 400, 3
TOLERANCE = 0.01
SETTING = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.5})


def settled_as(channel, mask):
    """Make a channel say that these samples (sample,) no longer show how the axis was stuck."""
    channel.__dict__["settled"] = lambda view: mask


def found_with(left, slope):
    """A search's result of which the rows of each run are given: what is left and the slope over the factor (run, sample)."""
    channels = [
        Channel(k, "X", "velocity", np.asarray(rows), np.ones(SAMPLES), 1.0, slice(k * SAMPLES, (k + 1) * SAMPLES))
        for k, rows in enumerate(left)
    ]
    for channel in channels:
        settled_as(channel, np.ones(SAMPLES, bool))
    rows = np.concatenate(left)
    parameter = SETTING.effect.parameter("factor")
    return SimpleNamespace(
        thresholds=DEFAULT,
        group=SimpleNamespace(
            channels=channels,
            thresholds=DEFAULT,
            size=rows.size,
            expected_loss=0.5 * rows.size,
            views=[None] * RUNS,
            weights=np.ones(rows.size),
            residual=rows,
            run_rows=lambda run: np.arange(rows.size) // SAMPLES == run,
        ),
        fit=SimpleNamespace(
            settings=(SETTING,), free=[Free(0, parameter, False, 0.05)], columns=np.concatenate(slope)[:, None], residual=lambda group: rows
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


def test_a_size_that_differs_where_an_axis_was_stuck_is_one_size():
    """Each break-away is another; twenty samples of one outweigh nothing."""
    slope, stuck = np.full((RUNS, SAMPLES), 2.0), np.arange(SAMPLES) < 20
    found = found_with(noise(1) + np.array((40.0, 0.0, -40.0))[:, None] * slope * stuck, slope)
    assert differs_between_runs(found)
    for channel in found.group.channels:
        settled_as(channel, ~stuck)
    assert not differs_between_runs(found)


def test_sizes_differ_where_that_brings_evidence():
    """Two steps of 2 known to 0.025 bring 6400; where 0.0012 of what noise makes is more than that, the twin may be wrong by as much."""
    slope = np.full((RUNS, SAMPLES), 2.0)
    found = found_with(noise(1) + np.array((2.0, 0.0, -2.0))[:, None] * slope, slope)
    assert differs_between_runs(found)
    found.group.expected_loss = 1e7
    assert not differs_between_runs(found)


def test_sizes_that_are_chance_do_not_differ():
    slope = np.full((RUNS, SAMPLES), 0.01)  # a run alone knows the step to 1 / (0.01 sqrt(400)) = 5
    assert not differs_between_runs(found_with(noise(2), slope))


@pytest.mark.parametrize(("levels", "systematic"), [((1.0, 1.8, 1.8), False), ((9.0, 1.0, 1.0), False), ((1.0, 2.5, 2.5), True)])
def test_what_is_left_in_most_runs_is_another_law(levels, systematic):
    """Root mean squares over noise: one run with much is chance, most runs with two and a half times the noise are not."""
    assert is_systematic(found_with(noise(3) * np.array(levels)[:, None], np.ones((RUNS, SAMPLES)))) is systematic


def test_only_axes_above_their_noise_are_loud():
    found = found_with(noise(4) * np.array((1.0, 1.5, 1.0))[:, None], np.ones((RUNS, SAMPLES)))
    found.group.channels = [replace(channel, axis=axis) for channel, axis in zip(found.group.channels, "XYZ")]
    found.group.credit = np.ones(found.group.size)
    assert axes_above_noise(found.group, found.group.residual) == {"Y"}
    found.group.credit[found.group.channels[1].rows] = 0.03  # the axis was stuck
    assert axes_above_noise(found.group, found.group.residual) == set()


@pytest.mark.parametrize(("size", "loud"), [(30.0, {"X"}), (3.0, set())])
def test_what_only_a_far_off_machine_explains_is_loud(size, loud):
    """A friction of many times the tolerance leaves noise alone, and is no re-tuning; `size` in noise, of which the tolerance makes 3."""
    wave = np.where(np.arange(RUNS * SAMPLES) % 40 < 20, 1.0, -1.0)
    tuning = tuning_from([Nuisance("X", "coulomb_friction")], 3.0 * wave[:, None] * UNIFORM, TOLERANCE * UNIFORM)
    found = found_with(noise(5), np.ones((RUNS, SAMPLES)))
    group = found.group
    group.credit, group.residual = np.ones(group.size), group.residual + size * wave
    found.fit = no_effect(group, tuning)
    assert axes_above_noise_within_tolerance(found, SimpleNamespace(parameter_tolerance=TOLERANCE)) == loud
