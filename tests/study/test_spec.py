"""Study files: numbers by path, ties, designs, and error messages."""

from collections.abc import Callable
from pathlib import Path
import shutil

import numpy as np
import pytest
import tomlkit
import trimesh

from tests.builders.refused import refused
from tests.builders.study_files import FACTOR, GRID, RUN, write_meshes, write_move, write_spec
from twin.effects import with_effects
from twin.errors import InputError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.simulation.plant_spec import commissioned_inertia, home_inertia_at_motor
from twin.study.design import machine_of, nominal_of, variants_of
from twin.study.execution import fingerprint
from twin.study.paths import matching_paths, number_at, numbers_of, unit_at, with_numbers
from twin.study.spec import read_study


def test_every_number_of_the_machine_file_has_a_path_and_can_be_changed(mikron: Machine) -> None:
    paths = numbers_of(mikron.document)
    assert {"gravity_m_per_s2", "axis.X.moving_mass_kg", "body.workpiece.centre_of_mass_m.2", "axis.A.travel_deg.0"} <= set(paths)
    for path in paths:
        if path.startswith("control."):
            continue  # cycles hang together
        value = number_at(mikron, path)
        changed = with_numbers(mikron, {path: value * 1.001})
        assert number_at(changed, path) == pytest.approx(value * 1.001)
        assert {p: number_at(changed, p) for p in paths if p != path} == {p: number_at(mikron, p) for p in paths if p != path}


def test_a_number_has_the_unit_of_its_key(mikron: Machine) -> None:
    for path, unit in (
        ("axis.X.screw_lead_m_per_rev", "m/rev"),
        ("axis.X.loops.speed_gain_nm_s_per_rad", "Nm s/rad"),
        ("axis.X.loops.position_gain_per_s", "1/s"),
        ("axis.A.motor.torque_constant_nm_per_a", "Nm/A"),
        ("body.workpiece.inertia_kg_m2.0", "kg m2"),
        ("axis.X.loops.velocity_feedforward", ""),
        ("effect.backlash.X.clearance", "SI"),
    ):
        assert unit_at(path) == unit
    assert {p for p in numbers_of(mikron.document) if not unit_at(p)} == {
        "parameter_tolerance",
        *(f"axis.{a}.{key}" for a in "XYZAC" for key in ("loops.velocity_feedforward", "loops.torque_feedforward")),
        *(f"axis.{a}.gear_ratio" for a in "AC"),
    }


def test_wildcards_stand_for_one_part(mikron: Machine) -> None:
    assert matching_paths("axis.*.loops.position_gain_per_s", mikron, "here") == [f"axis.{a}.loops.position_gain_per_s" for a in "XYZAC"]
    assert matching_paths("body.workpiece.inertia_kg_m2.*", mikron, "here") == [f"body.workpiece.inertia_kg_m2.{i}" for i in range(3)]
    with pytest.raises(InputError, match="no number"):
        matching_paths("axis.*", mikron, "here")


def test_effects_are_put_on_and_changed_by_path(mikron: Machine) -> None:
    path = "effect.backlash.X.clearance"
    assert number_at(mikron, path) is None
    once = with_numbers(mikron, {path: 1e-5})
    twice = with_numbers(once, {path: 2e-5, "effect.coulomb_friction.Y.factor": 2.0})
    assert number_at(once, path) == 1e-5
    assert [dict(e) for e in twice.effects] == [
        {"name": "backlash", "axis": "X", "clearance": 2e-5},
        {"name": "coulomb_friction", "axis": "Y", "factor": 2.0},
    ]


