"""What the tests of the design studies share: a short move, study files on it, and their rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.machine import load_machine
from twin.moves import moves_in_turn
from twin.study.carry_out import carry_out, fingerprint, threads_here
from twin.study.design import variants_of
from twin.study.spec import read_study
from twin.study.store import Row, Store
from twin.trace import Trace, write_trace

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


def rows_of(spec: Path, out: Path, threads: int = 1, resume: bool = False) -> list[Row]:
    """Carry a study out and read its rows."""
    study = read_study(spec)
    variants = variants_of(study)
    store = Store(out, fingerprint(study, variants), resume)
    try:
        with threads_here(threads) as workers:
            carry_out(study, variants, store, workers, lambda _: None)
        return store.rows()
    finally:
        store.close()
