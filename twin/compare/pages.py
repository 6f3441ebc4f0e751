"""HTML pages of a gap and of a comparison."""

from collections.abc import Sequence
from pathlib import Path

from twin.compare.compare import Comparison, Number
from twin.report import Figure, Section, Table, figure_svg, write_page
from twin.report.page import made_line
from twin.simulation.campaign_gap import AS_EXPECTED, CampaignGap, Outlier
from twin.units import in_words, plain

GAP_HEADING = ("run", "axis", "signal", "RMS", "largest", "noise alone", "times noise")


def gap_cells(rows: Sequence[Outlier]) -> list[list[str]]:
    """Cells of GAP_HEADING for each signal."""
    sizes = ([f"{plain(r.gap.rms)} {r.gap.unit}", plain(r.gap.max), plain(r.gap.noise), f"{r.times_noise:.1f}"] for r in rows)
    return [[r.run, r.axis, in_words(r.signal), *cells] for r, cells in zip(rows, sizes)]


def write_gap_page(gap: CampaignGap, path: Path) -> None:
    """Write the page of a gap: verdict, picture, outliers, every signal."""
    rows = gap.rows()
    cells = gap_cells(rows)
    marked = frozenset(i for i, row in enumerate(rows) if row.times_noise > AS_EXPECTED)
    picture = Figure(figure_svg(gap.plot()), "Gap as a multiple of noise alone. Grey: as it should be; blank: not recorded, or at rest.")
    outliers = Section("Outliers", [f"None: no signal is above {AS_EXPECTED:g} times noise alone."])
    if marked:
        outliers = Section("Outliers", tables=[Table(GAP_HEADING, cells[: len(marked)], left=3, marked=marked)])
    every = Table(GAP_HEADING, cells, left=3, marked=marked, folded=f"{len(cells)} signals, largest first")
    sections = [
        Section("Where the twin and the machine differ", figures=[picture]),
        outliers,
        *([Section("Notes", list(gap.notes))] if gap.notes else []),
        Section("Every signal", tables=[every]),
    ]
    write_page(path, f"Gap of {gap.campaign}", f"{gap.verdict}.", sections, made_line(gap.machine, gap.campaign))


def write_comparison_page(comparison: Comparison, path: Path, inputs: str, numbers: Sequence[Number] = ()) -> None:
    """Write the page of a comparison: verdict, picture, errors, differences; for two machines also the numbers that differ."""
    a, b = comparison.names
    picture = Figure(figure_svg(comparison.plot()), f"Error without the delay of the control. Grey: {a}; colour: {b}.")
    sections = [Section("In one picture", figures=[picture])]
    if comparison.differing:
        errors = Table(["axis", "error", a, b], comparison.error_rows(), left=2)
        differences = Table(["axis", "signal", "RMS", "largest", "at"], comparison.difference_rows(), left=2)
        sections += [
            Section("Errors without the delay of the control", tables=[errors]),
            Section(f"Differences: {b} minus {a}", tables=[differences]),
        ]
    sections += numbers_sections(numbers, (a, b))
    write_page(path, title_of(a, b), comparison.verdict, sections, made_line(comparison.machine.name, inputs))


def number_rows(numbers: Sequence[Number]) -> list[list[str]]:
    """Path and both values of each number; '-' where a file has none."""
    return [[n.path, *("-" if v is None else f"{v:.6g}" if isinstance(v, float) else str(v) for v in (n.first, n.second))] for n in numbers]


def numbers_sections(numbers: Sequence[Number], names: tuple[str, str]) -> list[Section]:
    """The numbers of two machine files that differ; no section without any."""
    table = Table(["number", *names], number_rows(numbers))
    return [Section("Numbers of the machine files that differ", tables=[table])] if numbers else []


def title_of(a: str, b: str) -> str:
    """'A and B', with a capital first letter."""
    return f"{a[:1].upper()}{a[1:]} and {b}"
