"""Samples that the twin does not follow have a larger model error and hardly influence a fit."""

import numpy as np
import pytest

from twin.diagnose.channel import Channel
from twin.diagnose.settings import T

PERIOD, SAMPLES = 0.002, 3000
SIGMA = 2.0


@pytest.fixture
def channel():
    return Channel(0, "X", "velocity", np.zeros(SAMPLES), np.full(SAMPLES, SIGMA), 1.0)


def noise():
    return SIGMA * np.random.default_rng(4).normal(size=SAMPLES)


def test_model_error_is_a_share_of_the_response(channel):
    change = np.zeros(SAMPLES)
    change[1000] = 500.0
    doubt = channel.with_model_error(change, np.zeros(SAMPLES), PERIOD).doubt
    assert doubt.max() == T.doubt * 500.0
    assert np.count_nonzero(doubt) == 11  # 10 ms before and after


def test_noise_alone_does_not_change_the_weights(channel):
    weights = channel.with_model_error(np.zeros(SAMPLES), noise(), PERIOD).weight
    assert np.mean(weights < 0.9 / SIGMA) < 0.02


def test_a_break_away_loses_its_weight_and_other_samples_keep_it(channel):
    left = noise()
    left[1500:1510] += 100.0
    doubted = channel.with_model_error(np.zeros(SAMPLES), left, PERIOD)
    mean_square = 10 * 100.0**2 / 51  # over 0.1 s
    known = SIGMA**2 + (mean_square - T.by_chance * SIGMA**2) * SAMPLES / T.shapes
    assert doubted.weight[1505] == pytest.approx(known**-0.5, rel=0.1)
    assert np.mean(doubted.weight[:1400] > 0.9 / SIGMA) > 0.98


def test_model_error_of_an_earlier_residual_is_discarded(channel):
    left = noise()
    left[1500:1510] += 100.0
    again = channel.with_model_error(np.zeros(SAMPLES), left, PERIOD).with_model_error(np.zeros(SAMPLES), noise(), PERIOD)
    assert again.weight[1505] > 0.5 / SIGMA
