"""Watch a machine: record it every week, let a backlash grow, and let `twin watch` find since when, by what cause, and when it has to be mended.

    python examples/watch/run.py [--out out/watch] [--weeks 16]

The machine is the second plant, which shares no code with the twin. Each week it runs the same three seconds of a program. The friction of all axes
follows a season, each axis scatters by 1 %, and from the ninth week on X has a backlash that grows by 1.5 um a week. The twin knows none of this.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date, timedelta
import math
from pathlib import Path
import sys
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.cli import main as twin
from twin.exam.draw import SHIPPED_MACHINE, SIGNALS, columns_of, draw_case, simulate
from twin.exam.paths import limits_of, path_of, together
from twin.exam.plant.parameters import AXES
from twin.exam.programme import TestRun

ONSET, UM_PER_WEEK = 8, 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/watch"), metavar="DIR", help="folder for the weeks and the history")
    parser.add_argument("--weeks", type=int, default=16, help="weeks to record (default 16)")
    args = parser.parse_args()
    sheet, rng = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8")), np.random.default_rng(1)
    machine = draw_case(1, "healthy", sheet)
    run = program(sheet)
    print(f"recording {args.weeks} weeks on the second plant, which is compiled first", flush=True)
    for week in range(args.weeks):
        season = 1.0 + 0.08 * math.cos(2.0 * math.pi * week / 52.0)
        worn = [{"name": "viscous_friction", "axis": axis, "factor": season + rng.normal(0.0, 0.01)} for axis in AXES]
        if week >= ONSET:
            worn.append({"name": "backlash", "axis": "X", "clearance": 1e-6 * UM_PER_WEEK * (week - ONSET + 1)})
        trace = simulate(replace(machine, effects=tuple(worn), noise_seed=week), sheet, run)
        folder = args.out / "weeks" / (date(2026, 1, 5) + timedelta(weeks=week)).isoformat()
        folder.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns_of(trace, SIGNALS["full"])), folder / "program.parquet")
        text = f'machine = "mikron_ucp710"\nrecorded = {folder.name}\n[[run]]\nfile = "program.parquet"\nfeedforward = "velocity+torque"\n'
        (folder / "campaign.toml").write_text(text, encoding="utf-8")
    code = twin(["watch", str(args.out / "weeks"), "--out", str(args.out / "history")])
    sys.exit(0 if code == 1 else f"no alarm (exit code {code})")


def program(sheet: dict) -> TestRun:
    """Moves of all axes there and back at three speeds [mm, degrees]."""
    limits, columns = limits_of(sheet), []
    for k in range(5):
        unit = 1e-3 if k < 3 else math.radians(1.0)
        start, places, speeds = (-30.0 if k == 3 else 0.0), (30.0, 45.0, 40.0, 0.0), (100.0, 30.0, 8.0, 160.0)
        targets = [unit * (start + place) for place in places]
        columns.append(path_of(unit * start, targets, [unit * v for v in speeds], 2.0, 0.9 * limits.jerk[k], 0.08))
    return TestRun("program", "program", "velocity+torque", together(columns)[:3000])


if __name__ == "__main__":
    main()
