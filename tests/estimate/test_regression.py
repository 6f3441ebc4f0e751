"""Laws of the regression: exact values, intervals under correlation, instruments, columns that the data do not excite."""

from __future__ import annotations

import numpy as np
import pytest

from twin.estimate.regression import RELATED, _enough_clusters, regress, solved


def coloured(rng: np.random.Generator, n: int, memory: float) -> np.ndarray:
    noise = rng.standard_normal(n)
    for k in range(1, n):
        noise[k] += memory * noise[k - 1]
    return noise


def test_exact_data_give_exact_values() -> None:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((400, 3)) * [1.0, 1e-4, 1e5]
    values = np.array([2.0, -3e3, 4e-6])
    fit = regress(columns, columns @ values, np.arange(400) // 10)
    assert fit.values == pytest.approx(values, rel=1e-10)
    assert fit.condition < 2.0


def test_intervals_hold_the_truth_under_correlated_noise() -> None:
    """Noise correlated over 20 samples, 60 clusters of 50: the 95 % intervals contain the truth in at least 90 %, naive ones in at most 60 %."""
    rng = np.random.default_rng(1)
    held = naive = 0
    for _ in range(200):
        drive = np.repeat(rng.standard_normal(60), 50)  # constant in a stroke, like the sign of the speed
        y = 1.5 * drive + coloured(rng, 3000, 0.95)
        fit = regress(np.column_stack([drive, np.ones(3000)]), y, np.arange(3000) // 50)
        error = abs(fit.values[0] - 1.5)
        held += error < fit.quantile * fit.deviations[0]
        naive += error < 1.96 * fit.residual.std() / np.sqrt(np.sum(drive**2))
    assert held / 200 >= 0.9
    assert naive / 200 <= 0.6


def test_instruments_take_the_bias_of_noise_in_the_regressor() -> None:
    rng = np.random.default_rng(2)
    clean = rng.standard_normal(20_000)
    seen = clean + 0.7 * rng.standard_normal(20_000)
    y = 3.0 * clean
    groups = np.arange(20_000) // 100
    assert regress(seen[:, None], y, groups).values[0] < 2.2
    assert regress(seen[:, None], y, groups, clean[:, None]).values[0] == pytest.approx(3.0, rel=0.03)


def test_a_collinear_column_is_omitted_with_infinite_deviation() -> None:
    x = np.linspace(-1.0, 1.0, 100)
    fit = regress(np.column_stack([x, 2.0 * x, np.zeros(100)]), x, np.arange(100) // 10)
    assert fit.seen.tolist() == [True, False, False]
    assert fit.values[0] == pytest.approx(1.0)
    assert np.isinf(fit.deviations[1:]).all()


def test_the_allowance_for_related_strokes_widens(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.linspace(-1.0, 1.0, 100)
    y = x + np.random.default_rng(1).normal(size=100)
    allowed = regress(x[:, None], y, np.arange(100) // 10).deviations
    monkeypatch.setattr("twin.estimate.regression.RELATED", 1.0)
    plain = regress(x[:, None], y, np.arange(100) // 10).deviations
    assert allowed / plain == pytest.approx(RELATED)
    assert RELATED > 1.05


@pytest.mark.parametrize("strokes", [1, 2, 3])
def test_as_few_strokes_as_columns_are_not_exact(strokes: int) -> None:
    """The scores sum to zero, which made the interval 1e-13 of the value."""
    rng = np.random.default_rng(3)
    columns = np.column_stack([np.linspace(-1.0, 1.0, 60), np.ones(60), np.sin(np.arange(60.0))])
    fit = regress(columns, columns @ [2.0, 1.0, -1.0] + rng.normal(0.0, 0.1, 60), np.arange(60) * strokes // 60)
    assert (fit.deviations > 0.005).all()
    assert (np.abs(fit.values - [2.0, 1.0, -1.0]) < fit.quantile * fit.deviations).all()
    assert fit.clusters >= 5


def test_enough_strokes_stay_whole() -> None:
    strokes = np.repeat([3, 1, 2, 0, 4], 7)
    assert np.array_equal(_enough_clusters(strokes, 3), strokes)


def test_columns_that_are_barely_apart_are_uncertain() -> None:
    """Their products are a singular matrix; the sum of both coefficients is known, each alone is not."""
    t = np.linspace(0.0, 1.0, 400)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    fit = regress(np.column_stack([t, t + 2e-8 * np.sin(40.0 * t)]), 2.0 * t + noise, np.arange(len(t)) // 10)
    assert fit.values.sum() == pytest.approx(2.0, abs=0.01)
    assert fit.deviations.min() > 100.0


def test_a_column_of_zeros_has_no_coefficient() -> None:
    """Rounding over its length of zero would be a number without bounds, which predicts the other rows."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        columns = rng.standard_normal((50, 7)) * [1.0, 1e-5, 1e3, 0.0, 1.0, 1e-9, 0.0]
        columns[:, 4] = columns[:, 0] + 1e-3 * columns[:, 4]
        found = solved(columns, columns @ np.arange(1.0, 8.0))
        assert np.allclose(found, [1.0, 2.0, 3.0, 0.0, 5.0, 6.0, 0.0], rtol=0.01)
        assert found[3] == found[6] == 0.0
