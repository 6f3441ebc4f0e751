"""Columns without the zeros at their ends: every product is that of the whole columns."""

import numpy as np
import pytest

from twin.diagnose import columns
from twin.diagnose.columns import Columns


@pytest.fixture
def dense(monkeypatch) -> np.ndarray:
    """Columns (row, n) over several blocks: whole, within a block, across a border of blocks, at an end, and zero."""
    monkeypatch.setattr(columns, "LONG", 40)
    out = np.random.default_rng(1).standard_normal((100, 5)).astype(np.float32).astype(float)
    for i, (first, end) in enumerate([(0, 100), (17, 30), (30, 90), (95, 100), (0, 0)]):
        out[:first, i] = out[end:, i] = 0.0
    return out


def test_a_product_is_that_of_the_whole_columns(dense):
    held, rows = Columns(dense.T, len(dense)), np.arange(100.0)
    assert [len(column.values) for column in held.each] == [100, 13, 60, 5, 0]
    np.testing.assert_array_equal(held.part(), dense)
    np.testing.assert_array_equal(held.part(slice(20, 35)), dense[20:35])
    np.testing.assert_allclose(held.times(np.arange(1.0, 6.0)), dense @ np.arange(1.0, 6.0), atol=1e-12)
    np.testing.assert_allclose(held.onto(rows), dense.T @ rows, atol=1e-10)
    np.testing.assert_allclose(held.gram(), dense.T @ dense, atol=1e-12)
    for few in ([1], [0, 2, 3, 4]):
        np.testing.assert_allclose(held.onto(held.chosen(few)), dense.T @ dense[:, few], atol=1e-12)
    np.testing.assert_allclose(held.scaled(rows).part(), dense * rows[:, None], rtol=1e-6)
    np.testing.assert_array_equal(held.at(np.array([3, 29, 96])).part(), dense[[3, 29, 96]])
