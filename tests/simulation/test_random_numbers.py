"""Remembered random numbers are those that a fresh generator draws, whatever was remembered or forgotten."""

import numpy as np
import pytest

from twin.simulation import random_numbers
from twin.simulation.random_numbers import NormalNumbers


def drawn(seed: int | tuple[int, ...], stretches: tuple[int, ...]) -> np.ndarray:
    """Numbers of two rows, drawn in these stretches."""
    numbers = NormalNumbers(seed, (2,))
    return np.concatenate([numbers.draw(ticks) for ticks in stretches])


@pytest.mark.parametrize("memory_bytes", [0, 1000, 1_000_000])
def test_numbers_do_not_depend_on_what_is_remembered(memory_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(random_numbers, "MOST_BYTES", memory_bytes)
    random_numbers._drawn.clear()
    expected = np.random.default_rng(7).standard_normal((90, 2))
    for stretches in ((40, 50), (40, 50), (90,), (40, 20, 30), (10, 80)):
        np.testing.assert_array_equal(drawn(7, stretches), expected)
    assert not np.array_equal(drawn((7, 1), (90,)), expected)
    assert sum(numbers.nbytes for numbers, _ in random_numbers._drawn.values()) <= memory_bytes


def test_equal_stretches_are_drawn_once() -> None:
    first, again = NormalNumbers(8, (3,)), NormalNumbers(8, (3,))
    assert first.draw(20) is again.draw(20)
    assert first.draw(20) is again.draw(20)
