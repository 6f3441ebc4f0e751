#!/usr/bin/env python3
"""False alarms of the regression suite: repeated runs of the unchanged twin, with 1 and 2 processes and threads.

    python devtools/measure_regress_alarms.py [--repeats 20] [--only NAME] [--traces] [--processes N] [--fresh] [--plain]

Prints the number of failed cases and the largest difference over tolerance. `--traces` leaves out the few long cases. `--fresh`
recompiles everything for each repeat, in a copy of the package; `--plain` emulates a processor without AVX and fused multiply-add,
whose instructions round differently.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time

from twin.regress.suite import read_suite

HERE = Path(__file__).resolve().parents[1]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


PLAIN = {
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3",
}


def once(folder: Path, count: int, only: list[str], more: dict[str, str]) -> tuple[int, list[dict]]:
    """Exit code and cases of one run of the suite in a folder with the package."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "twin", "regress", str(folder / "examples/regression"), "--out", out, "--jobs", str(count)]
        command += [word for name in only for word in ("--only", name)]
        environment = {**os.environ, "PYTHONPATH": str(folder), **dict.fromkeys(THREADS, str(count)), **more}
        ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900, check=False)
        file = Path(out) / "regress.json"
        if not file.is_file():
            sys.exit(f"measure_regress_alarms: the suite does not run: {ran.stderr.strip()}")
        return ran.returncode, json.loads(file.read_text(encoding="utf-8"))["cases"]


def nearest(cases: list[dict]) -> tuple[float, str]:
    """The largest difference over tolerance, and its case and quantity."""
    shares = [(c["found"] / c["allowed"], f"{case['name']} {c['quantity']}") for case in cases for c in case["checks"] if c["allowed"]]
    return max(shares, default=(0.0, "-"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--only", action="append", default=[], help="as in twin regress")
    parser.add_argument("--traces", action="store_true", help="only the cases with traces (of kind run)")
    parser.add_argument("--fresh", action="store_true", help="recompile everything for each repeat")
    parser.add_argument("--plain", action="store_true", help="as on a processor without AVX and fused multiply-add")
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2], metavar="N", help="processes and threads (default: 1 and 2)")
    args = parser.parse_args()
    if args.traces:
        args.only += [case.name for case in read_suite(HERE / "examples/regression") if case.kind == "run"]
    alarms = 0
    for count in args.processes:
        began, failed, worst, number = time.perf_counter(), 0, (0.0, "-"), 0
        for _ in range(args.repeats):
            with tempfile.TemporaryDirectory() as base:
                folder = HERE
                if args.fresh:
                    folder = Path(base)
                    for name in ("twin", "models", "examples"):
                        shutil.copytree(HERE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
                code, cases = once(folder, count, args.only, PLAIN if args.plain else {})
            for case in cases:
                if case["status"] in ("failed", "error"):
                    failed += 1
                    print(f"  {case['name']}: {case['text']}", flush=True)
            number += len(cases)
            worst = max(worst, nearest(cases))
            alarms += code != 0
        each = (time.perf_counter() - began) / args.repeats
        print(
            f"{count} {'process' if count == 1 else 'processes'}, {args.repeats} repeats, {number // args.repeats} cases each: {failed} false alarms; "
            f"largest difference {worst[0]:.2g} of its tolerance ({worst[1]}); {each:.1f} s each",
            flush=True,
        )
    return 1 if alarms else 0


if __name__ == "__main__":
    sys.exit(main())
