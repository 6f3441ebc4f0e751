"""The test for a change: no more alarms than stated, whatever scale, constants and nuisances; onset, size and forecast of a change."""

from __future__ import annotations

import numpy as np
import pytest

from twin.history.change import evidence, forecast, level

RNG = np.random.default_rng


def series(count: int, columns: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Scatter without a change, and nuisances (a constant and a temperature)."""
    rng = RNG(seed)
    return rng.standard_normal((count, columns)), np.column_stack([np.ones(count), rng.standard_normal(count)])


def test_without_a_change_an_alarm_is_as_rare_as_stated() -> None:
    """R > A at most once in A recordings; with A = 100 in 40 recordings of 400 machines: fewer than 160 alarms."""
    y, nuisance = series(40, 400, 1)
    alarmed = np.zeros(400, bool)
    for now in range(4, 41):
        alarmed |= evidence(y[:now], nuisance[:now])[0] > 100.0
    assert 4 <= alarmed.sum() < 160


def test_scale_constants_and_nuisances_do_not_matter() -> None:
    y, nuisance = series(30, 5, 2)
    plain, moved = evidence(y, nuisance), evidence(7.0 * y + nuisance @ np.array([[3.0], [-40.0]]), nuisance)
    assert moved[0] == pytest.approx(plain[0], rel=1e-6)
    assert (moved[1] == plain[1]).all()


@pytest.mark.parametrize("growing", [False, True])
def test_a_change_is_found_with_onset_and_size(growing: bool) -> None:
    y, nuisance = series(40, 50, 3)
    since = np.maximum(np.arange(40) - 24, 0) / 6.0 if growing else (np.arange(40) >= 25) * 1.0
    y = y + 8.0 * np.minimum(since, 1.0)[:, None]
    total, onset = evidence(y, nuisance)
    assert (total > 1e4).all()
    assert np.quantile(np.abs(onset - 25), 0.9) <= (4 if growing else 1)
    sizes = [level(column, nuisance, 25) for column in y.T]
    inside = np.mean([abs(size.size - 8.0) < size.half() for size in sizes])
    assert 0.85 <= inside <= 1.0


def test_a_forecast_holds_the_day_and_needs_a_growth() -> None:
    rng, days = RNG(4), np.arange(12) * 7.0
    hits = 0
    for _ in range(100):
        ahead = forecast(days, 0.01 * days + 0.03 * rng.standard_normal(12), 1.0, 77.0)
        hits += ahead is not None and ahead.earliest <= 100.0 <= ahead.latest
    assert hits >= 88
    still = sum(forecast(days, 0.3 + 0.03 * rng.standard_normal(12), 1.0, 77.0) is not None for _ in range(100))
    assert still <= 10
