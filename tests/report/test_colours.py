"""Colours that are seen together can be separated, by colour-blind eyes too; the scale of the contour error gets darker throughout."""

import numpy as np
import pytest

from devtools.colour_distances import SIGHTS, band_steps, closest, groups, oklab

SEEN_APART = 7.0
"""OKLab times 100; a difference of 2 is just seen side by side, thin lines need more."""


@pytest.mark.parametrize("sight", SIGHTS)
def test_colours_of_a_plot_can_be_separated(sight: str) -> None:
    for name, colours in groups().items():
        distance, a, b = closest(colours, sight)
        assert distance > SEEN_APART, f"{name}: {a} and {b}"


@pytest.mark.parametrize("sight", SIGHTS)
def test_the_scale_of_the_contour_error_is_monotone(sight: str) -> None:
    assert np.all(band_steps(sight) < -4.0)


def test_the_distance_is_that_of_oklab() -> None:
    black, white = oklab(np.array([[0, 0, 0], [255, 255, 255]]))
    assert np.linalg.norm(white - black) == pytest.approx(100.0, abs=0.1)
    # red and green of equal lightness, as they were once: a deuteranope hardly sees them apart
    assert closest({"red": (150, 110, 40), "green": (110, 125, 40)}, "deuteranopia")[0] < SEEN_APART
