"""Set points from the moves of a case, and small campaigns that the second plant records with them during the run of a suite.

[moves.X]
start_mm = 0.0                    # _deg on a rotary axis
distances_mm = [40.0, -60.0]
speed_mm_per_s = 100.0
dwell_s = 0.05                    # default 0.05

[recorded]                        # by the second plant of `twin.exam`
seed = 41                         # of the parameter spread, the size of the effect and the noise
effect = "backlash"               # without it: a healthy machine
axis = "Y"
feedforward = ["off", "velocity+torque"]      # one run each
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, default_machine_path
from twin.recordings.campaign import Campaign, read_campaign
from twin.regress.suite import Case, Recorded
from twin.simulation.setpoints import Setpoints
from twin.tables import is_number, known_keys, typed
from twin.units import factor_to_si

PERIOD_S = 1e-3
ACCELERATION_SHARE = 0.8
"""Share of an axis' greatest acceleration that moves use."""
LEAST_JERK = 50.0
"""Least jerk of moves over the axis' greatest acceleration [1/s], so that short moves still reach their acceleration."""


def setpoints_of_moves(case: Case, machine: Machine) -> Setpoints:
    """Set points (sample, axis) at 1 ms: rest-to-rest moves; an axis without moves stays at 0 or the nearest end of its travel."""
    columns: dict[str, np.ndarray] = {}
    for name, table in case.table["moves"].items():
        columns[name] = _moves(f"{case.where}: [moves.{name}]", machine, name, table)
    length = max(len(column) for column in columns.values())
    still = {axis.name: np.clip(0.0, *axis.travel) for axis in machine.axes}
    position = np.column_stack(
        [
            np.pad(columns[name], (0, length - len(columns[name])), mode="edge") if name in columns else np.full(length, still[name])
            for name in machine.axis_names
        ]
    )
    return Setpoints(position, PERIOD_S)


def _moves(where: str, machine: Machine, name: str, table: Any) -> np.ndarray:
    if name not in machine.axis_names:
        raise InputError(f"{where}: no such axis; {nearest(name, machine.axis_names)}")
    axis = machine.axis(name)
    unit = "mm" if axis.kind == "linear" else "deg"
    known = {f"start_{unit}": 0.0, f"distances_{unit}": None, f"speed_{unit}_per_s": None, "dwell_s": 0.05}
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: expected a table with {', '.join(known)}")
    known_keys(table, known, where)
    start, distances, speed, dwell = (table.get(key, default) for key, default in known.items())
    if not isinstance(distances, list) or not distances or not all(is_number(d) and d != 0 for d in distances):
        raise InputError(f"{where}: distances_{unit} must be a list of numbers other than 0, e.g. [40.0, -40.0]")
    if not is_number(speed) or not speed > 0 or not is_number(start) or not is_number(dwell) or dwell < 0:
        raise InputError(f"{where}: speed_{unit}_per_s must be above 0, start_{unit} and dwell_s numbers")
    si = factor_to_si(unit, where)
    acceleration = ACCELERATION_SHARE * axis.max_acceleration
    jerk = max(axis.max_jerk, LEAST_JERK * axis.max_acceleration)
    return moves_in_turn(start * si, [d * si for d in distances], speed * si, acceleration, jerk, dwell, PERIOD_S)[1]


def recorded_campaign(case: Case, machine: Machine, folder: Path) -> Campaign:
    """Record the case's moves on a drawn machine of the second plant, write the campaign to a folder and read it."""
    from twin.exam.draw import AXES, draw_case, write_campaign
    from twin.exam.plant.parameters import Richness
    from twin.exam.programme import TestRun

    where = f"{case.where}: [recorded]"
    asked = typed(case.table["recorded"], Recorded, where)
    document = read_toml(default_machine_path())
    try:
        kind = "single" if asked.effect else "healthy"
        drawn = draw_case(asked.seed, kind, document, effect=asked.effect, axis=asked.axis, richness=Richness.off(), run_set="exam")
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    # the second plant moves all five axes; only those of the case are recorded
    wanted = setpoints_of_moves(case, machine)
    points = np.zeros((len(wanted.position), len(AXES)))
    for a, name in enumerate(machine.axis_names):
        points[:, AXES.index(name)] = wanted.position[:, a]
    words = enumerate(asked.feedforward, start=1)
    runs = [TestRun(f"moves_{i}_{word.replace('+', '_')}", "test", word, points) for i, word in words]
    write_campaign(drawn, folder, document, runs=runs, axes=case.table["moves"])
    return read_campaign(folder, machine)
