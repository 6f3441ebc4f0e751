"""An effect on a number that the machine file had only assumed or tried is a calibration of this number, no finding. In an unscaled one the scale cancels."""

from pathlib import Path
import shutil
from types import SimpleNamespace

import pytest

from twin.diagnose.diagnosis import Diagnosis, contradicted
from twin.diagnose.wording import calibration_text, verdict_sentence
from twin.effects import EFFECTS, Setting
from twin.machine.machine import Machine, load_machine


def test_effects_on_assumed_and_tried_numbers_stand_apart(mikron: Machine, tmp_path: Path) -> None:
    assert mikron.path is not None
    shutil.copy(mikron.model_path, tmp_path)
    text, changed = mikron.path.read_text(encoding="utf-8"), {}
    for key, word in (
        ("position_gain_per_s", "assumed"),
        ("speed_integral_time_s", "tried"),
        ("position_delay_s", "unscaled: no scale of position in [inc]; measured"),
    ):
        line = next(line for line in text.split("[axis.X.loops]", 1)[1].splitlines() if line.startswith(key))
        changed[line] = f"{line.split('#')[0]} # {word}"
    head, loops = text.split("[axis.X.loops]", 1)
    for old, new in changed.items():
        loops = loops.replace(old, new, 1)
    (tmp_path / "m.toml").write_text(f"{head}[axis.X.loops]{loops}", encoding="utf-8")
    machine = load_machine(tmp_path / "m.toml")
    parts = {"position_gain": {"factor": 0.8}, "speed_integral_time": {"factor": 2.0}, "loop_delay": {"delay_s": 1e-3}, "backlash": {}}
    own = {("position_gain", "X"), ("speed_integral_time", "X")}
    # behind an assumed position controller only what a channel isolates from the loop is a finding
    for channels, calibrated in (([], own | {("loop_delay", "X"), ("backlash", "X")}), (["controller", "motor_minus_scale"], own)):
        state = SimpleNamespace(group=SimpleNamespace(has=lambda axis, name, shown=channels: axis == "X" and name in shown, on_own_path=()))
        named = [(Setting(EFFECTS[name], axis, values), state, 0.9) for name, values in parts.items() for axis in ("X", "Y")]
        found = Diagnosis.calibrated.func(SimpleNamespace(machine=machine, named=named))  # type: ignore[attr-defined]
        assert {key[:2] for key in found} == calibrated


def test_a_calibration_says_which_measured_number_it_contradicts(mikron: Machine, tmp_path: Path) -> None:
    """Behind a tried controller -61 % of a viscous friction that was measured to 1 % stood as its calibration."""
    assert mikron.path is not None
    shutil.copy(mikron.model_path, tmp_path)
    text, key = mikron.path.read_text(encoding="utf-8"), "viscous_friction_nm_s_per_rad"
    value = mikron.axis("X").viscous_friction_nm_s_per_rad
    setting = Setting(EFFECTS["viscous_friction"], "X", {"factor": 0.39})
    interval = f"95 % {0.99 * value:.6g} .. {1.01 * value:.6g}"
    for comment, high, said in (
        ("lump: Nm, 95 % +- 1 %", 0.5, True),
        (f"unscaled: no scale of torque in [%]; identified  {interval}, campaign c", 0.5, True),
        (f"identified  {interval}, campaign c", 1.0, False),
        (f"bounded  {interval}, campaign c", 0.5, False),
        ("tried", 0.5, False),
    ):
        head, own = text.split("[axis.X]", 1)
        line = next(line for line in own.splitlines() if line.startswith(key))
        (tmp_path / "m.toml").write_text(f"{head}[axis.X]{own.replace(line, f'{key} = {value:.9g} # {comment}', 1)}", encoding="utf-8")
        shown = {"factor": {"value": 0.39, "low": 0.3, "high": high, "unit": "1"}}
        against = contradicted(setting, shown, load_machine(tmp_path / "m.toml"))
        assert bool(against) == said, comment
        entry = {"effect": "viscous_friction", "axis": "X", "parameters": shown, "contradicts": against}
        assert ("contradicts" in calibration_text({"calibrated": [entry]})) == said


@pytest.mark.parametrize(("factor", "within"), [(0.97, True), (0.9, False)])
def test_an_effect_within_the_interval_of_a_measured_number_is_no_finding(
    factor: float, within: bool, mikron: Machine, tmp_path: Path
) -> None:
    """A speed gain of 412 +- 14 was measured from a recording, and one 3 % smaller named in the same recording with 0.9."""
    assert mikron.path is not None
    shutil.copy(mikron.model_path, tmp_path)
    text, key = mikron.path.read_text(encoding="utf-8"), "viscous_friction_nm_s_per_rad"
    value = mikron.axis("X").viscous_friction_nm_s_per_rad
    head, own = text.split("[axis.X]", 1)
    line = next(line for line in own.splitlines() if line.startswith(key))
    measured = own.replace(line, f"{key} = {value:.9g} # measured, 95 % +- {0.034 * value:.6g}", 1)
    (tmp_path / "m.toml").write_text(f"{head}[axis.X]{measured}", encoding="utf-8")
    state = SimpleNamespace(group=SimpleNamespace(has=lambda *_: True, on_own_path=()))
    named = [(Setting(EFFECTS["viscous_friction"], axis, {"factor": factor}), state, 0.9) for axis in ("X", "Y")]
    found = Diagnosis.calibrated.func(SimpleNamespace(machine=load_machine(tmp_path / "m.toml"), named=named))  # type: ignore[attr-defined]
    assert {key[:2] for key in found} == ({("viscous_friction", "X")} if within else set())


def test_a_verdict_without_findings_names_what_was_calibrated() -> None:
    entry = {"effect": "position_gain", "axis": "X", "parameters": {"factor": {"value": 0.8, "low": 0.7, "high": 0.9, "unit": "1"}}}
    document = {"verdict": "none", "effects": [], "calibrated": [entry], "budget": {"unexplained": []}}
    said = verdict_sentence(document)
    assert said.startswith("No effect: the machine agrees with its file once")
    left = {"unexplained": [{"axis": "X", "times_noise": 28.6}]}  # a mass 25 % larger, in place of which a tried gain was calibrated
    assert verdict_sentence({**document, "budget": left}).startswith("No effect found, but a gap remains, 28.6 times the noise on axis X")
    unlikely = {**entry, "probability": 0.03}
    said_of = {"verdict": "unknown", "effects": [unlikely], "where": [], "decided": True}
    assert verdict_sentence(said_of) == "Unknown: no known effect explains the gap."
    assert "position gain on axis X" in said
