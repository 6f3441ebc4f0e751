"""Tuning: as fast as the margins allow and no faster, delays that fit the loop, a machine file that holds the result."""

from __future__ import annotations

import math
from pathlib import Path
import re

import pytest

import twin
from twin.cli import main
from twin.effects import load_inertia
from twin.machine.check import Asked, asked_of, check_axis
from twin.machine.machine import Machine
from twin.remedy.predict import standard_motions
from twin.remedy.tune import Tuned, mode_needed, tune


def with_spring(machine: Machine, hz: float) -> Machine:
    return twin.add_effects(
        machine,
        *(f"transmission_compliance:{a.name}:stiffness={(2 * math.pi * hz) ** 2 * load_inertia(machine, a)}" for a in machine.axes),
    )


def tuned(machine: Machine, asked: Asked) -> tuple[Tuned, Tuned, Tuned]:
    return tune(machine, standard_motions(machine)[0], asked)


@pytest.mark.parametrize(("spring", "phase", "gain_db"), [(None, None, 6.0), (None, 60.0, 9.0), (60.0, 55.0, 6.0)])
def test_the_margins_are_kept_and_used(mikron: Machine, spring: float | None, phase: float | None, gain_db: float) -> None:
    machine = mikron.with_axes(["X", "Y"])
    machine = machine if spring is None else with_spring(machine, spring)
    asked = asked_of(phase, gain_db)
    _, textbook, after = tuned(machine, asked)
    slack = []
    for axis in after.machine.axes:
        speed, position = check_axis(after.machine, axis).margins[-2:]
        for name, m in (("speed", speed), ("position", position)):
            assert m.stable
            assert m.phase >= asked.phase[name] - 0.1
            assert m.gain >= 0.999 * asked.gain
        assert position.peak <= 1.3
        # a spring less stiff than what the gains are said to need takes more than half of a margin
        assert not asked.missed_by(after.machine, axis.name)
        faster = after.machine.with_values({f"axis.{axis.name}.loops.position_gain_per_s": 1.05 * axis.loops.position_gain_per_s})
        slack.append(not asked.missed_by(faster, axis.name))
    assert not all(slack)  # 5 % more position gain breaks a margin of an axis
    assert len({a.loops.position_gain_per_s for a in after.machine.axes}) == 1
    if spring is None:
        assert textbook.margins["X"][0].phase == pytest.approx(math.degrees(math.atan(0.75)), abs=5.0)  # atan((a2 - 1) / 2 a) with a = 2


def test_delays_follow_the_loop_and_not_the_file(mikron: Machine) -> None:
    machine = mikron.with_axes(["X", "Y"]).with_values({"axis.X.loops.position_delay_s": 0.0035, "axis.Y.loops.position_delay_s": 0.0012})
    before, _, after = tuned(machine, Asked())
    assert after.tool.rms < 0.1 * before.tool.rms
    late = [a.loops.position_delay_s for a in after.machine.axes]
    assert all(1e5 * s == pytest.approx(round(1e5 * s), abs=1e-6) for s in late)  # 0.01 ms, as the table shows them
    assert late[0] == pytest.approx(late[1])
    assert late[0] == pytest.approx(2e-3, abs=2e-4)


def test_a_slower_motor_keeps_its_current(mikron: Machine) -> None:
    machine = mikron.with_axes(["X", "Y"])
    free = tuned(machine, Asked())[-1]
    limit = free.tool.shares["X"] * machine.axis("X").motor.peak_current_a / 0.9
    short = tuned(machine.with_values({"axis.X.motor.peak_current_a": limit}), Asked())
    assert short[-1].tool.shares["X"] <= max(0.8, short[0].tool.shares["X"])
    assert short[-1].machine.axis("X").loops.speed_gain_nm_s_per_rad < free.machine.axis("X").loops.speed_gain_nm_s_per_rad


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "--out", str(tmp_path / "out"), "--phase-margin-deg", "50"]) == 0
    said = capsys.readouterr().out
    assert "symmetrical optimum" in said
    assert "keep half of the margins only if the first mode lies above" in said
    again = twin.load_machine(tmp_path / "out" / "machine.toml")
    assert f"{again.axis('X').loops.position_gain_per_s:.3g}" in said
    page = (tmp_path / "out" / "report.html").read_text()
    assert "MD32200" in page
    for old, new in re.findall(r"<td>([\d.]+)</td><td>([\d.]+)</td></tr>", page.partition("What to enter</h2>")[2]):
        assert f"{float(old):.3g}" != f"{float(new):.3g}"  # a delay that moves by a microsecond is nothing to enter
    assert main(["tune", "--out", str(tmp_path / "no"), "--phase-margin-deg", "89"]) == 2
    assert "ask for less" in capsys.readouterr().err


def test_the_mode_that_a_gain_needs_is_asked_unless_the_file_has_a_spring(mikron: Machine) -> None:
    """Another effect on the axis, such as a friction, says nothing about its first mode; more margin needs a stiffer drive train."""
    machine = mikron.with_axes(["X", "Y"])
    needed = mode_needed(machine, machine.axis("X"), Asked())
    assert needed is not None
    worn = twin.add_effects(machine, "coulomb_friction:X:factor=1.3")
    assert mode_needed(worn, worn.axis("X"), Asked()) == pytest.approx(needed, rel=0.05)
    stiffer = mode_needed(worn, worn.axis("X"), asked_of(75.0, 9.0))
    assert stiffer is not None
    assert stiffer > needed
    for spring in (with_spring(machine, 60.0), twin.add_effects(machine, "backlash:X:clearance=15e-6")):
        assert mode_needed(spring, spring.axis("X"), Asked()) is None
