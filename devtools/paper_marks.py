"""Depths of the paper's marks under assumptions about what the paper does not print.

The paper gives about 20 um (part 1), 30 um fast and 5 um slow (part 2) and 0.001 degrees (part 3). It prints neither the loops of the
control nor the limits of the axes nor the tolerance of the corners. `marks_of` cuts the fast pass of part 1 and both passes of part 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import functools
from pathlib import Path
import tempfile

from twin.machine.machine import Machine, load_machine
from twin.surface.levels import FOLLOWED, PROGRAMMED, levels_of_program
from twin.surface.machining import machine_part, report_of
from twin.surface.paper_parts import Dome, TangentPlanes, VerticalCorner
from twin.surface.part import read_part

PAPER = {"part 1 fast": 20.0, "part 2 fast": 30.0, "part 2 slow": 5.0}
"""Depths against the programmed cut that the paper gives [um]."""
AGREES = 0.10
"""Relative difference within which a depth agrees with the paper's."""
LINEAR = ("X", "Y", "Z")
BRIEF = 900.0
"""Feed of the slow pass where only the fast one is asked for [mm/min]: still slow for the zone, over in a second."""


@dataclass(frozen=True)
class Assumptions:
    """Position gain [1/s], jerk limits [m/s3], rounding tolerance [mm], feedforward weight (0: off) of the linear axes; radius of part 1 [mm]."""

    gain: float = 61.0
    jerk_xy: float = 5.0
    jerk_z: float = 5.0
    tolerance: float = 0.0055
    feedforward: float = 0.0
    radius: float = 20.0

    def machine(self, nominal: Machine) -> Machine:
        """The nominal machine with these gains, limits and weights."""
        values: dict[str, float] = {}
        for name in LINEAR:
            axis = f"axis.{name}"
            values[f"{axis}.loops.position_gain_per_s"] = self.gain
            values[f"{axis}.max_jerk_m_per_s3"] = self.jerk_z if name == "Z" else self.jerk_xy
            values |= {f"{axis}.loops.{kind}_feedforward": self.feedforward for kind in ("velocity", "torque")}
        return nominal.with_values(values)


def marks_of(assumed: Assumptions) -> dict[str, float]:
    """Depths [um] of PAPER's marks: the deepest point against the programmed cut, by the feed at which it was made."""
    # Z stands still on part 2, and at 0.1 m/min only the tolerance matters
    without_z = replace(assumed, jerk_z=assumed.jerk_xy, radius=Assumptions().radius)
    rounding = Assumptions(tolerance=assumed.tolerance)
    return {"part 1 fast": _part_1_fast(assumed), "part 2 fast": _part_2(without_z, "fast"), "part 2 slow": _part_2(rounding, "slow")}


@functools.cache
def _part_1_fast(assumed: Assumptions) -> float:
    shape = TangentPlanes(passes=0, tolerance=assumed.tolerance, radius=assumed.radius)
    return -cut_of(shape.program(), shape.part(40.0), assumed.machine(load_machine()))["against_programmed_fast_um"]["min"]


@functools.cache
def _part_2(assumed: Assumptions, speed: str) -> float:
    shape = VerticalCorner(tolerance=assumed.tolerance)
    if speed == "fast":
        shape = replace(shape, slow_feed=BRIEF)
    return -cut_of(shape.program(), shape.part(40.0), assumed.machine(load_machine()))[f"against_programmed_{speed}_um"]["min"]


def cut_of(program: str, part: str, machine: Machine) -> Mapping[str, Mapping[str, float]]:
    """What is read from the cut of the path that a machine follows, with the feedforward of its file."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "part.mpf").write_text(program, encoding="utf-8")
        (Path(folder) / "part.toml").write_text(part, encoding="utf-8")
        read = read_part(Path(folder) / "part.toml")
        levels = levels_of_program(Path(folder) / "part.mpf", machine, read.tool, (PROGRAMMED, FOLLOWED), (None,))
        machining = machine_part(read, levels)
    return report_of(machining, machining.cuts[-1])


def rotary_rms(machine: Machine) -> dict[str, float]:
    """RMS of A and C against their set points on the fast pass of part 3, constant delay taken out [deg]."""
    dome = Dome(passes=0)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "part.mpf").write_text(dome.program(), encoding="utf-8")
        (Path(folder) / "part.toml").write_text(dome.part(), encoding="utf-8")
        read = read_part(Path(folder) / "part.toml")
        level = levels_of_program(Path(folder) / "part.mpf", machine, read.tool, (FOLLOWED,), (None,))[-1]
    return {axis: level.errors[f"{axis}_deviation_rms_deg"] for axis in ("A", "C")}


def worst(marks: Mapping[str, float]) -> float:
    """Greatest relative difference from the paper's depths."""
    return max(abs(marks[name] / depth - 1.0) for name, depth in PAPER.items())
