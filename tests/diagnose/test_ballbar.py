"""Circles measured by a ballbar (radius only): both axes are searched together, on circles of the second plant."""

from __future__ import annotations

from collections.abc import Sequence
import importlib.util
import math
from pathlib import Path
import tomllib

import numpy as np
import pytest

from tests.conftest import ROOT
from twin.cli import main
from twin.diagnose import Diagnosis, diagnose
from twin.errors import InputError
from twin.exam.draw import SHIPPED_MACHINE, Case, simulate
from twin.exam.paths import limits_of
from twin.exam.plant.parameters import Richness, draw_factors, unit_factors
from twin.exam.programme import TestRun, _circle
from twin.machine.machine import Machine
from twin.recordings.ballbar import GEOMETRY, OVERLAP, Ballbar
from twin.recordings.campaign import read_campaign
from twin.recordings.trace import Trace

RADIUS, FEED = 0.05, 0.1


def circle_of(samples: int = 4000) -> np.ndarray:
    """Set points (sample, 2): counter-clockwise, at rest, clockwise; each one turn plus OVERLAP at both ends."""
    there = np.linspace(-OVERLAP, 2.0 * math.pi + OVERLAP, samples)
    angle = np.concatenate([there, np.full(100, there[-1]), there[::-1]])
    return RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])


def bar_on(commanded: np.ndarray) -> Ballbar:
    return Ballbar(("X", "Y"), np.arange(len(commanded)) * 1e-3, commanded, 1e-7)


def at(positions: np.ndarray) -> Trace:
    signals = {(axis, "position"): positions[:, k] for k, axis in enumerate("XY")}
    return Trace(np.arange(len(positions)) * 1e-3, signals, {"X": "linear", "Y": "linear"})


def seen(bar: Ballbar, positions: np.ndarray) -> np.ndarray:
    """Positions of both axes from the bar (sample, 2), minus the set points."""
    found = bar.positions(bar.deviation(at(positions)))
    return np.column_stack([found[axis, "position"] for axis in bar.axes]) - bar.commanded


def test_geometry_leaves_no_residual() -> None:
    """Centre, scale errors and squareness leave no residual and are estimated with their values."""
    commanded = circle_of()
    bar = bar_on(commanded)
    x, y = commanded.T
    built_in = dict(zip(GEOMETRY, (3e-6, -2e-6, 40e-6, -25e-6, 20e-6)))
    positions = np.column_stack([x * (1 + 40e-6) + 20e-6 * y + 3e-6, y * (1 - 25e-6) - 2e-6])
    assert np.abs(seen(bar, positions)).max() < 2e-9
    sizes = bar.sizes(bar.deviation(at(positions))) / np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])
    np.testing.assert_allclose(sizes, list(built_in.values()), atol=1e-8)


def test_a_common_lag_leaves_no_residual() -> None:
    """A lag of 10 ms on both axes leaves no residual; a radial wave keeps its angle under the lag."""
    commanded = circle_of()
    bar = bar_on(commanded)
    late = np.vstack([np.repeat(commanded[:1], 10, axis=0), commanded[:-10]])
    assert np.abs(seen(bar, late)).max() < 2e-9
    angle = np.arctan2(*late.T[::-1])
    waving = late * (1.0 + 5e-6 / RADIUS * np.cos(4.0 * angle))[:, None]
    expected = 5e-6 * np.cos(4.0 * bar.angle)[:, None] * bar.radial
    np.testing.assert_allclose(seen(bar, waving)[bar.measured], expected[bar.measured], atol=2e-8)
    assert not seen(bar, waving)[~bar.measured].any()


