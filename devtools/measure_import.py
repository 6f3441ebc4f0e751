#!/usr/bin/env python3
"""Memory and time of `twin import` on a large CSV, or accuracy of the detected time skew of channels.

devtools/measure_import.py [--gigabytes 1.0] [--folder DIR]     peak resident set of the process at three sizes (DIR needs twice the largest)
devtools/measure_import.py --skew ../shared/campaigns           channels of recorded runs as they are, and shifted by 7 samples
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
    """Write a CSV, import it in a process of its own, print its peak memory and time."""
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


def measure_skew(folder: Path, samples: int = 7) -> None:
    """Print the skew detected in recorded runs, and the error for channels shifted by a known time."""
    from twin.recordings.skew import skews_of
    from twin.recordings.trace import read_trace

    files = sorted(folder.glob("*/*.parquet"))
    missed: dict[str, list[float]] = {}
    silent: dict[str, int] = {}
    for file in files:
        trace = read_trace(file)
        for late in skews_of(trace.signals, trace.period, trace.kinds):
            if late.clear:
                told = f"{late.axis}.{late.signal} {late.seconds * 1e3:.3f} ms +- {1.96e3 * late.deviation:.3f}"
                print(f"detected in {file.parent.name}/{file.stem} as recorded: {told}")
        shifted = {k: v if k[1] in ("setpoint", "position") else np.roll(v, samples) for k, v in trace.signals.items()}
        for late in skews_of(shifted, trace.period, trace.kinds):
            if late.clear:
                missed.setdefault(late.signal, []).append(abs(late.seconds - samples * trace.period))
            else:
                silent[late.signal] = silent.get(late.signal, 0) + 1
    print(f"{len(files)} runs; shifted by {samples} samples:")
    for signal, errors in missed.items():
        values = np.array(errors) * 1e6
        print(
            f"  {signal}: detected in {len(values)} cases, uncertain in {silent.get(signal, 0)}; "
            f"error {np.median(values):.3g} us median, {np.percentile(values, 95):.3g} us 95 %"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--folder", help="where the file is made (default: the system's temporary folder)")
    parser.add_argument("--skew", metavar="CAMPAIGNS", help="folder of campaigns")
    args = parser.parse_args()
    if args.skew:
        measure_skew(Path(args.skew))
        return 0
    for part in (0.01, 0.25, 1.0):
        with tempfile.TemporaryDirectory(prefix="twin_measure_import_", dir=args.folder) as folder:
            measure(Path(folder), int(part * args.gigabytes * 1e9))
    return 0


if __name__ == "__main__":
    sys.exit(main())
