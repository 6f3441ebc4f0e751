"""Assumptions that agree with the paper's marks: draws docs/pictures/paper/assumptions.png.

    python -m devtools.paper_assumptions          80 combinations, some minutes

The paper gives marks of about 20 um (part 1), 30 um fast and 5 um slow (part 2), but neither the control loops, the axis limits nor the corner
tolerance. Each panel varies one of them and the position gain; the others stay as in `Assumptions`. Green: all three marks within 10 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import itertools
from pathlib import Path
import tempfile
from typing import Any

from examples.parts.paper_parts import TangentPlanes, VerticalCorner
from twin.machine.machine import Machine, load_machine
from twin.report.figure import AMBER, GREEN, RED, SOFT, new_figure, save_png
from twin.surface.levels import FOLLOWED, PROGRAMMED, levels_of_program
from twin.surface.machining import machine_part, report_of
from twin.surface.part import read_part

ROOT = Path(__file__).resolve().parent.parent
PANELS: dict[str, tuple[str, tuple[dict[str, float], ...]]] = {
    "jerk of Z [m/s3]": (
        "jerk_z", tuple({"gain": g, "jerk_z": j} for g, j in itertools.product((55, 58, 61, 64, 67), (2.5, 5.0, 10.0, 50.0)))
    ),
    "rounding [um]": (
        "tolerance", tuple({"gain": g, "tolerance": t} for g, t in itertools.product((55, 58, 60, 61, 62, 64, 67), (0.0045, 0.0048, 0.005, 0.0053, 0.0054, 0.006, 0.0065)))
    ),
    "jerk of X, Y and Z [m/s3]": (
        "jerk_xy", tuple({"gain": g, "jerk_xy": j, "jerk_z": j} for g, j in itertools.product((40, 50, 60, 70, 80), (2.0, 3.5, 5.0, 10.0)))
    ),
    "feedforward weight at 50 1/s": (
        "feedforward", tuple({"gain": 50.0, "feedforward": w} for w in (0.0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8))
    ),
}  # fmt: skip

PAPER = {"part 1 fast": 20.0, "part 2 fast": 30.0, "part 2 slow": 5.0}
"""Depths of the paper, against the programmed cut [um]."""
AGREES = 0.10
"""A depth agrees with the paper if it differs by less than this share."""
LINEAR = ("X", "Y", "Z")
BRIEF = 900.0
"""Feed of the slow pass if only the fast one is evaluated [mm/min]: still slow for the zone, but short."""


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
    """Depths [um] of PAPER's marks: the deepest point against the programmed cut, by the feed during the cut."""
    # Z does not move on part 2, and at 0.1 m/min only the tolerance matters
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
    """Report of the cut along the path that a machine follows, with the feedforward of its file."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "part.mpf").write_text(program, encoding="utf-8")
        (Path(folder) / "part.toml").write_text(part, encoding="utf-8")
        read = read_part(Path(folder) / "part.toml")
        levels = levels_of_program(Path(folder) / "part.mpf", machine, read.tool, (PROGRAMMED, FOLLOWED), (None,))
        machining = machine_part(read, levels)
    return report_of(machining, machining.cuts[-1])


def worst(marks: Mapping[str, float]) -> float:
    """Largest relative difference from the paper's depths."""
    return max(abs(marks[name] / depth - 1.0) for name, depth in PAPER.items())


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw one panel per varied quantity, with the tried values side by side; `rows` hold assumptions and depths [um]."""
    figure, axes = new_figure(1, len(PANELS), width=16.0, height=4.0)
    for (title, (key, asked)), ax in zip(PANELS.items(), axes[0]):
        fields = Assumptions.__dataclass_fields__
        wanted = {Assumptions(**one) for one in asked}
        mine = {Assumptions(**{k: v for k, v in row.items() if k in fields}): {name: row[name] for name in PAPER} for row in rows}
        across = sorted({getattr(a, "feedforward" if key == "feedforward" else "gain") for a in wanted})
        up = sorted({getattr(a, key) for a in wanted})
        for assumed in wanted:
            marks = mine[assumed]
            off = worst(marks)
            colour = GREEN if off <= AGREES else AMBER if off <= 2 * AGREES else RED if off <= 1.0 else SOFT
            value = getattr(assumed, key)
            x, y = (across.index(value), 1e2 * off) if key == "feedforward" else (across.index(assumed.gain), up.index(value))
            ax.plot(x, y, "o", color=colour, ms=9)
            ax.annotate(
                "/".join(f"{marks[n]:.0f}" for n in PAPER), (x, y), xytext=(0, 7), textcoords="offset points", ha="center", fontsize=6.5
            )
        ax.set_title(title)
        ax.set_xlabel("weight" if key == "feedforward" else "position gain [1/s]")
        ax.set_ylabel("worst difference [%]" if key == "feedforward" else title)
        ax.set_xticks(range(len(across)), [f"{one:g}" for one in across])
        if key != "feedforward":
            ax.set_yticks(range(len(up)), [f"{one * (1e3 if key == 'tolerance' else 1.0):g}" for one in up])
        ax.margins(0.12)
    figure.suptitle(
        "Depth of the marks [um]: part 1 / part 2 fast / part 2 slow; paper 20 / 30 / 5; green: all within 10 %, amber: 20 %, red: 100 %",
        fontsize=11,
    )
    save_png(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures" / "paper" / "assumptions.png")
    args = parser.parse_args()
    rows = []
    for _, (_, asked) in PANELS.items():
        for one in asked:
            marks = marks_of(Assumptions(**one))
            rows.append({**one, **marks})
            print(one, {name: round(depth, 2) for name, depth in marks.items()}, f"worst {worst(marks):.1%}", flush=True)
    draw(rows, args.out)


if __name__ == "__main__":
    main()
