"""Identify a production machine with a SINUMERIK 840D sl from its recording, and compare the simulated axes with it.

    python examples/real/sinumerik/run.py recording.json [--out out/sinumerik]

`recording.json` is a recording of SINUMERIK Edge ("Capture4Analysis") as published with the MIT-licensed project CaptureDataParser; it is not
part of this repository. The script imports it, makes a machine of all but its last run (there is no data sheet), and compares measurement and
simulation on the run left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

import numpy as np

from twin.cli.parser import show_and_run
from twin.errors import TwinError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.campaign import Campaign, read_campaign
from twin.remedy.advice import PULSE
from twin.remedy.change import Change
from twin.simulation.added_feedforward import added_feedforward
from twin.simulation.campaign_file import write_campaign
from twin.simulation.gap import is_moving, predict
from twin.simulation.setpoints import setpoints_of
from twin.simulation.summary import table


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=Path, metavar="recording.json", help="the recording of the control")
    parser.add_argument("--diagnose", action="store_true", help="also diagnose the recording against the identified machine")
    parser.add_argument("--out", type=Path, default=Path("out/sinumerik"), metavar="DIR", help="folder for all results")
    args = parser.parse_args(arguments)
    if not args.recording.is_file():
        print(f"run.py: {args.recording}: no such file; skipped. Give the recording of the project CaptureDataParser", file=sys.stderr)
        return 2
    out = args.out
    try:
        show_and_run("import", args.recording, "--out", out / "campaign")
        write_campaign({run.name: run for run in read_campaign(out / "campaign").runs[:-1]}, out / "fitted")
        show_and_run("machine", "new", "--from-recording", out / "fitted", "--out", out / "identified" / "machine.toml")
        machine = load_machine(out / "identified" / "machine.toml")
        campaign = read_campaign(out / "campaign", machine)
        print(summary_text(machine, campaign))
        compensated = with_recorded_pulses(machine, campaign)
        write_machine(compensated, out / "compensated" / "machine.toml")
        print(
            "\nfriction compensation in the recorded feedforward: "
            + "; ".join(f"axis {a.name}: {b.text(a.kind)}" for a in compensated.axes for b in a.blocks)
        )
        show_and_run(
            "remedy",
            out / "compensated" / "machine.toml",
            "--program",
            out / "campaign" / f"{campaign.runs[0].name}.parquet",
            "--target-um",
            "0.1",
            "--out",
            out / "remedy",
        )
        if args.diagnose:
            show_and_run("diagnose", out / "campaign", "--machine", out / "identified" / "machine.toml", "--out", out / "diagnosis")
    except TwinError as error:
        print(f"run.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def summary_text(machine: Machine, campaign: Campaign) -> str:
    """Gap of each axis on the run left out, as share of the following error and of the range of the current."""
    predictions = {run.name: predict(machine, run).trace for run in campaign.runs}
    fed = [added_feedforward(run.trace, machine, setpoints_of(run.trace, machine).at) for run in campaign.runs]
    trace = campaign.runs[-1].trace
    simulated = predictions[campaign.runs[-1].name]
    rows, pulses = [], []
    for a, axis in enumerate(machine.axes):
        moving = is_moving(trace, axis)
        setpoint, position, current = (trace.get(axis.name, signal) for signal in ("setpoint", "position", "current"))
        delayed = np.interp(trace.time - best_delay(campaign, axis.name), trace.time, setpoint)
        e, f, d = (rms((position - other)[moving]) for other in (simulated.get(axis.name, "position"), setpoint, delayed))
        i = rms((current - simulated.get(axis.name, "current"))[moving])
        whole = [run.trace.get(axis.name, "current") for run in campaign.runs]
        pulse = max((float(np.abs(one[:, a]).max()) for one in fed if one is not None), default=0.0)
        pulses.append(f"{axis.name} {pulse * 1e3:.3f} mm/s")
        whole_lag = [run.trace.get(axis.name, "position") - run.trace.get(axis.name, "setpoint") for run in campaign.runs]
        whole_gap = [run.trace.get(axis.name, "position") - predictions[run.name].get(axis.name, "position") for run in campaign.runs]
        standing = np.concatenate([(g - g.mean())[~is_moving(run.trace, axis)] for g, run in zip(whole_gap, campaign.runs)])
        anywhere = [np.concatenate([x[is_moving(r.trace, axis)] for x, r in zip(w, campaign.runs)]) for w in (whole_gap, whole_lag)]
        share = rms(anywhere[0]) / rms(anywhere[1])
        frequency = strongest(whole_gap, campaign.runs[0].trace.period)
        span = float(np.ptp(np.concatenate(whole)))
        rows.append([axis.name, f"{f * 1e6:.1f}", f"{e * 1e6:.2f}", f"{100 * e / f:.2f} %", f"{100 * share:.2f} %", f"{i:.3f}", f"{100 * i / span:.1f} %", f"{100 * d / f:.0f} %", f"{rms(standing) * 1e6:.2f}", f"{frequency:.0f}"])  # fmt: skip
    heading = ["axis", "following error [um RMS]", "gap [um RMS]", "of it", "of it in all motion", "gap of the current [A RMS]", "of its range", "residual of a pure delay", "gap at rest [um RMS]", "strongest at [Hz]"]  # fmt: skip
    said = f"\nlargest pulse of the recorded feedforward in addition to the slope of the set points: axis {', axis '.join(pulses)}"
    return "\non the run left out:\n" + table(heading, rows, left=1) + said


LEAST_PULSE = 0.02
"""Smallest share of the largest pulse that is read: what is left of it after four decay times."""

SAME_RATIO = 0.01
"""Largest median deviation of the ratios of neighbours that is one decay; those of noise lie anywhere between 0 and 1."""


def pulse_in(rest: np.ndarray, cycle: float) -> dict[str, float] | None:
    """Amplitude and decay time of the pulses in what a recorded feedforward holds beyond the slope of its set points (sample,), one sample a cycle.

    The decay is the median ratio of neighbours, the amplitude the median size where a large pulse begins. None if the ratios scatter, as those of noise do,
    or if nothing decays within a quarter of the record.
    """
    size = np.abs(rest)
    seen = size > LEAST_PULSE * size.max()
    later, before = seen[1:], seen[:-1]
    falls = later & before & (rest[1:] * rest[:-1] > 0.0) & (size[1:] < size[:-1])
    begins = later & ~falls & (size[1:] > 0.5 * size.max())
    if not falls.any() or not begins.any():
        return None
    ratios = size[1:][falls] / size[:-1][falls]
    ratio = float(np.median(ratios))
    decay = -cycle / math.log(ratio)
    if np.median(np.abs(ratios - ratio)) > SAME_RATIO or decay > 0.25 * len(rest) * cycle:
        return None
    return {"amplitude": float(np.median(size[1:][begins])), "decay_time": decay}


def with_recorded_pulses(machine: Machine, campaign: Campaign) -> Machine:
    """The machine whose control makes the pulses itself that are recorded in its feedforward, with their amplitude and decay."""
    for run in campaign.runs:
        fed = added_feedforward(run.trace, machine, setpoints_of(run.trace, machine).at)
        for i, axis in enumerate(machine.axes):
            if fed is not None and not machine.axis(axis.name).blocks and (found := pulse_in(fed[:, i], run.trace.period)) is not None:
                machine = Change(axis.name, PULSE, values=found).applied(machine)
    return machine


def best_delay(campaign: Campaign, axis: str) -> float:
    """Delay [s] of the set point that fits the position of the fitted runs best, as a reference without a simulation."""
    delays = np.arange(0.0, 0.03, 1e-4)
    left = np.zeros(len(delays))
    for run in campaign.runs[:-1]:
        time, setpoint, position = run.trace.time, run.trace.get(axis, "setpoint"), run.trace.get(axis, "position")
        left += [np.sum((position - np.interp(time - d, time, setpoint)) ** 2) for d in delays]
    return float(delays[np.argmin(left)])


def strongest(parts: Sequence[np.ndarray], period: float) -> float:
    """Frequency [Hz] of the largest component in the longest part."""
    longest = max(parts, key=len)
    spectrum = np.abs(np.fft.rfft((longest - longest.mean()) * np.hanning(len(longest))))
    return float(np.fft.rfftfreq(len(longest), period)[int(np.argmax(spectrum))])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
