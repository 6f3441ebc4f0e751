#!/usr/bin/env python3
"""Memory and time of `twin import` on a large CSV: peak resident set of the process at two sizes.

    scripts/measure_import.py [--gigabytes 1.0] [--folder DIR]

Needs about three times the size of the file on the disk of DIR.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np
import pyarrow as pa
import pyarrow.csv

MAP = """
[[column]]
name = "s"
axis = "X"
signal = "setpoint"
unit = "mm"
[[column]]
name = "x"
axis = "X"
signal = "position"
unit = "mm"
[[column]]
name = "v"
axis = "X"
signal = "velocity"
unit = "m/min"
[[column]]
name = "i"
axis = "X"
signal = "current"
unit = "A"
"""
ROWS = 200_000
PERIOD_S = 125e-6


def write_csv(path: Path, size: int) -> int:
    """A CSV of at least `size` bytes, sampled every 125 us; returns its rows."""
    rng = np.random.default_rng(1)
    rows = 0
    with open(path, "wb") as file:
        while file.tell() < size:
            t = (rows + np.arange(ROWS)) * PERIOD_S
            phase = 2.0 * np.pi * 0.5 * t
            speed = 100.0 * np.pi * np.cos(phase)
            columns = {
                "time [s]": np.round(t, 6),
                "s": 100.0 * np.sin(phase),
                "x": 100.0 * np.sin(phase - 0.01) + 1e-4 * rng.standard_normal(ROWS),
                "v": speed * 0.06,
                "i": 2.0 * np.tanh(speed) + 0.05 * rng.standard_normal(ROWS),
                "not wanted": rng.standard_normal(ROWS),
            }
            options = pyarrow.csv.WriteOptions(include_header=rows == 0)
            pyarrow.csv.write_csv(pa.table(columns), file, write_options=options)
            rows += ROWS
    return rows


def measure(folder: Path, size: int) -> None:
    """Write, import in a process of its own, tell its peak and time."""
    source, mapping, out = folder / "big.csv", folder / "map.toml", folder / "campaign"
    rows = write_csv(source, size)
    mapping.write_text(MAP, encoding="utf-8")
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "import", str(source), "--map", str(mapping), "--out", str(out)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    text = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit("the import failed")
    seconds = time.perf_counter() - begin
    told = next(line for line in text.splitlines() if line.startswith("big, "))
    print(
        f"{source.stat().st_size / 1e9:.2f} GB, {rows:,} rows: {seconds:.0f} s, peak {usage.ru_maxrss / 1024:.0f} MiB, "
        f"parquet {(out / 'big.parquet').stat().st_size / 1e9:.2f} GB ({told})"
    )
    source.unlink()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--folder", help="where the file is made (default: the system's temporary folder)")
    args = parser.parse_args()
    for part in (0.01, 0.25, 1.0):
        with tempfile.TemporaryDirectory(prefix="twin_measure_import_", dir=args.folder) as folder:
            measure(Path(folder), int(part * args.gigabytes * 1e9))
    return 0


if __name__ == "__main__":
    sys.exit(main())