@pytest.fixture(scope="module")
def worn() -> object:
    """The example that measures a run of the second plant with a ballbar."""
    spec = importlib.util.spec_from_file_location("worn_machine", ROOT / "examples" / "iso230" / "worn_machine.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def diagnosis_of(
    effects: Sequence[dict],
    worn: object,
    machine: Machine,
    folder: Path,
    seed: int | None = None,
    radius: float = RADIUS,
    feed: float = FEED,
    feedforward: str = "off",
) -> Diagnosis:
    """The second plant with these effects runs the circle, a ballbar measures it, the campaign is diagnosed.

    With a seed the machine has random parameters within the tolerance and all normal imperfections, with drive trains from 150 Hz.
    """
    document = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    factors = unit_factors() if seed is None else draw_factors(np.random.default_rng(seed), machine.parameter_tolerance)
    richness = Richness.off() if seed is None else Richness()
    case = Case(seed or 1, "ballbar", 1.0, tuple(effects), factors, richness)
    there = _circle(0, 1, radius, feed, 2, limits_of(document))
    run = TestRun("circle", "test", feedforward, np.vstack([there, there * np.array([1.0, -1.0, 1.0, 1.0, 1.0])]))
    worn.RADIUS, worn.FEED = radius, feed  # type: ignore[attr-defined]
    worn.write_ballbar(simulate(case, document, run), folder / "ballbar.csv")  # type: ignore[attr-defined]
    program = ["--radius-mm", str(radius * 1e3), "--feed-mm-per-min", str(feed * 60e3), "--feedforward", feedforward]
    bar = [*program, "--campaign", str(folder / "bar")]
    assert main(["iso", "230-4", str(folder / "ballbar.csv"), "--plot", str(folder / "bar.png"), *bar]) == 0
    return diagnose(read_campaign(folder / "bar", machine), machine)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "axis", "size", "value"),
    [
        ("coulomb_friction", "X", "factor", 1.6),
        ("position_gain", "X", "factor", 0.94),
    ],
)
def test_one_fault_is_named_from_a_circle(
    effect: str, axis: str, size: str, value: float, worn: object, mikron: Machine, tmp_path: Path
) -> None:
    """One fault on a machine with 20 um/m squareness error and the bar off centre is the only effect named, with its size."""
    found = diagnosis_of([{"name": effect, "axis": axis, size: value}], worn, mikron, tmp_path)
    assert found.verdict == "effect"
    assert [(s.effect.name, s.axis) for s, _, _ in found.named] == [(effect, axis)]
    (setting, _, probability) = found.named[0]
    assert setting.parameters[size] == pytest.approx(value, rel=0.05)
    assert probability == pytest.approx(0.9, abs=0.01)  # a single run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "radius", "feed", "feedforward"),
    [(3, RADIUS, FEED, "off"), (9, 0.1, 0.05, "velocity")],
)
def test_a_healthy_circle_has_no_effects(
    seed: int, radius: float, feed: float, feedforward: str, worn: object, mikron: Machine, tmp_path: Path
) -> None:
    """Seed 3 has a drive train of 167 Hz, softer than normal for complete records. With seed 9 the normal imperfections are visible at the
    reversals only, while the circle as a whole looks like noise.
    """
    found = diagnosis_of([], worn, mikron, tmp_path, seed, radius, feed, feedforward)
    assert (found.verdict, found.named) == ("none", [])


@pytest.mark.slow
def test_backlash_is_named_on_an_imperfect_machine(worn: object, mikron: Machine, tmp_path: Path) -> None:
    """Backlash among all normal imperfections, with drive trains of 174 and 177 Hz: nothing else is named."""
    found = diagnosis_of([{"name": "backlash", "axis": "X", "clearance": 12e-6}], worn, mikron, tmp_path, seed=2)
    assert found.verdict == "effect"
    assert [(s.effect.name, s.axis) for s, _, _ in found.named] == [("backlash", "X")]
    (setting, _, probability) = found.named[0]
    assert setting.parameters["clearance"] == pytest.approx(12e-6, rel=0.05)
    assert probability == pytest.approx(0.9, abs=0.01)


def test_each_reading_counts_once() -> None:
    """Each reading counts for the axis closer to the direction of the bar; its value there is the radial deviation without geometry."""
    bar = bar_on(circle_of())
    rows = {axis: bar.readings_of(axis) for axis in bar.axes}
    assert np.array_equal(rows["X"] ^ rows["Y"], bar.measured)
    deviation = 5e-6 * np.cos(4.0 * bar.angle)
    trace = Trace(bar.time, bar.positions(deviation), {"X": "linear", "Y": "linear"})
    for axis in bar.axes:
        np.testing.assert_allclose(bar.seen(trace, axis), deviation[rows[axis]], atol=2e-8)


def test_a_bar_needs_a_circle() -> None:
    """A straight line has no readings; two turns with their overlaps have readings for two thirds."""
    straight = np.column_stack([np.linspace(0.0, 0.1, 500), np.zeros(500)])
    assert not bar_on(straight).measured.any()
    assert bar_on(circle_of()).measured.mean() == pytest.approx(2.0 / 3.0, abs=0.02)


def test_identification_refuses_a_ballbar_run(tmp_path: Path, mikron: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    """Positions from a ballbar contain no lag, so `identify` refuses them; a wrong table is refused too."""
    bar = ["--radius-mm", "100", "--feed-mm-per-min", "1500", "--campaign", str(tmp_path / "bar")]
    assert main(["iso", "230-4", str(ROOT / "examples/iso230/ballbar.csv"), "--plot", str(tmp_path / "bar.png"), *bar]) == 0
    capsys.readouterr()
    assert main(["identify", str(tmp_path / "bar"), "--out", str(tmp_path / "machine.toml")]) == 2
    assert "a ballbar measures the radius only" in capsys.readouterr().err
    file = tmp_path / "bar" / "campaign.toml"
    for wrong, says in (('axes = ["X"]', "name two axes of the trace"), ('axes = ["X", "Z"]', "name two axes of the trace")):
        file.write_text(file.read_text().replace('axes = ["X", "Y"]', wrong), encoding="utf-8")
        with pytest.raises(InputError, match=says):
            read_campaign(tmp_path / "bar", mikron)
        file.write_text(file.read_text().replace(wrong, 'axes = ["X", "Y"]'), encoding="utf-8")
