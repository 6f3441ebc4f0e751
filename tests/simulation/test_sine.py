"""Sine and cosine of compiled terms compared with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from twin.compiled_functions import compiled
from twin.simulation.sine import LARGEST_QUARTERS, sine, sine_and_cosine


@compiled
def fill(angle, sines, cosines, alone):  # type: ignore[no-untyped-def]
    for i in range(len(angle)):
        sines[i], cosines[i] = sine_and_cosine(angle[i])
        alone[i] = sine(angle[i])


@pytest.mark.parametrize("span", [1e-3, 1.0, 100.0, 1e5, LARGEST_QUARTERS * 1.6])
def test_both_are_accurate_to_the_last_digit(span):
    """The largest span exceeds the range of the fast range reduction."""
    edges = np.arange(-50, 51) * np.pi / 4.0
    angle = np.concatenate([np.random.default_rng(0).uniform(-span, span, 20_000), edges, [0.0, -0.0]])
    sines, cosines, alone = np.empty_like(angle), np.empty_like(angle), np.empty_like(angle)
    fill(angle, sines, cosines, alone)
    assert np.abs(sines - np.sin(angle)).max() < 2.5e-16
    assert np.abs(cosines - np.cos(angle)).max() < 2.5e-16
    np.testing.assert_array_equal(alone, sines)


def test_nan_stays_nan():
    angle = np.array([np.nan, np.inf])
    sines = np.empty(2)
    fill(angle, sines, np.empty(2), np.empty(2))
    assert np.isnan(sines).all()
