"""Success rate of the diagnosis on single hidden effects of the second plant.

    python devtools/measure_diagnosis.py [--effects backlash loop_delay] [--scale 1.0] [--signals full] [--rich]

Draws one machine per effect, on one axis that can have it, records ten runs, and searches the axes of its group with the whole library.
Prints the found effects, the errors of the scored parameters, and the time. These seeds are for development; the examination has its own.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
import random
import tempfile
import time
import tomllib

from threadpoolctl import threadpool_limits

from twin.diagnose.axis_groups import axis_groups
from twin.diagnose.cross_validation import folds_of
from twin.diagnose.observe import observe
from twin.diagnose.search import search
from twin.diagnose.setup import Setup
from twin.diagnose.verdict import final_state
from twin.diagnose.view import view_of
from twin.exam.draw import draw_case, truth_of, write_campaign
from twin.exam.plant.effects import LIBRARY
from twin.exam.plant.parameters import Richness
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="*", help="only these (default: all 29)")
    parser.add_argument("--scale", type=float, default=1.0, help="size as a multiple of the usual one")
    parser.add_argument("--signals", default="full", help="full, no motor position, no velocity set point, scale and current")
    parser.add_argument("--rich", action="store_true", help="with small compliance, bristles, cogging and Stribeck always on")
    parser.add_argument("--seed", type=int, default=100)
    args = parser.parse_args()
    sheet = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    machine = load_machine()
    axes_of: dict[str, list[str]] = {}
    for effect, axis in ((name, axis) for name, one in LIBRARY.items() for axis in one.axes):
        axes_of.setdefault(effect, []).append(axis)
    rng = random.Random(args.seed)
    rows, right, first = [], 0, 0
    with ThreadPoolExecutor() as pool, threadpool_limits(limits=1, user_api="blas"):
        mapper = pool.map

        for i, (effect, axes) in enumerate(sorted(axes_of.items())):
            axis = rng.choice(axes)
            if args.effects and effect not in args.effects:
                continue
            richness = Richness.small() if args.rich else Richness.off()
            case = draw_case(args.seed + i, "single", sheet, effect=effect, axis=axis, scale=args.scale, richness=richness)
            truth = truth_of(case)["effect"][0]
            with tempfile.TemporaryDirectory() as folder:
                write_campaign(case, Path(folder) / "campaign", sheet, signals=args.signals)
                runs = read_campaign(Path(folder) / "campaign", machine).runs
            start = time.perf_counter()
            views = [view_of(machine, run) for run in runs]
            group = observe(views, next(g for g in axis_groups(machine, machine.axis_names) if axis in g))
            setup = Setup(machine, folds_of(len(views)), mapper, lambda _: None)
            found = final_state(search(replace(group, mapper=mapper), setup))
            named = [(s.effect.name, s.axis) for s in found.fit.settings]
            first += named[:1] == [(effect, axis)]
            right += named == [(effect, axis)]
            errors = []
            if named[:1] == [(effect, axis)]:
                for parameter in found.fit.settings[0].effect.parameters:
                    if not parameter.shape and parameter.name in truth:
                        value, true = found.fit.settings[0].parameters[parameter.name], truth[parameter.name]
                        size = parameter.deviation(true)
                        errors.append(f"{parameter.name} {abs(value - true) / size:.1%}")
            told = ", ".join(f"{e} {a}" for e, a in named) or "none"
            rows.append([f"{effect} {axis}", told, ", ".join(errors), f"{time.perf_counter() - start:.0f} s"])
            print(rows[-1], flush=True)
    print(table(["hidden", "found", "error", "search"], rows, left=3))
    print(f"{len(rows)} machines: first named right {first}, exactly right {right}")


if __name__ == "__main__":
    main()
