"""The judgement of a history, on projections that are made without a simulation: any J and G = J'J obey its laws."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
import functools

import numpy as np

from twin import load_machine
from twin.history.columns import Direction, directions_of
from twin.history.judge import Judgement, Limit, judge_recording
from twin.history.projection import Projection
from twin.history.series import LOAD, SCATTER
from twin.history.store import Row

GROUPS = (("X",), ("Y",), ("Z",))
WEEKS = 30

Theta = Callable[[Direction, int, np.random.Generator], float]


@functools.cache
def directions() -> dict[tuple[str, ...], list[Direction]]:
    machine = load_machine()
    return {axes: [d for d in directions_of(machine, axes) if not d.wave] for axes in GROUPS}


def history(seed: int, theta: Theta, programs: int = 1) -> list[Row]:
    """Weekly recordings in which each direction differs by `theta`, next to what the twin lacks and noise."""
    rng, rows = np.random.default_rng(seed), []
    jacobian = {(axes, p): 60.0 * rng.standard_normal((200, len(d))) for axes, d in directions().items() for p in range(programs)}
    for (axes, _), j in jacobian.items():  # a torque constant is friction and inertia together
        names = [d.cause[0] for d in directions()[axes]]
        parts = [names.index(name) for name in ("inertia", "coulomb_friction", "viscous_friction")]
        j[:, names.index("torque_constant")] = 0.5 * j[:, parts].sum(axis=1) + 0.05 * j[:, names.index("torque_constant")]
    lacks = {key: 3.0 * rng.standard_normal(200) * 60.0 for key in jacobian}
    for week in range(WEEKS):
        projections, p = {}, week % programs
        for axes, own in directions().items():
            j = jacobian[axes, p]
            r = lacks[axes, p] + j @ np.array([theta(d, week, rng) for d in own]) + rng.standard_normal(200)
            projections[axes] = Projection(j.T @ j, j.T @ r)
        rows.append(Row(str(week), str(week), datetime(2026, 1, 5) + timedelta(weeks=week), (1.0 + p, 2.0), (), projections))
    return rows


def everyday(d: Direction, week: int, rng: np.random.Generator) -> float:
    """A season on the friction of all axes, tools of different mass, and scatter."""
    season = 0.5 * np.sin(2.0 * np.pi * week / 52.0) * (0.8 + 0.1 * "XYZ".index(d.setting.axis))
    name = d.setting.effect.name
    load = 0.7 * (week // 5 % 3) if SCATTER.get(name) == LOAD else 0.0
    return load + (season if "friction" in name and name in SCATTER else 0.0) + 0.01 * float(rng.standard_normal())


def judge(rows: list[Row]) -> Judgement:
    return judge_recording(rows, directions())


def test_seasons_tools_and_programs_raise_no_alarm() -> None:
    for seed in range(8):
        found = judge(history(seed, everyday, programs=1 + seed % 2))
        assert not found.changes, [c.cause for c in found.changes]


def test_a_fault_is_named_sized_and_dated_next_to_them() -> None:
    for seed, (effect, axis, size) in enumerate([("backlash", "X", 0.4), ("coulomb_friction", "Y", -0.5), ("position_gain", "Z", 0.3)]):

        def faulty(d: Direction, week: int, rng: np.random.Generator, at: tuple[str, str] = (effect, axis), size: float = size) -> float:
            return everyday(d, week, rng) + (size if d.cause[:2] == at and week >= 18 else 0.0)

        (change,) = judge(history(seed, faulty)).changes
        assert change.cause[:2] == (effect, axis)
        assert abs(change.onset - 18) <= 1
        assert change.alarm_row <= 21
        assert abs(change.size.size - size) < 0.15 * abs(size)


def test_a_load_that_never_changed_tells_a_torque_constant_from_friction() -> None:
    """The first recordings show that X always carries the same: a torque constant that moves inertia and friction is sized, a first new load is none."""

    def light(d: Direction, week: int, rng: np.random.Generator, cause: str) -> float:
        new = 0.4 if d.cause[:2] == (cause, "X") and week >= 18 else 0.0
        return new + 0.01 * float(rng.standard_normal())

    rows = history(3, functools.partial(light, cause="torque_constant"))
    assert max(float(np.max(s.scatter)) for s in judge(rows).series) == 0.2  # that of friction
    assert max(float(np.max(s.scatter)) for s in judge(history(0, everyday)).series) == 1.0
    (change,) = judge(rows).changes
    assert change.cause[:2] == ("torque_constant", "X")
    assert abs(change.size.size - 0.4) < 0.02
    assert not judge(history(4, functools.partial(light, cause="inertia"))).changes


def test_a_growing_fault_is_one_change_with_a_forecast() -> None:
    def growing(d: Direction, week: int, rng: np.random.Generator) -> float:
        return everyday(d, week, rng) + (0.04 * max(week - 17, 0) if d.cause[:2] == ("backlash", "X") else 0.0)

    (change,) = judge(history(5, growing)).changes
    assert change.cause[:2] == ("backlash", "X")
    ahead = change.forecast
    assert ahead is not None
    assert ahead.earliest <= (17 + 25) * 7.0 <= ahead.latest
    (change,) = judge_recording(history(5, growing), directions(), lambda _direction, _size: Limit(2.0, "twice")).changes
    assert change.forecast is not None
    assert change.forecast.earliest <= (17 + 50) * 7.0 <= change.forecast.latest


def test_a_judgement_follows_from_the_rows_alone() -> None:
    """A recording that comes later does not change what was said before; the order of arrival does not matter."""
    rows = history(6, everyday)
    whole = judge(rows)
    assert np.allclose(judge(rows[:20]).evidence, whole.evidence[:20], rtol=1e-6)
