"""`twin iso 230-2|230-4 INPUT`: positioning and circles by ISO 230."""

from __future__ import annotations

from collections.abc import Callable
import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.cli.arguments import MACHINE, Args, arg, flag, machine_of, positive, runs_of
from twin.errors import InputError
from twin.files import output_file, shipped_example, write_json
from twin.progress import Progress
from twin.units import AXIS_UNITS, in_words

if TYPE_CHECKING:
    from twin.iso230.circles import CircleTest
    from twin.machine.machine import Machine
    from twin.recordings.campaign import MeasuredRun

ARGUMENTS = (
    ("standard", {"choices": ("230-2", "230-4"), "metavar": "230-2|230-4", "help": "230-2: positioning of an axis; 230-4: circles"}),
    arg("input", "INPUT", "table of readings (.csv), trace, run folder or campaign", type=shipped_example),
    arg("--json", "FILE", "write the results as JSON, with the plot beside it"),
    arg("--plot", "FILE", "plot file (default: beside --json, else out/iso_STANDARD.png)"),
    arg("--axis", "AXIS", "230-2: only this axis of a trace"),
    flag("--no-predict", "230-4: do not simulate the circle"),
    arg("--radius-mm", "MM", "230-4: radius of a ballbar test", type=positive),
    arg("--feed-mm-per-min", "F", "230-4: feed of a ballbar test", type=positive),
    arg("--feedforward", "F", "230-4: feedforward of a ballbar test: off | velocity | velocity+torque (default: from the machine file)"),
    arg("--plane", "XY", "230-4: plane of a ballbar test (default: XY)", default="XY"),
    arg("--diagnosis", "DIR", "230-4: output folder of 'twin diagnose'; adds the corrected twin and the contribution of each effect"),
    arg("--campaign", "DIR", "230-4: also write the ballbar test as a campaign for 'twin diagnose'"),
    MACHINE,
)


def carry_out(args: Args) -> None:
    """Evaluate; print and write results and plot."""
    if not Path(args.input).exists():
        raise InputError(f"{args.input}: no such file or folder; give a table of readings (.csv), a trace, a run folder or a campaign")
    machine = machine_of(args)
    written = output_file(args.json) if args.json else Path(f"out/iso_{args.standard}.json")
    plot = Path(args.plot) if args.plot else written.with_suffix(".png")
    document = (_positioning if args.standard == "230-2" else _circles)(args, Path(args.input), machine, plot)
    if args.json:
        write_json(document, written, "iso230")
        print(f"written: {args.json}")
    print(f"written: {plot}")


def _positioning(args: Args, source: Path, machine: Machine, plot: Path) -> dict[str, Any]:
    from twin.iso230.plots import draw_positioning
    from twin.iso230.positioning import positioning
    from twin.iso230.readings import is_table, positions_of_trace, read_positions
    from twin.simulation.summary import table

    readings, kinds, problems = {}, {}, []
    if source.is_file() and is_table(source):
        readings[""], kinds[""] = read_positions(source)
    else:
        for run in runs_of(source, machine):
            for axis in run.trace.axes:
                if run.trace.moves(axis) and args.axis in (None, axis) and axis not in readings:
                    try:
                        readings[axis], kinds[axis] = positions_of_trace(run.trace, axis, run.name), machine.axis(axis).kind
                    except InputError as error:
                        problems.append(str(error))
        if not readings:
            raise InputError(problems[0] if problems else f"{source}: no axis moves{f' like {args.axis}' if args.axis else ''}")
    results = {axis: positioning(one) for axis, one in readings.items()}
    draw_positioning(results, kinds, plot)
    print("ISO 230-2, k = 2")
    axes, said = {}, []
    for axis, result in results.items():
        (unit, factor), (large, scale) = AXIS_UNITS[kinds[axis]].error, AXIS_UNITS[kinds[axis]].position
        found = {name: f"{value * factor:.2f}" for name, value in result.numbers.items()}
        rows = [[name, found[name], *(found.get(f"{name}_{way}", "-") for way in ("forward", "backward"))] for name in "AREMB"]
        rows.append(["mean B", found["B_mean"], "-", "-"])
        said.append(f"{f'axis {axis}: ' if axis else ''}{', '.join(f'{name} {found[name]}' for name in 'ARB')} {unit}")
        print(f"{f'axis {axis}: ' if axis else ''}{len(readings[axis].target)} positions")
        print(table([f"{f'axis {axis}, ' if axis else ''}{unit}", "both directions", "forward", "backward"], rows, left=1))
        columns = {
            "target": result.target, "mean_forward": result.mean[0], "mean_backward": result.mean[1],
            "s_forward": result.spread[0], "s_backward": result.spread[1], "B": result.mean[0] - result.mean[1],
        }  # fmt: skip
        positions = [{name: float(values[i] * scale) for name, values in columns.items()} for i in range(len(result.target))]
        numbers = {name: value * scale for name, value in result.numbers.items()}
        axes[axis] = {"unit": large, **numbers, "cycles": readings[axis].forward.shape[1], "positions": positions}
    print("A accuracy, R repeatability, E systematic deviation, M mean systematic deviation, B reversal value")
    only = next(iter(axes.values())) if len(axes) == 1 else {}
    return {"standard": "ISO 230-2", "verdict": "; ".join(said), "k": 2, **only, "axes": axes}


