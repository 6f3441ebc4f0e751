"""A study of inertia on every machine there is: with and without rotary axes, with other drives, and a mill of three axes."""

from pathlib import Path

import pytest

from tests.builders.study_files import rows_of, write_spec
from tests.conftest import ROOT
from twin.cli import main
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.trace import Trace, write_trace
from twin.study.evaluate import FAULT

SHIPPED = sorted(
    path
    for folder in ("models", "examples")
    for path in (ROOT / folder).rglob("*.toml")
    if {"\n[axis.", "\nmodel ="} <= {part for part in ("\n[axis.", "\nmodel =") if part in path.read_text(encoding="utf-8")}
)


def study_of(machine: Machine, path: Path, folder: Path) -> Path:
    """A study of the inertia of the first axis (of its mass, if it is driven directly), on a short move of that axis."""
    axis = machine.axes[0]
    factor = f"inertia.{axis.name}" if axis.rotor_inertia_kg_m2 > 0.0 else f"axis.{axis.name}.moving_mass_kg"
    way = 0.01 if axis.kind == "linear" else 0.1
    time, position = moves_in_turn(0.0, [way], 0.5 * axis.max_velocity, 0.5 * axis.max_acceleration, axis.max_jerk, 0.06, 1e-3)
    write_trace(Trace(time, {(axis.name, "setpoint"): position}, machine.kinds), folder / "move.csv")
    spec = folder / "study.toml"
    spec.write_text(
        f'machine = "{path.as_posix()}"\n[[run]]\ninput = "move.csv"\n[[factor]]\nname = "inertia"\npath = "{factor}"\n'
        'relative = true\n[design]\nkind = "list"\nrows = [[1.0], [1.2]]\n',
        encoding="utf-8",
    )
    return spec


def check(path: Path, folder: Path) -> None:
    """Both variants of the study have their responses, and more inertia takes more effort; the command ends well."""
    machine = load_machine(path)
    spec = study_of(machine, path, folder)
    assert main(["study", str(spec), "--out", str(folder / "out"), "--no-replay"]) == 0
    axis = machine.axes[0]
    rows = rows_of(spec, folder / "out", resume=True)
    assert [reason for *_, reason in rows] == [None, None]
    light, heavy = (found[f"{axis.effort}_smooth_max_{axis.name}_{axis.effort_unit.lower()}"] for _, _, found, _ in rows)
    assert heavy > light


def test_all_shipped_machines_are_here() -> None:
    assert len(SHIPPED) >= 4


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.relative_to(ROOT).with_suffix("").as_posix())
def test_a_study_of_inertia_runs_on_a_shipped_machine(path: Path, tmp_path: Path) -> None:
    check(path, tmp_path)


def test_a_study_of_inertia_runs_on_a_mill_of_three_axes(mikron: Machine, tmp_path: Path) -> None:
    """Regression: a machine without rotary axes has one pose; the array of its angles could not be shaped."""
    write_machine(mikron.with_axes(["X", "Y", "Z"]), tmp_path / "mill.toml")
    check(tmp_path / "mill.toml", tmp_path)


def test_a_variant_that_a_fault_ended_is_computed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: it was kept as done, so that a study continued after the fault was mended still lacked it."""
    spec = write_spec(tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr("twin.study.evaluate.simulate", lambda *a, **k: 1 / 0)
        failed = rows_of(spec, tmp_path / "out")
    assert all(reason.startswith(FAULT) for *_, reason in failed if reason)
    assert not any(found for _, _, found, _ in failed)
    again = rows_of(spec, tmp_path / "out", resume=True)
    assert [reason for *_, reason in again] == [None] * len(failed)
