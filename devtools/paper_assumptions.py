"""Which assumptions agree with the paper's marks: a picture of the set, docs/pictures/paper/assumptions.png.

    python -m devtools.paper_assumptions          80 combinations, some minutes

Each point is one combination; green agrees with all three marks within 10 %. One thing is varied against the gain, the others stay as in `Assumptions`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import itertools
from pathlib import Path
from typing import Any

from devtools.paper_marks import AGREES, PAPER, Assumptions, marks_of, worst
from twin.report.figure import AMBER, GREEN, RED, SOFT, new_figure, save_png

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


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """One panel for each thing varied; `rows` hold the assumptions and the depths [um]."""
    figure, axes = new_figure(1, len(PANELS), width=14.0, height=4.0)
    for (title, (key, asked)), ax in zip(PANELS.items(), axes[0]):
        fields = Assumptions.__dataclass_fields__
        wanted = {Assumptions(**one) for one in asked}
        mine = [row for row in rows if Assumptions(**{k: v for k, v in row.items() if k in fields}) in wanted]
        for row in mine:
            marks = {name: row[name] for name in PAPER}
            assumed = Assumptions(**{k: v for k, v in row.items() if k in fields})
            off = worst(marks)
            colour = GREEN if off <= AGREES else AMBER if off <= 2 * AGREES else RED if off <= 1.0 else SOFT
            factor = 1e3 if key == "tolerance" else 1.0
            x, y = (assumed.feedforward, 1e2 * off) if key == "feedforward" else (assumed.gain, getattr(assumed, key) * factor)
            ax.plot(x, y, "o", color=colour, ms=9)
            ax.annotate(
                "/".join(f"{marks[n]:.0f}" for n in PAPER), (x, y), xytext=(0, 7), textcoords="offset points", ha="center", fontsize=6.5
            )
        ax.set_title(title)
        ax.set_xlabel("weight" if key == "feedforward" else "position gain [1/s]")
        ax.set_ylabel("worst difference [%]" if key == "feedforward" else title)
        if key in ("jerk_z", "jerk_xy"):
            ax.set_yscale("log")
        ax.margins(0.12)
    figure.suptitle(
        "Depth of the marks [um]: part 1 / part 2 fast / part 2 slow; paper 20 / 30 / 5; green: all within 10 %, amber: 20 %", fontsize=11
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
