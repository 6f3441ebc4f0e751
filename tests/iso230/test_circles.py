"""ISO 230-4 compared with closed forms: known ovals, eccentricity, steps and spikes."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.conftest import ROOT
from tests.iso230.part_programs import PROGRAMS, ConeFrustum, SShape
from twin.cli import main
from twin.effects import with_effects
from twin.errors import InputError
from twin.iso230.circles import CirclePath, CircleTest, circle_budget, circle_numbers, least_squares_circle, reversal_spikes
from twin.iso230.readings import circles_of_trace
from twin.machine.machine import Machine
from twin.program import interpolate, read_program
from twin.recordings.trace import Trace, write_trace

EXAMPLES = ROOT / "examples" / "iso230"
R = 0.05


def test_of(ccw, cw) -> CircleTest:  # type: ignore[no-untyped-def]
    """A test whose deviations [m] are functions of the angle."""
    angle = np.linspace(0.0, 2.0 * math.pi, 7201)
    return CircleTest(("X", "Y"), R, 0.05, {"ccw": CirclePath(angle, R + ccw(angle)), "cw": CirclePath(-angle, R + cw(-angle))})


test_of.__test__ = False  # type: ignore[attr-defined]


def test_ovals_of_both_directions() -> None:
    """An oval of +-4 um fixed in space, one of +-3 um that changes sign with the direction, and a radius error of 5 um."""
    numbers = circle_numbers(test_of(
        lambda a: 5e-6 + 4e-6 * np.cos(2 * a) + 3e-6 * np.sin(2 * a), lambda a: 5e-6 + 4e-6 * np.cos(2 * a) - 3e-6 * np.sin(2 * a)
    ))  # fmt: skip
    assert numbers["G_ccw"] == pytest.approx(10e-6, abs=2e-9)
    assert numbers["G_cw"] == pytest.approx(10e-6, abs=2e-9)
    assert numbers["G_b"] == pytest.approx(10e-6, abs=2e-9)
    assert numbers["F_max"] == pytest.approx(10e-6, abs=2e-9)
    assert numbers["F_min"] == pytest.approx(0.0, abs=2e-9)
    assert numbers["H"] == pytest.approx(6e-6, abs=2e-9)
    assert numbers["D"] == pytest.approx(5e-6, abs=2e-9)


def test_eccentricity_is_not_part_of_g() -> None:
    """An eccentricity of 7 um is part of F, not of G; centring removes it from F as well."""
    test = test_of(lambda a: 7e-6 * np.cos(a), lambda a: 7e-6 * np.cos(a))
    numbers = circle_numbers(test)
    assert numbers["G_b"] < 3e-9
    assert numbers["F_max"] == pytest.approx(7e-6, abs=2e-9)
    assert numbers["centre_1"] == pytest.approx(7e-6, abs=2e-9)
    assert circle_numbers(test.centred())["F_max"] < 3e-9


def test_reversal_spikes() -> None:
    """A spike of 6 um just after 90 degrees in one direction, and of -2 um at 0 in the other."""
    width = math.radians(1.5)
    test = test_of(
        lambda a: 6e-6 * np.exp(-(((a - math.pi / 2 - 0.02) / width) ** 2)),
        lambda a: -2e-6 * np.exp(-((np.mod(a + math.pi, 2 * math.pi) - math.pi) ** 2 / width**2)),
    )
    spikes = reversal_spikes(test)
    assert spikes["ccw"][90] == pytest.approx(6e-6, rel=1e-2)
    assert spikes["cw"][0] == pytest.approx(-2e-6, rel=1e-2)
    assert abs(spikes["ccw"][180]) < 1e-9


def test_least_squares_circle_is_exact_on_a_circle() -> None:
    angle = np.linspace(0.3, 4.0, 50)
    points = np.array([0.2, -0.1]) + 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    centre, radius = least_squares_circle(points)
    np.testing.assert_allclose([*centre, radius], [0.2, -0.1, 0.03], atol=1e-12)


def run(turns: float = 2.0, step: float = 4e-6) -> Trace:
    """Lead-in, ccw and cw circles of 30 mm about (-30, 0) mm; the scale of X reads `step` more when X moves up."""
    angle = np.linspace(0.0, turns * 2.0 * math.pi, int(4000 * turns) + 1)
    lead = np.column_stack([np.linspace(5e-3, 0.0, 300), np.zeros(300)])
    circle = np.column_stack([-0.03 + 0.03 * np.cos(angle), 0.03 * np.sin(angle)])
    s = np.vstack([np.repeat(lead[:1], 50, axis=0), lead, circle, np.repeat(circle[-1:], 200, axis=0), circle[::-1]])
    x = s.copy()
    x[:, 0] += step / 2.0 * np.sign(np.gradient(s[:, 0]))
    signals = {("X", "setpoint"): s[:, 0], ("Y", "setpoint"): s[:, 1], ("X", "position"): x[:, 0], ("Y", "position"): x[:, 1]}
    return Trace(np.arange(len(s)) * 1e-3, signals, {"X": "linear", "Y": "linear"})


@pytest.mark.parametrize("turns", [1.0, 1.5, 2.0])
def test_circles_are_found_in_a_run(turns: float) -> None:
    """Lost motion of 4 um along X: the paths are 4 um apart where the radius is parallel to X, 4 cos(45) um at 45 degrees."""
    (test,) = circles_of_trace(run(turns))
    assert test.axes == ("X", "Y")
    assert test.radius == pytest.approx(0.03, rel=1e-6)
    assert set(test.paths) == {"ccw", "cw"}
    numbers = circle_numbers(test)
    assert numbers["F_max"] == pytest.approx(2e-6, abs=2e-8)
    assert numbers["F_min"] == pytest.approx(-2e-6, abs=2e-8)
    assert numbers["H"] == pytest.approx(4e-6, rel=2e-2)


@pytest.mark.parametrize("simulated", [True, False])
def test_a_simulated_circle_is_not_called_measured(simulated: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = run(1.0)
    signals = {**trace.signals, ("X", "load_position"): trace.get("X", "position")} if simulated else trace.signals
    write_trace(Trace(trace.time, signals, trace.kinds), tmp_path / "circle.parquet")
    assert main(["iso", "230-4", str(tmp_path / "circle.parquet"), "--no-predict", "--json", str(tmp_path / "c.json")]) == 0
    out = capsys.readouterr().out
    assert (" simulated " in out, " measured " in out) == (simulated, not simulated)
    assert json.loads((tmp_path / "c.json").read_text())["H"] == pytest.approx(4.0, rel=2e-2)  # the numbers stand in one place


def test_a_run_without_circle_is_refused() -> None:
    trace = run()
    straight = {key: np.linspace(0.0, 0.1, len(trace.time)) for key in trace.signals}
    with pytest.raises(InputError, match="no two linear axes run a full circle"):
        circles_of_trace(Trace(trace.time, straight, trace.kinds))


def test_each_effect_has_its_share_of_the_circle(mikron: Machine) -> None:
    """Two effects that add 4 um cos 2a and 3 um, and 1 um sin 3a that no effect explains."""
    sizes = {"position_gain": lambda a: 4e-6 * np.cos(2 * a), "backlash": lambda a: 3e-6 + 0 * a}
    tables = [{"name": "backlash", "axis": "X", "clearance": 1e-5}, {"name": "position_gain", "axis": "Y", "factor": 0.9}]

    def run(machine: Machine) -> CircleTest:
        names = [table["name"] for table in machine.document.get("effect", [])]
        return test_of(*[lambda a: sum((sizes[n](a) for n in names), 0 * a)] * 2)

    measured = test_of(*[lambda a: sizes["position_gain"](a) + sizes["backlash"](a) + 1e-6 * np.sin(3 * a)] * 2)
    diagnosis = {"effects": [{"effect": "position_gain", "axis": "Y", "probability": 0.98}]}
    corrected, rows = circle_budget(with_effects(mikron, tables), diagnosis, measured, run)
    assert circle_numbers(corrected)["G_ccw"] == pytest.approx(8e-6, abs=1e-8)
    assert [(row["effect"], row["axis"], row["probability"]) for row in rows] == [
        ("backlash", "X", None),
        ("position_gain", "Y", 0.98),
        ("unknown", "", None),
    ]
    assert [row["rms_um"] for row in rows] == pytest.approx([3.0, 4.0 / math.sqrt(2.0), 1.0 / math.sqrt(2.0)], rel=1e-3)
    assert rows[1]["adds_um"]["G_ccw"] == pytest.approx(8.0, abs=1e-2)
    assert rows[0]["adds_um"]["F_max"] == pytest.approx(3.0, abs=1e-2)


def test_ballbar(tmp_path: Path) -> None:
    """The example: radius error 5 um, oval 4 um, 1.5 um that changes with the direction; the eccentricity is removed."""
    bar = [str(EXAMPLES / "ballbar.csv"), "--radius-mm", "100", "--feed-mm-per-min", "1500"]
    assert main(["iso", "230-4", *bar, "--json", str(tmp_path / "c.json")]) == 0
    found = json.loads((tmp_path / "c.json").read_text())
    jsonschema.validate(found, json.loads((ROOT / "twin" / "report" / "schemas" / "iso230.json").read_text()))
    assert found["G_ccw"] == pytest.approx(2 * math.hypot(4.0, 1.5), abs=0.03)  # 0 and 360 degrees: one point twice
    assert all(abs(height) < 0.05 for by_angle in found["reversal_spikes"].values() for height in by_angle.values())  # an oval has none
    assert found["H"] == pytest.approx(3.0, abs=0.01)
    assert found["F_max"] == pytest.approx(5.0 + math.hypot(4.0, 1.5), abs=0.03)


@pytest.mark.parametrize("name", list(PROGRAMS))
def test_example_programs(name: str, mikron: Machine) -> None:
    """The files equal the closed forms, and the machine can run them."""
    assert (EXAMPLES / f"{name}.mpf").read_text(encoding="utf-8") == PROGRAMS[name].program()
    setpoints = interpolate(read_program(EXAMPLES / f"{name}.mpf", mikron), mikron)
    if name == "circle_xy":
        ideal = {(axis, signal): setpoints.get(axis, "setpoint") for axis in setpoints.axes for signal in ("setpoint", "position")}
        (test,) = circles_of_trace(replace(setpoints, signals=ideal))
        assert test.radius == pytest.approx(0.05, abs=1e-6)
        assert circle_numbers(test)["G_b"] < 1e-5  # the rounding of the interpolator


@pytest.mark.parametrize("part", [ConeFrustum(), SShape()])
def test_the_flank_touches_the_ruling(part: ConeFrustum | SShape) -> None:
    """The tool's centre line is parallel to the ruling at a distance of one tool radius; on a cone it is that far from the whole surface."""
    for share, (tip, axis) in zip(np.linspace(0.0, 1.0, part.steps + 1), part.poses()):
        point, ruling, normal = part.ruling(share)
        assert np.linalg.norm(np.cross(point - tip, axis)) == pytest.approx(part.tool_radius, abs=1e-9)
        assert abs(ruling @ normal) < 1e-12
        assert abs(np.linalg.norm(axis) - 1.0) < 1e-12
    if isinstance(part, ConeFrustum):
        tip, axis = next(iter(part.poses()))
        surface = np.array([p + h * g for p, g, _ in map(part.ruling, np.linspace(0, 1, 2001)) for h in (0.0, 10.0, 20.0)])
        assert np.linalg.norm(np.cross(surface - tip, axis), axis=1).min() == pytest.approx(part.tool_radius, abs=1e-6)


def test_a_table_has_a_plane_of_two_axes_and_no_set_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["iso", "230-4", str(EXAMPLES / "ballbar.csv"), "--radius-mm", "100"]
    assert main([*given, "--plane", "XX"]) == 2
    assert "give --radius-mm and --plane" in capsys.readouterr().err
    assert main([*given, "--plane", "XY", "--diagnosis", str(tmp_path)]) == 2
    assert "--diagnosis needs the trace" in capsys.readouterr().err