def test_ties_follow_factors_and_inertia(tmp_path: Path, mikron: Machine) -> None:
    tied = "".join(
        f'[[tied]]\npath = "{path}"\nto = "{to}"\n{more}\n'
        for path, to, more in (
            ("axis.Y.moving_mass_kg", "mass", "slope = 1.0"),
            ("axis.X.max_jerk_m_per_s3", "mass", "exponent = -0.5"),
            ("axis.X.max_jerk_m_per_s3", "inertia.X", "exponent = -1.0"),
            ("axis.X.loops.speed_gain_nm_s_per_rad", "inertia.X", ""),
        )
    )
    study = read_study(write_spec(tmp_path, FACTOR + tied + GRID))
    machine = machine_of(study, np.array([900.0]))
    grown = home_inertia_at_motor(machine)[0] / home_inertia_at_motor(mikron)[0]
    assert grown == pytest.approx(1.0 + 200.0 * mikron.axis("X").ratio ** 2 / home_inertia_at_motor(mikron)[0], rel=1e-9)
    assert number_at(machine, "axis.Y.moving_mass_kg") == pytest.approx(1050.0 + 200.0)
    assert number_at(machine, "axis.X.max_jerk_m_per_s3") == pytest.approx(5.0 * (900.0 / 700.0) ** -0.5 / grown)
    assert number_at(machine, "axis.X.loops.speed_gain_nm_s_per_rad") == pytest.approx(3.4 * grown)


@pytest.mark.parametrize("recommission", [False, True])
def test_the_control_is_commissioned_on_the_variant_or_on_the_nominal_machine(tmp_path: Path, mikron: Machine, recommission: bool) -> None:
    study = read_study(write_spec(tmp_path, f"recommission = {str(recommission).lower()}\n" + FACTOR + GRID))
    machine = machine_of(study, np.array([900.0]))
    told = home_inertia_at_motor(machine if recommission else mikron)
    np.testing.assert_allclose(commissioned_inertia(machine), told, rtol=1e-9)


def without_told_constants(folder: Path, more: str = "") -> Path:
    """A study of the motor's torque constant on a machine whose file has commissioned inertias only."""
    machine = load_machine()
    told = {f"axis.{a}.commissioned": {"inertia_kg_m2": v} for a, v in zip(machine.axis_names, home_inertia_at_motor(machine).tolist())}
    write_machine(machine.with_values(told), folder / "machine.toml")
    factor = '[[factor]]\nname = "constant"\npath = "axis.X.motor.torque_constant_nm_per_a"\nrange = [1.0, 2.0]\n'
    return write_spec(folder, f'machine = "machine.toml"\n{more}{factor}{GRID}')


@pytest.mark.parametrize(("recommission", "constant"), [(False, 1.4), (True, 1.0)])
def test_the_control_keeps_the_nominal_torque_constant(tmp_path: Path, recommission: bool, constant: float) -> None:
    """A motor of 1.0 Nm/A instead of 1.4: only a recommissioned control uses the new value."""
    study = read_study(without_told_constants(tmp_path, f"recommission = {str(recommission).lower()}\n"))
    axis = machine_of(study, np.array([1.0])).axis("X")
    assert axis.motor.torque_constant_nm_per_a == 1.0
    assert axis.commissioned_torque_constant == constant


def test_commissioned_values_can_be_factors(tmp_path: Path) -> None:
    spec = without_told_constants(tmp_path)
    text = spec.read_text(encoding="utf-8").replace("axis.X.motor.torque_constant_nm_per_a", "axis.X.commissioned.inertia_kg_m2")
    spec.write_text(text.replace("[1.0, 2.0]", "[0.01, 0.02]"), encoding="utf-8")
    study = read_study(spec)
    machine = machine_of(study, np.array([0.015]))
    assert machine.axis("X").commissioned_inertia == 0.015
    assert machine.axis("Y").commissioned_inertia == study.machine.axis("Y").commissioned_inertia


@pytest.mark.parametrize("recommission", [False, True])
def test_an_inertia_among_the_machine_data_stays_there(tmp_path: Path, mikron: Machine, recommission: bool) -> None:
    """MD32650 of X is the commissioned inertia; recommissioning changes this number."""
    shutil.copy(mikron.model_path, tmp_path)
    document = tomlkit.parse(mikron.path.read_text(encoding="utf-8"))
    del document["axis"]["X"]["commissioned"]
    document["axis"]["X"]["sinumerik"] = {"MD32650": 0.02}
    (tmp_path / "machine.toml").write_text(tomlkit.dumps(document), encoding="utf-8")
    study = read_study(write_spec(tmp_path, f'machine = "machine.toml"\nrecommission = {str(recommission).lower()}\n' + FACTOR + GRID))
    machine = machine_of(study, np.array([900.0]))
    expected = home_inertia_at_motor(machine)[0] if recommission else 0.02
    assert machine.axis("X").commissioned_inertia == pytest.approx(expected, rel=1e-12)
    assert machine.axis("X").commissioned_torque_constant == 1.4


