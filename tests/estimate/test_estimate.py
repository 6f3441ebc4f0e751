"""Laws of the estimator on systems that it knows nothing of: parts, the most likely values, their scatter, bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from twin.estimate.held_out_gain import mean_log_rms, predicts_better
from twin.estimate.problem import Free, Linearised, Values, linearised
from twin.estimate.search import search


@dataclass
class Decays:
    """Two records of y = a exp(-b t), noise of another size in each. It counts its evaluations."""

    measured: Mapping[str, np.ndarray]
    free: Sequence[Free]
    calls: int = 0

    def residuals(self, many: Sequence[Values]) -> list[dict[str, dict[str, np.ndarray]] | None]:
        self.calls += len(many)
        return [self._one(x) for x in many]

    def _one(self, x: Values) -> dict[str, dict[str, np.ndarray]] | None:
        t = np.linspace(0.0, 2.0, 400)
        out = {}
        for part, y in self.measured.items():
            a, b = x[part, "a"], x[part, "b"]
            if b < -2.0:
                return None
            out[part] = {"y": y - a * np.exp(-b * t)}
        return out

    def clusters(self, part: str) -> dict[str, np.ndarray]:
        return {"y": np.arange(len(self.measured[part])) // 5}


def decays(seed: int, high: float = np.inf) -> Decays:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 2.0, 400)
    rates = {"one": 1.3, "two": 0.4}
    measured = {p: 2.0 * np.exp(-r * t) + s * rng.standard_normal(len(t)) for (p, r), s in zip(rates.items(), (0.01, 0.1))}
    free = [Free((p, "a"), 1.0, 1e-3, p) for p in measured]
    free += [Free((p, "b"), 0.0, 1e-3, p, high=high) for p in measured]
    return Decays(measured, free)


def test_the_intervals_contain_the_truth_as_often_as_they_say() -> None:
    held = []
    for seed in range(60):
        end = search(decays(seed))
        assert end is not None
        truth = {**{(p, "a"): 2.0 for p in ("one", "two")}, ("one", "b"): 1.3, ("two", "b"): 0.4}
        half = end.half_widths("one") | end.half_widths("two")
        held += [abs(value - truth[name]) < half[name] for name, value in end.values.items()]
    assert 0.90 < np.mean(held) < 0.995


def test_parts_are_evaluated_together_and_end_where_each_ends_alone() -> None:
    both = decays(1)
    end = search(both)
    assert end is not None
    for part in ("one", "two"):
        alone = Decays({part: both.measured[part]}, [f for f in both.free if f.part == part])
        own = search(alone)
        assert own is not None
        assert own.scores[part] == pytest.approx(end.scores[part], abs=1e-4)
        assert alone.calls > 0.4 * both.calls


def test_intervals_are_evaluated_once_and_only_where_they_are_asked_for() -> None:
    problem = decays(0)
    end = search(problem)
    assert end is not None
    before = problem.calls
    half = [end.half_widths(part) for part in ("one", "two", "one")]
    assert half[0] == half[2]
    assert problem.calls == before + 2  # a of both parts, b of both parts


def test_a_bound_holds_and_a_start_without_residuals_is_none() -> None:
    end = search(decays(2, high=1.0))
    assert end is not None
    assert end.values["one", "b"] == 1.0
    assert end.values["two", "b"] == pytest.approx(0.4, abs=0.1)
    assert search(decays(2), {**{(p, "a"): 1.0 for p in ("one", "two")}, ("one", "b"): -3.0, ("two", "b"): 0.0}) is None


def test_a_number_without_an_effect_has_no_interval() -> None:
    problem = decays(4)
    problem.free = [*problem.free, Free("idle", 0.5, 0.1, "one")]
    x = {f.name: f.start for f in problem.free}
    base = problem.residuals([x])[0]
    assert base is not None
    one = linearised(problem, x, base)["one"]
    change, covariance = one.solved()
    assert (change[-1], covariance[-1, -1]) == (0.0, np.inf)
    assert np.isfinite(covariance[:-1, :-1]).all()
    assert one.step(0.1, np.full(3, -1.0), np.full(3, 1.0))[-1] == 0.0


def test_an_interval_holds_if_few_of_many_clusters_determine_the_number() -> None:
    """Four short moves in a long record at rest: noise of a move is common to its rows. 1.96 standard deviations hold in 87 of 100 cases."""
    rng = np.random.default_rng(5)
    clusters = np.repeat(np.arange(40), 10)
    moves = (clusters % 10 == 0).astype(float)
    held, narrow = [], []
    for _ in range(600):
        noise = rng.standard_normal(40)[clusters] + 0.1 * rng.standard_normal(400)
        one = Linearised(noise, np.column_stack([moves, np.ones(400)]), clusters)
        change, covariance = one.solved()
        held.append(abs(change[0]) < one.half_widths()[0])
        narrow.append(abs(change[0]) < 1.96 * np.sqrt(covariance[0, 0]))
    assert np.mean(narrow) < 0.88
    assert np.mean(held) > 0.93


def test_evidence_is_a_log_density_per_row() -> None:
    rng = np.random.default_rng(0)
    signals = [0.1 * rng.standard_normal(300), 5.0 * rng.standard_normal(100)]
    assert mean_log_rms(signals) == pytest.approx(mean_log_rms([10.0 * s for s in signals]) - np.log(10.0))
    assert predicts_better([-5.3, -5.2], [-5.0, -5.0])
    assert not predicts_better([-5.9, -4.9], [-5.0, -5.0])