class _Test(NamedTuple):
    """Circle tests of a run by what they are: measured or simulated first, predicted, corrected. `again` simulates it on a machine, None for a table."""

    run: str
    circles: dict[str, CircleTest]
    again: Callable[[Machine], CircleTest] | None = None

    @property
    def measured(self) -> CircleTest:
        return next(iter(self.circles.values()))


def _circles(args: Args, source: Path, machine: Machine, plot: Path) -> dict[str, Any]:
    from twin.iso230.plots import draw_circles
    from twin.iso230.readings import is_table
    from twin.simulation.summary import table

    tests = [_of_table(args, source, machine)] if source.is_file() and is_table(source) else _of_runs(args, source, machine)
    if args.diagnosis and tests[0].again is None:
        raise InputError(f"{source}: --diagnosis needs the trace, run or campaign of the test; a table has no set points")
    if args.campaign and tests[0].again is not None:
        raise InputError(f"{source}: already a recording; give it to 'twin diagnose' (a single trace: 'twin import' first)")
    rows, circles = [], []
    for test in tests:
        budget = _budget(Path(args.diagnosis), test) if args.diagnosis else None
        measured, numbers = test.measured, {name: _numbers(one) for name, one in test.circles.items()}
        for name, own in numbers.items():
            rows.append([test.run, measured.name, name, *(f"{own[k]:.2f}" if k in own else "-" for k in _SHOWN)])
        entry = {"run": test.run, "plane": measured.name, "radius_mm": measured.radius * 1e3, **numbers.pop(next(iter(numbers))), **numbers}
        circles.append(entry if budget is None else {**entry, "budget": budget})
        file = plot if test is tests[0] else plot.with_name(f"{plot.stem}_{test.run}_{measured.name}{plot.suffix}")
        draw_circles(test.circles, file)
    print("ISO 230-4 [um]; G: about the least-squares centre; F: about the nominal centre; H: between the directions; D: mean")
    print(table(["run", "plane", "", *_SHOWN], rows, left=3))
    for entry in circles:
        for direction, spikes in entry["reversal_spikes"].items():
            shown = ", ".join(f"{q} deg {v:.2f}" for q, v in spikes.items())
            print(f"{entry['run']} {entry['plane']} {direction}: reversal spikes [um] at {shown}")
    for entry in (e for e in circles if "budget" in e):
        print(f"{entry['run']} {entry['plane']}: contribution of each effect to the circle [um]; unknown: measured minus corrected")
        cells = [
            [
                in_words(row["effect"]), row["axis"], "-" if row["probability"] is None else f"{row['probability']:.2f}",
                f"{row['rms_um']:.2f}", *(f"{row['adds_um'][k]:+.2f}" if k in row["adds_um"] else "-" for k in _ADDED),
            ]
            for row in entry["budget"]
        ]  # fmt: skip
        print(table(["effect", "axis", "probability", "RMS", *(f"adds to {k}" for k in _ADDED)], cells, left=2))
    if args.campaign:
        _write_campaign(tests[0].measured, Path(args.campaign), machine, args.feedforward)
    said = [f"{e['run']} {e['plane']}: {', '.join(f'{k} {e[k]:.2f}' for k in _SHOWN[:3] if k in e)} um" for e in circles]
    only = circles[0] if len(circles) == 1 else {}
    return {"standard": "ISO 230-4", "verdict": "; ".join(said), "unit": "um", **only, "circles": circles}


