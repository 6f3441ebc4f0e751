"""Two rotary axes of which one carries the other: the law against MuJoCo's inverse dynamics, and which axes are a pair."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.builders.script import script
from twin.identify.rotary_pair import MOMENTS, RotaryPair, pair_columns, pair_of
from twin.machine.machine import Machine, load_machine
from twin.simulation.plant_spec import build_plant


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.12g}" for v in values)


def body(name: str, rng: np.random.Generator, joint: str, inside: str = "") -> str:
    second = rng.uniform(0.2, 0.5, 3)  # second moments of mass: any three make an inertia
    inertia = second.sum() - second
    inertial = f'<inertial pos="{numbers(rng.normal(0.0, 0.1, 3))}" quat="{numbers(rng.normal(size=4))}" mass="{rng.uniform(20, 90):.9g}" '
    return f'<body name="{name}" {joint}{inertial}diaginertia="{numbers(inertia)}"/>{inside}</body>'


def tilted(folder: Path, seed: int, names: tuple[str, str] = ("B", "C")) -> Machine:
    """A machine of two square rotary axes, the inner one above the outer by a distance, anyhow in space."""
    rng = np.random.default_rng(seed)
    first = rng.normal(size=3)
    second = np.cross(first, rng.normal(size=3))
    place = numbers(rng.normal(0.0, 0.1, 3))
    table = body("table", rng, f'pos="{place}" euler="0.3 0.1 0"><joint name="{names[1]}" type="hinge" axis="0 0 1"/>')
    # the table's own frame is turned, so its axis is given in the frame of the cradle by the same turn
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, second / np.linalg.norm(second))
    table = table.replace('euler="0.3 0.1 0"', f'quat="{numbers(turn)}"')
    part = body("part", rng, 'pos="0.02 0 0.1">')
    table = table.removesuffix("</body>") + part + "</body>"
    cradle = body(
        "cradle", rng, f'quat="{numbers(rng.normal(size=4))}"><joint name="{names[0]}" type="hinge" axis="{numbers(first)}"/>', table
    )
    motors = "".join(f'<motor name="{name}" joint="{name}"/>' for name in names)
    path = folder / "pair.xml"
    path.write_text(f"<mujoco><worldbody>{cradle}</worldbody><actuator>{motors}</actuator></mujoco>", encoding="utf-8")
    base = load_machine()
    document = {key: value for key, value in base.document.items() if key not in ("body", "geometry", "driven_axes")}
    document |= {"name": "pair", "model": "pair.xml", "axis_order": list(names)}
    document["axis"] = {new: dict(base.document["axis"][old]) for new, old in zip(names, "AC")}
    return replace(base, document=document, model_path=path, path=None)


def paired(machine: Machine) -> RotaryPair:
    pair = pair_of(machine)
    assert pair is not None
    return pair


@pytest.mark.parametrize("seed", range(6))
def test_law_is_that_of_the_engine(tmp_path: Path, seed: int) -> None:
    machine = tilted(tmp_path, seed)
    pair, rng = paired(machine), np.random.default_rng(seed)
    angle, speed, acceleration = (rng.normal(size=(2, 50)) for _ in range(3))
    columns = pair_columns(pair, (angle[0], speed[0], acceleration[0]), (angle[1], speed[1], acceleration[1]))
    law = np.array([np.column_stack(of) @ pair.numbers for of in columns])
    plant = build_plant(machine)
    plant.model.dof_damping[:] = plant.model.dof_frictionloss[:] = 0.0
    engine = np.zeros_like(law)
    for k in range(50):
        plant.data.qpos[plant.load_position], plant.data.qvel[plant.load_dof] = angle[:, k], speed[:, k]
        plant.data.qacc[plant.load_dof] = acceleration[:, k]
        mujoco.mj_inverse(plant.model, plant.data)
        engine[:, k] = plant.data.qfrc_inverse[plant.load_dof]
    assert law == pytest.approx(engine, rel=1e-9, abs=1e-9 * float(np.abs(engine).max()))


def test_home_machine_is_one(mikron: Machine) -> None:
    pair = paired(mikron)
    assert (pair.axes, pair.bodies) == (("A", "C"), ("cradle", "table", "workpiece"))
    assert pair.gravity == pytest.approx([0.0, 0.0, -mikron.gravity])
    workpiece = next(b for b in mikron.bodies if b.name == "workpiece")
    x, y, _ = workpiece.centre_of_mass_m
    moments = dict(zip(MOMENTS, pair.numbers[2:].tolist()))
    assert (moments["table_x"], moments["table_y"]) == pytest.approx((workpiece.mass_kg * x, workpiece.mass_kg * y))


@pytest.mark.parametrize(("structure", "axes"), [("table_table", ("B", "C")), ("head_table", None), ("three_axis", None)])
def test_which_machines_have_one(structure: str, axes: tuple[str, str] | None) -> None:
    """A head that slides with a linear axis is none: its acceleration acts on the moments."""
    pair = pair_of(script("examples/kinematics/run.py", "kinematics").machine_of(structure))
    assert (pair and pair.axes) == axes
