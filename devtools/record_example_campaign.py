"""Records examples/campaign: three short runs of a nominal machine on the second plant, with measuring noise.

    python -m devtools.record_example_campaign [FOLDER]

The second plant shares no code with the twin, so the twin's gap on these runs checks its control law and its integration.
"""

from __future__ import annotations

from pathlib import Path
import sys
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.exam.draw import PAUSE_S, SHIPPED_MACHINE, SIGNALS, Case, columns_of, simulate
from twin.exam.paths import DEG, limits_of, path_of, together
from twin.exam.plant.parameters import Richness, unit_factors
from twin.exam.programme import TestRun, _circle, _five_axis

SEED = 20_260_131


def example_runs(machine: dict) -> list[TestRun]:
    """A circle in X and Y, strokes of all axes without feedforward, a small five-axis curve."""
    limits, rng = limits_of(machine), np.random.default_rng(SEED)
    home = np.array([0.0, 0.0, 0.0, -40.0 * DEG, 20.0 * DEG])
    there = [
        path_of(home[k], [home[k] + d, home[k]], [v] * 2, 0.8 * limits.acceleration[k], 0.9 * limits.jerk[k], 0.1) for k, d, v in _strokes()
    ]
    return [
        TestRun("circle_xy", "test", "velocity+torque", _circle(0, 1, 0.02, 0.1, 1, limits)),
        TestRun("strokes_ff_off", "test", "off", together(there)),
        TestRun("five_axis", "test", "velocity+torque", _five_axis(limits, rng, home, (1, 2, 1, 1, 1), size=0.25)[:2000]),
    ]


def _strokes() -> list[tuple[int, float, float]]:
    """Axis, distance [m, rad] and speed [m/s, rad/s] of the strokes."""
    return [(0, 0.05, 0.2), (1, -0.05, 0.2), (2, -0.04, 0.15), (3, 15.0 * DEG, 50.0 * DEG), (4, -30.0 * DEG, 80.0 * DEG)]


def record(folder: Path, case: Case, machine: dict) -> None:
    """Write the runs of a case and their campaign.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    lines, at = ["# recorded on the second plant: python -m devtools.record_example_campaign\n" + 'machine = "mikron_ucp710"\n'], 0.0
    for test in example_runs(machine):
        trace = simulate(case, machine, test, at)
        # set points in double precision, because they are differentiated twice; measured signals in single precision (4 nm at 50 mm)
        columns = columns_of(trace, SIGNALS["no velocity set point"])
        table = pa.table(
            {name: v if "setpoint" in name or name.startswith("time") else v.astype(np.float32) for name, v in columns.items()}
        )
        pq.write_table(
            table,
            folder / f"{test.name}.parquet",
            compression="zstd",
            compression_level=19,
            use_dictionary=False,
            use_byte_stream_split=True,
        )
        lines.append(f'[[run]]\nfile = "{test.name}.parquet"\nfeedforward = "{test.feedforward}"\nstarted_at_s = {at:.3f}\n')
        at = round(at + len(trace.time) * 1e-3 + PAUSE_S, 3)
        print(f"{test.name}: {len(trace.time)} samples, {(folder / test.name).with_suffix('.parquet').stat().st_size / 1e3:.0f} kB")
    (folder / "campaign.toml").write_text("\n".join(lines), encoding="utf-8")


def main() -> None:
    """Write the campaign."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/campaign")
    machine = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    record(folder, Case(SEED, "healthy", 1.0, (), unit_factors(), Richness.off()), machine)


if __name__ == "__main__":
    main()
