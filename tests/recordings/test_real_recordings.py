"""Public recordings that nobody here made, by one command each: map, import, card. What is known of each from its source must come out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import SHARED
from twin.cli import main
from twin.diagnose.first.axis_facts import AxisFacts
from twin.diagnose.first.card import Card, card_of
from twin.diagnose.first.raw import campaign_of
from twin.errors import InputError
from twin.machine.commented import guessed_values
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign

FOLDER = SHARED / "data" / "recordings"


def card(path: str, out: Path) -> Card:
    if not (FOLDER / path).is_file():
        pytest.skip("no recordings of real machines: ../shared/data/recordings is not beside this repository")
    return card_of(read_campaign(campaign_of([FOLDER / path], None, out, lambda _text: None)).runs)


def axis(found: Card, name: str = "X") -> AxisFacts:
    return next(one for one in found.facts if one.name == name)


def test_a_servo_axis_without_heading_and_time(tmp_path: Path) -> None:
    """Profile with a sine of speed: Fc = 0.030, B = 3.1e-4 s/rad in units of the command (truth.txt of the source)."""
    one = axis(card("lorenz_axis/Lorenz_Jm_1.txt", tmp_path))
    f = one.friction
    assert f is not None
    assert f.coulomb is not None
    assert f.viscous is not None
    assert f.coulomb.value == pytest.approx(0.030, rel=0.1)
    assert f.viscous.value == pytest.approx(3.1e-4, rel=0.15)
    assert f.inertia.value == pytest.approx(1.9e-4, rel=0.1)
    assert "velocity_setpoint" not in one.signals


def test_the_law_of_a_servo_axis_is_measured(tmp_path: Path) -> None:
    """A PD controller with the speed of the profile: 200 1/s and 0.01 in units of the command (truth.txt of the source)."""
    card("lorenz_axis/Lorenz_Jm_1.txt", tmp_path)
    assert main(["machine", "new", "--from-recording", str(tmp_path / "campaign"), "--out", str(tmp_path / "machine.toml")]) == 0
    machine = load_machine(tmp_path / "machine.toml")
    loops = machine.axis("X").loops
    assert loops.position_gain_per_s == pytest.approx(200.0, abs=0.01)
    assert loops.speed_gain_nm_s_per_rad == pytest.approx(0.01, rel=1e-4)
    assert "axis.X.loops.position_gain_per_s" not in guessed_values(machine)


def test_a_grinder_in_milliseconds_with_an_opposite_current(tmp_path: Path) -> None:
    found = card("ideko_grinder/electrical_20230911.csv", tmp_path)
    one = axis(found)
    f = one.friction
    assert one.period == pytest.approx(2e-3)
    assert one.lags[""].value == pytest.approx(0.184 / 16.75, rel=0.02)
    assert f is not None
    assert f.coulomb is None  # one speed: only the sum is known
    assert f.at_speed.value == pytest.approx(3.43, rel=0.05)
    assert one.transmission is not None
    assert one.transmission.high - one.transmission.low < 11e-6
    assert any(o.kind == "start" for o in found.odd)


def test_robots_of_six_joints(tmp_path: Path) -> None:
    for path, period in (("voraus_ad/test.parquet", 0.01), ("ur3e_rtde/L0L1.csv", 0.04)):
        found = card(path, tmp_path / path.split("/")[0])
        assert len(found.facts) == 6
        assert all(one.kind == "rotary" and one.period == pytest.approx(period, rel=0.02) for one in found.facts)
        assert any("no gains or delays of the loops" in s for s in found.cannot) or period < 0.02
        assert found.gains == {}


def test_a_drive_export_without_set_point(tmp_path: Path) -> None:
    one = axis(card("mitsubishi_mr/a3MR.csv", tmp_path))
    assert one.lags == {}
    assert one.friction is not None
    assert one.friction.inertia.known


def test_a_motor_in_saturation_and_a_mill_that_cuts(tmp_path: Path) -> None:
    assert axis(card("camber_lina/pp-square-wave-10mm-0.5Hz.txt", tmp_path / "a")).period == pytest.approx(0.01)
    mill = card("michigan_mill/experiment_01.csv", tmp_path / "b")
    assert all(one.period == pytest.approx(0.1) for one in mill.facts)
    assert any("no gains or delays of the loops" in s for s in mill.cannot)


@pytest.mark.parametrize(
    "path", ["linuxcnc_halscope/halscope_2.log", "twincat_scope/default.csv", "twincat_scope/decimal_comma.csv", "mitsubishi_mr/a3NI.csv"]
)
def test_what_holds_no_motion_of_an_axis_is_refused(path: str, tmp_path: Path) -> None:
    if not (FOLDER / path).is_file():
        pytest.skip("no recordings of real machines: ../shared/data/recordings is not beside this repository")
    with pytest.raises(InputError) as error:
        campaign_of([FOLDER / path], None, tmp_path, lambda _text: None)
    assert "\n" not in str(error.value)
    assert "axis" in str(error.value) or "position" in str(error.value)
