"""What a study writes: table.parquet and table.csv, study.json, report.html, plots, the best machine and its replay beside the nominal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet

from twin.errors import InputError, TwinError
from twin.files import write_json
from twin.machine.machine import Machine, write_machine
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.study.design import machine_of
from twin.study.evaluate import Source, motion_of, work_of
from twin.study.report import write_report
from twin.study.results import TABLE, Answers, table_of
from twin.study.spec import Study

BEST_MACHINE = "best_machine.toml"


def write_study(study: Study, answers: Answers, out: Path, replay: bool = True) -> list[str]:
    """Write everything into the folder; returns the names of the files."""
    table = table_of(study, answers.rows)
    written = [TABLE, "table.csv", "study.json", "report.html"]
    try:
        pyarrow.parquet.write_table(table, out / TABLE)
        pyarrow.csv.write_csv(table, out / "table.csv")
        write_json(answers.document(), out / "study.json", "study")
        written += write_report(study, answers, out)
        if answers.best is not None:
            best = machine_of(study, np.array(answers.row(answers.best)[1]))
            write_machine(best, out / BEST_MACHINE)
            written.append(BEST_MACHINE)
            if replay:
                written += write_replays(study, best, out)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written ({error.strerror}); give another --out with --resume in a copy of this folder"
        ) from None
    return written


def write_replays(study: Study, best: Machine, out: Path) -> list[str]:
    """A recording of each run: the best machine, with the nominal one drawn over it."""
    from twin.replay import write_recording

    written = []
    for source in work_of(study).sources:
        try:
            traces = {"best": _trace(source, best), "nominal": _trace(source, study.machine)}
        except TwinError:
            continue  # the nominal machine cannot run this: there is nothing to lay beside
        name = f"best_{source.name}.rrd"
        write_recording(out / name, best, traces)
        written.append(name)
    return written


def _trace(source: Source, machine: Machine) -> Trace:
    return simulate(machine.with_feedforward(source.feedforward), motion_of(source, machine, None)[0]).trace
