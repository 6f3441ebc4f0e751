"""Peak memory of commands, each in a process of its own, as a table for docs/promises.md.

    python -m devtools.measure_memory CAMPAIGN...    diagnose of each campaign, import of a text of 500 MB, cut of the dome

On Linux and macOS. The peak is the largest resident memory of the process and of those that it waited for.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import subprocess
import sys
import tempfile

import numpy as np

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
TEXT_BYTES = 500_000_000


def peak(*words: object) -> tuple[float, float, int]:
    """(peak memory [GB], processor time [s], exit code) of a command."""
    process = subprocess.Popen([sys.executable, "-m", "twin", *map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return unit * used.ru_maxrss / 1e9, used.ru_utime + used.ru_stime, os.waitstatus_to_exitcode(status)


def text_recording(path: Path, size: int = TEXT_BYTES) -> Path:
    """A recording of one axis of about this many bytes."""
    rows, block = 0, 200_000
    with path.open("w", encoding="ascii") as file:
        file.write("time [s],X.setpoint [mm],X.position [mm],X.velocity [mm/s]\n")
        while file.tell() < size:
            time = (rows + np.arange(block)) * 1e-3
            values = np.column_stack([time, 50 * np.sin(time), 50 * np.sin(time - 0.01), 50 * np.cos(time - 0.01)])
            np.savetxt(file, values, "%.9f", ",")
            rows += block
    return path


def main(campaigns: Sequence[str]) -> int:
    """Print the table; 1 if a command failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        commands: list[tuple[str, tuple[object, ...]]] = [
            (f"diagnose {Path(c).name}", ("diagnose", c, "--out", Path(folder) / f"d{i}")) for i, c in enumerate(campaigns)
        ]
        text = text_recording(Path(folder) / "text.csv")
        commands.append((f"import of {text.stat().st_size / 1e6:.0f} MB", ("import", text, "--out", Path(folder) / "c")))
        dome = EXAMPLES / "parts" / "part3_dome"
        commands.append(("cut of the dome", ("cut", f"{dome}.mpf", "--part", f"{dome}.toml", "--out", Path(folder) / "cut")))
        print("| command | peak memory | processor time |\n|---|---|---|")
        for label, words in commands:
            memory, seconds, code = peak(*words)
            failed |= code not in (0, 1)
            print(f"| {label} | {memory:.2f} GB | {seconds:.0f} s |" + (f" exit code {code}" if code else ""), flush=True)
    return failed


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
