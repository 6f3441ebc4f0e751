"""What the tests of the design studies share: a short move, study files on it, and their rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.trace import Trace, write_trace
from twin.study.design import variants_of
from twin.study.execution import simulated, threads_here
from twin.study.results import Row
from twin.study.spec import read_study

FACTOR = '[[factor]]\nname = "mass"\npath = "axis.X.moving_mass_kg"\nrange = [500.0, 900.0]\n'
GRID = '[design]\nkind = "grid"\nlevels = 3\n'
RUN = '[[run]]\ninput = "move.csv"\n'


def write_move(
    path: Path, distance: float = 0.01, acceleration: float = 2.0, jerk: float = 100.0, speed: float = 0.1, **others: float
) -> None:
    """Set points of X: from rest over `distance` [m]; `others` are axes that stand at a place."""
    time, position = moves_in_turn(0.0, [distance], speed, acceleration, jerk, 0.06, 1e-3)
    signals = {("X", "setpoint"): position}
    signals |= {(axis, "setpoint"): np.full(len(time), at) for axis, at in others.items()}
    write_trace(Trace(time, signals, {a: k for a, k in load_machine().kinds.items() if a == "X" or a in others}), path)


def write_spec(folder: Path, text: str = FACTOR + GRID, run: str = RUN) -> Path:
    """A study file beside its move."""
    if not (folder / "move.csv").exists():
        write_move(folder / "move.csv")
    path = folder / "study.toml"
    path.write_text(text.replace("[[factor]]", f"{run}[[factor]]", 1), encoding="utf-8")
    return path


def write_meshes(folder: Path) -> None:
    """`part.toml` with a mesh as nominal surface and one as stock, and `machine.toml`, the Mikron with a mesh that is only looked at."""
    machine = load_machine()
    for name, low, high in (
        ("nominal.stl", (-2, -2, -2), (2, 2, 0)),
        ("stock.stl", (-3, -3, -3), (3, 3, 0.1)),
        ("looks/cover.stl", (0, 0, 0), (9, 9, 9)),
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        trimesh.creation.box(bounds=[low, high]).export(folder / name)
    (folder / "part.toml").write_text(
        '[tool]\nkind = "ball"\ndiameter_mm = 2.0\nlength_mm = 120\n[placement]\norigin_mm = [0, 0, 300]\n'
        '[stock]\nmesh = "stock.stl"\nunit = "mm"\n[[surface]]\nkind = "mesh"\nfile = "nominal.stl"\nunit = "mm"\nspacing_mm = 0.5\n',
        encoding="utf-8",
    )
    model = machine.model_path.read_text(encoding="utf-8")
    model = model.replace("<worldbody>", '<worldbody><geom type="mesh" mesh="cover" contype="0" conaffinity="0"/>', 1)
    asset = '<asset><mesh name="cover" file="looks/cover.stl" scale="0.01 0.01 0.01"/></asset>'
    (folder / "machine.xml").write_text(model.replace("<worldbody>", f"{asset}<worldbody>", 1), encoding="utf-8")
    text = machine.path.read_text(encoding="utf-8")
    (folder / "machine.toml").write_text(text.replace(machine.model_path.name, "machine.xml"), encoding="utf-8")


def rows_of(spec: Path, out: Path, threads: int = 1, resume: bool = False) -> list[Row]:
    """Carry a study out and read its rows."""
    study = read_study(spec)
    return simulated(study, variants_of(study), out, threads_here(threads), resume)[0]
