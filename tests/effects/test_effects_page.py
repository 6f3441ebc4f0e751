"""docs/effects.md agrees with the library: effects, laws, bounds and pictures; the example runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import re
import subprocess
import sys

from tests.builders.script import script
from tests.conftest import ROOT
from twin.effects import EFFECTS as ALL_EFFECTS
from twin.effects import check_setting
from twin.effects.effect import Picture
from twin.effects.readable import setting_text
from twin.machine.machine import load_machine
from twin.simulation.effect_picture import draw_effect, traces_of

EFFECTS = {name: effect for name, effect in ALL_EFFECTS.items() if not effect.block_of_control}
"""Those of the blocks of a control are tested in test_control_blocks."""


def test_page_agrees_with_the_library():
    page = script("devtools/picture_effects.py", "picture_effects")
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.page(load_machine(), text) == text, "run python devtools/picture_effects.py --text"
    assert re.findall(r"^### (\w+)$", text, re.M) == [e.name for block in page.BLOCKS for e in EFFECTS.values() if e.block == block]


def test_each_effect_has_its_picture():
    pictures = {path.stem: path for path in (ROOT / "docs" / "pictures" / "effects").glob("*.png")}
    assert set(pictures) == set(EFFECTS), "run python devtools/picture_effects.py"
    assert all(path.stat().st_size < 80_000 for path in pictures.values())


def test_an_effect_without_its_own_picture_is_shown():
    """A new effect needs no picture settings: it is shown on an acceleration of its first axis."""
    plain = replace(EFFECTS["backlash"], picture=Picture())
    axis, without, having, _ = traces_of(plain, load_machine())
    assert axis.name == "X"
    assert (without.get("X", "motor_position") != having.get("X", "motor_position")).any()


def test_example(tmp_path: Path):
    """Simulated and closed form agree to 0.1 um, and the machine file that it writes has the effect."""
    command = [sys.executable, str(ROOT / "examples" / "effects.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env={"PYTHONPATH": str(ROOT), "PATH": ""}, capture_output=True, text=True, check=True)
    rows = re.findall(r"^ *([\d.-]+) +([\d.-]+)  ", done.stdout, re.M)
    assert len(rows) == 3
    assert all(abs(float(simulated) - float(closed)) < 0.1 for simulated, closed in rows)
    assert load_machine(tmp_path / "loose_x.toml").effects[0]["name"] == "backlash"


def test_an_effect_is_drawn_on_an_axis_that_takes_a_voltage_and_beside_a_slow_axis(tmp_path: Path):
    voltage = load_machine(ROOT / "examples" / "emps" / "axis.toml")
    assert draw_effect(EFFECTS["coulomb_friction"], voltage, tmp_path / "voltage.png").stat().st_size > 10_000
    slow = load_machine().with_values({"axis.Y.max_acceleration_m_per_s2": 0.3})
    axis, without, _, _ = traces_of(EFFECTS["cross_axis_coupling"], slow)
    assert len(without.time) > 1000
    assert axis.name == "X"


def test_an_infinite_stiffness_has_a_text():
    machine = load_machine()
    setting = check_setting({"name": "transmission_compliance", "axis": "X", "stiffness": float("inf")}, machine, "test")
    assert "inf" in setting_text(setting, machine)
