"""Sine and cosine of the compiled terms against those of numpy."""

import numpy as np
import pytest

from twin.compiled_functions import compiled
from twin.simulation.waves import sine, sine_and_cosine


@compiled
def _fill(angles, values):  # type: ignore[no-untyped-def]
    for i in range(len(angles)):
        values[i, 0], values[i, 1] = sine_and_cosine(angles[i])
        values[i, 2] = sine(angles[i])


@pytest.mark.parametrize("largest", [1e-3, 1.0, 1e3, 1e6])
def test_sine_and_cosine_are_those_of_numpy(largest: float) -> None:
    """Random angles, both signs, and multiples of 45 degrees, where the polynomials are exchanged."""
    corners = np.arange(-9, 10) * np.pi / 4.0
    angles = np.concatenate([corners, np.nextafter(corners, 10.0), np.random.default_rng(5).uniform(-largest, largest, 20_000)])
    values = np.empty((len(angles), 3))
    _fill(angles, values)
    np.testing.assert_allclose(values, np.stack([np.sin(angles), np.cos(angles), np.sin(angles)], axis=1), rtol=0.0, atol=1e-15)


def test_a_number_that_is_none_stays_none() -> None:
    """A diverging run is found by its speeds, which are then not numbers."""
    values = np.empty((1, 3))
    _fill(np.array([np.nan]), values)
    assert np.isnan(values).all()
