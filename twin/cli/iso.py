"""`twin iso 230-2|230-4 INPUT`: positioning and circles by ISO 230."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.cli.arguments import MACHINE, arg, flag, machine_of, positive
from twin.errors import InputError
from twin.files import shipped_example, write_json
from twin.progress import Progress
from twin.units import AXIS_UNITS

if TYPE_CHECKING:
    from twin.iso230.circle_budget import EffectOnCircle
    from twin.iso230.circles import CircleTest
    from twin.machine.machine import Machine
    from twin.recordings.ballbar import Ballbar
    from twin.recordings.trace import Trace

STANDARDS = ("230-2", "230-4")


ARGUMENTS = (
    ("standard", {"choices": STANDARDS, "metavar": "230-2|230-4", "help": "230-2: positioning of an axis; 230-4: circles"}),
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


def carry_out(args: argparse.Namespace) -> None:
    """Evaluate; print and write results and plot."""
    if not Path(args.input).exists():
        raise InputError(f"{args.input}: no such file or folder; give a table of readings (.csv), a trace, a run folder or a campaign")
    machine = machine_of(args)
    plot = Path(args.plot) if args.plot else Path(args.json or f"out/iso_{args.standard}.json").with_suffix(".png")
    document = _positioning(args, machine, plot) if args.standard == "230-2" else _circles(args, machine, plot)
    if args.json:
        write_json(document, Path(args.json), "iso230")
        print(f"written: {args.json}")
    print(f"written: {plot}")


def _positioning(args: argparse.Namespace, machine: Machine, plot: Path) -> dict[str, Any]:
    from twin.iso230.plots import draw_positioning
    from twin.iso230.positioning import positioning
    from twin.iso230.readings import is_table, positions_of_trace, read_positions
    from twin.simulation.summary import table

    source = Path(args.input)
    readings, kinds = {}, {}
    if source.is_file() and is_table(source):
        readings[""], kinds[""] = read_positions(source)
    else:
        problems = []
        for run, trace, *_ in _traces(source, machine):
            for axis in trace.axes:
                if trace.moves(axis) and args.axis in (None, axis) and axis not in readings:
                    try:
                        readings[axis], kinds[axis] = positions_of_trace(trace, axis, run), machine.axis(axis).kind
                    except InputError as error:
                        problems.append(str(error))
        if not readings:
            raise InputError(problems[0] if problems else f"{source}: no axis moves{f' like {args.axis}' if args.axis else ''}")
    results = {axis: positioning(one) for axis, one in readings.items()}
    draw_positioning(results, kinds, plot)
    scale = {axis: (1e3, "mm") if kind == "linear" else (180.0 / math.pi, "deg") for axis, kind in kinds.items()}
    print("ISO 230-2, k = 2")
    for axis, result in results.items():
        unit, factor = AXIS_UNITS[kinds[axis]].error
        found = {name: f"{value * factor:.2f}" for name, value in result.numbers.items()}
        rows = [[name, found[name], *(found.get(f"{name}_{way}", "-") for way in ("forward", "backward"))] for name in "AREMB"]
        rows.append(["mean B", found["B_mean"], "-", "-"])
        print(f"{f'axis {axis}: ' if axis else ''}{len(readings[axis].target)} positions")
        print(table([f"{f'axis {axis}, ' if axis else ''}{unit}", "both directions", "forward", "backward"], rows, left=1))
    print(_MEANING)
    axes = {
        axis: {
            "unit": scale[axis][1],
            **{name: value * scale[axis][0] for name, value in found.numbers.items()},
            "cycles": readings[axis].forward.shape[1],
            "positions": [
                {
                    "target": float(found.target[i] * scale[axis][0]),
                    "mean_forward": float(found.mean_forward[i] * scale[axis][0]),
                    "mean_backward": float(found.mean_backward[i] * scale[axis][0]),
                    "s_forward": float(found.deviation_forward[i] * scale[axis][0]),
                    "s_backward": float(found.deviation_backward[i] * scale[axis][0]),
                    "B": float(found.reversal[i] * scale[axis][0]),
                }
                for i in range(len(found.target))
            ],
        }
        for axis, found in results.items()
    }
    alone = next(iter(axes.values())) if len(axes) == 1 else {}
    return {"standard": "ISO 230-2", "k": 2, **alone, "axes": axes}


_MEANING = "A accuracy, R repeatability, E systematic deviation, M mean systematic deviation, B reversal value"


def _circles(args: argparse.Namespace, machine: Machine, plot: Path) -> dict[str, Any]:
    from twin.iso230.circle_of_trace import circles_of_trace
    from twin.iso230.plots import draw_circles
    from twin.iso230.readings import is_table, read_ballbar
    from twin.simulation.summary import table

    source = Path(args.input)
    tests: list[tuple[str, dict[str, CircleTest]]] = []
    recorded: list[tuple[Trace, str | None, Ballbar | None]] = []
    if source.is_file() and is_table(source):
        if args.radius_mm is None or len(args.plane) != 2 or args.plane[0] == args.plane[1]:
            raise InputError(f"{source}: a ballbar table needs its radius and plane; give --radius-mm and --plane XY")
        plane = (args.plane[0], args.plane[1])
        for axis in plane:
            machine.axis(axis)
        feed = args.feed_mm_per_min / 60e3 if args.feed_mm_per_min else math.nan
        tests.append((source.stem, {"measured": read_ballbar(source, args.radius_mm * 1e-3, feed, plane).centred()}))
    else:
        problems = []
        for run, trace, feedforward, ballbar in _traces(source, machine):
            try:
                found = circles_of_trace(trace, where=run)
            except InputError as error:
                problems.append(str(error))
                continue
            for test in found:
                tests.append((run, {"measured": test}))
                recorded.append((trace, feedforward, ballbar))
                if not args.no_predict:
                    tests[-1][1]["predicted"] = _predicted(trace, machine.with_feedforward(feedforward), test, ballbar)
        if not tests:
            raise InputError(problems[0] if problems else f"{source}: no run with a circle")
    if args.diagnosis and not recorded:
        raise InputError(f"{source}: --diagnosis needs the trace, run or campaign of the test; a table has no set points")
    if args.campaign and recorded:
        raise InputError(f"{source}: already a recording; give it to 'twin diagnose' (a single trace: 'twin import' first)")
    rows, circles, budgets = [], [], []
    for i, (run, by_name) in enumerate(tests):
        if i < len(recorded) and args.diagnosis:
            budgets.append(_budget(Path(args.diagnosis), recorded[i], by_name))
        words = {"measured": "simulated"} if i < len(recorded) and recorded[i][0].is_simulated else {}
        entry: dict[str, Any] = {"run": run, "plane": by_name["measured"].name, "radius_mm": by_name["measured"].radius * 1e3}
        for name, test in by_name.items():
            numbers = _numbers(test)
            entry |= numbers if name == "measured" else {name: numbers}
            rows.append([run, test.name, words.get(name, name), *(f"{numbers[k]:.2f}" if k in numbers else "-" for k in _SHOWN)])
        if budgets:
            entry["budget"] = [_budget_row(row) for row in budgets[-1]]
        circles.append(entry)
        shown = {words.get(name, name): test for name, test in by_name.items()}
        draw_circles(shown, plot if i == 0 else plot.with_name(f"{plot.stem}_{run}_{by_name['measured'].name}{plot.suffix}"))
    print("ISO 230-4 [um]; G: about the least-squares centre, F: about the nominal centre")
    print(table(["run", "plane", "", *_SHOWN], rows, left=3))
    for entry in circles:
        for direction, spikes in entry["reversal_spikes"].items():
            print(
                f"{entry['run']} {entry['plane']} {direction}: reversal spikes [um] at "
                + ", ".join(f"{q} deg {v:.2f}" for q, v in spikes.items())
            )
    for entry in circles:
        if "budget" in entry:
            print(f"{entry['run']} {entry['plane']}: contribution of each effect to the circle [um]; unknown: measured minus corrected")
            cells = [
                [
                    row["effect"].replace("_", " "),
                    row["axis"],
                    "-" if row["probability"] is None else f"{row['probability']:.2f}",
                    f"{row['rms_um']:.2f}",
                    *(f"{row['adds_um'][k]:+.2f}" if k in row["adds_um"] else "-" for k in _ADDED),
                ]
                for row in entry["budget"]
            ]
            print(table(["effect", "axis", "probability", "RMS", *(f"adds to {k}" for k in _ADDED)], cells, left=2))
    if args.campaign:
        _write_campaign(tests[0][1]["measured"], Path(args.campaign), machine, source, args.feedforward)
    return {"standard": "ISO 230-4", "unit": "um", **(circles[0] if len(circles) == 1 else {}), "circles": circles}


_SHOWN = ("G_cw", "G_ccw", "G_b", "F_max", "F_min", "H", "D")


def _numbers(test: CircleTest) -> dict[str, Any]:
    """Results of a circle [um]; reversal spikes by direction and quadrant."""
    from twin.iso230.circles import circle_numbers, reversal_spikes

    numbers: dict[str, Any] = {k: v * 1e6 for k, v in circle_numbers(test).items() if not k.startswith("radius")}
    spikes = {d: {str(q): v * 1e6 for q, v in s.items()} for d, s in reversal_spikes(test).items()}
    return {**numbers, "reversal_spikes": spikes}


_ADDED = ("G_b", "G_ccw", "G_cw", "F_max", "F_min")


def _budget(folder: Path, recorded: tuple[Trace, str | None, Ballbar | None], by_name: dict[str, CircleTest]) -> list[EffectOnCircle]:
    """Contribution of each effect to a circle, from a diagnosis folder; adds the corrected circle to `by_name`."""
    from twin.documents import read_json_table
    from twin.iso230.circle_budget import circle_budget
    from twin.machine import load_machine

    file, document = folder / "machine.toml", folder / "diagnosis.json"
    if not (file.is_file() and document.is_file()):
        raise InputError(f"{folder}: no machine.toml and diagnosis.json; give the --out folder of 'twin diagnose'")
    trace, feedforward, ballbar = recorded
    measured = by_name["measured"]
    by_name["corrected"], rows = circle_budget(
        load_machine(file).with_feedforward(feedforward),
        read_json_table(document, "a diagnosis"),
        measured,
        lambda machine: _predicted(trace, machine, measured, ballbar),
    )
    return rows


def _budget_row(row: EffectOnCircle) -> dict[str, Any]:
    """A row of the budget for the JSON file [um]."""
    return {
        "effect": row.effect,
        "axis": row.axis,
        "probability": row.probability,
        "rms_um": row.share * 1e6,
        "adds_um": {k: v * 1e6 for k, v in row.adds.items()},
    }


def _predicted(trace: Trace, machine: Machine, measured: CircleTest, ballbar: Ballbar | None) -> CircleTest:
    """The circle simulated by the twin, evaluated like the measurement."""
    from twin.iso230.circle_of_trace import circles_of_trace
    from twin.simulation.gap import as_recorded, simulated_period
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    with Progress("simulating the circle") as bar:
        period = simulated_period(machine, trace.period, ballbar)
        run = simulate(machine, setpoints_of(trace, machine), sample_period=period, progress=bar)
    return next(test for test in circles_of_trace(as_recorded(run.trace, trace.time, ballbar)) if test.axes == measured.axes)


def _traces(source: Path, machine: Machine) -> Iterator[tuple[str, Trace, str | None, Ballbar | None]]:
    """Name, trace, feedforward and ballbar of every run of a campaign, run folder or trace."""
    from twin.recordings import read_campaign, read_trace

    if (source / "campaign.toml").is_file():
        for run in read_campaign(source, machine).runs:
            yield run.name, run.trace, run.feedforward, run.ballbar
        return
    file = source / "trace.parquet" if source.is_dir() else source
    if not file.is_file():
        raise InputError(f"{source}: neither campaign.toml nor trace.parquet; give a campaign, a run folder, a trace or a table")
    yield source.stem, read_trace(file, axes=machine.kinds, need=("setpoint",)), None, None


def _write_campaign(test: CircleTest, folder: Path, machine: Machine, source: Path, feedforward: str | None) -> None:
    """Write a ballbar circle as a campaign; print the deviations removed because a radius cannot separate them."""
    from twin.files import write_whole
    from twin.iso230.ballbar_campaign import ballbar_campaign
    from twin.recordings.trace import write_trace

    found = ballbar_campaign(test, machine.with_feedforward(feedforward))
    slopes = ", ".join(f"{name} {value * 1e6:+.1f} um/m" for name, value in found.slopes.items())
    name = f"circle_{test.name.lower()}.parquet"
    write_trace(found.trace, folder / name)
    lines = [
        f"# {source.name}: ballbar measurement. Removed here and from the twin, because a radius cannot separate them from the machine:",
        f"# {slopes}, relative to the nominal twin",
        f'machine = "{machine.model_path.stem}"',
        "",
        "[[run]]",
        f'file = "{name}"',
        *([f'feedforward = "{feedforward}"'] if feedforward else []),
        "[run.ballbar]",
        f'axes = ["{test.axes[0]}", "{test.axes[1]}"]',
        f"noise_m = {found.noise:.3g}",
        "",
    ]
    write_whole(folder / "campaign.toml", "\n".join(lines))
    print(f"removed, relative to the nominal twin: {slopes} (one radius cannot separate a scale error from the position gain of its axis)")
    print(f"written: {folder}, a campaign for twin diagnose")