def test_fixed_numbers_stand_in_all_variants(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, '[fixed]\naxis.Y.moving_mass_kg = 1100\n"axis.*.loops.torque_feedforward" = 0.0\n' + FACTOR + GRID)
    machine = machine_of(read_study(spec), np.array([600.0]))
    assert machine.axis("Y").moving_mass_kg == 1100.0
    assert {axis.loops.torque_feedforward for axis in machine.axes} == {0.0}
    assert machine.axis("X").moving_mass_kg == 600.0


SECOND = '[[factor]]\nname = "gain"\npath = "axis.X.loops.position_gain_per_s"\nrelative = true\nvalues = [0.5, 1.0, 2.0]\n'


def test_designs_cover_their_factors(tmp_path: Path) -> None:
    def table(design: str) -> np.ndarray:
        return variants_of(read_study(write_spec(tmp_path, FACTOR + SECOND + f"[design]\n{design}\n")))

    grid = table('kind = "grid"\nlevels = 3')
    assert sorted(map(tuple, grid)) == [(m, g) for m in (500.0, 700.0, 900.0) for g in (0.5, 1.0, 2.0)]
    one = table('kind = "one_at_a_time"\nlevels = 3')
    assert sorted(map(tuple, one)) == [(500.0, 1.0), (700.0, 0.5), (700.0, 1.0), (700.0, 2.0), (900.0, 1.0)]
    cube = table('kind = "latin_hypercube"\ncount = 30')
    assert sorted(np.floor((cube[:, 0] - 500.0) / 400.0 * 30)) == list(range(30))  # each thirtieth of the range once
    assert {v: int(np.sum(cube[:, 1] == v)) for v in (0.5, 1.0, 2.0)} == {0.5: 10, 1.0: 10, 2.0: 10}
    sobol = table('kind = "sobol"\ncount = 8')
    assert sobol.shape == (8 * 4, 2)
    assert np.all((sobol[:, 0] >= 500.0) & (sobol[:, 0] <= 900.0))
    np.testing.assert_array_equal(table('kind = "list"\nrows = [[600, 1.5], [610, 2]]'), [[600.0, 1.5], [610.0, 2.0]])
    np.testing.assert_array_equal(nominal_of(read_study(tmp_path / "study.toml")), [700.0, 1.0])


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_a_seed_is_a_table(tmp_path: Path, kind: str) -> None:
    def table(seed: int) -> np.ndarray:
        return variants_of(read_study(write_spec(tmp_path, f'seed = {seed}\n{FACTOR}[design]\nkind = "{kind}"\ncount = 16\n')))

    np.testing.assert_array_equal(table(1), table(1))
    assert not np.array_equal(table(1), table(2))


def test_the_fingerprint_changes_with_the_study(tmp_path: Path) -> None:
    def print_of(text: str) -> str:
        study = read_study(write_spec(tmp_path, text))
        return fingerprint(study, variants_of(study))

    same = print_of(FACTOR + GRID)
    assert print_of("# a remark\nanswer = ['cycle_time_s']\n" + FACTOR + GRID) == same
    assert print_of(FACTOR.replace("500", "510") + GRID) != same
    assert print_of("recommission = true\n" + FACTOR + GRID) != same
    write_move(tmp_path / "move.csv", distance=0.011)
    assert print_of(FACTOR + GRID) != same


