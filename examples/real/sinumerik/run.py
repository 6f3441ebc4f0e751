"""A production machine under a SINUMERIK 840D sl: from its recording to a simulated axis, in one command.

    python examples/real/sinumerik/run.py recording.json [--out out/sinumerik]

`recording.json` is a recording of SINUMERIK Edge ("Capture4Analysis") as published with the MIT-licensed project CaptureDataParser; it is not
part of this repository. The script imports it, makes a machine with lumped parameters (there is no data sheet), identifies it on all but the
last part of each axis' motion, and prints what the axis does there: measured against simulated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

import numpy as np

from twin.cli.parser import show_and_run
from twin.errors import TwinError
from twin.identify.held_out import divided
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, read_campaign
from twin.simulation.gap import is_moving, predict
from twin.simulation.summary import table


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=Path, metavar="recording.json", help="the recording of the control")
    parser.add_argument("--diagnose", action="store_true", help="hold the recording against the identified machine, too")
    parser.add_argument("--out", type=Path, default=Path("out/sinumerik"), metavar="DIR", help="folder for all results")
    args = parser.parse_args(arguments)
    if not args.recording.is_file():
        print(f"run.py: {args.recording}: no such file; skipped. Give the recording of the project CaptureDataParser", file=sys.stderr)
        return 2
    out = args.out
    try:
        show_and_run("import", args.recording, "--out", out / "campaign")
        show_and_run("machine", "new", "--from-recording", out / "campaign", "--out", out / "lumped" / "machine.toml")
        start = out / "lumped" / "machine.toml"
        show_and_run(
            "identify",
            out / "campaign",
            "--machine",
            start,
            "--out",
            out / "identified" / "machine.toml",
            "--json",
            out / "identified.json",
        )
        machine = load_machine(out / "identified" / "machine.toml")
        print(summary_text(machine, read_campaign(out / "campaign", machine)))
        if args.diagnose:
            show_and_run("diagnose", out / "campaign", "--machine", out / "identified" / "machine.toml", "--out", out / "diagnosis")
    except TwinError as error:
        print(f"run.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def summary_text(machine: Machine, campaign: Campaign) -> str:
    """Gap of each axis on the part of its motion that was left out, in parts of following error and range of the current."""
    division = divided(machine, campaign.runs)
    predictions = {run.name: predict(machine, run).trace for run in campaign.runs}
    rows = []
    for axis in machine.axes:
        gap, lag, current = [], [], []
        whole = [run.trace.get(axis.name, "current") for run in campaign.runs]
        for i, left_out in division.judged(axis.name):
            run = division.runs[i]
            moving = left_out & is_moving(run.trace, axis)
            simulated = predictions[run.name]
            gap.append((run.trace.get(axis.name, "position") - simulated.get(axis.name, "position"))[moving])
            lag.append((run.trace.get(axis.name, "position") - run.trace.get(axis.name, "setpoint"))[moving])
            current.append((run.trace.get(axis.name, "current") - simulated.get(axis.name, "current"))[moving])
        e, f, i = (rms(np.concatenate(x)) for x in (gap, lag, current))
        span = float(np.ptp(np.concatenate(whole)))
        rows.append([axis.name, f"{f * 1e6:.1f}", f"{e * 1e6:.2f}", f"{100 * e / f:.2f} %", f"{i:.3f}", f"{100 * i / span:.1f} %"])
    heading = ["axis", "following error [um RMS]", "gap [um RMS]", "of it", "gap of the current [A RMS]", "of its range"]
    return "\non the motion that no fit has seen:\n" + table(heading, rows, left=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
