"""A design study in one call, and its output files: table.parquet and table.csv, study.json, report.html, plots, the best machine and its replay beside the nominal one."""

from collections.abc import Sequence
import contextlib
from pathlib import Path
import tempfile

import numpy as np
import pyarrow.csv
import pyarrow.parquet

from twin.errors import InputError, TwinError
from twin.files import beside, write_json
from twin.machine.machine import Machine, write_machine
from twin.report import save_png
from twin.simulation.summary import table
from twin.study.catalogue import RATINGS
from twin.study.design import machine_of, variants_of
from twin.study.duty import driven_axes, duty_of, torque_speed_figure
from twin.study.evaluate import responses_of, work_of
from twin.study.execution import simulated, threads_here
from twin.study.labels import label_of, valued
from twin.study.report import write_report
from twin.study.results import TABLE, Answers, answers_of, table_of
from twin.study.spec import Study, read_study

BEST_MACHINE = "best_machine.toml"


def study(spec: str | Path, out: str | Path | None = None, *, machine: str | Path | None = None, threads: int | None = None) -> Answers:
    """Run a study on the threads of this computer and return its answers.

    `out` is the folder for results and report (None: nothing is kept); results of the same study in it are continued. `machine` is
    another machine file. The answers hold the effect of each factor on each response from its low to its high end in the response's
    unit, the Pareto front and the best variant. Raises InputError for an invalid study file.
    """
    known = read_study(spec, machine)
    with tempfile.TemporaryDirectory(prefix="twin-study-", ignore_cleanup_errors=True) as scratch:
        rows, _ = simulated(known, variants_of(known), Path(out or scratch), threads_here(threads), resume=out is not None)
        answers = answers_of(known, rows)
        if out is not None:
            write_study(known, answers, Path(out))
    return answers


def write_study(study: Study, answers: Answers, out: Path, replay: bool = True) -> list[str]:
    """Write all output files to the folder; returns their names."""
    rows = table_of(study, answers.rows)
    written = [TABLE, "table.csv", "study.json", "report.html"]
    with beside(out / TABLE) as partial:
        pyarrow.parquet.write_table(rows, partial)
    with beside(out / "table.csv") as partial:
        pyarrow.csv.write_csv(rows, partial)
    write_json(answers.document(), out / "study.json", "study")
    if answers.best is None:
        return [*written, *write_report(study, answers, [], out, {})]
    best, work = machine_of(study, np.array(answers.row(answers.best)[1])), work_of(study)
    found = [duty_of(work, best, "best"), duty_of(work, rated(study), "nominal")]
    duties = [duty for duty in found if duty]  # those that can be simulated
    present: dict[str, float] = {}
    with contextlib.suppress(TwinError):
        present = responses_of(study.machine, work)
    written += [*write_report(study, answers, duties, out, present), BEST_MACHINE]
    write_machine(best, out / BEST_MACHINE)
    if replay and len(duties) == 2:
        from twin.replay.recording import write_recording

        for run in duties[0].runs:
            written.append(f"best_{run}.rrd")
            write_recording(out / written[-1], duties[0].machine, {duty.label: duty.runs[run].trace for duty in duties})
    return written


def rated(study: Study) -> Machine:
    """The present machine with the catalogue's ratings of the installed entries."""
    installed = [choice for factor in study.factors for choice in factor.choices if choice.name == factor.installed]
    return study.machine.with_values({path: value for choice in installed for path, value in choice.values if path.endswith(RATINGS)})


def write_comparison(study: Study, answers: Answers, numbers: Sequence[int], out: Path) -> list[str]:
    """Compare two variants: one recording of both per run, and a plot of torque against speed."""
    from twin.replay.side_by_side import write_side_by_side

    known = {row[0]: row for row in answers.rows}
    if (wrong := next((n for n in numbers if n not in known or not known[n][2]), None)) is not None:
        raise InputError(f"--compare {wrong}: no variant with this number could be run; see the numbers in {out / 'table.csv'}")
    # factors and responses side by side
    rows = [known[n] for n in numbers]
    lines = [[factor.name, *(factor.value_text(row[1][i]) for row in rows)] for i, factor in enumerate(answers.definitions)]
    lines += [[label_of(name), *(valued(name, row[2][name]) if name in row[2] else "-" for row in rows)] for name in answers.looked]
    summary = table(["design", *(f"variant {n}" for n in numbers)], lines)
    work = work_of(study)
    duties = [duty_of(work, machine_of(study, np.array(row[1])), f"variant {row[0]}") for row in rows]
    found = [duty for duty in duties if duty]
    name = "compare_" + "_".join(str(n) for n in numbers)
    written = []
    for run in found[0].runs:
        written.append(f"{name}_{run}.rrd")
        write_side_by_side(out / written[-1], {duty.label: (duty.machine, duty.runs[run].trace) for duty in found}, summary=summary)
    if driven_axes(found):
        save_png(torque_speed_figure(found), out / "plots" / f"{name}.png")
        written.append(f"plots/{name}.png")
    return written
