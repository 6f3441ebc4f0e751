"""A measured axis (EMPS benchmark), if its recording is available, and a simulation of it."""

from __future__ import annotations

import numpy as np
import pytest

from examples.emps.single_axis import Record, fit_single_axis, read_emps, refine_single_axis, residual_shapes, resimulate
from tests.conftest import SHARED
from twin.errors import InputError

PUBLISHED = {"mass": 95.11, "viscous": 203.5, "coulomb": 20.39}
LIMITS = {"mass": 0.005, "viscous": 0.02, "coulomb": 0.01}


@pytest.fixture(scope="module")
def record() -> Record:
    file = SHARED / "data" / "emps" / "DATA_EMPS.mat"
    if not file.is_file():
        pytest.skip("no measured axis: ../shared/data/emps is not beside this repository")
    return read_emps(file)


def test_regression_agrees_with_the_published_model(record: Record) -> None:
    fit = fit_single_axis(record)
    for value, (name, published) in zip(fit.values, PUBLISHED.items()):
        assert value == pytest.approx(published, rel=LIMITS[name]), name
    assert fit.force_error <= 0.042


def test_closed_loop_resimulation_follows_the_record(record: Record) -> None:
    again = resimulate(record, fit_single_axis(record).values)
    assert again.position_rms <= 2e-6
    assert again.force_error <= 0.046
    assert again.force_error_filtered <= 0.046


def test_shares_of_the_residual(record: Record) -> None:
    shares = residual_shapes(fit_single_axis(record), record.period)
    assert shares["viscous friction by direction"] > 0.3
    assert shares["lags outside the white band"] > 0.5


def test_a_simulated_axis_is_found_again() -> None:
    """Planted values come back by both routes, with noise of half a count."""
    t = np.arange(12_000) * 1e-3
    setpoint = 0.1 * np.sin(2 * np.pi * 0.35 * t) ** 3 + 0.03 * np.sin(2 * np.pi * 1.3 * t)
    true = np.array([95.0, 205.0, 20.0, -3.0])
    setpoint *= np.minimum(t / 0.5, 1.0) ** 2  # from rest, below the limit of the voltage
    empty = Record(t, setpoint, np.full_like(t, setpoint[0]), np.zeros_like(t), 160.0, 243.0, 35.0)
    made = resimulate(empty, true, initial_speed=0.0)
    rng = np.random.default_rng(0)
    seen = Record(t, setpoint, made.position + 2.5e-8 * rng.standard_normal(len(t)), made.voltage, 160.0, 243.0, 35.0)
    fit = fit_single_axis(seen)
    assert fit.values == pytest.approx(true, rel=0.02)
    assert refine_single_axis(seen, fit.values) == pytest.approx(true, rel=0.005)


def test_a_missing_record_is_an_error_with_a_remedy() -> None:
    with pytest.raises(InputError, match="no such file"):
        read_emps("nowhere.mat")