_SHOWN = ("G_cw", "G_ccw", "G_b", "F_max", "F_min", "H", "D")
_ADDED = ("G_b", "G_ccw", "G_cw", "F_max", "F_min")


def _of_table(args: Args, source: Path, machine: Machine) -> _Test:
    """The test of a ballbar's table."""
    from twin.iso230.readings import read_ballbar

    if args.radius_mm is None or len(args.plane) != 2 or args.plane[0] == args.plane[1]:
        raise InputError(f"{source}: a ballbar table needs its radius and plane; give --radius-mm and --plane XY")
    for axis in args.plane:
        machine.axis(axis)
    feed = args.feed_mm_per_min / 60e3 if args.feed_mm_per_min else math.nan
    test = read_ballbar(source, args.radius_mm * 1e-3, feed, (args.plane[0], args.plane[1]))
    return _Test(source.stem, {"measured": test.centred()})


def _of_runs(args: Args, source: Path, machine: Machine) -> list[_Test]:
    """The tests of recorded or simulated runs, with the prediction of the twin unless --no-predict is given."""
    from twin.iso230.readings import circles_of_trace

    tests, problems = [], []
    for run in runs_of(source, machine):
        try:
            found = circles_of_trace(run.trace, where=run.name)
        except InputError as error:
            problems.append(str(error))
            continue
        for measured in found:
            again = functools.partial(_predicted, run=run, measured=measured)
            circles = {"simulated" if run.trace.is_simulated else "measured": measured}
            tests.append(_Test(run.name, circles if args.no_predict else {**circles, "predicted": again(machine)}, again))
    if not tests:
        raise InputError(problems[0] if problems else f"{source}: no run with a circle")
    return tests


def _numbers(test: CircleTest) -> dict[str, Any]:
    """Results of a circle [um]; reversal spikes by direction and quadrant."""
    from twin.iso230.circles import circle_numbers, reversal_spikes

    numbers: dict[str, Any] = {k: v * 1e6 for k, v in circle_numbers(test).items()}
    spikes = {d: {str(q): v * 1e6 for q, v in s.items()} for d, s in reversal_spikes(test).items()}
    return {**numbers, "reversal_spikes": spikes}


def _budget(folder: Path, test: _Test) -> list[dict[str, Any]]:
    """Contribution of each effect to a circle [um], from a diagnosis folder; adds the corrected circle to the test."""
    from twin.documents import read_json
    from twin.iso230.circles import circle_budget
    from twin.machine import load_machine

    file, document = folder / "machine.toml", folder / "diagnosis.json"
    if not (file.is_file() and document.is_file()):
        raise InputError(f"{folder}: no machine.toml and diagnosis.json; give the --out folder of 'twin diagnose'")
    assert test.again is not None
    test.circles["corrected"], rows = circle_budget(load_machine(file), read_json(document, "a diagnosis"), test.measured, test.again)
    return rows


def _predicted(machine: Machine, run: MeasuredRun, measured: CircleTest) -> CircleTest:
    """The circle simulated by the twin, evaluated like the measurement."""
    from twin.iso230.readings import circles_of_trace
    from twin.simulation.recorded_times import as_recorded, simulated_period
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    machine = machine.with_feedforward(run.feedforward)
    with Progress("simulating the circle") as bar:
        period = simulated_period(machine, run.trace.period, run.ballbar)
        simulated = simulate(machine, setpoints_of(run.trace, machine), sample_period=period, progress=bar).trace
    return next(test for test in circles_of_trace(as_recorded(simulated, run.trace.time, run.ballbar)) if test.axes == measured.axes)


def _write_campaign(test: CircleTest, folder: Path, machine: Machine, feedforward: str | None) -> None:
    """Write a ballbar circle as a campaign; print the deviations removed because a radius cannot separate them."""
    from twin.iso230.ballbar_campaign import ballbar_run
    from twin.simulation.campaign_file import write_campaign

    run, removed = ballbar_run(test, machine, feedforward)
    write_campaign({run.name: run}, folder)
    slopes = ", ".join(f"{name} {value * 1e6:+.1f} um/m" for name, value in removed.items())
    print(f"removed, relative to the nominal twin: {slopes} (one radius cannot separate a scale error from the position gain of its axis)")
    print(f"written: {folder}, a campaign for twin diagnose")
