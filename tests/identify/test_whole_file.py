"""The file of `twin machine new` and `twin identify` as a whole: what its comments state holds the truth of a plant of a few lines."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest

from tests.builders.other_structures import machine_text, write_slides
from tests.identify.test_other_controls import COULOMB, LONG, MASS, VISCOUS, pd, proportional, recorded
from tests.machine.test_from_recording import recorded as strokes
from twin.cli import main
from twin.estimate.regression import Range
from twin.identify.from_recording import machine_from_recording
from twin.identify.identify import identify
from twin.identify.parameters import unidentified
from twin.identify.result import Parameter
from twin.identify.write import machine_comments
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import write_trace

FORCES = ("moving_mass_kg", "coulomb_friction_n", "viscous_friction_n_s_per_m")


def folder_of(run: MeasuredRun, path: Path, unit: str = "") -> Path:
    """A campaign of one run whose current is in a stated unit without a scale."""
    path.mkdir()
    write_trace(run.trace, path / "run.parquet")
    channel = f'[[run.channel]]\naxis = "X"\nsignal = "current"\nstated_unit = "{unit}"\n' if unit else ""
    (path / "campaign.toml").write_text(f'[[run]]\nfile = "run.parquet"\n{channel}', encoding="utf-8")
    return path


def comments(file: Path) -> dict[str, str]:
    """Key -> the comment after its number."""
    lines = [line.partition(" = ") for line in file.read_text(encoding="utf-8").splitlines()]
    return {key: value.partition("# ")[2] for key, _, value in lines}


@pytest.mark.parametrize("cycles", [1, 2])
def test_intervals_of_the_written_machine_hold_the_truth(tmp_path: Path, cycles: int) -> None:
    """A drive of 2.5 ms between samples of 1 and 2 ms: their mean is half of the force and less, however narrow its scatter."""
    run = recorded(proportional, speed_command=True, ends=LONG)
    folder = folder_of(replace(run, trace=run.trace.decimated(cycles)), tmp_path / "campaign")
    machine_from_recording(folder, tmp_path / "m.toml")
    assert main(["identify", str(folder), "--machine", str(tmp_path / "m.toml"), "--out", str(tmp_path / "again.toml")]) == 0
    for file in ("m.toml", "again.toml"):
        said = comments(tmp_path / file)
        for key, true in zip(FORCES, (MASS, COULOMB, VISCOUS)):
            low, high = map(float, re.search(r"(?:95 %|between) (\S+) (?:\.\.|and) (\S+) ", said[key].replace(",", " ")).groups())  # type: ignore[union-attr]
            assert low < true < high
        assert said["moving_mass_kg"].startswith("bounded")
        assert not said["speed_integral_time_s"].startswith("identified")


def test_an_identified_number_of_a_channel_without_a_scale_stays_unscaled(tmp_path: Path) -> None:
    folder = folder_of(recorded(pd, plant=(0.6, 0.2, 4.0)), tmp_path / "campaign", "%")
    machine_from_recording(folder, tmp_path / "m.toml", identified=False)
    assert main(["identify", str(folder), "--machine", str(tmp_path / "m.toml"), "--out", str(tmp_path / "again.toml")]) == 0
    said = comments(tmp_path / "again.toml")
    assert "identified" in said["coulomb_friction_n"]
    assert {key for key, text in said.items() if text.startswith("unscaled: no scale of current in [%]")} >= set(FORCES)


def test_a_frequency_needs_no_scale_of_the_signals(tmp_path: Path) -> None:
    """It comes from time alone; an interval of large numbers is written without exponents."""
    machine_from_recording(folder_of(recorded(pd, plant=(0.6, 0.2, 4.0)), tmp_path / "campaign"), tmp_path / "m.toml", identified=False)
    before = load_machine(tmp_path / "m.toml")
    found = identify(tmp_path / "campaign", before, gaps=False)
    wide = Range(20.0, 19.0, 21.0)
    mode = Parameter("X", "mode_frequency_hz", "Hz", 0.0, wide, wide, False, 1.0, False, "axis.X.mode_frequency_hz")
    after = replace(found, parameters=(mode,), machine=before.with_values({mode.path: 20.0}), unscaled={"X": {"current": "%"}})
    assert machine_comments(after)[mode.path].startswith("identified")
    gain = Parameter("X", "speed_gain_nm_s_per_rad", "A s/m", 1.0, Range(1e3, 740.0, 3300.0), wide, True, 1.0, False)
    assert "speed gain only within 740 to 3300 A s/m" in unidentified(before, [gain])[0].text


def test_a_record_slower_than_the_assumed_cycle_is_identified(tmp_path: Path) -> None:
    """Nothing shows the cycle of this control; the file assumes 4 ms, and the record has a sample every 8 ms."""
    trace = recorded(proportional, speed_command=True).trace.decimated(8)
    signals = {key: values for key, values in trace.signals.items() if key[1] != "velocity_setpoint"}
    folder = folder_of(MeasuredRun("run", replace(trace, signals=signals), None, 0.0), tmp_path / "campaign")
    machine_from_recording(folder, tmp_path / "m.toml", identified=False)
    assert main(["identify", str(folder), "--machine", str(tmp_path / "m.toml"), "--out", str(tmp_path / "again.toml")]) == 0


def test_a_unit_that_nobody_states_is_no_scale(tmp_path: Path) -> None:
    """Whole numbers under names without a unit: one count is taken as 1 um. A map whose line is deleted has stated it."""
    t = recorded(pd, plant=(0.6, 0.2, 4.0)).trace
    columns = [t.time, *(np.rint(1e7 * t.get("X", s)) for s in ("setpoint", "position")), t.get("X", "current")]
    head = "time [s],X_target_counts,X_actual_counts,X_current"
    np.savetxt(tmp_path / "run.csv", np.column_stack(columns), delimiter=",", header=head, comments="", fmt=["%.4f", "%d", "%d", "%.4f"])
    import_it = ["import", str(tmp_path / "run.csv"), "--no-picture", "--out"]
    assert main([*import_it, str(tmp_path / "assumed")]) == 0
    text = (tmp_path / "assumed" / "map.toml").read_text(encoding="utf-8")
    (tmp_path / "known.toml").write_text(re.sub(r"(?m)^unit_assumed.*$", "", text), encoding="utf-8")
    assert main([*import_it, str(tmp_path / "stated"), "--map", str(tmp_path / "known.toml")]) == 0
    for name, said in (("assumed", "unscaled: no unit of set point, position"), ("stated", "lump")):
        machine_from_recording(tmp_path / name, tmp_path / f"{name}.toml", identified=False)
        assert comments(tmp_path / f"{name}.toml")["coulomb_friction_n"].startswith(said)


def test_counts_of_a_current_are_no_reason_to_refuse_a_recording(tmp_path: Path) -> None:
    """Their size in A says nothing: the unit is assumed. A current that the map calls 16 kA is one."""
    t = recorded(proportional, speed_command=True).trace
    counts = np.rint(5000.0 * t.get("X", "current"))
    columns = [t.time, *(1e3 * t.get("X", s) for s in ("setpoint", "position")), counts]
    head = "time [s],X_pos_cmd [mm],X_pos_act [mm],X_current [inc]"
    np.savetxt(tmp_path / "run.csv", np.column_stack(columns), delimiter=",", header=head, comments="", fmt=["%.4f", "%.5f", "%.5f", "%d"])
    import_it = ["import", str(tmp_path / "run.csv"), "--no-picture", "--out"]
    assert main([*import_it, str(tmp_path / "campaign")]) == 0
    text = (tmp_path / "campaign" / "map.toml").read_text(encoding="utf-8")
    (tmp_path / "stated.toml").write_text(re.sub(r"(?m)^unit_assumed.*$", "scale = 1.0", text).replace('"mA"', '"A"'), encoding="utf-8")
    assert main([*import_it, str(tmp_path / "stated"), "--map", str(tmp_path / "stated.toml")]) == 2


def test_the_mechanics_of_a_recording_are_referred_to_the_motor(tmp_path: Path) -> None:
    """Behind a screw an inertia in A per m/s2 is one at the motor by force over current and the lead."""
    machine = load_machine(write_slides(tmp_path, machine_text("Z", cycles_us=(250, 1000)))).with_feedforward("off")
    found = identify(strokes(tmp_path / "campaign", machine), machine)
    (axis,) = machine.axes
    true = {
        "inertia": axis.rotor_inertia_kg_m2 + axis.moving_mass_kg * axis.ratio**2,  # type: ignore[operator]
        "viscous_friction": axis.viscous_friction_nm_s_per_rad,
        "coulomb_friction": axis.coulomb_friction_nm,
    }
    for name, value in true.items():
        (p,) = (p for p in found.parameters if p.name == name)
        assert p.value.low < value < p.value.high
        assert p.value.half < value  # samples of a control that computes between them give no more
