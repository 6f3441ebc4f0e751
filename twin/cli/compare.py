"""`twin compare A B`: compare two runs, campaigns or machines."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from twin.cli.arguments import MACHINE, OPEN, arg, machine_of, open_report, out_argument, setpoints_of_input
from twin.errors import InputError
from twin.files import output_folder, shipped_example, write_json
from twin.progress import Progress

if TYPE_CHECKING:
    from twin.compare.machines import Number
    from twin.machine import Machine
    from twin.recordings import Trace


ARGUMENTS = (
    arg("first", "A", "run folder, trace, campaign folder or machine file", type=shipped_example),
    arg("second", "B", "another one of the same kind", type=shipped_example),
    out_argument("folder for compare.json and report.html (default: out/compare)", default="out/compare"),
    arg("--input", "FILE", "for two machine files: program or trace that both simulate"),
    MACHINE,
    OPEN,
)


def carry_out(args: argparse.Namespace) -> None:
    """Compare; print verdict and table, write compare.json and report.html."""
    first, second = Path(args.first), Path(args.second)
    kinds = [_kind(path) for path in (first, second)]
    if kinds[0] != kinds[1]:
        raise InputError(f"{first} is a {kinds[0]}, {second} is a {kinds[1]}; give two of the same kind")
    if args.input and kinds[0] != "machine":
        raise InputError("--input is for two machine files; leave it out")
    out = output_folder(args.out)
    document = {"run": _runs, "campaign": _campaigns, "machine": _machines}[kinds[0]](args, first, second, out)
    write_json({"kind": f"{kinds[0]}s", **document}, out / "compare.json", "compare")
    moved = kinds[0] != "machine" or args.input
    print(f"written to {out}: compare.json, report.html{', compare.rrd' if moved else ''}")
    open_report(args, out / "report.html")


def _runs(args: argparse.Namespace, first: Path, second: Path, out: Path) -> dict:
    machine = machine_of(args)
    a, b, names = _trace(first, machine), _trace(second, machine), _names(first, second)
    document = _compared(a, b, machine, names, out, f"{first}, {second}")
    _record(a, b, machine, names, out)
    return document


def _compared(a: Trace, b: Trace, machine: Machine, names: tuple[str, str], out: Path, inputs: str, numbers: Sequence[Number] = ()) -> dict:
    from twin.compare.compare import compare
    from twin.compare.pages import write_comparison_page

    comparison = compare(a, b, machine, names=names)
    print(comparison.verdict)
    print(comparison.table())
    write_comparison_page(comparison, out / "report.html", inputs, numbers)
    return comparison.document()


def _record_designs(a: tuple[Machine, Trace], b: tuple[Machine, Trace], names: tuple[str, str], out: Path) -> None:
    """Write compare.rrd: both machines side by side."""
    from twin.replay import write_side_by_side

    write_side_by_side(out / "compare.rrd", {names[0]: a, names[1]: b})


def _record(a: Trace, b: Trace, machine: Machine, names: tuple[str, str], out: Path) -> None:
    """Write compare.rrd: both runs overlaid."""
    from twin.replay import write_recording
    from twin.replay.clock import on_clock_of

    write_recording(out / "compare.rrd", machine, {names[0]: a, names[1]: on_clock_of(a, b)[0]})


def _campaigns(args: argparse.Namespace, first: Path, second: Path, out: Path) -> dict:
    from twin.compare.compare import compare
    from twin.compare.pages import write_comparison_page
    from twin.recordings.campaign import read_campaign

    machine = machine_of(args)
    names = _names(first, second)
    a, b = ({run.name: run.trace for run in read_campaign(path, machine).runs} for path in (first, second))
    common = [name for name in a if name in b]
    if not common:
        raise InputError(f"{first} and {second} have no run name in common; compare two traces instead")
    found = {name: compare(a[name], b[name], machine, names=names) for name in common}
    for name, comparison in found.items():
        print(f"{name}: {comparison.verdict}")
    worst = max(found, key=lambda name: max((d.max for d in found[name].differences if d.signal == "position"), default=0.0))
    print(f"\n{worst}\n{found[worst].table()}")
    _record(a[worst], b[worst], machine, names, out)
    write_comparison_page(found[worst], out / "report.html", f"run {worst} of {first} and {second}")
    return {
        "first": names[0],
        "second": names[1],
        "verdict": f"{worst}: {found[worst].verdict}",
        "runs": {name: comparison.document() for name, comparison in found.items()},
    }


def _machines(args: argparse.Namespace, first: Path, second: Path, out: Path) -> dict:
    from twin.compare.machines import differing_numbers
    from twin.compare.pages import number_rows, write_machines_page
    from twin.machine import load_machine
    from twin.simulation.summary import table

    machines = [load_machine(path) for path in (first, second)]
    names = _names(first, second)
    numbers = differing_numbers(*machines)
    verdict = f"{len(numbers)} numbers differ." if numbers else "The two machine files have the same numbers."
    print(verdict)
    if numbers:
        print(table(["number", *names], number_rows(numbers)))
    document = {"first": names[0], "second": names[1], "verdict": verdict, "numbers": [n._asdict() for n in numbers]}
    if not args.input:
        write_machines_page(names, numbers, verdict, out / "report.html", f"{first}, {second}")
    else:
        from twin.simulation.run import simulate

        program, trace = setpoints_of_input(Path(args.input), machines[0])
        word = program.feedforward if program else None
        with Progress("simulating", total=2) as bar:
            runs = []
            for machine in machines:
                runs.append(simulate(machine.with_feedforward(word), trace).trace)
                bar(None)
        document = {
            **_compared(runs[0], runs[1], machines[0], names, out, f"{first}, {second} on {args.input}", numbers),
            "numbers": document["numbers"],
        }
        _record_designs((machines[0], runs[0]), (machines[1], runs[1]), names, out)
    return document


def _kind(path: Path) -> str:
    if path.suffix == ".toml":
        return "machine"
    return "campaign" if (path / "campaign.toml").is_file() else "run"


def _trace(path: Path, machine: Machine) -> Trace:
    from twin.recordings import read_trace

    file = next((path / f"trace{end}" for end in (".parquet", ".csv") if (path / f"trace{end}").is_file()), path) if path.is_dir() else path
    if file.is_dir():
        raise InputError(
            f"{path}: no trace.parquet in this folder; give the --out folder of 'twin run', a trace, a campaign or a machine file"
        )
    return read_trace(file, axes=machine.kinds, need=("setpoint",))


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Short names: those of the files, with their folders if the files have the same name."""
    a, b = (path.resolve() for path in (first, second))
    names = (a.stem, b.stem) if a.stem != b.stem else (f"{a.parent.name}/{a.stem}", f"{b.parent.name}/{b.stem}")
    return names if names[0] != names[1] else (str(first), f"{second} (2)")
