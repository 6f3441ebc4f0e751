"""`twin cut INPUT --part PART.toml --out DIR`: remove material along a tool path and write the cut surface."""

from pathlib import Path
import re
from typing import Any

from twin.cli.arguments import MACHINE, THREADS, Args, arg, flag, machine_of, out_argument, positive, trace_file
from twin.errors import InputError, nearest
from twin.files import output_folder, shipped_example, write_json
from twin.machine.machine import FEEDFORWARD, Machine
from twin.program.read import is_program
from twin.progress import Progress
from twin.recordings.trace import read_trace
from twin.surface.levels import LEVELS, levels_of_program, levels_of_trace
from twin.surface.machining import Machining, check_rays, machine_part, report_of
from twin.surface.measured import HeightMap, compare, read_height_map
from twin.surface.part import read_part
from twin.surface.shapes import GridSurface
from twin.units import in_words, plain

ARGUMENTS = (
    arg("input", "INPUT", "part program, run folder or trace", type=shipped_example),
    arg("--part", "PART.toml", "part file with tool, stock, nominal surfaces, zones (see examples/parts)", required=True, type=shipped_example),
    out_argument("folder for pictures, meshes, height maps and cut.json (default: out/cut_<name of the input>)", default=None),
    MACHINE,
    arg("--level", "L", "tool path to cut: programmed | commanded | followed; repeatable (default: all available)", action="append", default=[]),
    arg("--feedforward", "F", "feedforward of the simulated program: velocity+torque | velocity | off; repeatable (default: velocity+torque and off)",
        action="append", default=[]),
    arg("--zone-um", "UM", "spacing of the height rays in the zones (default: from the part file)", type=positive),
    arg("--measured", "MAP", "measured height map of the zone (.npz .csv .sur .x3p), registered and compared with every cut"),
    THREADS,
    flag("--no-files", "write only cut.json and pictures"),
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Cut, print a table, write all files."""
    from twin.simulation.summary import table

    part = read_part(args.part)
    machine = machine_of(args)
    levels = _checked(args.level, LEVELS, "level") or list(LEVELS)
    words = _checked(args.feedforward, FEEDFORWARD, "feedforward") or ["velocity+torque", "off"]
    zone_spacing = args.zone_um * 1e-6 if args.zone_um else None
    if zone_spacing and not any(surface.zone_um for surface in part.surfaces):
        raise InputError(f"--zone-um: {args.part} has no zone; add zone_um to a [[surface]]")
    check_rays(part, zone_spacing)
    measured = read_height_map(Path(args.measured)) if args.measured else None
    out = output_folder(args.out or Path("out") / f"cut_{Path(args.input).stem}")
    with Progress("tool paths") as bar:
        if is_program(source := Path(args.input)):
            paths = levels_of_program(source, machine, part.tool, levels, words, bar)
        else:
            file = trace_file(source)
            paths = levels_of_trace(read_trace(file, axes=machine.kinds), machine, part.tool, levels, str(file))
    with Progress("cutting") as bar:
        machining = machine_part(part, paths, threads=args.threads, zone_spacing=zone_spacing, progress=bar)
    with Progress("measuring the surfaces", total=0):
        reports = [report_of(machining, one) for one in machining.cuts]
    if measured is not None:
        _compare(machining, reports, measured, out)
    pairs, tests = machining.work.tolist()
    of_work = {"pairs": pairs, "tests": tests, "seconds": machining.seconds}
    document = {"part": part.name, "tool": part.tool.name, "notes": list(part.notes), "cuts": reports, "work": of_work}
    write_json(document, out / "cut.json", "cut")
    with Progress("writing surfaces", total=len(machining.cuts) + 1) as bar:
        written = write_files(machining, machine, out, bar, files=not args.no_files)
    print("\n".join([f"{part.name}: {part.tool.name}", *(f"note: {note}" for note in part.notes)]))
    print(table(HEADING, [_row(r) for r in reports], left=2))
    print("too deep, left: relative to the programmed cut; slow, fast: the same where the feed was slow or fast")
    for one in paths:
        if one.errors:
            print(f"{one.label}: " + ", ".join(_said(*error) for error in one.errors.items()))
    print(f"written: {out / 'cut.json'} and {len(written)} files beside it")


def _said(key: str, value: float) -> str:
    """An error of a path in words, from its key with unit: 'contour 9.16 um'; angles in arcsec."""
    name, _, unit = key.rpartition("_")
    return f"{in_words(name)} {plain(3600.0 * value)} arcsec" if unit == "deg" else f"{in_words(name)} {plain(value)} {unit}"


HEADING = ("surface", "level", "deviation um", "too deep um", "left um", "slow um", "fast um", "Sa um", "Sz um")


def _row(report: dict[str, Any]) -> list[str]:
    """Cells of HEADING."""

    def span(values: dict[str, float] | None) -> str:
        return f"{round(values['min'], 2) + 0.0:.2f} .. {round(values['max'], 2) + 0.0:.2f}" if values else "-"  # no -0.00

    mark, areal = report.get("mark"), report.get("areal_um")
    cells = [report["surface"], f"{report['level']} {report['feedforward']}".strip(), span(report["deviation_um"])]
    cells += [f"{mark['depth_um']:.2f}", f"{mark['left_um']:.2f}"] if mark else ["-", "-"]
    cells += [span(report.get(f"against_programmed_{feed}_um")) for feed in ("slow", "fast")]
    return [*cells, *([f"{areal['sa']:.3f}", f"{areal['sz']:.2f}"] if areal else ["-", "-"])]


def _compare(machining: Machining, reports: list[dict[str, Any]], measured: HeightMap, out: Path) -> None:
    """Compare the measured map with each cut: extend its report, print the difference, draw both maps."""
    from twin.surface.picture import draw_measured

    for one, report in zip(machining.cuts, reports):
        if not one.finest.is_grid:
            continue
        simulated = HeightMap(one.finest.u, one.finest.v, one.finest.map())
        found = compare(measured, simulated)
        shift = {f"shift_{way}_mm": value * 1e3 for way, value in zip("uv", found.shift)}
        depths = {f"depth_{whose}_um": depth * 1e6 for whose, depth in zip(("simulated", "measured"), found.depth(simulated.height))}
        report["measured"] = {"difference_rms_um": found.rms * 1e6, **shift, **depths}
        print(
            f"{one.surface.name}, {one.level.label}: measured minus simulated {found.rms * 1e6:.2f} um RMS; deepest below the mean: "
            f"simulated {depths['depth_simulated_um']:.2f} um, measured {depths['depth_measured_um']:.2f} um"
        )
        draw_measured(simulated, found, one.level.label, out / f"{_name(f'{one.surface.name} {one.level.label}')}_measured.png")


def write_files(machining: Machining, machine: Machine, out: Path, progress: Progress, *, files: bool = True) -> list[Path]:
    """Write pictures of each cut and of all levels; with `files` also meshes, height maps and a recording."""
    from twin.replay.cut import write_cut
    from twin.surface.export import write_height_map, write_mesh
    from twin.surface.picture import colour_end, draw_cut, draw_levels

    written = []

    def file(name: str) -> Path:
        written.append(out / name)
        return written[-1]

    for one in machining.cuts:
        progress(None)
        stem = _name("_".join(filter(None, (one.surface.name, one.level.level, one.level.feedforward))))
        draw_cut(machining, one, file(f"{stem}.png"))
        for ending in (".ply", ".stl") if files else ():
            write_mesh(one.finest, file(f"{stem}{ending}"), colour_end(one.finest.height * 1e6) * 1e-6)
        for ending in (".npz", ".csv") if files else ():
            write_height_map(one.finest, file(f"{stem}{ending}"))
    for surface in machining.part.surfaces:
        if isinstance(surface, GridSurface):
            draw_levels(machining, surface.name, file(f"{_name(surface.name)}_levels.png"))
    if files:
        write_cut(file("cut.rrd"), machine, machining)
    return written


def _checked(words: list[str], known: tuple[str, ...], what: str) -> list[str]:
    for word in words:
        if word not in known:
            raise InputError(f"--{what} {word}: {nearest(word, known)}; use one of {', '.join(known)}")
    return list(dict.fromkeys(words))


def _name(text: str) -> str:
    """A name without blanks and special characters."""
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
