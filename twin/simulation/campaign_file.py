"""Write a campaign: simulated runs, or the runs of another campaign, as a folder that `read_campaign` reads."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
import warnings

import msgspec
import numpy as np
import tomlkit

from twin.errors import InputError
from twin.files import output_folder, write_whole
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace, write_trace
from twin.simulation.result import Run


def write_campaign(runs: Mapping[str, Run | Trace | MeasuredRun], folder: str | Path, feedforward: str | None = None) -> Path:
    """Write runs by name to `folder`: one parquet file each, and `campaign.toml`. Returns the folder.

    `feedforward` (off, velocity, velocity+torque) was on in all runs; None: as the machine file says. A `MeasuredRun` keeps its own, with
    start time and findings. A run that was simulated without `noise_seed` has ideal sensors, which no measured run has: a diagnosis with
    the noise of the machine file then finds less noise than it expects, so a warning says so.

    Raises InputError if there is no run, a name is no file name, or the folder cannot be written.
    """
    if not runs:
        raise InputError("write_campaign: no run; give at least one as {'stroke': run}")
    out = output_folder(Path(folder))
    entries = []
    for name, run in runs.items():
        if not name or Path(name).name != name or name in (".", ".."):
            raise InputError(f"write_campaign: '{name}' cannot name a file; use letters, digits, - and _")
        if isinstance(run, Run) and _is_ideal(run):
            warnings.warn(
                f"run {name} has no measuring noise; simulate it with noise_seed=1 to diagnose it like a measured one", stacklevel=2
            )
        trace = run if isinstance(run, Trace) else run.trace
        measured = run if isinstance(run, MeasuredRun) else MeasuredRun(name, trace, feedforward, 0.0)
        write_trace(trace, out / f"{name}.parquet")
        entry: dict[str, Any] = {"file": f"{name}.parquet", "started_at_s": round(measured.started_at, 6)}
        optional = {
            "feedforward": measured.feedforward,
            "channel": [msgspec.to_builtins(fact) for fact in measured.facts.values()],
            "labels": dict(measured.labels),
            "ballbar": measured.ballbar and {"axes": list(measured.ballbar.axes), "noise_m": measured.ballbar.noise},
        }
        entries.append(entry | {key: value for key, value in optional.items() if value})
    write_whole(out / "campaign.toml", tomlkit.dumps({"run": entries}))
    return out


def _is_ideal(run: Run) -> bool:
    """Was the run simulated without the measuring noise that its machine file gives?"""
    noisy = any(value > 0.0 for key, value in run.machine.document.get("measurement", {}).items() if "noise" in key)
    return noisy and all(np.array_equal(values, run.without_noise.signals[key]) for key, values in run.trace.signals.items())
