"""Fuzz all commands with corrupted files, folders, recordings and programs, and with unusual options.

scripts/fuzz --cases 2000 --seed 1              all kinds in turn
scripts/fuzz --cases 500 --only machine         one kind; --list prints their names
scripts/fuzz --cases 1 --seed 1234 --only map   repeat one case
"""

from __future__ import annotations

import argparse
import functools
import math
from pathlib import Path
import random
import time

from devtools import fuzz_claims, fuzz_files, fuzz_folders, fuzz_packed, fuzz_programs, fuzz_recordings
from devtools.fuzz_loop import SECONDS, Case, fuzz

RARELY = ("chain", "claims", "study", "study_folder", "study_cells", "exam", "diagnose", "plan", "height")
"""Kinds whose cases take longer than others."""


def kinds(data: Path) -> dict[str, Case]:
    """All kinds by name."""
    return {
        **fuzz_files.all_kinds(),
        **fuzz_folders.all_kinds(),
        "program": program,
        "packed": fuzz_packed.packed,
        "recording": lambda seed, folder: fuzz_recordings.recording(seed, folder, fuzz_recordings.real(data))[1],
        "chain": lambda seed, folder: fuzz_recordings.chain(seed, folder, fuzz_recordings.real(data), no_refine=True)[1],
        "claims": lambda seed, folder: fuzz_claims.on_real(seed, folder, data),
    }


@functools.cache
def _mikron() -> object:
    from twin.machine.machine import load_machine

    return load_machine()


def program(seed: int, folder: Path) -> str:
    """A mutated program is refused in one line, or its normalised print is read with the same meaning."""
    rng = random.Random(f"program {seed}")
    name = rng.choice(sorted(fuzz_programs.SAMPLES))
    text = fuzz_programs.mutate(fuzz_programs.SAMPLES[name], rng)
    try:
        fuzz_programs.check(name, text, _mikron(), folder)  # type: ignore[arg-type]
    except AssertionError as error:
        return f"{name}: {error}"
    except Exception as error:
        return f"{name}: {type(error).__name__}: {error}"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", metavar="KIND")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="processor time that one case may take")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with recordings of real machines, if any")
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--list", action="store_true", help="print the names of the kinds")
    args = parser.parse_args()
    known = kinds(args.data.resolve())
    if args.list or not set(args.only or known) <= set(known):
        print("\n".join(known))
        return 0 if args.list else 2
    begin = time.monotonic()
    chosen = {k: v for k, v in known.items() if k in (args.only or known)}
    tally = fuzz(chosen, args.cases, args.seed, lambda s: print(s, flush=True), args.seconds, args.minutes, RARELY)
    took = time.monotonic() - begin
    for kind, count in tally.cases.items():
        print(f"{kind:<14}{count:>6} cases {1e3 * tally.seconds[kind] / count:>7.0f} ms each")
    print(f"{tally.total} cases in {took:.0f} s, {sum(tally.seconds.values()):.0f} s of processor time; {len(tally.faults)} faults")
    return 1 if tally.faults else 0


if __name__ == "__main__":
    raise SystemExit(main())
