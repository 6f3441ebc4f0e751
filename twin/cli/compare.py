"""`twin compare A B`: compare two runs, campaigns or machines."""

from pathlib import Path

from twin.cli.arguments import MACHINE, OPEN, Args, arg, finish, machine_of, out_argument, runs_of, setpoints_of_input
from twin.errors import InputError
from twin.files import output_folder, shipped_example, write_json
from twin.progress import Progress

ARGUMENTS = (
    arg("first", "A", "run folder, trace, campaign folder or machine file", type=shipped_example),
    arg("second", "B", "another one of the same kind", type=shipped_example),
    out_argument("folder for compare.json and report.html (default: out/compare)", default="out/compare"),
    arg("--input", "FILE", "for two machine files: program or trace that both simulate"),
    MACHINE,
    OPEN,
)


def carry_out(args: Args) -> None:
    """Compare; print verdict and table, write compare.json and report.html."""
    first, second = Path(args.first), Path(args.second)
    kinds = [_kind(path) for path in (first, second)]
    if kinds[0] != kinds[1]:
        raise InputError(f"{first} is a {kinds[0]}, {second} is a {kinds[1]}; give two of the same kind")
    if args.input and kinds[0] != "machine":
        raise InputError("--input is for two machine files; leave it out")
    out = output_folder(args.out)
    document = (_machines if kinds[0] == "machine" else _recorded)(args, first, second, out)
    write_json({"kind": f"{kinds[0]}s", **document}, out / "compare.json", "compare")
    moved = kinds[0] != "machine" or args.input
    finish(args, out, f"compare.json, report.html{', compare.rrd' if moved else ''}")


def _recorded(args: Args, first: Path, second: Path, out: Path) -> dict:
    """Two runs, or the runs of one name of two campaigns: page and recording show those that differ most."""
    from twin.compare.align import on_clock_of
    from twin.compare.compare import compare
    from twin.compare.pages import write_comparison_page
    from twin.replay.recording import write_recording

    machine, names = machine_of(args), _names(first, second)
    campaigns = _kind(first) == "campaign"
    a, b = ({run.name if campaigns else "": run.trace for run in runs_of(path, machine)} for path in (first, second))
    found = {name: compare(a[name], b[name], machine, names=names) for name in a if name in b}
    if not found:
        raise InputError(f"{first} and {second} have no run name in common; compare two traces instead")
    worst = max(found, key=lambda name: max((d.max for d in found[name].differences if d.signal == "position"), default=0.0))
    print("\n".join(f"{name}: {one.verdict}" if campaigns else one.verdict for name, one in found.items()))
    print(f"\n{worst}\n{found[worst].table()}" if campaigns else found[worst].table())
    write_recording(out / "compare.rrd", machine, {names[0]: a[worst], names[1]: on_clock_of(a[worst], b[worst])[0]})
    write_comparison_page(found[worst], out / "report.html", f"run {worst} of {first} and {second}" if campaigns else f"{first}, {second}")
    if not campaigns:
        return found[worst].document()
    runs = {name: one.document() for name, one in found.items()}
    return {"first": names[0], "second": names[1], "verdict": f"{worst}: {found[worst].verdict}", "runs": runs}


def _machines(args: Args, first: Path, second: Path, out: Path) -> dict:
    """Two machine files: the numbers that differ and, with --input, both simulated."""
    from twin.compare.compare import compare, differing_numbers
    from twin.compare.pages import number_rows, numbers_sections, title_of, write_comparison_page
    from twin.machine import load_machine
    from twin.replay.side_by_side import write_side_by_side
    from twin.report.page import made_line, write_page
    from twin.simulation.run import simulate
    from twin.simulation.summary import table

    machines = [load_machine(path) for path in (first, second)]
    names = _names(first, second)
    numbers = differing_numbers(*machines)
    verdict = f"{len(numbers)} numbers differ." if numbers else "The two machine files have the same numbers."
    print("\n".join([verdict, *([table(["number", *names], number_rows(numbers))] if numbers else [])]))
    document = {"first": names[0], "second": names[1], "verdict": verdict, "numbers": [n._asdict() for n in numbers]}
    if not args.input:
        write_page(out / "report.html", title_of(*names), verdict, numbers_sections(numbers, names), made_line(inputs=f"{first}, {second}"))
        return document
    program, trace = setpoints_of_input(Path(args.input), machines[0])
    runs = []
    with Progress("simulating", total=2) as bar:
        for machine in machines:
            runs.append(simulate(machine.with_feedforward(program.feedforward if program else None), trace).trace)
            bar(None)
    comparison = compare(runs[0], runs[1], machines[0], names=names)
    print(f"{comparison.verdict}\n{comparison.table()}")
    write_comparison_page(comparison, out / "report.html", f"{first}, {second} on {args.input}", numbers)
    write_side_by_side(out / "compare.rrd", {name: (machine, run) for name, machine, run in zip(names, machines, runs)})
    return {**document, **comparison.document()}


def _kind(path: Path) -> str:
    if path.suffix.lower() == ".toml":
        return "machine"
    return "campaign" if (path / "campaign.toml").is_file() else "run"


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Short names: those of the files, with their folders if the files have the same name."""
    a, b = (path.resolve() for path in (first, second))
    names = (a.stem, b.stem) if a.stem != b.stem else (f"{a.parent.name}/{a.stem}", f"{b.parent.name}/{b.stem}")
    return names if names[0] != names[1] else (str(first), f"{second} (2)")