def test_results_belong_to_the_meshes_that_part_and_model_name(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    spec = write_spec(tmp_path, 'machine = "machine.toml"\npart = "part.toml"\n' + FACTOR + GRID)

    def fresh() -> str:
        study = read_study(spec)
        return fingerprint(study, variants_of(study))

    found = {fresh()}
    for name in ("looks/cover.stl", "nominal.stl", "stock.stl"):
        assert fresh() in found
        trimesh.creation.box((0.02, 0.02, 0.03)).export(tmp_path / name)
        found.add(fresh())
    assert len(found) == 4


WRONG: dict[str, tuple[Callable[[str], str], tuple[str, ...]]] = {
    "no TOML": (lambda t: t + "[", ("not a valid TOML file",)),
    "unknown key": (lambda t: "sed = 1\n" + t, ("unknown key 'sed'", "did you mean 'seed'")),
    "seed": (lambda t: "seed = 1.5\n" + t, ("seed = 1.5", "whole number")),
    "flag": (lambda t: "recommission = 1\n" + t, ("recommission = 1", "true or false")),
    "no factor": (lambda t: RUN + GRID, ("no [[factor]]",)),
    "no run": (lambda t: t.replace(RUN, ""), ("no [[run]]",)),
    "run without input": (lambda t: t.replace('input = "move.csv"', ""), ("run 1", "'input' is missing")),
    "run is not there": (lambda t: t.replace("move.csv", "mov.csv"), ("mov.csv", "no such file beside")),
    "run of one name": (lambda t: t + RUN, ("two of [[run]]", "'move'")),
    "feedforward": (lambda t: t.replace(RUN, RUN + 'feedforward = "on"\n'), ("feedforward = 'on'", "off, velocity")),
    "unknown path": (lambda t: t.replace("moving_mass_kg", "moving_mas_kg"), ("moving_mas_kg", "did you mean 'axis.X.moving_mass_kg'")),
    "pattern without match": (lambda t: t.replace("axis.X.moving", "axis.*.movin"), ("no number 'axis.*.movin_mass_kg'",)),
    "no path": (lambda t: t.replace('path = "axis.X.moving_mass_kg"', ""), ("'path' is missing",)),
    "misspelt key of a factor": (lambda t: t.replace("range =", "rang ="), ("unknown key 'rang'", "did you mean 'range'")),
    "range upside down": (lambda t: t.replace("[500.0, 900.0]", "[900.0, 500.0]"), ("range = [900.0, 500.0]", "low below high")),
    "range of text": (lambda t: t.replace("[500.0, 900.0]", '["a", 1]'), ("range", "list of numbers")),
    "range of nan": (lambda t: t.replace("[500.0, 900.0]", "[nan, 1]"), ("range", "list of numbers")),
    "neither": (lambda t: t.replace("range = [500.0, 900.0]", ""), ("neither values nor a range",)),
    "both": (lambda t: t.replace("range =", "values = [1.0, 2.0]\nrange ="), ("both values and a range",)),
    "one value": (lambda t: t.replace("range = [500.0, 900.0]", "values = [500.0]"), ("only one value", "[fixed]")),
    "factor twice": (lambda t: t.replace(GRID, FACTOR + GRID), ("two of [[factor]]", "'mass'")),
    "unknown effect": (lambda t: t.replace("axis.X.moving_mass_kg", "effect.backlsh.X.clearance"), ("backlsh", "did you mean 'backlash'")),
    "effect's parameter": (lambda t: t.replace("axis.X.moving_mass_kg", "effect.backlash.X.gap"), ("no parameter 'gap'",)),
    "effect's axis": (lambda t: t.replace("axis.X.moving_mass_kg", "effect.backlash.Q.clearance"), ("no axis Q",)),
    "effect short": (lambda t: t.replace("axis.X.moving_mass_kg", "effect.backlash.X"), ("write effect.NAME.AXIS.PARAMETER",)),
    "effect on a wrong axis": (
        lambda t: t.replace("axis.X.moving_mass_kg", "effect.encoder_eccentricity.X.amplitude"),
        ("axis X cannot have this effect",),
    ),
    "relative effect": (
        lambda t: t.replace("axis.X.moving_mass_kg", "effect.backlash.X.clearance").replace("range", "relative = true\nrange"),
        ("the machine lacks effect.backlash.X.clearance",),
    ),
    "tie to nothing": (lambda t: t + '[[tied]]\npath = "axis.X.moving_mass_kg"\nto = "mas"\n', ("to = 'mas'", "did you mean 'mass'")),
    "tie without path": (lambda t: t + '[[tied]]\nto = "mass"\n', ("'path' is missing",)),
    "tie with both": (
        lambda t: t + '[[tied]]\npath = "axis.Y.moving_mass_kg"\nto = "mass"\nslope = 1\nexponent = 2\n',
        ("slope needs a factor and excludes exponent",),
    ),
    "fixed path": (lambda t: '[fixed]\n"axis.X.moving_mas_kg" = 1.0\n' + t, ("[fixed]", "did you mean 'axis.X.moving_mass_kg'")),
    "fixed value": (lambda t: '[fixed]\n"axis.X.moving_mass_kg" = "a"\n' + t, ("[fixed]", "moving_mass_kg = 'a'; give a number")),
    "impossible fixed value": (lambda t: '[fixed]\n"axis.X.moving_mass_kg" = -1.0\n' + t, ("moving_mass_kg = -1", "impossible")),
    "no design": (lambda t: t.replace(GRID, ""), ("'design' is missing", "write [design]")),
    "unknown design": (lambda t: t.replace('"grid"', '"gird"'), ("kind = 'gird'", "did you mean 'grid'")),
    "levels of another design": (lambda t: t.replace('"grid"', '"sobol"'), ("unknown key 'levels'", "count")),
    "one level": (lambda t: t.replace("levels = 3", "levels = 1"), ("levels = 1", "2 or more")),
    "empty design": (lambda t: t.replace('"grid"\nlevels = 3', '"latin_hypercube"\ncount = 0'), ("the design has no variant",)),
    "empty list": (lambda t: t.replace('"grid"\nlevels = 3', '"list"\nrows = []'), ("the design has no variant",)),
    "short row": (lambda t: t.replace('"grid"\nlevels = 3', '"list"\nrows = [[600.0], [600.0, 1.0]]'), ("row 2 needs 1 numbers",)),
    "row too short for two factors": (
        lambda t: t.replace(GRID, f'{SECOND}[design]\nkind = "list"\nrows = [[700.0]]\n'),
        ("row 1 needs 2 numbers",),
    ),
    "Sobol count": (lambda t: t.replace('"grid"\nlevels = 3', '"sobol"\ncount = 60'), ("count = 60", "power of two")),
    "huge design": (lambda t: t.replace("levels = 3", "levels = 2000000"), ("2e+06 variants", "latin_hypercube")),
    "part": (lambda t: 'part = "part.toml"\n' + t, ("part: 'part.toml'", "no such file beside")),
    "machine": (lambda t: 'machine = "m.toml"\n' + t, ("machine: 'm.toml'", "no such file beside")),
    "unknown answer": (lambda t: 'answer = ["cycle_tim_s"]\n' + t, ("no response 'cycle_tim_s'", "did you mean 'cycle_time_s'")),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_study_file_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str) -> None:
    change, words = WRONG[fault]
    spec = write_spec(tmp_path)
    text = spec.read_text(encoding="utf-8")
    spec.write_text(change(text), encoding="utf-8")
    assert spec.read_text(encoding="utf-8") != text
    message = refused(capsys, "study", str(spec), "--out", str(tmp_path / "out"))
    for word in words:
        assert word in message


def test_effects_of_one_name_on_one_axis_are_all_kept(mikron: Machine) -> None:
    coupled = with_effects(mikron, [{"name": "cross_axis_coupling", "axis": "X", "from_axis": a, "mass": 40.0} for a in "YZ"])
    assert len(coupled.effects) == 2
    assert with_numbers(coupled, {}).effects == coupled.effects
    changed = with_numbers(coupled, {"effect.backlash.Y.clearance": 1e-5})
    assert [(e["name"], e["axis"]) for e in changed.effects] == [("cross_axis_coupling", "X")] * 2 + [("backlash", "Y")]


@pytest.mark.parametrize("key", ["tied", "constraint"])
def test_a_number_in_place_of_tables_is_refused(tmp_path: Path, key: str) -> None:
    with pytest.raises(InputError, match=rf"{key} = 5; write \[\[{key}\]\]"):
        read_study(write_spec(tmp_path, f"{key} = 5\n" + FACTOR + GRID))
